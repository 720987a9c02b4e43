"""What the residuals tell: how much centering error the covariances miss, and which stars are outliers.

Excess. Do the residuals scatter as the centers' covariances say? In a random-effects model one excess variance s^2,
the same for all stars and both coordinates, is added to the covariances. Plate errors, an imperfect PSF and catalog
errors act this way; scaling all covariances by one factor would instead punish the faint stars for the errors of the
bright ones. With 4 or 5 stars the scatter itself is known to 30 % only, so that a test which believes the covariances
until they are improbable lets errors of twice their sigma pass. Instead s^2 is averaged over what the residuals leave
possible:

    restricted likelihood   the attitude integrated out (Patterson & Thompson 1971, doi:10.1093/biomet/58.3.545)
    prior                   no excess at all, or an excess of any size: Jeffreys' prior of this likelihood, which far
                            above the given sigmas is flat in ln s

The average is what makes the covariance right in the mean square: where s dominates, it equals the sum of squares over
(freedom - 2), the variance of Student's t. With fewer than three degrees of freedom no average exists; there the
covariances are believed until they are improbable, and s then makes chi-squared equal its expectation (Paule & Mandel
1982, J. Res. NBS 87, 377, doi:10.6028/jres.087.022).

Outliers are found against a start that they cannot spoil. First all stars are fitted; if their residuals are what
their covariances say, nothing is done. Otherwise every pair of stars (or a sample of pairs) proposes an attitude, and
each is rated by the likelihood of the mixture

    p(residual) = (1 - P) N(residual; covariance + excess^2) + P / area,

in which a star is either good, its centering error perhaps larger than it says, or an outlier that may be anywhere.
This weighs "these bright stars are wrong" against "all centers are a little worse than they say", which a test in units
of the formal sigmas cannot do. From the best start stars are taken back in and put out, one and the same threshold for
all, until nothing changes; never more than a minority is put out.

References: Hogg, Bovy & Lang (2010), arXiv:1008.4686, section 3 (mixture); Fischler & Bolles (1981),
doi:10.1145/358669.358692 (proposals from minimal sets).
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry import unit
from opnav_workbench.robust import moment_excess
from opnav_workbench.stars.pointing.attitude_fit import (
    AttitudeFit,
    LinearizedProblem,
    PointingProblem,
    fit_attitude,
    with_excess_covariance,
)
from opnav_workbench.stars.pointing.attitude_steps import StepModel

__all__ = ["BELIEVED", "StarSelection", "chi2_probability", "excess_sigma", "select_stars"]


# ---- Do the residuals scatter as the centers' covariances say? If not, how much centering error is missing.

BELIEVED = 0.01  # a formal chi-squared less rare than this leaves the weights as they are
IMPROBABLE = 1e-3  # a formal chi-squared this rare (one picture in a thousand by chance) is not believed
EXCESS_TOLERANCE_PX = 1e-6  # far below any centering error
MIN_FREEDOM = 3  # of the stars alone; below, Student's t has no variance
# Prior odds of an excess within a factor e, far above the given sigmas, against none. With stars of equal sigma, error
# over sigma is then 0.95..1.25 for every excess from 4 stars on; less lets small ones pass, more doubts good covariances.
ODDS_PER_EFOLD = 0.3
LEAST_RATIO = 0.1  # an excess this far below the smallest given sigma changes nothing
MOST_RATIO = 30.0  # beyond this many times the residuals' own scatter the likelihood is nil
EXCESS_STEPS = 80  # of a grid in ln s: 0.1 to 0.2 e-folds apart, smoother than any likelihood of scatter


def chi2_probability(linear: LinearizedProblem, excess_sigma_px: float = 0.0) -> float:
    """Return the probability of a chi-squared at least as large by chance; 1 without redundancy."""
    if linear.freedom <= 0:
        return 1.0
    return float(chdtrc(linear.freedom, linear.chi2(excess_sigma_px)))


def excess_sigma(linear: LinearizedProblem) -> float:
    """Return the root of the mean excess variance, px, to be expected after these residuals; see the module."""
    if linear.chi2(0.0) <= linear.freedom:
        return 0.0  # no sign of an excess: the given covariances stand as they are
    if linear.residual_px.size - 3 >= MIN_FREEDOM:
        return _mean_excess_sigma(linear)
    return 0.0 if chi2_probability(linear) >= IMPROBABLE else _moment_excess_sigma(linear)


def _mean_excess_sigma(linear: LinearizedProblem) -> float:
    variance, design, residual = _scalar_measurements(linear)
    scatter = np.sqrt(variance.max() + np.max(residual**2))
    s = np.geomspace(LEAST_RATIO * np.sqrt(variance.min()), MOST_RATIO * scatter, EXCESS_STEPS)
    log_likelihood, information = _restricted_likelihood(
        linear, variance, design, residual, np.append(0.0, s**2)
    )
    odds = ODDS_PER_EFOLD * np.sqrt(information[1:] / linear.freedom) * s**2 * np.log(s[1] / s[0])
    weight = np.exp(log_likelihood - log_likelihood.max()) * np.append(1.0, odds)
    return float(np.sqrt(weight[1:] @ s**2 / weight.sum()))


def _scalar_measurements(linear: LinearizedProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Independent scalar measurements of the stars: variances (m,), design (m, 3), residuals (m,)."""
    variance, axes = np.linalg.eigh(linear.covariance_px2)
    turned = np.swapaxes(axes, 1, 2)
    residual = turned @ linear.residual_px[..., None]
    return variance.ravel(), (turned @ linear.jacobian).reshape(-1, 3), residual.ravel()


