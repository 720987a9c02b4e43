"""A coarse mesh over a picture: tiles, their clipped statistics, and the way back to every pixel.

The cost is one sort per tile; after it, clipping only moves two indices, and sums come from running totals.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["Mesh", "clipped_statistics", "make_mesh", "tiles_of"]

TILES_ACROSS = 8  # fewer cannot follow a gradient and lose a body at the same time
SMALLEST_TILE_PX = 16  # 256 pixels give a level to 0.08 sigma; smaller tiles are noise
CLIP_PASSES = 12  # each pass only moves indices; a bright limb in the tile takes the most
LEVEL_CLIP_SIGMA = 2.0  # a narrow window keeps the wings of stars out of the mean
NOISE_CLIP_SIGMA = 3.0
# Standard deviation of a unit Gaussian cut at +-3: sqrt(1 - 2 k phi(k) / (2 Phi(k) - 1)).
NOISE_CLIP_FACTOR = 0.986578
SHARE_BELOW_ONE_SIGMA = 0.158655
STEPS_IN_WINDOW = 1.5  # whole numbers: the neighbours on both sides stay in, wherever the level lies between
CLIP_TOLERANCE = 1e-3  # of the noise: a tenth of the error of a tile's level
SMALLEST_SAMPLE_PX = 32  # fewer usable pixels than this: the tile says nothing
SMALLEST_SHARE = 0.1  # nor does a tile with less than a tenth of its pixels left


@dataclass(frozen=True, slots=True)
class Mesh:
    """Where the tiles of one axis pair lie.

    Attributes
    ----------
    line_start, pixel_start : (k,) int arrays
        First line and pixel of each row and column of tiles.
    tile_line, tile_pixel : int
        Height and width of every tile; neighbours may overlap by a pixel so that all are equal.
    shape : (n_line, n_pixel)
    """

    line_start: IntArray
    pixel_start: IntArray
    tile_line: int
    tile_pixel: int
    shape: tuple[int, int]

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.line_start), len(self.pixel_start)

    def centers(self) -> FloatArray:
        """Return the tile centers (k, 2) as (pixel, line), scaled to -1..1 over the picture."""
        line = _unit_interval(self.line_start + (self.tile_line - 1) / 2.0, self.shape[0])
        pixel = _unit_interval(self.pixel_start + (self.tile_pixel - 1) / 2.0, self.shape[1])
        grid_line, grid_pixel = np.meshgrid(line, pixel, indexing="ij")
        return np.column_stack([grid_pixel.ravel(), grid_line.ravel()])

    def upsample(self, values: FloatArray) -> FloatArray:
        """Spread tile values (k,) over the picture, bilinear and linear beyond the outer centers."""
        along_line = _linear_weights(self.line_start + (self.tile_line - 1) / 2.0, self.shape[0])
        along_pixel = _linear_weights(self.pixel_start + (self.tile_pixel - 1) / 2.0, self.shape[1])
        return np.asarray(along_line @ values.reshape(self.tiles) @ along_pixel.T)


def make_mesh(shape: tuple[int, int], box_px: int) -> Mesh:
    """Divide a picture into tiles of about `box_px`, smaller where fewer than eight would fit across."""
    (line_start, tile_line), (pixel_start, tile_pixel) = (_divide(n, box_px) for n in shape)
    return Mesh(line_start, pixel_start, tile_line, tile_pixel, shape)


def _divide(length: int, box_px: int) -> tuple[IntArray, int]:
    side = min(box_px, max(length // TILES_ACROSS, min(SMALLEST_TILE_PX, box_px)))
    count = max(1, round(length / side))
    size = -(-length // count)
    return np.linspace(0, length - size, count).round().astype(np.int64), size


def _unit_interval(position: NDArray[np.floating[Any]], length: int) -> FloatArray:
    return np.asarray((2.0 * position - (length - 1)) / max(length - 1, 1))


def _linear_weights(nodes: NDArray[np.floating[Any]], length: int) -> FloatArray:
    """Return the matrix (length, k) that interpolates node values at 0..length-1, linearly extended."""
    weights = np.zeros((length, len(nodes)))
    if len(nodes) == 1:
        return weights + 1.0
    at = np.arange(length)
    left = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    fraction = (at - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights[at, left] = 1.0 - fraction
    weights[at, left + 1] = fraction
    return weights


def tiles_of(image: FloatArray, mesh: Mesh) -> FloatArray:
    """Cut a picture into tiles: (k_line * k_pixel, tile_line * tile_pixel), a copy."""
    k_line, k_pixel = mesh.tiles
    if k_line * mesh.tile_line == mesh.shape[0] and k_pixel * mesh.tile_pixel == mesh.shape[1]:
        gathered = image
    else:
        lines = (mesh.line_start[:, None] + np.arange(mesh.tile_line)).ravel()
        pixels = (mesh.pixel_start[:, None] + np.arange(mesh.tile_pixel)).ravel()
        gathered = image[np.ix_(lines, pixels)]
    blocks = gathered.reshape(k_line, mesh.tile_line, k_pixel, mesh.tile_pixel)
    return blocks.transpose(0, 2, 1, 3).reshape(k_line * k_pixel, mesh.tile_line * mesh.tile_pixel)


def clipped_statistics(tiles: FloatArray, step_dn: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return level and noise (k,) of tiles (k, n); nan marks a masked pixel, and a tile with too few others.

    The level is the mean of what lies within two sigma of itself, the noise the standard deviation within
    three, corrected for the cut: both hold where stars or a limb add a bright tail. `step_dn` is the step of
    a whole-number picture; no window leaves out the neighbours, or a quiet sky would show no noise at all.
    """
    ordered = np.sort(tiles, axis=1)  # nan goes last
    count = np.asarray(np.count_nonzero(~np.isnan(ordered), axis=1), np.int64)
    usable = (count >= SMALLEST_SAMPLE_PX) & (count >= SMALLEST_SHARE * tiles.shape[1])
    if not usable.any():
        return np.full(len(tiles), np.nan), np.full(len(tiles), np.nan)
    level, noise = (np.full(len(tiles), np.nan) for _ in range(2))
    level[usable], noise[usable] = _clip(_SortedTiles(ordered[usable], count[usable]), step_dn)
    return level, noise


