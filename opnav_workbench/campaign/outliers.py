"""Outliers of a series: robust against what it looks for, with a stated rate of false alarms for the whole series.

A robust line (or level) is laid through the series; each point is then compared with what the others predict for it, so
that a lonely point does not hide behind a line that it bends. It is flagged where it is farther off than noise alone would
bring any point of such a series, once in a hundred series.

Reference: deletion residuals, Cook & Weisberg (1982), Residuals and Influence in Regression; robust weights, Beaton & Tukey
(1974), doi:10.1080/00401706.1974.10489171.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.constants import MAD_TO_SIGMA

__all__ = ["Screened", "screen"]

FALSE_ALARM = 0.01  # of a series without outliers: one in a hundred shows one nevertheless
MIN_POINTS = 6  # of fewer, half may be wrong without anybody knowing which half
MAD_EFFICIENCY = 0.37  # asymptotic, against the standard deviation: its scatter is that of 0.37 n points
LINE_POINTS = 10  # a slope from fewer points follows the outlier
BISQUARE = 4.685  # sigmas: 95 % as good as least squares where there is no outlier
PASSES = 20
MAX_PAIRS_POINTS = 400  # Theil-Sen looks at every pair of points; longer series are thinned evenly


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """A series and its outliers; arrays (n,) are read-only.

    Attributes
    ----------
    level
        The robust line, or level of a short series.
    deviation
        Distance of each point from what the others predict for it, over the error of that difference; nan for a point that
        is not known.
    scatter
        Robust standard deviation about `level`, in the unit of the values or, with sigmas, in sigmas; at least 1 there.
    threshold
        Of `deviation`.
    outlier : array of bool
    """

    level: FloatArray
    deviation: FloatArray
    scatter: float
    threshold: float
    outlier: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def threshold_sigmas(count: int, false_alarm: float = FALSE_ALARM) -> float:
    """Return how many robust sigmas a point of `count` must be off to be flagged.

    Each point gets its share of the false-alarm rate (Bonferroni); the scatter, known from the points themselves, makes
    the deviations Student's t, with as many degrees of freedom as the median absolute deviation is worth.

    Examples
    --------
    >>> [round(threshold_sigmas(n), 1) for n in (10, 100, 10_000)]
    [9.5, 4.4, 4.9]
    """
    freedom = max(MAD_EFFICIENCY * count, 1.0)
    return -float(stdtrit(freedom, _share(count, false_alarm)))


def _share(count: int, false_alarm: float) -> float:
    """One point's part of the false-alarm rate, on one side."""
    return 0.5 * false_alarm / max(count, 1)


def screen(
    time: ArrayLike,
    values: ArrayLike,
    sigmas: ArrayLike | None = None,
    *,
    false_alarm: float = FALSE_ALARM,
) -> Screened:
    """Find the outliers of a series.

    Parameters
    ----------
    time, values : (n,) array_like
        In any order and unit; nan values are no outliers.
    sigmas : (n,) array_like, optional
        Of the values. Then a deviation counts in these, and a scatter below them is not believed.
    false_alarm
        Probability that a series of nothing but noise shows an outlier.

    Examples
    --------
    >>> values = np.sin(np.arange(30.0) * 7.0)
    >>> values[4] += 20.0
    >>> np.flatnonzero(screen(np.arange(30.0), values).outlier)
    array([4])
    """
    t, y = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    s = np.ones(len(y)) if sigmas is None else np.asarray(sigmas, dtype=np.float64)
    known = np.isfinite(t) & np.isfinite(y) & np.isfinite(s) & (s > 0.0)
    count = int(known.sum())
    level, deviation = np.full((2, len(y)), np.nan)
    if not count:
        return Screened(level, deviation, 1.0, np.inf, np.zeros(len(y), dtype=bool))
    fit = _Line(t[known], y[known], s[known], believed=sigmas is not None)
    deviation[known] = fit.deviations()
    level[:] = fit.at(t)
    limit = threshold_sigmas(count, false_alarm)
    if sigmas is not None and fit.scatter == 1.0:  # the points' own sigmas explain all: nothing was estimated
        limit = -float(ndtri(_share(count, false_alarm)))
    found = (np.abs(np.nan_to_num(deviation)) > limit) & (count >= MIN_POINTS)
    return Screened(level, deviation, fit.scatter, limit, found)


