"""Any PSF from its shares in fine cells: pixel shares by interpolation in a table, no flux lost; the Moffat is one.

Flow   shares in cells of 1/oversampling px -> B-spline coefficients d -> pixel shares at any phase
Units  px; offsets are pixel center minus point, (pixel, line)

The share of a pixel is the sum of its oversampling x oversampling cells, so the pixel share as a function of the
offset has the coefficients P = moving sum of d, and cubic B-splines interpolate it. Interpolation weights sum to 1,
and the P that lie a whole pixel apart sum to the sum of all cells whatever the phase: flux is conserved to rounding.
This is the effective PSF of Anderson & King (2000), doi:10.1086/316632. The Moffat profile, a core with the wings that
a Gaussian lacks, is laid into such a table.
"""

from dataclasses import dataclass, field
from itertools import product
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.ndimage import spline_filter

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, gauss_legendre, readonly
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.protocol import PsfGradient, cell_shift, checked_centers, require_positive

__all__ = ["MoffatPsf", "PixelTable", "TablePsf", "bspline_weights"]


# ---- Any PSF from its shares in fine cells: pixel shares by interpolation in a table, with no flux lost.

PADDING_CELLS = 4  # empty cells around, in which the spline filter rings off (factor 0.27 a cell)
CHUNK_PIXELS = 150_000  # pixels of boxes worked on at once: their arrays stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class PixelTable:
    """Pixel shares of a PSF for every offset, in a table of `oversampling` steps a pixel."""

    cell_coefficients: FloatArray  # (k, k) cubic B-spline coefficients of the shares in cells, sum 1
    pages: (
        FloatArray  # (oversampling, oversampling, m, m): coefficients of pixel shares by phase, then by pixel
    )
    oversampling: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def from_cells(cls, cells: FloatArray, oversampling: int) -> Self:
        """Build the table from shares (k, k), k odd, in cells about the point; they are normalised.

        Raises
        ------
        CameraError
            Not square with an odd side, not finite, or without positive sum; oversampling below 1.
        """
        shares = np.asarray(cells, dtype=np.float64)
        if shares.ndim != 2 or shares.shape[0] != shares.shape[1] or shares.shape[0] % 2 == 0:
            raise CameraError(f"PSF samples have shape {shares.shape}; give a square with an odd side.")
        if not np.isfinite(shares).all() or not shares.sum() > 0.0:
            raise CameraError(
                f"PSF samples sum to {float(shares.sum()):.3g}; give finite ones of positive sum."
            )
        if oversampling < 1:
            raise CameraError(f"PSF oversampling is {oversampling}; give a whole number of at least 1.")
        coefficients = spline_filter(np.pad(shares, PADDING_CELLS), order=3, mode="mirror")
        if shares.min() >= 0.0:
            coefficients = np.maximum(coefficients, 0.0)  # no light below zero where the cells end abruptly
        coefficients /= coefficients.sum()
        return cls(coefficients, _pages(coefficients, oversampling), oversampling)

    @property
    def half_size_px(self) -> float:
        """Half the side of the square outside which the table is empty."""
        return (len(self.cell_coefficients) / 2.0 + 2.0) / self.oversampling

    @property
    def sigma_px(self) -> FloatArray:
        """Root of the second moments along pixel and line (2,), about the center of light."""
        at = (np.arange(len(self.cell_coefficients)) - len(self.cell_coefficients) // 2) / self.oversampling
        # From coefficients to cells the B-spline's samples 1/6, 4/6, 1/6 add 1/3 cell^2; collecting the light in
        # cells had added 1/12.
        spread = (1.0 / 3.0 - 1.0 / 12.0) / self.oversampling**2
        profiles = self.cell_coefficients.sum(axis=0), self.cell_coefficients.sum(axis=1)
        variances = np.array([p @ at**2 - (p @ at) ** 2 + spread for p in profiles])
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    def box(self, center_px: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Return pixel shares (n, size, size); see `Psf.box`."""
        return np.asarray(self._boxes(center_px, first, size, derivatives=False)[0])

    def gradient(self, center_px: FloatArray, first: FloatArray, size: int) -> PsfGradient:
        """Return pixel shares and their derivatives: those of the interpolating splines; see `Psf.gradient`."""
        return PsfGradient(*self._boxes(center_px, first, size, derivatives=True))

    def _boxes(self, center_px: FloatArray, first: FloatArray, size: int, *, derivatives: bool) -> FloatArray:
        """Shares, and with `derivatives` those along pixel and line: (1 or 3, n, size, size)."""
        n_cell = len(self.cell_coefficients)
        origin_px = -(n_cell // 2 + (self.oversampling - 1) / 2.0) / self.oversampling
        at = (np.asarray(first, dtype=np.float64) - center_px - origin_px) * self.oversampling
        base = np.floor(at)
        weights = bspline_weights(at - base)
        products = weights[:, None, 1, :, None] * weights[:, None, 0, None, :]  # (n, 1, line tap, pixel tap)
        if derivatives:
            # The offset of a pixel falls as the center rises.
            slopes = -self.oversampling * bspline_slopes(at - base)
            along_pixel = weights[:, 1, :, None] * slopes[:, 0, None, :]
            along_line = slopes[:, 1, :, None] * weights[:, 0, None, :]
            products = np.stack([products[:, 0], along_pixel, along_line], axis=1)
        pages = sliding_window_view(
            np.pad(self.pages, ((0, 0), (0, 0), (size, size), (size, size))), (size, size), axis=(2, 3)
        )
        boxes = np.empty((products.shape[1], len(at), size, size))
        step = max(1, CHUNK_PIXELS // size**2)
        for start in range(0, len(at), step):
            part = slice(start, start + step)
            boxes[:, part] = self._interpolated(pages, base[part].astype(np.int64), products[part], size)
        return boxes

    def _interpolated(self, pages: FloatArray, base: IntArray, products: FloatArray, size: int) -> FloatArray:
        last = pages.shape[2] - 1
        total = np.zeros((products.shape[1], len(base), size, size))
        for line, pixel in product(range(4), range(4)):
            page, phase = np.divmod(base + np.array([pixel - 1, line - 1]), self.oversampling)
            page = np.clip(page + size, 0, last)
            share = pages[phase[:, 1], phase[:, 0], page[:, 1], page[:, 0]]
            for column, weight in enumerate(products[:, :, line, pixel].T):
                total[column] += share * weight[:, None, None]
        return total

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares in cells of 1/subsample px; see `Psf.kernel`.

        They are differences of the cumulative share at the edges of the cells, so they add up to pixel shares.
        """
        shift = cell_shift(subsample, shift_px)
        reach = int(np.ceil(self.half_size_px * subsample + np.abs(shift).max()))
        edges = np.arange(2 * reach + 2) - reach - 0.5
        along_pixel, along_line = (self._cumulative_weights((edges - s) / subsample) for s in shift)
        cumulative = np.cumsum(np.cumsum(self.cell_coefficients, axis=0), axis=1)
        cells = np.diff(np.diff(along_line @ cumulative @ along_pixel.T, axis=0), axis=1)
        return np.asarray(cells / cells.sum())

    def _cumulative_weights(self, edges_px: FloatArray) -> FloatArray:
        """Weights (n, k) that take cumulated coefficients to the cumulated share below each edge."""
        n_cell = len(self.cell_coefficients)
        at = edges_px * self.oversampling + n_cell // 2 - 0.5
        base = np.floor(at).astype(np.int64)
        spline = bspline_weights(at - base)
        weights = np.zeros((len(at), n_cell))
        row = np.arange(len(at))
        for tap in range(4):
            index = base + tap - 1
            known = index >= 0  # below the first cell the cumulated share is 0, above the last it stays
            np.add.at(weights, (row[known], np.minimum(index[known], n_cell - 1)), spline[known, tap])
        return weights


class TablePsf:
    """What every PSF that lies in a table does; see `opnav_workbench.psf.Psf`."""

    __slots__ = ()
    _table: PixelTable

    @property
    def half_size_px(self) -> float:
        """Half the side of the square outside which there is no light."""
        return self._table.half_size_px

    @property
    def sigma_px(self) -> FloatArray:
        """Root of the second moments along pixel and line (2,), about the center of light."""
        return readonly(self._table.sigma_px)

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the shares (n, size, size); see `Psf.box`."""
        return self._table.box(checked_centers(center_px), np.asarray(first, dtype=np.float64), size)

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares and their derivatives; see `Psf.gradient`."""
        return self._table.gradient(checked_centers(center_px), np.asarray(first, dtype=np.float64), size)

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares in cells of 1/subsample px, (k, k); see `Psf.kernel`."""
        return self._table.kernel(subsample, shift_px)

    def at(self, pixel_line: ArrayLike) -> Self:  # noqa: ARG002 - the protocol's signature
        """Return itself."""
        return self


def bspline_weights(fraction: FloatArray) -> FloatArray:
    """Return cubic B-spline weights (..., 4) of the nodes at -1, 0, 1, 2 for a fraction 0..1; they sum to 1."""
    t = np.asarray(fraction, dtype=np.float64)
    s = 1.0 - t
    inner, outer = 2.0 / 3.0 - 0.5 * t**2 * (2.0 - t), 2.0 / 3.0 - 0.5 * s**2 * (2.0 - s)
    return np.stack([s**3 / 6.0, inner, outer, t**3 / 6.0], axis=-1)


def bspline_slopes(fraction: FloatArray) -> FloatArray:
    """Return the derivatives (..., 4) of `bspline_weights` with respect to the fraction; they sum to 0.

    Examples
    --------
    >>> bspline_slopes(np.array(0.0))
    array([-0.5,  0. ,  0.5,  0. ])
    """
    t = np.asarray(fraction, dtype=np.float64)
    s = 1.0 - t
    return np.stack([-0.5 * s**2, 1.5 * t**2 - 2.0 * t, 2.0 * s - 1.5 * s**2, 0.5 * t**2], axis=-1)


def _pages(coefficients: FloatArray, oversampling: int) -> FloatArray:
    """Moving sums over a pixel's cells, sorted by phase: (oversampling, oversampling, m, m)."""
    reach = oversampling - 1
    padded = np.pad(coefficients, reach)
    n = len(coefficients) + reach  # a pixel whose first cell is the last of the table is the last one lit
    sums = _moving_sum(_moving_sum(padded, oversampling, 0), oversampling, 1)[:n, :n]
    m = -(-n // oversampling)
    sums = np.pad(sums, ((0, m * oversampling - n),) * 2)
    return np.ascontiguousarray(sums.reshape(m, oversampling, m, oversampling).transpose(1, 3, 0, 2))


def _moving_sum(values: FloatArray, length: int, axis: int) -> FloatArray:
    """Sum of each `length` consecutive values along `axis`."""
    windows = sliding_window_view(values, length, axis=axis)
    return np.asarray(windows.sum(axis=-1))


# ---- The Moffat profile: a core with the wings that a Gaussian lacks.

MOFFAT_CELLS_PER_FWHM = 20  # interpolation good to 1e-7 of the flux
MOFFAT_MIN_OVERSAMPLING = 4
MOFFAT_NODES_PER_CELL = 4  # Gauss-Legendre: exact to 1e-12 for cells of 1/20 of the width


@dataclass(frozen=True, slots=True)
class MoffatPsf(TablePsf):
    """A round Moffat profile, ``(1 + r^2 / a^2)^-beta``; shares are good to 1e-6 of the flux.

    Its wings never end. Where less than `cut_share` of the light is left outside, they are cut off (on a square
    about the point) and the rest is normalised to 1.

    Attributes
    ----------
    fwhm_px
        Full width at half maximum, before integration over pixels.
    beta
        Above 1; 2.5 to 5 for telescopes, a Gaussian as it grows.
    cut_share
        Share of the light beyond the cut.

    References
    ----------
    Moffat (1969), A&A 3, 455; Trujillo et al. (2001), doi 10.1046/j.1365-8711.2001.04937.x.

    Examples
    --------
    >>> psf = MoffatPsf(fwhm_px=2.0, beta=3.0)
    >>> psf.box([[5.0, 5.0]], [[4, 4]], 3)[0].round(3)
    array([[0.049, 0.081, 0.049],
           [0.081, 0.146, 0.081],
           [0.049, 0.081, 0.049]])
    """

    fwhm_px: float
    beta: float
    cut_share: float = 1e-3
    _table: PixelTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_positive("Moffat PSF", fwhm_px=self.fwhm_px, cut_share=self.cut_share)
        if not 1.0 < self.beta < np.inf or self.cut_share >= 1.0:
            raise CameraError(
                f"Moffat PSF: beta is {self.beta} and cut_share {self.cut_share}; give beta > 1 (else the light "
                "is infinite) and a share below 1."
            )
        per_px = max(MOFFAT_MIN_OVERSAMPLING, int(np.ceil(MOFFAT_CELLS_PER_FWHM / self.fwhm_px)))
        object.__setattr__(self, "_table", PixelTable.from_cells(self._cells(per_px), per_px))

    def _cells(self, per_px: int) -> FloatArray:
        """Shares in cells of 1/per_px px (not normalised), one quadrant computed and mirrored."""
        scale = self.fwhm_px / (2.0 * np.sqrt(2.0 ** (1.0 / self.beta) - 1.0)) * per_px
        reach = int(np.ceil(scale * np.sqrt(self.cut_share ** (-1.0 / (self.beta - 1.0)) - 1.0)))
        t, w = gauss_legendre(MOFFAT_NODES_PER_CELL)
        at2 = ((np.arange(reach + 1)[:, None] + 0.5 * t) / scale) ** 2
        quadrant = sum(
            a * b * (1.0 + at2[:, None, i] + at2[None, :, j]) ** -self.beta
            for i, a in enumerate(w)
            for j, b in enumerate(w)
        )
        half = np.concatenate([quadrant[:0:-1], quadrant])
        return np.asarray(np.concatenate([half[:, :0:-1], half], axis=1))
