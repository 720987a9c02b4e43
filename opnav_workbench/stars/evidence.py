"""How sure an identification is: the evidence of its rotation against detections strewn at random, and its confidence.

For one rotation the ratio of the likelihoods of all detections, stars there or not, is

    LR = prod over pairs [P_i g(d) m(b) / (density f(b))] * prod over stars missed [1 - P_i]

with P_i the probability that star i is detected, g the Gaussian of a pair's distance d, m and f the distributions of a
star's and of any detection's brightness b. The evidence is the mean of LR over all rotations searched: the best LR
times the part of the searched volume in which it is as good. Among detections strewn at random the mean of the
evidence is one, so that it exceeds E in less than one field of E (Markov): evidence 1000 is mistaken once in a
thousand fields that have nothing to do with the stars.

The confidence is the share of the best hypothesis in the evidence of all, "the field is another one" included with 1:
one minus the probability that the answer is a mistake, be it another field or a rival that explains the detections as
well. Above 0.999 it may be relied on. With one star there is nothing to cross-check: nearness and brightness choose
among the detections, and it is never sure.

References: Lang et al. (2010), doi:10.1088/0004-6256/139/5/1782, section 2.3; Jaynes (2003), chapter 4.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, ndtr

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.stars.hypotheses import MAGNITUDE_SIGMA
from opnav_workbench.stars.second_images import CLEARLY_SIGMAS, fainter_by
from opnav_workbench.stars.star_field import RotationHypothesis, SearchLimits, StarField, shift_and_twist

__all__ = [
    "SURE_CONFIDENCE",
    "Identification",
    "best_identification",
    "identification_from",
    "in_camera_frame",
    "log_evidence",
    "log_ratio_of_other_stars",
    "no_identification",
]


# ---- How much more likely the detections are with a hypothesis than strewn at random.

POSITION_SIGMA_PX = 0.5  # an axis: coarse centers, unmodeled motion and distortion
DETECTED_PART = 0.8  # of the stars that are bright enough: catalogs list doubles, variables and plate faults
DETECTED_FAINT = 0.01  # of those much too faint: something else at their place
LIMIT_SIGMA_MAG = 0.7  # how unsharp the limit is: colors, pixel phase, zero point
SUSPECT_STARS = 0.15  # of stars are sharper than the PSF described: it is not known better
BRIGHTNESS_OUTLIERS = 0.1  # of stars are off in brightness by more than MAGNITUDE_SIGMA tells
OUTLIER_SPREAD_MAG = 2.0
ZERO_POINT_RANGE_MAG = 10.0  # of a zero point that is not known
CENTRAL_PART = (
    0.5  # of pointing errors stem from a Gaussian of this part of the limit, the others are uniform
)
CENTRAL_SIGMA = 0.25


def log_evidence(star_field: StarField, limits: SearchLimits, h: RotationHypothesis) -> float:
    """Log of the evidence of one hypothesis and its surroundings, over that of detections at random."""
    if len(h.pairs) == 0:
        return -np.inf
    pairs, missed = _log_ratios(star_field, h)
    return float(np.sum(pairs) + missed + _log_volume(star_field, limits, h))


def log_ratio_of_other_stars(star_field: StarField, h: RotationHypothesis, known: IntArray) -> float:
    """Log of the likelihood ratio of all stars but those in pairs (k, 2) that are taken as given."""
    pairs, missed = _log_ratios(star_field, h)
    others = ~np.isin(h.pairs[:, 0], known[:, 0])
    return float(np.sum(pairs[others]) + missed)


def _log_ratios(star_field: StarField, h: RotationHypothesis) -> tuple[FloatArray, float]:
    """Log likelihood ratio of each pair (k,), and of the stars missed together."""
    star, detection = h.pairs.T
    zero_point = _zero_point(star_field, h)
    detected = detection_probability(star_field, zero_point)
    background = len(star_field.detected) / star_field.area_px2
    gaussian = -0.5 * (h.distance_px / POSITION_SIGMA_PX) ** 2 - np.log(2.0 * np.pi * POSITION_SIGMA_PX**2)
    missed = star_field.inside(star_field.places(h.rotation))
    missed[star] = False
    pairs: FloatArray = (
        gaussian + np.log(detected[star]) - np.log(background) + _log_sharpness_ratio(star_field)[detection]
    )
    return pairs + _log_brightness_ratio(star_field, h, zero_point), float(
        np.sum(np.log1p(-detected[missed]))
    )


def detection_probability(star_field: StarField, zero_point: float) -> FloatArray:
    """Probability (n,) that each star is among the detections, if it is on the detector."""
    limit = star_field.limit_mag + zero_point
    bright = ndtr((limit - star_field.magnitude) / LIMIT_SIGMA_MAG)
    return np.asarray(DETECTED_FAINT + (DETECTED_PART - DETECTED_FAINT) * bright)


def _zero_point(star_field: StarField, h: RotationHypothesis) -> float:
    if not np.isnan(h.zero_point_mag):
        return h.zero_point_mag
    return float(np.median(star_field.magnitude[h.pairs[:, 0]] - star_field.detected_mag[h.pairs[:, 1]]))


def _log_sharpness_ratio(star_field: StarField) -> FloatArray:
    """Log ratio of how often a star, and any detection, looks as sharp as each detection; (m,)."""
    part = (np.sum(star_field.sharper_than_star) + 1.0) / (len(star_field.sharper_than_star) + 2.0)
    star = np.where(star_field.sharper_than_star, SUSPECT_STARS, 1.0 - SUSPECT_STARS)
    return np.asarray(np.log(star / np.where(star_field.sharper_than_star, part, 1.0 - part)), float)


def _log_brightness_ratio(star_field: StarField, h: RotationHypothesis, zero_point: float) -> FloatArray:
    """Log ratio of a star's brightness being as seen, and any detection's; (k,), with the cost of a zero point."""
    star, detection = h.pairs.T
    if np.isnan(h.zero_point_mag):
        return np.zeros(len(star))
    seen = star_field.detected_mag
    spread = max(float(np.std(seen)), 1.0)
    any_one = -0.5 * ((seen[detection] - seen.mean()) / spread) ** 2 - np.log(spread)
    off = seen[detection] + zero_point - star_field.magnitude[star]
    core = (1.0 - BRIGHTNESS_OUTLIERS) * np.exp(-0.5 * (off / MAGNITUDE_SIGMA) ** 2) / MAGNITUDE_SIGMA
    tail = BRIGHTNESS_OUTLIERS * np.exp(-0.5 * (off / OUTLIER_SPREAD_MAG) ** 2) / OUTLIER_SPREAD_MAG
    ratio = np.where(star_field.saturated[detection], 0.0, np.log(core + tail) - any_one)
    if np.isnan(star_field.zero_point_mag):  # it was fitted to these very stars
        cost = np.log(np.sqrt(2.0 * np.pi / len(star)) * MAGNITUDE_SIGMA / ZERO_POINT_RANGE_MAG)
        return np.asarray(ratio + cost / len(star))
    return np.asarray(ratio + _log_zero_point_ratio(zero_point - star_field.zero_point_mag) / len(star))


def _log_zero_point_ratio(off_mag: float) -> float:
    """Log of how likely a camera's zero point is off by that, over its being right.

    Ghosts, and a second image of all stars, have the pattern of the field, but not its brightness.
    """
    density = 1.0 / (np.sqrt(2.0 * np.pi) * LIMIT_SIGMA_MAG)
    wrong = BRIGHTNESS_OUTLIERS / ZERO_POINT_RANGE_MAG
    right = (1.0 - BRIGHTNESS_OUTLIERS) * density
    return float(np.log((right * np.exp(-0.5 * (off_mag / LIMIT_SIGMA_MAG) ** 2) + wrong) / (right + wrong)))


def _log_volume(star_field: StarField, limits: SearchLimits, h: RotationHypothesis) -> float:
    """Log of the part of the searched shifts and twists, weighed by their prior, in which the fit is as good."""
    place = star_field.detected_plane[h.pairs[:, 1]]
    k, lever = len(place), np.sum((place - place.mean(axis=0)) ** 2)
    shift, _ = shift_and_twist(h.rotation, star_field.focal_px)
    limit = max(limits.max_shift_px, limits.tolerance_px)
    uniform = 1.0 / (np.pi * limit**2)
    sigma = CENTRAL_SIGMA * limit
    central = np.exp(-0.5 * np.sum(shift**2) / sigma**2) / (2.0 * np.pi * sigma**2)
    prior = (1.0 - CENTRAL_PART) * uniform + CENTRAL_PART * central
    area = 2.0 * np.pi * POSITION_SIGMA_PX**2 / k
    twist = np.sqrt(2.0 * np.pi) * POSITION_SIGMA_PX / np.sqrt(max(float(lever), 1e-12))
    twist_part = min(1.0, twist / max(2.0 * limits.max_twist_rad, 1e-12))
    return float(np.log(min(prior * area, 1.0)) + np.log(twist_part))


# ---- How sure an identification is, and in which words.

SURE_CONFIDENCE = 0.999  # the evidence of a thousand; below this an identification is a proposal
LOG_BEYOND_CHANCE = float(np.log(1.0 / (1.0 - SURE_CONFIDENCE)))
EITHER_CONFIDENCE = 0.5  # of two images as bright as each other
BRIGHTER_CONFIDENCE = 0.99  # at most: which stars have a second image in their boxes is not known here
SINGLE_STAR_CONFIDENCE = 0.99  # at most: detectors have more ways to mimic one star than statistics know
SAME_TOLERANCES = 2.0  # hypotheses that differ by less at the detector's corners are one


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Stars identified.

    `rotation` turns camera-frame directions from the a priori attitude to the one found: ``camera_from_j2000 = rotation
    @ a_priori_camera_from_j2000``. In a plane: observed = center + shift + R(twist) (predicted - center).
    """

    shift_px: (
        FloatArray  # (2,) pixel, line: where the a priori center of the field is seen, without distortion
    )
    twist_rad: float  # positive from +pixel toward +line
    pairs: IntArray  # (k, 2) star index, detection index
    confidence: float  # 1 - estimated probability that the pairs are a mistake
    message: str
    zero_point_mag: float | None = None  # magnitude of 1 DN, as given or fitted
    rotation: FloatArray | None = None  # (3, 3)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sure(self) -> bool:
        """True where the answer may be relied on; else it is a proposal to be confirmed."""
        return self.confidence >= SURE_CONFIDENCE


