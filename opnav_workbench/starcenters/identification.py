"""Which detection is which star: shift and twist of the a priori pointing, pairs, and how sure they are.

The brightest stars vote for shifts on a grid of twists (`voting`); the best hypotheses are refined, and
judged by the likelihood of their pairs, in position and magnitude, against detections strewn at random.
Confidence is one minus the probability of a mistake, which has two parts:

- chance: how often a random scene of as many detections would show as many pairs somewhere in the searched
  range, that is (number of independent shifts and twists) x (binomial tail of the pairs);
- rivalry: the share of the runner-up in the likelihood.

With one star there is nothing to cross-check: nearness and brightness choose among the detections, and
confidence is modest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.stats import binom

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.starcenters.boxes import check_points
from opnav_workbench.starcenters.detection import Detections
from opnav_workbench.starcenters.voting import (
    MAGNITUDE_TOLERANCE,
    Hypothesis,
    Limits,
    Scene,
    move,
    refine,
    vote,
)

__all__ = ["Identification", "identify"]

MAX_SHIFT_PX = 60.0  # attitude errors of 40 px are usual (AAS 13-443)
MAX_TWIST_RAD = float(np.radians(0.5))  # headers are off by 0.2 deg (LORRI, 2020)
TOLERANCE_PX = 2.0  # unmodeled proper motion and distortion, coarse centers
POSITION_SIGMA_PX = 0.7
MAGNITUDE_SIGMA = 0.6
DETECTED_PART = 0.8  # of the stars that are bright enough
DETECTED_PART_FAINT = 0.3  # of those at the limit of what was detected
LIMIT_MARGIN_MAG = 0.5
SINGLE_STAR_CONFIDENCE = 0.6  # nearness and brightness alone; shared among the candidates by their likelihood
SINGLE_STAR_CONFIDENCE_NO_BRIGHTNESS = 0.3
SINGLE_STAR_SHIFT_PART = 0.25  # 1 sigma of the pointing error along an axis, as part of its limit
SINGLE_STAR_MAGNITUDE_SIGMA = 0.8  # catalog bands differ from the camera's by this
SURE = 0.9  # below this the message says that the identification is not sure


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Stars identified: observed = center + shift + R(twist) (predicted - center), see `voting`."""

    shift_px: FloatArray  # (2,) pixel, line
    twist_rad: float  # positive from +pixel toward +line
    pairs: IntArray  # (k, 2) star index, detection index
    confidence: float  # 1 - estimated probability that the pairs are a mistake
    message: str
    zero_point_mag: float | None = None  # magnitude of 1 DN, as given or fitted

    def __post_init__(self) -> None:
        freeze_arrays(self)


def identify(
    predicted_px: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    *,
    center_px: ArrayLike,
    max_shift_px: float = MAX_SHIFT_PX,
    max_twist_rad: float = MAX_TWIST_RAD,
    tolerance_px: float = TOLERANCE_PX,
    zero_point_mag: float | None = None,
) -> Identification:
    """Match predicted stars with detections, whatever the pointing error within the limits.

    Parameters
    ----------
    predicted_px : (n, 2) array_like
        A priori (pixel, line) of the catalog stars on and around the detector.
    magnitude : (n,) array_like
        Their magnitudes.
    detections : Detections
        From `detect`; cosmic rays among them are expected.
    center_px : (2,) array_like
        Center of the detector (pixel, line), about which the twist turns; the detector ends at twice that.
    max_shift_px, max_twist_rad : float
        Limits of the pointing error.
    tolerance_px : float
        Largest distance between a star and its detection after shift and twist.
    zero_point_mag : float, optional
        Magnitude of a star of 1 DN total flux in this exposure; without it brightness only ranks.

    Returns
    -------
    Identification
        Without a match: no pairs, confidence 0, and a message that says why.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape or limits that are not positive.

    Examples
    --------
    >>> stars = np.array([[20.0, 30.0], [200.0, 80.0], [90.0, 210.0], [150.0, 150.0]])
    >>> seen = Detections(stars + [12.0, -7.0], *np.ones((3, 4)), np.zeros(4, int))
    >>> found = identify(stars, np.full(4, 9.0), seen, center_px=(127.5, 127.5))
    >>> found.shift_px.round(3).tolist(), len(found.pairs), found.confidence > 0.99
    ([12.0, -7.0], 4, True)
    """
    scene = _scene(predicted_px, magnitude, detections, center_px, zero_point_mag)
    if not (max_shift_px >= 0.0 and max_twist_rad >= 0.0 and tolerance_px > 0.0):
        raise CenterfindingError(
            f"limits must not be negative: {max_shift_px} px, {max_twist_rad} rad, {tolerance_px} px."
        )
    limits = Limits(max_shift_px, max_twist_rad, tolerance_px)
    if len(scene.predicted_px) == 0:
        return _nothing(scene, "no predicted star near the detector: nothing to identify")
    if len(scene.detected_px) == 0:
        return _nothing(scene, "no star detected in the image")
    hypotheses = [refine(scene, limits, *guess) for guess in vote(scene, limits)]
    hypotheses = [
        h for h in hypotheses if len(h.pairs) > 1 and np.hypot(*h.shift_px) <= max_shift_px + tolerance_px
    ]
    if len(scene.predicted_px) == 1 or not hypotheses:
        return _single(scene, limits)
    return _judge(scene, limits, hypotheses)


