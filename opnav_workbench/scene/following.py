"""Bodies before cameras whose lines are exposed one after the other: the spacecraft flies on, bodies move and spin.

A body's direction changes by the motion of spacecraft and body, besides the camera's turn. `following` gives a camera that
sees the body's center where it is at each line's own time: its turn is followed by the least rotation that takes the
center's direction of mid-picture to that of the line's time. Meanwhile the limb changes, as the body comes nearer, shows
another side, and spins. It is a conic in the plane across the center's direction u, ``(u - c)^T E^-1 (u - c) = 1``, and goes
from (c0, E0) to (c, E) by ``u = c + L (u0 - c0)`` with the one symmetric positive L that has ``L E0 L = E``: directions are
mapped linearly, a sphere's by its tangent cone, and any ellipsoid's limb is exact.

What lies within the limb is not where the limb's map takes it: the way flown and the spin turn the surface under it. So a
body is best taken as it stands when its own lines are exposed (`seen_at_its_lines`); how far its surface is off elsewhere is
told by `turned_meanwhile`.

Light time and the motion of the body are in `TargetState.course_km` (`with_course`); what the spacecraft's changing velocity
does to the places of stars and bodies, in the sweep (`with_aberration`).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera, RowSweep, row_sweep
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import (
    apparent_direction,
    least_turn,
    radec_from_unit,
    rotation_from_vector,
    tangent_basis,
    unit,
    vector_from_rotation,
)
from opnav_workbench.targets import TargetState

__all__ = [
    "following",
    "seen_at_its_lines",
    "sweep_of",
    "turned_meanwhile",
    "with_aberration",
    "with_course",
]

STILL_PX = 1e-4  # less motion over the whole picture is none
LIMB_POINTS = 16
COURSE_TIMES = 17  # of a course: a spline through so many parts of half a turn is right to 1e-6 of the way


def following(
    camera: Camera, target: TargetState, observer_velocity_km_s: ArrayLike, camera_from_j2000: ArrayLike
) -> Camera:
    """Return the camera as it sees one body; the camera itself where all its lines are exposed together, or of a star.

    Parameters
    ----------
    target
        At mid-picture, or as it stands at another time (`TargetState.at_time`): directions are then those of that time.
    observer_velocity_km_s : (3,) array_like
        With respect to the solar-system barycenter, J2000, at mid-picture.
    camera_from_j2000 : (3, 3) array_like
        At mid-picture.
    """
    camera = camera.standing(camera_from_j2000)
    sweep = camera.sweep
    if sweep is None or sweep.follows or target.is_star:
        return camera
    course = _course(target, sweep.time_s, np.asarray(observer_velocity_km_s, dtype=np.float64))
    if course is None:
        return camera
    places, turned = course
    directions = np.asarray(apparent_direction(unit(places), observer_velocity_km_s))
    attitude, still_rad = np.asarray(camera_from_j2000, dtype=np.float64), STILL_PX * camera.pixel_scale_rad
    start = np.asarray(apparent_direction(target.direction, observer_velocity_km_s))
    followed = sweep
    if np.linalg.norm(directions - start, axis=1).max() >= still_rad:
        moved = rotation_from_vector(least_turn(start, directions))
        turns = rotation_from_vector(sweep.turn_rad) @ attitude @ moved @ attitude.T
        followed = replace(followed, turn_rad=vector_from_rotation(turns), follows=target.name)
    spread = _limb_spread(target, places, turned, still_rad)
    if spread is not None:
        to_camera = attitude @ rotation_from_vector(least_turn(target.direction, start))
        followed = replace(followed, spread=to_camera @ spread @ to_camera.T, follows=target.name)
    return camera if followed is sweep else replace(camera, sweep=followed)


def _course(
    target: TargetState, time_s: FloatArray, observer_km_s: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return places (k, 3), km, and turns (k, 3) at times of the picture; None where nothing is known of its motion."""
    if target.course_s is not None:
        return target.along_course(time_s)
    if target.velocity_km_s is None:
        return None
    flown = (time_s - target.epoch_s)[:, None] * (target.velocity_km_s - observer_km_s)
    return target.position_km + flown, np.zeros((len(time_s), 3))