def best_identification(
    star_field: StarField, limits: SearchLimits, hypotheses: list[RotationHypothesis], evidence: FloatArray
) -> Identification:
    """Choose the likeliest hypothesis; its confidence is its share, "another field" having evidence one."""
    order = np.argsort(-evidence, kind="stable")
    pairs = [frozenset(map(tuple, h.pairs.tolist())) for h in hypotheses]
    rotations = np.stack([h.rotation for h in hypotheses])
    distinct: list[int] = []
    for i in order:
        near = (
            _moved_px(star_field, rotations[i], rotations[distinct]) <= SAME_TOLERANCES * limits.tolerance_px
        )
        if not (np.any(near) or any(2 * len(pairs[i] & pairs[j]) > len(pairs[i]) for j in distinct)):
            distinct.append(int(i))
    chosen, others, most = distinct[0], distinct[1:], 1.0
    for rival in distinct[1:]:
        if evidence[rival] > LOG_BEYOND_CHANCE and _is_second_image(hypotheses[chosen], hypotheses[rival]):
            others = [i for i in others if i != rival]
            fainter, sigma = _fainter_by(star_field, hypotheses[chosen], hypotheses[rival])
            clear = abs(fainter) > CLEARLY_SIGMAS * sigma
            most = min(most, BRIGHTER_CONFIDENCE if clear else EITHER_CONFIDENCE)
            chosen = chosen if fainter >= 0.0 else rival
    best, total = hypotheses[chosen], float(logsumexp(np.append(evidence[[chosen, *others]], 0.0)))
    confidence = min(float(np.exp(evidence[chosen] - total)), most)
    if len(best.pairs) == 1:
        confidence = min(confidence, SINGLE_STAR_CONFIDENCE)
    return identification_from(star_field, best, confidence)


