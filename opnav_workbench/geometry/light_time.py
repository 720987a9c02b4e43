"""Light time: where a body was seen that is elsewhere by now, or that stands elsewhere than was thought.

    rho = r - (|rho| - d) / c v     place where the light left, relative to the observer

r is where the body would be seen if the light time were the one d / c that is known; light of a body farther away left
earlier, when the body was elsewhere. v is the body's velocity with respect to the solar-system barycenter, constant
meanwhile.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.geometry.rotations import unit

__all__ = ["light_time_jacobian", "where_light_left"]

LIGHT_TIME_PASSES = 8  # each is better by v/c; 1e-3 for a fast comet near the Sun


def where_light_left(moved_km: ArrayLike, range_km: ArrayLike, velocity_km_s: ArrayLike) -> FloatArray:
    """Return the places (..., 3) where the light of moved bodies left, relative to the observer, km.

    Parameters
    ----------
    moved_km : (..., 3) array_like
        Bodies as they would be seen with the light time of `range_km`.
    range_km : (...) array_like
        Distance whose light time is already in `moved_km`.
    velocity_km_s : (..., 3) array_like
        Of the bodies, with respect to the solar-system barycenter.

    Examples
    --------
    A body 300,000 km farther away is seen one second earlier on its way.

    >>> print(where_light_left([0.0, 0.0, 1.3e6], 1.0e6, [20.0, 0.0, 0.0]).round(1).tolist())
    [-20.0, 0.0, 1300000.0]
    """
    moved, velocity = np.asarray(moved_km, float), np.asarray(velocity_km_s, float)
    known_km = np.asarray(range_km, float)[..., None]
    seen = moved
    for _ in range(LIGHT_TIME_PASSES):
        later_s = (np.linalg.norm(seen, axis=-1, keepdims=True) - known_km) / SPEED_OF_LIGHT_KM_S
        seen = moved - later_s * velocity
    return np.asarray(seen)


def light_time_jacobian(position_km: ArrayLike, velocity_km_s: ArrayLike) -> FloatArray:
    """Return d(place where the light left)/d(place of the body), (..., 3, 3), both relative to the observer.

    It is I - v u' / (c + u.v), with u the direction of `position_km`, where the light left.
    """
    direction, velocity = unit(position_km), np.asarray(velocity_km_s, float)
    slower = SPEED_OF_LIGHT_KM_S + np.sum(direction * velocity, axis=-1)
    return np.asarray(np.eye(3) - velocity[..., :, None] * direction[..., None, :] / slower[..., None, None])
