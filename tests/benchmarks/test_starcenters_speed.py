"""Speed of the batched star fit as a ratio against one scipy fit per star and photutils, in the same run."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.special import erf

from opnav_workbench.psf import EmpiricalPsf, GaussianPsf
from opnav_workbench.stars import ShapePrior, detect, fit_gaussian, fit_psf

STARS = 1000
PEER_STARS = 10  # the loop is timed on these and scaled
PHOTUTILS_STARS = 50
SIGMA_PX = 1.2
BOX_PX = 13
NOISE_DN = 3.0
SPACING_PX = 24


def separable_star(x, y, flux, sigma_pixel, sigma_line, pixel, line):
    def part(center, sigma, at):
        edges = (np.append(at - 0.5, at[-1] + 0.5) - center) / (np.sqrt(2.0) * sigma)
        return 0.5 * np.diff(erf(edges))

    return flux * part(y, sigma_line, line)[:, None] * part(x, sigma_pixel, pixel)


@pytest.fixture(scope="module")
def field():
    rng = np.random.default_rng(1000)
    side = int(np.ceil(np.sqrt(STARS)))
    line, pixel = np.divmod(np.arange(STARS), side)
    centers = (np.column_stack([pixel, line]) + 0.5) * SPACING_PX + rng.uniform(-0.5, 0.5, (STARS, 2))
    image = rng.normal(0.0, NOISE_DN, (side * SPACING_PX, side * SPACING_PX))
    for x, y in centers:
        columns, rows = np.arange(int(x) - 8, int(x) + 9), np.arange(int(y) - 8, int(y) + 9)
        image[rows[:, None], columns] += separable_star(x, y, 2000.0, SIGMA_PX, SIGMA_PX, columns, rows)
    return image, centers


def naive_loop(image, starts):
    """One scipy least-squares fit per star: flux, center, two sigmas, level."""
    found = []
    for x, y in starts:
        columns = np.arange(BOX_PX) + round(x) - BOX_PX // 2
        rows = np.arange(BOX_PX) + round(y) - BOX_PX // 2
        data = image[rows[:, None], columns]

        def residuals(p, data=data, columns=columns, rows=rows):
            return (
                (data - separable_star(*p[1:3], p[0], p[3], p[4], columns, rows) - p[5]) / NOISE_DN
            ).ravel()

        fit = least_squares(
            residuals, [data.sum(), x, y, SIGMA_PX, SIGMA_PX, 0.0], x_scale=[1e3, 1, 1, 1, 1, 10]
        )
        found.append(fit.x[1:3])
    return np.array(found)


def photutils_fits(image, starts):
    """Peer: photutils' PSF photometry with its pixel-integrated Gaussian: flux and center, local background."""
    psf = pytest.importorskip("photutils.psf", reason="photutils is not installed")
    table = pytest.importorskip("astropy.table")
    photometry = psf.PSFPhotometry(
        psf.CircularGaussianPRF(fwhm=2.3548 * SIGMA_PX), (BOX_PX, BOX_PX), aperture_radius=4.0
    )
    guess = table.Table(
        {"x_init": starts[:, 0], "y_init": starts[:, 1], "flux_init": np.full(len(starts), 1500.0)}
    )
    found = photometry(image, error=np.full(image.shape, NOISE_DN), init_params=guess)
    return np.column_stack([found["x_fit"], found["y_fit"]])


@pytest.mark.slow(keep=["level"])
@pytest.mark.parametrize("background", ["level", "plane"])
def test_batched_fit_against_a_loop_of_scipy_fits(benchmark, fastest, field, background):
    image, centers = field
    start = centers + 0.3

    def batched():
        return fit_gaussian(
            image, NOISE_DN, None, start, ShapePrior.round_psf(SIGMA_PX), box_px=BOX_PX, background=background
        )

    (loop_s, peers), (batch_s, _) = fastest(lambda: naive_loop(image, start[:PEER_STARS]), batched)
    fit = benchmark(batched)
    benchmark.extra_info["times_faster_than_loop"] = loop_s / PEER_STARS * STARS / batch_s
    benchmark.extra_info["ms_per_1000_stars"] = 1e3 * batch_s
    # Both find the same stars: the comparison is between equals.
    np.testing.assert_allclose(fit.pixel_line[:PEER_STARS], peers, atol=0.05)
    assert fit.usable.mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gaussian", "empirical"])
def test_fit_of_a_given_psf_against_photutils(benchmark, fastest, field, kind):
    image, centers = field
    start, gaussian = centers + 0.3, GaussianPsf(SIGMA_PX, SIGMA_PX)
    psf = gaussian if kind == "gaussian" else EmpiricalPsf(gaussian.kernel(4), 4)

    def batched():
        return fit_psf(image, NOISE_DN, None, start, psf, box_px=BOX_PX)

    photutils_fits(image, start[:2])  # imports and first use are not its speed
    (peer_s, peers), (batch_s, _) = fastest(lambda: photutils_fits(image, start[:PHOTUTILS_STARS]), batched)
    fit = benchmark(batched)
    benchmark.extra_info["times_faster_than_photutils"] = peer_s / PHOTUTILS_STARS * STARS / batch_s
    benchmark.extra_info["ms_per_1000_stars"] = 1e3 * batch_s
    np.testing.assert_allclose(fit.pixel_line[:PHOTUTILS_STARS], peers, atol=0.05)
    assert fit.usable.mean() > 0.99


def test_detection_in_a_full_frame(benchmark):
    rng = np.random.default_rng(1024)
    image = rng.normal(0.0, NOISE_DN, (1024, 1024))
    rows, columns = rng.integers(10, 1014, (2, 200))
    image[rows, columns] += 200.0
    found = benchmark(lambda: detect(image, NOISE_DN, None, 0.7))
    assert len(found) >= 190


@pytest.mark.slow
@pytest.mark.parametrize("uneven", [0.0, 0.2])
def test_detection_costs_no_more_than_two_gaussian_filters(fastest, uneven):
    """It takes 0.7 of one, where the noise is uneven, too (2 to 3 before its sums were of shifted strips)."""
    image = np.random.default_rng(4096).normal(0.0, NOISE_DN, (2048, 2048))
    noise = NOISE_DN * (1.0 + uneven * np.sin(np.arange(2048) / 300.0)[:, None] * np.ones(2048))
    (blur_s, _), (ours_s, _) = fastest(
        lambda: gaussian_filter(image, 1.0),
        lambda: detect(image, noise, None, 1.0),
        enough=lambda blur_s, ours_s: ours_s <= 2.0 * blur_s,
    )
    assert ours_s <= 2.0 * blur_s