def _is_second_image(best: RotationHypothesis, rival: RotationHypothesis) -> bool:
    """Tell whether a rival that is no chance has most of the stars, too, in other detections: then all are seen twice.

    Evidence does not choose between them: a star more or less in one of them says nothing, as both are images of the field.
    """
    shared = np.isin(rival.pairs[:, 1], best.pairs[:, 1]).sum()
    return 2 * len(rival.pairs) > len(best.pairs) and bool(2 * shared <= len(rival.pairs))


def _fainter_by(
    star_field: StarField, one: RotationHypothesis, other: RotationHypothesis
) -> tuple[float, float]:
    """Return how much fainter the images are that the other hypothesis takes for the stars, and the sigma of it, mag."""
    _, row, of_other = np.intersect1d(one.pairs[:, 0], other.pairs[:, 0], return_indices=True)
    return fainter_by(
        star_field.detected_mag, star_field.saturated, one.pairs[row, 1], other.pairs[of_other, 1]
    )


def identification_from(star_field: StarField, best: RotationHypothesis, confidence: float) -> Identification:
    """Word a hypothesis as the identification."""
    shift, twist = shift_and_twist(best.rotation, star_field.focal_px)
    return Identification(
        star_field.pixel_from_plane @ shift,
        float(twist),
        best.pairs,
        confidence,
        _message(star_field, best, confidence),
        _none_if_nan(best.zero_point_mag),
        best.rotation,
    )


