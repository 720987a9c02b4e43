"""The pixels of a picture in squares of 1, 2, 4 and 8, of which a disk takes the larger ones where its light is smooth.

A square's mean of data is compared with the light at four places in it, which hold its curvature; what is left goes as the
fourth power of side over depth.
"""

from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.bodies.disk.limb_cells import LimbPlaces, limb_depth, limb_places
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["LimbSamples", "PixelSquares", "limb_samples"]

SIDES = (1, 2, 4, 8)
CLEAR_SIDES = 2.0  # a square is as far from the limb, at least


class LimbSamples(NamedTuple):
    """Squares of pixels about an outline: their places; data (n,), variance without shot noise (n,), sides (n,)."""

    places: LimbPlaces
    data_dn: FloatArray
    variance_dn2: FloatArray
    side: FloatArray

    @property
    def spread_px(self) -> FloatArray:
        """Standard deviation (n,) of a square's pixels in any direction."""
        return np.asarray(np.sqrt((self.side**2 - 1.0) / 12.0))

    def in_order(self, order: IntArray) -> "LimbSamples":
        """Return the same squares in another order (n,)."""
        return LimbSamples(self.places.in_order(order), *(each[order] for each in self[1:]))


class _Squares(NamedTuple):
    """Means of data and of variance in squares (n_line, n_pixel) of one side, and which of them are whole."""

    data_dn: FloatArray
    variance_dn2: FloatArray
    whole: BoolArray


class PixelSquares:
    """Squares of all sides in the part of a picture about an outline.

    Parameters
    ----------
    reach_px
        Beyond the outline.
    """

    def __init__(self, pixels: Cutout, outline: Outline, reach_px: float) -> None:
        self.first, self.last = _part(outline, reach_px, pixels.use.shape)
        (line, pixel), (line_end, pixel_end) = SIDES[-1] * self.first, SIDES[-1] * self.last
        part = np.s_[line:line_end, pixel:pixel_end]
        use = pixels.use[part]
        short = [(0, -n % SIDES[-1]) for n in use.shape]
        whole = np.pad(use, short)
        data = np.pad(np.where(use, pixels.data_dn[part], 0.0), short)
        variance = np.pad(np.where(use, pixels.noise_dn[part] ** 2, 0.0), short)
        self.levels = [_Squares(data, variance, whole)]
        for _ in SIDES[1:]:
            self.levels.append(_of_four(self.levels[-1]))
        self.shape = pixels.use.shape

    def hold(self, outline: Outline, reach_px: float) -> bool:
        """Tell whether all about an outline is in them."""
        first, last = _part(outline, reach_px, self.shape)
        return bool(np.all(first >= self.first) and np.all(last <= self.last))


def _part(outline: Outline, reach_px: float, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Return first and last + 1 (line, pixel) of the largest squares that an outline may touch."""
    reach, side = outline.reach_px + reach_px + 1.0, SIDES[-1]
    most = -(-np.array(shape) // side)
    first = np.clip((outline.center_px - reach[:2])[::-1] // side, 0, most).astype(np.int64)
    last = np.clip((outline.center_px + reach[2:])[::-1] // side + 1, first, most).astype(np.int64)
    return first, last


def _of_four(squares: _Squares) -> _Squares:
    corners = [np.s_[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    data, variance = (0.25 * np.sum([plane[corner] for corner in corners], axis=0) for plane in squares[:2])
    whole = np.logical_and.reduce([squares.whole[corner] for corner in corners])
    return _Squares(data, variance, whole)


def limb_samples(
    squares: PixelSquares, outline: Outline, inward_px: float, outward_px: float, sharp_px: float
) -> LimbSamples:
    """Return the usable pixels between two depths, in squares beyond `sharp_px` of the limb."""
    found: list[tuple[FloatArray, ...]] = []
    first, last = _part(outline, outward_px, squares.shape) - np.array([squares.first])
    line, pixel = (at.ravel() for at in np.mgrid[first[0] : last[0], first[1] : last[1]])
    for level, side in zip(reversed(squares.levels), reversed(SIDES), strict=True):
        middle = SIDES[-1] * squares.first + 0.5 * (side - 1.0)
        x, y = side * pixel + middle[1], side * line + middle[0]
        depth = limb_depth(outline, x, y)
        kept = (depth > -inward_px) & (depth < outward_px) & level.whole[line, pixel]
        if side > 1:
            kept &= np.abs(depth) > max(CLEAR_SIDES * side, sharp_px + side)
        here = line[kept], pixel[kept]
        variance = level.variance_dn2[here] / side**2
        found.append((x[kept], y[kept], level.data_dn[here], variance, np.full(len(variance), float(side))))
        near = ~kept & (depth > -inward_px - side) & (depth < outward_px + side)
        line, pixel = _quarters(line[near], pixel[near])
    x, y, data, variance, sides = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return LimbSamples(limb_places(outline, x, y), data, variance, sides)


def _quarters(line: IntArray, pixel: IntArray) -> tuple[IntArray, IntArray]:
    """Return the squares of half of the side."""
    lines, pixels = (
        (2 * at[:, None] + half).ravel() for at, half in ((line, [0, 0, 1, 1]), (pixel, [0, 1, 0, 1]))
    )
    return lines, pixels
