"""Stretches of time: what lies between windows, and where windows of several files lie over one another."""

from collections.abc import Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray

__all__ = ["covered_share", "gaps_between", "overlaps_of"]

NONE = np.empty((0, 2))


def gaps_between(windows: FloatArray) -> FloatArray:
    """Return the gaps (m, 2) between disjoint windows (k, 2) in order.

    Examples
    --------
    >>> gaps_between(np.array([[0.0, 1.0], [3.0, 4.0]]))
    array([[1., 3.]])
    """
    return np.column_stack([windows[:-1, 1], windows[1:, 0]]) if len(windows) > 1 else NONE


def overlaps_of(windows: Sequence[FloatArray]) -> FloatArray:
    """Return where at least two of several sets of windows are valid, (m, 2), disjoint and in order.

    Windows that only touch do not overlap.

    Parameters
    ----------
    windows : sequence of (k, 2) arrays
        Each disjoint in itself.

    Examples
    --------
    >>> overlaps_of([np.array([[0.0, 2.0], [5.0, 6.0]]), np.array([[1.0, 5.0]])])
    array([[1., 2.]])
    """
    every = np.concatenate([*windows, NONE])
    edges = np.concatenate([every[:, 0], every[:, 1]])
    steps = np.repeat([1, -1], len(every))
    order = np.lexsort((steps, edges))  # at one instant ends come before starts
    depth = np.cumsum(steps[order])
    before = np.concatenate([[0], depth[:-1]])
    starts = edges[order][(before < 2) & (depth >= 2)]
    stops = edges[order][(before >= 2) & (depth < 2)]
    found = np.column_stack([starts, stops])
    return np.asarray(found[found[:, 1] > found[:, 0]], dtype=np.float64)


def covered_share(windows: FloatArray, edges: FloatArray) -> FloatArray:
    """Return how much of each cell between increasing edges the windows cover, 0 to 1, shape (n - 1,).

    Examples
    --------
    >>> covered_share(np.array([[1.0, 2.5]]), np.array([0.0, 1.0, 2.0, 3.0]))
    array([0. , 1. , 0.5])
    """
    starts, stops = windows.T
    lengths = np.concatenate([[0.0], np.cumsum(stops - starts)])
    index = np.searchsorted(starts, edges, side="right")  # windows that have begun
    beyond = np.maximum(stops[index - 1] - edges, 0.0) if len(windows) else np.zeros(len(edges))
    until = lengths[index] - np.where(index > 0, beyond, 0.0)
    return np.asarray(np.diff(until) / np.diff(edges), dtype=np.float64)
