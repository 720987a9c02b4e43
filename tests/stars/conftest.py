"""Star images for the tests, by brute force: no code of the package under test renders them."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf

sys.path.insert(0, str(Path(__file__).parent))  # the exams beside the tests

NODES = 8  # Gauss-Legendre nodes per pixel and axis: exact to 1e-7 for sigmas from 0.3 px
HALF = 14  # pixels rendered on each side of a star


def brute_force(center, flux, sigma_major, sigma_minor, angle, pixel, line):
    """Return the flux (m,) of one star in pixels centered at `pixel`, `line` (m,), by 2-D quadrature."""
    t, w = np.polynomial.legendre.leggauss(NODES)
    x = pixel[:, None, None] + 0.5 * t[None, :, None] - center[0]
    y = line[:, None, None] + 0.5 * t[None, None, :] - center[1]
    along = x * np.cos(angle) + y * np.sin(angle)
    across = -x * np.sin(angle) + y * np.cos(angle)
    density = np.exp(-0.5 * (along / sigma_major) ** 2 - 0.5 * (across / sigma_minor) ** 2)
    weights = np.outer(w, w) / 4.0
    return flux * np.sum(density * weights, axis=(1, 2)) / (2.0 * np.pi * sigma_major * sigma_minor)


def render(shape, centers, fluxes, majors, minors=None, angles=None):
    """Return an image (n_line, n_pixel) of stars without noise."""
    n_line, n_pixel = shape
    n = len(centers)
    majors = np.broadcast_to(majors, n)
    minors = majors if minors is None else np.broadcast_to(minors, n)
    angles = np.broadcast_to(0.0 if angles is None else angles, n)
    image = np.zeros(shape)
    for center, flux, a, b, angle in zip(
        centers, np.broadcast_to(fluxes, n), majors, minors, angles, strict=True
    ):
        half = min(HALF, int(np.ceil(6.0 * a + 1.0)))
        column, row = np.rint(center).astype(int)
        columns = np.arange(max(column - half, 0), min(column + half + 1, n_pixel))
        rows = np.arange(max(row - half, 0), min(row + half + 1, n_line))
        x, y = np.meshgrid(columns, rows)
        star = brute_force(center, flux, a, b, angle, x.ravel().astype(float), y.ravel().astype(float))
        image[rows[:, None], columns] += star.reshape(x.shape)
    return image


def grid_of_stars(n, spacing, rng, jitter=0.5):
    """Return (n, 2) positions on a grid of `spacing` px at random sub-pixel phase, and the image shape."""
    side = int(np.ceil(np.sqrt(n)))
    line, pixel = np.divmod(np.arange(n), side)
    nominal = (np.column_stack([pixel, line]) + 0.5) * spacing
    return nominal + rng.uniform(-jitter, jitter, (n, 2)), (side * spacing, side * spacing)


@pytest.fixture(scope="session")
def render_stars() -> Callable:
    return render


@pytest.fixture(scope="session")
def star_grid() -> Callable:
    return grid_of_stars


@pytest.fixture(scope="session")
def pixel_flux() -> Callable:
    return brute_force


def mosaic(n, spacing, make, rng):
    """Return an image of n stars, each in its own tile of `spacing` px, and their places at random phase.

    `make(center, pixel, line)` gives the light (k, spacing, spacing) of k stars whose centers (k, 2) and pixel
    centers (k, spacing) are relative to their tile.
    """
    side = int(np.ceil(np.sqrt(n)))
    tile_line, tile_pixel = np.divmod(np.arange(n), side)
    corner = np.column_stack([tile_pixel, tile_line]) * spacing
    center = spacing // 2 + rng.uniform(-0.5, 0.5, (n, 2))
    at = np.broadcast_to(np.arange(float(spacing)), (n, spacing))
    tiles = np.zeros((side * side, spacing, spacing))
    tiles[:n] = make(center, at, at)
    image = tiles.reshape(side, side, spacing, spacing).transpose(0, 2, 1, 3).reshape(side * spacing, -1)
    return image, corner + center


def round_gaussian(sigma):
    """Return a `make` for `mosaic`: round unit Gaussians integrated over pixels, exact products of error functions."""

    def part(center, at):
        upper, lower = ((at + step - center[:, None]) / (np.sqrt(2.0) * sigma) for step in (0.5, -0.5))
        return 0.5 * (erf(upper) - erf(lower))

    def make(center, pixel, line):
        return part(center[:, 1], line)[:, :, None] * part(center[:, 0], pixel)[:, None, :]

    return make


@pytest.fixture(scope="session")
def star_mosaic() -> Callable:
    return mosaic


@pytest.fixture(scope="session")
def unit_gaussian() -> Callable:
    return round_gaussian
