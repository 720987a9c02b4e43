"""Charge that overexposed pixels have spilled along their columns (or lines): bright, and yet no body.

It runs as much up as down, so that the middle of a saturated run is the body's, whatever its length.
"""

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import BoolArray, FloatArray, pixel_runs
from opnav_workbench.bodies.picture import BodyPicture

__all__ = ["without_spilled"]


LONGER = 1.3
PARTLY_FILLED_PX = 2  # where a run ends: bright, if not saturated


def without_spilled(picture: BodyPicture, width_px: float) -> BodyPicture:
    """Return the picture with what lies beyond the middle `width_px` of saturated runs not known, as if it were bad.

    A run counts as spilled if it is longer than that and than the run across it: a body that is larger than it should be
    has both. The middle of one that reaches the picture's edge is not known.
    """
    if not picture.saturated.any():
        return picture
    down, across = (_runs(picture.saturated, axis) for axis in (0, 1))
    spilled = _ends(down, across, width_px) | _ends(across, down, width_px)
    kept = picture.saturated & ~spilled
    about = binary_dilation(spilled, iterations=PARTLY_FILLED_PX) & ~kept if spilled.any() else spilled
    return picture.without(about)


def _ends(
    along: tuple[FloatArray, FloatArray], across: tuple[FloatArray, FloatArray], width_px: float
) -> BoolArray:
    (length, away), (other, _) = along, across
    long = np.isfinite(length) & (length > np.maximum(width_px, LONGER * other))
    return np.asarray(long & (away > 0.5 * width_px))


def _runs(mask: BoolArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Return the length of the run that each pixel lies in, and how far from its middle; infinite runs reach the edge."""
    lines = np.moveaxis(mask, axis, -1)
    row, first, past = pixel_runs(lines)
    count = past - first
    length, away = np.zeros(lines.shape), np.zeros(lines.shape)
    cell = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    at = np.repeat(row, count), np.repeat(first, count) + cell
    cut = (first == 0) | (past == lines.shape[1])
    length[at] = np.repeat(np.where(cut, np.inf, count), count)
    away[at] = np.abs(cell - np.repeat(0.5 * (count - 1), count))
    return np.moveaxis(length, -1, axis), np.moveaxis(away, -1, axis)
