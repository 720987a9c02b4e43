"""How finely each pixel of a body is looked at: one ray where the surface is smooth, 32 by 32 at its edges.

Every pixel of the window gets a ray through its center. Pixels that an edge may cross, and those whose brightness bends
too much between its neighbours, are divided into 4 x 4 cells; cells where the same holds again into 4 x 4, and those into
2 x 2. For small bodies every pixel near the body is divided. AAS 13-443 takes 5 x 5 cells there, on which a limb is off
by up to 1/10 px. Here it is 4 x 4, and 32 by 32 at edges: finer than the paper's where it matters, and a lattice that the
32 x 32 rays of a brute-force reference share, so that the two differ by errors of this program alone.

The result is a mean brightness and its slopes for every pixel left whole, and mean brightnesses of 16 x 16 cells for every
pixel that was divided. An edge falls on the wrong side of half a finest cell at most, 1/64 px.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.render.grid import PixelGrid

__all__ = ["PATTERNED_SURFACE", "PLATED_SURFACE", "SMOOTH_SURFACE", "Fineness", "sample_pixels"]

FIRST_DIVISION, SECOND_DIVISION, THIRD_DIVISION = 4, 4, 2  # cells along a side, in each division
RAYS_AT_ONCE = 16_384  # 400 kB a vector array


@dataclass(frozen=True, slots=True)
class Fineness:
    """When a pixel or cell is divided, in shares of the peak brightness.

    A mid-pixel ray misses the pixel's mean by 1/24 of the brightness's second differences. That is corrected, but at a
    kink it is only a bound, and at a jump 12 times more is possible.
    """

    bend: float  # second difference between neighbouring pixels
    step: float  # difference between neighbouring cells


SMOOTH_SURFACE = Fineness(bend=24.0 * 4e-4, step=0.02)
# A map's cells show everywhere, and quarter pixels see them: 1 % of the peak at the sharpest edges, 0.02 % on average.
PATTERNED_SURFACE = Fineness(bend=24.0 * 4e-4, step=0.3)
# Plates differ from each other by a few percent: that pattern is sampled, outline and shadows are refined.
PLATED_SURFACE = Fineness(bend=0.02, step=0.2)

Result = TypeVar("Result", FloatArray, BoolArray)
Radiance = Callable[[FloatArray], FloatArray]  # rays (3, n) -> (n,)
NearEdge = Callable[[FloatArray, float], BoolArray]  # rays (3, n), reach in rad -> (n,)


@dataclass(frozen=True, slots=True, eq=False)
class PixelSamples:
    """Mean radiances over a window."""

    whole: FloatArray  # (3, n_line, n_pixel) mean, slopes along pixel and line; 0 for divided pixels
    divided: IntArray  # (n,) flat indices of divided pixels
    cells: FloatArray  # (n, s, s) their cells, [line, pixel]


def sample_pixels(
    grid: PixelGrid, radiance: Radiance, near_edge: NearEdge, fineness: Fineness, *, everywhere: bool
) -> PixelSamples:
    """Return the mean radiance of every pixel, divided where it needs to be.

    Parameters
    ----------
    radiance, near_edge : callable
        What rays show, and whether an edge may pass within an angle of them.
    everywhere
        Divide every pixel near the body.
    """
    rays = grid.directions()
    center = _in_parts(radiance, rays)
    whole, bend = _expanded(center.reshape(grid.shape))
    reach = grid.half_pixel_rad
    edge = _in_parts(lambda part: near_edge(part, reach), rays)
    peak = float(center[~edge].max(initial=0.0))
    wanted = edge | (bend.ravel() > fineness.bend * peak)
    # Between a bright limb and the night lies a crescent that may be thinner than a pixel.
    wanted |= (center == 0.0) & _beside(edge.reshape(grid.shape)).ravel()
    if everywhere:
        wanted |= center > 0.0
    divided = np.flatnonzero(wanted)
    whole.reshape(3, -1)[:, divided] = 0.0

    rays = grid.directions_within(divided, _cell_offsets(FIRST_DIVISION)[None]).reshape(3, -1)
    coarse = _in_parts(radiance, rays).reshape(-1, FIRST_DIVISION, FIRST_DIVISION)
    limit = fineness.step * max(peak, float(coarse.mean(axis=(1, 2)).max(initial=0.0)))
    edge = _in_parts(lambda part: near_edge(part, reach / FIRST_DIVISION), rays).reshape(coarse.shape)
    again = (
        edge | _uneven(coarse, limit) | _unlike_neighbours(coarse, divided, center.reshape(grid.shape), limit)
    )
    return PixelSamples(
        whole,
        divided,
        _divide(
            grid,
            radiance,
            lambda part: near_edge(part, reach / FIRST_DIVISION / SECOND_DIVISION),
            limit,
            divided,
            coarse,
            again,
        ),
    )


def _divide(
    grid: PixelGrid,
    radiance: Radiance,
    near_edge: Callable[[FloatArray], BoolArray],
    limit: float,
    pixels: IntArray,
    coarse: FloatArray,
    again: BoolArray,
) -> FloatArray:
    """Return the means (n, 16, 16) of the cells of pixels (n,) from those of coarse cells (n, 4, 4)."""
    pixel, line_cell, pixel_cell = np.nonzero(again)
    center = _cell_offsets(FIRST_DIVISION).reshape(FIRST_DIVISION, FIRST_DIVISION, 2)[line_cell, pixel_cell]
    at = center[:, None] + _cell_offsets(SECOND_DIVISION) / FIRST_DIVISION
    rays = grid.directions_within(pixels[pixel], at).reshape(3, -1)
    fine = _in_parts(radiance, rays).reshape(-1, SECOND_DIVISION, SECOND_DIVISION)
    edge = _in_parts(near_edge, rays).reshape(fine.shape)
    which, line_sub, pixel_sub = np.nonzero(edge | _uneven(fine, limit))

    center = at.reshape(-1, SECOND_DIVISION, SECOND_DIVISION, 2)[which, line_sub, pixel_sub]
    at = center[:, None] + _cell_offsets(THIRD_DIVISION) / (FIRST_DIVISION * SECOND_DIVISION)
    rays = grid.directions_within(pixels[pixel[which]], at).reshape(3, -1)
    fine[which, line_sub, pixel_sub] = (
        _in_parts(radiance, rays).reshape(-1, THIRD_DIVISION * THIRD_DIVISION).mean(axis=1)
    )

    cells = np.repeat(np.repeat(coarse, SECOND_DIVISION, axis=1), SECOND_DIVISION, axis=2)
    step = np.arange(SECOND_DIVISION)
    lines = (line_cell * SECOND_DIVISION)[:, None, None] + step[:, None]
    columns = (pixel_cell * SECOND_DIVISION)[:, None, None] + step
    cells[pixel[:, None, None], lines, columns] = fine
    return cells


def _cell_offsets(n: int) -> FloatArray:
    """Centers (n * n, 2) of the cells of a unit square about zero, (pixel, line), line by line."""
    at = (np.arange(n) + 0.5) / n - 0.5
    line, pixel = np.meshgrid(at, at, indexing="ij")
    return np.stack([pixel.ravel(), line.ravel()], axis=-1)


def _expanded(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and slopes of each pixel (3, ...) from brightnesses at pixel centers, and the larger second difference.

    Beyond the window's border counts as dark.
    """
    padded = np.pad(image, 1)
    right, left, below, above = padded[1:-1, 2:], padded[1:-1, :-2], padded[2:, 1:-1], padded[:-2, 1:-1]
    along, down = right + left - 2.0 * image, below + above - 2.0 * image
    expanded = np.stack([image + (along + down) / 24.0, 0.5 * (right - left), 0.5 * (below - above)])
    return expanded, np.maximum(np.abs(along), np.abs(down))


