"""Targets as values: validation, stars as targets, and where a body's light lies."""

import numpy as np
import pytest

from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import CatalogError, KernelError
from opnav_workbench.geometry import camera_from_j2000, unit_from_radec
from opnav_workbench.observables import numerical_position_partials
from opnav_workbench.targets import MIN_PARALLAX_RAD, TargetState, center_of_light_radii, star_target

POSITION = (3e6, 4e6, 0.0)


def test_target_holds_read_only_floats():
    target = TargetState("PLUTO", POSITION, radii_km=(1188, 1188, 1188), body_from_j2000=np.eye(3))
    assert target.range_km == 5e6
    np.testing.assert_allclose(target.direction, [0.6, 0.8, 0.0], atol=1e-16)
    assert target.radii_km.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        target.position_km[0] = 0.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"position_km": (1.0, 2.0)}, "position_km"),
        ({"position_km": (1.0, np.nan, 2.0)}, "position_km"),
        ({"position_km": (0.0, 0.0, 0.0)}, "at the spacecraft"),
        ({"radii_km": (1.0, -1.0, 1.0)}, "negative radius"),
        ({"radii_km": (1.0, np.inf, 1.0)}, "radii_km"),
        ({"body_from_j2000": np.diag([1.0, 1.0, -1.0])}, "no rotation"),
        ({"body_from_j2000": 1.01 * np.eye(3)}, "no rotation"),
        ({"sun_position_km": np.eye(3)}, "sun_position_km"),
        ({"covariance_km2": np.diag([1.0, 1.0, -1.0])}, "negative eigenvalue"),
        ({"covariance_km2": np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]])}, "not symmetric"),
        ({"name": ""}, "needs a name"),
    ],
)
def test_impossible_targets_are_errors(fields, message):
    with pytest.raises(KernelError, match=message):
        TargetState(**{"name": "PLUTO", "position_km": POSITION} | fields)


def test_star_stands_at_the_distance_of_its_parallax():
    parallax = np.radians(0.7685 / 3600.0)
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]]) * 1e-18
    ra, dec = 3.79, -1.094
    star = star_target("Proxima Cen", 7.0 * unit_from_radec(ra, dec), parallax, covariance_rad2=covariance)
    assert star.is_star
    assert star.radii_km is None
    assert star.range_km == pytest.approx(AU_KM / parallax, rel=1e-14)
    # Toward east: (-sin ra, cos ra, 0); nothing along the line of sight.
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    assert east @ star.covariance_km2 @ east == pytest.approx(4e-18 * star.range_km**2, rel=1e-9)
    assert abs(star.direction @ star.covariance_km2 @ star.direction) < 1e-12 * np.trace(star.covariance_km2)


@pytest.mark.parametrize("parallax", [np.nan, 0.0, -1e-9, 1e-30])
def test_star_of_unknown_parallax_has_vanishing_partials(cameras, parallax):
    star = star_target("FAR", unit_from_radec(1.0, 0.2), parallax)
    assert star.range_km == pytest.approx(AU_KM / MIN_PARALLAX_RAD)
    camera = cameras["lorri"]
    attitude = camera_from_j2000(1.0, 0.2, 0.0, camera.focal_from_camera)
    partials = numerical_position_partials(star.position_km, np.zeros(3), camera, attitude)
    assert np.isfinite(partials).all()
    assert np.abs(partials).max() * 50.0 * AU_KM < 1e-3  # px for 50 au of error


def test_star_parallax_partials_are_the_parallax(cameras):
    """Moving the observer by 1 au across the line of sight moves Proxima by its parallax."""
    parallax = np.radians(0.7685 / 3600.0)
    star = star_target("Proxima Cen", unit_from_radec(1.0, 0.2), parallax)
    camera = cameras["lorri"]
    attitude = camera_from_j2000(1.0, 0.2, 0.0, camera.focal_from_camera)
    partials = numerical_position_partials(star.position_km, np.zeros(3), camera, attitude)
    moved = np.linalg.norm(partials @ [-np.sin(1.0), np.cos(1.0), 0.0]) * AU_KM
    assert moved == pytest.approx(parallax / camera.pixel_scale_rad, rel=1e-5)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (1.0, np.nan, 0.0), (1.0, 0.0)])
def test_star_without_a_direction_is_an_error(direction):
    with pytest.raises(CatalogError, match="direction"):
        star_target("X", direction, 1e-6)


def test_star_covariance_of_the_wrong_shape_is_an_error():
    with pytest.raises(CatalogError, match=r"shape \(3, 3\)"):
        star_target("X", (1.0, 0.0, 0.0), 1e-6, covariance_rad2=np.eye(3))


@pytest.mark.parametrize("phase_deg", [2.0, 15.0, 60.0, 90.0, 130.0])
def test_center_of_light_by_quadrature(phase_deg):
    """Lambert and Lommel-Seeliger spheres integrated over the disk; the shift is the mean of both."""
    alpha = np.radians(phase_deg)
    t, w = np.polynomial.legendre.leggauss(400)
    x, y = np.meshgrid(t, t)
    weight = np.outer(w, w)
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    toward_sun = np.maximum(x * np.sin(alpha) + z * np.cos(alpha), 0.0)  # cosine of incidence, Sun along +x
    inside = x**2 + y**2 < 1.0
    shifts = []
    lommel_seeliger = np.where(toward_sun > 0.0, toward_sun / (toward_sun + z + 1e-300), 0.0)
    for brightness in (toward_sun, lommel_seeliger):
        light = np.where(inside, brightness, 0.0) * weight
        shifts.append(np.sum(light * x) / np.sum(light))
    shift, sigma = center_of_light_radii(alpha)
    assert shift == pytest.approx(np.mean(shifts), abs=2e-3)  # quadrature over a disk on a square grid
    assert sigma == pytest.approx(0.5 * abs(shifts[0] - shifts[1]), abs=2e-3)
