"""Which stars belong together: outliers are found against a start that they cannot spoil.

First all stars are fitted; if their residuals are what their covariances say, nothing is done. Otherwise
every pair of stars (or a sample of pairs) proposes an attitude, and each is rated by the likelihood of the
mixture

    p(residual) = (1 - P) N(residual; covariance + excess^2) + P / area,

in which a star is either good, its centering error perhaps larger than it says, or an outlier that may be
anywhere. This weighs "these bright stars are wrong" against "all centers are a little worse than they say",
which a test in units of the formal sigmas cannot do. From the best start stars are taken back in and put out,
one and the same threshold for all, until nothing changes; never more than a minority is put out.

Reference: Hogg, Bovy & Lang (2010), arXiv:1008.4686, section 3 (mixture); Fischler & Bolles (1981),
doi:10.1145/358669.358692 (proposals from minimal sets).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry import unit
from opnav_workbench.pointing.excess import IMPROBABLE, excess_sigma, probability
from opnav_workbench.pointing.fit import Fit, Sightings, fit_attitude
from opnav_workbench.pointing.models import StepModel

__all__ = ["Selection", "select_stars"]

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
class Selection:
    """Which of n stars to use, and with how much excess error.

    Attributes
    ----------
    used : (n,) array of bool
    excess_sigma_px : float
    fit : Fit
        To the used stars.
    distance : (n,) array
        Residuals in units of their sigmas, both coordinates together.
    ambiguous : bool
        Three stars of which one may be wrong, but not which one.
    """

    used: BoolArray
    excess_sigma_px: float
    fit: Fit
    distance: FloatArray
    ambiguous: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)


def select_stars(stars: Sightings, model: StepModel, keep: BoolArray | None = None) -> Selection | None:
    """Return which stars to use, those of `keep` always; None where no attitude fits them."""
    everyone = np.ones(len(stars), dtype=bool)
    fit = fit_attitude(stars, model, stars.start, everyone)
    agree = fit is not None and probability(fit.linear) >= IMPROBABLE
    if fit is not None and agree and np.all(_distances(stars, fit, everyone, 0.0) <= REJECT_SIGMA):
        return _settled(stars, model, stars.start, everyone)
    ambiguous = len(stars) == 3 and _consistent_pairs(stars) != 1
    if len(stars) < 3 or ambiguous:
        return _settled(stars, model, stars.start, everyone, ambiguous)
    keep = ~everyone if keep is None else keep
    start, used = _consensus(stars, model) or (stars.start, everyone)
    return _settle(stars, model, start, used | keep, keep)


def _settle(
    stars: Sightings, model: StepModel, start: FloatArray, used: BoolArray, keep: BoolArray
) -> Selection | None:
    """Take in and put out stars until the set no longer changes."""
    result = None
    seen: set[bytes] = set()
    for _ in range(MAX_PASSES):
        result = _settled(stars, model, start, used)
        if result is None or used.tobytes() in seen:
            break
        seen.add(used.tobytes())
        used = _at_least_majority(result.distance <= REJECT_SIGMA, result.distance) | keep
    return result


def _settled(
    stars: Sightings, model: StepModel, start: FloatArray, used: BoolArray, ambiguous: bool = False
) -> Selection | None:
    """Fit the given stars, with an excess error if their scatter asks for one."""
    fit = fit_attitude(stars, model, start, used)
    excess = 0.0 if fit is None else excess_sigma(fit.linear)
    if fit is not None and excess > 0.0:
        fit = fit_attitude(stars, model, fit.attitude, used, excess)
    if fit is None:
        return None
    return Selection(used, excess, fit, _distances(stars, fit, used, excess), ambiguous)


def _distances(stars: Sightings, fit: Fit, used: BoolArray, excess: float) -> FloatArray:
    """Residuals over their sigmas (n,); a star outside the fit also gets the fit's own uncertainty."""
    covariance = stars.covariance_px2 + excess**2 * np.eye(2)
    predicted = fit.jacobian @ fit.covariance_rad2 @ np.swapaxes(fit.jacobian, 1, 2)
    covariance = np.where(used[:, None, None], covariance, covariance + predicted)
    return np.sqrt(_squared(fit.residual_px, covariance))