def _beside(mask: BoolArray) -> BoolArray:
    """Tell which pixels touch one of the mask, by a side or a corner."""
    rows = np.pad(mask, 1)
    rows = rows[:-2] | rows[1:-1] | rows[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def _uneven(blocks: FloatArray, limit: float) -> BoolArray:
    """Tell which cells (n, k, k) differ by more than `limit` from a neighbour in their block."""
    out = np.zeros(blocks.shape, dtype=bool)
    down = np.abs(np.diff(blocks, axis=1)) > limit
    along = np.abs(np.diff(blocks, axis=2)) > limit
    out[:, 1:] |= down
    out[:, :-1] |= down
    out[:, :, 1:] |= along
    out[:, :, :-1] |= along
    return out


def _unlike_neighbours(blocks: FloatArray, pixels: IntArray, center: FloatArray, limit: float) -> BoolArray:
    """Tell which cells (n, k, k) differ by more than `limit` from what lies across their pixel's border.

    A neighbour pixel that is not divided counts as its center; beyond the window counts as dark.
    """
    padded = np.pad(center, 1)
    slot = np.full(padded.size, -1)
    width = padded.shape[1]
    line, pixel = np.divmod(pixels, center.shape[1])
    place = (line + 1) * width + pixel + 1
    slot[place] = np.arange(len(pixels))
    out = np.zeros(blocks.shape, dtype=bool)
    for axis, side, step in ((1, 0, -width), (1, -1, width), (2, 0, -1), (2, -1, 1)):
        mine = np.take(blocks, side, axis=axis)
        beyond = np.take(blocks, -1 - side, axis=axis)[slot[place + step]]
        whole = padded.ravel()[place + step, None]
        other = np.where(slot[place + step, None] >= 0, beyond, whole)
        np.moveaxis(out, axis, 0)[side] |= np.abs(mine - other) > limit
    return out


def _in_parts(function: Callable[[FloatArray], Result], rays: FloatArray) -> Result:
    """Evaluate in parts that stay in the processor's cache, and bound the memory."""
    if rays.shape[1] <= RAYS_AT_ONCE:
        return function(rays)
    parts = range(0, rays.shape[1], RAYS_AT_ONCE)
    return np.concatenate([function(rays[:, a : a + RAYS_AT_ONCE]) for a in parts])
