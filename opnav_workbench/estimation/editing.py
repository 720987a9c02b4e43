"""Outliers: what remains of a measurement after the fit, over the scatter that the fit predicts for it.

A measurement in use pulls the solution toward itself, so its residual scatters less than the measurement, by R - H P H'; one
that is not in use scatters more, by R + H P H'.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, symmetric

__all__ = ["Scatter", "equal_sigmas", "scatter_of", "worst"]

# A measurement that alone determines a parameter has no residual left to judge it by.
LEAST_FREEDOM = 1e-6  # of the measurement's own variance
MOST_SIGMAS = 37.0  # beyond, the probability of a normal error is no double


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """What remains of one center (two rows) or range (one row)."""

    kind: str
    number: int
    rows: IntArray
    used: bool
    residual: FloatArray
    sigmas: float
    reason: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


def scatter_of(
    kind: str,
    number: int,
    rows: IntArray,
    used: bool,
    residuals: FloatArray,
    covariance: FloatArray,
    mapped: FloatArray,
) -> Scatter:
    """Judge one measurement.

    Parameters
    ----------
    kind, number, rows, used
        Copied into the result; `rows` of the following.
    residuals : (k,) array
    covariance, mapped : (k, k) arrays
        Of the measurements, R; and of their computed values by the solution, H P H'.
    """
    block = np.ix_(rows, rows)
    residual, own = residuals[rows], covariance[block]
    predicted = symmetric(own - mapped[block] if used else own + mapped[block])
    size = _sigmas(residual, predicted, own)
    unit = "px" if kind == "center" else "km"
    words = ", ".join(f"{r:.3g}" for r in residual)
    return Scatter(
        kind, number, rows, used, residual, size, f"{size:.1f} sigma off after the fit ({words} {unit})"
    )


def _sigmas(residual: FloatArray, predicted: FloatArray, own: FloatArray) -> float:
    """Return the sigmas of a normal error that is as improbable; zero where no freedom is left."""
    values, vectors = np.linalg.eigh(predicted)
    free = values > LEAST_FREEDOM * float(np.trace(own))
    if not free.any():
        return 0.0
    return equal_sigmas(float(np.sum((vectors.T @ residual)[free] ** 2 / values[free])), int(free.sum()))


def equal_sigmas(square: float, freedom: int) -> float:
    """Return the sigmas of a normal error that is as improbable as a chi-squared.

    Examples
    --------
    >>> round(equal_sigmas(9.0, 1), 6), round(equal_sigmas(11.829, 2), 3)
    (3.0, 3.0)
    """
    improbable = float(chdtrc(freedom, square))
    return float(-ndtri(0.5 * improbable)) if improbable > 0.0 else max(MOST_SIGMAS, float(np.sqrt(square)))


def worst(scatters: Sequence[Scatter], reject_sigmas: float) -> Scatter | None:
    """Return the measurement in use that is farthest off, if that is too far."""
    used = [scatter for scatter in scatters if scatter.used]
    farthest = max(used, key=lambda s: s.sigmas, default=None)
    return farthest if farthest is not None and farthest.sigmas > reject_sigmas else None
