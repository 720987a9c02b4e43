"""Saturated stars are measured by what is not saturated, to what it can tell; hot pixels are no stars.

Images are summed over 11 x 11 points of each pixel, with profiles that the fit does not have.
"""

import numpy as np
import pytest

from opnav_workbench.simulation.charge import bloom
from opnav_workbench.stars import NoiseModel, ShapePrior, fit_wings

SIZE, FINE, FULL_DN, GAIN, READ_DN, SKY_DN = 41, 11, 3000.0, 8.0, 2.0, 10.0


def _shares(place, sigma, halo):
    """Light of a Gaussian with a halo that falls with the third power, in each pixel."""
    grid = (np.arange(SIZE * FINE) + 0.5) / FINE - 0.5
    r2 = (grid - place[0]) ** 2 + (grid[:, None] - place[1]) ** 2
    core = np.exp(-0.5 * r2 / sigma**2) / (2.0 * np.pi * sigma**2)
    wide = 0.5 / (np.pi * (2.0 * sigma) ** 2) * (1.0 + r2 / (2.0 * sigma) ** 2) ** -1.5
    light = (1.0 - halo) * core + halo * wide
    return light.reshape(SIZE, FINE, SIZE, FINE).sum(axis=(1, 3)) / FINE**2


def _picture(rng, place, sigma, halo, over, bleeding):
    middle = np.full(2, SIZE // 2)
    flux = over * FULL_DN / _shares(middle, sigma, halo).max()
    charge = rng.poisson(GAIN * (flux * _shares(place, sigma, halo) + SKY_DN)).astype(float)
    charge = bloom(charge, 1.1 * GAIN * FULL_DN) if bleeding else charge
    image = charge / GAIN - SKY_DN + rng.normal(0.0, READ_DN, charge.shape)
    return np.minimum(image, FULL_DN), image >= FULL_DN


@pytest.mark.parametrize(
    ("sigma", "halo", "over", "bleeding", "most_px"),
    [(0.5, 0.1, 8.0, False, 0.06), (0.8, 0.1, 50.0, True, 0.04)],
)
def test_a_saturated_star_is_found_by_its_flanks_to_its_sigma(sigma, halo, over, bleeding, most_px):
    rng = np.random.default_rng(4)
    noise = np.hypot(READ_DN, np.sqrt(SKY_DN / GAIN))
    errors, sigmas = [], []
    for _ in range(5):
        place = SIZE // 2 + rng.uniform(-0.5, 0.5, 2)
        image, saturated = _picture(rng, place, sigma, halo, over, bleeding)
        found = fit_wings(
            image, noise, None, saturated, [place + rng.normal(0.0, 0.7, 2)],
            ShapePrior.round_psf(sigma * 1.1), noise_model=NoiseModel(READ_DN, GAIN),
        )  # fmt: skip
        assert saturated.any()
        assert found.measured.all()
        errors.append(found.pixel_line[0] - place)
        sigmas.append(np.sqrt(np.diag(found.covariance_px2[0])))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms < most_px)
    assert np.sqrt(np.mean((np.array(errors) / sigmas) ** 2)) < 1.5


def test_neither_a_hot_pixel_nor_a_filled_column_is_a_star():
    rng = np.random.default_rng(5)
    image = rng.normal(0.0, READ_DN, (SIZE, SIZE))
    image[20, 20] = image[5:15, 33] = FULL_DN
    found = fit_wings(
        image,
        READ_DN,
        None,
        image >= FULL_DN,
        [[20.3, 19.8], [33.0, 10.0], [8.0, 30.0]],
        ShapePrior.round_psf(0.8),
    )
    assert not found.measured.any()


@pytest.mark.parametrize("radius_px", [8.0, 100.0])
def test_the_rim_of_a_body_is_no_star(radius_px):
    """A core that curves about its own middle has no light there."""
    line, pixel = np.mgrid[:301, :301]
    away = np.abs(np.hypot(pixel - 150.0, line - 150.0) - radius_px)
    image = np.where(away < 0.03 * radius_px + 0.5, FULL_DN, 0.0)
    place = [150.0 + radius_px, 150.0]
    found = fit_wings(image, READ_DN, None, image >= FULL_DN, [place], ShapePrior.round_psf(0.8))
    assert not found.measured.any()
