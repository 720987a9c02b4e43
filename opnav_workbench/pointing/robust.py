"""Which stars belong together: outliers are found against a start that they cannot spoil.

First all stars are fitted; if their residuals are what their covariances say, nothing is done. Otherwise
every pair of stars (or a sample of pairs) proposes an attitude; those that suit the better half of the stars
best are refined by least trimmed squares (Rousseeuw & Van Driessen 2006, doi:10.1007/s10618-005-0024-4),
which holds as long as the outliers are the minority. From there stars are taken back in and put out, one and
the same threshold for all, until nothing changes; never more than a minority is put out.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.geometry import unit
from opnav_workbench.pointing.excess import IMPROBABLE, excess_sigma, probability
from opnav_workbench.pointing.fit import Fit, Sightings, fit_attitude
from opnav_workbench.pointing.models import StepModel

__all__ = ["Selection", "select_stars"]

REJECT_SIGMA = 4.0  # of both coordinates together: one good star in 3000 is lost
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


def select_stars(stars: Sightings, model: StepModel) -> Selection | None:
    """Return which stars to use; None where no attitude fits them."""
    everyone = np.ones(len(stars), dtype=bool)
    fit = fit_attitude(stars, model, stars.a_priori, everyone)
    if fit is not None:
        distance = _distances(stars, fit, everyone, 0.0)
        if probability(fit.linear) >= IMPROBABLE and np.all(distance <= REJECT_SIGMA):
            return Selection(everyone, 0.0, fit, distance)
    ambiguous = len(stars) == 3 and _consistent_pairs(stars) != 1
    if len(stars) < 3 or ambiguous:
        return _settled(stars, model, stars.a_priori, everyone, ambiguous)
    start = _consensus(stars, model)
    return None if start is None else _settle(stars, model, *start)


def _settle(stars: Sightings, model: StepModel, start: FloatArray, core: BoolArray) -> Selection | None:
    """Take in and put out stars until the set no longer changes."""
    used = core
    result = None
    seen: set[bytes] = set()
    for _ in range(MAX_PASSES):
        result = _settled(stars, model, start, used)
        if result is None or used.tobytes() in seen:
            break
        seen.add(used.tobytes())
        used = _closest(result.distance, int(np.sum(core))) | (result.distance <= REJECT_SIGMA)
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


def _closest(distance: FloatArray, count: int) -> BoolArray:
    """True for the `count` smallest of `distance` (n,)."""
    mask = np.zeros(distance.shape, dtype=bool)
    mask[np.argsort(distance, kind="stable")[:count]] = True
    return mask


def _consensus(stars: Sightings, model: StepModel) -> tuple[FloatArray, BoolArray] | None:
    """Attitude and majority of stars with the least trimmed sum of squares; None without proposals."""
    proposals = _pair_attitudes(stars)
    majority = len(stars) // 2 + 1
    seen = stars.camera.project((proposals @ stars.directions.T).transpose(0, 2, 1).reshape(-1, 3))
    residual = stars.observed_px - seen.reshape(len(proposals), -1, 2)
    squared = _squared(residual, stars.covariance_px2)
    trimmed = np.sort(squared, axis=1)[:, :majority].sum(axis=1)
    best: tuple[float, FloatArray, BoolArray] | None = None
    for index in np.argsort(trimmed, kind="stable")[:PROMISING]:
        refined = _concentrate(stars, model, proposals[index], _closest(squared[index], majority))
        if refined is not None and (best is None or refined[0] < best[0]):
            best = refined
    return None if best is None else best[1:]


def _concentrate(
    stars: Sightings, model: StepModel, attitude: FloatArray, core: BoolArray
) -> tuple[float, FloatArray, BoolArray] | None:
    """Refit the majority that fits best until it stays the same; each step lowers the trimmed sum."""
    for _ in range(MAX_PASSES):
        fit = fit_attitude(stars, model, attitude, core)
        if fit is None:
            return None
        attitude = fit.attitude
        squared = _squared(fit.residual_px, stars.covariance_px2)
        closest = _closest(squared, int(np.sum(core)))
        if np.array_equal(closest, core):
            break
        core = closest
    return float(np.sum(squared[core])), attitude, core


def _pair_attitudes(stars: Sightings) -> FloatArray:
    """Attitudes (m, 3, 3) from pairs of stars: middles and directions from one to the other are aligned."""
    pairs = _pairs(len(stars))
    observed = stars.camera.unproject(stars.observed_px)
    apart = [np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1) for v in (observed, stars.directions)]
    pairs = pairs[(apart[0] > MIN_PAIR_RAD) & (apart[1] > MIN_PAIR_RAD)]
    return _triads(observed, pairs) @ np.swapaxes(_triads(stars.directions, pairs), 1, 2)


def _pairs(n: int) -> FloatArray:
    pairs = np.array(list(combinations(range(n), 2)))
    if len(pairs) <= MAX_PAIRS:
        return pairs
    return np.random.default_rng(SEED).permutation(pairs)[:MAX_PAIRS]


def _triads(directions: FloatArray, pairs: FloatArray) -> FloatArray:
    """Right-handed orthonormal axes as columns (m, 3, 3): the pair's middle, along it, across it."""
    first, second = directions[pairs[:, 0]], directions[pairs[:, 1]]
    middle, along = unit(first + second), unit(second - first)
    return np.stack([middle, along, np.cross(middle, along)], axis=-1)


def _consistent_pairs(stars: Sightings) -> int:
    """Number of pairs whose observed separation agrees with the predicted one."""
    predicted = stars.camera.project(stars.directions @ stars.a_priori.T)
    count = 0
    for i, j in combinations(range(len(stars)), 2):
        expected, observed = predicted[j] - predicted[i], stars.observed_px[j] - stars.observed_px[i]
        length = float(np.linalg.norm(expected))
        along = expected / length if length > 0.0 else np.array([1.0, 0.0])
        variance = float(along @ (stars.covariance_px2[i] + stars.covariance_px2[j]) @ along)
        mismatch = abs(float(np.linalg.norm(observed)) - length)
        count += mismatch <= REJECT_SIGMA * np.sqrt(variance)
    return count
