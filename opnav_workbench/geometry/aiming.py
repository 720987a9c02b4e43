"""Attitudes that put a direction at a place on the detector, and turns of a camera about its own axes.

Frames  ``camera_from_j2000``; places are tangents from the boresight along pixel and line, without distortion.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry.rotations import (
    camera_from_j2000,
    radec_from_unit,
    rotation_from_vector,
    unit,
    wrapped,
)

__all__ = ["aim", "turn_about_boresight", "turn_across"]

ROUNDING = 1e-12  # rad


def aim(
    direction: ArrayLike,
    twist_rad: ArrayLike,
    focal_from_camera: ArrayLike,
    offset_rad: ArrayLike = (0.0, 0.0),
) -> FloatArray:
    """Return the attitudes (..., 3, 3) in which J2000 directions appear at an offset from the boresight.

    Parameters
    ----------
    direction : (..., 3) array_like
        J2000, of any length; this, the twist and the offset broadcast.
    twist_rad : (...) array_like
        Position angle of increasing line, east of J2000 north, at the boresight.
    focal_from_camera : (3, 3) array_like
        Rows: increasing pixel, increasing line and boresight, unit vectors in the camera frame.
    offset_rad : (..., 2) array_like
        Tangents of the offset along pixel and line.

    Raises
    ------
    ValueError
        `focal_from_camera` is not orthonormal; or a direction is so near a celestial pole that no boresight
        has it at that offset with that twist.

    Examples
    --------
    >>> focal = np.diag([1.0, 1.0, -1.0])
    >>> seen = focal @ aim([1.0, 0.0, 0.0], 0.3, focal, (1e-3, -2e-3)) @ [1.0, 0.0, 0.0]
    >>> (seen[:2] / seen[2]).round(12).tolist()
    [0.001, -0.002]
    """
    focal, twist = np.asarray(focal_from_camera, float), np.asarray(twist_rad, float)
    tangents = np.asarray(offset_rad, float)
    offset = unit(np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1))
    ra, dec = radec_from_unit(direction)
    boresight_dec = _boresight_dec(dec, twist, offset, float(np.sign(np.linalg.det(focal))))
    at_zero = camera_from_j2000(0.0, boresight_dec, twist, focal)
    # Turning about the celestial pole changes right ascension only; the declination is right already.
    there = np.swapaxes(at_zero, -1, -2) @ (offset @ focal)[..., None]
    ra_of_offset, _ = radec_from_unit(there[..., 0])
    return camera_from_j2000(ra - ra_of_offset, boresight_dec, twist, focal)


def _boresight_dec(
    dec_rad: FloatArray, twist_rad: FloatArray, offset: FloatArray, handedness: float
) -> FloatArray:
    """Return the boresight's declination at which the offset directions (..., 3) have the declination `dec_rad`.

    In focal axes the celestial pole is ``(-h sin t cos d, cos t cos d, sin d)``, with handedness h, twist t
    and boresight declination d; its product with the offset, ``a cos d + b sin d``, is the sine of `dec_rad`.
    The root is taken from ``cos(dec)``, which keeps its digits at the pole.
    """
    sine, cosine = np.sin(twist_rad), np.cos(twist_rad)
    x, y, b = (offset[..., i] for i in range(3))
    a = y * cosine - handedness * x * sine
    across = np.abs(y * sine + handedness * x * cosine)
    reach = np.cos(dec_rad)
    half = np.arctan2(np.sqrt(np.maximum(0.0, (reach - across) * (reach + across))), np.sin(dec_rad))
    middle = np.arctan2(b, a)
    roots = np.stack(np.broadcast_arrays(*(wrapped(middle + side * half) for side in (-1.0, 1.0))))
    first = np.abs(roots[0] - dec_rad) <= np.abs(roots[1] - dec_rad)
    best = np.where(first, roots[0], roots[1])
    held = (reach > across - ROUNDING) & (np.abs(best) <= math.pi / 2 + ROUNDING)
    _refuse(held, dec_rad, twist_rad)
    return np.asarray(np.clip(best, -math.pi / 2, math.pi / 2))


def _refuse(held: FloatArray, dec_rad: FloatArray, twist_rad: FloatArray) -> None:
    if np.all(held):
        return
    held, dec, twist = np.broadcast_arrays(held, dec_rad, twist_rad)
    worst = int(np.argmin(held))
    raise ValueError(
        f"declination {math.degrees(dec.flat[worst]):.4f} deg cannot be held at that offset with twist "
        f"{math.degrees(twist.flat[worst]):.4f} deg: too close to the pole; change offset or twist"
    )


def turn_across(angles_rad: ArrayLike, focal_from_camera: ArrayLike) -> FloatArray:
    """Return the turns (..., 3, 3) of a camera that move its boresight's sky over the detector, without roll.

    Parameters
    ----------
    angles_rad : (..., 2) array_like
        Angle along pixel and line; the sky goes along a great circle.

    Returns
    -------
    (..., 3, 3) array
        Multiply from the left: ``turn @ camera_from_j2000``.

    Examples
    --------
    >>> turn = turn_across([0.1, 0.0], np.eye(3))
    >>> (turn @ [0.0, 0.0, 1.0]).round(6).tolist()
    [0.099833, 0.0, 0.995004]
    """
    focal, angles = np.asarray(focal_from_camera, float), np.asarray(angles_rad, float)
    toward = angles @ focal[:2]
    return rotation_from_vector(np.cross(focal[2], toward))


def turn_about_boresight(angle_rad: ArrayLike, focal_from_camera: ArrayLike) -> FloatArray:
    """Return the turns (..., 3, 3) of a camera about its boresight that add `angle_rad` (...) to the twist.

    Examples
    --------
    >>> from opnav_workbench.geometry import pointing_angles
    >>> lorri = np.diag([1.0, 1.0, -1.0])
    >>> attitude = camera_from_j2000(1.0, 0.5, 0.3, lorri)
    >>> round(pointing_angles(turn_about_boresight(0.01, lorri) @ attitude, lorri)[2], 9)
    0.31
    """
    focal = np.asarray(focal_from_camera, float)
    # Seen from inside the sphere east is left of north: what turns the sky clockwise on the detector adds twist.
    return rotation_from_vector(np.asarray(angle_rad, float)[..., None] * focal[2])
