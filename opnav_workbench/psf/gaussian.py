"""The elliptical Gaussian of the paper: two widths and an angle, normalised to one, integrated over pixels."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.integrals import box_integrals, box_values, covariance_from_shape, shape_from_ellipse
from opnav_workbench.psf.protocol import PsfGradient, cell_shift, checked_centers, require_positive

__all__ = ["REACH_SIGMAS", "GaussianPsf"]

REACH_SIGMAS = 5.6  # less than 5e-8 of the flux lies outside a square of this half-side


@dataclass(frozen=True, slots=True)
class GaussianPsf:
    """An elliptical Gaussian; shares are exact for axes along pixel and line, else good to 1e-9.

    Attributes
    ----------
    sigma_major_px, sigma_minor_px : float
        Standard deviations along both axes, before integration over pixels.
    angle_rad : float
        Of the major axis, from +pixel toward +line.

    Raises
    ------
    CameraError
        A width that is not positive, or an angle that is not finite.

    Examples
    --------
    >>> GaussianPsf(0.5, 0.5).box([[3.0, 4.0]], [[2, 3]], 3)[0].round(4)
    array([[0.0247, 0.1074, 0.0247],
           [0.1074, 0.4661, 0.1074],
           [0.0247, 0.1074, 0.0247]])
    """

    sigma_major_px: float
    sigma_minor_px: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        require_positive(
            "Gaussian PSF", sigma_major_px=self.sigma_major_px, sigma_minor_px=self.sigma_minor_px
        )
        if not np.isfinite(self.angle_rad):
            raise CameraError(f"Gaussian PSF: angle_rad is {self.angle_rad}; give a finite angle.")

    @property
    def shape(self) -> FloatArray:
        """Log scale, e1, e2 (3,): see `covariance_from_shape`."""
        return shape_from_ellipse(np.array([self.sigma_major_px, self.sigma_minor_px, self.angle_rad]))

    @property
    def half_size_px(self) -> float:
        """Half the side of the square that holds all but 5e-8 of the flux."""
        return REACH_SIGMAS * float(self.sigma_px.max())

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations along pixel and along line, (2,)."""
        return readonly(np.sqrt(covariance_from_shape(*self.shape)[[0, 2]]))

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the shares (n, size, size); see `Psf.box`."""
        centers = checked_centers(center_px)
        shape = np.broadcast_to(self._tidy_shape(), (len(centers), 3))
        return box_values(centers, shape, np.asarray(first, dtype=np.float64), size)

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares and their derivatives; see `Psf.gradient`."""
        centers = checked_centers(center_px)
        shape = np.broadcast_to(self._tidy_shape(), (len(centers), 3))
        boxes = box_integrals(centers, shape, np.asarray(first, dtype=np.float64), size)
        return PsfGradient(boxes.value, boxes.d_pixel, boxes.d_line)

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares in cells of 1/subsample px, (k, k); see `Psf.kernel`."""
        shift = cell_shift(subsample, shift_px)
        fine = replace(
            self,
            sigma_major_px=self.sigma_major_px * subsample,
            sigma_minor_px=self.sigma_minor_px * subsample,
        )
        reach = int(np.ceil(fine.half_size_px + np.abs(shift).max()))
        cells = fine.box(shift[None], np.full((1, 2), -reach), 2 * reach + 1)[0]
        return np.asarray(cells / cells.sum())

    def at(self, pixel_line: ArrayLike) -> "GaussianPsf":  # noqa: ARG002 - the protocol's signature
        """Return itself."""
        return self

    def _tidy_shape(self) -> FloatArray:
        """Return `shape` with the rounding of a quarter turn removed, so that it counts as axis-aligned."""
        log_scale, e1, e2 = self.shape
        return np.array([log_scale, e1, 0.0 if abs(e2) < 1e-15 else e2])
