"""Charge that overexposed pixels have spilled along their columns (or lines): bright, and yet no body.

It runs as much up as down, so that the middle of a saturated run is the body's, whatever its length. One that the
picture's edge cuts has no middle that is known: the body may lie anywhere in it.
"""

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import BoolArray, FloatArray, pixel_runs
from opnav_workbench.bodies.picture import BodyPicture

__all__ = ["without_filled", "without_spilled"]


LONGER = 1.3  # than the body and than the run across it: no body is so much larger than it should be
CORE_SIGMAS = 3.0  # of the PSF, to each side: how far light alone saturates
PARTLY_FILLED_PX = 2  # where a run ends: bright, if not saturated


def without_filled(picture: BodyPicture) -> BodyPicture:
    """Return the picture with columns and lines that charge fills from edge to edge not known: a body may lie in them.

    A body that is larger than the picture fills it too.
    """
    if not picture.saturated.any():
        return picture
    widest_px = max((picture.diameter_px(model.target.name) for model in picture.models), default=0.0)
    filled = np.zeros(picture.saturated.shape, dtype=bool)
    for plane, saturated in ((filled, picture.saturated), (filled.T, picture.saturated.T)):
        _, first, past = pixel_runs(np.asarray(saturated.all(axis=0))[None])
        for start, stop in zip(first, past, strict=True):
            if len(plane) > LONGER * max(stop - start, widest_px):
                plane[:, start:stop] = True
    return picture.with_spilled(filled) if filled.any() else picture


def without_spilled(picture: BodyPicture, diameter_px: float) -> BodyPicture:
    """Return the picture with what lies beyond the middle of saturated runs not known, as if it were bad.

    A run counts as spilled if it is longer than a body of that diameter and than the run across it: a body that is larger
    than it should be has both. Of one that reaches the picture's edge nothing is known.
    """
    if not picture.saturated.any():
        return picture
    width_px = LONGER * diameter_px + 2.0 * CORE_SIGMAS * float(np.max(picture.psf.sigma_px))
    down, across = (_runs(picture.saturated, axis) for axis in (0, 1))
    spilled = _ends(down, across, width_px) | _ends(across, down, width_px)
    if not spilled.any():
        return picture
    kept = picture.saturated & ~spilled
    return picture.with_spilled(binary_dilation(spilled, iterations=PARTLY_FILLED_PX) & ~kept)


def _ends(
    along: tuple[FloatArray, FloatArray], across: tuple[FloatArray, FloatArray], width_px: float
) -> BoolArray:
    (length, away), (other, _) = along, across
    return np.asarray((length > np.maximum(width_px, LONGER * other)) & (away > 0.5 * width_px))


def _runs(mask: BoolArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Return the length of the run that each pixel lies in, and how far from its middle: infinitely, if an edge cuts it."""
    lines = np.moveaxis(mask, axis, -1)
    row, first, past = pixel_runs(lines)
    count = past - first
    length, away = np.zeros(lines.shape), np.zeros(lines.shape)
    cell = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    at = np.repeat(row, count), np.repeat(first, count) + cell
    cut = (first == 0) | (past == lines.shape[1])
    length[at] = np.repeat(count, count)
    away[at] = np.where(np.repeat(cut, count), np.inf, np.abs(cell - np.repeat(0.5 * (count - 1), count)))
    return np.moveaxis(length, -1, axis), np.moveaxis(away, -1, axis)
