"""Which places of a picture are near which others: SciPy's tree of many, compared one by one where they are few.

A star frame has some ten detections; to load the tree for them takes longer than to compare them. Both ways give the same.
"""

import numpy as np
import scipy

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["NearPlaces", "pairs_within"]

# Comparisons that take half a millisecond, sorted or for the nearest alone; the tree is loaded in 80.
FEW_SORTED, FEW = 10_000, 100_000


class NearPlaces:
    """Places (n, d) that are asked for those near others."""

    def __init__(self, places: FloatArray) -> None:
        self._places = np.array(places, dtype=np.float64)
        self._tree: scipy.spatial.cKDTree | None = None

    def nearest(
        self, asked: FloatArray, count: int = 1, within: float = np.inf
    ) -> tuple[FloatArray, IntArray]:
        """Return distances and rows of the places nearest to others.

        Parameters
        ----------
        asked : (m, d) array
        count
            How many for each.
        within
            Only what is nearer than this.

        Returns
        -------
        distance : (m,) array, (m, count) for several
            The nearest first; infinite where there is none.
        row : arrays of the same shape
            n where there is none.

        Examples
        --------
        >>> NearPlaces(np.array([[0.0, 0.0], [3.0, 4.0]])).nearest(np.array([[0.0, 1.0], [9.0, 9.0]]), within=2.0)
        (array([ 1., inf]), array([0, 2]))
        """
        if len(asked) * len(self._places) > (FEW if count == 1 else FEW_SORTED):
            if self._tree is None:
                self._tree = scipy.spatial.cKDTree(self._places)
            found = self._tree.query(asked, k=count, distance_upper_bound=within)
            return np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
        square = _squares(np.asarray(asked, np.float64), self._places)
        if count == 1 and len(self._places) > 0:
            order = square.argmin(axis=1)[:, None]
        else:
            order = np.argsort(square, axis=1, kind="stable")[:, :count]
        distance = np.full((len(asked), count), np.inf)
        row = np.full((len(asked), count), len(self._places))
        known = np.sqrt(np.take_along_axis(square, order, axis=1))
        near = np.take_along_axis(square, order, axis=1) < within * within
        distance[:, : order.shape[1]] = np.where(near, known, np.inf)
        row[:, : order.shape[1]] = np.where(near, order, len(self._places))
        return (distance[:, 0], row[:, 0]) if count == 1 else (distance, row)


def pairs_within(places: FloatArray, radius: float, *, along_axes: bool = False) -> IntArray:
    """Return pairs (m, 2), i < j, of places (n, d) not farther apart than `radius`, in no order.

    Parameters
    ----------
    along_axes
        The distance is that along each axis.

    Examples
    --------
    >>> pairs_within(np.array([[0.0, 0.0], [9.0, 9.0], [1.0, 1.0]]), 1.0, along_axes=True).tolist()
    [[0, 2]]
    """
    if len(places) ** 2 > FEW_SORTED:
        tree = scipy.spatial.cKDTree(places)
        found = tree.query_pairs(radius, p=np.inf if along_axes else 2.0, output_type="ndarray")
        return np.asarray(found, np.int64).reshape(-1, 2)
    places = np.asarray(places, np.float64)
    near: BoolArray
    if along_axes:
        near = np.all(np.abs(places[:, None] - places) <= radius, axis=2)
    else:
        near = _squares(places, places) <= radius * radius
    return np.argwhere(np.triu(near, 1))


def _squares(first: FloatArray, second: FloatArray) -> FloatArray:
    """Squared distances (m, n), summed axis by axis as the tree does."""
    total = np.zeros((len(first), len(second)))
    for axis in range(second.shape[1]):
        total += (first[:, None, axis] - second[:, axis]) ** 2
    return total
