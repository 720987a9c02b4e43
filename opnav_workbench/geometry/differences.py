"""Derivatives by central differences whose step is chosen by the differences themselves.

A step too long errs by curvature, a step too short by rounding. So the slope is taken with a series of steps and
extrapolated to none; of all extrapolations the one that agrees best with its neighbors stands.

Reference: Ridders (1982), Advances in Engineering Software 4, 75, doi:10.1016/S0141-1195(82)80057-0.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray

__all__ = ["STEP_COUNT", "STEP_RATIO", "jacobian_by_differences", "limit_of_slopes"]

STEP_RATIO = 4.0  # each step is a fourth of the one before
STEP_COUNT = 4


def limit_of_slopes(slopes: FloatArray) -> FloatArray:
    """Return the limit (...) of central differences (steps, ...) for a vanishing step.

    Parameters
    ----------
    slopes : (k, ...) array
        Slopes with steps that each are `STEP_RATIO` times shorter than the one before. All values of a row share the
        choice of the extrapolation.
    """
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


def jacobian_by_differences(
    function: Callable[[FloatArray], FloatArray], point: ArrayLike, steps: ArrayLike
) -> FloatArray:
    """Return d(function)/d(point), (m, n), perturbing one component at a time.

    Parameters
    ----------
    function
        Takes (n,), returns (m,).
    point, steps : (n,) array_like
        Where, and the longest step of each component, in its unit.

    Examples
    --------
    >>> print(jacobian_by_differences(lambda x: np.array([x[0] ** 3 * x[1]]), [2.0, 5.0], [0.1, 0.1]).round(9))
    [[60.  8.]]
    """
    center, longest = np.asarray(point, float), np.asarray(steps, float)
    columns = []
    for axis in np.eye(len(center)):
        moves = [axis * longest / STEP_RATIO**k for k in range(STEP_COUNT)]
        slopes = [(function(center + m) - function(center - m)) / (2.0 * float(m.sum())) for m in moves]
        columns.append(limit_of_slopes(np.array(slopes)))
    return np.stack(columns, axis=-1)
