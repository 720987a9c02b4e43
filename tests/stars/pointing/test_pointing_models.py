"""Jacobians and step models against differences; deltas of attitudes against their definition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.geometry import camera_from_j2000, pointing_angles, rotation_from_vector
from opnav_workbench.stars.pointing import attitude_shift
from opnav_workbench.stars.pointing.attitude_steps import EulerAngles, ImagePlane

CAMERAS = ("lorri", "mapcam", "mvic", "pinhole")
MODELS = (EulerAngles, ImagePlane)


def places(camera, rng, n=20):
    return rng.uniform(0.0, 1.0, (n, 2)) * [camera.n_pixel - 1, camera.n_line - 1]


@pytest.mark.parametrize("name", CAMERAS)
def test_attitude_jacobian_is_the_difference_quotient(cameras, name):
    camera = cameras[name]
    directions = camera.unproject(places(camera, np.random.default_rng(1)))
    jacobian = camera.attitude_jacobian(directions)
    step = 1e-6
    for axis in range(3):
        plus, minus = (rotation_from_vector(s * step * np.eye(3)[axis]) for s in (1, -1))
        difference = (camera.project(directions @ plus.T) - camera.project(directions @ minus.T)) / (2 * step)
        # 1e-7 of the scale of a radian in px: truncation of the difference.
        np.testing.assert_allclose(jacobian[:, :, axis], difference, atol=1e-7 / camera.pixel_scale_rad)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("model", MODELS)
def test_tangent_is_the_rotation_vector_of_a_small_step(cameras, name, model):
    camera = cameras[name]
    steps = model(camera)
    scale = [1e-3, 1e-3, 1e-6] if model is ImagePlane else [1e-6, 1e-6, 1e-6]
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = scale[axis]
        moved = (steps.rotation(step) - steps.rotation(-step)) / (2 * scale[axis])
        vector = np.array([moved[2, 1], moved[0, 2], moved[1, 0]])
        size = np.linalg.norm(steps.tangent[:, axis])
        np.testing.assert_allclose(steps.tangent[:, axis], vector, atol=1e-6 * size)


@pytest.mark.parametrize("name", CAMERAS)
def test_euler_design_is_the_difference_quotient_of_its_rotation(cameras, name):
    camera = cameras[name]
    steps, step = EulerAngles(camera), 1e-6
    pixel_line = places(camera, np.random.default_rng(2))
    directions = camera.unproject(pixel_line)
    design = steps.design(camera.attitude_jacobian(directions), pixel_line)
    for axis in range(3):
        angles = step * np.eye(3)[axis]
        moved = [camera.project(directions @ steps.rotation(s * angles).T) for s in (1, -1)]
        difference = (moved[0] - moved[1]) / (2 * step)
        np.testing.assert_allclose(design[:, :, axis], difference, atol=1e-7 / camera.pixel_scale_rad)


def test_image_plane_step_shifts_and_turns_a_pinhole_picture(cameras):
    camera = cameras["pinhole"]
    steps, pixel_line = ImagePlane(camera), places(cameras["pinhole"], np.random.default_rng(3))
    moved = camera.project(camera.unproject(pixel_line) @ steps.rotation(np.array([0.3, -0.2, 1e-4])).T)
    expected = pixel_line + steps.design(
        camera.attitude_jacobian(camera.unproject(pixel_line)), pixel_line
    ) @ [0.3, -0.2, 1e-4]
    # Second order: 1e-4 rad squared times 512 px, and 0.3 px times the tangent's 0.5 % over the field.
    np.testing.assert_allclose(moved, expected, atol=1e-4)


@pytest.mark.parametrize("name", CAMERAS)
def test_shift_is_where_the_first_boresight_goes(cameras, name):
    camera = cameras[name]
    first = camera_from_j2000(1.0, 0.4, 2.0, camera.focal_from_camera)
    target = camera.project(camera.boresight[None])[0] + [4.5, -12.3]
    # The attitude under which the first boresight is seen at `target`: turn the boresight onto it.
    seen = camera.unproject(target[None])[0]
    axis = np.cross(camera.boresight, seen)
    second = rotation_from_vector(np.arcsin(np.linalg.norm(axis)) * axis / np.linalg.norm(axis)) @ first
    shift = attitude_shift(camera, first, second)
    assert (shift.delta_pixel, shift.delta_line) == pytest.approx((4.5, -12.3), abs=1e-7)


@given(st.floats(-np.pi, np.pi - 1e-6), st.floats(0.0, 2 * np.pi), st.floats(-1.55, 1.55))
@settings(max_examples=50, deadline=None)
def test_twist_delta_is_second_minus_first_and_wrapped(change, twist, dec):
    camera = pinhole()
    first, second = (
        camera_from_j2000(0.7, dec, t, camera.focal_from_camera) for t in (twist, twist + change)
    )
    delta = attitude_shift(camera, first, second).delta_twist_rad
    assert -np.pi <= delta < np.pi
    assert np.cos(delta - change) == pytest.approx(1.0, abs=1e-14)  # equal, or a full turn apart at +-pi
    assert np.sin(delta - change) == pytest.approx(0.0, abs=1e-12)


def pinhole():
    from opnav_workbench.camera import Camera
    from opnav_workbench.resources import kernels_meta_dir

    return Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")


def test_twist_delta_agrees_with_the_angles(cameras):
    camera = cameras["lorri"]
    first = camera_from_j2000(1.0, 0.4, 6.2, camera.focal_from_camera)
    second = camera_from_j2000(1.0002, 0.4001, 0.1, camera.focal_from_camera)
    angles = [pointing_angles(a, camera.focal_from_camera)[2] for a in (first, second)]
    expected = angles[1] - angles[0] + 2 * np.pi
    assert attitude_shift(camera, first, second).delta_twist_rad == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("angle_deg", [100.0, 179.0, 180.0])
def test_shift_to_an_attitude_that_looks_behind_is_the_angle(cameras, angle_deg):
    """About the line axis: the sky moves along pixels by the angle, in pixels of the middle."""
    camera = cameras["lorri"]
    first = camera_from_j2000(1.0, 0.4, 2.0, camera.focal_from_camera)
    turn = rotation_from_vector(camera.focal_from_camera[1] * np.radians(angle_deg))
    shift = attitude_shift(camera, first, turn @ first)
    length = np.hypot(shift.delta_pixel, shift.delta_line)
    assert length == pytest.approx(np.radians(angle_deg) / camera.pixel_scale_rad, rel=1e-9)
    if angle_deg < 180.0:  # straight behind it has no direction
        assert shift.delta_line == pytest.approx(0.0, abs=1e-6)
