"""A body that comes nearer while its lines are exposed, against its tangent cone asked at each line's own time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from opnav_workbench.camera import Camera, RowTiming, row_sweep
from opnav_workbench.geometry import least_turn, rotation_from_vector, unit
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import following
from opnav_workbench.targets import TargetState

RADIUS_KM, POSITION_KM = 40.0, np.array([30.0, -20.0, 900.0])
VELOCITY_KM_S = np.array([3.0, 2.0, -12.0])  # of the body; the spacecraft rests
SIZE = 512
CASES = {
    "rolling": (RowTiming(-2e-3), [0.01, 0.02, 0.03]),
    "scanner": (RowTiming(0.01, 255.5), [2.2e-2, 3e-4, -1e-4]),  # a pixel a line
}


@pytest.fixture(params=CASES)
def rest_and_swept(request):
    timing, rate = CASES[request.param]
    camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/cubesat.yaml")
    rest = replace(
        camera,
        n_pixel=SIZE,
        n_line=SIZE,
        center_pixel_line=np.array([255.5, 255.5]),
        focal_from_camera=np.eye(3),
    )

    def attitude(time_s):
        return rotation_from_vector(np.array(rate) * time_s)

    return (
        rest,
        replace(rest, rows=timing, sweep=row_sweep(timing, SIZE, rest.pixel_scale_rad, attitude)),
        attitude,
    )


def cone(position, angle):
    """Directions of a sphere's limb at angles about its center, carried along as the center moves."""
    start = unit(POSITION_KM)
    first = unit(np.cross(start, [0.0, 1.0, 0.0]))
    spoke = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(start, first))
    sine = RADIUS_KM / np.linalg.norm(position)
    limb = np.sqrt(1.0 - sine**2) * start + sine * spoke
    return limb @ rotation_from_vector(least_turn(start, unit(position))).T


def by_bisection(rest, swept, attitude, angle):
    def place(line):
        time_s = (line - 0.5 * (SIZE - 1)) * swept.rows.line_time_s
        seen = cone(POSITION_KM + VELOCITY_KM_S * time_s, np.array([angle]))[0]
        return rest.project(attitude(time_s) @ seen)

    goal = swept.rows.detector_line
    line = brentq(
        lambda line: place(line)[1] - (line if goal is None else goal), -200.0, SIZE + 200.0, xtol=1e-10
    )
    return np.array([place(line)[0], line])


def test_the_limb_is_where_each_line_sees_it(rest_and_swept):
    rest, swept, attitude = rest_and_swept
    target = TargetState("ROCK", POSITION_KM, radii_km=np.full(3, RADIUS_KM), velocity_km_s=VELOCITY_KM_S)
    camera = following(swept, target, np.zeros(3), np.eye(3))
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    truth = np.array([by_bisection(rest, swept, attitude, angle) for angle in angles])
    inside = (truth[:, 1] > -0.5) & (truth[:, 1] < SIZE - 0.5)  # beyond, the camera's turn is not known
    assert np.count_nonzero(inside) >= 16
    truth, limb = truth[inside], cone(POSITION_KM, angles)[inside]
    np.testing.assert_allclose(camera.project(limb), truth, rtol=0, atol=0.02)
    np.testing.assert_allclose(camera.unproject(truth), limb, rtol=0, atol=0.02 * rest.pixel_scale_rad)
    # As if its distance stayed, the limb would be off by this.
    as_far = replace(camera, sweep=replace(camera.sweep, toward=None, spread=None))
    assert np.abs(as_far.project(limb) - truth).max() > 0.5


def test_jacobians_are_those_of_differences(rest_and_swept):
    _, swept, _ = rest_and_swept
    target = TargetState("ROCK", POSITION_KM, radii_km=np.full(3, RADIUS_KM), velocity_km_s=VELOCITY_KM_S)
    camera = following(swept, target, np.zeros(3), np.eye(3))
    places = np.array([[200.0, 300.0], [330.0, 180.0], [270.0, 240.0]])
    rays = camera.unproject(places)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(camera.project(rays), places, rtol=0, atol=1e-6)
    step = 1e-3
    there = np.stack(
        [
            (camera.unproject(places + move) - camera.unproject(places - move)) / (2.0 * step)
            for move in step * np.eye(2)
        ],
        axis=-1,
    )
    jacobian = camera.unproject_jacobian(places)
    np.testing.assert_allclose(jacobian, there, rtol=0, atol=1e-9)
    forth = camera.project_jacobian(rays) @ jacobian
    np.testing.assert_allclose(forth, np.broadcast_to(np.eye(2), (3, 2, 2)), rtol=0, atol=1e-5)


def test_a_camera_mounted_otherwise_sees_the_body_spread_about_its_center(rest_and_swept):
    """As `RowSweep.standing` turns its path, the direction about which the limb spreads turns, too."""
    _, swept, _ = rest_and_swept
    target = TargetState("ROCK", POSITION_KM, radii_km=np.full(3, RADIUS_KM), velocity_km_s=VELOCITY_KM_S)
    other = rotation_from_vector([0.01, -0.02, 0.3])
    sweep = following(swept, target, np.zeros(3), np.eye(3)).sweep.standing(other)
    np.testing.assert_allclose(sweep.toward, other @ unit(POSITION_KM), rtol=0, atol=1e-12)


def test_what_has_no_limb_spreads_nothing(rest_and_swept):
    _, swept, _ = rest_and_swept
    for radius in (None, 1e-6):
        radii = None if radius is None else np.full(3, radius)
        target = TargetState("ROCK", POSITION_KM, radii_km=radii, velocity_km_s=VELOCITY_KM_S)
        assert following(swept, target, np.zeros(3), np.eye(3)).sweep.toward is None