def _clip(tiles: "_SortedTiles", step_dn: float) -> tuple[FloatArray, FloatArray]:
    level, noise = tiles.start()
    narrowest = STEPS_IN_WINDOW * step_dn
    for _ in range(CLIP_PASSES):
        before = level, noise
        level = tiles.moments(level, np.maximum(LEVEL_CLIP_SIGMA * noise, narrowest))[0]
        noise = tiles.moments(level, np.maximum(NOISE_CLIP_SIGMA * noise, narrowest))[1] / NOISE_CLIP_FACTOR
        moved = np.abs(level - before[0]) + np.abs(noise - before[1])
        if np.all(moved <= CLIP_TOLERANCE * noise):
            break
    return level, noise


class _SortedTiles:
    """Sorted tiles with running sums: the moments within any window cost two binary searches a tile."""

    def __init__(self, ordered: FloatArray, count: IntArray) -> None:
        self.ordered = ordered
        self.count = count
        self.rows = np.arange(len(ordered))
        self.median = ordered[self.rows, (count - 1) // 2]
        shifted = ordered - self.median[:, None]  # sums of small numbers keep their digits
        shifted[np.isnan(shifted)] = 0.0
        self.sums = _running(shifted)
        self.squares = _running(np.square(shifted, out=shifted))

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Return the median, and the scale of the fainter half, which a bright tail inflates least."""
        one_sigma_below = self.ordered[self.rows, (self.count * SHARE_BELOW_ONE_SIGMA).astype(np.int64)]
        return self.median, np.asarray(self.median - one_sigma_below)

    def moments(self, center: FloatArray, half_width: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of the values within `half_width` of `center`."""
        low = np.minimum(self._position(center - half_width, "left"), self.count - 1)
        high = np.maximum(self._position(center + half_width, "right"), low + 1)
        n = high - low
        mean = (self.sums[self.rows, high] - self.sums[self.rows, low]) / n
        square = (self.squares[self.rows, high] - self.squares[self.rows, low]) / n
        return self.median + mean, np.sqrt(np.maximum(square - mean * mean, 0.0))

    def _position(self, bounds: FloatArray, side: Literal["left", "right"]) -> IntArray:
        found = (
            row[:n].searchsorted(b, side) for row, n, b in zip(self.ordered, self.count, bounds, strict=True)
        )
        return np.fromiter(found, np.int64, len(bounds))


def _running(values: FloatArray) -> FloatArray:
    sums = np.zeros((values.shape[0], values.shape[1] + 1))
    np.cumsum(values, axis=1, out=sums[:, 1:])
    return sums
