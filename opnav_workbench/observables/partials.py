"""Partial derivatives of a body's (pixel, line) with respect to spacecraft position, target state and camera attitude.

The paper (AAS 13-443, "Output Observables") perturbs the spacecraft's state one component at a time; so do the
numerical functions here, through the whole model: light time, direction, stellar aberration, attitude, distortion. The
analytic ones are a check on them, and faster.

What is held fixed
    spacecraft position  every body of the scene, the spacecraft's velocity (aberration), the attitude, the time
    target state         the spacecraft's state, the attitude, the time; of position and velocity the other one; the
                         acceleration of the target during the light time counts as zero
    attitude             positions, velocities and time

Which body the spacecraft's position refers to does not matter for its partials: with the bodies held fixed among each
other, moving the spacecraft by d relative to Pluto moves it by d relative to Charon. The partials of Charon "relative to
Pluto" are therefore those of Charon's own place. The target state is the target's own, too; a correction of a whole
system's barycenter moves each of its bodies alike.

Light time
    ``target_velocity_km_s=None``  held fixed: the body stays where it was when the light left
    given                          solved anew: light of a body farther away left earlier, when the body was elsewhere:
                                   d(rho) = (I - v u' / (c + u.v)) d(r), u the direction and v the target's velocity
                                   with respect to the solar-system barycenter. Both differ by v/c, 1e-4 at most.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import aberration_jacobian, apparent_direction, unit
from opnav_workbench.geometry.differences import STEP_COUNT, STEP_RATIO, limit_of_slopes
from opnav_workbench.geometry.light_time import LIGHT_TIME_PASSES, light_time_jacobian, where_light_left

__all__ = [
    "analytic_position_partials",
    "analytic_target_partials",
    "numerical_position_partials",
    "numerical_target_partials",
    "seen_place_jacobian",
]

# The largest step moves the body by this angle. The smallest (1/64 of it) still keeps rounding (1e-16 of a direction,
# 1e-12 mm of a distortion found by iteration) below 1e-8 of the partials.
STEP_RAD = 1e-5


def numerical_position_partials(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    camera: Camera,
    camera_from_j2000: ArrayLike,
    *,
    target_velocity_km_s: ArrayLike | None = None,
) -> FloatArray:
    """Central differences of (pixel, line) over the spacecraft's position, one component at a time.

    The step is chosen by the differences themselves (`limit_of_slopes`): a fixed step fails where distortion
    bends strongly or its calibration ends (MVIC).

    Parameters
    ----------
    position_km : (3,) array_like
        From the spacecraft to where the body was when the light left, J2000, no stellar aberration.
    velocity_km_s : (3,) array_like
        Spacecraft with respect to the solar-system barycenter.
    camera_from_j2000 : (3, 3) array_like
    target_velocity_km_s : (3,) array_like, optional
        Of the body with respect to the solar-system barycenter; with it the light time is solved anew, else held fixed.

    Returns
    -------
    (2, 3) array
        d(pixel, line) / d(spacecraft position relative to the reference body, J2000), px/km.

    Raises
    ------
    PointingError
        The body is not in front of the camera.
    """
    position = np.asarray(position_km, float)
    steps_km = _steps(float(np.linalg.norm(position)))
    # Moving the spacecraft by +d moves the body, as seen from it, by -d.
    moves = steps_km[:, None, None, None] * np.stack([-np.eye(3), np.eye(3)])
    seen = _seen_from(position + moves, position, target_velocity_km_s)
    return _slopes(_seen_places(seen, velocity_km_s, camera, camera_from_j2000), steps_km)


def analytic_position_partials(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    camera: Camera,
    camera_from_j2000: ArrayLike,
    *,
    target_velocity_km_s: ArrayLike | None = None,
) -> FloatArray:
    """Return the same partials (2, 3), px/km, by the chain rule; parameters and errors as there."""
    of_seen = _of_seen_position(position_km, velocity_km_s, camera, camera_from_j2000)
    return np.asarray(-of_seen @ seen_place_jacobian(position_km, target_velocity_km_s))


def numerical_target_partials(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    camera: Camera,
    camera_from_j2000: ArrayLike,
    *,
    target_velocity_km_s: ArrayLike | None = None,
) -> FloatArray:
    """Central differences of (pixel, line) over the target's state at mid-exposure, one component at a time.

    The body is seen where it was a light time earlier, so its velocity counts: ``-light time`` times the position's
    partials.

    Parameters
    ----------
    position_km, velocity_km_s, camera, camera_from_j2000, target_velocity_km_s
        As in `numerical_position_partials`.

    Returns
    -------
    (2, 6) array
        d(pixel, line) / d(target position, px/km; target velocity, px/(km/s)), J2000, target state at the time when the
        light arrives.

    Raises
    ------
    PointingError
        The body is not in front of the camera.
    """
    position = np.asarray(position_km, float)
    range_km = float(np.linalg.norm(position))
    steps_km = _steps(range_km)
    moves = steps_km[:, None, None, None] * np.stack([np.eye(3), -np.eye(3)])
    by_position = _seen_from(position + moves, position, target_velocity_km_s)
    # A velocity step moves the body as it was seen, one light time before, by -step * light time.
    light_time_s = range_km / SPEED_OF_LIGHT_KM_S
    by_velocity = _seen_moving(position, target_velocity_km_s, moves / light_time_s)
    slopes = [
        _slopes(_seen_places(seen, velocity_km_s, camera, camera_from_j2000), step)
        for seen, step in ((by_position, steps_km), (by_velocity, steps_km / light_time_s))
    ]
    return np.concatenate(slopes, axis=1)


def analytic_target_partials(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    camera: Camera,
    camera_from_j2000: ArrayLike,
    *,
    target_velocity_km_s: ArrayLike | None = None,
) -> FloatArray:
    """Return the same partials (2, 6), px/km and px/(km/s), by the chain rule; parameters and errors as there."""
    by_spacecraft = analytic_position_partials(
        position_km,
        velocity_km_s,
        camera,
        camera_from_j2000,
        target_velocity_km_s=target_velocity_km_s,
    )
    light_time_s = np.linalg.norm(np.asarray(position_km, float)) / SPEED_OF_LIGHT_KM_S
    return np.concatenate([-by_spacecraft, by_spacecraft * light_time_s], axis=1)


def seen_place_jacobian(position_km: ArrayLike, target_velocity_km_s: ArrayLike | None) -> FloatArray:
    """Return d(place where the light left)/d(place of the target), (3, 3), both relative to the spacecraft.

    The identity where the light time is held fixed (`target_velocity_km_s` None).
    """
    if target_velocity_km_s is None:
        return np.eye(3)
    return light_time_jacobian(position_km, target_velocity_km_s)


def _of_seen_position(
    position_km: ArrayLike, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """d(pixel, line)/d(place where the light left, relative to the spacecraft), (2, 3) px/km."""
    position, rotation = np.asarray(position_km, float), np.asarray(camera_from_j2000, float)
    toward = unit(position)
    of_unit = (np.eye(3) - np.outer(toward, toward)) / float(np.linalg.norm(position))
    apparent = apparent_direction(toward, velocity_km_s)
    of_pixel = camera.project_jacobian((rotation @ apparent)[None])[0] @ rotation
    _require_seen(of_pixel)
    return np.asarray(of_pixel @ aberration_jacobian(toward, velocity_km_s) @ of_unit)


def _steps(range_km: float) -> FloatArray:
    return np.asarray(STEP_RAD * range_km * STEP_RATIO ** -np.arange(STEP_COUNT))


def _seen_from(moved_km: FloatArray, position_km: FloatArray, velocity_km_s: ArrayLike | None) -> FloatArray:
    """Places (..., 3) where the light left of bodies moved to (..., 3), relative to the spacecraft."""
    if velocity_km_s is None:
        return moved_km
    return where_light_left(moved_km, np.linalg.norm(position_km), velocity_km_s)


def _seen_moving(
    position_km: FloatArray, velocity_km_s: ArrayLike | None, moves_km_s: FloatArray
) -> FloatArray:
    """Places (..., 3) where the light left of a body whose velocity differs by (..., 3)."""
    light_time_s = np.linalg.norm(position_km) / SPEED_OF_LIGHT_KM_S
    if velocity_km_s is None:
        return np.asarray(position_km - light_time_s * moves_km_s)
    velocity = np.asarray(velocity_km_s, float)
    now, seen = position_km + light_time_s * velocity, position_km - light_time_s * moves_km_s
    for _ in range(LIGHT_TIME_PASSES):
        delay_s = np.linalg.norm(seen, axis=-1, keepdims=True) / SPEED_OF_LIGHT_KM_S
        seen = now - delay_s * (velocity + moves_km_s)
    return np.asarray(seen)


def _seen_places(
    seen_km: FloatArray, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """(pixel, line) of bodies at (steps, 2 signs, 3 components, 3)."""
    directions = apparent_direction(unit(seen_km), velocity_km_s)
    places = camera.project(directions @ np.asarray(camera_from_j2000, float).T)
    _require_seen(places)
    return places


def _slopes(places: FloatArray, steps: FloatArray) -> FloatArray:
    slopes = (places[:, 0] - places[:, 1]) / (2.0 * steps[:, None, None])
    return limit_of_slopes(np.swapaxes(slopes, 1, 2))


def _require_seen(values: FloatArray) -> None:
    if not np.isfinite(values).all():
        raise PointingError(
            "the body is not in front of the camera, so its partials do not exist; check the pointing."
        )
