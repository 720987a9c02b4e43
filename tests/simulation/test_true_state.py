"""The truth that kernels do not know: offsets of bodies and spacecraft, and attitudes off the predicted one."""

import math
from pathlib import Path

import numpy as np
import pytest
import spiceypy

from opnav_workbench.catalog import open_catalog
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import angle_between, pointing_angles, tangent_basis
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.mission import load_mission
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.simulation.scenario import ActualAttitude, Perturbations, PredictedAttitude
from opnav_workbench.simulation.true_state import (
    predicted_attitude,
    true_attitude,
    true_observer,
    true_stars,
    true_target,
)
from opnav_workbench.stars.pointing import attitude_shift

NH = -98
CLIGHT = 299792.458


@pytest.fixture(scope="module")
def et():
    with KernelSet("new_horizons/pluto_approach"):
        yield et_from_utc("2015-07-12T08:46:57")


@pytest.fixture(scope="module")
def camera():
    return load_mission("new_horizons").camera_for(
        {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"}
    )


def perturbed(**values):
    return Perturbations.model_validate(values)


def test_without_perturbations_the_kernels_are_true(et):
    known, true = body_target("CHARON", NH, et), true_target("CHARON", NH, et, Perturbations())
    assert np.array_equal(known.position_km, true.position_km)
    assert np.array_equal(
        true_observer(NH, et, Perturbations()).position_km, observer_from_kernels(NH, et).position_km
    )


def test_a_barycenter_moves_its_whole_system_toward_the_sun(et):
    truth = perturbed(bodies=[{"name": "PLUTO BARYCENTER", "toward_sun_km": 4500.0}])
    sun, _ = spiceypy.spkpos("SUN", et, "J2000", "NONE", "PLUTO BARYCENTER")
    toward = sun / np.linalg.norm(sun)
    for name in ("PLUTO", "CHARON", "PLUTO BARYCENTER"):
        moved = true_target(name, NH, et, truth).position_km - body_target(name, NH, et).position_km
        assert moved == pytest.approx(4500.0 * toward, abs=0.1)  # km: the body itself moves 80 m in 15 ms
    # facts of the paper's case: 15 deg off the line of sight, so 4347 km along it and 1165 km across
    along = body_target("PLUTO", NH, et).direction
    assert -moved @ along == pytest.approx(4347.0, abs=15.0)
    assert np.linalg.norm(moved - (moved @ along) * along) == pytest.approx(1165.0, abs=60.0)


def test_the_sun_is_seen_from_the_moved_body(et):
    truth = perturbed(bodies=[{"name": "PLUTO", "offset_km": [1000.0, -2000.0, 500.0]}])
    known, true = body_target("PLUTO", NH, et), true_target("PLUTO", NH, et, truth)
    assert true.sun_position_km - known.sun_position_km == pytest.approx([-1000.0, 2000.0, -500.0], abs=1e-3)
    other = true_target("CHARON", NH, et, truth)
    assert np.array_equal(other.position_km, body_target("CHARON", NH, et).position_km)


def test_light_time_is_that_of_the_moved_body(et):
    """A large offset, against light time iterated by hand on the body's own path."""
    offset = np.array([3e6, -2e6, 1e6])
    truth = perturbed(bodies=[{"name": "PLUTO", "offset_km": offset.tolist()}])
    true = true_target("PLUTO", NH, et, truth).position_km
    craft, _ = spiceypy.spkpos(str(NH), et, "J2000", "NONE", "SSB")
    light_s = 0.0
    for _ in range(5):
        body, _ = spiceypy.spkpos("PLUTO", et - light_s, "J2000", "NONE", "SSB")
        expected = body + offset - craft
        light_s = np.linalg.norm(expected) / CLIGHT
    assert true == pytest.approx(expected, abs=0.02)  # km: 1e-9 of what the second-order term could be


def test_the_spacecraft_moves_the_other_way(et):
    truth = perturbed(spacecraft={"position_km": [10.0, 20.0, -30.0], "velocity_km_s": [0.001, 0.0, 0.0]})
    moved = true_target("PLUTO", NH, et, truth).position_km - body_target("PLUTO", NH, et).position_km
    assert moved == pytest.approx([-10.0, -20.0, 30.0], abs=2e-3)
    there, here = true_observer(NH, et, truth), observer_from_kernels(NH, et)
    assert there.position_km - here.position_km == pytest.approx([10.0, 20.0, -30.0], abs=1e-5)
    assert there.velocity_km_s - here.velocity_km_s == pytest.approx([0.001, 0.0, 0.0], abs=1e-12)


def test_an_unknown_body_is_refused(et):
    with pytest.raises(KernelError, match="NEMESIS"):
        true_target("PLUTO", NH, et, perturbed(bodies=[{"name": "NEMESIS", "offset_km": [1, 0, 0]}]))


# -- attitude ------------------------------------------------------------------------------------------------------


def actual(**values):
    return ActualAttitude.model_validate(values)


def test_predicted_attitude_from_kernels_angles_and_quaternion(et, camera):
    ck = predicted_attitude(PredictedAttitude(source="kernels"), camera, et)
    assert ck == pytest.approx(spiceypy.pxform("J2000", camera.frame, et), abs=1e-15)
    quaternion = tuple(spiceypy.m2q(ck.copy()))
    fixed = PredictedAttitude(source="fixed", quaternion_camera_from_j2000=quaternion)
    assert predicted_attitude(fixed, camera, et) == pytest.approx(ck, abs=1e-14)
    ra, dec, twist = (math.degrees(a) for a in pointing_angles(ck, camera.focal_from_camera))
    fixed = PredictedAttitude(source="fixed", ra_deg=ra, dec_deg=dec, twist_deg=twist)
    assert predicted_attitude(fixed, camera, et) == pytest.approx(ck, abs=1e-13)


def test_a_given_error_is_the_shift_that_repointing_reports(et, camera):
    predicted = predicted_attitude(PredictedAttitude(source="kernels"), camera, et)
    plan = actual(source="error", shift_px=[14.3, -9.6], twist_deg=0.06)
    true = true_attitude(plan, predicted, camera, et, 1, Path())
    shift = attitude_shift(camera, predicted, true)
    # distortion moves a point 17 px from the center by 1e-3 px
    assert [shift.delta_pixel, shift.delta_line] == pytest.approx([14.3, -9.6], abs=2e-3)
    assert math.degrees(shift.delta_twist_rad) == pytest.approx(0.06, abs=1e-9)


def test_random_errors_have_the_a_priori_size(camera):
    nominal = np.array(spiceypy.eul2m(0.3, 1.2, -2.0, 3, 1, 3))
    plan = actual(source="random")
    draws = [true_attitude(plan, nominal, camera, 0.0, seed, Path()) for seed in range(500)]
    vectors = np.array([axis * angle for axis, angle in (spiceypy.raxisa(a @ nominal.T) for a in draws)])
    sigma, px = camera.attitude_sigma, 12.997e-3 / 2618.4775964615382691
    # 500 draws tell a deviation to 3.2 %; LORRI's pixel, line and boresight are its X, Y and -Z.
    assert vectors[:, :2].std(axis=0) / px == pytest.approx([sigma.cross_px] * 2, rel=0.13)
    assert np.degrees(vectors[:, 2].std()) == pytest.approx(sigma.twist_deg, rel=0.13)
    assert np.abs(vectors.mean(axis=0) / vectors.std(axis=0)).max() < 0.18  # 4 sigmas of a mean


def test_no_error_and_errors_of_other_kernels(et, camera):
    predicted = predicted_attitude(PredictedAttitude(source="kernels"), camera, et)
    assert true_attitude(actual(source="none"), predicted, camera, et, 1, Path()) is predicted
    turned = np.array(spiceypy.rotate(0.01, 3)) @ predicted
    plan = actual(source="kernels", kernels="new_horizons/pluto_approach")
    assert angle_between(
        true_attitude(plan, turned, camera, et, 1, Path()).T @ camera.boresight,
        predicted.T @ camera.boresight,
    ) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_true_stars_are_off_by_what_their_catalog_leaves_open(et):
    """Seen from Pluto; a star's error is its own, whoever stands beside it."""
    catalog, observer_km = open_catalog("bundled"), np.array([1.3e9, -4.5e9, -1.6e9])
    stars = catalog.cone(4.72, -0.25, 0.06, mag_limit=11.0)
    known, n = stars.motion_known, len(stars)
    assert 50 < known.sum() < n
    east, north = tangent_basis(stars.ra_rad, stars.dec_rad)
    believed, squares = stars.directions(et, observer_km), []
    weight = np.linalg.inv(stars.sky_covariance(et, observer_km))
    for seed in range(30):
        off = true_stars(stars, seed).directions(et, observer_km) - believed
        on_sky = np.stack([(off * axis).sum(axis=1) for axis in (east, north)], axis=-1)
        squares.append(np.einsum("ni,nij,nj->n", on_sky, weight, on_sky) / 2.0)
    assert np.mean(np.array(squares)[:, known]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.array(squares)[:, ~known]) > 0.5  # of a mixture with tails
    few = true_stars(stars.take(slice(3, 9)), 5)
    assert np.array_equal(few.ra_rad, true_stars(stars, 5).ra_rad[3:9])
    assert not np.array_equal(few.ra_rad, true_stars(stars, 6).ra_rad[3:9])
