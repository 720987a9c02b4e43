"""Unresolved bodies: errors against their covariance, statuses, and what may spoil a center."""

import numpy as np
import pytest
from scipy.special import erf

from opnav_workbench.bodies import BodyCenter, find_unresolved
from opnav_workbench.bodies.unresolved import FALSE_ALARM, detection_snr
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars import NoiseModel, ShapePrior

SHAPE = (64, 72)  # lines, pixels
NOISE_DN = 5.0
SIGMA_PX = 0.8
GAIN = 2.0  # e/DN
PRIOR = ShapePrior.round_psf(SIGMA_PX, 0.1, 0.05)


def gaussian(center, flux, sigma=SIGMA_PX):
    """Return a picture of one round Gaussian integrated over the pixels, by error functions."""
    axes = [np.arange(n) for n in (SHAPE[1], SHAPE[0])]
    steps = [
        0.5 * (erf((axis + 0.5 - c) / (sigma * np.sqrt(2))) - erf((axis - 0.5 - c) / (sigma * np.sqrt(2))))
        for axis, c in zip(axes, center, strict=True)
    ]
    return flux * np.outer(steps[1], steps[0])


def with_noise(picture, rng):
    return picture + rng.normal(size=SHAPE) * np.sqrt(NOISE_DN**2 + picture / GAIN)


def find(picture, prediction, radius=5.0, **options):
    noise = np.full(SHAPE, NOISE_DN)
    bad = options.pop("bad", np.zeros(SHAPE, dtype=bool))
    return find_unresolved(
        picture,
        noise,
        bad,
        prediction,
        options.pop("prior", PRIOR),
        name="NIX",
        search_radius_px=radius,
        noise_model=NoiseModel(NOISE_DN, GAIN),
        **options,
    )


def test_body_is_found_where_it_is():
    rng = np.random.default_rng(1)
    body = find(with_noise(gaussian((31.3, 28.8), 5000.0), rng), (33.0, 27.0))
    assert (body.name, body.method, body.status, body.messages) == ("NIX", "unresolved", "ok", ())
    assert body.pixel_line == pytest.approx([31.3, 28.8], abs=0.06)
    assert body.flux_dn == pytest.approx(5000.0, rel=0.05)
    assert body.snr > 50.0


@pytest.mark.slow
def test_errors_are_what_the_covariance_says():
    rng, errors = np.random.default_rng(2), []
    for _ in range(500):
        center = rng.uniform(28.0, 38.0, 2)
        flux = np.exp(rng.uniform(np.log(500.0), np.log(20000.0)))
        body = find(with_noise(gaussian(center, flux), rng), center + rng.uniform(-2.0, 2.0, 2))
        assert body.status == "ok"
        errors.append((body.pixel_line - center) / np.sqrt(np.diag(body.covariance_px2)))
    ratio = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((ratio > 0.9) & (ratio < 1.1)), ratio
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.15)  # 3.4 sigma of a mean over 500


def test_excess_and_light_offset_enter():
    rng = np.random.default_rng(3)
    picture = with_noise(gaussian((30.0, 30.0), 5000.0), rng)
    plain = find(picture, (30.0, 30.0))
    offset_covariance = np.array([[0.02, 0.01], [0.01, 0.03]])
    body = find(
        picture,
        (30.0, 30.0),
        excess_sigma_px=0.2,
        light_offset_px=(0.3, -0.1),
        light_offset_covariance_px2=offset_covariance,
    )
    # The light lies 0.3 px beyond the center of figure, so the center lies 0.3 px before the light.
    np.testing.assert_allclose(body.pixel_line, plain.pixel_line - [0.3, -0.1], atol=1e-12)
    expected = plain.covariance_px2 + 0.04 * np.eye(2) + offset_covariance
    np.testing.assert_allclose(body.covariance_px2, expected, atol=1e-12)


def disk(center, radius, flux):
    """Return a uniform disk seen through the PSF, by rings of points."""
    t, w = np.polynomial.legendre.leggauss(12)
    picture = np.zeros(SHAPE)
    for r, weight in zip(0.5 * (t + 1.0), 0.5 * w, strict=True):
        for angle in np.arange(12) * np.pi / 6.0:
            place = np.array(center) + radius * r * np.array([np.cos(angle), np.sin(angle)])
            picture += gaussian(place, 2.0 * r * weight * flux / 12.0)
    return picture


