"""Do the residuals scatter as the centers' covariances say? If not, how much centering error is missing.

A random-effects model: one excess variance s^2, the same for all stars and both coordinates, is added to the
covariances. Plate errors, an imperfect PSF and catalog errors act this way; scaling all covariances by one factor
would instead punish the faint stars for the errors of the bright ones.

With 4 or 5 stars the scatter itself is known to 30 % only, so that a test which believes the covariances until they
are improbable lets errors of twice their sigma pass. Instead s^2 is averaged over what the residuals leave possible:

    restricted likelihood   the attitude integrated out (Patterson & Thompson 1971, doi:10.1093/biomet/58.3.545)
    prior                   no excess at all, or an excess of any size: Jeffreys' prior of this likelihood, which far
                            above the given sigmas is flat in ln s

The average is what makes the covariance right in the mean square: where s dominates, it equals the sum of squares
over (freedom - 2), the variance of Student's t. With fewer than three degrees of freedom no average exists; there
the covariances are believed until they are improbable, and s then makes chi-squared equal its expectation (Paule &
Mandel 1982, J. Res. NBS 87, 377, doi:10.6028/jres.087.022).
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from opnav_workbench.arrays import FloatArray
from opnav_workbench.pointing.fit import Linear

__all__ = ["IMPROBABLE", "excess_sigma", "probability"]

IMPROBABLE = 1e-3  # a formal chi-squared this rare (one picture in a thousand by chance) is not believed
EXCESS_TOLERANCE_PX = 1e-6  # far below any centering error
MIN_FREEDOM = 3  # of the stars alone; below, Student's t has no variance
# Prior odds of an excess within a factor e, far above the given sigmas, against none. With stars of equal sigma, error
# over sigma is then 0.95..1.25 for every excess from 4 stars on; less lets small ones pass, more doubts good covariances.
ODDS_PER_EFOLD = 0.3
LEAST_RATIO = 0.1  # an excess this far below the smallest given sigma changes nothing
MOST_RATIO = 30.0  # beyond this many times the residuals' own scatter the likelihood is nil
EXCESS_STEPS = 80  # of a grid in ln s: 0.1 to 0.2 e-folds apart, smoother than any likelihood of scatter


def probability(linear: Linear, excess_sigma_px: float = 0.0) -> float:
    """Return the probability of a chi-squared at least as large by chance; 1 without redundancy."""
    if linear.freedom <= 0:
        return 1.0
    return float(chdtrc(linear.freedom, linear.chi2(excess_sigma_px)))


def excess_sigma(linear: Linear) -> float:
    """Return the root of the mean excess variance, px, to be expected after these residuals; see the module."""
    if linear.chi2(0.0) <= linear.freedom:
        return 0.0  # no sign of an excess: the given covariances stand as they are
    if linear.residual_px.size - 3 >= MIN_FREEDOM:
        return _expected(linear)
    return 0.0 if probability(linear) >= IMPROBABLE else _moment(linear)


def _expected(linear: Linear) -> float:
    variance, design, residual = _scalars(linear)
    scatter = np.sqrt(variance.max() + np.max(residual**2))
    s = np.geomspace(LEAST_RATIO * np.sqrt(variance.min()), MOST_RATIO * scatter, EXCESS_STEPS)
    log_likelihood, information = _restricted(linear, variance, design, residual, np.append(0.0, s**2))
    odds = ODDS_PER_EFOLD * np.sqrt(information[1:] / linear.freedom) * s**2 * np.log(s[1] / s[0])
    weight = np.exp(log_likelihood - log_likelihood.max()) * np.append(1.0, odds)
    return float(np.sqrt(weight[1:] @ s**2 / weight.sum()))


def _scalars(linear: Linear) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Independent scalar measurements of the stars: variances (m,), design (m, 3), residuals (m,)."""
    variance, axes = np.linalg.eigh(linear.covariance_px2)
    turned = np.swapaxes(axes, 1, 2)
    residual = turned @ linear.residual_px[..., None]
    return variance.ravel(), (turned @ linear.jacobian).reshape(-1, 3), residual.ravel()


def _restricted(
    linear: Linear, variance: FloatArray, design: FloatArray, residual: FloatArray, excess_px2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Restricted log likelihood (k,) and twice Fisher's information tr(P P) (k,) of excess variances (k,)."""
    scale = np.linalg.norm(design, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    rows, prior = design / scale, linear.prior_rows / scale
    weight = 1.0 / (variance + excess_px2[:, None])  # (k, m)
    powers = [np.einsum("km,mi,mj->kij", weight**p, rows, rows) for p in (1, 2, 3)]
    normal = powers[0] + prior.T @ prior
    right = (weight * residual) @ rows + linear.prior_residual @ prior
    step = np.linalg.solve(normal, right[..., None])[..., 0]
    chi2 = weight @ residual**2 + linear.prior_residual @ linear.prior_residual - np.sum(right * step, axis=1)
    square, cube = (np.linalg.solve(normal, power) for power in powers[1:])
    information = (
        np.sum(weight**2, axis=1)
        - 2.0 * np.trace(cube, axis1=1, axis2=2)
        + np.trace(square @ square, axis1=1, axis2=2)
    )
    log_likelihood = 0.5 * np.sum(np.log(weight), axis=1) - 0.5 * np.linalg.slogdet(normal)[1] - 0.5 * chi2
    return log_likelihood, np.maximum(information, 0.0)


def _moment(linear: Linear) -> float:
    def surplus(sigma_px: float) -> float:
        return linear.chi2(sigma_px) - linear.freedom

    upper = 0.1
    while surplus(upper) > 0.0:  # falls as 1 / sigma^2
        upper *= 2.0
    return float(brentq(surplus, 0.0, upper, xtol=EXCESS_TOLERANCE_PX))
