"""A body that comes nearer while its lines are exposed, against its tangent cone asked at each line's own time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from opnav_workbench.camera import Camera, RowTiming, row_sweep
from opnav_workbench.geometry import apparent_direction, least_turn, rotation_from_vector, unit
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import following, turned_meanwhile, with_aberration, with_course
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
    as_far = replace(camera, sweep=replace(camera.sweep, spread=None))
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
    toward = other @ unit(POSITION_KM)
    np.testing.assert_allclose(
        sweep.spread @ toward, np.broadcast_to(toward, (len(sweep.spread), 3)), rtol=0, atol=1e-12
    )


def test_what_has_no_limb_spreads_nothing(rest_and_swept):
    _, swept, _ = rest_and_swept
    for radius in (None, 1e-6):
        radii = None if radius is None else np.full(3, radius)
        target = TargetState("ROCK", POSITION_KM, radii_km=radii, velocity_km_s=VELOCITY_KM_S)
        assert following(swept, target, np.zeros(3), np.eye(3)).sweep.spread is None


# ---- Another side of it, and its spin.

AXES_KM = np.array([60.0, 40.0, 25.0])
SPIN_RAD_S = np.array([0.01, 0.03, -0.02])
BEND_KM_S2 = np.array([0.2, -0.4, 0.3])


def turned(time_s):
    """J2000 from J2000 at mid-picture, of the body's surface."""
    return rotation_from_vector(SPIN_RAD_S * time_s)


def place_km(time_s):
    return POSITION_KM + VELOCITY_KM_S * time_s + 0.5 * BEND_KM_S2 * time_s**2


@pytest.fixture
def tumbling(rest_and_swept):
    """An ellipsoid that spins, on a bent path: another side is seen from line to line."""
    _, swept, _ = rest_and_swept
    start = rotation_from_vector([0.3, -0.5, 1.1])
    target = TargetState("ROCK", POSITION_KM, radii_km=AXES_KM, body_from_j2000=start)

    def at(time_s):
        return replace(target, position_km=place_km(time_s), body_from_j2000=start @ turned(time_s).T)

    return with_course(target, float(swept.sweep.time_s[-1]), at), start


def limb_of(position_km, start, count=48):
    """Directions that touch the ellipsoid at mid-picture, by the polar plane of the observer."""
    eye = -(start @ position_km) / AXES_KM
    toward = unit(eye)
    first = unit(np.cross(toward, [0.2, 0.5, -0.3]))
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    distance = np.linalg.norm(eye)
    circle = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(toward, first))
    touched = toward / distance + np.sqrt(1.0 - distance**-2) * circle
    return unit((touched - eye) * AXES_KM @ start)


@pytest.mark.parametrize("epoch_s", [0.0, 0.2])
def test_the_limb_of_a_tumbling_ellipsoid_touches_it_at_each_line_s_own_time(
    rest_and_swept, tumbling, epoch_s
):
    rest, swept, attitude = rest_and_swept
    body, start = tumbling
    body = body.at_time(epoch_s)
    camera = following(swept, body, np.zeros(3), np.eye(3))
    limb = limb_of(place_km(epoch_s), start @ turned(epoch_s).T)
    places = camera.project(limb)
    inside = (places[:, 1] > -0.5) & (places[:, 1] < SIZE - 0.5)
    assert np.count_nonzero(inside) >= 24

    def misses_px(places, position_at, turned_at):
        off = []
        for pixel, line in places:
            time_s = (line - 0.5 * (SIZE - 1)) * swept.rows.line_time_s
            goal = line if swept.rows.detector_line is None else swept.rows.detector_line
            ray = (start @ turned_at(time_s).T @ attitude(time_s).T @ rest.unproject([pixel, goal])) / AXES_KM
            eye = -(start @ turned_at(time_s).T @ position_at(time_s)) / AXES_KM
            nearest = np.linalg.norm(np.cross(unit(ray), eye))  # 1 where the ray touches
            off.append(
                (nearest - 1.0) * AXES_KM.min() / np.linalg.norm(position_at(time_s)) / rest.pixel_scale_rad
            )
        return np.array(off)

    assert np.abs(misses_px(places[inside], place_km, turned)).max() < 0.02
    # a body that does not turn, or flies straight on, has another limb
    assert np.abs(misses_px(places[inside], place_km, lambda _: np.eye(3))).max() > 0.3
    straight = misses_px(places[inside], lambda t: POSITION_KM + VELOCITY_KM_S * t, turned)
    assert np.abs(straight).max() > 0.1 or swept.rows.detector_line is None


def test_a_course_is_the_same_told_from_another_time(tumbling):
    body, _ = tumbling
    later = body.at_time(0.3)
    assert later.at_time(0.3) is later
    np.testing.assert_allclose(later.position_km, place_km(0.3), atol=1e-6)
    for first, again in zip(body.along_course([-0.2, 0.4]), later.along_course([-0.2, 0.4]), strict=True):
        assert first.shape == again.shape == (2, 3)
    np.testing.assert_allclose(later.along_course([0.4])[0], body.along_course([0.4])[0], atol=1e-9)
    np.testing.assert_allclose(
        later.at_time(-0.2).body_from_j2000, body.at_time(-0.2).body_from_j2000, atol=1e-9
    )
    back = later.at_time(0.0)
    np.testing.assert_allclose(back.body_from_j2000, body.body_from_j2000, atol=1e-9)


def test_how_far_a_surface_turns_meanwhile(rest_and_swept):
    _, swept, _ = rest_and_swept
    ball = TargetState("BALL", POSITION_KM, radii_km=[RADIUS_KM] * 3, body_from_j2000=np.eye(3))
    spin = np.cross([0.0, 1.0, 0.0], unit(POSITION_KM)) * 0.0 + 0.05 * unit(
        np.cross(POSITION_KM, [0.0, 1.0, 0.0])
    )
    half_s = float(swept.sweep.time_s[-1])
    still = with_course(ball, half_s, lambda _: ball)
    turning = with_course(
        ball, half_s, lambda t: replace(ball, body_from_j2000=rotation_from_vector(spin * t).T)
    )
    assert turned_meanwhile(swept, still, np.zeros(3), np.eye(3))[0] == pytest.approx(0.0, abs=1e-6)
    px, seconds = turned_meanwhile(swept, turning, np.zeros(3), np.eye(3))
    radius_px = RADIUS_KM / np.linalg.norm(POSITION_KM) / swept.pixel_scale_rad
    assert px == pytest.approx(radius_px * 0.05 * seconds, rel=1e-3)
    assert 0.0 < seconds <= half_s


def test_a_velocity_that_changes_turns_the_field(rest_and_swept):
    """Places seen with the velocity of mid-picture, by an attitude that is turned, are those seen with the velocity then."""
    _, swept, attitude = rest_and_swept

    def velocity(time_s):
        return np.array([20.0, -5.0, 10.0]) + np.array([0.0, 30.0, 0.0]) * time_s

    seen = with_aberration(swept, 0.2, attitude, velocity)
    field = unit(np.add(swept.boresight, [[0.0, 0.0, 0.0], [0.02, -0.01, 0.0]]))
    then, turned_then = attitude(0.2), seen(0.2)
    wanted = apparent_direction(field @ then, velocity(0.2)) @ then.T
    told = apparent_direction(field @ then, velocity(0.0)) @ turned_then.T
    assert np.abs(told - wanted).max() < 1e-6
    assert np.abs(apparent_direction(field @ then, velocity(0.0)) @ then.T - wanted).max() > 1e-5
    assert with_aberration(swept, 0.2, attitude, lambda _: np.array([20.0, 0.0, 0.0])) is attitude
