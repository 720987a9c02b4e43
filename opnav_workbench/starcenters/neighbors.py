"""Which stars must be fitted together: chains of neighbors that lie in each other's boxes."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["groups_of", "link_neighbors", "pairs_within"]

MAX_MEMBERS = 8  # of one group: larger chains are cut at their widest gaps
CUT_STEP = 0.97  # factor on the linking length of groups that are too large


def pairs_within(places: FloatArray, radius_px: float, p: float = 2.0) -> IntArray:
    """Return pairs (m, 2), i < j, of places (n, 2) nearer than `radius_px`; p = inf counts along each axis."""
    tree = cKDTree(places)
    return np.asarray(tree.query_pairs(radius_px, p=p, output_type="ndarray"), np.int64).reshape(-1, 2)


def link_neighbors(
    places: FloatArray, joinable: BoolArray, radius_px: float, too_close_px: float
) -> IntArray:
    """Return a label (n,) for each place: equal for those that belong together.

    Parameters
    ----------
    places : (n, 2) array
    joinable : (n,) array of bool
        The others stay alone.
    radius_px : float
        Along each axis: neighbors in a box of twice this size are linked.
    too_close_px : float
        Of two places nearer than this, one source for the fit, the second stays alone.
    """
    joinable = joinable.copy()
    joinable[pairs_within(places, too_close_px)[:, 1]] = False
    labels = np.arange(len(places))
    pairs = pairs_within(places, radius_px, p=np.inf)
    pairs = pairs[joinable[pairs].all(axis=1)]
    distance = np.abs(np.diff(places[pairs], axis=1)[:, 0]).max(axis=1)
    while len(pairs):
        labels = _components(len(places), pairs)
        crowded = np.bincount(labels)[labels[pairs[:, 0]]] > MAX_MEMBERS
        if not crowded.any():
            break
        longest = distance[crowded].max()
        keep = ~crowded | (distance < CUT_STEP * longest)
        pairs, distance = pairs[keep], distance[keep]
        labels = np.arange(len(places))
    return labels


def groups_of(labels: IntArray, chosen: BoolArray) -> list[IntArray]:
    """Return the chosen stars as arrays (g, k), one for each group size k: rows are groups, brothers by row."""
    stars = np.flatnonzero(chosen)
    stars = stars[np.argsort(labels[stars], kind="stable")]
    _, start, count = np.unique(labels[stars], return_index=True, return_counts=True)
    return [stars[start[count == k][:, None] + np.arange(k)] for k in np.unique(count)]


def _components(n: int, pairs: IntArray) -> IntArray:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
