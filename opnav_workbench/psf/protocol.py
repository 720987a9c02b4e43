"""What every point spread function can do, and pictures of many points drawn with one.

Shares are of a source of unit flux; boxes are square, indexed [point, line, pixel], and hold all light of their point.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CameraError

__all__ = [
    "Psf",
    "PsfGradient",
    "add_boxes",
    "add_sources",
    "cell_shift",
    "checked_centers",
    "covering_boxes",
    "require_positive",
]


# ---- What every point spread function can do.


@dataclass(frozen=True, slots=True, eq=False)
class PsfGradient:
    """Pixel-integrated shares in boxes and how they change with the point's place; all (n, size, size)."""

    value: FloatArray
    d_pixel: FloatArray  # px^-1, with respect to the point's center
    d_line: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@runtime_checkable
class Psf(Protocol):
    """How the light of a point spreads over pixels; every share is of a source of unit flux.

    A PSF has no light outside the square of `half_size_px` about its center, or less than 1e-7 of it, so the
    boxes of `covering_boxes` sum to 1 for any sub-pixel phase.
    """

    @property
    def half_size_px(self) -> float:
        """Half the side of the square about the center that holds all light."""
        ...

    @property
    def sigma_px(self) -> FloatArray:
        """Root of the second moment along pixel and along line (2,), before integration over pixels."""
        ...

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the pixel-integrated shares of n points in square boxes.

        Parameters
        ----------
        center_px : (n, 2) array_like
            Where the points fall, (pixel, line).
        first : (n, 2) array_like of int
            (pixel, line) of the first pixel of each box.
        size
            Pixels along a side.

        Returns
        -------
        (n, size, size) array
            Indexed [point, line, pixel].
        """
        ...

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares of `box` and their derivatives with respect to the centers, analytic."""
        ...

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares (k, k), k odd, in cells of 1/subsample px.

        They sum to 1. A picture sampled at `subsample` cells a pixel, convolved with the kernel and summed
        over each pixel's cells, is the picture that `box` gives for points at the middles of the cells, or
        displaced from there by `shift_px` (pixel, line).
        """
        ...

    def at(self, pixel_line: ArrayLike) -> "Psf":
        """Return the PSF at a place (2,) on the detector; itself where it is the same everywhere."""
        ...


def covering_boxes(psf: Psf, center_px: ArrayLike) -> tuple[IntArray, int]:
    """Return first pixels (n, 2) and the side of the boxes that hold all light of points (n, 2) px.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> psf = GaussianPsf(0.7, 0.5, 0.3)
    >>> first, size = covering_boxes(psf, [[12.4, 7.9]])
    >>> round(float(psf.box([[12.4, 7.9]], first, size).sum()), 7)
    1.0
    """
    reach = int(np.ceil(psf.half_size_px))
    first = np.rint(checked_centers(center_px)).astype(np.int64) - reach
    return first, 2 * reach + 1


def checked_centers(center_px: ArrayLike) -> FloatArray:
    """Return points (n, 2) as floats.

    Raises
    ------
    CameraError
        Another shape, or a value that is not finite.
    """
    centers = np.asarray(center_px, dtype=np.float64)
    if centers.ndim != 2 or centers.shape[1] != 2 or not np.isfinite(centers).all():
        raise CameraError(
            f"PSF centers need shape (n, 2) and finite values, got shape {centers.shape}; leave out points that "
            "do not fall on the detector."
        )
    return centers


def cell_shift(subsample: int, shift_px: ArrayLike) -> FloatArray:
    """Return a kernel's displacement (2,) in cells.

    Raises
    ------
    CameraError
        Less than one cell a pixel, or a displacement that is not two finite numbers.
    """
    shift = np.asarray(shift_px, dtype=np.float64)
    if subsample < 1 or shift.shape != (2,) or not np.isfinite(shift).all():
        raise CameraError(
            f"PSF kernel for {subsample} cells a pixel displaced by {shift.tolist()} px; give at least 1 and two "
            "finite numbers."
        )
    return shift * subsample


def require_positive(what: str, **values: float) -> None:
    """Raise CameraError, naming the parameter, unless all values are positive and finite."""
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise CameraError(f"{what}: {name} is {value}; give a positive number.")


# ---- Many points added to a picture through a PSF.

FEW_PIXELS = (
    10  # where boxes have fewer pixels than the picture by this factor, summing up whole pictures is slower
)
CHUNK_PIXELS = 2_000_000  # pixels of boxes held at once: 16 MB an array


def add_sources(picture: FloatArray, psf: Psf, center_px: ArrayLike, flux: ArrayLike) -> None:
    """Add n points to `picture` in place; the light that falls off its edges is lost.

    Parameters
    ----------
    picture : (n_line, n_pixel) array
    center_px : (n, 2) array_like
        (pixel, line); points that are not finite (behind the camera) are left out.
    flux : (n,) array_like
        Total flux of each, in the unit of the picture.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> picture = np.zeros((20, 30))
    >>> add_sources(picture, GaussianPsf(0.8, 0.8), [[10.3, 9.9], [22.0, 8.5]], [100.0, 50.0])
    >>> round(float(picture.sum()), 4)
    150.0
    """
    centers = np.asarray(center_px, dtype=np.float64).reshape(-1, 2)
    fluxes = np.broadcast_to(np.asarray(flux, dtype=np.float64), len(centers))
    size_px = np.array(picture.shape[::-1])
    reach = np.ceil(psf.half_size_px) + 1.0
    near = ((centers > -reach) & (centers < size_px - 1.0 + reach)).all(axis=1)  # nan: no
    centers, fluxes = centers[near], fluxes[near]
    if len(centers) == 0:
        return
    first, size = covering_boxes(psf, centers)
    step = max(1, CHUNK_PIXELS // size**2)
    for start in range(0, len(centers), step):
        part = slice(start, start + step)
        light = psf.box(centers[part], first[part], size) * fluxes[part, None, None]
        add_boxes(picture, light, first[part])


def add_boxes(picture: FloatArray, boxes: FloatArray, first: ArrayLike) -> None:
    """Add boxes (n, size, size) whose first pixels are `first` (n, 2) to `picture` in place."""
    step = np.arange(boxes.shape[-1])
    corner = np.asarray(first, dtype=np.int64)
    n_line, n_pixel = picture.shape
    line, pixel = corner[:, 1, None] + step, corner[:, 0, None] + step
    line_in, pixel_in = (line >= 0) & (line < n_line), (pixel >= 0) & (pixel < n_pixel)
    place = line[:, :, None] * n_pixel + pixel[:, None, :]
    inside = line_in[:, :, None] & pixel_in[:, None, :]
    if boxes.size * FEW_PIXELS < picture.size:
        np.add.at(picture, np.divmod(place[inside], n_pixel), boxes[inside])
    else:
        summed = np.bincount(place[inside], weights=boxes[inside], minlength=picture.size)
        picture += summed.reshape(picture.shape)
