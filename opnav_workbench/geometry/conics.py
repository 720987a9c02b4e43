"""Limb and terminator of a triaxial ellipsoid, and the ellipse that a limb draws in the picture.

Everything follows from one scaling: divide body coordinates by the radii, and the body becomes a unit
sphere. Lines of sight from a point at distance d > 1 touch it along a circle of radius sqrt(1 - 1/d^2), whose
center lies 1/d from the sphere's toward that point. The camera's circle is the limb, the Sun's circle is the
terminator (Sun as a point at its finite distance).

Frames  camera; positions in km from the camera to the body center, and from there to the Sun
Source  Christian (2021), IEEE Access 9, 19819, doi:10.1109/ACCESS.2021.3051914.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.geometry.rotations import checked_rotation, unit

__all__ = [
    "Ellipse",
    "ellipse_from_conic",
    "limb_cone",
    "limb_on_surface",
    "limb_points",
    "sphere_center_offset",
    "terminator_points",
]

# Ratio of a conic's two curvatures under which it is a parabola to rounding (an ellipse 10^6 times longer
# than wide would have it).
PARABOLA_RATIO = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """An ellipse in the plane of the conic it came from, and in that plane's units."""

    center: FloatArray  # (2,)
    semi_axes: FloatArray  # (2,) major, minor
    angle_rad: float  # of the major axis, from the first coordinate toward the second, in (-pi/2, pi/2]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def limb_cone(position_km: ArrayLike, radii_km: ArrayLike, camera_from_body: ArrayLike) -> FloatArray:
    """Return the cone of limb directions of an ellipsoid, as a quadratic form.

    Parameters
    ----------
    position_km : (3,) array_like
        Camera to body center, camera frame.
    radii_km : (3,) array_like
        Semi-axes along body x, y, z.
    camera_from_body : (3, 3) array_like
        ``v_camera = camera_from_body @ v_body``.

    Returns
    -------
    (3, 3) ndarray
        Symmetric S, with ``s @ S @ s == 0`` for a direction s (camera frame) to the limb, < 0 for one that
        hits the body. The cone opens to both sides: -s counts like s. Where image-plane coordinates u have
        ``s = K @ u`` the limb's conic is ``K.T @ S @ K``.

    Raises
    ------
    ValueError
        The camera is inside the body, the radii are not positive, or the matrix is not a rotation.

    Examples
    --------
    A sphere of radius 3 seen from 5: the limb stands 3/4 off the axis in the plane at unit distance.

    >>> cone = limb_cone([0, 0, 5], [3, 3, 3], np.eye(3))
    >>> ellipse_from_conic(cone).semi_axes
    array([0.75, 0.75])
    """
    radii, rotation = _body(radii_km, camera_from_body)
    camera = _outside(position_km, radii, rotation, "camera")
    scaled_from_camera = (rotation / radii).T
    # A r r^T A - (r^T A r - 1) A of the reference, divided by r^T A r - 1, so that it does not lose the
    # shape of a distant body beside its distance.
    along = scaled_from_camera.T @ camera
    shape = scaled_from_camera.T @ scaled_from_camera
    return symmetric(shape - np.outer(along, along) / (camera @ camera - 1.0))


def limb_points(
    position_km: ArrayLike, radii_km: ArrayLike, camera_from_body: ArrayLike, n: int = 180
) -> FloatArray:
    """Return `n` unit directions (n, 3) once around the limb of an ellipsoid, camera frame.

    Parameters and errors as in `limb_cone`.

    Examples
    --------
    >>> limb = limb_points([0, 0, 5], [3, 3, 3], np.eye(3), n=4)
    >>> np.hypot(limb[:, 0], limb[:, 1]).round(12)
    array([0.6, 0.6, 0.6, 0.6])
    """
    radii, rotation = _body(radii_km, camera_from_body)
    camera = _outside(position_km, radii, rotation, "camera")
    return _directions(_limb(camera, n) - camera, radii, rotation)


