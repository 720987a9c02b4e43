"""Directions and attitudes: RA/Dec, boresight angles, quaternions and rotation vectors.

Frames      ``v_camera = camera_from_j2000 @ v_j2000``; `camera` is the instrument's own SPICE frame
Focal axes  rows of ``focal_from_camera``: increasing pixel, increasing line, boresight toward the sky.
            A camera that shows the sky mirrored has focal axes of determinant -1; nothing else changes.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import few_rotations
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    from scipy.spatial import transform
else:  # for many rotations at once
    transform = module_on_demand("scipy.spatial.transform")

__all__ = [
    "angle_between",
    "camera_from_j2000",
    "checked_rotation",
    "least_turn",
    "matrix_from_quaternion",
    "pointing_angle_arrays",
    "pointing_angles",
    "quaternion_from_matrix",
    "radec_from_unit",
    "rotation_from_vector",
    "tangent_basis",
    "tangent_offset",
    "unit",
    "unit_from_radec",
    "vector_from_rotation",
    "wrapped",
]


# Largest |m m^T - 1|: lets matrices through that were printed with 7 digits, stops swapped or scaled axes.
ORTHOGONALITY_TOLERANCE = 1e-6
TWO_PI = 2.0 * np.pi
FEW = 16  # rotations, in a tenth of a millisecond; SciPy's are loaded in 80


def unit(vectors: ArrayLike) -> FloatArray:
    """Return `vectors` (..., 3) scaled to length one.

    Raises
    ------
    ValueError
        A vector has length zero; non-finite vectors stay non-finite.
    """
    array = np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if np.any(length == 0.0):
        raise ValueError("a zero vector has no direction; give vectors of non-zero length")
    return np.asarray(array / length)


def unit_from_radec(ra_rad: ArrayLike, dec_rad: ArrayLike) -> FloatArray:
    """Return the unit vectors (..., 3) of right ascensions and declinations, which broadcast.

    Examples
    --------
    >>> unit_from_radec(0.0, 0.0)
    array([1., 0., 0.])
    """
    ra, dec = np.broadcast_arrays(np.asarray(ra_rad, float), np.asarray(dec_rad, float))
    cos_dec = np.cos(dec)
    vectors = np.empty((*ra.shape, 3))
    vectors[..., 0], vectors[..., 1] = cos_dec * np.cos(ra), cos_dec * np.sin(ra)
    vectors[..., 2] = np.sin(dec)
    return vectors


def radec_from_unit(directions: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return right ascension in [0, 2 pi) and declination of vectors (..., 3) of any length, in rad."""
    x, y, z = np.moveaxis(np.asarray(directions, float), -1, 0)
    # atan2 and not arcsin: an arcsin loses half of its digits at the poles.
    return _wrap(np.arctan2(y, x)), np.asarray(np.arctan2(z, np.hypot(x, y)))


def tangent_basis(ra_rad: ArrayLike, dec_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the unit vectors (..., 3) toward east and north on the sky at a position.

    Source: ESA (1997), The Hipparcos and Tycho Catalogues, vol. 1, section 1.2.8 (its p and q).

    Examples
    --------
    >>> east, north = tangent_basis(0.0, 0.0)
    >>> east.tolist(), north.tolist()
    ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    """
    ra, dec = np.broadcast_arrays(np.asarray(ra_rad, float), np.asarray(dec_rad, float))
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    east = np.stack([0.0 - sin_ra, cos_ra, np.zeros_like(ra)], axis=-1)  # 0 - x: no negative zeros
    north = np.stack([0.0 - sin_dec * cos_ra, 0.0 - sin_dec * sin_ra, cos_dec], axis=-1)
    return east, north


def tangent_offset(
    vectors: FloatArray, directions: FloatArray, tangent: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where vectors stand on the tangent planes of n directions, and the derivative of that.

    The gnomonic offset e = T v / (v.u) from the direction u with the tangent axes T, and de/dv = (T - e u') / (v.u).

    Parameters
    ----------
    vectors, directions : (n, 3) arrays
        Vectors of any length, each within 90 deg of its unit direction.
    tangent : (n, 2, 3) array
        Unit vectors across each direction, such as east and north.

    Returns
    -------
    offset : (n, 2) array
        rad, for small ones.
    by_vector : (n, 2, 3) array

    Examples
    --------
    >>> offset, _ = tangent_offset(np.array([[2.0, 0.002, 0.0]]), np.eye(3)[:1], np.eye(3)[None, 1:])
    >>> offset.tolist()
    [[0.001, 0.0]]
    """
    along = np.sum(vectors * directions, axis=1)
    offset = np.einsum("nij,nj->ni", tangent, vectors / along[:, None])
    return offset, (tangent - offset[:, :, None] * directions[:, None]) / along[:, None, None]


def angle_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the angle in rad between vectors (..., 3) of any length; exact to rounding at 0 and pi too.

    Examples
    --------
    >>> float(angle_between([1.0, 0.0, 0.0], [1.0, 1e-12, 0.0]))
    1e-12
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(sine, np.sum(a * b, axis=-1)))