def _moved_px(star_field: StarField, rotation: FloatArray, others: FloatArray) -> FloatArray:
    """Return how far the detector's corners are apart (n,), px, by a rotation and by others (n, 3, 3)."""
    between = vector_from_rotation(rotation @ np.swapaxes(others, -1, -2))
    shift, twist = np.hypot(between[:, 0], between[:, 1]), np.abs(between[:, 2])
    return np.asarray(star_field.focal_px * shift + star_field.half_diagonal_px * twist)


def _message(star_field: StarField, h: RotationHypothesis, confidence: float) -> str:
    doubt = "" if confidence >= SURE_CONFIDENCE else ": not sure, confirm by eye or mark two stars"
    if len(h.pairs) == 1:
        known = "nearness" if np.isnan(star_field.zero_point_mag) else "brightness and nearness"
        return (
            f"one star only, chosen among {len(star_field.detected)} detections by {known} only, "
            f"confidence {confidence:.2f}{doubt}"
        )
    expected = int(star_field.inside(star_field.places(h.rotation)).sum())
    return (
        f"{len(h.pairs)} of {expected} stars on the detector identified, confidence {confidence:.4f}{doubt}"
    )


def no_identification(star_field: StarField, message: str) -> Identification:
    """Return that nothing is identified, and why."""
    return Identification(
        np.zeros(2), 0.0, np.zeros((0, 2), np.int64), 0.0, message, _none_if_nan(star_field.zero_point_mag)
    )


def _none_if_nan(value: float) -> float | None:
    return None if np.isnan(value) else value


def in_camera_frame(found: Identification, kept: IntArray, axes: FloatArray) -> Identification:
    """Return the pairs with the caller's detections, and the rotation in the camera's frame."""
    pairs = np.column_stack([found.pairs[:, 0], kept[found.pairs[:, 1]]])
    rotation = None if found.rotation is None else axes.T @ found.rotation @ axes
    return Identification(
        found.shift_px,
        found.twist_rad,
        pairs,
        found.confidence,
        found.message,
        found.zero_point_mag,
        rotation,
    )
