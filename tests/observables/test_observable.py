"""Observables: O, C, O-C and their covariance against known displacements and errors."""

import numpy as np
import pytest

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.geometry import (
    apparent_direction,
    camera_from_j2000,
    rotation_from_vector,
    tangent_basis,
    unit_from_radec,
)
from opnav_workbench.observables import observe
from opnav_workbench.targets import TargetState

VELOCITY_KM_S = np.array([3.1, -12.4, -6.0])
ARCSEC = np.radians(1.0 / 3600.0)
COVARIANCE = np.array([[0.01, 0.002], [0.002, 0.02]])


def looking_at(camera, ra, dec, twist=2.0):
    """Return the attitude whose boresight points at the apparent place of (ra, dec)."""
    seen = apparent_direction(unit_from_radec(ra, dec), VELOCITY_KM_S)
    return camera_from_j2000(
        np.arctan2(seen[1], seen[0]), np.arcsin(seen[2]), twist, camera.focal_from_camera
    )


def measured(pixel_line, covariance=COVARIANCE, **fields):
    return BodyCenter("PLUTO", "unresolved", "ok", np.array(pixel_line), covariance, 5000.0, 80.0, **fields)


def observed_with(camera, attitude, target, center, attitude_covariance=None):
    return observe(
        target,
        center,
        camera,
        attitude,
        np.zeros((3, 3)) if attitude_covariance is None else attitude_covariance,
        observer_velocity_km_s=VELOCITY_KM_S,
        a_priori_px=np.array([1.0, 2.0]),
        diameter_px=0.4,
        image="lor_0299.fit",
        et=4.9e8,
        utc="2015-07-12T08:46:57",
        reference_body="PLUTO BARYCENTER",
    )


def place_of(camera, attitude, direction):
    return camera.project(attitude @ apparent_direction(direction, VELOCITY_KM_S))


@pytest.mark.parametrize(
    ("ra", "dec"), [(4.7, -0.25), (1e-7, 0.4), (2.0, np.radians(89.999)), (3.0, -1.5707)]
)
def test_displaced_body_has_the_displacement_as_residual(cameras, ra, dec):
    """A body 0.30 arcsec north and 0.09 arcsec west of its ephemeris (the paper's Pluto of June 2012)."""
    camera = cameras["lorri"]
    attitude = looking_at(camera, ra, dec)
    computed = unit_from_radec(ra, dec)
    east, north = tangent_basis(ra, dec)
    true = computed + (-0.08963 * east + 0.30037 * north) * ARCSEC
    true = true / np.linalg.norm(true)
    center = measured(place_of(camera, attitude, true))
    result = observed_with(camera, attitude, TargetState("PLUTO", 1e9 * computed), center)
    assert result.residual_arcsec == pytest.approx([-0.08963, 0.30037], abs=1e-6)
    expected = place_of(camera, attitude, true) - place_of(camera, attitude, computed)
    assert result.residual_px == pytest.approx(expected, abs=1e-9)
    assert np.hypot(*result.residual_px) == pytest.approx(np.hypot(0.08963, 0.30037) / 1.0238, rel=1e-3)
    seen = unit_from_radec(np.radians(result.ra_deg), np.radians(result.dec_deg))
    np.testing.assert_allclose(seen, true, atol=1e-6 * ARCSEC)
    apparent = unit_from_radec(np.radians(result.apparent_ra_deg), np.radians(result.apparent_dec_deg))
    np.testing.assert_allclose(apparent, apparent_direction(true, VELOCITY_KM_S), atol=1e-6 * ARCSEC)
    assert 0.0 <= result.ra_deg < 360.0


