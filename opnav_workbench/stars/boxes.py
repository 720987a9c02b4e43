"""Square boxes around stars, cut out of an image all at once; unusable pixels carry no weight."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError

__all__ = ["Boxes", "Pixels", "box_corners", "check_image", "check_points", "cut_at", "cut_boxes"]


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """An image with its noise and its masks, all (n_line, n_pixel), checked."""

    image_dn: FloatArray
    noise_dn: FloatArray  # infinite where a pixel must not be used
    bad: BoolArray
    saturated: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def without(self, line: IntArray, pixel: IntArray) -> "Pixels":
        """Return the same with some pixels taken out of use; they do not count as bad."""
        noise, image = self.noise_dn.copy(), self.image_dn.copy()
        noise[line, pixel], image[line, pixel] = np.inf, 0.0
        return Pixels(image, noise, self.bad, self.saturated)


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """n boxes of size x size pixels, indexed [star, line, pixel]."""

    first: IntArray  # (n, 2) pixel, line of the first pixel of each box; may lie off the detector
    data_dn: FloatArray  # (n, size, size), 0 where unusable
    variance_dn2: FloatArray  # (n, size, size), infinite where unusable
    bad: BoolArray  # (n, size, size) bad pixels on the detector
    saturated: BoolArray  # (n, size, size)
    outside: BoolArray  # (n, size, size) off the detector

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return int(self.data_dn.shape[-1])

    @property
    def weight(self) -> FloatArray:
        """Inverse variance, 0 where unusable; (n, size, size)."""
        return 1.0 / self.variance_dn2

    def offsets(self, center: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return pixel (n, size) and line (n, size) coordinates relative to `center` (n, 2)."""
        steps = np.arange(self.size) + (self.first - center)[:, :, None]
        return steps[:, 0], steps[:, 1]


def check_image(
    image_dn: ArrayLike, noise_dn: ArrayLike, bad: ArrayLike | None, saturated: ArrayLike | None = None
) -> Pixels:
    """Return image, noise and masks as arrays of one shape; not-finite pixels count as bad.

    Raises
    ------
    CenterfindingError
        The image is not 2-D, a map has another shape, or the noise is nowhere positive.
    """
    image = np.asarray(image_dn, dtype=float)
    if image.ndim != 2 or 0 in image.shape:
        raise CenterfindingError(f"an image must be a 2-D array [line, pixel], got shape {image.shape}.")
    noise: FloatArray = _like(image, np.asarray(noise_dn, float), "noise_dn")
    masked: BoolArray = _like(image, np.asarray(False if bad is None else bad, bool), "bad")
    saturated_map: BoolArray = _like(
        image, np.asarray(False if saturated is None else saturated, bool), "saturated"
    )
    good = np.isfinite(image)
    if noise.strides == (0, 0):
        good &= bool(np.isfinite(noise[0, 0]) and noise[0, 0] > 0.0)
    else:
        good &= noise > 0.0
        good &= noise < np.inf
    if bad is not None:
        good &= ~masked
    if not good.any():
        raise CenterfindingError(
            "no usable pixel: all are masked, not finite, or without a positive noise_dn."
        )
    bad_map, unusable = ~good, ~good if saturated is None else saturated_map | ~good
    if not unusable.any():  # the usual large picture is not copied
        return Pixels(image, noise, bad_map, saturated_map)
    return Pixels(
        np.where(unusable, 0.0, image),
        np.where(unusable, np.inf, noise),
        bad_map & ~saturated_map,
        saturated_map,
    )


def check_points(pixel_line: ArrayLike, name: str = "start_pixel_line") -> FloatArray:
    """Return `pixel_line` as an (n, 2) float array; a single point and an empty list are welcome.

    Raises
    ------
    CenterfindingError
        The shape is not (n, 2), or a coordinate is not finite.
    """
    points = np.asarray(pixel_line, dtype=float)
    points = points.reshape(-1, 2) if points.size == 0 or points.shape == (2,) else points
    if points.ndim != 2 or points.shape[1] != 2:
        raise CenterfindingError(f"{name} must have shape (n, 2) (pixel, line), got {points.shape}.")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise CenterfindingError(
            f"{name} row {row} is {points[row].tolist()}; leave out stars without a position."
        )
    return points


def box_corners(pixels: Pixels, pixel_line: FloatArray, size: int) -> IntArray:
    """Return the first pixels (n, 2) of boxes of `size` centered on the pixels that hold the points."""
    n_line, n_pixel = pixels.image_dn.shape
    # Far outside all boxes are empty alike: the limit keeps the integers small.
    nearest = np.rint(np.clip(pixel_line, -size, [n_pixel + size, n_line + size])).astype(np.int64)
    return nearest - (size - 1) // 2


def cut_boxes(pixels: Pixels, pixel_line: FloatArray, size: int) -> Boxes:
    """Cut a box of `size` pixels around each point, centered on the pixel that holds it (odd sizes)."""
    return cut_at(pixels, box_corners(pixels, pixel_line, size), size)


def cut_at(pixels: Pixels, first: IntArray, size: int) -> Boxes:
    """Cut boxes of `size` pixels whose first pixels (n, 2) are given."""
    n_line, n_pixel = pixels.image_dn.shape
    steps = np.arange(size)
    column, row = first[:, 0, None] + steps, first[:, 1, None] + steps
    outside = ((row < 0) | (row >= n_line))[:, :, None] | ((column < 0) | (column >= n_pixel))[:, None, :]
    index = np.clip(row, 0, n_line - 1)[:, :, None], np.clip(column, 0, n_pixel - 1)[:, None, :]
    return Boxes(
        first=first,
        data_dn=np.where(outside, 0.0, pixels.image_dn[index]),
        variance_dn2=np.where(outside, np.inf, pixels.noise_dn[index] ** 2),
        bad=pixels.bad[index] & ~outside,
        saturated=pixels.saturated[index] & ~outside,
        outside=outside,
    )


def _like(image: FloatArray, array: NDArray[Any], name: str) -> NDArray[Any]:
    if array.shape not in ((), image.shape):
        raise CenterfindingError(f"{name} has shape {array.shape}, the image {image.shape}; they must agree.")
    return np.broadcast_to(array, image.shape)