def least_turn(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Return the shortest rotation vectors (..., 3) that take unit vectors (..., 3) to others; 0 where they are opposite.

    Examples
    --------
    >>> least_turn([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]).round(6)
    array([0.      , 0.      , 1.570796])
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.sum(start * end, axis=-1, keepdims=True))
    return np.asarray(axis * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 0.0))


def wrapped(angle_rad: ArrayLike) -> FloatArray:
    """Bring angles into [-pi, pi], with the digits of ``math.remainder``.

    Examples
    --------
    >>> float(wrapped(7.0)) == math.remainder(7.0, math.tau)  # with ``import math``
    True
    """
    angle = np.asarray(angle_rad, float)
    return np.asarray(angle - math.tau * np.rint(angle / math.tau))


def camera_from_j2000(
    ra_rad: ArrayLike, dec_rad: ArrayLike, twist_rad: ArrayLike, focal_from_camera: ArrayLike
) -> FloatArray:
    """Return the attitude matrices (..., 3, 3) of a camera from its boresight and twist.

    Parameters
    ----------
    ra_rad, dec_rad : (...) array_like
        J2000 direction of the boresight; these and the twist broadcast.
    twist_rad : (...) array_like
        Position angle, east of J2000 north, of the direction of increasing line at the boresight.
    focal_from_camera : (3, 3) array_like
        Rows: directions of increasing pixel, increasing line and boresight, unit vectors in the camera frame.

    Raises
    ------
    ValueError
        `focal_from_camera` is not orthonormal, or an angle is not finite.

    Examples
    --------
    LORRI looks along its -Z axis, with +X along pixel and +Y along line.

    >>> lorri = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]
    >>> attitude = camera_from_j2000(3.0, 0.5, 1.0, lorri)
    >>> bool(np.allclose(attitude @ unit_from_radec(3.0, 0.5), [0, 0, -1]))
    True
    >>> print("%.6f %.6f %.6f" % pointing_angles(attitude, lorri))
    3.000000 0.500000 1.000000
    """
    if not all(np.all(np.isfinite(angle)) for angle in (ra_rad, dec_rad, twist_rad)):
        raise ValueError(f"RA {ra_rad!r}, Dec {dec_rad!r}, twist {twist_rad!r} rad: all three must be finite")
    focal, handedness = _focal_axes(focal_from_camera)
    east, north = tangent_basis(ra_rad, dec_rad)
    boresight = unit_from_radec(ra_rad, dec_rad)
    twist = np.asarray(twist_rad, float)[..., None]
    line = np.cos(twist) * north + np.sin(twist) * east
    axes = np.broadcast_arrays(handedness * np.cross(line, boresight), line, boresight)
    return np.asarray(focal.T @ np.stack(axes, axis=-2))


def pointing_angles(camera_from_j2000: ArrayLike, focal_from_camera: ArrayLike) -> tuple[float, float, float]:
    """Return boresight RA in [0, 2 pi), Dec and twist in [0, 2 pi) of an attitude, in rad.

    The inverse of `camera_from_j2000`. At a celestial pole RA alone carries no information, but the three
    angles together still give the attitude back.

    Raises
    ------
    ValueError
        The attitude is not a rotation, or `focal_from_camera` is not orthonormal.
    """
    ra, dec, twist = pointing_angle_arrays(camera_from_j2000, focal_from_camera)
    return float(ra), float(dec), float(twist)


