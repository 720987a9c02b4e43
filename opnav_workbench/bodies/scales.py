"""Linear unknowns of which nobody said how far they may be from their model: a mixture over scales.

A figure that was measured before is right to a percent; one of a first approach is off by ten. Neither is known of a body
whose uncertainty nobody stated. Each scale is a Gaussian prior of its own; the data weigh them by their evidence, and
moments are taken over all of them (Bayesian model averaging; Hoeting et al. 1999, doi:10.1214/ss/1009212519). So a simple
figure is believed as far as it explains the picture, and let go where it does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays

__all__ = ["RIDGE", "MixedSolution", "mixed_solution", "scale_precisions"]

RIDGE = 1e-11  # of a unit diagonal: keeps what nothing tells from becoming infinite
LARGEST_SCALE = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class MixedSolution:
    """Moments over k scales.

    Attributes
    ----------
    theta, covariance : (p,), (p, p) arrays
    log_evidence
        Of normal equations: what depends on their right side and on the prior.
    gained
        What chi-squared falls by from theta = 0, the mean over the scales; prior included.
    share : (k,) array
        Of each scale.
    """

    theta: FloatArray
    covariance: FloatArray
    log_evidence: float
    gained: float
    share: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def scale_precisions(unknowns: int, *groups: tuple[Sequence[int], ArrayLike]) -> FloatArray:
    """Return the precisions (k, unknowns) of all combinations of scales; 0 of what has none.

    Each of `groups` is n indices with the sigmas (m, n), or (m,) for all of them alike, that they have in each of m scales.
    """
    out = np.zeros((1, unknowns))
    for indices, sigmas in groups:
        each = np.reshape(np.asarray(sigmas, dtype=np.float64) ** -2.0, (len(np.atleast_1d(sigmas)), -1))
        out = np.repeat(out, len(each), axis=0)
        out[:, list(indices)] += np.tile(each, (len(out) // len(each), 1))
    return out


def mixed_solution(
    normal: FloatArray, right: FloatArray, precisions: FloatArray, least: FloatArray | float = 0.0
) -> MixedSolution:
    """Solve normal equations (p, p), (p,) with a prior of mean 0 that has one of the precisions (k, p).

    Their diagonal counts as `least` (p,) at least. What no prior and no data tell gets a large covariance instead of an
    infinite one.
    """
    scaled = np.any(precisions > 0.0, axis=0)
    plain = ~scaled
    inverse, log_plain = _inverse(normal[np.ix_(plain, plain)], np.broadcast_to(least, right.shape)[plain])
    # What has no scale is solved for once; what is left is small.
    carry = inverse @ normal[np.ix_(plain, scaled)]
    first = inverse @ right[plain]
    inner = normal[np.ix_(scaled, scaled)] - normal[np.ix_(scaled, plain)] @ carry
    rest = right[scaled] - carry.T @ right[plain]
    own = precisions[:, scaled]
    root = 1.0 / np.sqrt(own)
    even = root[:, :, None] * inner * root[:, None, :] + np.eye(len(rest))
    each = root[:, :, None] * np.linalg.inv(even) * root[:, None, :]
    theta = each @ rest
    gained = theta @ rest + float(first @ right[plain])
    log_evidence = 0.5 * (gained - np.linalg.slogdet(even)[1] - log_plain) - np.log(len(precisions))
    most = float(log_evidence.max())
    share = np.exp(log_evidence - most)
    total = float(share.sum())
    share = share / total
    mean = share @ theta
    away = theta - mean
    spread = np.einsum("k,kij->ij", share, each) + np.einsum("k,ki,kj->ij", share, away, away)
    whole_mean, whole = np.empty(len(right)), np.empty(normal.shape)
    whole_mean[scaled], whole_mean[plain] = mean, first - carry @ mean
    whole[np.ix_(scaled, scaled)] = spread
    whole[np.ix_(plain, scaled)] = -carry @ spread
    whole[np.ix_(scaled, plain)] = whole[np.ix_(plain, scaled)].T
    whole[np.ix_(plain, plain)] = inverse + carry @ spread @ carry.T
    return MixedSolution(whole_mean, whole, most + float(np.log(total)), float(share @ gained), share)


def _inverse(normal: FloatArray, least: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of normal equations whose diagonal counts as `least` at least, and their log determinant."""
    scale = 1.0 / np.sqrt(np.maximum(np.maximum(np.diag(normal), least), 1e-300))
    scaled = normal * scale[:, None] * scale
    scaled[np.diag_indices(len(scale))] += RIDGE
    value, vector = np.linalg.eigh(scaled)
    value = np.maximum(value, RIDGE)
    log_determinant = float(np.log(value).sum() - 2.0 * np.log(scale).sum())
    scale = np.minimum(scale, LARGEST_SCALE)  # of what no pixel depends on
    return scale[:, None] * ((vector / value) @ vector.T) * scale, log_determinant
