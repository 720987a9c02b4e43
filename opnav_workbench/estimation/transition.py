"""How a correction of a state at one epoch becomes a correction at another: state transition matrices.

A transition is any callable ``(epoch_et, et) -> (6, 6)``, so that an orbit determination program's own can be used.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.estimation.two_body import propagate_two_body
from opnav_workbench.observables.differences import jacobian_by_differences

__all__ = ["Transition", "kepler", "straight_line"]

Transition = Callable[[float, float], FloatArray]

# Longest step of the differences, as a share of distance and speed; the differences themselves choose shorter ones.
STEP_SHARE = 1e-3
KEPT_MATRICES = 4096  # epochs of a campaign


def straight_line(epoch_et: float, et: float) -> FloatArray:
    """Return the transition (6, 6) of unaccelerated motion: a velocity error grows into a position error.

    Parameters
    ----------
    epoch_et, et : float
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
    gm_km3_s2 : float
        Of the central body.

    Examples
    --------
    >>> transition = kepler([1e5, 0, 0, 0, 2.0, 0], 398600.0)
    >>> bool(np.allclose(transition(0.0, 0.0), np.eye(6), atol=1e-9))
    True
    """
    reference = np.asarray(state, float)
    steps = STEP_SHARE * np.repeat([np.linalg.norm(reference[:3]), np.linalg.norm(reference[3:])], 3)

    @lru_cache(maxsize=KEPT_MATRICES)
    def transition(epoch_et: float, et: float) -> FloatArray:
        return jacobian_by_differences(
            lambda s: propagate_two_body(s, gm_km3_s2, et - epoch_et), reference, steps
        )

    return transition
