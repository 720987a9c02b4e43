"""How finely each pixel of a body is looked at: one ray where the surface is smooth, 32 by 32 at its edges.

Every pixel of the window gets a ray through its center. Pixels that an edge may cross, and those whose brightness bends
too much between its neighbours, are divided into 4 x 4 cells; cells where the same holds again into 4 x 4, and those into
2 x 2. For small bodies every pixel near the body is divided: AAS 13-443 asks for 5 x 5 cells there, which err by 5 % of
the peak at the limb.

The result is a mean brightness and its slopes for every pixel left whole, and mean brightnesses of 16 x 16 cells for every pixel that was
divided. An edge falls on the wrong side of half a finest cell at most, 1/64 px.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.render.grid import PixelGrid

__all__ = ["PixelSamples", "sample_pixels"]

FIRST, SECOND, THIRD = 4, 4, 2  # cells along a side, in each division
# A mid-pixel ray misses the pixel's mean by 1/24 of the brightness's second differences. That is corrected, but at a kink
# it is only a bound: this share of the peak is allowed.
BEND = 24.0 * 4e-4
# Cells are divided further where a neighbour differs by this share of the peak.
STEP = 0.01
RAYS_AT_ONCE = 400_000

Radiance = Callable[[FloatArray], FloatArray]  # rays (3, n) -> (n,)
NearEdge = Callable[[FloatArray, float], BoolArray]  # rays (3, n), reach in rad -> (n,)


@dataclass(frozen=True, slots=True, eq=False)
class PixelSamples:
    """Mean radiances over a window."""

    whole: FloatArray  # (3, n_line, n_pixel) mean, slopes along pixel and line; 0 for divided pixels
    divided: IntArray  # (n,) flat indices of divided pixels
    cells: FloatArray  # (n, s, s) their cells, [line, pixel]


def sample_pixels(
    grid: PixelGrid, radiance: Radiance, near_edge: NearEdge, *, everywhere: bool
) -> PixelSamples:
    """Return the mean radiance of every pixel, divided where it needs to be.

    Parameters
    ----------
    grid : PixelGrid
    radiance, near_edge : callable
        What rays show, and whether an edge may pass within an angle of them.
    everywhere : bool
        Divide every pixel near the body.
    """
    rays = grid.directions()
    center = _in_parts(radiance, rays)
    whole, bend = _expanded(center.reshape(grid.shape))
    edge = near_edge(rays, grid.half_pixel_rad)
    peak = float(center[~edge].max(initial=0.0))
    wanted = edge | (bend.ravel() > BEND * peak)
    if everywhere:
        wanted |= center > 0.0
    divided = np.flatnonzero(wanted)
    whole.reshape(3, -1)[:, divided] = 0.0
    return PixelSamples(whole, divided, _divide(grid, radiance, near_edge, divided, peak))


def _divide(
    grid: PixelGrid, radiance: Radiance, near_edge: NearEdge, pixels: IntArray, peak: float
) -> FloatArray:
    """Return the means (n, s, s) of the cells of pixels (n,), s = 16."""
    n = len(pixels)
    offsets = _cell_offsets(FIRST)
    rays = grid.directions_within(pixels, offsets[None]).reshape(3, -1)
    level1 = _in_parts(radiance, rays).reshape(n, FIRST, FIRST)
    peak = max(peak, float(level1.mean(axis=(1, 2)).max(initial=0.0)))
    edge = near_edge(rays, grid.half_pixel_rad / FIRST).reshape(level1.shape)
    pixel, line_cell, pixel_cell = np.nonzero(edge | _uneven(level1, peak))
    cells = np.repeat(np.repeat(level1, SECOND, axis=1), SECOND, axis=2)

    center = offsets.reshape(FIRST, FIRST, 2)[line_cell, pixel_cell]
    at = center[:, None] + _cell_offsets(SECOND) / FIRST
    rays = grid.directions_within(pixels[pixel], at).reshape(3, -1)
    level2 = _in_parts(radiance, rays).reshape(-1, SECOND, SECOND)
    edge = near_edge(rays, grid.half_pixel_rad / (FIRST * SECOND)).reshape(level2.shape)
    which, line_sub, pixel_sub = np.nonzero(edge | _uneven(level2, peak))

    size = FIRST * SECOND
    at = at.reshape(-1, SECOND, SECOND, 2)[which, line_sub, pixel_sub][:, None] + _cell_offsets(THIRD) / size
    rays = grid.directions_within(pixels[pixel[which]], at).reshape(3, -1)
    level2[which, line_sub, pixel_sub] = _in_parts(radiance, rays).reshape(-1, THIRD * THIRD).mean(axis=1)
    sub = np.arange(SECOND)
    lines = (line_cell * SECOND)[:, None, None] + sub[:, None]
    columns = (pixel_cell * SECOND)[:, None, None] + sub
    cells[pixel[:, None, None], lines, columns] = level2
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


def _uneven(blocks: FloatArray, peak: float) -> BoolArray:
    """Tell which cells (n, k, k) differ much from a neighbour in their block."""
    limit = STEP * peak
    out = np.zeros(blocks.shape, dtype=bool)
    down = np.abs(np.diff(blocks, axis=1)) > limit
    along = np.abs(np.diff(blocks, axis=2)) > limit
    out[:, 1:] |= down
    out[:, :-1] |= down
    out[:, :, 1:] |= along
    out[:, :, :-1] |= along
    return out


def _in_parts(radiance: Radiance, rays: FloatArray) -> FloatArray:
    """Evaluate in parts that stay in the processor's cache and bound the memory."""
    if rays.shape[1] <= RAYS_AT_ONCE:
        return radiance(rays)
    parts = range(0, rays.shape[1], RAYS_AT_ONCE)
    return np.concatenate([radiance(rays[:, a : a + RAYS_AT_ONCE]) for a in parts])
