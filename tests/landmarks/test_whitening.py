"""Errors with an autocorrelation of their own: their covariance, and its inverse on the pixels in use."""

import numpy as np
import pytest
from scipy import fft, ndimage

from opnav_workbench.landmarks.matching import LAGS
from opnav_workbench.landmarks.whitening import FEWEST_TOLD, Whitening, _scales

SIZE = 24


def correlated(rng, count, size=SIZE, sigma_px=1.0):
    """Return planes of unit variance whose neighbors are alike, with some noise of their own."""
    wide = ndimage.gaussian_filter(rng.normal(size=(count, 2 * size, 2 * size)), (0, sigma_px, sigma_px))
    planes = wide[:, size // 2 : size // 2 + size, size // 2 : size // 2 + size]
    return planes / planes.std() + 0.3 * rng.normal(size=(count, size, size))


def autocorrelation(planes):
    n = len(planes[0])
    padded = fft.rfft2(planes, (2 * n, 2 * n))
    products = fft.irfft2((np.abs(padded) ** 2).mean(axis=0))
    ones = fft.irfft2(np.abs(fft.rfft2(np.ones((n, n)), (2 * n, 2 * n))) ** 2)
    lags = np.arange(-LAGS, LAGS + 1)
    rho = products[np.ix_(lags, lags)] / ones[np.ix_(lags, lags)]
    return rho / rho[LAGS, LAGS]


@pytest.fixture(scope="module")
def white():
    return Whitening(autocorrelation(correlated(np.random.default_rng(3), 200)), SIZE)


def test_the_spread_of_a_pixel_is_the_autocorrelation(white):
    pixel = np.zeros((1, 1, SIZE, SIZE))
    pixel[0, 0, 12, 12] = 1.0
    spread = white.spread(pixel)[0, 0]
    assert spread[12, 12] == pytest.approx(1.0, abs=0.05)
    assert spread[12, 13] == pytest.approx(spread[13, 12], abs=0.05)
    assert 0.5 < spread[12, 13] < 0.9
    assert abs(spread[12, 20]) < 0.1


def test_the_inverse_holds_on_the_pixels_in_use(white):
    """Against the dense inverse, with a corner and some pixels left out."""
    rng = np.random.default_rng(4)
    used = rng.random((SIZE, SIZE)) > 0.05
    used[:6, :9] = False
    unit = np.eye(SIZE * SIZE).reshape(-1, 1, SIZE, SIZE)
    dense = white.spread(unit).reshape(SIZE * SIZE, -1)[np.ix_(used.ravel(), used.ravel())]
    np.testing.assert_allclose(dense, dense.T, atol=1e-9)
    plane = correlated(rng, 1)[0] * used
    exact = np.zeros((SIZE, SIZE))
    exact[used] = np.linalg.solve(dense, plane[used])
    solved = white.solved(plane[None, None], used[None])[0, 0]
    assert not solved[~used].any()
    assert np.linalg.norm(solved - exact) < 0.05 * np.linalg.norm(exact)


def test_weighed_by_it_a_gain_is_better_known(white):
    """What is hidden in correlated errors comes out nearer to the truth than by plain least squares, as near as it says."""
    rng = np.random.default_rng(5)
    used = np.ones((1, SIZE, SIZE), dtype=bool)
    fine = rng.normal(size=(SIZE, SIZE))
    weighed = white.solved(fine[None, None], used)[0, 0]
    errors = correlated(rng, 300)
    plain = errors.reshape(300, -1) @ fine.ravel() / np.sum(fine**2)
    by_weight = errors.reshape(300, -1) @ weighed.ravel() / np.sum(weighed * fine)
    assert by_weight.std() < 0.7 * plain.std()
    scale = errors.std()
    stated = scale / np.sqrt(np.sum(weighed * fine))
    assert by_weight.std() == pytest.approx(stated, rel=0.2)


# ---- What the halves of patches say of their covariances


@pytest.mark.parametrize("worth", [5.0, 12.0, np.inf])
def test_errors_over_sigmas_are_one_however_patches_differ(worth):
    """Patches whose errors are 2.5 times as large as stated in the mean, and more or less so each for itself."""
    rng = np.random.default_rng(6)
    variance = 2.5 * (np.ones(4000) if np.isinf(worth) else worth / rng.chisquare(worth, 4000))
    apart = [size * rng.chisquare(2.0, 2) for size in variance]
    scale = _scales(apart)
    error = np.sqrt(variance) * rng.normal(size=4000)
    assert np.sqrt(np.mean(error**2 / scale)) == pytest.approx(1.0, abs=0.06)
    worst = np.argsort([one.sum() for one in apart])[-400:]
    assert np.sqrt(np.mean(error[worst] ** 2 / scale[worst])) == pytest.approx(1.0, abs=0.15)
    # Where all patches are alike, what differs is chance.
    assert (np.std(scale) < 0.15) == np.isinf(worth)


def test_few_patches_or_none_with_halves_leave_covariances_nearly_as_they_are():
    assert _scales([np.zeros(0)] * 30) == pytest.approx(np.full(30, 8.0 / 6.0))
    few = _scales([np.array([2.0, 2.0])] * (FEWEST_TOLD - 1))
    assert few == pytest.approx(np.full(len(few), 1.2))
