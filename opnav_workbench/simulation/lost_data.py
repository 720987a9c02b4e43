"""Data that never reached the ground: whole lines and square blocks."""

import numpy as np

from opnav_workbench.arrays import BoolArray
from opnav_workbench.simulation.effects import LostData

__all__ = ["draw_lost_data"]


def draw_lost_data(settings: LostData, shape: tuple[int, int], rng: np.random.Generator) -> BoolArray:
    """Return which pixels (n_line, n_pixel) are lost.

    Examples
    --------
    >>> int(draw_lost_data(LostData(lines=2), (8, 5), np.random.default_rng(0)).sum())
    10
    """
    n_line, n_pixel = shape
    lost = np.zeros(shape, dtype=bool)
    lost[rng.permutation(n_line)[: settings.lines]] = True
    side = settings.block_px
    corners = rng.random((settings.blocks, 2)) * [max(n_line - side, 0) + 1, max(n_pixel - side, 0) + 1]
    for line, pixel in corners.astype(np.int64):
        lost[line : line + side, pixel : pixel + side] = True
    return lost
