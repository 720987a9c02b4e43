"""Whether pieces of limb scatter as their model says: by how much larger, or smaller, a center's variance is.

A random field that is Gaussian and alike everywhere is no surface. Craters, sharp patches and a limb of another shape leave
pieces of limb that pull the center apart by more than expected; a surface that is more even than its prior, by less. So the
scatter of what they have of the solution is held beside what the model expects of it: the robust covariance of Huber (1967)
and White (1980, doi:10.2307/1912934), with neighbors in common (Newey & West 1987, doi:10.2307/1913610), but relative to
its expectation, since a limb has few independent pieces and the solution has taken most of their sum.

How far a model's variance may be off is not known beforehand, so it has an inverse chi-squared distribution of few degrees
of freedom, and the limb's adds to it; a center then has a Student's distribution, whose variance is what is told.
"""

import numpy as np

from opnav_workbench.bodies.disk.marginal import LimbScores

__all__ = ["limb_scatter"]

COMMON_TURN = 0.2  # of a turn: pieces farther apart pull by themselves
MODEL_DEGREES = 4.0  # of freedom that a model's own variance is worth
LEAST_INFORMATION = 1e-6  # of the largest: a direction without a limb


def limb_scatter(scores: LimbScores, excess: float = 1.0) -> float:
    """Return the variance of a center over that of its model, whose cells have `excess` times the variance it expects."""
    value, vector = np.linalg.eigh(scores.information)
    if not value[-1] > 0.0:
        return 1.0
    whiten = (vector / np.sqrt(np.maximum(value, LEAST_INFORMATION * value[-1]))).T
    found = whiten @ scores.found
    expected = np.einsum("ab,bjck,dc->ajdk", whiten, scores.expected, whiten)
    k, j = found.shape
    apart = np.abs(np.subtract.outer(np.arange(j), np.arange(j)))
    common = np.maximum(1.0 - np.minimum(apart, j - apart) / (COMMON_TURN * j + 1.0), 0.0)
    # A quadratic form of Gaussian numbers: mean, and degrees of freedom by its variance (Satterthwaite 1946).
    weighted = np.einsum("ij,ajbk->aibk", common, expected).reshape(k * j, k * j)
    mean, power = float(np.trace(weighted)), float(np.sum(weighted * weighted.T))
    if not (mean > 0.0 and power > 0.0):
        return 1.0
    ratio, degrees = float(np.sum((found @ common) * found)) / (excess * mean), mean**2 / power
    return (MODEL_DEGREES + degrees * ratio) / (MODEL_DEGREES + degrees - 2.0)
