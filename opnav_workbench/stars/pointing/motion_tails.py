"""Stars whose motion nobody measured: what each of them is worth, seen beside the others.

The motions of stars are no Gaussian: most are slow, a few per cent ten times as fast. A star's unknown motion is a mixture
of Gaussians (`catalog.proper_motion`), and what the residuals of the others leave possible tells to which part it
belongs. Expectation propagation does that for all stars at once: each star is taken out, the others predict its place,
the mixture is put there with the star's center, and the star goes back as the one Gaussian with the same spread. A star
alone keeps the spread of the whole mixture; among many the quiet ones count by the narrow part, and one that has run away
hardly counts, without a threshold.

Reference: Minka (2001), "Expectation propagation for approximate Bayesian inference", UAI 17.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays

__all__ = ["MotionTails", "effective_covariance"]

ROUNDS = 8  # weights settle to a per cent
DAMPING = 0.6  # of a round's change: neighbors change at the same time
# Sites between two parts of a mixture would be negative, and are left out: by so much the others promise too much. From
# simulated fields of 3 to 30 stars, at latitudes of 0 to 90 deg, centers from a tenth of the motions to as large.
UNSETTLED = 0.6
FLAT_SIGMA_RAD = 0.1  # nothing but the twist is known of the attitude: stars decide it alone


@dataclass(frozen=True, slots=True, eq=False)
class MotionTails:
    """What unknown motions do to the predicted places of n stars.

    Attributes
    ----------
    covariance_px2 : (n, 2, 2) array
        Share of the catalog covariance that unknown motions have, with the variance of the whole mixture; 0 where a motion
        is known.
    weights, variances : (n, k) arrays
        Of the parts of the mixture: how many stars belong to them, and their variance as a multiple of the whole's.
    """

    covariance_px2: FloatArray
    weights: FloatArray
    variances: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def take(self, rows: IntArray | BoolArray) -> "MotionTails":
        """Return some of the stars, by index or mask."""
        return MotionTails(self.covariance_px2[rows], self.weights[rows], self.variances[rows])


def effective_covariance(
    residual_px: FloatArray,
    jacobian: FloatArray,
    covariance_px2: FloatArray,
    tails: MotionTails,
    prior_information: FloatArray,
) -> FloatArray:
    """Return the covariances (n, 2, 2), px^2, with which each star counts beside the others.

    Parameters
    ----------
    residual_px : (n, 2) array
        At an attitude near the solution.
    jacobian : (n, 2, 3) array
        d(pixel, line) / d(rotation vector), px/rad.
    covariance_px2 : (n, 2, 2) array
        Of center and catalog place, unknown motions with the variance of their whole mixture.
    tails
        What of it is unknown motion.
    prior_information : (3, 3) array
        What is known of the attitude without stars, rad^-2.
    """
    rest = covariance_px2 - tails.covariance_px2
    parts = rest[:, None] + tails.variances[..., None, None] * tails.covariance_px2[:, None]  # (n, k, 2, 2)
    unknown = np.trace(tails.covariance_px2, axis1=1, axis2=2)
    moving = unknown > 0.0
    scale = np.ones(len(residual_px))
    transposed = np.swapaxes(jacobian, 1, 2)
    prior = prior_information + np.eye(3) / FLAT_SIGMA_RAD**2
    for _ in range(ROUNDS):
        weighted = transposed @ np.linalg.inv(rest + scale[:, None, None] * tails.covariance_px2)
        information, right = weighted @ jacobian, (weighted @ residual_px[..., None])[..., 0]
        others = prior + information.sum(axis=0) - information
        spread = np.linalg.inv(others)
        place = (jacobian @ spread @ (right.sum(axis=0) - right)[..., None])[..., 0]
        site = _matched_sites(residual_px - place, jacobian @ spread @ transposed, parts, tails.weights)
        fresh = _scales(site, rest, tails)
        scale = np.where(moving, scale + DAMPING * (fresh - scale), 1.0)
    effective = rest + scale[:, None, None] * tails.covariance_px2
    return np.asarray(
        _unsettled(effective, jacobian @ spread @ transposed, covariance_px2, scale * unknown) * effective
    )


def _unsettled(
    effective: FloatArray, spread: FloatArray, whole: FloatArray, moving_px2: FloatArray
) -> FloatArray:
    """Factors (n, 1, 1): more than the parts' Gaussians say is unknown while it is unknown which part a star belongs to."""
    share = moving_px2 / np.trace(effective, axis1=1, axis2=2)
    own, others = (np.trace(a, axis1=1, axis2=2) for a in (whole, spread))
    return np.asarray(1.0 + UNSETTLED * share * own / (own + others))[:, None, None]


def _matched_sites(
    offset: FloatArray, spread: FloatArray, parts: FloatArray, weights: FloatArray
) -> FloatArray:
    """Inverse covariances (n, 2, 2) of the Gaussians that leave each place as uncertain as its mixture does.

    Between two parts they are negative: a residual there makes the place less certain than it was.
    """
    total = spread[:, None] + parts
    inverse = np.linalg.inv(total)
    square = np.einsum("ni,nkij,nj->nk", offset, inverse, offset)
    with np.errstate(divide="ignore"):  # a part that no star belongs to
        log_part = np.log(weights) - 0.5 * np.log(np.linalg.det(total)) - 0.5 * square
    part = np.exp(log_part - logsumexp(log_part, axis=1, keepdims=True))
    gain = spread[:, None] @ inverse
    step = np.einsum("nkij,nj->nki", gain, offset)
    apart = step - np.einsum("nk,nki->ni", part, step)[:, None]
    left = spread[:, None] - gain @ spread[:, None] + apart[..., :, None] * apart[..., None, :]
    posterior = np.einsum("nk,nkij->nij", part, left)
    return np.asarray(np.linalg.inv(posterior) - np.linalg.inv(spread))


def _scales(site: FloatArray, rest: FloatArray, tails: MotionTails) -> FloatArray:
    """Multiples (n,) of the mixture's covariance that agree with the sites, within those of its parts."""
    positive = np.linalg.eigvalsh(site)[:, 0] > 0.0
    wide = np.trace(np.linalg.inv(np.where(positive[:, None, None], site, np.eye(2))), axis1=1, axis2=2)
    unknown = np.trace(tails.covariance_px2, axis1=1, axis2=2)
    excess = wide - np.trace(rest, axis1=1, axis2=2)
    scale = np.where(positive, excess / np.where(unknown > 0.0, unknown, 1.0), np.inf)
    return np.clip(scale, tails.variances.min(axis=1), tails.variances.max(axis=1))
