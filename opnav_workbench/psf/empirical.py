"""A PSF given as an oversampled template, and its extraction from many stars, each of another sub-pixel phase.

Flow   boxes around the stars -> sparse least squares for the cells -> outliers left out, and again
Units  cells of 1/oversampling px

The model of a pixel is linear in the cells: its share is the sum over the cells that it covers, interpolated as
`PixelTable` does. What single pixels cannot tell (structure that repeats every pixel has no pixel share, and an empty
phase no data) is decided by a weak demand for smoothness. Idea: Anderson & King (2000), doi:10.1086/316632.
"""

from dataclasses import dataclass, field
from os import PathLike
from typing import Self

import numpy as np
import scipy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, readonly
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.errors import CameraError
from opnav_workbench.files import atomic_path
from opnav_workbench.npz_file import read_npz
from opnav_workbench.psf.protocol import Psf
from opnav_workbench.psf.tabulated import PixelTable, TablePsf, bspline_weights

__all__ = ["EmpiricalPsf", "cells_from_stars"]


# ---- An oversampled PSF from many stars, each of which samples it at another sub-pixel phase.

SMOOTHNESS = (
    1e-4  # weight of the cells' second differences against that of the pixels: decides ties, bends nothing
)
PASSES = 3
OUTLIER_SIGMAS = 6.0  # a neighbor star or a cosmic ray; a 6-sigma pixel by chance is one in 10^9
MODEL_ERROR = 0.05  # of a pixel's light: shot noise, errors of the center and of the cells themselves


def cells_from_stars(
    image: ArrayLike,
    bad: ArrayLike | None,
    centers: ArrayLike,
    fluxes: ArrayLike,
    oversampling: int,
    *,
    half_size_px: float = 6.0,
    base: Psf | None = None,
    smoothness: float = SMOOTHNESS,
    weights: ArrayLike | None = None,
) -> FloatArray:
    """Return the light (k, k) of a unit star in cells of 1/oversampling px, k odd; its sum is near 1.

    Parameters
    ----------
    image : (n_line, n_pixel) array_like
        With its background removed.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    centers : (n, 2) array_like
        Stars, (pixel, line).
    fluxes : (n,) array_like
        Their fluxes.
    oversampling
        Cells a pixel.
    half_size_px
        Half the side of the square of cells.
    base
        What the PSF nearly is. Smoothness is then demanded of the difference from it, and cells that no pixel tells
        of take its light.
    smoothness
        Weight of the cells' second differences against that of the pixels; the default decides ties only, noisy or few
        stars ask for more.
    weights : (n,) array_like, optional
        Of the stars' pixels, by default equal: bright stars then count by their flux, without limit.

    Raises
    ------
    CameraError
        Fewer usable pixels than cells, or arrays that do not fit together.
    """
    pixels, usable, stars, flux, weight = _checked_stars(image, bad, centers, fluxes, weights)
    half = int(np.ceil(half_size_px * oversampling))
    design, data, known, star = _cell_design(pixels, usable, stars, flux, oversampling, half, base)
    n_cell = 2 * half + 1
    if len(data) < n_cell**2:
        raise CameraError(
            f"{len(data)} usable pixels around {len(stars)} stars cannot determine {n_cell**2} cells of a PSF; "
            "give more stars, less oversampling or a smaller half_size_px."
        )
    keep = np.ones(len(data), dtype=bool)
    for _ in range(PASSES):
        heavy = weight[star[keep]]
        rows = scipy.sparse.csr_matrix(scipy.sparse.diags(heavy) @ design[keep])
        coefficients = _solve_cells(rows, heavy * (data - known)[keep], n_cell, smoothness)
        model = known + design @ coefficients
        residual = np.abs(data - model)
        sigma = MAD_TO_SIGMA * float(np.median(residual[keep]))
        keep = residual <= OUTLIER_SIGMAS * np.hypot(sigma, MODEL_ERROR * model)
    cells = _spline_values(coefficients.reshape(n_cell, n_cell))
    return cells if base is None else cells + _cells_of_base(base, oversampling, half)