def _restricted_likelihood(
    linear: LinearizedProblem,
    variance: FloatArray,
    design: FloatArray,
    residual: FloatArray,
    excess_px2: FloatArray,
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


def _moment_excess_sigma(linear: LinearizedProblem) -> float:
    return moment_excess(lambda sigma_px: linear.chi2(sigma_px) - linear.freedom, EXCESS_TOLERANCE_PX)


# ---- Which stars belong together: outliers are found against a start that they cannot spoil.

REJECT_SIGMA = 4.0  # of both coordinates together: one good star in 3000 is lost
OUTLIER_FRACTION = 0.1  # P: cosmic rays, blends and wrong identifications in an ordinary picture
OUTLIER_AREA_PX2 = 1000.0  # they lie anywhere within a search area about this large
EXCESS_GRID_PX = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # only a start; the final excess is estimated
MAX_PAIRS = 300  # with 30 % outliers half of any sample of pairs is good
MAX_PASSES = 30  # sets of stars settle within a few
PROMISING = 10  # proposals that are refined
MIN_PAIR_RAD = 1e-9  # stars closer than this give no direction
SEED = 20130213  # of the sample of pairs; any will do, but the same every time


@dataclass(frozen=True, slots=True, eq=False)
class StarSelection:
    """Which of n stars to use, and with how much excess error.

    Attributes
    ----------
    used : (n,) array of bool
    fit
        To the used stars.
    distance : (n,) array
        Residuals in units of their sigmas, both coordinates together.
    ambiguous
        Three stars of which one may be wrong, but not which one.
    """

    used: BoolArray
    excess_sigma_px: float
    fit: AttitudeFit
    distance: FloatArray
    ambiguous: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)


def select_stars(
    stars: PointingProblem, model: StepModel, keep: BoolArray | None = None
) -> StarSelection | None:
    """Return which stars to use, those of `keep` always; None where no attitude fits them."""
    everyone = np.ones(len(stars), dtype=bool)
    fit = fit_attitude(stars, model, stars.start, everyone)
    agree = fit is not None and chi2_probability(fit.linear) >= IMPROBABLE
    if fit is not None and agree and np.all(_distances(stars, fit, everyone, 0.0) <= REJECT_SIGMA):
        return _with_excess(stars, model, fit, everyone)
    ambiguous = len(stars) == 3 and _consistent_pairs(stars) != 1
    if len(stars) < 3 or ambiguous:
        return None if fit is None else _with_excess(stars, model, fit, everyone, ambiguous)
    keep = ~everyone if keep is None else keep
    start, used = _consensus(stars, model) or (stars.start, everyone)
    return _reselect(stars, model, start, used | keep, keep)


