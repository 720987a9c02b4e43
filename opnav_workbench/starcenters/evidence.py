"""How much more likely the detections are with a hypothesis than strewn at random: what makes an identification sure.

For one rotation the ratio of the likelihoods of all detections, stars there or not, is

    LR = prod over pairs [P_i g(d) m(b) / (density f(b))] * prod over stars missed [1 - P_i]

with P_i the probability that star i is detected, g the Gaussian of a pair's distance d, m and f the distributions of a
star's and of any detection's brightness b. The evidence is the mean of LR over all rotations searched: the best LR
times the part of the searched volume in which it is as good. Among detections strewn at random the mean of the
evidence is one, so that it exceeds E in less than one field of E (Markov): evidence 1000 is mistaken once in a thousand
fields that have nothing to do with the stars. The confidence is the share of the best hypothesis in the evidence of
all, "the field is another one" included with 1.

Reference: Lang et al. (2010), doi:10.1088/0004-6256/139/5/1782, section 2.3; Jaynes (2003), chapter 4.
"""

import numpy as np
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.starcenters.matching import MAGNITUDE_SIGMA
from opnav_workbench.starcenters.sky_scene import Hypothesis, Limits, Scene, shift_and_twist

__all__ = ["DETECTED_PART", "detection_probability", "log_evidence", "log_ratio_of_others"]

POSITION_SIGMA_PX = 0.5  # an axis: coarse centers, unmodeled motion and distortion
DETECTED_PART = 0.8  # of the stars that are bright enough: catalogs list doubles, variables and plate faults
DETECTED_FAINT = 0.01  # of those much too faint: something else at their place
LIMIT_SIGMA_MAG = 0.7  # how unsharp the limit is: colors, pixel phase, zero point
SUSPECT_STARS = 0.15  # of stars are sharper than the PSF described: it is not known better
OUTLIERS = 0.1  # of stars are off in brightness by more than MAGNITUDE_SIGMA tells
OUTLIER_SPREAD_MAG = 2.0
ZERO_POINT_RANGE_MAG = 10.0  # of a zero point that is not known
CENTRAL_PART = (
    0.5  # of pointing errors stem from a Gaussian of this part of the limit, the others are uniform
)
CENTRAL_SIGMA = 0.25


def log_evidence(scene: Scene, limits: Limits, h: Hypothesis) -> float:
    """Log of the evidence of one hypothesis and its surroundings, over that of detections at random."""
    if len(h.pairs) == 0:
        return -np.inf
    pairs, missed = _log_ratios(scene, h)
    return float(np.sum(pairs) + missed + _volume(scene, limits, h))


def log_ratio_of_others(scene: Scene, h: Hypothesis, known: IntArray) -> float:
    """Log of the likelihood ratio of all stars but those in pairs (k, 2) that are taken as given."""
    pairs, missed = _log_ratios(scene, h)
    others = ~np.isin(h.pairs[:, 0], known[:, 0])
    return float(np.sum(pairs[others]) + missed)


def _log_ratios(scene: Scene, h: Hypothesis) -> tuple[FloatArray, float]:
    """Log likelihood ratio of each pair (k,), and of the stars missed together."""
    star, detection = h.pairs.T
    zero_point = _zero_point(scene, h)
    detected = detection_probability(scene, zero_point)
    background = len(scene.detected) / scene.area_px2
    gaussian = -0.5 * (h.distance_px / POSITION_SIGMA_PX) ** 2 - np.log(2.0 * np.pi * POSITION_SIGMA_PX**2)
    missed = scene.inside(scene.places(h.rotation))
    missed[star] = False
    pairs: FloatArray = gaussian + np.log(detected[star]) - np.log(background) + _kind(scene)[detection]
    return pairs + _brightness(scene, h, zero_point), float(np.sum(np.log1p(-detected[missed])))


def detection_probability(scene: Scene, zero_point: float) -> FloatArray:
    """Probability (n,) that each star is among the detections, if it is on the detector."""
    limit = scene.limit_mag + zero_point
    bright = ndtr((limit - scene.magnitude) / LIMIT_SIGMA_MAG)
    return np.asarray(DETECTED_FAINT + (DETECTED_PART - DETECTED_FAINT) * bright)


def _zero_point(scene: Scene, h: Hypothesis) -> float:
    if not np.isnan(h.zero_point_mag):
        return h.zero_point_mag
    return float(np.median(scene.magnitude[h.pairs[:, 0]] - scene.detected_mag[h.pairs[:, 1]]))


def _kind(scene: Scene) -> FloatArray:
    """Log ratio of how often a star, and any detection, looks as sharp as each detection; (m,)."""
    part = (np.sum(scene.suspect) + 1.0) / (len(scene.suspect) + 2.0)
    star = np.where(scene.suspect, SUSPECT_STARS, 1.0 - SUSPECT_STARS)
    return np.asarray(np.log(star / np.where(scene.suspect, part, 1.0 - part)), float)


def _brightness(scene: Scene, h: Hypothesis, zero_point: float) -> FloatArray:
    """Log ratio of a star's brightness being as seen, and any detection's; (k,), with the cost of a zero point."""
    star, detection = h.pairs.T
    if np.isnan(h.zero_point_mag):
        return np.zeros(len(star))
    seen = scene.detected_mag
    spread = max(float(np.std(seen)), 1.0)
    any_one = -0.5 * ((seen[detection] - seen.mean()) / spread) ** 2 - np.log(spread)
    off = seen[detection] + zero_point - scene.magnitude[star]
    core = (1.0 - OUTLIERS) * np.exp(-0.5 * (off / MAGNITUDE_SIGMA) ** 2) / MAGNITUDE_SIGMA
    tail = OUTLIERS * np.exp(-0.5 * (off / OUTLIER_SPREAD_MAG) ** 2) / OUTLIER_SPREAD_MAG
    ratio = np.where(scene.censored[detection], 0.0, np.log(core + tail) - any_one)
    if np.isnan(scene.zero_point_mag):  # it was fitted to these very stars
        cost = np.log(np.sqrt(2.0 * np.pi / len(star)) * MAGNITUDE_SIGMA / ZERO_POINT_RANGE_MAG)
        ratio = ratio + cost / len(star)
    return np.asarray(ratio)


def _volume(scene: Scene, limits: Limits, h: Hypothesis) -> float:
    """Log of the part of the searched shifts and twists, weighed by their prior, in which the fit is as good."""
    place = scene.detected_plane[h.pairs[:, 1]]
    k, lever = len(place), np.sum((place - place.mean(axis=0)) ** 2)
    shift, _ = shift_and_twist(h.rotation, scene.focal_px)
    limit = max(limits.max_shift_px, limits.tolerance_px)
    uniform = 1.0 / (np.pi * limit**2)
    sigma = CENTRAL_SIGMA * limit
    central = np.exp(-0.5 * np.sum(shift**2) / sigma**2) / (2.0 * np.pi * sigma**2)
    prior = (1.0 - CENTRAL_PART) * uniform + CENTRAL_PART * central
    area = 2.0 * np.pi * POSITION_SIGMA_PX**2 / k
    twist = np.sqrt(2.0 * np.pi) * POSITION_SIGMA_PX / np.sqrt(max(float(lever), 1e-12))
    twist_part = min(1.0, twist / max(2.0 * limits.max_twist_rad, 1e-12))
    return float(np.log(min(prior * area, 1.0)) + np.log(twist_part))