def _cells_of_base(base: Psf, oversampling: int, half: int) -> FloatArray:
    """The base in the same cells, cut or padded to their square."""
    kernel = base.kernel(oversampling)
    middle = len(kernel) // 2
    kernel = np.pad(kernel, max(half - middle, 0))
    middle = len(kernel) // 2
    return np.asarray(kernel[middle - half : middle + half + 1, middle - half : middle + half + 1])


def _checked_stars(
    image: ArrayLike,
    bad: ArrayLike | None,
    centers: ArrayLike,
    fluxes: ArrayLike,
    weights: ArrayLike | None,
) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray, FloatArray]:
    pixels = np.asarray(image, dtype=np.float64)
    stars, flux = np.asarray(centers, dtype=np.float64), np.asarray(fluxes, dtype=np.float64)
    masked = np.zeros(pixels.shape, dtype=bool) if bad is None else np.asarray(bad, dtype=bool)
    if pixels.ndim != 2 or masked.shape != pixels.shape:
        raise CameraError(f"PSF from an image of shape {pixels.shape} with a mask of {masked.shape}.")
    if stars.ndim != 2 or stars.shape[1] != 2 or flux.shape != stars.shape[:1]:
        raise CameraError(f"PSF from {stars.shape} centers and {flux.shape} fluxes; give (n, 2) and (n,).")
    good = np.isfinite(stars).all(axis=1) & np.isfinite(flux) & (flux > 0.0)
    weight = np.ones(len(flux)) if weights is None else np.asarray(weights, dtype=np.float64)
    return pixels, np.isfinite(pixels) & ~masked, stars[good], flux[good], weight[good]


def _cell_design(
    pixels: FloatArray,
    usable: BoolArray,
    stars: FloatArray,
    flux: FloatArray,
    oversampling: int,
    half: int,
    base: Psf | None,
) -> tuple["scipy.sparse.csr_matrix", FloatArray, FloatArray, IntArray]:
    """Rows: usable pixels near stars; columns: coefficients of the cells; data, the base's light, and whose pixel."""
    reach = int(np.floor(half / oversampling))
    step = np.arange(-reach, reach + 1)
    index = np.rint(stars).astype(np.int64)[:, :, None] + step  # (n, 2, side)
    columns, weights = zip(*(_axis_weights(index[:, a] - stars[:, a, None], oversampling, half) for a in (0, 1)),
                           strict=True)  # fmt: skip
    line, pixel = np.broadcast_arrays(index[:, 1, :, None], index[:, 0, None, :])
    inside = (line >= 0) & (line < pixels.shape[0]) & (pixel >= 0) & (pixel < pixels.shape[1])
    inside[inside] = usable[line[inside], pixel[inside]]
    star, row, column = np.nonzero(inside)
    weight = weights[1][star, row, :, None] * weights[0][star, column, None, :] * flux[star, None, None]
    place = columns[1][star, row, :, None] * (2 * half + 1) + columns[0][star, column, None, :]
    starts = np.arange(len(star) + 1) * weight[0].size if len(star) else np.zeros(1, dtype=np.int64)
    matrix = scipy.sparse.csr_matrix(
        (weight.ravel(), place.ravel(), starts), shape=(len(star), (2 * half + 1) ** 2)
    )
    light = np.zeros(len(star))
    if base is not None and len(stars):
        light = flux[star] * base.box(stars, index[:, :, 0], len(step))[star, row, column]
    return matrix, pixels[line[inside], pixel[inside]], light, star


