"""How a correction of a state at one epoch becomes a correction at another: state transition matrices.

A transition is any callable ``(epoch_et, et) -> (6, 6)``, so that an orbit determination program's own can be used;
`straight_line` and `kepler` are at hand. `propagate_two_body` is unperturbed motion, by SPICE's universal variables.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import EstimationError, KernelError
from opnav_workbench.geometry.differences import jacobian_by_differences
from opnav_workbench.kernels.states import two_body_state

__all__ = ["Transition", "kepler", "propagate_two_body", "straight_line"]


# ---- Unperturbed two-body motion: ellipse, parabola and hyperbola alike.


def propagate_two_body(state: ArrayLike, gm_km3_s2: float, time_s: float) -> FloatArray:
    """Return the state (6,), km and km/s, a time later.

    Parameters
    ----------
    state : (6,) array_like
        Position and velocity relative to the center.
    gm_km3_s2
        Of the center; zero for a straight line.
    time_s
        Negative for earlier.

    Raises
    ------
    EstimationError
        The state is not finite, at the center, or moves straight toward it.

    Examples
    --------
    Half a revolution on a circle.

    >>> half = np.pi * np.sqrt(7000.0**3 / 398600.0)
    >>> later = propagate_two_body([7000.0, 0, 0, 0, np.sqrt(398600.0 / 7000.0), 0], 398600.0, half)
    >>> bool(np.allclose(later[:3], [-7000.0, 0.0, 0.0], atol=1e-6))
    True
    """
    values = np.asarray(state, float)
    position, velocity = values[:3], values[3:]
    distance = float(np.linalg.norm(position))
    if not np.isfinite(values).all() or distance == 0.0 or not gm_km3_s2 >= 0.0:
        raise EstimationError(
            f"no two-body orbit through state {values.tolist()} with GM {gm_km3_s2:g} km^3/s^2."
        )
    if gm_km3_s2 == 0.0:
        return np.concatenate([position + time_s * velocity, velocity])
    try:
        return two_body_state(values, gm_km3_s2, time_s)
    except KernelError as error:
        raise EstimationError(f"no two-body orbit through state {values.tolist()}: {error}") from error


# ---- How a correction of a state at one epoch becomes a correction at another: state transition matrices.

Transition = Callable[[float, float], FloatArray]

# Longest step of the differences, as a share of distance and speed; the differences themselves choose shorter ones.
DIFFERENCE_STEP_SHARE = 1e-3
KEPT_MATRICES = 4096  # epochs of a campaign


def straight_line(epoch_et: float, et: float) -> FloatArray:
    """Return the transition (6, 6) of unaccelerated motion: a velocity error grows into a position error.

    Parameters
    ----------
    epoch_et, et
        TDB seconds past J2000.

    Examples
    --------
    >>> straight_line(0.0, 100.0)[0].tolist()
    [1.0, 0.0, 0.0, 100.0, 0.0, 0.0]
    """
    matrix = np.eye(6)
    matrix[:3, 3:] = (et - epoch_et) * np.eye(3)
    return matrix


def kepler(state: ArrayLike, gm_km3_s2: float) -> Transition:
    """Return the transition of two-body motion about the reference state.

    Parameters
    ----------
    state : (6,) array_like
        Reference position (km) and velocity (km/s) at the epoch, relative to the central body, J2000.
    gm_km3_s2
        Of the central body.

    Examples
    --------
    >>> transition = kepler([1e5, 0, 0, 0, 2.0, 0], 398600.0)
    >>> bool(np.allclose(transition(0.0, 0.0), np.eye(6), atol=1e-9))
    True
    """
    reference = np.asarray(state, float)
    steps = DIFFERENCE_STEP_SHARE * np.repeat(
        [np.linalg.norm(reference[:3]), np.linalg.norm(reference[3:])], 3
    )

    @lru_cache(maxsize=KEPT_MATRICES)
    def transition(epoch_et: float, et: float) -> FloatArray:
        return jacobian_by_differences(
            lambda s: propagate_two_body(s, gm_km3_s2, et - epoch_et), reference, steps
        )

    return transition
