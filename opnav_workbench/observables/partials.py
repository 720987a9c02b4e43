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

# The step moves the body by this angle. The error of central differences is then below 1e-9 by truncation and, with
# directions rounded at 1e-16, below 1e-11 by rounding.
STEP_RAD = 1e-5


def numerical_position_partials(
    position_km: ArrayLike, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """Central differences of (pixel, line) over the spacecraft's position.

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
    """
    position, rotation = np.asarray(position_km, float), np.asarray(camera_from_j2000, float)
    step_km = STEP_RAD * float(np.linalg.norm(position))
    # Moving the spacecraft by +d moves the body, as seen from it, by -d.
    moves = np.concatenate([-step_km * np.eye(3), step_km * np.eye(3)])
    directions = apparent_direction(_unit(position + moves), velocity_km_s)
    places = camera.project(directions @ rotation.T)
    _require_seen(places)
    return np.asarray((places[:3] - places[3:]).T / (2.0 * step_km))


def analytic_position_partials(
    position_km: ArrayLike, velocity_km_s: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> FloatArray:
    """Return the same partials (2, 3), px/km, by the chain rule; parameters as `numerical_position_partials`."""
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