def _axis_weights(offset_px: FloatArray, oversampling: int, half: int) -> tuple[IntArray, FloatArray]:
    """Cells (..., oversampling + 3) under a pixel at `offset_px` (...) from the star, and their weights."""
    at = offset_px * oversampling + half - (oversampling - 1) / 2.0
    base = np.floor(at).astype(np.int64)
    spline = bspline_weights(at - base)
    weights = np.zeros((*at.shape, oversampling + 3))
    for cell in range(oversampling):
        weights[..., cell : cell + 4] += spline
    columns = base[..., None] - 1 + np.arange(oversampling + 3)
    known = (columns >= 0) & (columns <= 2 * half)
    return np.clip(columns, 0, 2 * half), np.where(known, weights, 0.0)


def _solve_cells(
    design: "scipy.sparse.csr_matrix", data: FloatArray, n_cell: int, smoothness: float
) -> FloatArray:
    """Least squares with a weak demand for smoothness; the normal matrix is banded, as cells see near ones only."""
    normal = (design.T @ design).tocsc()
    difference = scipy.sparse.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(n_cell, n_cell))
    rough = scipy.sparse.kronsum(difference, difference)
    strength = smoothness * float(normal.diagonal().mean())
    lower = scipy.sparse.tril(normal + strength * (rough.T @ rough), format="coo")
    band = np.zeros((int((lower.row - lower.col).max()) + 1, n_cell**2))
    band[lower.row - lower.col, lower.col] = lower.data
    return np.asarray(scipy.linalg.solveh_banded(band, design.T @ data, lower=True))


def _spline_values(coefficients: FloatArray) -> FloatArray:
    """Return the values at the cells of a cubic B-spline with these coefficients."""
    taps = np.array([1.0, 4.0, 1.0]) / 6.0
    padded = np.pad(coefficients, 1)
    along = sum(w * padded[:, i : i + coefficients.shape[1]] for i, w in enumerate(taps))
    return np.asarray(sum(w * along[i : i + coefficients.shape[0]] for i, w in enumerate(taps)))


# ---- A PSF given as an oversampled template, such as one extracted from bright stars.

SUM_ROUNDING = 1e-12  # of thousands of samples


@dataclass(frozen=True, slots=True, eq=False)
class EmpiricalPsf(TablePsf):
    """A template of the light itself, before integration over pixels; pixel shares are its own cells summed.

    Attributes
    ----------
    samples : (k, k) array
        Light in square cells of 1/oversampling px, [line, pixel], k odd, the point at the middle of the middle
        cell. Their sum is normalised to 1.
    oversampling
        Cells a pixel. Four cells to the full width at half maximum keep shares good to 4e-4, nine to 2e-5.

    Raises
    ------
    CameraError
        Samples that are not square with an odd side, not finite, or without positive sum.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> psf = EmpiricalPsf(GaussianPsf(0.9, 0.7).kernel(8), 8)
    >>> difference = psf.box([[4.3, 4.6]], [[0, 0]], 9) - GaussianPsf(0.9, 0.7).box([[4.3, 4.6]], [[0, 0]], 9)
    >>> bool(abs(difference).max() < 2e-5)
    True
    """

    samples: FloatArray
    oversampling: int
    _table: PixelTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = PixelTable.from_cells(self.samples, self.oversampling)
        samples = np.array(self.samples, dtype=np.float64)
        total = samples.sum()
        if abs(total - 1.0) > SUM_ROUNDING:  # a template that was saved comes back with the same bits
            samples = samples / total
        object.__setattr__(self, "samples", readonly(samples))
        object.__setattr__(self, "_table", table)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a template that `save` wrote.

        Raises
        ------
        CameraError
            The file cannot be read or holds no template.
        """
        try:
            file = read_npz(path, {"samples", "oversampling"})
            return cls(file["samples"], int(file["oversampling"]))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CameraError(
                f"PSF template {path} cannot be read: {error}; give an npz file with samples and oversampling."
            ) from error

    def save(self, path: str | PathLike[str]) -> None:
        """Write the template as an npz file with the arrays ``samples`` and ``oversampling``."""
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, samples=self.samples, oversampling=self.oversampling)
