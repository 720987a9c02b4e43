"""What is measured by hand in a picture, and another image laid over it."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from opnav_workbench.errors import OpNavError
from opnav_workbench.geometry import apparent_direction, geometric_direction
from opnav_workbench.psf import box_integrals
from opnav_workbench.workbench.exports import solved_wcs
from opnav_workbench.workbench.inspection import compass_arrows, measure_aperture
from opnav_workbench.workbench.laying import laid_over

FLUX, SIGMA_PX, SKY, NOISE = 9000.0, 0.7, 120.0, 3.0


def star_field(center, seed=3):
    noise = np.random.default_rng(seed).normal(SKY, NOISE, (64, 80))
    shape = np.array([[np.log(SIGMA_PX), 0.0, 0.0]])
    star = box_integrals(np.array([center]), shape, np.array([[0, 0]]), 80).value[0][:64]
    return noise + FLUX * star


@pytest.mark.parametrize("center", [(40.3, 20.7), (3.4, 60.2)], ids=["inside", "at the edge"])
def test_aperture_finds_sum_center_and_width(center):
    image = star_field(center)
    usable = np.ones(image.shape, bool)
    found = measure_aperture(image, usable, (center[0] + 1.2, center[1] - 0.8), 5.0)
    assert found.found
    assert (found.pixel, found.line) == pytest.approx(center, abs=0.01)
    assert found.fwhm_px == pytest.approx(2.3548 * SIGMA_PX, rel=0.02)
    assert found.sky_dn == pytest.approx(SKY, abs=1.0)
    assert found.noise_dn == pytest.approx(NOISE, rel=0.2)
    assert abs(found.sum_dn - FLUX) < 4.0 * found.sigma_dn
    assert (found.n_missing > 0) == (center[0] < 5.0)


@pytest.mark.slow
def test_aperture_sums_as_a_known_library_does():
    """Photutils' exact circle on the same sky: nothing but the area of the edge pixels can differ."""
    aperture = pytest.importorskip("photutils.aperture")
    image = star_field((40.3, 20.7))
    found = measure_aperture(image, np.ones(image.shape, bool), (40.3, 20.7), 4.0)
    circle = aperture.CircularAperture((found.pixel, found.line), 4.0)
    peer, _ = circle.do_photometry(image - found.sky_dn)
    assert found.sum_dn == pytest.approx(peer[0], abs=0.2 * NOISE)


@pytest.mark.slow
def test_aperture_scatter_is_what_it_says():
    """Over empty sky the sum scatters by its sigma, and no star is called found in more than a few."""
    rng = np.random.default_rng(8)
    sums, found = [], 0
    for _ in range(60):
        one = measure_aperture(rng.normal(SKY, NOISE, (31, 31)), np.ones((31, 31), bool), (15.0, 15.0), 2.5)
        found += one.found
        if not one.found:
            sums.append(one.sum_dn / one.sigma_dn)
    assert np.std(sums) == pytest.approx(1.0, abs=0.3)
    assert found < 8


def test_aperture_without_pixels_says_so():
    image = np.zeros((40, 40))
    with pytest.raises(OpNavError, match="too few usable pixels"):
        measure_aperture(image, np.zeros((40, 40), bool), (20.0, 20.0), 4.0)
    with pytest.raises(OpNavError, match="no usable pixel is in the aperture"):
        measure_aperture(image, np.hypot(*(np.indices((40, 40)) - 20)) > 4.9, (20.0, 20.0), 4.0)


@pytest.mark.slow
def test_compass_points_as_the_wcs_does(solved_sessions):
    arrows = {name: np.array(way) for name, *way in compass_arrows(solved_sessions[0])}
    assert set(arrows) == {"N", "E", "Sun"}
    camera, wcs = solved_sessions[0].context.camera, solved_wcs(solved_sessions[0])
    middle = 0.5 * (np.array([camera.n_pixel, camera.n_line]) - 1.0)
    ra, dec = wcs.all_pix2world(*middle, 0)
    for name, place in (("N", (ra, dec + 1e-3)), ("E", (ra + 1e-3 / np.cos(np.radians(dec)), dec))):
        step = np.array(wcs.all_world2pix(*place, 0)) - middle
        assert arrows[name] @ step / np.hypot(*step) == pytest.approx(1.0, abs=1e-4), name


@pytest.mark.slow
def test_sun_stands_where_the_body_is_lit(solved_sessions):
    """Light falls from the Sun's side: the terminator lies across the arrow."""
    (arrow,) = (np.array(way) for name, *way in compass_arrows(solved_sessions[0]) if name == "Sun")
    target, camera = solved_sessions[0].inputs.targets["PLUTO"], solved_sessions[0].context.camera
    sun = target.sun_position_km / np.linalg.norm(target.sun_position_km)
    points = [target.position_km, target.position_km + 1000.0 * sun]
    seen = apparent_direction(
        np.array([p / np.linalg.norm(p) for p in points]), solved_sessions[0].inputs.observer.velocity_km_s
    )
    step = np.subtract(*camera.project(seen @ solved_sessions[0].camera_from_j2000.T)[::-1])
    assert arrow @ step / np.hypot(*step) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.slow
def test_image_laid_over_itself_is_itself(solved_sessions):
    image = solved_sessions[0].context.picture.image_dn
    np.testing.assert_array_equal(laid_over(solved_sessions[0], solved_sessions[0], "sky"), image)
    np.testing.assert_array_equal(laid_over(solved_sessions[0], solved_sessions[0], "pixel"), image)


@pytest.mark.slow
def test_image_is_laid_by_direction_or_by_pixel(solved_sessions):
    onto, other = solved_sessions
    by_pixel = laid_over(other, onto, "pixel")
    np.testing.assert_array_equal(by_pixel[:128], other.context.picture.image_dn[:, :256])
    assert np.isnan(by_pixel[128:]).all()
    by_sky = laid_over(other, onto, "sky")
    assert np.isfinite(by_sky).any()
    places = np.random.default_rng(2).integers(0, 256, (400, 2)).astype(float)
    sky = geometric_direction(
        onto.context.camera.unproject(places) @ onto.camera_from_j2000, onto.inputs.observer.velocity_km_s
    )
    seen = apparent_direction(sky, other.inputs.observer.velocity_km_s)
    there = other.context.camera.project(seen @ other.camera_from_j2000.T)
    expected = map_coordinates(
        other.context.picture.image_dn, there[:, ::-1].T, order=0, cval=np.nan, mode="constant"
    )
    found = by_sky[places[:, 1].astype(int), places[:, 0].astype(int)]
    size = np.array(other.context.picture.image_dn.shape[::-1])
    # Not between two pixels, nor on the last half of an edge
    clear = np.abs(there - np.floor(there) - 0.5) > 0.02
    clear = (clear & (np.abs(there + 0.25) > 0.3) & (np.abs(there - size + 0.75) > 0.3)).all(axis=1)
    np.testing.assert_array_equal(found[clear], expected[clear])
