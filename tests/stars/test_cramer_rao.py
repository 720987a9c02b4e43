"""The Cramer-Rao bound against brute force, a published closed form, and the exact statistics of a pixel."""

import numpy as np
import pytest
from scipy.stats import norm, poisson

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, MoffatPsf
from opnav_workbench.stars import NoiseModel, ShapePrior, cramer_rao, flux_at_snr
from opnav_workbench.stars.center_bounds import _information_of_pixels

NOISE_DN = 3.0
MODEL = NoiseModel(NOISE_DN, 15.0)


@pytest.mark.parametrize("background", ["level", "plane"])
def test_agrees_with_differences_of_a_brute_force_model(pixel_flux, background):
    center, flux, box = np.array([20.3, 18.8]), 900.0, 9
    prior = ShapePrior(np.log(1.0), 0.1, np.array([0.2, 0.1]), 0.05)
    line, pixel = np.indices((box, box)).reshape(2, -1) + np.array([[15], [16]])

    def model(p):
        e = np.hypot(p[4], p[5])
        a, b = np.exp(p[3]) * np.sqrt(1 + e), np.exp(p[3]) * np.sqrt(1 - e)
        star = pixel_flux(p[1:3], p[0], a, b, 0.5 * np.arctan2(p[5], p[4]), pixel, line)
        return star, star + p[6] + p[7] * (pixel - 20) + p[8] * (line - 19)

    p0 = np.array([flux, *center, *prior.mean, 0.0, 0.0, 0.0])
    steps = np.array([0.1, *np.full(5, 1e-4), 0.01, 0.01, 0.01])
    jacobian = np.array([(model(p0 + d)[1] - model(p0 - d)[1]) / (2 * d.sum()) for d in np.diag(steps)])
    jacobian = jacobian[: 9 if background == "plane" else 7]
    read = (NOISE_DN * 15.0) ** 2
    variance = read + 15.0 * model(p0)[0]
    information = jacobian * 15.0**2 * (1 / variance + 0.5 * (read / variance**2) ** 2) @ jacobian.T
    information[[3, 4, 5], [3, 4, 5]] += prior.information
    bound = cramer_rao(
        center[None], flux, prior, NOISE_DN, box_px=box, noise_model=MODEL, background=background
    )
    expected = np.linalg.inv(information)
    scale = np.sqrt(np.diag(expected))
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(bound.covariance[0] / unit, expected / unit, atol=1e-4)


@pytest.mark.parametrize(("sigma", "electrons"), [(0.75, 1e4), (0.75, 1e3), (1.0, 1e3), (2.0, 1e4)])
def test_agrees_with_the_closed_form_for_a_gaussian(sigma, electrons):
    # Mortensen et al. (2010), doi:10.1038/nmeth.1447, with the pixels' own width in s; good to 2 % from 0.75 px.
    noise_e = 24.2
    phases = np.random.default_rng(1).uniform(-0.5, 0.5, (200, 2))
    bound = cramer_rao(
        phases, electrons, GaussianPsf(sigma, sigma), noise_e, box_px=2 * int(6 * sigma) + 3,
        noise_model=NoiseModel(noise_e, 1.0), background="none",
    )  # fmt: skip
    s2 = sigma**2 + 1 / 12
    tau = 2 * np.pi * s2 * noise_e**2 / electrons
    expected = np.sqrt(s2 / electrons * (1 + 4 * tau + np.sqrt(2 * tau / (1 + 4 * tau))))
    np.testing.assert_allclose(np.sqrt(np.mean(bound.sigma_px**2)), expected, rtol=0.02)


@pytest.mark.slow(keep=["0.5-3.0", "0.5-10.0", "20.0-10.0"])
@pytest.mark.parametrize("read_e", [3.0, 10.0])
@pytest.mark.parametrize("light_e", [0.5, 20.0, 300.0])
def test_information_of_a_pixel_is_that_of_its_exact_distribution(read_e, light_e):
    # Poisson counts plus Gaussian noise: the density is a sum over counts, differentiated exactly.
    counts = np.arange(int(light_e + 12 * np.sqrt(light_e) + 20))
    z = np.linspace(-8 * read_e, counts[-1] + 8 * read_e, 20001)
    kernel = norm.pdf(z[:, None], counts, read_e)
    density = kernel @ poisson.pmf(counts, light_e)
    slope = kernel @ (poisson.pmf(counts - 1, light_e) - poisson.pmf(counts, light_e))
    exact = np.trapezoid(np.where(density > 1e-300, slope**2 / np.maximum(density, 1e-300), 0.0), z)
    ours = _information_of_pixels(np.array([light_e]), read_e, NoiseModel(read_e, 1.0))[0]
    np.testing.assert_allclose(ours, exact, rtol=2e-3 if read_e == 10.0 else 0.02)
    assert ours > 1.0 / (light_e + read_e**2)  # what the mean alone tells is less


def test_more_that_is_free_costs_accuracy_and_a_prior_gives_it_back():
    phase, common = [[0.2, -0.3]], {"box_px": 9, "noise_model": MODEL}
    known = cramer_rao(phase, 500.0, GaussianPsf(0.7, 0.7), NOISE_DN, **common)
    free = cramer_rao(phase, 500.0, ShapePrior.round_psf(0.7, 100.0, 100.0), NOISE_DN, **common)
    tight = cramer_rao(phase, 500.0, ShapePrior.round_psf(0.7, 1e-4, 1e-4), NOISE_DN, **common)
    fixed = cramer_rao(phase, 500.0, GaussianPsf(0.7, 0.7), NOISE_DN, background="none", **common)
    assert np.all(free.sigma_px > known.sigma_px)
    assert free.snr < known.snr < fixed.snr
    np.testing.assert_allclose(tight.sigma_px, known.sigma_px, rtol=1e-6)


def test_any_psf_has_a_bound():
    gaussian = GaussianPsf(0.9, 0.7, 0.4)
    exact = cramer_rao([[0.1, 0.2]], 500.0, gaussian, NOISE_DN, box_px=11)
    table = cramer_rao([[0.1, 0.2]], 500.0, EmpiricalPsf(gaussian.kernel(8), 8), NOISE_DN, box_px=11)
    np.testing.assert_allclose(table.sigma_px, exact.sigma_px, rtol=2e-3)
    np.testing.assert_allclose(table.snr, exact.snr, rtol=2e-3)


def test_flux_at_snr_inverts_the_bound():
    psf = MoffatPsf(2.0, 3.0)
    flux = flux_at_snr(6.0, psf, NOISE_DN, box_px=13, noise_model=MODEL)
    phases = np.random.default_rng(2).uniform(-0.5, 0.5, (2000, 2))
    bound = cramer_rao(phases, flux, psf, NOISE_DN, box_px=13, noise_model=MODEL)
    np.testing.assert_allclose(bound.snr.mean(), 6.0, rtol=2e-3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda psf: cramer_rao([[0, 0]], 1.0, psf, 0.0, box_px=9), "noise_dn"),
        (lambda psf: cramer_rao([[0, 0]], 1.0, psf, 1.0, box_px=8), "box_px"),
        (lambda psf: cramer_rao([[0, 0, 0]], 1.0, psf, 1.0, box_px=9), "center_px"),
        (lambda psf: flux_at_snr(0.0, psf, 1.0, box_px=9), "snr"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(CenterfindingError, match=message):
        call(GaussianPsf(1.0, 1.0))