def limb_on_surface(
    position_km: ArrayLike, radii_km: ArrayLike, camera_from_body: ArrayLike, n: int = 180
) -> FloatArray:
    """Return the points (n, 3) of an ellipsoid's surface, body-fixed km, where lines of sight touch it.

    Parameters, order and errors as in `limb_points`.

    Examples
    --------
    >>> on_limb = limb_on_surface([0, 0, 5], [3, 3, 3], np.eye(3), n=4)
    >>> on_limb[:, 2].round(12) + 0.0
    array([-1.8, -1.8, -1.8, -1.8])
    """
    radii, rotation = _body(radii_km, camera_from_body)
    return np.asarray(_limb(_outside(position_km, radii, rotation, "camera"), n) * radii)


def terminator_points(
    position_km: ArrayLike,
    radii_km: ArrayLike,
    camera_from_body: ArrayLike,
    sun_position_km: ArrayLike,
    n: int = 180,
) -> FloatArray:
    """Return `n` unit directions along the visible part of the terminator of an ellipsoid, camera frame.

    Parameters
    ----------
    position_km, radii_km, camera_from_body
        As in `limb_cone`.
    sun_position_km : (3,) array_like
        Body center to Sun (a point), camera frame.
    n
        Number of points; they run along the arc from limb to limb, both ends included.

    Returns
    -------
    (n, 3) ndarray
        (0, 3) where the camera sees no terminator (full or new phase); a closed circle, without a repeated
        point, where it sees all of it.

    Raises
    ------
    ValueError
        Camera or Sun is inside the body, or as in `limb_cone`.

    Examples
    --------
    At a phase angle of 90 deg the terminator of a far sphere is a straight line through its middle.

    >>> arc = terminator_points([0, 0, 1e6], [1, 1, 1], np.eye(3), [1e8, 0, 0], n=3)
    >>> (arc * 1e6).round(3)[:, :2] + 0.0
    array([[ 0., -1.],
           [ 0.,  0.],
           [ 0.,  1.]])
    """
    radii, rotation = _body(radii_km, camera_from_body)
    camera = _outside(position_km, radii, rotation, "camera")
    sun = _outside(-np.asarray(sun_position_km, float), radii, rotation, "Sun")
    # A surface point y of the unit sphere is in view where y . camera > 1. On the Sun's circle, with angles
    # counted from the side toward the camera, that product is level + swing cos(angle).
    level = float(camera @ sun / (sun @ sun))
    across = camera - level * sun
    swing = float(np.sqrt(1.0 - 1.0 / (sun @ sun)) * np.linalg.norm(across))
    if 1.0 - level >= swing:
        return np.empty((0, 3))
    if 1.0 - level <= -swing:
        points = _touching_circle(sun, _off_axis(sun), np.linspace(0.0, 2.0 * np.pi, n, endpoint=False))
    else:
        half = np.arccos((1.0 - level) / swing)
        points = _touching_circle(sun, across, np.linspace(-half, half, n))
    return _directions(points - camera, radii, rotation)


def ellipse_from_conic(conic: ArrayLike) -> Ellipse:
    """Return the ellipse ``[x, y, 1] @ conic @ [x, y, 1] == 0``.

    Parameters
    ----------
    conic : (3, 3) array_like
        Symmetric, of any scale and sign.

    Raises
    ------
    ValueError
        The conic is a parabola or hyperbola (the limb reaches behind the camera), or has no real points.

    Examples
    --------
    >>> ellipse = ellipse_from_conic(np.diag([1.0, 4.0, -4.0]))
    >>> ellipse.semi_axes, ellipse.angle_rad
    (array([2., 1.]), 0.0)
    """
    matrix = symmetric(np.asarray(conic, float))
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise ValueError(f"a conic is a finite (3, 3) matrix; got shape {matrix.shape}")
    curvatures, axes = np.linalg.eigh(matrix[:2, :2])
    if matrix[0, 0] + matrix[1, 1] < 0.0:  # turn the sign, so that an ellipse has positive curvatures
        matrix, curvatures, axes = -matrix, -curvatures[::-1], axes[:, ::-1]
    if not curvatures[0] > PARABOLA_RATIO * curvatures[1]:
        raise ValueError(
            f"the conic is a parabola or hyperbola (curvatures {curvatures[0]:.3g}, {curvatures[1]:.3g}); "
            "the limb does not close in front of the camera"
        )
    center = -np.linalg.solve(matrix[:2, :2], matrix[:2, 2])
    level = float(matrix[2, 2] + matrix[:2, 2] @ center)
    if not level < 0.0:
        raise ValueError(f"the conic has no real points: its value at the center is {level:.3g}, not < 0")
    major = axes[:, 0] * (1.0 if axes[0, 0] > 0.0 or (axes[0, 0] == 0.0 and axes[1, 0] > 0.0) else -1.0)
    return Ellipse(
        center=np.asarray(center),
        semi_axes=np.asarray(np.sqrt(-level / curvatures)),
        angle_rad=float(np.arctan2(major[1], major[0])),
    )