def _squared(residual_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Squared residuals (..., n) in units of their covariances; infinite where there is no residual."""
    squared = np.einsum("...i,...ij,...j->...", residual_px, np.linalg.inv(covariance_px2), residual_px)
    return np.where(np.isfinite(squared), squared, np.inf)


def _at_least_majority(mask: BoolArray, distance: FloatArray) -> BoolArray:
    """Return `mask` with the closest of all stars added, so that more than half are in."""
    closest = np.zeros_like(mask)
    closest[np.argsort(distance, kind="stable")[: len(mask) // 2 + 1]] = True
    return mask | closest


def _consensus(stars: Sightings, model: StepModel) -> tuple[FloatArray, BoolArray] | None:
    """Attitude and good stars of the greatest likelihood; None where no pair of stars proposes one."""
    proposals = _pair_attitudes(stars)
    seen = stars.camera.project((proposals @ stars.directions.T).transpose(0, 2, 1).reshape(-1, 3))
    residual = stars.observed_px - seen.reshape(len(proposals), -1, 2)
    rating = np.max([_likelihood(stars, residual, excess)[0] for excess in EXCESS_GRID_PX], axis=0)
    promising = np.argsort(-rating, kind="stable")[:PROMISING]
    refined = [_refine(stars, model, proposals[i], residual[i]) for i in promising]
    found = [start for start in refined if start is not None]
    return max(found, key=lambda start: start[0])[1] if found else None


def _refine(
    stars: Sightings, model: StepModel, attitude: FloatArray, residual_px: FloatArray
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
    stars: Sightings, residual_px: FloatArray, excess: float
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Log likelihood (...) of residuals (..., n, 2); which are rather good (..., n); squared distances."""
    covariance = stars.covariance_px2 + excess**2 * np.eye(2)
    squared = _squared(residual_px, covariance)
    normal = -0.5 * squared - 0.5 * np.log(np.linalg.det(2.0 * np.pi * covariance))
    good = normal + np.log(1.0 - OUTLIER_FRACTION)
    outlier = np.log(OUTLIER_FRACTION / OUTLIER_AREA_PX2)
    return np.logaddexp(good, outlier).sum(axis=-1), good > outlier, squared


def _pair_attitudes(stars: Sightings) -> FloatArray:
    """Attitudes (m, 3, 3) from pairs of stars: middles and directions from one to the other are aligned."""
    pairs = _pairs(len(stars))
    observed = stars.camera.unproject(stars.observed_px)
    apart = [np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (observed, stars.directions)]
    pairs = pairs[(apart[0] > MIN_PAIR_RAD) & (apart[1] > MIN_PAIR_RAD)]
    return _triads(observed, pairs) @ np.swapaxes(_triads(stars.directions, pairs), 1, 2)


def _pairs(n: int) -> IntArray:
    pairs = np.array(list(combinations(range(n), 2)))
    if len(pairs) <= MAX_PAIRS:
        return pairs
    return np.random.default_rng(SEED).permutation(pairs)[:MAX_PAIRS]


def _triads(directions: FloatArray, pairs: IntArray) -> FloatArray:
    """Right-handed orthonormal axes as columns (m, 3, 3): the pair's middle, along it, across it."""
    first, second = directions[pairs[:, 0]], directions[pairs[:, 1]]
    middle, along = unit(first + second), unit(second - first)
    return np.stack([middle, along, np.cross(middle, along)], axis=-1)


def _consistent_pairs(stars: Sightings) -> int:
    """Number of pairs whose observed separation agrees with the predicted one."""
    predicted = stars.camera.project(stars.directions @ stars.start.T)
    count = 0
    for i, j in combinations(range(len(stars)), 2):
        expected, observed = predicted[j] - predicted[i], stars.observed_px[j] - stars.observed_px[i]
        length = float(np.linalg.norm(expected))
        along = expected / length if length > 0.0 else np.array([1.0, 0.0])
        variance = float(along @ (stars.covariance_px2[i] + stars.covariance_px2[j]) @ along)
        mismatch = abs(float(np.linalg.norm(observed)) - length)
        count += mismatch <= REJECT_SIGMA * np.sqrt(variance)
    return count