def _reselect(
    stars: PointingProblem, model: StepModel, start: FloatArray, used: BoolArray, keep: BoolArray
) -> StarSelection | None:
    """Take in and put out stars until the set no longer changes."""
    result = None
    seen: set[bytes] = set()
    for _ in range(MAX_PASSES):
        result = _fit_with_excess(stars, model, start, used)
        if result is None or used.tobytes() in seen:
            break
        seen.add(used.tobytes())
        used = _at_least_majority(result.distance <= REJECT_SIGMA, result.distance) | keep
    return result


def _fit_with_excess(
    stars: PointingProblem, model: StepModel, start: FloatArray, used: BoolArray
) -> StarSelection | None:
    """Fit the given stars, with an excess error if their scatter asks for one."""
    fit = fit_attitude(stars, model, start, used)
    return None if fit is None else _with_excess(stars, model, fit, used)


def _with_excess(
    stars: PointingProblem, model: StepModel, fit: AttitudeFit, used: BoolArray, ambiguous: bool = False
) -> StarSelection | None:
    """Allow a fit an excess error if its scatter asks for one.

    One that chance may explain widens the covariance alone: weights that follow it would cost a sixth of the accuracy of
    four good stars. One that it does not enters the weights as well.
    """
    excess = excess_sigma(fit.linear)
    if excess > 0.0 and chi2_probability(fit.linear) >= BELIEVED:
        fit = with_excess_covariance(fit, excess)
    elif excess > 0.0:
        again = fit_attitude(stars, model, fit.attitude, used, excess)
        if again is None:
            return None
        fit = replace(again, path=(*fit.path, *again.path[1:]))
    return StarSelection(used, excess, fit, _distances(stars, fit, used, excess), ambiguous)


def _distances(stars: PointingProblem, fit: AttitudeFit, used: BoolArray, excess: float) -> FloatArray:
    """Residuals over their sigmas (n,); a star outside the fit also gets the fit's own uncertainty."""
    covariance = stars.covariance_px2 + excess**2 * np.eye(2)
    predicted = fit.jacobian @ fit.covariance_rad2 @ np.swapaxes(fit.jacobian, 1, 2)
    covariance = np.where(used[:, None, None], covariance, covariance + predicted)
    return np.sqrt(_squared_distances(fit.residual_px, covariance))