def _scene(
    predicted_px: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    center_px: ArrayLike,
    zero_point_mag: float | None,
) -> Scene:
    predicted, magnitudes = (
        check_points(predicted_px, "predicted_px"),
        np.asarray(magnitude, float).reshape(-1),
    )
    center = check_points(center_px, "center_px")
    if len(magnitudes) != len(predicted) or len(center) != 1:
        raise CenterfindingError(
            f"{len(predicted)} predicted stars need as many magnitudes and one center, got {len(magnitudes)}."
        )
    # An unknown magnitude counts as that of the faintest star: it votes last.
    magnitudes = np.nan_to_num(magnitudes, nan=float(np.nanmax(magnitudes, initial=-np.inf)), neginf=0.0)
    flux = np.maximum(detections.flux_dn, np.finfo(float).tiny)
    return Scene(
        predicted, magnitudes, detections.pixel_line, -2.5 * np.log10(flux), center[0],
        np.nan if zero_point_mag is None else zero_point_mag, cKDTree(detections.pixel_line.reshape(-1, 2)),
    )  # fmt: skip


def _judge(scene: Scene, limits: Limits, hypotheses: list[Hypothesis]) -> Identification:
    """Choose the likeliest hypothesis and say how sure it is."""
    likelihood = np.array([_log_likelihood(scene, h) for h in hypotheses])
    best = hypotheses[int(likelihood.argmax())]
    rivals = [
        float(value) for value, h in zip(likelihood, hypotheses, strict=True) if _differs(h, best, limits)
    ]
    gap = float(likelihood.max()) - max(rivals, default=-np.inf)
    rivalry = 1.0 / (1.0 + np.exp(min(gap, 700.0)))
    confidence = float(np.clip((1.0 - _chance(scene, limits, best)) * (1.0 - rivalry), 0.0, 1.0))
    count, expected = len(best.pairs), int(_on_detector(scene, best).sum())
    message = f"{count} of {expected} stars on the detector identified, confidence {confidence:.4f}"
    if confidence < SURE:
        message += ": not sure, confirm by eye or give a better a priori pointing"
    return Identification(
        best.shift_px, best.twist_rad, best.pairs, confidence, message, _optional(best.zero_point_mag)
    )


def _log_likelihood(scene: Scene, h: Hypothesis) -> float:
    """Log of the likelihood of the pairs over that of the same detections strewn at random."""
    star, detection = h.pairs.T
    density = len(scene.detected_px) / _area(scene)
    position = -0.5 * (h.distance_px / POSITION_SIGMA_PX) ** 2 - np.log(
        2.0 * np.pi * POSITION_SIGMA_PX**2 * density
    )
    seen = scene.detected_mag
    spread = max(float(np.std(seen)), 1.0)
    brightness = np.zeros(len(star))
    if not np.isnan(h.zero_point_mag):
        difference = seen[detection] + h.zero_point_mag - scene.magnitude[star]
        by_chance = -0.5 * ((seen[detection] - seen.mean()) / spread) ** 2 - np.log(spread)
        brightness = -0.5 * (difference / MAGNITUDE_SIGMA) ** 2 - np.log(MAGNITUDE_SIGMA) - by_chance
    part = _detected_part(scene, h)
    missed = _on_detector(scene, h)
    missed[star] = False
    return float(np.sum(position + brightness + np.log(part[star])) + np.sum(np.log1p(-part[missed])))