def _limb_spread(
    target: TargetState, places_km: FloatArray, turned_rad: FloatArray, still_rad: float
) -> FloatArray | None:
    """Return maps (k, 3, 3), J2000, of directions about the center's, from the limb at first to those at other times."""
    if target.radii_km is None or not (target.radii_km > 0.0).all():
        return None
    here, east_north = target.direction, np.stack(tangent_basis(*radec_from_unit(target.direction)), axis=-1)
    axes = np.column_stack([east_north, here])
    at_times = rotation_from_vector(least_turn(here, unit(places_km))) @ axes
    first = _limb_conics(target, target.position_km[None], np.zeros((1, 3)), axes[None])
    then = _limb_conics(target, places_km, turned_rad, at_times)
    if first is None or then is None:
        return None
    (center0, shape0), (center, shape) = first, then
    root = _root(shape0)
    back = np.linalg.inv(root)
    stretch = back @ _root(root @ shape @ root) @ back
    maps = np.tile(np.eye(3), (len(places_km), 1, 1))
    maps[:, :2, :2] = stretch
    maps[:, :2, 2] = center - np.einsum("kij,kj->ki", stretch, np.broadcast_to(center0, center.shape))
    radius = float(np.sqrt(np.trace(shape0[0])))
    if radius * np.abs(stretch - np.eye(2)).max() + np.abs(maps[:, :2, 2]).max() < still_rad:
        return None
    return np.asarray(axes @ maps @ axes.T)


