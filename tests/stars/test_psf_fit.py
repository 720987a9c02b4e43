"""Least squares with a given PSF: empirical templates, wings, trails; and the arrays a person looks at."""

import numpy as np
import pytest

from opnav_workbench.psf import (
    EmpiricalPsf,
    FieldPsf,
    GaussianPsf,
    MoffatPsf,
    PolynomialShape,
    TrailedPsf,
    add_sources,
)
from opnav_workbench.psf.empirical import cells_from_stars
from opnav_workbench.stars import (
    NoiseModel,
    ShapePrior,
    correlate,
    cramer_rao,
    fit_gaussian,
    fit_psf,
    flux_at_snr,
    gaussian_template,
)

NOISE_DN = 3.0
NOISE = NoiseModel(NOISE_DN, 15.0)
STARS = 400


def field(psf, flux, spacing, seed, n=STARS):
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    line, pixel = np.divmod(np.arange(n), side)
    truth = np.column_stack([pixel, line]) * spacing + spacing // 2 + rng.uniform(-0.5, 0.5, (n, 2))
    clean = np.zeros((side * spacing, side * spacing))
    add_sources(clean, psf, truth, np.full(n, flux))
    image = rng.poisson(15.0 * np.maximum(clean, 0.0)) / 15.0 + rng.normal(0.0, NOISE_DN, clean.shape) + 10.0
    return image, truth, truth + rng.uniform(-0.8, 0.8, truth.shape)


@pytest.mark.slow(keep=["100-empirical"])
@pytest.mark.parametrize(
    "psf",
    [MoffatPsf(2.0, 3.0), EmpiricalPsf(GaussianPsf(1.1, 0.7, 0.5).kernel(8), 8)],
    ids=["moffat", "empirical"],
)
@pytest.mark.parametrize("snr", [15, 100])
def test_a_given_psf_reaches_its_bound(psf, snr):
    box = 11
    flux = flux_at_snr(snr, psf, NOISE_DN, box_px=box, noise_model=NOISE)
    image, truth, start = field(psf, flux, 40, [snr, 1])
    fit = fit_psf(image, NOISE_DN, None, start, psf, box_px=box, noise_model=NOISE)
    bound = cramer_rao(truth, flux, psf, NOISE_DN, box_px=box, noise_model=NOISE).sigma_px
    error = fit.pixel_line - truth
    assert fit.usable.all()
    assert 0.92 < np.sqrt(np.mean(error**2) / np.mean(bound**2)) < 1.08  # 800 errors: 2.5 % by chance
    assert 0.92 < np.sqrt(np.mean((error / fit.sigma_px) ** 2)) < 1.08
    assert 0.95 < np.median(fit.chi2_reduced) < 1.05


def test_a_psf_extracted_from_stars_fits_other_stars_to_the_noise():
    # An undersampled PSF with wings, as LORRI's: no Gaussian follows it through the sub-pixel phases.
    image, truth, start = field(MoffatPsf(1.2, 2.5), 3e4, 30, 2)
    half = STARS // 2
    known, others = truth[:half], truth[half:]
    cells = cells_from_stars(image - 10.0, None, known, np.full(half, 3e4), 4, half_size_px=5.0)
    template = EmpiricalPsf(cells, 4)
    empirical = fit_psf(image, NOISE_DN, None, start[half:], template, noise_model=NOISE)
    gaussian = fit_gaussian(image, NOISE_DN, None, start[half:], ShapePrior.round_psf(0.5), noise_model=NOISE)
    errors = [np.sqrt(np.mean((fit.pixel_line - others) ** 2)) for fit in (empirical, gaussian)]
    assert errors[0] < 0.75 * errors[1]
    assert np.median(empirical.chi2_reduced) < 1.3
    assert np.median(gaussian.chi2_reduced) > 50.0
    assert 0.9 < np.sqrt(np.mean(((empirical.pixel_line - others) / empirical.sigma_px) ** 2)) < 1.15


@pytest.mark.slow(keep=["4.0-0.3"])
@pytest.mark.parametrize(("length", "angle"), [(4.0, 0.3), (12.0, 1.2)])
def test_smeared_stars_are_fitted_with_their_trail(length, angle):
    psf = TrailedPsf.straight(GaussianPsf(0.9, 0.9), length, angle)
    flux = flux_at_snr(40, psf, NOISE_DN, box_px=25, noise_model=NOISE)
    image, truth, start = field(psf, flux, 50, 3)
    fit = fit_psf(image, NOISE_DN, None, start, psf, noise_model=NOISE)
    bound = cramer_rao(truth, flux, psf, NOISE_DN, box_px=fit.images.size, noise_model=NOISE).sigma_px
    error = fit.pixel_line - truth
    assert fit.usable.all()
    assert 0.92 < np.sqrt(np.mean(error**2) / np.mean(bound**2)) < 1.08
    assert 0.92 < np.sqrt(np.mean((error / fit.sigma_px) ** 2)) < 1.08
    major, minor, direction = fit.shape[0]
    np.testing.assert_allclose([major, minor], [np.hypot(0.9, length / np.sqrt(12.0)), 0.9], rtol=0.02)
    np.testing.assert_allclose(np.cos(direction - angle) ** 2, 1.0, atol=1e-3)


