"""Closed-form attitude from pairs of directions: Wahba's problem.

Minimises sum w |observed - A reference|^2 over rotations A, from no start at all. Optimal only for errors that are
equal in all directions, without distortion's say on them: a start for the least squares, or a check on it.

References: Wahba (1965), doi:10.1137/1007077; SVD: Markley (1988), J. Astronautical Sciences 36, 245; q-method:
Davenport, in Wertz (ed.), Spacecraft Attitude Determination and Control (1978), doi:10.1007/978-94-009-9907-7, 12.2.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import matrix_from_quaternion

__all__ = ["ClosedForm", "wahba"]

ClosedForm = Literal["svd", "q_method"]
# Sum of the two smaller singular values of the attitude profile over the largest: below this a radian of twist changes
# the sum of squares by nothing but rounding (stars a microradian apart give 1e-12).
MIN_SPREAD = 1e-13


def wahba(
    observed: ArrayLike, reference: ArrayLike, weights: ArrayLike, method: ClosedForm = "svd"
) -> FloatArray:
    """Return the rotation (3, 3) that best takes reference directions onto observed ones.

    Parameters
    ----------
    observed : (n, 3) array_like
        Unit vectors, camera frame.
    reference : (n, 3) array_like
        The same stars, J2000; the result is camera_from_j2000.
    weights : (n,) array_like
        Inverse variances, in any common unit.
    method : {"svd", "q_method"}
        Singular values of the attitude profile matrix, or Davenport's largest eigenvector; the same attitude.

    Raises
    ------
    PointingError
        One star, or stars in one direction, which leave the rotation about it open; an unknown method.

    Examples
    --------
    >>> wahba([[0.0, 1, 0], [0, 0, 1]], [[1.0, 0, 0], [0, 0, 1]], [1.0, 1.0]).round(12) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    share = np.asarray(weights, dtype=np.float64)
    profile = np.einsum("n,ni,nj->ij", share / share.sum(), np.asarray(observed), np.asarray(reference))
    left, singular, right = np.linalg.svd(profile)
    sign = float(np.linalg.det(left) * np.linalg.det(right))
    if not singular[1] + sign * singular[2] > MIN_SPREAD * singular[0]:
        raise PointingError(
            f"{len(share)} stars in one direction leave the rotation about it open; "
            "start from the a priori attitude"
        )
    if method == "svd":
        return np.asarray(left @ np.diag([1.0, 1.0, np.sign(sign)]) @ right)
    if method == "q_method":
        return _davenport(profile)
    raise PointingError(f"unknown closed form {method!r}; use svd or q_method")


def _davenport(profile: FloatArray) -> FloatArray:
    """Rotation of the eigenvector of Davenport's matrix that belongs to its largest eigenvalue."""
    trace = np.trace(profile)
    # SPICE's quaternions turn vectors where Davenport's turn frames: the vector part changes its sign.
    z = np.array(
        [profile[2, 1] - profile[1, 2], profile[0, 2] - profile[2, 0], profile[1, 0] - profile[0, 1]]
    )
    matrix = np.empty((4, 4))
    matrix[0, 0], matrix[0, 1:], matrix[1:, 0] = trace, z, z
    matrix[1:, 1:] = profile + profile.T - trace * np.eye(3)
    return matrix_from_quaternion(np.linalg.eigh(matrix)[1][:, -1])
