"""Shift and twist between predicted stars and detections: votes for a first guess, then a rigid fit.

Transformation (pixel, line): observed = center + shift + R(twist) (predicted - center), R = [[cos, -sin],
[sin, cos]]; a positive twist turns +pixel toward +line.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays

__all__ = ["Hypothesis", "Limits", "Scene", "move", "refine", "vote"]

VOTING_STARS = 40  # brightest predicted stars that vote
VOTING_DETECTIONS = (
    120  # brightest detections voted for: stars must be found among more cosmic rays than stars
)
KEPT_HYPOTHESES = 60
RIVAL_PART = 0.5  # hypotheses with a smaller part of the best one's votes are no rivals
NEIGHBORS = 3  # detections considered for one star
MAGNITUDE_SIGMA = 0.6  # color of the star, and the filter's flux at unlucky pixel phases
MAGNITUDE_TOLERANCE = 2.0  # a star may be off by this through color or variability, not more
MIN_STARS_FOR_ZERO_POINT = 3
REFINEMENTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Predicted stars and detections to be matched; magnitudes of detections are -2.5 log10(flux)."""

    predicted_px: FloatArray  # (n, 2)
    magnitude: FloatArray  # (n,)
    detected_px: FloatArray  # (m, 2)
    detected_mag: FloatArray  # (m,)
    center_px: FloatArray  # (2,)
    zero_point_mag: float  # magnitude of 1 DN, nan where unknown
    tree: cKDTree

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class Limits:
    """How far the truth may be from the prediction."""

    max_shift_px: float
    max_twist_rad: float
    tolerance_px: float  # between a moved prediction and its detection


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One shift and twist, and the pairs (star, detection) it makes."""

    shift_px: FloatArray  # (2,)
    twist_rad: float
    pairs: IntArray  # (k, 2)
    distance_px: FloatArray  # (k,)
    zero_point_mag: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def move(
    predicted_px: FloatArray, center_px: FloatArray, shift_px: FloatArray, twist_rad: float
) -> FloatArray:
    """Turn predictions about `center_px` by `twist_rad`, then shift them; (n, 2)."""
    c, s = np.cos(twist_rad), np.sin(twist_rad)
    return np.asarray((predicted_px - center_px) @ np.array([[c, s], [-s, c]]) + center_px + shift_px)


def twist_steps(scene: Scene, limits: Limits) -> FloatArray:
    """Return twists dense enough that no star misses its detection by more than half the tolerance."""
    extent = float(np.max(np.hypot(*(scene.predicted_px - scene.center_px).T), initial=0.0))
    count = int(np.ceil(limits.max_twist_rad * extent / limits.tolerance_px))
    return np.linspace(-limits.max_twist_rad, limits.max_twist_rad, 2 * count + 1)


def vote(scene: Scene, limits: Limits) -> list[tuple[FloatArray, float]]:
    """Return shifts (2,) and twists that bring most of the brightest stars onto detections, best first."""
    stars = np.argsort(scene.magnitude, kind="stable")[:VOTING_STARS]
    detections = np.argsort(scene.detected_mag, kind="stable")[:VOTING_DETECTIONS]
    shifts, twists, votes = [], [], []
    for twist in twist_steps(scene, limits):
        turned = move(scene.predicted_px[stars], scene.center_px, np.zeros(2), twist)
        offset = (scene.detected_px[detections] - turned[:, None, :]).reshape(-1, 2)
        near = np.hypot(*offset.T) <= limits.max_shift_px + limits.tolerance_px
        if not np.isnan(scene.zero_point_mag):
            expected = scene.magnitude[stars] - scene.zero_point_mag
            difference = np.abs(scene.detected_mag[detections] - expected[:, None]).ravel()
            near &= difference <= MAGNITUDE_TOLERANCE
        offset = offset[near]
        moved = turned + offset[:, None, :]
        distance, _ = scene.tree.query(moved.reshape(-1, 2), distance_upper_bound=limits.tolerance_px)
        nearness = np.maximum(1.0 - 0.5 * (distance / limits.tolerance_px) ** 2, 0.0)
        shifts.append(offset)
        twists.append(np.full(len(offset), twist))
        votes.append(nearness.reshape(len(offset), len(stars)).sum(axis=1))
    return _distinct(np.concatenate(shifts), np.concatenate(twists), np.concatenate(votes), limits)


def _distinct(
    shifts: FloatArray, twists: FloatArray, votes: FloatArray, limits: Limits
) -> list[tuple[FloatArray, float]]:
    """Keep the best of hypotheses that are the same within the tolerance."""
    kept: list[tuple[FloatArray, float]] = []
    order = np.argsort(-votes, kind="stable")
    order = order[votes[order] >= RIVAL_PART * np.max(votes, initial=0.0)]
    shifts, twists = shifts[order], twists[order]
    while len(shifts) and len(kept) < KEPT_HYPOTHESES:
        kept.append((shifts[0], float(twists[0])))
        other = (np.hypot(*(shifts - shifts[0]).T) > limits.tolerance_px) | (twists != twists[0])
        shifts, twists = shifts[other], twists[other]
    return kept


def refine(scene: Scene, limits: Limits, shift_px: FloatArray, twist_rad: float) -> Hypothesis:
    """Match one-to-one, fit shift and twist, and again, with a zero point once there are stars for one."""
    zero_point = scene.zero_point_mag
    for _ in range(REFINEMENTS):
        pairs, distance = _match(scene, limits, shift_px, twist_rad, zero_point)
        if len(pairs) == 0:
            break
        shift_px, twist_rad = _rigid_fit(scene, limits, pairs, twist_rad)
        if len(pairs) >= MIN_STARS_FOR_ZERO_POINT:
            difference = scene.magnitude[pairs[:, 0]] - scene.detected_mag[pairs[:, 1]]
            zero_point = float(np.median(difference))
    pairs, distance = _match(scene, limits, shift_px, twist_rad, zero_point)
    return Hypothesis(shift_px, twist_rad, pairs, distance, zero_point)


def _match(
    scene: Scene, limits: Limits, shift_px: FloatArray, twist_rad: float, zero_point: float
) -> tuple[IntArray, FloatArray]:
    """One-to-one pairs within the tolerances: each star's best detection, each detection's best star."""
    moved = move(scene.predicted_px, scene.center_px, shift_px, twist_rad)
    nearest = scene.tree.query(moved, k=NEIGHBORS, distance_upper_bound=limits.tolerance_px)
    distance, index = np.asarray(nearest[0], float), np.asarray(nearest[1], np.int64)
    found = np.isfinite(distance)
    cost = np.where(found, (distance / limits.tolerance_px) ** 2, np.inf)
    if not np.isnan(zero_point):
        seen = scene.detected_mag[np.where(found, index, 0)] + zero_point
        difference = seen - scene.magnitude[:, None]
        cost = np.where(
            np.abs(difference) <= MAGNITUDE_TOLERANCE,
            cost + 0.1 * (difference / MAGNITUDE_SIGMA) ** 2,
            np.inf,
        )
    best = cost.argmin(axis=1)
    rows = np.arange(len(moved))
    star = rows[np.isfinite(cost[rows, best])]
    star = star[np.argsort(cost[star, best[star]], kind="stable")]
    chosen = index[star, best[star]]
    _, first = np.unique(chosen, return_index=True)  # of stars that want the same detection, the cheapest
    star, detection = star[first], chosen[first]
    pairs = np.column_stack([star, detection])
    order = np.argsort(star)
    return pairs[order], distance[star, best[star]][order]


def _rigid_fit(scene: Scene, limits: Limits, pairs: IntArray, twist_rad: float) -> tuple[FloatArray, float]:
    """Least squares of shift and twist; the twist is held to its limit as by a Gaussian of half of it."""
    lever = scene.predicted_px[pairs[:, 0]] - scene.center_px
    observed = scene.detected_px[pairs[:, 1]] - scene.center_px
    prior = (limits.tolerance_px / 4.0) ** 2 / max(0.5 * limits.max_twist_rad, 1e-9) ** 2
    for _ in range(2):  # the second step takes up the curvature of the first
        c, s = np.cos(twist_rad), np.sin(twist_rad)
        turned = lever @ np.array([[c, s], [-s, c]])
        residual = observed - turned
        slope = np.column_stack([-turned[:, 1], turned[:, 0]])
        slope, residual = slope - slope.mean(axis=0), residual - residual.mean(axis=0)
        step = (np.sum(slope * residual) - prior * twist_rad) / (np.sum(slope**2) + prior)
        twist_rad = float(np.clip(twist_rad + step, -limits.max_twist_rad, limits.max_twist_rad))
    moved = move(scene.predicted_px[pairs[:, 0]], scene.center_px, np.zeros(2), twist_rad)
    shift = (scene.detected_px[pairs[:, 1]] - moved).mean(axis=0)
    return shift, twist_rad
