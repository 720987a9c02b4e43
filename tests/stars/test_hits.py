"""Cosmic rays in and beside stars, saturated cores and masked pixels: what flight data hold."""

import numpy as np
import pytest

from opnav_workbench.psf import GaussianPsf, add_sources
from opnav_workbench.stars import (
    NoiseModel,
    ShapePrior,
    StarFlag,
    fit_gaussian,
    fit_psf,
    fit_stars,
    flux_at_snr,
    strange_images,
)

NOISE_DN = 3.0
NOISE = NoiseModel(NOISE_DN, 15.0)
STARS, TILE = 400, 26
FULL_DN = 4000.0


def field(star_mosaic, unit_gaussian, sigma, flux, seed):
    rng = np.random.default_rng(seed)
    clean, truth = star_mosaic(STARS, TILE, unit_gaussian(sigma), rng)
    image = rng.poisson(15.0 * flux * clean) / 15.0 + rng.normal(0.0, NOISE_DN, clean.shape) + 40.0
    return image, truth, rng


def with_hits(image, truth, rng, reach_px):
    """One hit for each star, 10 to 1000 sigma of the noise, one or two pixels, up to `reach_px` from the star."""
    column, row = np.rint(truth + rng.uniform(-reach_px, reach_px, truth.shape)).astype(int).T
    charge = np.exp(rng.uniform(np.log(10.0 * NOISE_DN), np.log(1000.0 * NOISE_DN), len(truth)))
    hit = image.copy()
    hit[row, column] += charge
    hit[row, column + 1] += charge * rng.uniform(0.0, 0.5, len(truth))
    return hit


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "snr"), [(1.2, 15), (1.2, 40), (0.8, 30)])
def test_hits_within_the_box_are_masked(star_mosaic, unit_gaussian, sigma, snr):
    prior = ShapePrior.round_psf(sigma, 0.03, 0.03)
    flux = flux_at_snr(snr, GaussianPsf(sigma, sigma), NOISE_DN, box_px=13, noise_model=NOISE)
    image, truth, rng = field(star_mosaic, unit_gaussian, sigma, flux, 1)
    hit = with_hits(image, truth, rng, 4.0)
    clean, masked, raw = (
        fit_gaussian(data, NOISE_DN, None, truth, prior, noise_model=NOISE, mask_hits=mask)
        for data, mask in ((image, True), (hit, True), (hit, False))
    )
    spread = [np.median(np.hypot(*(fit.pixel_line - truth).T)) for fit in (clean, masked, raw)]
    # Pixels that are masked in a core are lost: a quarter more error, not a pixel.
    assert spread[1] < 1.3 * spread[0]
    assert spread[1] < 0.5 * spread[2]
    assert np.mean(masked.usable) > 0.95
    assert np.mean(masked.flags & StarFlag.HIT > 0) > 0.85
    # What is left of a hit beside the mask is small: most stars keep the errors that they state.
    normalized = np.hypot(*((masked.pixel_line - truth) / masked.sigma_px).T)
    assert np.mean(normalized < 3.5) > 0.85


def test_stars_without_hits_lose_no_pixel(star_mosaic, unit_gaussian):
    image, truth, _ = field(star_mosaic, unit_gaussian, 1.0, 2e4, 2)
    prior = ShapePrior.round_psf(1.0, 0.03, 0.03)
    fit = fit_gaussian(image, NOISE_DN, None, truth, prior, noise_model=NOISE)
    raw = fit_gaussian(image, NOISE_DN, None, truth, prior, noise_model=NOISE, mask_hits=False)
    assert not np.any(fit.flags & StarFlag.HIT)
    np.testing.assert_array_equal(fit.pixel_line, raw.pixel_line)


def test_wings_that_the_model_lacks_are_not_hits(star_mosaic, unit_gaussian):
    # A tenth of the light in a halo, as real optics have it.
    rng = np.random.default_rng(3)

    def make(center, pixel, line):
        return 9e3 * unit_gaussian(0.8)(center, pixel, line) + 1e3 * unit_gaussian(2.0)(center, pixel, line)

    clean, truth = star_mosaic(STARS, TILE, make, rng)
    image = clean + rng.normal(0.0, NOISE_DN, clean.shape)
    fit = fit_gaussian(image, NOISE_DN, None, truth, ShapePrior.round_psf(0.8, 0.1, 0.1))
    assert np.mean(fit.flags & StarFlag.HIT > 0) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "sigma_scale"), [(0.7, 0.03), (0.7, 0.3), (1.5, 0.03), (1.5, 0.3)])
