"""The least-squares centers against simulated truth: bias, scatter, Cramer-Rao bound; and every flag."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars import (
    NoiseModel,
    PsfShape,
    ShapePrior,
    StarFlag,
    default_box_px,
    describe_flags,
    fit_gaussian,
)

TRIALS = 600
BOUND_TRIALS = 160  # one bound takes as long as ten fits
READ_NOISE_DN = 3.0
GAIN_E_PER_DN = 15.0
NOISE = NoiseModel(READ_NOISE_DN, GAIN_E_PER_DN)
SPACING_PX = 30


def flux_of_snr(snr, sigma):
    """Flux of a star that read noise alone would leave at `snr` in a matched filter."""
    return snr * READ_NOISE_DN * np.sqrt(4.0 * np.pi * (sigma**2 + 1.0 / 12.0))


def draw_shapes(prior, n, rng):
    """Ellipses drawn from a prior: what the prior claims, the truth does."""
    scale = np.exp(prior.log_scale + prior.sigma_log_scale * rng.normal(size=n))
    e = prior.ellipticity + prior.sigma_ellipticity * rng.normal(size=(n, 2))
    size = np.hypot(*e.T)
    return scale * np.sqrt(1 + size), scale * np.sqrt(1 - size), 0.5 * np.arctan2(e[:, 1], e[:, 0])


def simulate(render_stars, star_grid, prior, snr, seed, n=TRIALS, jitter=0.5):
    rng = np.random.default_rng(seed)
    centers, shape = star_grid(n, SPACING_PX, rng, jitter)
    flux = flux_of_snr(snr, prior.sigma_px)
    ellipses = np.array(draw_shapes(prior, n, rng))
    clean = render_stars(shape, centers, flux, *ellipses)
    image = rng.poisson(clean * GAIN_E_PER_DN) / GAIN_E_PER_DN + rng.normal(0.0, READ_NOISE_DN, shape) + 40.0
    start = centers + rng.uniform(-1.0, 1.0, centers.shape)
    return image, centers, ellipses, flux, start


def cramer_rao(pixel_flux, center, ellipse, flux, prior, box_px):
    """Covariance bound (2, 2) of the center, by differences of a brute-force model all nuisances free."""
    major, minor, angle = ellipse
    e = (major**2 - minor**2) / (major**2 + minor**2)
    log_scale = 0.5 * np.log(0.5 * (major**2 + minor**2))
    p0 = np.array([flux, *center, log_scale, e * np.cos(2 * angle), e * np.sin(2 * angle), 40.0])
    half = box_px // 2
    line, pixel = np.indices((box_px, box_px)).reshape(2, -1) - half + np.rint(center)[::-1, None]

    def model(p):
        size = np.hypot(p[4], p[5])
        a, b = np.exp(p[3]) * np.sqrt(1 + size), np.exp(p[3]) * np.sqrt(1 - size)
        return pixel_flux(p[1:3], p[0], a, b, 0.5 * np.arctan2(p[5], p[4]), pixel, line) + p[6]

    steps = np.array([1e-3 * flux, *np.full(5, 1e-4), 1e-2])
    jacobian = np.array([(model(p0 + d) - model(p0 - d)) / (2 * d.sum()) for d in np.diag(steps)])
    variance = READ_NOISE_DN**2 + (model(p0) - 40.0) / GAIN_E_PER_DN
    information = jacobian / variance @ jacobian.T
    information[3, 3] += prior.sigma_log_scale**-2.0
    information[4, 4] += prior.sigma_ellipticity**-2.0
    information[5, 5] += prior.sigma_ellipticity**-2.0
    return np.linalg.inv(information)[1:3, 1:3]


CASES = [
    # sigma px, SNR, background, sigma of log scale, sigma of ellipticity
    (0.7, 20.0, "level", 0.2, 0.1),
    (1.2, 20.0, "plane", 0.2, 0.1),
    (2.0, 20.0, "level", 0.2, 0.1),
    (1.2, 200.0, "level", 0.2, 0.1),
    (0.35, 20.0, "level", 0.05, 0.05),
    (0.35, 100.0, "level", 0.05, 0.05),
]


@pytest.mark.slow(keep=["0.35-100.0-level-0.05-0.05"])
@pytest.mark.parametrize(("sigma", "snr", "background", "sigma_scale", "sigma_e"), CASES)
def test_centers_are_unbiased_efficient_and_know_their_errors(
    render_stars, star_grid, pixel_flux, sigma, snr, background, sigma_scale, sigma_e
):
    prior = ShapePrior.round_psf(sigma, sigma_scale, sigma_e)
    image, truth, ellipses, flux, start = simulate(
        render_stars, star_grid, prior, snr, [int(100 * sigma), int(snr)]
    )
    fit = fit_gaussian(image, READ_NOISE_DN, None, start, prior, background=background, noise_model=NOISE)
    assert fit.usable.mean() > 0.99
    error = (fit.pixel_line - truth)[fit.usable]
    normalized = error / fit.sigma_px[fit.usable]
    scatter = normalized.std(axis=0)
    assert np.all((scatter > 0.9) & (scatter < 1.1)), scatter
    assert np.all(np.abs(normalized.mean(axis=0)) < 0.1), normalized.mean(axis=0)
    assert 0.95 < np.median(fit.chi2_reduced) < 1.05

    box = default_box_px(sigma)
    bound = np.array([
        np.diag(cramer_rao(pixel_flux, truth[i], ellipses[:, i], flux, prior, box))
        for i in np.flatnonzero(fit.usable)[:BOUND_TRIALS]
    ])  # fmt: skip
    ratio = np.sqrt(np.mean(error[:BOUND_TRIALS] ** 2 / bound, axis=0))
    assert np.all((ratio > 0.9) & (ratio < 1.1)), ratio


def test_flux_and_shape_know_their_errors(render_stars, star_grid):
    prior = ShapePrior.round_psf(1.2, 0.2, 0.1)
    image, _, ellipses, flux, start = simulate(render_stars, star_grid, prior, 60.0, 5)
    fit = fit_gaussian(image, READ_NOISE_DN, None, start, prior, noise_model=NOISE)
    assert 0.9 < np.std((fit.flux_dn - flux) / fit.flux_sigma_dn) < 1.1
    np.testing.assert_allclose(np.median(fit.background_dn), 40.0, atol=0.1)
    np.testing.assert_allclose(fit.snr, fit.flux_dn / fit.flux_sigma_dn)
    log_scale = 0.5 * np.log(0.5 * (fit.shape[:, 0] ** 2 + fit.shape[:, 1] ** 2))
    truth = 0.5 * np.log(0.5 * (ellipses[0] ** 2 + ellipses[1] ** 2))
    assert 0.9 < np.std((log_scale - truth) / np.sqrt(fit.shape_covariance[:, 0, 0])) < 1.1


def test_agrees_with_scipy_least_squares_star_by_star(render_stars, star_grid, pixel_flux):
    prior = ShapePrior.round_psf(1.0, 0.3, 0.2)
    image, _, _, flux, start = simulate(render_stars, star_grid, prior, 50.0, 8, n=6, jitter=0.3)
    fit = fit_gaussian(image, READ_NOISE_DN, None, start, prior, box_px=11)
    for i in range(6):
        corner = np.rint(fit.pixel_line[i]).astype(int) - 5
        line, pixel = np.indices((11, 11)).reshape(2, -1) + corner[::-1, None]
        data = image[line, pixel]

        def residuals(p, pixel=pixel, line=line, data=data):
            size = min(np.hypot(p[4], p[5]), 0.95)
            a, b = np.exp(p[3]) * np.sqrt(1 + size), np.exp(p[3]) * np.sqrt(1 - size)
            star = pixel_flux(p[1:3], p[0], a, b, 0.5 * np.arctan2(p[5], p[4]), pixel, line)
            return np.r_[
                (data - star - p[6]) / READ_NOISE_DN, (p[3:6] - prior.mean) * np.sqrt(prior.information)
            ]

        p0 = np.r_[flux, fit.pixel_line[i] + 0.2, prior.mean + 0.05, 40.0]
        peer = least_squares(residuals, p0, x_scale=np.r_[flux, 1, 1, 0.3, 0.3, 0.3, 3.0])
        np.testing.assert_allclose(fit.pixel_line[i], peer.x[1:3], atol=2e-4)
        np.testing.assert_allclose(fit.flux_dn[i], peer.x[0], rtol=1e-3)


@pytest.mark.parametrize("offset", [(2.0, 2.0), (-2.0, 2.0), (2.0, -2.0), (-2.0, -2.0)])
def test_an_undersampled_star_is_found_from_two_pixels_off(render_stars, offset):
    # Two pixels from a star of 0.3 px the fit's gradient is zero: the search area must be looked through.
    image = render_stars((40, 40), [[20.3, 18.8]], 800.0, 0.3)
    fit = fit_gaussian(image, 1.0, None, np.add([[20.3, 18.8]], offset), ShapePrior.round_psf(0.3, 0.1, 0.1))
    np.testing.assert_allclose(fit.pixel_line, [[20.3, 18.8]], atol=0.01)
    assert fit.flags[0] == StarFlag.OK


def test_a_sloping_background_needs_the_plane(render_stars):
    line, pixel = np.indices((40, 40))
    image = render_stars((40, 40), [[20.3, 18.8]], 500.0, 1.0) + 30.0 + 2.0 * pixel - 1.0 * line
    prior = ShapePrior.round_psf(1.0, 0.1, 0.1)
    plane = fit_gaussian(image, 1.0, None, [[20.0, 19.0]], prior, background="plane")
    level = fit_gaussian(image, 1.0, None, [[20.0, 19.0]], prior)
    np.testing.assert_allclose(plane.pixel_line, [[20.3, 18.8]], atol=2e-3)
    np.testing.assert_allclose(plane.background_dn, 30.0 + 2.0 * 20.3 - 18.8, atol=0.1)
    assert np.abs(level.pixel_line - [[20.3, 18.8]]).max() > 0.05


def test_misfit_inflates_the_covariance_but_not_the_signal_to_noise_ratio(render_stars):
    # A wing that no Gaussian has: 20 % of the light in a halo.
    image = render_stars((60, 60), [[30.2, 29.6]], 8e4, 1.0) + render_stars(
        (60, 60), [[30.2, 29.6]], 2e4, 2.5
    )
    prior = ShapePrior.round_psf(1.0, 0.2, 0.1)
    raw = fit_gaussian(image, 3.0, None, [[30.0, 30.0]], prior, inflate_misfit=False)
    honest = fit_gaussian(image, 3.0, None, [[30.0, 30.0]], prior)
    np.testing.assert_allclose(honest.covariance_px2, raw.covariance_px2 * raw.chi2_reduced[0], rtol=1e-9)
    assert raw.chi2_reduced[0] > 10.0
    assert honest.snr[0] == raw.snr[0] > 1000.0


def test_psf_error_widens_the_covariance_as_simulated(render_stars, star_grid):
    # Each pixel of each star is off by 5 % of the star: what psf_error=0.05 stands for.
    rng = np.random.default_rng(77)
    centers, shape = star_grid(500, 20, rng)
    clean = render_stars(shape, centers, 2e4, 0.9)
    image = clean * (1.0 + 0.05 * rng.normal(size=shape)) + rng.normal(0.0, 1.0, shape)
    prior = ShapePrior.round_psf(0.9, 0.02, 0.02)
    fit = fit_gaussian(image, 1.0, None, centers, prior, psf_error=0.05, inflate_misfit=False)
    assert fit.psf_error == 0.05
    scatter = ((fit.pixel_line - centers) / fit.sigma_px).std(axis=0)
    assert np.all((scatter > 0.9) & (scatter < 1.1)), scatter


# ---------------------------------------------------------------- what flight data hold


def one_star(render_stars, sigma=1.0, flux=2000.0, center=(20.3, 18.8), shape=(40, 40), seed=3):
    rng = np.random.default_rng(seed)
    return render_stars(shape, [center], flux, sigma) + rng.normal(0.0, 1.0, shape)


def test_saturated_core_is_masked_and_flagged(render_stars):
    image = one_star(render_stars, flux=20000.0)
    saturated = image > 2000.0
    image[saturated] = 2000.0
    prior = ShapePrior.round_psf(1.0, 0.05, 0.05)
    masked = fit_gaussian(image, 1.0, None, [[20.0, 19.0]], prior, saturated=saturated)
    clipped = fit_gaussian(image, 1.0, None, [[20.0, 19.0]], prior)
    assert saturated.sum() >= 3
    assert masked.flags[0] == StarFlag.SATURATED
    error = np.abs(masked.pixel_line[0] - [20.3, 18.8]).max()
    assert error < 4.0 * masked.sigma_px.max()
    assert error < 0.3 * np.abs(clipped.pixel_line[0] - [20.3, 18.8]).max()


def test_bad_pixels_in_the_core_are_left_out_and_flagged(render_stars):
    image = one_star(render_stars)
    bad = np.zeros(image.shape, bool)
    image[19, 21], bad[19, 21] = 5000.0, True
    image[12, 25] = np.nan  # a not-finite pixel counts as bad, here outside the core
    fit = fit_gaussian(image, 1.0, bad, [[20.0, 19.0]], ShapePrior.round_psf(1.0, 0.1, 0.1))
    assert fit.flags[0] == StarFlag.BAD_PIXELS
    assert np.all(np.abs(fit.pixel_line[0] - [20.3, 18.8]) < 4.0 * fit.sigma_px[0])


def test_a_star_at_the_edge_is_fitted_with_what_there_is(render_stars):
    image = one_star(render_stars, center=(0.4, 18.8))
    fit = fit_gaussian(image, 1.0, None, [[1.0, 19.0]], ShapePrior.round_psf(1.0, 0.1, 0.1))
    assert fit.flags[0] == StarFlag.EDGE
    assert np.all(np.abs(fit.pixel_line[0] - [0.4, 18.8]) < 4.0 * fit.sigma_px[0])


@pytest.mark.slow
def test_empty_sky_has_low_snr(render_stars):
    image = np.random.default_rng(5).normal(0.0, 1.0, (200, 200))
    start = np.random.default_rng(6).uniform(20, 180, (100, 2))
    fit = fit_gaussian(image, 1.0, None, start, ShapePrior.round_psf(1.0, 0.1, 0.1))
    assert np.mean(fit.usable) < 0.05
    assert np.isfinite(fit.covariance_px2).all()


def test_a_star_beyond_the_search_area_stops_at_its_bound(render_stars):
    image = one_star(render_stars)
    fit = fit_gaussian(
        image, 1.0, None, [[17.5, 18.8]], ShapePrior.round_psf(1.0, 0.1, 0.1), search_radius_px=2.0
    )
    assert fit.flags[0] & StarFlag.AT_BOUND
    assert not fit.usable[0]
    np.testing.assert_allclose(fit.pixel_line[0, 0], 19.5, atol=1e-6)


def test_two_stars_in_one_image_are_flagged_as_blended(render_stars):
    image = render_stars((40, 60), [[20.3, 18.8], [23.0, 19.5], [45.0, 20.0]], 2000.0, 1.0)
    start = [[20.3, 18.8], [23.0, 19.5], [45.0, 20.0]]
    fit = fit_gaussian(image, 1.0, None, start, ShapePrior.round_psf(1.0, 0.1, 0.1), search_radius_px=1.0)
    assert [bool(f & StarFlag.BLENDED) for f in fit.flags] == [True, True, False]


def test_a_single_hot_pixel_is_a_cosmic_ray_where_the_psf_is_resolved():
    image = np.random.default_rng(2).normal(0.0, 1.0, (40, 40))
    image[20, 21] += 400.0
    fit = fit_gaussian(image, 1.0, None, [[20.5, 20.5]], ShapePrior.round_psf(1.2, 0.3, 0.2))
    assert fit.flags[0] & StarFlag.COSMIC_RAY
    sharp = fit_gaussian(image, 1.0, None, [[20.5, 20.5]], ShapePrior.round_psf(0.35, 0.3, 0.2))
    assert not sharp.flags[0] & StarFlag.COSMIC_RAY


def test_no_center_is_nan_only_with_its_flag(render_stars):
    image = one_star(render_stars)
    bad = np.zeros(image.shape, bool)
    bad[:, :10] = True
    start = [[-50.0, 10.0], [1e9, -1e9], [4.0, 20.0], [20.0, 19.0]]
    fit = fit_gaussian(image, 1.0, bad, start, ShapePrior.round_psf(1.0, 0.1, 0.1))
    lost = (fit.flags & StarFlag.NOT_FINITE) > 0
    assert lost.tolist() == [True, True, True, False]
    for name in ("pixel_line", "covariance_px2", "flux_dn", "flux_sigma_dn", "shape", "chi2_reduced", "snr"):
        finite = np.isfinite(getattr(fit, name)).reshape(4, -1).all(axis=1)
        assert finite.tolist() == [False, False, False, True], name
    assert "too few usable pixels" in describe_flags(int(fit.flags[0]))


def test_no_stars_give_an_empty_result():
    fit = fit_gaussian(np.zeros((20, 20)), 1.0, None, np.zeros((0, 2)), ShapePrior.round_psf(1.0))
    assert len(fit) == 0
    assert fit.covariance_px2.shape == (0, 2, 2)


def test_results_are_bit_identical_and_read_only(render_stars):
    image = one_star(render_stars)
    prior = ShapePrior.round_psf(1.0)
    first, second = (fit_gaussian(image, 1.0, None, [[20.0, 19.0]], prior) for _ in range(2))
    assert first.pixel_line.tobytes() == second.pixel_line.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        first.pixel_line[0, 0] = 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image_dn": np.zeros(5)}, "2-D"),
        ({"noise_dn": np.ones((3, 3))}, "noise_dn has shape"),
        ({"noise_dn": 0.0}, "no usable pixel"),
        ({"bad": np.ones((20, 20), bool)}, "no usable pixel"),
        ({"start_pixel_line": [[1.0, 2.0, 3.0]]}, "start_pixel_line"),
        ({"start_pixel_line": [[1.0, np.nan]]}, "row 0"),
        ({"box_px": 8}, "box_px"),
        ({"background": "cubic"}, "background"),
        ({"psf_error": -0.1}, "psf_error"),
    ],
)
def test_bad_input_is_refused_with_its_numbers(change, message):
    arguments = {
        "image_dn": np.zeros((20, 20)), "noise_dn": 1.0, "bad": None, "start_pixel_line": [[10.0, 10.0]],
        "prior": ShapePrior.round_psf(1.0),
    } | change  # fmt: skip
    with pytest.raises(CenterfindingError, match=message):
        fit_gaussian(**arguments)


def test_priors_shapes_and_noise_models_check_themselves():
    for make in (
        lambda: ShapePrior.round_psf(0.0),
        lambda: ShapePrior(0.0, 0.0, np.zeros(2), 0.1),
        lambda: ShapePrior(0.0, 0.1, np.array([0.8, 0.8]), 0.1),
        lambda: PsfShape(1.0, 2.0),
        lambda: NoiseModel(1.0, 0.0),
    ):
        with pytest.raises(CenterfindingError):
            make()
    shape = ShapePrior(np.log(0.9), 0.1, np.array([0.0, 0.3]), 0.1).shape
    np.testing.assert_allclose(shape.angle_rad, np.pi / 4)
    np.testing.assert_allclose(shape.parameters, [np.log(0.9), 0.0, 0.3], atol=1e-12)
