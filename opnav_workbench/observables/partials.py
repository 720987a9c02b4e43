"""Partial derivatives of a body's (pixel, line) with respect to spacecraft position and camera attitude.

The paper (AAS 13-443, "Output Observables") perturbs the spacecraft's state one component at a time; so does
`numerical_position_partials`, through the whole model: direction, stellar aberration, attitude, distortion. The analytic
route is a check on it, and faster. Light time and the spacecraft's velocity are held fixed in both: they change the
partials by the ratio of the body's speed to that of light, 1e-4 at most.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import SPEED_OF_LIGHT_KM_S, apparent_direction

__all__ = ["analytic_position_partials", "attitude_partials", "numerical_position_partials"]

# The largest step moves the body by this angle; the others are each a fourth of the one before. The smallest still
# keeps rounding (1e-16 of a direction, 1e-12 mm of a distortion found by iteration) below 1e-8 of the partials.
STEP_RAD = 1e-5
STEP_RATIO = 4.0
STEP_COUNT = 4


def numerical_position_partials(
    position_km: ArrayLike, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """Central differences of (pixel, line) over the spacecraft's position, one component at a time.

    The step is chosen by the differences themselves: extrapolations over a series of steps are compared, and the
    one that agrees best with its neighbors stands. A fixed step fails where distortion bends strongly or its
    calibration ends (MVIC). Light time and velocity are held fixed.

    Parameters
    ----------
    position_km : (3,) array_like
        Spacecraft to body, J2000, light time removed, no stellar aberration.
    velocity_km_s : (3,) array_like
        Spacecraft with respect to the solar-system barycenter.
    camera : Camera
    camera_from_j2000 : (3, 3) array_like

    Returns
    -------
    (2, 3) array
        d(pixel, line) / d(spacecraft position relative to the body, J2000), px/km.

    Raises
    ------
    PointingError
        The body is not in front of the camera.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4, 75, doi:10.1016/S0141-1195(82)80057-0.
    """
    position, rotation = np.asarray(position_km, float), np.asarray(camera_from_j2000, float)
    steps_km = STEP_RAD * float(np.linalg.norm(position)) * STEP_RATIO ** -np.arange(STEP_COUNT)
    # Moving the spacecraft by +d moves the body, as seen from it, by -d.
    moves = steps_km[:, None, None, None] * np.stack([-np.eye(3), np.eye(3)])
    directions = apparent_direction(_unit(position + moves), velocity_km_s)
    places = camera.project(directions @ rotation.T)  # (steps, 2 signs, 3 components, 2)
    _require_seen(places)
    slopes = (places[:, 0] - places[:, 1]) / (2.0 * steps_km[:, None, None])
    return _extrapolated(np.swapaxes(slopes, 1, 2))


def analytic_position_partials(
    position_km: ArrayLike, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """Return the same partials (2, 3), px/km, by the chain rule.

    Parameters, units and errors as in `numerical_position_partials`; light time and velocity are held fixed.
    """
    position, rotation = np.asarray(position_km, float), np.asarray(camera_from_j2000, float)
    range_km = float(np.linalg.norm(position))
    unit = position / range_km
    of_unit = (np.eye(3) - np.outer(unit, unit)) / range_km
    apparent = apparent_direction(unit, velocity_km_s)
    of_apparent = _aberration_jacobian(unit, np.asarray(velocity_km_s, float) / SPEED_OF_LIGHT_KM_S)
    of_pixel = camera.project_jacobian((rotation @ apparent)[None])[0] @ rotation
    _require_seen(of_pixel)
    return np.asarray(-of_pixel @ of_apparent @ of_unit)


def attitude_partials(direction: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike) -> FloatArray:
    """Return d(pixel, line) / d(small rotation vector about the camera frame's axes), (2, 3) px/rad.

    The rotation is the error of the attitude, ``true = rotation_from_vector(eps) @ camera_from_j2000``, as in
    `PointingSolution.covariance_rad2`; `direction` is the body's apparent one, J2000.
    """
    in_camera = np.asarray(camera_from_j2000, float) @ np.asarray(direction, float)
    x, y, z = in_camera
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # d(eps x v) / d(eps)
    return np.asarray(camera.project_jacobian(in_camera[None])[0] @ turned)


def _extrapolated(slopes: FloatArray) -> FloatArray:
    """Limit (2, 3) of central differences (steps, 2, 3) for a vanishing step, by Ridders' table."""
    best, error, row = slopes[-1], np.inf, [slopes[0]]
    for slope in slopes[1:]:
        refined = [slope]
        for order, coarser in enumerate(row, start=1):
            factor = STEP_RATIO ** (2 * order)  # central differences err by even powers of the step
            candidate = (factor * refined[-1] - coarser) / (factor - 1.0)
            estimate = max(np.abs(candidate - refined[-1]).max(), np.abs(candidate - coarser).max())
            if estimate < error:
                best, error = candidate, estimate
            refined.append(candidate)
        row = refined
    return np.asarray(best)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _aberration_jacobian(unit: FloatArray, beta: FloatArray) -> FloatArray:
    """Derivative of the apparent direction with respect to the geometric one (SPICE's convention), (3, 3).

    The apparent direction n' satisfies n = unit(n' - beta): n' = beta + k n with k from |n'| = 1.
    """
    along = float(beta @ unit)
    root = np.sqrt(along**2 + 1.0 - beta @ beta)
    k = -along + root
    gradient = beta * (along / root - 1.0)
    return np.asarray(k * np.eye(3) + np.outer(unit, gradient))


def _require_seen(values: FloatArray) -> None:
    if not np.isfinite(values).all():
        raise PointingError(
            "the body is not in front of the camera, so its partials do not exist; check the pointing."
        )