def test_a_hit_where_there_is_no_star_is_recognised_by_its_sharpness(sigma, sigma_scale):
    rng = np.random.default_rng(4)
    image = rng.normal(0.0, NOISE_DN, (20 * TILE, 20 * TILE))
    line, pixel = (np.indices((20, 20)).reshape(2, -1) * TILE) + TILE // 2
    image[line, pixel] += np.exp(rng.uniform(np.log(20.0 * NOISE_DN), np.log(3000.0 * NOISE_DN), 400))
    start = np.column_stack([pixel, line]) + rng.uniform(-0.5, 0.5, (400, 2))
    fit = fit_gaussian(
        image, NOISE_DN, None, start, ShapePrior.round_psf(sigma, sigma_scale, sigma_scale), noise_model=NOISE
    )
    assert np.mean(fit.usable) < 0.01
    assert np.mean(fit.flags & StarFlag.COSMIC_RAY > 0) > 0.99


def test_a_listed_star_is_nobodys_hit(star_mosaic, unit_gaussian):
    # Fitted apart, a star in another one's box must not be masked away for both.
    clean, truth = star_mosaic(1, 40, unit_gaussian(1.0), np.random.default_rng(5))
    image = 3000.0 * (clean + np.roll(clean, 5, axis=1))
    start = np.vstack([truth, truth + np.array([5.0, 0.0])])
    fit = fit_psf(image, 1.0, None, start, GaussianPsf(1.0, 1.0), joint=False)
    assert fit.usable.all()
    np.testing.assert_allclose(fit.pixel_line, start, atol=0.05)


@pytest.mark.slow(keep=["1.0-3.0", "1.0-30.0"])
@pytest.mark.parametrize(("sigma", "times_full"), [(1.0, 3.0), (1.0, 30.0), (1.5, 100.0)])
def test_saturated_cores_are_masked_and_the_wings_tell_the_center(
    star_mosaic, unit_gaussian, sigma, times_full
):
    flux = FULL_DN * times_full * 2.0 * np.pi * (sigma**2 + 1.0 / 12.0)
    image, truth, rng = field(star_mosaic, unit_gaussian, sigma, flux, 6)
    saturated = image > FULL_DN
    image[saturated] = FULL_DN
    start = truth + rng.uniform(-0.7, 0.7, truth.shape)
    fit = fit_gaussian(
        image, NOISE_DN, None, start, ShapePrior.round_psf(sigma, 0.03, 0.03), noise_model=NOISE,
        saturated=saturated,
    )  # fmt: skip
    assert np.all(fit.flags & StarFlag.SATURATED)
    assert np.mean(fit.usable) > 0.99
    error = (fit.pixel_line - truth)[fit.usable]
    assert np.abs(error).max() < 0.05
    assert 0.9 < np.sqrt(np.mean((error / fit.sigma_px[fit.usable]) ** 2)) < 1.1


def test_pixels_of_bad_quality_have_no_say(star_mosaic, unit_gaussian):
    image, truth, rng = field(star_mosaic, unit_gaussian, 1.0, 3000.0, 7)
    bad = rng.uniform(size=image.shape) < 0.05
    spoiled = np.where(bad, rng.normal(0.0, 1e5, image.shape), image)
    prior = ShapePrior.round_psf(1.0, 0.05, 0.05)
    one, other = (
        fit_gaussian(data, NOISE_DN, bad, truth, prior, noise_model=NOISE) for data in (image, spoiled)
    )
    for name in ("pixel_line", "covariance_px2", "flux_dn", "chi2_reduced", "flags"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    error = (one.pixel_line - truth)[one.usable]
    assert 0.95 < np.sqrt(np.mean((error / one.sigma_px[one.usable]) ** 2)) < 1.05


def test_tracks_taken_for_stars_do_not_spoil_the_others():
    """Four stars of an undersampled picture; two fits begin on a cosmic ray's track: the two others keep their centers."""
    rng = np.random.default_rng(8)
    psf, places = GaussianPsf(0.42, 0.42), np.array([[20.3, 20.1], [60.7, 22.4], [22.2, 61.6], [58.1, 60.9]])
    image = np.zeros((80, 80))
    add_sources(image, psf, places, np.full(4, 600.0))
    image += rng.normal(0.0, 1.3, image.shape)
    start = places.copy()
    for star, track in (
        (0, [(22, 19), (23, 18), (23, 17), (24, 16)]),
        (1, [(63, 21), (64, 20), (64, 19), (65, 18)]),
    ):
        for pixel, line in track:
            image[line, pixel] += 830.0
        start[star] = track[1]
    centers, _ = fit_stars(image, 1.3, None, start, ShapePrior.round_psf(0.4))
    assert np.abs(centers.pixel_line[2:] - places[2:]).max() < 0.05
    assert not strange_images(centers)[2:].any()