def _limb_conics(
    target: TargetState, places_km: FloatArray, turned_rad: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return middles (k, 2) and shapes (k, 2, 2) of the limb across `axes` (k, 3, 3: right, up, toward the center).

    None where a place is within the body, or a limb is no ellipse.
    """
    assert target.radii_km is not None
    radii, attitude = target.radii_km, target.body_from_j2000
    if attitude is None:  # drawn as a sphere of the same volume
        radii, attitude = np.full(3, np.cbrt(np.prod(radii))), np.eye(3)
    body_from_axes = attitude @ np.swapaxes(rotation_from_vector(turned_rad), -1, -2) @ axes
    quadric = np.swapaxes(body_from_axes, -1, -2) @ (body_from_axes / radii[:, None] ** 2)
    tilt, depth, across = quadric[:, :2, 2], quadric[:, 2, 2], quadric[:, :2, :2]
    range2 = np.sum(places_km**2, axis=1)
    outside = range2 * depth - 1.0
    if (outside <= 0.0).any():
        return None
    # (p A u)^2 = (p A p - 1) (u A u), its third row and column without the differences of large numbers
    width = outside[:, None, None] * across - range2[:, None, None] * (tilt[:, :, None] * tilt[:, None, :])
    if (np.linalg.eigvalsh(width) <= 0.0).any():
        return None
    inverse = np.linalg.inv(width)
    center = np.einsum("kij,kj->ki", inverse, tilt)
    size = depth + np.einsum("ki,ki->k", tilt, center)
    return center, size[:, None, None] * inverse


def _root(matrix: FloatArray) -> FloatArray:
    """Return the positive square root of symmetric positive matrices (k, 2, 2)."""
    root = np.sqrt(np.linalg.det(matrix))
    return np.asarray(
        (matrix + root[:, None, None] * np.eye(2))
        / np.sqrt(np.trace(matrix, axis1=1, axis2=2) + 2.0 * root)[:, None, None]
    )


# ---- What moves and turns meanwhile.


def with_course(target: TargetState, half_s: float, at: Callable[[float], TargetState]) -> TargetState:
    """Return a body with its course while lines are exposed.

    Parameters
    ----------
    target
        At mid-picture.
    half_s
        Of the time in which lines are exposed.
    at
        The body at a time, s from mid-picture, seen from where the spacecraft is then.

    Returns
    -------
    TargetState
        Itself where it is a star, or where kernels do not reach so far.
    """
    if target.is_star or half_s <= 0.0:
        return target
    times = half_s * np.linspace(-1.0, 1.0, COURSE_TIMES)
    try:
        states = [at(float(time)) for time in times]
    except KernelError:
        return target
    attitude, turned = target.body_from_j2000, [state.body_from_j2000 for state in states]
    turn = None
    if attitude is not None and all(there is not None for there in turned):
        turn = vector_from_rotation(np.swapaxes(np.array(turned), -1, -2) @ attitude)
    places = np.array([state.position_km for state in states])
    return replace(target, course_s=times, course_km=places - target.position_km, course_turn_rad=turn)


def with_aberration(
    camera: Camera,
    half_s: float,
    attitude_at: Callable[[float], FloatArray],
    velocity_at: Callable[[float], FloatArray],
) -> Callable[[float], FloatArray]:
    """Return a camera's attitudes for places that are seen with the spacecraft's velocity at mid-picture.

    Stars and bodies are aberrated once a picture; the velocity changes meanwhile, and turns a small field as a whole. That
    change over the speed of light, times the size of the field, is left.

    Parameters
    ----------
    half_s
        Of the time in which lines are exposed.
    attitude_at
        ``camera_from_j2000`` (3, 3) at times in s from mid-picture.
    velocity_at
        Velocity (3,) with respect to the solar-system barycenter, J2000, km/s, at such times.

    Returns
    -------
    callable
        `attitude_at` itself where it makes no difference.
    """
    middle_km_s = velocity_at(0.0)
    changes = [np.linalg.norm(velocity_at(time) - middle_km_s) for time in (-half_s, half_s)]
    if max(changes) < STILL_PX * camera.pixel_scale_rad * SPEED_OF_LIGHT_KM_S:
        return attitude_at

    def turned(time_s: float) -> FloatArray:
        attitude = attitude_at(time_s)
        boresight = attitude.T @ camera.boresight
        before, then = (apparent_direction(boresight, v) for v in (middle_km_s, velocity_at(time_s)))
        return np.asarray(attitude @ rotation_from_vector(least_turn(before, then)))

    return turned


def sweep_of(
    camera: Camera,
    attitude_at: Callable[[float], FloatArray],
    velocity_at: Callable[[float], FloatArray],
) -> RowSweep:
    """Return how a camera with rows turns while they are exposed, `with_aberration` of the velocity then.

    Parameters
    ----------
    attitude_at, velocity_at
        As of `with_aberration`.

    Raises
    ------
    CameraError
        The picture is a line scan, and the camera does not move.
    """
    assert camera.rows is not None
    seen = with_aberration(camera, 0.5 * camera.rows.span_s(camera.n_line), attitude_at, velocity_at)
    return row_sweep(camera.rows, camera.n_line, camera.pixel_scale_rad, seen)


def seen_at_its_lines(
    camera: Camera, target: TargetState, observer_velocity_km_s: ArrayLike, camera_from_j2000: ArrayLike
) -> TargetState:
    """Return a body as it stands when the line of its center is exposed; itself without rows, course, or place in them."""
    if camera.sweep is None or target.course_s is None:
        return target
    seen = following(camera, target, observer_velocity_km_s, camera_from_j2000)
    start = apparent_direction(target.direction, observer_velocity_km_s)
    line = float(seen.project(np.asarray(camera_from_j2000) @ start)[1])
    if not -0.5 <= line <= camera.n_line - 0.5:
        return target
    return target.at_time(float(camera.sweep.times_s(line)))


def turned_meanwhile(
    camera: Camera, target: TargetState, observer_velocity_km_s: ArrayLike, camera_from_j2000: ArrayLike
) -> tuple[float, float]:
    """Return how far a body's surface moves against its limb while its lines are exposed, and that time.

    Px at most, and s, both from the line of its center to its first or last; by its spin and by the way flown around it. 0
    where none is known.
    """
    sweep = camera.sweep
    if sweep is None or target.course_s is None or target.radii_km is None:
        return 0.0, 0.0
    body = seen_at_its_lines(camera, target, observer_velocity_km_s, camera_from_j2000)
    seen = following(camera, body, observer_velocity_km_s, camera_from_j2000)
    limb = _limb_lines(seen, body, observer_velocity_km_s, camera_from_j2000)
    lines = np.clip(limb[np.isfinite(limb)], 0.0, camera.n_line - 1.0)
    if not len(lines):
        return 0.0, 0.0
    half_s = float(np.abs(sweep.times_s(lines) - body.epoch_s).max())
    places, turned = body.along_course(body.epoch_s + half_s * np.array([-1.0, 1.0]))
    carried = rotation_from_vector(least_turn(body.direction, unit(places)))
    ways = vector_from_rotation(np.swapaxes(carried, -1, -2) @ rotation_from_vector(turned))
    radius_px = float(np.max(target.radii_km)) / body.range_km / camera.pixel_scale_rad
    return float(radius_px * np.linalg.norm(ways, axis=1).max()), half_s


def _limb_lines(
    seen: Camera, body: TargetState, observer_velocity_km_s: ArrayLike, camera_from_j2000: ArrayLike
) -> FloatArray:
    """Return lines of points of a circle that holds the limb."""
    assert body.radii_km is not None
    sine = min(float(np.max(body.radii_km)) / body.range_km, 1.0)
    angle = np.linspace(0.0, 2.0 * np.pi, LIMB_POINTS, endpoint=False)[:, None]
    east, north = tangent_basis(*radec_from_unit(body.direction))
    rim = np.sqrt(1.0 - sine**2) * body.direction + sine * (np.cos(angle) * east + np.sin(angle) * north)
    apparent = apparent_direction(rim, observer_velocity_km_s)
    return np.asarray(seen.project(apparent @ np.asarray(camera_from_j2000).T)[:, 1])
