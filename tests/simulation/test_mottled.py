"""Mottled albedo maps: limits, an even spread, no seam, no crowding at the poles."""

import numpy as np
import pytest

from opnav_workbench.simulation.surfaces import mottled_map


@pytest.fixture(scope="module", params=range(4))
def albedo(request):
    return mottled_map(request.param, dark=0.2, bright=0.8, rows=90)


def test_values_keep_within_their_limits_and_use_them(albedo):
    area = np.cos(np.radians(89.0 - 2.0 * np.arange(90)))[:, None] * np.ones(180)
    assert albedo.min() >= 0.2
    assert albedo.max() <= 0.8
    order = np.argsort(albedo.ravel())
    share = np.cumsum(area.ravel()[order]) / area.sum()
    low, high = np.interp([0.1, 0.9], share, albedo.ravel()[order])
    # An even spread has 0.26 and 0.74 there; a map of few independent regions scatters about that.
    assert low == pytest.approx(0.26, abs=0.07)
    assert high == pytest.approx(0.74, abs=0.07)


def test_there_is_no_seam(albedo):
    """Across the date line neighbours differ as they do elsewhere, and around a pole the row is nearly even."""
    steps = np.abs(np.diff(albedo, axis=1))
    seam = np.abs(albedo[:, 0] - albedo[:, -1])
    assert seam.max() <= steps.max()
    assert np.ptp(albedo[0]) < 0.1  # 2 deg circle about the pole, far below the smallest patch


def test_the_seed_decides_everything():
    first, second, other = (mottled_map(seed, rows=20) for seed in (3, 3, 4))
    assert first.tobytes() == second.tobytes()
    assert np.abs(first - other).max() > 0.1


@pytest.mark.slow
def test_patches_are_as_large_as_asked():
    """Half-way decorrelation along the equator, against the Gaussian patches' own."""

    def halfway_deg(size):
        maps = [mottled_map(s, 0.0, 1.0, 400, size, size, rows=180)[89] - 0.5 for s in range(12)]
        spectrum = np.mean([np.abs(np.fft.rfft(row)) ** 2 for row in maps], axis=0)
        correlation = np.fft.irfft(spectrum)
        return np.argmax(correlation < 0.5 * correlation[0])

    # Two Gaussians of sigma s correlate as exp(-d^2 / 4 s^2): one half at 1.67 s.
    assert halfway_deg(6.0) == pytest.approx(10.0, abs=3.0)
    assert halfway_deg(12.0) == pytest.approx(20.0, abs=6.0)
