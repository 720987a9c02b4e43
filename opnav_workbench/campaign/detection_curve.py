"""Detections against magnitude: how faint a star may be and still be found, over many pictures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import betainccinv, betaincinv, expit

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import SessionError

__all__ = ["Completeness", "completeness"]

BIN_MAG = 0.5
CONFIDENCE = 0.68  # of the interval of each bin: one sigma
MIN_WIDTH_MAG, MAX_WIDTH_MAG = 0.02, 3.0  # from all to nothing: a step, or no dependence
PRIOR_STARS = 0.5  # Jeffreys' prior of a share


@dataclass(frozen=True, slots=True, eq=False)
class Completeness:
    """How many of the stars that should be there were found; arrays (n,) are read-only, one row a bin.

    Attributes
    ----------
    mag
        Middle of the bin.
    stars, detected : array of int
    share, low, high
        Detected share and its one-sigma interval (Jeffreys); nan in an empty bin.
    half_mag, half_mag_sigma
        Magnitude at which half of the stars are found, from a logistic curve through all stars; nan where the stars
        do not tell (all found, or none).
    width_mag
        Scale of that curve: 73 % are found one width brighter, 27 % one width fainter.
    """

    mag: FloatArray
    stars: IntArray
    detected: IntArray
    share: FloatArray
    low: FloatArray
    high: FloatArray
    half_mag: float
    half_mag_sigma: float
    width_mag: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def curve(self, mag: ArrayLike) -> FloatArray:
        """Return the share of the logistic curve at magnitudes (...)."""
        return np.asarray(expit((self.half_mag - np.asarray(mag, dtype=np.float64)) / self.width_mag))


def completeness(mag: ArrayLike, detected: ArrayLike, bin_mag: float = BIN_MAG) -> Completeness:
    """Return the completeness curve of stars that were on the detector.

    Parameters
    ----------
    mag : (n,) array_like
        Stars without a magnitude (nan) are left out.
    detected : (n,) array_like of bool

    Raises
    ------
    SessionError
        `bin_mag` is not positive, or the arrays differ in length.

    Examples
    --------
    >>> mag = np.linspace(8.0, 12.0, 200)
    >>> found = completeness(mag, mag < 10.3)
    >>> round(found.half_mag, 1), int(found.detected.sum())
    (10.3, 115)
    """
    m, found = np.asarray(mag, dtype=np.float64), np.asarray(detected, dtype=bool)
    if m.shape != found.shape or not bin_mag > 0.0:
        raise SessionError(
            f"{m.shape} magnitudes, {found.shape} detections, bins of {bin_mag} mag: not a curve."
        )
    m, found = m[np.isfinite(m)], found[np.isfinite(m)]
    first = np.floor(m / bin_mag).astype(np.int64)
    lowest = int(first.min()) if len(first) else 0
    count = int(first.max() - lowest + 1) if len(first) else 0
    stars = np.bincount(first - lowest, minlength=count)[:count]
    seen = np.bincount((first - lowest)[found], minlength=count)[:count]
    tail = 0.5 * (1.0 - CONFIDENCE)
    a, b = seen + PRIOR_STARS, stars - seen + PRIOR_STARS
    filled = np.where(stars > 0, 1.0, np.nan)
    half, sigma, width = _logistic(m, found)
    return Completeness(
        mag=np.asarray((lowest + np.arange(count) + 0.5) * bin_mag, dtype=np.float64),
        stars=stars,
        detected=seen,
        share=filled * seen / np.maximum(stars, 1),
        low=filled * np.where(seen == 0, 0.0, betaincinv(a, b, tail)),
        high=filled * np.where(seen == stars, 1.0, betainccinv(a, b, tail)),
        half_mag=half,
        half_mag_sigma=sigma,
        width_mag=width,
    )


def _logistic(mag: FloatArray, found: np.ndarray) -> tuple[float, float, float]:
    """Maximum likelihood of a logistic curve: magnitude of one half, its sigma, width."""
    if not found.any() or found.all():
        return np.nan, np.nan, np.nan
    sign = np.where(found, 1.0, -1.0)

    def minus_log(parameters: FloatArray) -> float:
        half, log_width = parameters
        return float(np.logaddexp(0.0, -sign * (half - mag) / np.exp(log_width)).sum())

    start = np.array([0.5 * (np.median(mag[found]) + np.median(mag[~found])), np.log(0.3)])
    reach = (float(mag.min()) - 1.0, float(mag.max()) + 1.0)
    widths = (np.log(MIN_WIDTH_MAG), np.log(MAX_WIDTH_MAG))
    best = minimize(minus_log, start, method="L-BFGS-B", bounds=[reach, widths]).x
    width = float(np.exp(best[1]))
    share = expit((best[0] - mag) / width)
    information = float((share * (1.0 - share)).sum()) / width**2
    sigma = information**-0.5 if information > 0.0 else np.nan
    return float(best[0]), sigma, width