class _Line:
    """A robust line through points with sigmas, and what the others predict for each."""

    def __init__(self, t: FloatArray, y: FloatArray, sigma: FloatArray, *, believed: bool) -> None:
        self._center, self._span = float(np.median(t)), float(np.ptp(t)) or 1.0
        self._y, self._sigma, self._believed = y, sigma, believed
        sloped = len(t) >= LINE_POINTS and float(np.ptp(t)) > 0.0
        self._x = self._terms(t)[:, : 2 if sloped else 1]
        self._solution = _theil_sen(self._x, y)
        for _ in range(PASSES):
            self.scatter = self._scatter_of(self._residuals())
            self._weight = self._weights()
            self._solution = self._solved()
        self.scatter = self._scatter_of(self._residuals())

    def at(self, t: FloatArray) -> FloatArray:
        """The line at times (n,)."""
        return np.asarray(self._terms(t)[:, : len(self._solution)] @ self._solution)

    def deviations(self) -> FloatArray:
        """Distance of each point (n,) from the line through the others, over the error of both."""
        x, weight = self._x, self._weight / self._sigma**2
        own = weight[:, None, None] * x[:, :, None] * x[:, None, :]
        inverse = np.linalg.pinv(own.sum(axis=0) - own, hermitian=True)
        moments = weight[:, None] * x * self._y[:, None]
        predicted = np.einsum("ni,nij,nj->n", x, inverse, moments.sum(axis=0) - moments)
        error = self._sigma**2 + np.einsum("ni,nij,nj->n", x, inverse, x)
        return np.asarray((self._y - predicted) / (self.scatter * np.sqrt(error)))

    def _terms(self, t: FloatArray) -> FloatArray:
        return np.stack([np.ones(len(t)), (t - self._center) / self._span], axis=1)

    def _residuals(self) -> FloatArray:
        return np.asarray((self._y - self._x @ self._solution) / self._sigma)

    def _scatter_of(self, residuals: FloatArray) -> float:
        # What was fitted takes part of the scatter away; the finite-sample factor is that of Croux & Rousseeuw (1992).
        few = len(residuals) / max(len(residuals) - 0.8 * self._x.shape[1], 0.2)
        robust = few * MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
        rounding = 1e-12 * float(np.abs(self._y / self._sigma).max())  # points that do not scatter at all
        return float(max(robust, 1.0 if self._believed else rounding, np.finfo(float).tiny))

    def _weights(self) -> FloatArray:
        square = np.minimum((self._residuals() / (BISQUARE * self.scatter)) ** 2, 1.0)
        return np.asarray((1.0 - square) ** 2)

    def _solved(self) -> FloatArray:
        root = np.sqrt(self._weight) / self._sigma
        return np.asarray(np.linalg.lstsq(root[:, None] * self._x, root * self._y, rcond=None)[0])


def _theil_sen(x: FloatArray, y: FloatArray) -> FloatArray:
    """Median of all slopes, or the median alone: a start that half of the points cannot spoil."""
    if x.shape[1] == 1:
        return np.array([float(np.median(y))])
    order = np.argsort(x[:, 1], kind="stable")[:: -(-len(y) // MAX_PAIRS_POINTS)]
    t, z = x[order, 1], y[order]
    first, second = np.triu_indices(len(t), 1)
    apart = t[second] > t[first]
    slope = float(np.median((z[second] - z[first])[apart] / (t[second] - t[first])[apart]))
    return np.array([float(np.median(y - slope * x[:, 1])), slope])
