"""Masks as runs of pixels, so that a few bad columns do not cost a picture."""

import numpy as np

from opnav_workbench.arrays import BoolArray
from opnav_workbench.widgets.overlays import Columns

__all__ = ["mask_runs"]

MOST_RUNS = 20_000  # more are drawn coarser, in blocks of pixels; nobody sees single ones then


def mask_runs(mask: BoolArray) -> Columns:
    """Return runs of marked pixels along lines, as rectangles: left, right, top, bottom, in px with edges at halves.

    Examples
    --------
    >>> mask_runs(np.array([[False, True, True, False], [True, False, False, True]]))["left"]
    array([ 0.5, -0.5,  2.5])
    """
    block = 1
    while True:
        coarse = _coarse(mask, block)
        line, first, past = _runs(coarse)
        if len(line) <= MOST_RUNS:
            break
        block *= 2
    n_line, n_pixel = mask.shape
    return {
        "left": block * first - 0.5,
        "right": np.minimum(block * past, n_pixel) - 0.5,
        "top": block * line - 0.5,
        "bottom": np.minimum(block * (line + 1), n_line) - 0.5,
    }


def _coarse(mask: BoolArray, block: int) -> BoolArray:
    if block == 1:
        return mask
    padded = np.pad(mask, [(0, -size % block) for size in mask.shape])
    shape = (padded.shape[0] // block, block, padded.shape[1] // block, block)
    return np.asarray(padded.reshape(shape).any(axis=(1, 3)))


def _runs(mask: BoolArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Line, first and one-past-last pixel of each run."""
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    line, first = np.nonzero(steps == 1)
    _, past = np.nonzero(steps == -1)
    return line, first, past