def test_small_disk_is_not_taken_for_a_wrong_psf():
    """A disk of 2.4 px under a PSF known to 3 %: its own width is told by the predicted diameter."""
    picture = with_noise(disk((30.2, 30.6), 1.2, 20000.0), np.random.default_rng(4))
    known = ShapePrior.round_psf(SIGMA_PX, 0.03, 0.03)
    body = find(picture, (30.0, 31.0), diameter_px=2.4, prior=known)
    assert body.status == "ok"
    assert body.flux_dn == pytest.approx(20000.0, rel=0.03)
    assert body.pixel_line == pytest.approx([30.2, 30.6], abs=0.06)
    # The same picture taken for a point is doubted.
    assert find(picture, (30.0, 31.0), prior=known).status == "uncertain"


def test_faint_body_is_uncertain():
    rng, seen = np.random.default_rng(5), []
    # A flux of 4.4 times its sigma, sigma = noise / sqrt(sum psf^2).
    flux = 4.4 * NOISE_DN / np.sqrt(np.sum(gaussian((30.0, 30.0), 1.0) ** 2))
    for _ in range(60):
        body = find(with_noise(gaussian((30.0, 30.0), flux), rng), (30.0, 30.0), radius=3.0)
        seen.append(body.status)
        if body.pixel_line is not None and body.snr < 5.0:
            assert body.status == "uncertain"
            assert "is below 5" in body.messages[0]
    assert seen.count("uncertain") > 20


@pytest.mark.slow(keep=["25.0"])
@pytest.mark.parametrize("radius", [3.0, 12.0, 25.0])
def test_noise_is_rarely_taken_for_a_body(radius):
    rng = np.random.default_rng(6)
    alarms = [find(rng.normal(0.0, NOISE_DN, SHAPE), (36.0, 32.0), radius).pixel_line for _ in range(200)]
    assert sum(a is not None for a in alarms) <= 8  # 200 * 0.01 expected, 8 once in 1000


