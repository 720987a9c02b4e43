"""Densities integrated over pixels by brute force: no code of the package under test."""

from collections.abc import Callable

import numpy as np
import pytest

NODES = 8  # Gauss-Legendre nodes per pixel and axis: exact to 1e-7 for Gaussian sigmas from 0.3 px


def quadrature(density, pixel, line, parts=1):
    """Integrate `density(x, y)` over unit pixels centered at `pixel`, `line` (m,), each cut in parts x parts."""
    t, w = np.polynomial.legendre.leggauss(NODES)
    start = (np.arange(parts) + 0.5) / parts - 0.5
    at = (start[:, None] + 0.5 * t / parts).ravel()
    weight = np.tile(0.5 * w / parts, parts)
    x = np.asarray(pixel, float)[:, None, None] + at[None, :, None]
    y = np.asarray(line, float)[:, None, None] + at[None, None, :]
    return np.sum(density(x, y) * np.outer(weight, weight), axis=(1, 2))


def gaussian(center, sigma_major, sigma_minor, angle):
    """Return the density of a unit elliptical Gaussian as a function of x, y."""

    def density(x, y):
        along = (x - center[0]) * np.cos(angle) + (y - center[1]) * np.sin(angle)
        across = -(x - center[0]) * np.sin(angle) + (y - center[1]) * np.cos(angle)
        power = -0.5 * (along / sigma_major) ** 2 - 0.5 * (across / sigma_minor) ** 2
        return np.exp(power) / (2.0 * np.pi * sigma_major * sigma_minor)

    return density


@pytest.fixture(scope="session")
def pixel_quadrature() -> Callable:
    return quadrature


@pytest.fixture(scope="session")
def gaussian_density() -> Callable:
    return gaussian
