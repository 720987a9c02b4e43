"""Bodies before cameras whose lines are exposed one after the other: the spacecraft flies on meanwhile, and they move.

A body's direction changes by the motion of spacecraft and body, besides the camera's turn. `following` gives a camera that
sees the body's center where it is at each line's own time: its turn is followed by the least rotation that takes the
center's direction of mid-picture to that of the line's time. Across the body this leaves the change of perspective, which is
as small as the way flown is against the range; the body's own spin is left out.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

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
    if np.linalg.norm(directions[-1] - directions[0]) < STILL_PX * camera.pixel_scale_rad:
        return camera
    middle = np.asarray(apparent_direction(unit(target.position_km), observer_velocity_km_s))
    moved = rotation_from_vector(least_turn(middle, directions))
    attitude = np.asarray(camera_from_j2000, dtype=np.float64)
    turns = rotation_from_vector(sweep.turn_rad) @ attitude @ moved @ attitude.T
    return replace(camera, sweep=replace(sweep, turn_rad=vector_from_rotation(turns), follows=target.name))
