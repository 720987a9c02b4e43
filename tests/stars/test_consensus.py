"""The PSF that the stars of a frame agree on, and the second fit that uses it."""

import numpy as np
import pytest

from opnav_workbench.psf import shape_from_ellipse
from opnav_workbench.stars import (
    NoiseModel,
    ShapePrior,
    StarFlag,
    estimate_psf_error,
    fit_gaussian,
    fit_stars,
    shape_from_stars,
)

NOISE_DN = 2.0
TRUE_ELLIPSE = (0.42, 0.31, 0.8)  # an undersampled, smeared PSF: sigma_major_px, sigma_minor_px, angle_rad
BROAD = ShapePrior.round_psf(0.5, 0.3, 0.3)


def frame(render_stars, star_grid, n, fluxes, seed, ellipse=TRUE_ELLIPSE):
    rng = np.random.default_rng(seed)
    centers, shape = star_grid(n, 16, rng)
    image = render_stars(shape, centers, fluxes, *(np.full(n, v) for v in ellipse))
    return image + rng.normal(0.0, NOISE_DN, shape), centers


def test_consensus_finds_the_psf_that_no_star_tells_alone(render_stars, star_grid):
    image, centers = frame(render_stars, star_grid, 25, 600.0, 1)
    fit = fit_gaussian(image, NOISE_DN, None, centers, BROAD)
    consensus = shape_from_stars(fit, BROAD)
    truth = shape_from_ellipse(np.array(TRUE_ELLIPSE))
    assert abs(consensus.log_scale - truth[0]) < 0.05
    np.testing.assert_allclose(consensus.ellipticity, truth[1:], atol=0.1)
    assert consensus.sigma_log_scale < 0.5 * BROAD.sigma_log_scale
    # The prior (0.5 px, round) is far off; stars outvote it.
    assert abs(BROAD.log_scale - truth[0]) > 0.25


@pytest.mark.slow
def test_second_fit_is_better_for_faint_stars(render_stars, star_grid):
    fluxes = np.where(np.arange(400) < 40, 1500.0, 60.0)
    image, centers = frame(render_stars, star_grid, 400, fluxes, 2)
    noise = NoiseModel(NOISE_DN, 1e6)
    first = fit_gaussian(image, NOISE_DN, None, centers, BROAD, noise_model=noise)
    second, _ = fit_stars(image, NOISE_DN, None, centers, BROAD, noise_model=noise)
    faint = (fluxes < 100.0) & first.usable & second.usable
    assert faint.sum() > 300
    before, after = (np.sqrt(np.mean((f.pixel_line - centers)[faint] ** 2)) for f in (first, second))
    assert after < 0.99 * before
    scatter = ((second.pixel_line - centers) / second.sigma_px)[faint].std(axis=0)
    assert np.all((scatter > 0.87) & (scatter < 1.1)), (
        scatter
    )  # what is round of a PSF has a variance of its own: 0.89
    assert second.psf_error == 0.0


def test_without_well_exposed_stars_the_prior_stays(render_stars, star_grid):
    image, centers = frame(render_stars, star_grid, 9, 40.0, 3)
    fit = fit_gaussian(image, NOISE_DN, None, centers, BROAD)
    assert fit.snr.max() < 30.0
    assert shape_from_stars(fit, BROAD) is BROAD


def test_one_odd_star_does_not_spoil_the_consensus(render_stars, star_grid):
    rng = np.random.default_rng(4)
    centers, shape = star_grid(16, 24, rng)
    major = np.where(np.arange(16) == 5, 2.2, 1.0)  # a galaxy among the stars
    image = render_stars(shape, centers, 5000.0, major) + rng.normal(0.0, NOISE_DN, shape)
    prior = ShapePrior.round_psf(1.2, 0.3, 0.2)
    consensus = shape_from_stars(fit_gaussian(image, NOISE_DN, None, centers, prior, box_px=15), prior)
    assert abs(consensus.sigma_px - 1.0) < 0.02
    assert consensus.sigma_log_scale < 0.06


def test_scatter_between_stars_widens_the_consensus(render_stars, star_grid):
    rng = np.random.default_rng(6)
    centers, shape = star_grid(64, 24, rng)
    sigma = 1.0 * np.exp(0.12 * rng.normal(size=64))  # a PSF that varies over the field by 12 %
    image = render_stars(shape, centers, 8000.0, sigma) + rng.normal(0.0, NOISE_DN, shape)
    prior = ShapePrior.round_psf(1.1, 0.5, 0.2)
    consensus = shape_from_stars(fit_gaussian(image, NOISE_DN, None, centers, prior), prior)
    assert 0.08 < consensus.sigma_log_scale < 0.17


def test_spoiled_stars_have_no_say(render_stars, star_grid):
    image, centers = frame(render_stars, star_grid, 4, 5000.0, 7, (1.0, 1.0, 0.0))
    saturated = image > 300.0
    prior = ShapePrior.round_psf(1.3, 0.3, 0.2)
    fit = fit_gaussian(image, NOISE_DN, None, centers, prior, saturated=saturated)
    assert np.all(fit.flags & StarFlag.SATURATED)
    assert shape_from_stars(fit, prior) is prior
    assert estimate_psf_error(fit) == 0.0


@pytest.mark.slow(keep=["0.08"])
@pytest.mark.parametrize("error", [0.02, 0.08])
def test_psf_error_is_measured_from_the_misfit(render_stars, star_grid, error):
    rng = np.random.default_rng(8)
    centers, shape = star_grid(100, 20, rng)
    clean = render_stars(shape, centers, 2e4, 0.9)
    image = clean * (1.0 + error * rng.normal(size=shape)) + rng.normal(0.0, 1.0, shape)
    fit, _ = fit_stars(image, 1.0, None, centers, ShapePrior.round_psf(0.9, 0.05, 0.05))
    # The fit absorbs part of the error of the few bright pixels, so the measured value is lower.
    assert 0.5 * error < fit.psf_error < 1.2 * error
    scatter = ((fit.pixel_line - centers) / fit.sigma_px).std(axis=0)
    assert np.all((scatter > 0.6) & (scatter < 1.6)), scatter
