"""Covariance of several bodies' O-C: bodies of one picture share its pointing error."""

from collections.abc import Mapping, Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.bodycenters import JointCenters
from opnav_workbench.observables.observable import Observable

__all__ = ["center_cross", "cross_covariance_px2", "joint_covariance_px2"]


def center_cross(joint: JointCenters, name: str) -> Mapping[str, FloatArray]:
    """Return the covariances (2, 2) px^2 of one body's center (rows) with the others found jointly (columns).

    Parameters
    ----------
    joint : JointCenters
    name : str

    Raises
    ------
    CenterfindingError
        The body is not among them.
    """
    joint.center(name)
    names = [center.name for center in joint.centers]
    row = 2 * names.index(name)
    cross = np.asarray(joint.covariance_px2)[row : row + 2]
    return {
        other: cross[:, 2 * i : 2 * i + 2]
        for i, other in enumerate(names)
        if other != name and joint.centers[i].pixel_line is not None
    }


def cross_covariance_px2(first: Observable, second: Observable) -> FloatArray:
    """Return the covariance (2, 2) px^2 of two observables' O-C, rows of the first; zero for different pictures.

    Both share the picture's attitude error, eps: O-C = center error - J eps, so that the covariance is J P J'; centers
    found jointly have a share of their own.

    Notes
    -----
    Two methods on the same body use the same pixels; how their centers are correlated nobody computes. The result then
    holds the pointing's share alone.
    """
    cross = np.zeros((2, 2))
    if first.image != second.image:
        return cross
    left, right = first.partials_px_per_rad, second.partials_px_per_rad
    if left is not None and right is not None and first.attitude_covariance_rad2 is not None:
        cross = cross + left @ first.attitude_covariance_rad2 @ right.T
    if first.method == second.method and second.name in first.center_cross_px2:
        cross = cross + first.center_cross_px2[second.name]
    return cross


def joint_covariance_px2(observables: Sequence[Observable]) -> FloatArray:
    """Return the covariance (2 n, 2 n) px^2 of n observables' O-C: pixel 0, line 0, pixel 1, ...

    Blocks on the diagonal are `Observable.total_covariance_px2`, the others `cross_covariance_px2`; nan for an observable
    without a center.

    Examples
    --------
    >>> joint_covariance_px2([]).shape
    (0, 0)
    """
    n = len(observables)
    blocks = np.zeros((n, 2, n, 2))
    for i, first in enumerate(observables):
        blocks[i, :, i] = first.total_covariance_px2
        for j in (j for j in range(i) if observables[j].image == first.image):
            blocks[i, :, j] = cross_covariance_px2(first, observables[j])
            blocks[j, :, i] = blocks[i, :, j].T
    return symmetric(blocks.reshape(2 * n, 2 * n))