def test_a_trail_of_unknown_length_is_fitted_by_an_elongated_gaussian():
    psf = TrailedPsf.straight(GaussianPsf(0.9, 0.9), 4.0, 0.3)
    image, truth, start = field(psf, 4000.0, 30, 4)
    fit = fit_gaussian(
        image, NOISE_DN, None, start, ShapePrior.round_psf(1.1, 0.3, 0.4), noise_model=NOISE, box_px=15
    )
    assert fit.usable.mean() > 0.99
    error = (fit.pixel_line - truth)[fit.usable]
    # A trail is no Gaussian: the misfit widens the covariance, which then errs on the safe side.
    assert 0.7 < np.sqrt(np.mean((error / fit.sigma_px[fit.usable]) ** 2)) < 1.1
    np.testing.assert_allclose(np.median(fit.shape[:, 0]), np.hypot(0.9, 4.0 / np.sqrt(12.0)), rtol=0.1)


def test_a_trail_of_a_psf_that_varies_stays_itself():
    varying = FieldPsf(PolynomialShape((400, 400), [0.8, 0.2, 0.0]))
    trail = TrailedPsf.straight(varying, 5.0, 0.0)
    assert trail.tabulated() is trail
    image = np.zeros((60, 400))
    places = np.array([[60.3, 20.4], [340.6, 31.2]])
    add_sources(image, trail, places, np.full(2, 5000.0))
    fit = fit_psf(image, 1.0, None, places + 0.4, trail)
    np.testing.assert_allclose(fit.pixel_line, places, atol=1e-3)


def test_a_table_of_a_trail_is_the_trail():
    trail = TrailedPsf.straight(GaussianPsf(0.6, 0.6), 7.0, 0.7)
    box = trail.box([[10.3, 9.8]], [[0, 0]], 21)
    np.testing.assert_allclose(trail.tabulated().box([[10.3, 9.8]], [[0, 0]], 21), box, atol=2e-5)


# ---------------------------------------------------------------- what a person looks at


def test_images_show_data_model_and_residual_of_the_fit():
    image, _, start = field(GaussianPsf(1.0, 1.0), 4000.0, 30, 5, n=25)
    bad = np.zeros(image.shape, bool)
    bad[15, 15] = True
    fit = fit_gaussian(image, NOISE_DN, bad, start, ShapePrior.round_psf(1.0, 0.05, 0.05), noise_model=NOISE)
    shown = fit.images
    assert len(shown) == 25
    assert np.isnan(shown.data_dn[0]).sum() == 1
    first = shown.first[7]
    np.testing.assert_array_equal(
        shown.data_dn[7], image[first[1] : first[1] + shown.size, first[0] : first[0] + shown.size]
    )
    # The residual is that of the stated chi-square, and what is left has no trace of the star.
    chi2 = np.nansum(shown.weighted_residual**2, axis=(1, 2)) / fit.degrees_of_freedom
    np.testing.assert_allclose(chi2, fit.chi2_reduced, rtol=1e-9)
    assert 0.9 < np.nanstd(shown.weighted_residual) < 1.1
    np.testing.assert_allclose(np.nanmax(shown.model_dn[7]), np.nanmax(shown.data_dn[7]), rtol=0.1)
    assert shown.surface is None


@pytest.mark.parametrize("method", ["matched_filter", "cross_correlation"])
def test_images_show_the_correlation_surface(method):
    image, _, start = field(GaussianPsf(1.0, 1.0), 4000.0, 40, 6, n=25)
    found = correlate(
        image, NOISE_DN, None, start, gaussian_template(1.0, 9), search_radius_px=5.0, method=method
    )
    shown = found.images
    peak = np.array([np.unravel_index(np.nanargmax(s), s.shape)[::-1] for s in shown.surface]) + shown.first
    assert np.abs(peak - found.pixel_line).max() <= 1.0
    if method == "cross_correlation":
        assert shown.size == 16
    residual = np.nansum(shown.residual_dn[:, 3:-3, 3:-3], axis=(1, 2))
    assert np.abs(np.median(residual)) < 0.15 * 4000.0
    middle = shown.model_dn - found.background_dn[:, None, None]
    np.testing.assert_allclose(middle.sum(axis=(1, 2)), found.flux_dn, rtol=1e-4)


def test_the_amplitude_is_the_height_of_the_gaussian():
    image, _, start = field(GaussianPsf(1.2, 1.2), 4000.0, 30, 7, n=9)
    fit = fit_gaussian(image, NOISE_DN, None, start, ShapePrior.round_psf(1.2, 0.01, 0.01), noise_model=NOISE)
    np.testing.assert_allclose(fit.amplitude_dn, 4000.0 / (2.0 * np.pi * 1.2**2), rtol=0.1)
