"""Bodies before cameras whose lines are exposed one after the other: the spacecraft flies on meanwhile, and they move.

A body's direction changes by the motion of spacecraft and body, besides the camera's turn. `following` gives a camera that
sees the body's center where it is at each line's own time: its turn is followed by the least rotation that takes the
center's direction of mid-picture to that of the line's time. As the body comes nearer, its limb spreads about the center:
by its tangent cone, exactly so for a sphere. That is for limbs. Left out is that another side of the body is seen
meanwhile, by the way flown around it and by its own spin: what stands before the plane of the limb is off by that angle
times how far it does, at a line far from the center's.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import (
    apparent_direction,
    least_turn,
    rotation_from_vector,
    unit,
    vector_from_rotation,
)
from opnav_workbench.targets import TargetState

__all__ = ["following"]

STILL_PX = 1e-4  # less motion over the whole picture is none


def following(
    camera: Camera, target: TargetState, observer_velocity_km_s: ArrayLike, camera_from_j2000: ArrayLike
) -> Camera:
    """Return the camera as it sees one body; the camera itself where all its lines are exposed together, or of a star.

    Parameters
    ----------
    target
        At mid-picture.
    observer_velocity_km_s : (3,) array_like
        With respect to the solar-system barycenter, J2000.
    camera_from_j2000 : (3, 3) array_like
        At mid-picture.
    """
    camera = camera.standing(camera_from_j2000)
    sweep, velocity = camera.sweep, target.velocity_km_s
    if sweep is None or sweep.follows or target.is_star or velocity is None:
        return camera
    flown = velocity - np.asarray(observer_velocity_km_s, dtype=np.float64)
    position = np.asarray(target.position_km) + sweep.time_s[:, None] * flown
    directions = np.asarray(apparent_direction(unit(position), observer_velocity_km_s))
    attitude, still_rad = np.asarray(camera_from_j2000, dtype=np.float64), STILL_PX * camera.pixel_scale_rad
    middle = np.asarray(apparent_direction(unit(target.position_km), observer_velocity_km_s))
    followed = sweep
    if np.linalg.norm(directions[-1] - directions[0]) >= still_rad:
        moved = rotation_from_vector(least_turn(middle, directions))
        turns = rotation_from_vector(sweep.turn_rad) @ attitude @ moved @ attitude.T
        followed = replace(followed, turn_rad=vector_from_rotation(turns), follows=target.name)
    spread, radius_rad = _limb_spread(target, position)
    if radius_rad * np.abs(spread - 1.0).max() >= still_rad:
        followed = replace(followed, toward=attitude @ middle, spread=spread, follows=target.name)
    return camera if followed is sweep else replace(camera, sweep=followed)


def _limb_spread(target: TargetState, position_km: FloatArray) -> tuple[FloatArray, float]:
    """Return the tangent of the limb's angle from the center at other places (k, 3) over that at mid-picture, and that."""
    none = np.ones(len(position_km))
    if target.radii_km is None:
        return none, 0.0
    radius2 = float(np.cbrt(np.prod(target.radii_km))) ** 2
    outside = target.range_km**2 - radius2, np.sum(position_km**2, axis=1) - radius2
    if outside[0] <= 0.0 or (outside[1] <= 0.0).any():  # what lies within a body has no limb
        return none, 0.0
    return np.sqrt(outside[0] / outside[1]), float(np.sqrt(radius2 / outside[0]))
