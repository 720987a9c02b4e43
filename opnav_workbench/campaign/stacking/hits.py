"""Cosmic rays, and whatever else is in one picture only, found by comparing each picture with the median of all.

The median of the resampled pictures is laid back on each picture's own pixels; what exceeds it by more than noise and
the median's slope allow (undersampled stars differ from phase to phase) is masked before the final resampling.

Reference: AstroDrizzle's ``driz_cr``; Fruchter & Hook (2002), doi:10.1086/338393.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.campaign.stacking.grid import Grid

__all__ = ["MIN_FRAMES", "mask_hits"]

MIN_FRAMES = 3  # of two that differ nobody knows which one is right
HIT_SIGMAS = 5.0  # one pixel in two million by noise alone
SKIRT_SIGMAS = 3.0  # beside a hit: charge that went astray
SLOPE_PART = 1.2  # of the difference to the steepest neighbour; driz_cr's own value
EIGHT = np.ones((3, 3), dtype=bool)


def mask_hits(
    frames: Sequence[StackFrame], grid: Grid, cube: FloatArray, response: FloatArray
) -> tuple[list[StackFrame], list[int]]:
    """Return the pictures with hits masked, and how many pixels of each.

    Parameters
    ----------
    frames : sequence of StackFrame
    grid : Grid
    cube : (n, n_line, n_pixel) array
        The pictures resampled on the grid, light divided by `response`; nan where unusable.
    response : (n,) array
    """
    if len(frames) < MIN_FRAMES:
        return list(frames), [0] * len(frames)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(cube).sum(axis=0) >= MIN_FRAMES
        median = np.where(known, _median(cube), np.nan)
    slope = _slope(median)
    masked, counts = [], []
    for frame, gain in zip(frames, response, strict=True):
        hit = _hits(frame, grid, median, slope, float(gain))
        counts.append(int((hit & ~frame.bad).sum()))
        masked.append(frame.replace(bad=frame.bad | hit))
    return masked, counts


def _median(cube: FloatArray) -> FloatArray:
    """Median of the usable values, 0 where there are none (no warning on the way)."""
    filled = np.sort(np.where(np.isfinite(cube), cube, np.inf), axis=0)
    count = np.isfinite(filled).sum(axis=0)
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(cube) - 1)
    pair = [np.take_along_axis(filled, index[None], axis=0)[0] for index in (low, high)]
    return np.where(count > 0, 0.5 * (pair[0] + pair[1]), 0.0)


def _slope(median: FloatArray) -> FloatArray:
    """Largest difference to a neighbour."""
    known = np.isfinite(median)
    filled = np.where(known, median, 0.0)
    high = ndimage.maximum_filter(np.where(known, median, -np.inf), footprint=EIGHT, mode="nearest")
    low = ndimage.minimum_filter(np.where(known, median, np.inf), footprint=EIGHT, mode="nearest")
    steep = np.maximum(np.where(known, high, 0.0) - filled, filled - np.where(known, low, 0.0))
    return np.where(known, steep, np.nan)


def _hits(frame: StackFrame, grid: Grid, median: FloatArray, slope: FloatArray, response: float) -> BoolArray:
    cut = _covered(frame, grid)
    line, pixel = np.indices(frame.bad.shape)[(slice(None), *cut)]
    own = np.stack([pixel.ravel(), line.ravel()], axis=1).astype(np.float64)
    there = grid.index(grid.from_frame(own, frame))
    expected, steep = (_at(values, there).reshape(line.shape) for values in (median, slope))
    off = np.abs(frame.signal_dn[cut] / response - expected) - SLOPE_PART * steep
    sigmas = np.nan_to_num(off * response / frame.noise_dn[cut], nan=0.0)
    core = sigmas > HIT_SIGMAS
    hit = np.zeros(frame.bad.shape, dtype=bool)
    hit[cut] = core | (ndimage.binary_dilation(core, EIGHT) & (sigmas > SKIRT_SIGMAS))
    return hit


def _covered(frame: StackFrame, grid: Grid) -> tuple[slice, slice]:
    """Lines and pixels of a picture that the grid lies on."""
    places = grid.to_frame(grid.centers(), frame)
    seen = places[np.asarray(np.isfinite(places).all(axis=1))]
    if not len(seen):
        return slice(0), slice(0)
    left, top = (max(round(float(edge)), 0) for edge in seen.min(axis=0))
    right, bottom = (max(round(float(edge)), -1) for edge in seen.max(axis=0))
    return slice(top, bottom + 1), slice(left, right + 1)


def _at(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values at places (n, 2) of a picture, bilinear; nan outside and beside unknown pixels."""
    known = np.asarray(np.isfinite(places).all(axis=1))
    coordinates = np.where(known[:, None], places, -1e6).T[::-1]
    return np.asarray(ndimage.map_coordinates(values, coordinates, order=1, mode="constant", cval=np.nan))