def test_fields_are_carried_over(cameras):
    camera = cameras["lorri"]
    attitude = looking_at(camera, 4.7, -0.25)
    target = TargetState("PLUTO", 1e9 * unit_from_radec(4.7, -0.25))
    center = measured([510.0, 512.0], diameter_px=0.7, messages=("faint",))
    result = observed_with(camera, attitude, target, center)
    assert (result.name, result.method, result.status) == ("PLUTO", "unresolved", "ok")
    assert (result.image, result.utc, result.et) == ("lor_0299.fit", "2015-07-12T08:46:57", 4.9e8)
    assert result.reference_body == "PLUTO BARYCENTER"
    assert (result.diameter_px, result.measured_diameter_px, result.snr) == (0.4, 0.7, 80.0)
    assert result.messages == ("faint",)
    np.testing.assert_array_equal(result.a_priori_px, [1.0, 2.0])
    np.testing.assert_array_equal(result.covariance_px2, COVARIANCE)
    np.testing.assert_allclose(result.residual_px, result.observed_px - result.predicted_px, atol=1e-12)
    assert result.partials_px_per_km.shape == (2, 3)
    with pytest.raises(ValueError, match="read-only"):
        result.partials_px_per_km[0, 0] = 1.0


@pytest.mark.slow
def test_residual_over_total_covariance_is_chi_squared(cameras):
    """Center noise and attitude errors together: mean chi-squared 2 over 1000 trials, either alone too small."""
    camera, rng = cameras["lorri"], np.random.default_rng(61)
    true = looking_at(camera, 4.7, -0.25)
    direction = camera.unproject(np.array([[950.0, 90.0]]))[0] @ true  # off axis: the twist counts
    target = TargetState("PLUTO", 1e9 * direction)
    sigma = np.array([0.2 * camera.pixel_scale_rad, 0.3 * camera.pixel_scale_rad, 5e-4])
    mixing = np.linalg.qr(rng.normal(size=(3, 3)))[0] * 0.1 + np.eye(3)
    factor = mixing * sigma
    attitude_covariance = factor @ factor.T
    center_factor = np.linalg.cholesky(COVARIANCE)
    place, chi2, without = place_of(camera, true, direction), [], []
    for _ in range(1000):
        error = rotation_from_vector(factor @ rng.normal(size=3))
        center = measured(place + center_factor @ rng.normal(size=2))
        # camera_true = R(eps) camera_solved, so the solved attitude is the true one turned back.
        result = observed_with(camera, error.T @ true, target, center, attitude_covariance)
        residual = result.residual_px
        chi2.append(residual @ np.linalg.solve(result.total_covariance_px2, residual))
        without.append(residual @ np.linalg.solve(result.covariance_px2, residual))
    assert np.mean(chi2) == pytest.approx(2.0, abs=0.22)  # 3.5 sigma of the mean
    assert np.mean(without) > 4.0


def test_body_without_a_center(cameras):
    camera = cameras["lorri"]
    attitude = looking_at(camera, 4.7, -0.25)
    target = TargetState("NIX", 1e9 * unit_from_radec(4.7, -0.25))
    center = BodyCenter.without_center("NIX", "unresolved", "not_detected", "nothing found")
    result = observed_with(camera, attitude, target, center)
    assert result.observed_px is None
    assert result.residual_px is None
    assert result.residual_arcsec is None
    assert np.isnan([result.ra_deg, result.dec_deg, result.apparent_ra_deg, result.apparent_dec_deg]).all()
    assert np.isnan(result.total_covariance_px2).all()
    assert result.partials_px_per_km.shape == (2, 3)  # the prediction stands, and so do its partials


def test_body_behind_the_camera(cameras):
    camera = cameras["lorri"]
    attitude = looking_at(camera, 4.7, -0.25)
    target = TargetState("SUN", -1e9 * unit_from_radec(4.7, -0.25))
    center = BodyCenter.without_center("SUN", "unresolved", "off_detector", "not in front of the camera")
    result = observed_with(camera, attitude, target, center)
    assert result.partials_px_per_km is None
    assert result.partials_px_per_rad is None
    assert np.isnan(result.predicted_px).all()
    assert result.status == "off_detector"