def _detected_part(scene: Scene, h: Hypothesis) -> FloatArray:
    """Probability that each star is among the detections, by its magnitude; (n,)."""
    zero_point = h.zero_point_mag
    if np.isnan(zero_point):
        zero_point = float(np.median(scene.magnitude[h.pairs[:, 0]] - scene.detected_mag[h.pairs[:, 1]]))
    limit = float(np.max(scene.detected_mag)) + zero_point - LIMIT_MARGIN_MAG
    return np.where(scene.magnitude < limit, DETECTED_PART, DETECTED_PART_FAINT)


def _chance(scene: Scene, limits: Limits, h: Hypothesis) -> float:
    """Expected number of shifts and twists at which a random scene would show as many pairs (at most 1)."""
    area = np.pi * limits.tolerance_px**2
    consistent = 1.0
    if not np.isnan(h.zero_point_mag):
        difference = scene.detected_mag + h.zero_point_mag - scene.magnitude[h.pairs[:, 0], None]
        consistent = float(np.mean(np.abs(difference) <= MAGNITUDE_TOLERANCE))
    single = 1.0 - np.exp(-len(scene.detected_px) / _area(scene) * consistent * area)
    extent = float(np.max(np.hypot(*(scene.predicted_px - scene.center_px).T)))
    shifts = 1.0 + 4.0 * (limits.max_shift_px / limits.tolerance_px) ** 2
    twists = 1.0 + 2.0 * limits.max_twist_rad * extent / limits.tolerance_px
    stars = max(int(_on_detector(scene, h).sum()), len(h.pairs))
    return min(1.0, float(shifts * twists * binom.sf(len(h.pairs) - 1, stars, single)))


def _differs(h: Hypothesis, best: Hypothesis, limits: Limits) -> bool:
    """True for a real alternative: another place on the sky, not a worse version of the same."""
    return bool(np.hypot(*(h.shift_px - best.shift_px)) > 2.0 * limits.tolerance_px)


def _single(scene: Scene, limits: Limits) -> Identification:
    """The brightest star, and the detection that is likeliest by nearness and brightness."""
    inside = np.all((scene.predicted_px > -0.5) & (scene.predicted_px < 2.0 * scene.center_px + 0.5), axis=1)
    star = int(np.argmin(np.where(inside | ~inside.any(), scene.magnitude, np.inf)))
    offset = scene.detected_px - scene.predicted_px[star]
    distance = np.hypot(*offset.T)
    candidates = distance <= limits.max_shift_px
    cost = (distance / (limits.max_shift_px * SINGLE_STAR_SHIFT_PART + limits.tolerance_px)) ** 2
    known = not np.isnan(scene.zero_point_mag)
    if known:
        difference = scene.detected_mag + scene.zero_point_mag - scene.magnitude[star]
        candidates &= np.abs(difference) <= MAGNITUDE_TOLERANCE
        cost = cost + (difference / SINGLE_STAR_MAGNITUDE_SIGMA) ** 2
    within = f"within {limits.max_shift_px:g} px of its predicted position"
    if not candidates.any():
        return _nothing(scene, f"no detection {'of the brightness of the star ' if known else ''}{within}")
    share = np.where(candidates, np.exp(-0.5 * (cost - cost[candidates].min())), 0.0)
    detection = int(share.argmax())
    most = SINGLE_STAR_CONFIDENCE if known else SINGLE_STAR_CONFIDENCE_NO_BRIGHTNESS
    message = (
        f"one star only, chosen among {int(candidates.sum())} detections {within}: this rests on "
        f"{'brightness and nearness' if known else 'nearness'} only, confirm by eye"
    )
    pairs = np.array([[star, detection]], np.int64)
    confidence = float(most * share[detection] / share.sum())
    return Identification(offset[detection], 0.0, pairs, confidence, message, _optional(scene.zero_point_mag))


def _nothing(scene: Scene, message: str) -> Identification:
    return Identification(
        np.zeros(2), 0.0, np.zeros((0, 2), np.int64), 0.0, message, _optional(scene.zero_point_mag)
    )


def _optional(value: float) -> float | None:
    return None if np.isnan(value) else value


def _area(scene: Scene) -> float:
    return float(np.prod(2.0 * scene.center_px + 1.0))


def _on_detector(scene: Scene, h: Hypothesis) -> BoolArray:
    moved = move(scene.predicted_px, scene.center_px, h.shift_px, h.twist_rad)
    return np.asarray(np.all((moved > -0.5) & (moved < 2.0 * scene.center_px + 0.5), axis=1))