def sphere_center_offset(off_axis_rad: float, angular_radius_rad: float) -> float:
    """Return how far a sphere's limb ellipse is centered outside of its projected center, in focal lengths.

    Parameters
    ----------
    off_axis_rad
        Angle from the boresight to the sphere's center.
    angular_radius_rad
        Angular radius, arcsin(radius / distance).

    Raises
    ------
    ValueError
        The limb does not close in front of the camera.

    Examples
    --------
    Pluto's 38 px radius at the corner of a LORRI picture: one part in 10^10, far below a pixel.

    >>> print(f"{sphere_center_offset(0.0036, 1.88e-4):.1e}")
    1.3e-10
    """
    cos2, sin2 = np.cos(off_axis_rad) ** 2, np.sin(angular_radius_rad) ** 2
    if not (cos2 > sin2 and np.cos(off_axis_rad) > 0.0):
        raise ValueError(
            f"a limb {angular_radius_rad:.4g} rad around {off_axis_rad:.4g} rad off the boresight "
            "does not close in front of the camera"
        )
    return float(np.tan(off_axis_rad) * sin2 / (cos2 - sin2))


def _body(radii_km: ArrayLike, camera_from_body: ArrayLike) -> tuple[FloatArray, FloatArray]:
    radii, rotation = np.asarray(radii_km, float), checked_rotation(camera_from_body, "camera_from_body")
    if radii.shape != (3,) or not np.all(np.isfinite(radii) & (radii > 0.0)):
        raise ValueError(f"radii {radii.tolist()} km: three positive numbers are needed")
    return radii, rotation


def _outside(body_km: ArrayLike, radii: FloatArray, rotation: FloatArray, viewer: str) -> FloatArray:
    """Return where `viewer`, which sees the body at `body_km`, stands when the body is a unit sphere."""
    scaled = np.asarray(-(np.asarray(body_km, float) @ rotation) / radii)
    distance = float(np.linalg.norm(scaled))
    if not distance > 1.0:  # "not >" catches nan as well
        raise ValueError(
            f"the {viewer} is not outside the body: {distance:.6g} body radii from its center; "
            "check the position (km) and the radii (km)"
        )
    return scaled


def _touching_circle(viewer: FloatArray, start: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the points (n, 3) of the unit sphere where lines of sight from `viewer` touch it.

    The angles count from the side toward `start`, any vector not along `viewer`.
    """
    axis = unit(viewer)
    first = unit(start - (start @ axis) * axis)
    second = np.cross(axis, first)
    inverse = 1.0 / float(np.linalg.norm(viewer))
    wheel = np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)
    return np.asarray(inverse * axis + np.sqrt(1.0 - inverse**2) * wheel)


def _limb(camera: FloatArray, n: int) -> FloatArray:
    """Return n points (n, 3) of the unit sphere once around its limb."""
    return _touching_circle(camera, _off_axis(camera), np.linspace(0.0, 2.0 * np.pi, n, endpoint=False))


def _off_axis(vector: FloatArray) -> FloatArray:
    """Return the coordinate axis that stands most across `vector`."""
    return np.asarray(np.eye(3)[np.argmin(np.abs(vector))])


def _directions(scaled: FloatArray, radii: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return camera-frame unit directions of scaled body vectors (n, 3)."""
    return unit((scaled * radii) @ rotation.T)
