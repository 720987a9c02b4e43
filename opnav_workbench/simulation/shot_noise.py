"""Photon counts that follow Poisson's law, each pixel with a random number of its own.

A generator of Poisson numbers takes more or fewer random numbers as the mean asks, so that one more star would change
the noise of all pixels after it. Here one normal deviate a pixel is turned into the count of the same probability:
pictures of one seed have the same noise wherever their light is the same, and their difference shows what differs.

Source: M. B. Giles (2016), "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
ACM Trans. Math. Softw. 42(1), 7, doi:10.1145/2699466 (its expansion Q_N about the normal quantile).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray

__all__ = ["poisson_counts"]

# Mean from which the expansion is good: fewer than one count in a thousand then differs (by 1) from the exact quantile.
SMALL_MEAN = 10.0
MOST_COUNTS = 120  # of a mean below SMALL_MEAN: the probability of more is below 1e-80


def poisson_counts(mean: ArrayLike, rng: np.random.Generator) -> FloatArray:
    """Draw one count per element.

    Parameters
    ----------
    mean : array_like
        Expected counts; negative ones count as 0.
    rng : numpy.random.Generator
        Gives one normal deviate per element, whatever the mean.

    Returns
    -------
    array
        Whole numbers, of the shape of `mean`.

    Examples
    --------
    >>> poisson_counts([0.0, 4.0, 400.0], np.random.default_rng(1))
    array([  0.,   6., 406.])
    """
    expected = np.asarray(mean, dtype=np.float64)
    deviate = rng.standard_normal(expected.shape)
    counts = np.zeros_like(expected)
    for some, quantile in (
        (expected >= SMALL_MEAN, _expansion),
        ((expected > 0.0) & (expected < SMALL_MEAN), _inversion),
    ):
        if some.all():
            return quantile(expected, deviate)
        if some.any():
            counts[some] = quantile(expected[some], deviate[some])
    return counts


def _expansion(mean: FloatArray, w: FloatArray) -> FloatArray:
    """Giles' asymptotic expansion of the quantile of deviates `w`, to terms in 1/mean."""
    root = np.sqrt(mean)
    w2 = w * w
    quantile = mean + root * w + (1.0 / 3.0 + w2 / 6.0) - w * (1.0 / 36.0 + w2 / 72.0) / root
    quantile += (-8.0 / 405.0 + w2 * (7.0 / 810.0 + w2 / 270.0)) / mean
    return np.maximum(np.floor(quantile), 0.0)


def _inversion(mean: FloatArray, w: FloatArray) -> FloatArray:
    """Smallest counts whose cumulative probability reaches that of deviates `w`, by summing the terms."""
    counts, means = np.zeros(mean.size), mean.ravel()
    term = np.exp(-means)
    rest = ndtr(w).ravel() - term
    open_ = np.flatnonzero(rest > 0.0)
    term, rest, means = term[open_], rest[open_], means[open_]
    for k in range(1, MOST_COUNTS):
        if len(open_) == 0:
            break
        counts[open_] = k
        term *= means / k
        rest -= term
        on = rest > 0.0
        open_, term, rest, means = open_[on], term[on], rest[on], means[on]
    return counts.reshape(mean.shape)