@pytest.mark.parametrize(("radius", "sigma"), [(5.0, 0.8), (20.0, 1.5)])
def test_detection_level_is_what_filtered_noise_reaches(radius, sigma):
    """Brute force: white noise, Gaussian filter, its maximum within the circle."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(7)
    n = int(2 * radius + 12 * sigma) // 2 * 2 + 1
    line, pixel = np.indices((n, n)) - n // 2
    inside, level = np.hypot(line, pixel) <= radius, detection_snr(radius, sigma)
    norm = 1.0 / np.sqrt(np.sum(gaussian_filter((np.hypot(line, pixel) == 0).astype(float), sigma) ** 2))
    exceeded = np.mean(
        [(gaussian_filter(rng.normal(size=(n, n)), sigma) * norm)[inside].max() > level for _ in range(3000)]
    )
    # Samples at whole pixels miss some of a continuous field's peaks, so the level is a little safe.
    assert 0.2 * FALSE_ALARM < exceeded < 1.3 * FALSE_ALARM


def test_missing_body_is_not_detected():
    body = find(np.random.default_rng(8).normal(0.0, NOISE_DN, SHAPE), (36.0, 32.0))
    assert (body.status, body.pixel_line) == ("not_detected", None)
    assert np.isnan(body.covariance_px2).all()
    assert "nothing found within 5.0 px" in body.messages[0]
    assert "needed" in body.messages[0]


def test_body_outside_the_search_radius_is_not_taken():
    body = find(with_noise(gaussian((50.0, 30.0), 5000.0), np.random.default_rng(9)), (30.0, 30.0))
    assert body.status == "not_detected"


@pytest.mark.parametrize(
    ("prediction", "words"),
    [
        ((-0.6, 30.0), "pixel -0.6, line 30.0, outside the 72 x 64"),
        ((30.0, 63.6), "line 63.6"),
        ((np.nan, np.nan), "not in front of the camera"),
        ((1e6, 3.0), "far outside"),
    ],
)
def test_body_off_the_detector_has_no_center(prediction, words):
    body = find(np.zeros(SHAPE), prediction)
    assert (body.status, body.pixel_line) == ("off_detector", None)
    assert words in body.messages[0]


@pytest.mark.parametrize(("flux", "sigma"), [(3e4, SIGMA_PX), (1e6, SIGMA_PX), (1e8, 2.5)])
def test_saturated_body_has_no_center(flux, sigma):
    picture = with_noise(gaussian((30.2, 30.4), flux, sigma), np.random.default_rng(10))
    body = find(np.minimum(picture, 4000.0), (30.0, 30.0), saturated=picture >= 4000.0)
    assert (body.status, body.pixel_line) == ("saturated", None)
    assert "shorter exposure" in body.messages[0]


def test_saturated_star_elsewhere_does_not_matter():
    rng = np.random.default_rng(11)
    picture = with_noise(gaussian((20.0, 20.0), 3000.0) + gaussian((55.0, 45.0), 3e5), rng)
    body = find(np.minimum(picture, 4000.0), (20.0, 20.0), saturated=picture >= 4000.0)
    assert body.status == "ok"


def test_close_neighbour_makes_a_center_uncertain():
    rng = np.random.default_rng(12)
    picture = with_noise(gaussian((30.0, 30.0), 5000.0) + gaussian((32.5, 30.5), 1500.0), rng)
    body = find(picture, (30.0, 30.0), neighbours_px=[(32.5, 30.5), (np.nan, np.nan)])
    assert body.status == "uncertain"
    assert any("another object 2." in message for message in body.messages)


def test_brighter_neighbour_in_the_search_area_is_not_taken_for_the_body():
    rng = np.random.default_rng(13)
    picture = with_noise(gaussian((30.0, 30.0), 2000.0) + gaussian((36.0, 33.0), 20000.0), rng)
    body = find(picture, (29.5, 30.5), radius=10.0, neighbours_px=[(36.0, 33.0)])
    assert body.status == "ok"
    error = (body.pixel_line - [30.0, 30.0]) / np.sqrt(np.diag(body.covariance_px2))
    assert np.all(np.abs(error) < 4.0)


@pytest.mark.parametrize("charge", [150.0, 500.0, 2000.0])
def test_cosmic_ray_is_not_certified(charge):
    picture = np.random.default_rng(14).normal(0.0, NOISE_DN, SHAPE)
    picture[30, 31] += charge
    body = find(picture, (30.0, 30.0))
    assert body.status == "uncertain"
    assert any("not that of a star" in message for message in body.messages)


def test_smeared_image_is_not_certified():
    trail = sum(gaussian((28.0 + step, 30.0), 1500.0) for step in np.linspace(0.0, 4.0, 9))
    body = find(with_noise(trail, np.random.default_rng(18)), (30.0, 30.0))
    assert body.status == "uncertain"


@pytest.mark.slow
def test_few_good_bodies_are_doubted():
    rng = np.random.default_rng(19)
    fluxes = np.geomspace(700.0, 30000.0, 100)
    seen = [find(with_noise(gaussian((30.3, 30.4), flux), rng), (30.0, 30.0)).status for flux in fluxes]
    assert seen.count("ok") >= 99


def test_edge_and_bad_pixels():
    rng = np.random.default_rng(15)
    body = find(with_noise(gaussian((1.0, 30.0), 5000.0), rng), (2.0, 30.0))
    assert body.status == "uncertain"
    assert "edge" in body.messages[0]
    bad = np.zeros(SHAPE, dtype=bool)
    bad[20:40, 20:40] = True
    body = find(with_noise(gaussian((30.0, 30.0), 5000.0), rng), (30.0, 30.0), bad=bad)
    assert body.status == "not_detected"
    assert "no usable pixels" in body.messages[0]


def test_one_bad_pixel_in_the_core_does_not_bias():
    rng, errors = np.random.default_rng(16), []
    bad = np.zeros(SHAPE, dtype=bool)
    bad[30, 30] = True
    for _ in range(40):
        picture = with_noise(gaussian((30.4, 30.3), 8000.0), rng)
        picture[30, 30] = 60000.0
        body = find(picture, (30.0, 30.0), bad=bad)
        errors.append((body.pixel_line - [30.4, 30.3]) / np.sqrt(np.diag(body.covariance_px2)))
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.6)  # 4 sigma of a mean over 40


def test_results_are_checked_and_read_only():
    with pytest.raises(CenterfindingError, match="unknown status 'good'"):
        BodyCenter("NIX", "unresolved", "good", None, np.eye(2))
    body = find(with_noise(gaussian((30.0, 30.0), 5000.0), np.random.default_rng(17)), (30.0, 30.0))
    with pytest.raises(ValueError, match="read-only"):
        body.covariance_px2[0, 0] = 1.0
