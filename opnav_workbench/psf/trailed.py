"""A PSF smeared by motion during the exposure: the sum of displaced copies."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.constants import FWHM_PER_SIGMA
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.empirical import EmpiricalPsf
from opnav_workbench.psf.protocol import Psf, PsfGradient, cell_shift, checked_centers, covering_boxes

__all__ = ["TrailedPsf"]

CELLS_PER_FWHM = 12  # see `EmpiricalPsf`
MIN_CELLS = 4
COPIES_PER_SIGMA = 2.0  # copies half a sigma apart make a trail that is smooth to 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class TrailedPsf:
    """Copies of a PSF displaced from the point's nominal place, each with its share of the exposure.

    Attributes
    ----------
    psf
        Without motion.
    offsets_px : (k, 2) array
        Displacements (pixel, line). Half a sigma of the PSF apart, copies make a trail that is smooth to 1e-8.
    weights : (k,) array
        Their shares, not negative; normalised to a sum of 1.

    Raises
    ------
    CameraError
        No offsets, arrays that do not fit together or are not finite, a negative weight or none above zero.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> trail = TrailedPsf(GaussianPsf(0.8, 0.8), np.linspace([-3.0, 0.0], [3.0, 0.0], 16), np.ones(16))
    >>> trail.sigma_px.round(2)
    array([2.01, 0.8 ])
    """

    psf: Psf
    offsets_px: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        offsets, weights = (np.array(a, dtype=np.float64) for a in (self.offsets_px, self.weights))
        if (
            offsets.ndim != 2
            or offsets.shape[1] != 2
            or weights.shape != offsets.shape[:1]
            or not len(weights)
        ):
            raise CameraError(
                f"trailed PSF: offsets of shape {offsets.shape} with weights of {weights.shape}; give (k, 2) and (k,)."
            )
        if not np.isfinite(offsets).all() or not (weights >= 0.0).all() or not 0.0 < weights.sum() < np.inf:
            raise CameraError("trailed PSF: give finite offsets, and weights >= 0 of which one is positive.")
        object.__setattr__(self, "offsets_px", offsets)
        object.__setattr__(self, "weights", weights / weights.sum())
        freeze_arrays(self)

    @classmethod
    def straight(cls, psf: Psf, length_px: float, angle_rad: float) -> "TrailedPsf":
        """Return the trail of a steady motion, the point's nominal place in its middle.

        Parameters
        ----------
        psf
            Without motion.
        length_px
            Way of the point during the exposure.
        angle_rad
            Direction of the motion, from +pixel toward +line.

        Raises
        ------
        CameraError
            A length that is negative, or one of both not finite.
        """
        if not 0.0 <= length_px < np.inf or not np.isfinite(angle_rad):
            raise CameraError(
                f"trailed PSF: length {length_px} px, angle {angle_rad} rad; give a finite length >= 0."
            )
        count = 1 + int(np.ceil(COPIES_PER_SIGMA * length_px / float(psf.sigma_px.min())))
        # Middles of equal parts of the exposure: the second moment is that of the trail to 1 / count^2.
        along = length_px * ((np.arange(count) + 0.5) / count - 0.5)
        direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
        return cls(psf, along[:, None] * direction, np.ones(count))

    def tabulated(self) -> Psf:
        """Return the same as a table, good to some 1e-5 of the flux and many times faster in a fit.

        Itself where the PSF without motion is not the same everywhere.
        """
        if self.psf.at(np.zeros(2)) is not self.psf:
            return self
        fwhm_px = FWHM_PER_SIGMA * float(self.psf.sigma_px.min())
        cells = max(MIN_CELLS, int(np.ceil(CELLS_PER_FWHM / fwhm_px)))
        return EmpiricalPsf(self.kernel(cells), cells)

    @property
    def half_size_px(self) -> float:
        """Half the side of the square that holds all copies."""
        return self.psf.half_size_px + float(np.abs(self.offsets_px).max())

    @property
    def sigma_px(self) -> FloatArray:
        """Root of the second moments along pixel and line (2,), about the center of light."""
        mean = self.weights @ self.offsets_px
        spread = self.weights @ (self.offsets_px - mean) ** 2
        return readonly(np.sqrt(self.psf.sigma_px**2 + spread))

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the shares (n, size, size); see `Psf.box`. Each copy is computed in its own small box."""
        centers, start = checked_centers(center_px), np.asarray(first, dtype=np.int64)
        n = len(centers)
        boxes = np.zeros(n * size * size)
        base = np.arange(n)[:, None, None] * size * size
        for offset, weight in zip(self.offsets_px, self.weights, strict=True):
            corner, small = covering_boxes(self.psf, centers + offset)
            shares = self.psf.box(centers + offset, corner, small)
            pixel, line = (corner[:, a, None] - start[:, a, None] + np.arange(small) for a in (0, 1))
            seen = ((line >= 0) & (line < size))[:, :, None] & ((pixel >= 0) & (pixel < size))[:, None, :]
            place = base + line[:, :, None] * size + pixel[:, None, :]
            # A place occurs once in each copy, so plain indexed addition loses nothing.
            boxes[place[seen]] += weight * shares[seen]
        return boxes.reshape(n, size, size)

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares and their derivatives; see `Psf.gradient`."""
        centers = checked_centers(center_px)
        total = np.zeros((3, len(centers), size, size))
        for offset, weight in zip(self.offsets_px, self.weights, strict=True):
            copy = self.psf.gradient(centers + offset, first, size)
            for column, part in enumerate((copy.value, copy.d_pixel, copy.d_line)):
                total[column] += weight * part
        return PsfGradient(*total)

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares in cells of 1/subsample px, (k, k); see `Psf.kernel`."""
        shift = cell_shift(subsample, shift_px) + self.offsets_px * subsample
        whole = np.rint(shift).astype(np.int64)
        parts = [self.psf.kernel(subsample, rest / subsample) for rest in shift - whole]
        reach = int(np.abs(whole).max()) + max(len(part) // 2 for part in parts)
        total = np.zeros((2 * reach + 1, 2 * reach + 1))
        for (pixel, line), part, weight in zip(whole + reach, parts, self.weights, strict=True):
            half = len(part) // 2
            total[line - half : line + half + 1, pixel - half : pixel + half + 1] += weight * part
        return total

    def at(self, pixel_line: ArrayLike) -> "TrailedPsf":
        """Return the trail of the PSF at a place on the detector."""
        return TrailedPsf(self.psf.at(pixel_line), self.offsets_px, self.weights)
