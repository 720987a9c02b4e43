"""Statistics that fits of stars, limbs and trajectories share: scatter beyond what is stated, and how improbable it is."""

from collections.abc import Callable

import numpy as np
import scipy
from scipy.special import chdtrc, ndtri

__all__ = ["equal_sigmas", "moment_excess"]

FIRST_BRACKET = 0.1  # in the unit of the measurements: px, of which an excess is a few hundredths
LARGEST_SIGMAS = 37.0  # beyond, the probability of a normal error is no double


def moment_excess(surplus: Callable[[float], float], tolerance: float, upper: float = FIRST_BRACKET) -> float:
    """Return the sigma that must be added to the stated ones for chi-squared to be what it is expected to be.

    Parameters
    ----------
    surplus
        Chi-squared minus its expectation as a function of the sigma added; falls, finally below zero.
    tolerance
        Of the result, in its unit.
    upper
        Where to look for the end of the search; doubled until the surplus is gone.

    Returns
    -------
    float
        0 where the stated sigmas suffice.

    References
    ----------
    Paule & Mandel (1982), doi:10.6028/jres.087.022.

    Examples
    --------
    >>> errors = np.array([3.0, -4.0, 5.0, -1.0])  # with sigmas of 1
    >>> print(round(moment_excess(lambda s: np.sum(errors**2 / (1.0 + s**2)) - 4.0, 1e-9) ** 2, 6))
    11.75
    """
    if surplus(0.0) <= 0.0:
        return 0.0
    while surplus(upper) > 0.0:
        upper *= 2.0
    return float(scipy.optimize.brentq(surplus, 0.0, upper, xtol=tolerance))


def equal_sigmas(square: float, freedom: int) -> float:
    """Return the sigmas of a normal error that is as improbable as a chi-squared.

    Examples
    --------
    >>> round(equal_sigmas(9.0, 1), 6), round(equal_sigmas(11.829, 2), 3)
    (3.0, 3.0)
    """
    improbable = float(chdtrc(freedom, square))
    return (
        float(-ndtri(0.5 * improbable)) if improbable > 0.0 else max(LARGEST_SIGMAS, float(np.sqrt(square)))
    )
