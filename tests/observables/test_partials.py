"""Partials: numerical against analytic, against closed forms, and against SPICE's aberration."""

import numpy as np
import pytest
import spiceypy
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector
from opnav_workbench.observables import (
    analytic_position_partials,
    numerical_position_partials,
)

CAMERAS = ("lorri", "mapcam", "mvic", "pinhole")
RELATIVE = 1e-6
NEW_HORIZONS_KM_S = np.array([3.1, -12.4, -6.0])


def attitude_of(camera, ra=4.7, dec=-0.25, twist=2.0):
    return camera_from_j2000(ra, dec, twist, camera.focal_from_camera)


@given(
    name=st.sampled_from(CAMERAS),
    place=st.tuples(st.floats(-0.1, 1.1), st.floats(-0.1, 1.1)),
    log_range=st.floats(2.0, 19.5),
    velocity=st.tuples(*[st.floats(-200.0, 200.0)] * 3),
    angles=st.tuples(st.floats(0.0, 6.28), st.floats(-1.57, 1.57), st.floats(0.0, 6.28)),
)
@settings(max_examples=150, deadline=None)
def test_numerical_partials_agree_with_analytic_ones(
    cameras, body_seen_at, name, place, log_range, velocity, angles
):
    """On the detector and 10 % beyond it; from 100 km to 1 Mpc; any velocity within the solar system."""
    camera = cameras[name]
    attitude = attitude_of(camera, *angles)
    pixel_line = np.array(place) * [camera.n_pixel - 1, camera.n_line - 1]
    body = body_seen_at(camera, attitude, pixel_line, 10.0**log_range, velocity)
    numerical = numerical_position_partials(body.position_km, velocity, camera, attitude)
    analytic = analytic_position_partials(body.position_km, velocity, camera, attitude)
    assert np.abs(numerical - analytic).max() < RELATIVE * np.abs(analytic).max()


def test_lorri_far_off_axis(cameras, body_seen_at):
    """Each component to 1e-6 in the corner, where distortion and its slope are largest."""
    camera = cameras["lorri"]
    attitude = attitude_of(camera)
    for corner in ((0, 0), (1023, 0), (0, 1023), (1023, 1023)):
        body = body_seen_at(camera, attitude, corner, 6.318e6, NEW_HORIZONS_KM_S)
        arguments = body.position_km, NEW_HORIZONS_KM_S, camera, attitude
        analytic = analytic_position_partials(*arguments)
        np.testing.assert_allclose(numerical_position_partials(*arguments), analytic, rtol=RELATIVE)


def test_size_is_that_of_the_paper_scale(cameras, body_seen_at):
    """1 LORRI px at range rho is 4.9636e-6 rho km (facts: IFOV), whatever the direction across."""
    camera, range_km = cameras["lorri"], 6.318e6
    attitude = attitude_of(camera)
    body = body_seen_at(camera, attitude, (511.5, 511.5), range_km, np.zeros(3))
    partials = numerical_position_partials(body.position_km, np.zeros(3), camera, attitude)
    assert np.linalg.svd(partials)[1] == pytest.approx(1.0 / (4.963571e-6 * range_km), rel=1e-5)
    # Moving along the line of sight does not move the body in the picture.
    assert np.abs(partials @ body.direction).max() < 1e-8 * np.abs(partials).max()


def test_closed_form_without_aberration_and_distortion(cameras):
    """d(S, L)/dr = K [[f/z, 0, -X/z], [0, f/z, -Y/z]] in the focal frame, negated for the spacecraft."""
    camera = cameras["pinhole"]
    attitude = attitude_of(camera)
    focal_km = np.array([300.0, -250.0, 9000.0])
    position = attitude.T @ camera.focal_from_camera.T @ focal_km
    f, z = camera.focal_length_mm, focal_km[2]
    x, y = f * focal_km[:2] / z
    closed = camera.pixel_from_mm @ np.array([[f / z, 0.0, -x / z], [0.0, f / z, -y / z]])
    expected = -closed @ camera.focal_from_camera @ attitude
    for partials in (numerical_position_partials, analytic_position_partials):
        result = partials(position, np.zeros(3), camera, attitude)
        np.testing.assert_allclose(result, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("speed", [14.5, 35.0, 200.0])
def test_aberration_is_that_of_spice(cameras, body_seen_at, speed):
    """Differences of `stelab`, CSPICE's own; aberration changes the partials by its own size, v/c."""
    camera = cameras["lorri"]
    attitude = attitude_of(camera)
    velocity = speed * np.array([0.36, -0.8, 0.48])
    position = np.array(body_seen_at(camera, attitude, (100.0, 900.0), 1e6, velocity).position_km)

    def place(offset_km):
        return camera.project(attitude @ spiceypy.stelab(position - offset_km, velocity))

    step = 10.0  # 1e-5 rad
    differences = [(place(step * e) - place(-step * e)) / (2.0 * step) for e in np.eye(3)]
    expected = np.column_stack(differences)
    result = analytic_position_partials(position, velocity, camera, attitude)
    tolerance = 3e-8 * np.abs(expected).max()  # truncation 1e-10, rounding 1e-11; (v/c)^2 is 4e-7 at 200 km/s
    np.testing.assert_allclose(result, expected, atol=tolerance)
    np.testing.assert_allclose(
        numerical_position_partials(position, velocity, camera, attitude), expected, atol=tolerance
    )
    # The same body without aberration: the test would see it if it were left out.
    still = analytic_position_partials(position, 1e-9 * velocity, camera, attitude)
    assert np.abs(still - expected).max() > 20.0 * tolerance


@pytest.mark.parametrize("name", CAMERAS)
def test_attitude_jacobian_is_the_difference_quotient(cameras, name):
    camera = cameras[name]
    attitude = attitude_of(camera)
    corner = np.array([[0.9 * camera.n_pixel, 0.1 * camera.n_line]])
    direction = camera.unproject(corner)[0] @ attitude
    partials = camera.attitude_jacobian(attitude @ direction)
    step = 1e-6
    for axis in range(3):
        turned = [rotation_from_vector(s * step * np.eye(3)[axis]) @ attitude for s in (1, -1)]
        moved = [camera.project(rotation @ direction) for rotation in turned]
        expected = (moved[0] - moved[1]) / (2.0 * step)
        np.testing.assert_allclose(partials[:, axis], expected, atol=1e-7 / camera.pixel_scale_rad)


def test_body_behind_the_camera_has_no_partials(cameras, body_seen_at):
    camera = cameras["lorri"]
    attitude = attitude_of(camera)
    behind = -np.array(body_seen_at(camera, attitude, (500.0, 500.0), 1e6, np.zeros(3)).position_km)
    for partials in (numerical_position_partials, analytic_position_partials):
        with pytest.raises(PointingError, match="not in front of the camera"):
            partials(behind, np.zeros(3), camera, attitude)