def _squared_distances(residual_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Squared residuals (..., n) in units of their covariances; infinite where there is no residual."""
    squared = np.einsum("...i,...ij,...j->...", residual_px, np.linalg.inv(covariance_px2), residual_px)
    return np.where(np.isfinite(squared), squared, np.inf)


def _at_least_majority(mask: BoolArray, distance: FloatArray) -> BoolArray:
    """Return `mask` with the closest of all stars added, so that more than half are in."""
    closest = np.zeros_like(mask)
    closest[np.argsort(distance, kind="stable")[: len(mask) // 2 + 1]] = True
    return mask | closest


def _consensus(stars: PointingProblem, model: StepModel) -> tuple[FloatArray, BoolArray] | None:
    """Attitude and good stars of the greatest likelihood; None where no pair of stars proposes one."""
    proposals = _pair_attitudes(stars)
    seen = stars.camera.project((proposals @ stars.directions.T).transpose(0, 2, 1).reshape(-1, 3))
    residual = stars.observed_px - seen.reshape(len(proposals), -1, 2)
    rating = np.max([_likelihood(stars, residual, excess)[0] for excess in EXCESS_GRID_PX], axis=0)
    promising = np.argsort(-rating, kind="stable")[:PROMISING]
    refined = [_refine_proposal(stars, model, proposals[i], residual[i]) for i in promising]
    found = [start for start in refined if start is not None]
    return max(found, key=lambda start: start[0])[1] if found else None


def _refine_proposal(
    stars: PointingProblem, model: StepModel, attitude: FloatArray, residual_px: FloatArray
) -> tuple[float, tuple[FloatArray, BoolArray]] | None:
    """Refit the stars that are rather good than outliers until they stay the same; likelihood first."""
    before = np.zeros(len(stars), dtype=bool)
    for _ in range(MAX_PASSES):
        rated = [(*_likelihood(stars, residual_px, excess), excess) for excess in EXCESS_GRID_PX]
        rating, good, squared, excess = max(rated, key=lambda r: float(r[0]))
        used = _at_least_majority(good, squared)
        if np.array_equal(used, before):
            break
        fit = fit_attitude(stars, model, attitude, used, excess)
        if fit is None:
            return None
        attitude, residual_px, before = fit.attitude, fit.residual_px, used
    return float(rating), (attitude, before)


def _likelihood(
    stars: PointingProblem, residual_px: FloatArray, excess: float
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Log likelihood (...) of residuals (..., n, 2); which are rather good (..., n); squared distances."""
    covariance = stars.covariance_px2 + excess**2 * np.eye(2)
    squared = _squared_distances(residual_px, covariance)
    normal = -0.5 * squared - 0.5 * np.log(np.linalg.det(2.0 * np.pi * covariance))
    good = normal + np.log(1.0 - OUTLIER_FRACTION)
    outlier = np.log(OUTLIER_FRACTION / OUTLIER_AREA_PX2)
    return np.logaddexp(good, outlier).sum(axis=-1), good > outlier, squared


def _pair_attitudes(stars: PointingProblem) -> FloatArray:
    """Attitudes (m, 3, 3) from pairs of stars: middles and directions from one to the other are aligned."""
    pairs = _pairs(len(stars))
    observed = stars.camera.unproject(stars.observed_px)
    apart = [np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (observed, stars.directions)]
    pairs = pairs[(apart[0] > MIN_PAIR_RAD) & (apart[1] > MIN_PAIR_RAD)]
    return _triads(observed, pairs) @ np.swapaxes(_triads(stars.directions, pairs), 1, 2)


def _pairs(n: int) -> IntArray:
    pairs = np.stack(np.triu_indices(n, 1), axis=1)
    if len(pairs) <= MAX_PAIRS:
        return pairs
    return pairs[np.random.default_rng(SEED).permutation(len(pairs))[:MAX_PAIRS]]


def _triads(directions: FloatArray, pairs: IntArray) -> FloatArray:
    """Right-handed orthonormal axes as columns (m, 3, 3): the pair's middle, along it, across it."""
    first, second = directions[pairs[:, 0]], directions[pairs[:, 1]]
    middle, along = unit(first + second), unit(second - first)
    return np.stack([middle, along, np.cross(middle, along)], axis=-1)


def _consistent_pairs(stars: PointingProblem) -> int:
    """Number of pairs whose observed separation agrees with the predicted one."""
    predicted = stars.camera.standing(stars.start).project(stars.directions @ stars.start.T)
    count = 0
    for i, j in combinations(range(len(stars)), 2):
        expected, observed = predicted[j] - predicted[i], stars.observed_px[j] - stars.observed_px[i]
        length = float(np.linalg.norm(expected))
        along = expected / length if length > 0.0 else np.array([1.0, 0.0])
        variance = float(along @ (stars.covariance_px2[i] + stars.covariance_px2[j]) @ along)
        mismatch = abs(float(np.linalg.norm(observed)) - length)
        count += mismatch <= REJECT_SIGMA * np.sqrt(variance)
    return count
