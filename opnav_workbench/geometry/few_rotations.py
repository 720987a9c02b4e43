"""Single rotations between matrices, quaternions and rotation vectors, to the bit as SciPy's `Rotation` turns them.

SciPy's takes a tenth of a star frame's processor time to load, and a picture has one attitude: `rotations` takes these for a
few, SciPy's for many. Quaternions are SciPy's: scalar last, of length one.

Sources: Markley (2008), Unit quaternion from rotation matrix, doi:10.2514/1.31730 (of the four forms the one whose largest
term is largest); SciPy's series for small angles.
"""

import math
from collections.abc import Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray

__all__ = [
    "matrix_of_quaternion",
    "quaternion_of_matrix",
    "quaternion_of_vector",
    "unit_quaternion",
    "vector_of_quaternion",
]

SMALL_RAD = 1e-3  # of which the series are exact to rounding
ORTHOGONAL = 1e-12  # error of a matrix times its transposed one that is rounding
RELATIVE = 1e-5  # beside that, of numpy's comparison

Quaternion = tuple[float, float, float, float]


def unit_quaternion(xyzw: Sequence[float]) -> Quaternion:
    """Return a quaternion of length one."""
    x, y, z, w = xyzw
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def quaternion_of_vector(vector: FloatArray) -> Quaternion:
    """Return the quaternion of a rotation vector (3,), rad."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle <= SMALL_RAD:
        square = angle * angle
        scale = 0.5 - square / 48 + square * square / 3840
    else:
        scale = math.sin(angle / 2) / angle
    return scale * x, scale * y, scale * z, math.cos(angle / 2)


def vector_of_quaternion(xyzw: Quaternion) -> tuple[float, float, float]:
    """Return the rotation vector, of length 0..pi rad; of a half turn the first part that is not 0 is positive."""
    x, y, z, w = xyzw
    if (w, x, y, z) < (0.0, 0.0, 0.0, 0.0):
        x, y, z, w = -x, -y, -z, -w
    angle = 2 * math.atan2(math.sqrt(x * x + y * y + z * z), w)
    if angle <= SMALL_RAD:
        square = angle * angle
        scale = 2 + square / 12 + 7 * square * square / 2880
    else:
        scale = angle / math.sin(angle / 2)
    return scale * x, scale * y, scale * z


def matrix_of_quaternion(xyzw: Quaternion) -> list[list[float]]:
    """Return the rotation matrix of a quaternion of length one, by rows."""
    x, y, z, w = xyzw
    x2, y2, z2, w2 = x * x, y * y, z * z, w * w
    xy, zw, xz, yw, yz, xw = x * y, z * w, x * z, y * w, y * z, x * w
    return [
        [x2 - y2 - z2 + w2, 2 * (xy - zw), 2 * (xz + yw)],
        [2 * (xy + zw), -x2 + y2 - z2 + w2, 2 * (yz - xw)],
        [2 * (xz - yw), 2 * (yz + xw), -x2 - y2 + z2 + w2],
    ]


def quaternion_of_matrix(matrix: FloatArray) -> Quaternion:
    """Return the quaternion of a rotation matrix (3, 3), of the nearest one where it is not orthogonal to rounding."""
    product = matrix @ matrix.T
    if not np.all(np.abs(product - np.eye(3)) <= ORTHOGONAL + RELATIVE * np.eye(3)):
        left, _, right = np.linalg.svd(matrix[None], full_matrices=False)
        matrix = (left @ right)[0]
    m = matrix.tolist()
    terms = [m[0][0], m[1][1], m[2][2], m[0][0] + m[1][1] + m[2][2]]
    largest = terms.index(max(terms))
    if largest == 3:
        return unit_quaternion(
            (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1.0 + terms[3]),
        )
    i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
    found = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
    found[i] = 1.0 - terms[3] + 2.0 * m[i][i]
    found[j], found[k] = m[j][i] + m[i][j], m[k][i] + m[i][k]
    return unit_quaternion(found)