def pointing_angle_arrays(
    camera_from_j2000: ArrayLike, focal_from_camera: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return `pointing_angles` of attitudes (..., 3, 3) as three arrays (...)."""
    focal, _ = _focal_axes(focal_from_camera)
    axes = focal @ checked_rotation(camera_from_j2000, "camera_from_j2000")
    line, boresight = axes[..., 1, :], axes[..., 2, :]
    ra, dec = radec_from_unit(boresight)
    east, north = tangent_basis(ra, dec)
    twist = np.arctan2(np.sum(line * east, axis=-1), np.sum(line * north, axis=-1))
    return ra, dec, _wrap(twist)


def quaternion_from_matrix(m: ArrayLike) -> FloatArray:
    """Return the SPICE quaternion (..., 4) of rotation matrices (..., 3, 3), as ``m2q`` does.

    Scalar first and never negative; ``matrix_from_quaternion`` gives the same matrix back. A half turn, whose
    scalar is zero, may come out with the opposite sign of ``m2q``.

    Source: NAIF, Rotations Required Reading, "Quaternions".

    Raises
    ------
    ValueError
        A matrix is not a rotation.

    Examples
    --------
    >>> quaternion_from_matrix(np.eye(3))
    array([1., 0., 0., 0.])
    """
    matrices = checked_rotation(m)
    flat = matrices.reshape(-1, 3, 3)
    if len(flat) <= FEW:
        xyzw = np.array([few_rotations.quaternion_of_matrix(m) for m in flat]).reshape(-1, 4)
    else:
        xyzw = transform.Rotation.from_matrix(flat).as_quat()
    wxyz = np.roll(xyzw, 1, axis=-1).reshape(*matrices.shape[:-2], 4)
    return np.asarray(np.where(wxyz[..., :1] < 0.0, -wxyz, wxyz) + 0.0)  # + 0.0: no negative zeros


def matrix_from_quaternion(q: ArrayLike) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of SPICE quaternions (..., 4) of any length, as ``q2m`` does.

    Source: NAIF, Rotations Required Reading, "Quaternions".

    Raises
    ------
    ValueError
        A quaternion has length zero or is not finite.
    """
    wxyz = np.asarray(q, float)
    length = np.linalg.norm(wxyz, axis=-1)
    if not np.all(np.isfinite(length) & (length > 0.0)):
        raise ValueError(f"quaternion {wxyz.tolist()} gives no rotation; it must be finite and not zero")
    xyzw = np.roll(wxyz, -1, axis=-1).reshape(-1, 4)
    if len(xyzw) <= FEW:
        made = [few_rotations.matrix_of_quaternion(few_rotations.unit_quaternion(q)) for q in xyzw.tolist()]
        return np.array(made).reshape(*wxyz.shape[:-1], 3, 3)
    return np.asarray(transform.Rotation.from_quat(xyzw).as_matrix().reshape(*wxyz.shape[:-1], 3, 3))


def rotation_from_vector(rotvec_rad: ArrayLike) -> FloatArray:
    """Return the matrices (..., 3, 3) that turn vectors by ``|rotvec|`` about ``rotvec`` (..., 3).

    The active rotation: for a small vector ``m @ v = v + cross(rotvec, v)``.

    Examples
    --------
    >>> rotation_from_vector([0.0, 0.0, np.pi / 2]).round(12) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    vectors = np.array(rotvec_rad, float)  # a copy: SciPy takes no read-only arrays
    flat = vectors.reshape(-1, 3)
    matrices: Any
    if len(flat) <= FEW and np.isfinite(flat).all():
        quaternions = map(few_rotations.quaternion_of_vector, flat)
        matrices = np.array([few_rotations.matrix_of_quaternion(q) for q in quaternions])
    else:
        matrices = transform.Rotation.from_rotvec(flat).as_matrix()
    return np.asarray(matrices.reshape(*vectors.shape[:-1], 3, 3))


def vector_from_rotation(m: ArrayLike) -> FloatArray:
    """Return the rotation vectors (..., 3) in rad, of length 0..pi, of rotation matrices (..., 3, 3).

    Raises
    ------
    ValueError
        A matrix is not a rotation.
    """
    matrices = checked_rotation(m)
    flat = matrices.reshape(-1, 3, 3)
    vectors: Any
    if len(flat) <= FEW:
        quaternions = map(few_rotations.quaternion_of_matrix, flat)
        vectors = np.array([few_rotations.vector_of_quaternion(q) for q in quaternions])
    else:
        vectors = transform.Rotation.from_matrix(flat).as_rotvec()
    return np.asarray(vectors.reshape(matrices.shape[:-1]))


def checked_rotation(m: ArrayLike, name: str = "matrix") -> FloatArray:
    """Return rotation matrices (..., 3, 3) as float64; `name` is used in the message.

    Raises
    ------
    ValueError
        A matrix is not orthonormal to 1e-6, or it mirrors.
    """
    matrices = np.asarray(m, float)
    _check_orthonormal(matrices, name)
    if np.any(np.linalg.det(matrices) < 0.0):
        raise ValueError(f"{name} has determinant -1: it mirrors; exchange or reverse one of its axes")
    return matrices


def _wrap(angle_rad: FloatArray) -> FloatArray:
    """Bring angles into [0, 2 pi); the remainder of a tiny negative angle rounds to 2 pi itself."""
    wrapped = np.mod(angle_rad, TWO_PI)
    return np.asarray(np.where(wrapped >= TWO_PI, 0.0, wrapped))


def _focal_axes(focal_from_camera: ArrayLike) -> tuple[FloatArray, float]:
    """Return the checked focal axes and their handedness, +1 or -1 (mirrored)."""
    focal = np.asarray(focal_from_camera, float)
    _check_orthonormal(focal, "focal_from_camera")
    return focal, float(np.sign(np.linalg.det(focal)))


def _check_orthonormal(matrices: FloatArray, name: str) -> None:
    if matrices.shape[-2:] != (3, 3):
        raise ValueError(f"{name} has shape {matrices.shape}, expected (..., 3, 3)")
    error = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3))
    if not np.all(error <= ORTHOGONALITY_TOLERANCE):  # "not <=" catches nan as well
        raise ValueError(
            f"{name} is not orthonormal: off by {np.max(error):.3g}, limit {ORTHOGONALITY_TOLERANCE:g}; "
            "give unit vectors at right angles"
        )
