"""The pixels about a limb, gathered in cells of angle and depth: data, their weights, and the model's derivatives.

Every pixel of the strip belongs to one cell; the model is taken at the pixel itself, so that a cell's mean of data is
compared with the same mean of the model, and nothing is resampled.
"""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.silhouette import TURN, Outline

__all__ = [
    "LimbPlaces",
    "SquareCorners",
    "angle_and_depth",
    "between_pieces",
    "cell_of",
    "depth_edges",
    "gathered",
    "limb_depth",
    "limb_pixels",
    "limb_places",
    "piece_angles",
    "piece_of",
    "square_corners",
]

# Of a square along pixel and along line, in standard deviations of its pixels.
CORNERS = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, -1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class LimbPlaces:
    """n places about an outline: pixels, or middles of squares of them.

    Attributes
    ----------
    pixel, line : (n,) arrays
        On the detector.
    angle_rad, depth_px : (n,) arrays
    limb_px : (n,) array
        Radius of the outline there.
    shift, turn : (n, 2) arrays
        Change of the depth (px) and of the angle (rad) per px that the center moves along pixel and along line.
    """

    pixel: FloatArray
    line: FloatArray
    angle_rad: FloatArray
    depth_px: FloatArray
    limb_px: FloatArray
    shift: FloatArray
    turn: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def index(self) -> tuple[IntArray, IntArray]:
        """Line and pixel, to look up planes of the picture."""
        return self.line.astype(np.int64), self.pixel.astype(np.int64)

    def in_order(self, order: IntArray) -> "LimbPlaces":
        """Return the same places in another order (n,)."""
        return LimbPlaces(*(getattr(self, each.name)[order] for each in fields(self)))


class SquareCorners(NamedTuple):
    """Four places in each of m squares, whose mean is the square's of what is cubic across it: `of` (m,) says which squares.

    `angle_rad` and `depth_px` are (m, 4).
    """

    of: IntArray
    angle_rad: FloatArray
    depth_px: FloatArray


def square_corners(outline: Outline, middles: LimbPlaces, spread_px: FloatArray) -> SquareCorners:
    """Return the corners of squares whose pixels have `spread_px` (n,) as their standard deviation; of a pixel none."""
    wide = np.flatnonzero(spread_px)
    spread = spread_px[wide, None]
    x, y = (
        at[wide, None] + spread * sign
        for at, sign in zip((middles.pixel, middles.line), CORNERS, strict=True)
    )
    return SquareCorners(wide, *angle_and_depth(outline, x, y))


def limb_pixels(outline: Outline, shape: tuple[int, int], inward_px: float, outward_px: float) -> LimbPlaces:
    """Return the pixels of a detector (lines, pixels) between two depths."""
    reach = outline.reach_px + outward_px + 1.0
    center = outline.center_px
    first = np.clip(np.ceil(center - reach[:2]), 0, np.array(shape)[::-1]).astype(int)
    last = np.minimum(np.floor(center + reach[2:]), np.array(shape)[::-1] - 1).astype(int)
    x, y = np.arange(first[0], last[0] + 1.0), np.arange(first[1], last[1] + 1.0)
    radius = np.hypot(x - center[0], y[:, None] - center[1])
    limb = outline.radius_px
    row, column = np.nonzero((radius > limb.min() - inward_px) & (radius < limb.max() + outward_px))
    x, y = x[column], y[row]
    depth = limb_depth(outline, x, y)
    kept = (depth > -inward_px) & (depth < outward_px)
    return limb_places(outline, x[kept], y[kept])


def limb_depth(outline: Outline, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
    """Return how far outside of the limb (n,) places of the detector are, along rays from the center."""
    return angle_and_depth(outline, x_px, y_px)[1]


def angle_and_depth(outline: Outline, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where places (n,) of the detector are about an outline: angles, and how far outside of the limb along rays."""
    x, y = x_px - outline.center_px[0], y_px - outline.center_px[1]
    angle = np.arctan2(y, x)
    return angle, np.asarray(np.hypot(x, y) - _outline_at(outline, angle)[0])


def limb_places(outline: Outline, x_px: FloatArray, y_px: FloatArray) -> LimbPlaces:
    """Return where places (n,) of the detector are about an outline."""
    x, y = x_px - outline.center_px[0], y_px - outline.center_px[1]
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    at, slope = _outline_at(outline, angle)
    radius = np.maximum(distance, 1e-6)
    along = np.stack([x, y], axis=-1) / radius[:, None]
    turn = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.maximum(radius, 1.0)[:, None]
    shift = -along - (slope / radius)[:, None] * turn * radius[:, None]
    return LimbPlaces(x_px, y_px, angle, distance - at, at, shift, turn)


def _outline_at(outline: Outline, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return radius and its slope (px/rad) at angles: the outline has an even grid."""
    n = len(outline.angle_rad)
    place = (angle - outline.angle_rad[0]) * (n / TURN)
    below = np.floor(place).astype(np.int64)
    part = place - below
    low, high = outline.radius_px[below % n], outline.radius_px[(below + 1) % n]
    return low + part * (high - low), (high - low) * (n / TURN)


def depth_edges(inward_px: float, outward_px: float, sharp_px: float) -> FloatArray:
    """Return edges of depths: 0.75 px about the limb, wider where nothing is sharp."""
    fine = max(4.0 * sharp_px, 3.0)
    near = np.arange(-min(fine, inward_px), min(fine, outward_px) + 0.375, 0.75)
    inner, width = [near[0]], 1.0
    while inner[-1] > -inward_px:
        width *= 1.3
        inner.append(max(inner[-1] - width, -inward_px))
    outer, width = [near[-1]], 1.5
    while outer[-1] < outward_px:
        outer.append(min(outer[-1] + width, outward_px))
    return np.concatenate([inner[:0:-1], near, outer[1:]])


def piece_of(angle_rad: FloatArray, pieces: int) -> IntArray:
    """Return the piece of limb (n,) at each angle."""
    return np.asarray(np.floor(np.mod(angle_rad, TURN) * (pieces / TURN)).astype(np.int64) % pieces)


def piece_angles(n: int) -> FloatArray:
    """Return the middles (n,) of pieces of limb, rad."""
    return np.asarray((np.arange(n) + 0.5) * (TURN / n))


def between_pieces(angle_rad: FloatArray, values: FloatArray) -> FloatArray:
    """Return what pieces of limb have (j, ...) at angles (n,), linear from the middle of one to the next: (n, ...)."""
    j = len(values)
    place = np.mod(angle_rad, TURN) * (j / TURN) - 0.5
    below = np.floor(place).astype(np.int64)
    part = (place - below).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - part) * values[below % j] + part * values[(below + 1) % j])


def cell_of(places: LimbPlaces, pieces: int, edges: FloatArray) -> IntArray:
    """Return the cell (n,) of each place."""
    piece = piece_of(places.angle_rad, pieces)
    depth = np.clip(np.searchsorted(edges, places.depth_px) - 1, 0, len(edges) - 2)
    return np.asarray(piece * (len(edges) - 1) + depth)


def gathered(
    cell: IntArray, weight: FloatArray, data: FloatArray, columns: FloatArray, pieces: int, edges: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weights and means of data (j, c) and of columns (p, j, c) over the cells of n pixels."""
    c = len(edges) - 1
    size = pieces * c

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, values, size).reshape(pieces, c), dtype=np.float64)

    whole = total(weight)
    share = 1.0 / np.where(whole > 0.0, whole, np.inf)
    means = np.stack([total(weight * column) * share for column in columns])
    return whole, total(weight * data) * share, means
