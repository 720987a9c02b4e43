"""Partials with respect to the target's state, and light time: numerical, analytic, and SPICE-like truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import apparent_direction, camera_from_j2000, limb_points
from opnav_workbench.observables import (
    analytic_position_partials,
    analytic_target_partials,
    numerical_position_partials,
    numerical_target_partials,
    observe,
)
from opnav_workbench.observables.observing import diameter_partials
from opnav_workbench.targets import TargetState

CAMERAS = ("lorri", "mapcam", "mvic", "pinhole")
RELATIVE = 1e-6
NEW_HORIZONS_KM_S = np.array([3.1, -12.4, -6.0])
PLUTO_KM_S = np.array([5.35, -0.35, -1.72])


def attitude_of(camera, ra=4.7, dec=-0.25, twist=2.0):
    return camera_from_j2000(ra, dec, twist, camera.focal_from_camera)


@pytest.mark.slow
@given(
    name=st.sampled_from(CAMERAS),
    place=st.tuples(st.floats(-0.1, 1.1), st.floats(-0.1, 1.1)),
    log_range=st.floats(2.0, 10.0),
    velocity=st.tuples(*[st.floats(-100.0, 100.0)] * 3),
    target=st.none() | st.tuples(*[st.floats(-100.0, 100.0)] * 3),
    angles=st.tuples(st.floats(0.0, 6.28), st.floats(-1.57, 1.57), st.floats(0.0, 6.28)),
)
@settings(max_examples=100, deadline=None)
def test_numerical_partials_agree_with_analytic_ones(
    cameras, body_seen_at, name, place, log_range, velocity, target, angles
):
    """On the detector and 10 % beyond; 100 km to 70 au; target at rest, moving, or light time held fixed."""
    camera = cameras[name]
    attitude = attitude_of(camera, *angles)
    pixel_line = np.array(place) * [camera.n_pixel - 1, camera.n_line - 1]
    body = body_seen_at(camera, attitude, pixel_line, 10.0**log_range, velocity)
    arguments = body.position_km, velocity, camera, attitude
    numerical = numerical_target_partials(*arguments, target_velocity_km_s=target)
    analytic = analytic_target_partials(*arguments, target_velocity_km_s=target)
    for columns in (slice(0, 3), slice(3, 6)):
        error = np.abs(numerical[:, columns] - analytic[:, columns]).max()
        assert error < RELATIVE * np.abs(analytic[:, columns]).max()
    by_spacecraft = numerical_position_partials(*arguments, target_velocity_km_s=target)
    exact = analytic_position_partials(*arguments, target_velocity_km_s=target)
    assert np.abs(by_spacecraft - exact).max() < RELATIVE * np.abs(exact).max()


def seen_from_the_spacecraft(target_km, target_km_s, spacecraft_km):
    """Light time by bisection, from positions with respect to the barycenter: nothing of the package."""
    nearest, farthest = 0.0, 1e6
    for _ in range(200):
        middle = 0.5 * (nearest + farthest)
        distance = np.linalg.norm(target_km - target_km_s * middle - spacecraft_km)
        nearest, farthest = (
            (middle, farthest) if distance > SPEED_OF_LIGHT_KM_S * middle else (nearest, middle)
        )
    return target_km - target_km_s * middle - spacecraft_km


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_light_time_by_an_independent_route(cameras, body_seen_at, speed):
    """Differences over barycentric states, light time by bisection: position, velocity and spacecraft position."""
    camera, velocity = cameras["lorri"], NEW_HORIZONS_KM_S
    attitude, target_km_s = attitude_of(camera), speed * PLUTO_KM_S
    seen = np.array(body_seen_at(camera, attitude, (300.0, 800.0), 2.5e6, velocity).position_km)
    spacecraft = np.array([7e8, -4e9, -1e9])
    light_time_s = np.linalg.norm(seen) / SPEED_OF_LIGHT_KM_S
    target = spacecraft + seen + target_km_s * light_time_s

    def place(step):
        moved = seen_from_the_spacecraft(target + step[:3], target_km_s + step[3:6], spacecraft + step[6:])
        return camera.project(attitude @ apparent_direction(moved, velocity))

    # 30 km turn by 1e-5 rad, and distortion bends by 3e-8; of 4e9 km 5e-7 km are lost to rounding, 1e-8 of a step.
    steps = np.diag([30.0] * 3 + [3.0] * 3 + [30.0] * 3)
    differences = [(place(s) - place(-s)) / (2.0 * s.sum()) for s in steps]
    expected = np.column_stack(differences)
    arguments = seen, velocity, camera, attitude
    result = np.concatenate(
        [
            analytic_target_partials(*arguments, target_velocity_km_s=target_km_s),
            analytic_position_partials(*arguments, target_velocity_km_s=target_km_s),
        ],
        axis=1,
    )
    for k in (0, 3, 6):
        scale = np.abs(expected[:, k : k + 3]).max()
        np.testing.assert_allclose(result[:, k : k + 3], expected[:, k : k + 3], atol=1e-7 * scale)
    fixed = analytic_target_partials(*arguments)
    # The term is there: v/c of the partials. Left out, the test would see it.
    assert np.abs(fixed[:, :3] - expected[:, :3]).max() > 2e-6 * np.abs(expected[:, :3]).max()


def observed(cameras, body_seen_at, light_time="fixed", **fields):
    camera = cameras["lorri"]
    attitude = attitude_of(camera)
    seen = body_seen_at(camera, attitude, (300.0, 800.0), 2.5e6, NEW_HORIZONS_KM_S)
    values = {"velocity_km_s": PLUTO_KM_S, "radii_km": np.full(3, 1188.3)} | fields
    target = TargetState("CHARON", seen.position_km, **values)
    center = BodyCenter(
        "CHARON", "ellipse", "ok", np.array([300.3, 799.8]), 0.01 * np.eye(2), diameter_px=189.0
    )
    return observe(
        target,
        center,
        camera,
        attitude,
        1e-14 * np.eye(3),
        observer_velocity_km_s=NEW_HORIZONS_KM_S,
        a_priori_px=np.array([1.0, 2.0]),
        diameter_px=189.1,
        image="lor.fit",
        et=4.9e8,
        utc="2015-07-12T08:46:57",
        reference_body="PLUTO",
        light_time=light_time,
    )


def test_observable_says_what_it_held_fixed(cameras, body_seen_at):
    fixed, solved = (observed(cameras, body_seen_at, way) for way in ("fixed", "solved"))
    assert (fixed.light_time, solved.light_time) == ("fixed", "solved")
    # The velocity moves the body by -light time, in either way; with the light time fixed exactly.
    light_time_s = fixed.range_km / SPEED_OF_LIGHT_KM_S
    np.testing.assert_allclose(
        fixed.target_partials_px_per_km_s, -light_time_s * fixed.target_partials_px_per_km, rtol=1e-7
    )
    # Charon's partials "relative to Pluto" are those of its own place, whoever the reference body is.
    np.testing.assert_allclose(fixed.partials_px_per_km, -fixed.target_partials_px_per_km, rtol=1e-7)
    difference = np.abs(solved.target_partials_px_per_km - fixed.target_partials_px_per_km).max()
    speed = np.linalg.norm(PLUTO_KM_S) / SPEED_OF_LIGHT_KM_S
    assert 0.02 * speed < difference / np.abs(fixed.target_partials_px_per_km).max() < 1.1 * speed
    unknown = observed(cameras, body_seen_at, "solved", velocity_km_s=None)
    assert unknown.light_time == "fixed"
    with pytest.raises(PointingError, match="unknown light time 'never'; choose one of fixed, solved"):
        observed(cameras, body_seen_at, "never")


def test_range_and_size_move_with_the_spacecraft(cameras, body_seen_at):
    """Differences of the distance and of the limb's own width in the picture."""
    result = observed(cameras, body_seen_at)
    position = np.array(result.position_km)
    # 1e-10 km of rounding over 200 km: 1e-12; the curvature is (100 / 2.5e6)^2.
    steps = 100.0 * np.eye(3)
    slopes = [(np.linalg.norm(position - s) - np.linalg.norm(position + s)) / 200.0 for s in steps]
    np.testing.assert_allclose(result.range_partials, slopes, atol=1e-9)
    camera, attitude = cameras["pinhole"], attitude_of(cameras["pinhole"])
    # 1.7 deg wide, seen on the axis
    ahead = attitude.T @ camera.focal_from_camera.T @ np.array([0.0, 0.0, 8e4])

    def width(relative):
        limb = camera.project(limb_points(relative, np.full(3, 1188.3), np.eye(3), 4000) @ attitude.T)
        return 2.0 * np.hypot(*(limb - camera.center_pixel_line).T).mean()

    step = 10.0 * ahead / np.linalg.norm(ahead)
    slope = (width(ahead - step) - width(ahead + step)) / 20.0
    partials = diameter_partials(TargetState("PLUTO", ahead, radii_km=np.full(3, 1188.3)), width(ahead))
    assert partials @ step / 10.0 == pytest.approx(slope, rel=1e-6)
    assert np.abs(np.cross(partials, step)).max() < 1e-9 * np.abs(partials).max()
