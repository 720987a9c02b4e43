"""How a correction of a state at one epoch becomes a correction at another: state transition matrices.

A transition is any callable ``(epoch_et, et) -> (6, 6)``, so that an orbit determination program's own can be used;
`straight_line` and `kepler` are at hand. `propagate_two_body` is unperturbed motion by universal variables: ellipse,
parabola and hyperbola alike.

Reference: Bate, Mueller & White (1971), Fundamentals of Astrodynamics, chapter 4; Stumpff functions c2 and c3.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry.differences import jacobian_by_differences

__all__ = ["Transition", "kepler", "propagate_two_body", "straight_line"]


# ---- Unperturbed two-body motion by universal variables: ellipse, parabola and hyperbola alike.

SERIES_BELOW = (
    1e-3  # |z| for which the closed forms of c2 and c3 lose digits, and four terms of the series are exact
)
MAX_KEPLER_PASSES = 200
KEPLER_TOLERANCE = 1e-15


def propagate_two_body(state: ArrayLike, gm_km3_s2: float, time_s: float) -> FloatArray:
    """Return the state (6,), km and km/s, a time later.

    Parameters
    ----------
    state : (6,) array_like
        Position and velocity relative to the center.
    gm_km3_s2 : float
        Of the center; zero for a straight line.
    time_s : float
        Negative for earlier.

    Raises
    ------
    EstimationError
        The state is not finite or at the center, or the iteration does not end.

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
    root, radial = np.sqrt(gm_km3_s2), float(position @ velocity)
    alpha = 2.0 / distance - float(velocity @ velocity) / gm_km3_s2
    x = _universal_anomaly(distance, radial / root, alpha, root * time_s)
    z = alpha * x * x
    c2, c3 = _stumpff(z)
    f = 1.0 - x * x * c2 / distance
    g = time_s - x**3 * c3 / root
    later = f * position + g * velocity
    after = float(np.linalg.norm(later))
    f_rate = root / (distance * after) * x * (z * c3 - 1.0)
    g_rate = 1.0 - x * x * c2 / after
    return np.concatenate([later, f_rate * position + g_rate * velocity])


def _universal_anomaly(distance: float, sigma: float, alpha: float, target: float) -> float:
    """Solve Kepler's equation t(x) = target (both times sqrt(GM)); t grows with x, so bisection guards Newton."""
    x = target / distance
    low, high = -np.inf, np.inf
    for _ in range(MAX_KEPLER_PASSES):
        z = alpha * x * x
        c2, c3 = _stumpff(z)
        error = x**3 * c3 + sigma * x * x * c2 + distance * x * (1.0 - z * c3) - target
        slope = x * x * c2 + sigma * x * (1.0 - z * c3) + distance * (1.0 - z * c2)
        low, high = (x, high) if error < 0.0 else (low, x)
        following = x - error / slope
        if abs(error / slope) <= KEPLER_TOLERANCE * abs(x):
            return float(following)
        x = following if low < following < high else _bisected(low, high, x)
    return float(x)


def _bisected(low: float, high: float, x: float) -> float:
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return 0.5 * x if x != 0.0 else 1.0


def _stumpff(z: float) -> tuple[float, float]:
    if abs(z) < SERIES_BELOW:
        c2 = (1.0 - z / 12.0 * (1.0 - z / 30.0 * (1.0 - z / 56.0))) / 2.0
        c3 = (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0))) / 6.0
        return c2, c3
    root = np.sqrt(abs(z))
    if z > 0.0:
        return float((1.0 - np.cos(root)) / z), float((root - np.sin(root)) / root**3)
    # A hyperbola far out: cosh overflows only beyond any time that a picture has.
    return float((1.0 - np.cosh(root)) / z), float((np.sinh(root) - root) / root**3)


# ---- How a correction of a state at one epoch becomes a correction at another: state transition matrices.

Transition = Callable[[float, float], FloatArray]

# Longest step of the differences, as a share of distance and speed; the differences themselves choose shorter ones.
DIFFERENCE_STEP_SHARE = 1e-3
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
    steps = DIFFERENCE_STEP_SHARE * np.repeat(
        [np.linalg.norm(reference[:3]), np.linalg.norm(reference[3:])], 3
    )

    @lru_cache(maxsize=KEPT_MATRICES)
    def transition(epoch_et: float, et: float) -> FloatArray:
        return jacobian_by_differences(
            lambda s: propagate_two_body(s, gm_km3_s2, et - epoch_et), reference, steps
        )

    return transition
