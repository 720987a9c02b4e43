"""The pixels of a picture in squares of 1, 2, 4 and 8, of which a disk takes the larger ones where its light is smooth.

A square's mean of data is compared with the light at two depths, which hold the curvature across the limb; what is left goes
as the fourth power of side over depth.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_cells import LimbPlaces, limb_depth, limb_places
from opnav_workbench.bodies.silhouette import Outline

__all__ = ["DiskPixels", "LimbSamples", "limb_samples"]

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


class _Squares(NamedTuple):
    """Means of data and of variance in squares (n_line, n_pixel) of one side, and which of them are whole."""

    data_dn: FloatArray
    variance_dn2: FloatArray
    whole: BoolArray


@dataclass(frozen=True, eq=False)
class DiskPixels:
    """Planes (n_line, n_pixel) of the picture: data, noise without shot noise, which pixels count; and the gain."""

    data_dn: FloatArray
    noise_dn: FloatArray
    use: BoolArray
    gain_e_per_dn: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @cached_property
    def squares(self) -> tuple[_Squares, ...]:
        """By side."""
        short = [(0, -n % SIDES[-1]) for n in self.use.shape]
        whole = np.pad(self.use, short)
        data, variance = (
            np.where(whole, np.pad(plane, short), 0.0) for plane in (self.data_dn, self.noise_dn**2)
        )
        levels = [_Squares(data, variance, whole)]
        for _ in SIDES[1:]:
            levels.append(_of_four(levels[-1]))
        return tuple(levels)


def _of_four(squares: _Squares) -> _Squares:
    corners = [np.s_[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    data, variance = (
        0.25 * (plane[corners[0]] + plane[corners[1]] + plane[corners[2]] + plane[corners[3]])
        for plane in squares[:2]
    )
    whole = squares.whole[corners[0]].copy()
    for corner in corners[1:]:
        whole &= squares.whole[corner]
    return _Squares(data, variance, whole)


def limb_samples(
    pixels: DiskPixels, outline: Outline, inward_px: float, outward_px: float, sharp_px: float
) -> LimbSamples:
    """Return the usable pixels between two depths, in squares beyond `sharp_px` of the limb."""
    found: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]] = []
    line, pixel = _first_squares(outline, pixels.use.shape, outward_px)
    for level, side in reversed(list(enumerate(SIDES))):
        squares, middle = pixels.squares[level], 0.5 * (side - 1.0)
        x, y = side * pixel + middle, side * line + middle
        depth = limb_depth(outline, x, y)
        within = (depth > -inward_px) & (depth < outward_px)
        kept = within & squares.whole[line, pixel]
        if side > 1:
            kept &= np.abs(depth) > max(CLEAR_SIDES * side, sharp_px + side)
        here = line[kept], pixel[kept]
        variance = squares.variance_dn2[here] / side**2
        found.append((x[kept], y[kept], squares.data_dn[here], variance, np.full(len(here[0]), float(side))))
        near = ~kept & (depth > -inward_px - side) & (depth < outward_px + side)
        line, pixel = _quarters(line[near], pixel[near])
    x, y, data, variance, sides = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return LimbSamples(limb_places(outline, x, y), data, variance, sides)


def _first_squares(
    outline: Outline, shape: tuple[int, int], outward_px: float
) -> tuple[IntArray, IntArray]:
    """Return line and pixel (n,) of the largest squares that an outline may touch."""
    reach, side = outline.reach_px + outward_px + 1.0, SIDES[-1]
    most = -(-np.array(shape)[::-1] // side)
    first = np.clip((outline.center_px - reach[:2]) // side, 0, most).astype(np.int64)
    last = np.clip((outline.center_px + reach[2:]) // side + 1, 0, most).astype(np.int64)
    line, pixel = np.mgrid[first[1] : last[1], first[0] : last[0]]
    return line.ravel(), pixel.ravel()


def _quarters(line: IntArray, pixel: IntArray) -> tuple[IntArray, IntArray]:
    """Return the squares of half of the side."""
    lines, pixels = ((2 * at[:, None] + half).ravel() for at, half in ((line, [0, 0, 1, 1]), (pixel, [0, 1, 0, 1])))
    return lines, pixels
