"""Rotations that may take the stars onto the detections: proposed by votes of pairs, and refined by matching.

Votes     A pair of stars and a pair of detections the same angle apart give one rotation each way round. The right
          rotation gets a vote from every pair of identified stars, k (k - 1) / 2 of them for k stars; wrong ones are
          strewn over all shifts and twists. Votes are counted in cells of shift and twist; the fullest are looked at.
Matching  From a rotation to one-to-one pairs of stars and detections, from the pairs to a better rotation, and again.
One star  The brightest expected, as each of the detections within reach; nothing can be cross-checked.

References: pairs and their angles as in Kolomenkin et al. (2008), doi:10.1109/TAES.2008.4560202; counting after
Duda & Hart (1972), doi:10.1145/361237.361242.
"""

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.geometry.near_places import pairs_within
from opnav_workbench.stars.star_field import RotationHypothesis, SearchLimits, StarField, shift_and_twist

__all__ = [
    "KEPT_HYPOTHESES",
    "MAGNITUDE_SIGMA",
    "most_promising",
    "pair_rotations",
    "refine_rotation",
    "single_star_hypotheses",
    "vote_for_rotations",
]


# ---- First guesses of the rotation between stars and detections: pairs of equal separation vote for it.

STARS_ON_DETECTOR = 30  # brightest stars that vote, as many as this on an area as large as the detector's
VOTING_STARS = 900  # but no more than this in all
VOTING_DETECTIONS = 150  # brightest detections: stars must be found among more cosmic rays than stars
PAIR_BUDGET = 1_500_000  # pairs of pairs looked at; fewer detections vote where there would be more
KEPT_HYPOTHESES = 150
MAGNITUDE_TOLERANCE = 2.0  # a star may be off by this through color or variability, not more
MIN_SEPARATION_PX = 4.0  # a closer pair says nothing of the twist
PAIR_TOLERANCE_PX = 1.5  # of a separation; centers of detections are good to some tenths
CELL_TOLERANCES = (
    2.5  # size of a cell, in tolerances: a pair a quarter of the diagonal apart is off by one at the center
)
FAINT_MARGIN_MAG = 1.0  # stars fainter than the faintest detection by more do not vote


def vote_for_rotations(
    star_field: StarField,
    limits: SearchLimits,
    detections: IntArray | None = None,
    kept: int = KEPT_HYPOTHESES,
) -> FloatArray:
    """Return the rotations (h, 3, 3) with most votes, best first, at most `kept`; given detections alone vote."""
    stars, likeliest = _voters(star_field, limits)
    detections = likeliest if detections is None else detections
    allowed = _allowed_pairs(star_field, limits, stars, detections)
    star_pairs, detection_pairs = _pairs_of_pairs(star_field, stars, detections, allowed)
    rotation = pair_rotations(star_field, star_pairs, detection_pairs)
    shift, twist = shift_and_twist(rotation, star_field.focal_px)
    separation = np.linalg.norm(
        star_field.detected_plane[detection_pairs[:, 0]] - star_field.detected_plane[detection_pairs[:, 1]],
        axis=1,
    )
    slack = limits.tolerance_px / np.maximum(separation, 1.0)
    reach = limits.max_shift_px + limits.tolerance_px + slack * star_field.half_diagonal_px
    fits = (np.hypot(*shift.T) <= reach) & (np.abs(twist) <= limits.max_twist_rad + slack)
    chosen = _fullest_cells(star_field, limits, shift[fits], twist[fits], separation[fits])[:kept]
    return np.asarray(rotation[fits][chosen])


def _voters(star_field: StarField, limits: SearchLimits) -> tuple[IntArray, IntArray]:
    """Brightest stars that can be on the detector, and brightest detections of those that may be one of them."""
    reach = star_field.half_diagonal_px + limits.max_shift_px
    plane = star_field.plane(star_field.stars)
    near = np.hypot(*plane.T) <= reach
    if not np.isnan(star_field.zero_point_mag):
        near &= star_field.magnitude <= star_field.limit_mag + star_field.zero_point_mag + FAINT_MARGIN_MAG
    if limits.max_twist_rad < 0.1:  # what stays off the detector however the field is shifted
        margin = limits.max_shift_px + limits.max_twist_rad * reach
        near &= star_field.inside(plane - np.clip(plane, -margin, margin))
    share = max(np.pi * reach**2 / star_field.area_px2, 1.0) if limits.max_twist_rad >= 0.1 else (
        np.prod(star_field.size_px + 2.0 * limits.max_shift_px) / star_field.area_px2
    )  # fmt: skip
    count = min(int(STARS_ON_DETECTOR * share), VOTING_STARS)
    stars = np.flatnonzero(near)
    stars = stars[np.argsort(star_field.magnitude[stars], kind="stable")[:count]]
    detections = np.lexsort((star_field.detected_mag, star_field.sharper_than_star))
    if len(detections) > VOTING_DETECTIONS:  # what no star can be, by place and brightness, has no vote
        possible = _allowed_pairs(star_field, limits, stars, detections).any(axis=0)
        detections = detections[possible] if possible.any() else detections
    return stars, detections[:VOTING_DETECTIONS]


def _allowed_pairs(
    star_field: StarField, limits: SearchLimits, stars: IntArray, detections: IntArray
) -> BoolArray:
    """Which star may be which detection, by place and brightness; (stars, detections)."""
    plane, seen = star_field.plane(star_field.stars[stars]), star_field.detected_plane[detections]
    turn = 2.0 * np.sin(0.5 * min(limits.max_twist_rad, np.pi)) * np.hypot(*plane.T)
    # Off the boresight the tangent plane stretches shifts by a few per cent in the widest fields.
    reach = 1.1 * limits.max_shift_px + turn + 2.0 * limits.tolerance_px
    offset = plane[:, None] - seen
    allowed = np.asarray(np.hypot(offset[..., 0], offset[..., 1]) <= reach[:, None])
    if not np.isnan(star_field.zero_point_mag):
        difference = (
            star_field.detected_mag[detections]
            + star_field.zero_point_mag
            - star_field.magnitude[stars][:, None]
        )
        allowed &= (np.abs(difference) <= MAGNITUDE_TOLERANCE) | (
            star_field.saturated[detections] & (difference > 0.0)
        )
    return allowed


def _pairs_of_pairs(
    star_field: StarField, stars: IntArray, detections: IntArray, allowed: BoolArray
) -> tuple[IntArray, IntArray]:
    """Pairs of stars and pairs of detections of the same separation and difference in brightness; (h, 2) each."""
    points = star_field.focal_px * star_field.stars[stars]
    seen = star_field.focal_px * star_field.detected[detections]
    first, second = np.triu_indices(len(seen), 1)
    apart = np.linalg.norm(seen[first] - seen[second], axis=1)
    candidates = pairs_within(points, float(apart.max(initial=0.0)) + PAIR_TOLERANCE_PX)
    separation = np.linalg.norm(points[candidates[:, 0]] - points[candidates[:, 1]], axis=1)
    order = np.argsort(separation)
    candidates, separation = candidates[order], separation[order]
    begin = np.searchsorted(separation, apart - PAIR_TOLERANCE_PX)
    count = np.searchsorted(separation, apart + PAIR_TOLERANCE_PX) - begin
    count[apart < MIN_SEPARATION_PX] = 0
    count = _within_budget(first, second, count)
    row = np.repeat(np.arange(len(count)), count)
    column = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
    a, b, i, j = candidates[column, 0], candidates[column, 1], first[row], second[row]
    a, b, i, j = np.r_[a, b], np.r_[b, a], np.r_[i, i], np.r_[j, j]
    good = allowed[a, i] & allowed[b, j]
    a, b, i, j = stars[a[good]], stars[b[good]], detections[i[good]], detections[j[good]]
    good = _same_contrast(star_field, a, b, i, j)
    return np.column_stack([a, b])[good], np.column_stack([i, j])[good]


def _within_budget(first: IntArray, second: IntArray, count: IntArray) -> IntArray:
    """Leave out the last detections where all of them would make too many pairs."""
    rank = np.maximum(first, second)
    total = np.cumsum(np.bincount(rank, weights=count, minlength=1))
    return np.where(total[rank] <= PAIR_BUDGET, count, 0)


def _same_contrast(star_field: StarField, a: IntArray, b: IntArray, i: IntArray, j: IntArray) -> BoolArray:
    stars = star_field.magnitude[a] - star_field.magnitude[b]
    seen = star_field.detected_mag[i] - star_field.detected_mag[j]
    unknown = star_field.saturated[i] | star_field.saturated[j]
    return np.asarray(unknown | (np.abs(stars - seen) <= MAGNITUDE_TOLERANCE))


def pair_rotations(star_field: StarField, star_pairs: IntArray, detection_pairs: IntArray) -> FloatArray:
    """Rotations (h, 3, 3) that turn pairs of stars onto pairs of detections."""
    stars = _pair_axes(star_field.stars[star_pairs[:, 0]], star_field.stars[star_pairs[:, 1]])
    seen = _pair_axes(star_field.detected[detection_pairs[:, 0]], star_field.detected[detection_pairs[:, 1]])
    return np.asarray(np.swapaxes(seen, -1, -2) @ stars)


def _pair_axes(one: FloatArray, two: FloatArray) -> FloatArray:
    """Orthonormal axes (h, 3, 3), in rows, along the middle and the difference of two unit vectors."""
    middle, along = one + two, two - one
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([middle, along, np.cross(middle, along)], axis=1)


def _fullest_cells(
    star_field: StarField, limits: SearchLimits, shift: FloatArray, twist: FloatArray, separation: FloatArray
) -> IntArray:
    """One vote from each of the fullest cells, that of its widest pair."""
    size = CELL_TOLERANCES * limits.tolerance_px
    turn = (twist + np.pi) * star_field.half_diagonal_px
    place = np.column_stack([shift, turn]) / size
    period = max(int(np.ceil(2.0 * np.pi * star_field.half_diagonal_px / size)), 1)
    votes = np.zeros(len(place), np.int64)
    cell = np.zeros(len(place), np.int64)
    for grid, start in enumerate((0.0, 0.5)):  # a cluster on the edge of a cell is in the middle of another
        index = np.floor(place + start).astype(np.int64)
        index[:, 2] %= period
        span = 2 * int(np.ceil(np.abs(place).max(initial=0.0))) + 4
        key = ((index[:, 0] * span + index[:, 1]) * span + index[:, 2]) * 2 + grid
        _, which, count = np.unique(key, return_inverse=True, return_counts=True)
        fuller = count[which] > votes
        votes = np.where(fuller, count[which], votes)
        cell = np.where(fuller, key, cell)
    order = np.lexsort((-separation, -votes))
    _, first = np.unique(cell[order], return_index=True)
    return np.asarray(order[np.sort(first)])


# ---- From a first guess of the rotation to pairs of stars and detections, and back: match, fit, and again.

DETECTIONS_PER_STAR = 3  # detections considered for one star
MAGNITUDE_SIGMA = 0.6  # color of the star, and the filter's flux at unlucky pixel phases
MIN_STARS_FOR_ZERO_POINT = 3
REFINEMENTS = 4
FIRST_TOLERANCES = 2.5  # a guess from one pair is off by this many tolerances at the far end of the detector


def most_promising(
    star_field: StarField, limits: SearchLimits, rotations: FloatArray, count: int
) -> FloatArray:
    """Return the `count` rotations (k, 3, 3) that bring most stars near detections, best first."""
    places = star_field.places(rotations)
    on = star_field.inside(places)
    reach = FIRST_TOLERANCES * limits.tolerance_px
    distance = np.full(on.shape, np.inf)
    found, index = star_field.near.nearest(places[on], within=reach)
    seen = np.isfinite(found)
    if not np.isnan(star_field.zero_point_mag):
        detection = np.where(seen, index, 0)
        difference = (
            star_field.detected_mag[detection]
            + star_field.zero_point_mag
            - star_field.magnitude[np.nonzero(on)[1]]
        )
        seen &= (np.abs(difference) <= MAGNITUDE_TOLERANCE) | star_field.saturated[detection]
    distance[on] = np.where(seen, found, np.inf)
    score = np.sum(np.maximum(1.0 - 0.5 * (distance / reach) ** 2, 0.0), axis=1)
    return rotations[np.argsort(-score, kind="stable")[:count]]


def refine_rotation(star_field: StarField, limits: SearchLimits, rotation: FloatArray) -> RotationHypothesis:
    """Match one-to-one, fit the rotation, and again, with a zero point once there are stars for one."""
    zero_point = star_field.zero_point_mag
    for step in range(REFINEMENTS):
        tolerance = limits.tolerance_px * (FIRST_TOLERANCES if step == 0 else 1.0)
        pairs, _ = _match_stars(star_field, tolerance, rotation, zero_point)
        if len(pairs) == 0:
            break
        rotation = _fit_rotation(star_field, limits, pairs, rotation)
        clear = pairs[~star_field.saturated[pairs[:, 1]]]
        if len(clear) >= MIN_STARS_FOR_ZERO_POINT:
            zero_point = float(
                np.median(star_field.magnitude[clear[:, 0]] - star_field.detected_mag[clear[:, 1]])
            )
    pairs, distance = _match_stars(star_field, limits.tolerance_px, rotation, zero_point)
    return RotationHypothesis(rotation, pairs, distance, zero_point)


def _match_stars(
    star_field: StarField, tolerance_px: float, rotation: FloatArray, zero_point: float
) -> tuple[IntArray, FloatArray]:
    """One-to-one pairs within the tolerances: each star's best detection, each detection's best star."""
    places = star_field.places(rotation)
    on = np.flatnonzero(star_field.inside(places))
    distance, index = star_field.near.nearest(places[on], DETECTIONS_PER_STAR, tolerance_px)
    found = np.isfinite(distance)
    cost = np.where(found, (distance / tolerance_px) ** 2, np.inf)
    if not np.isnan(zero_point):
        detection = np.where(found, index, 0)
        difference = star_field.detected_mag[detection] + zero_point - star_field.magnitude[on][:, None]
        difference = np.where(star_field.saturated[detection], np.minimum(difference, 0.0), difference)
        cost = np.where(
            np.abs(difference) <= MAGNITUDE_TOLERANCE,
            cost + 0.1 * (difference / MAGNITUDE_SIGMA) ** 2,
            np.inf,
        )
    best = cost.argmin(axis=1)
    rows = np.arange(len(on))
    star = rows[np.isfinite(cost[rows, best])]
    star = star[np.argsort(cost[star, best[star]], kind="stable")]
    chosen = index[star, best[star]]
    _, first = np.unique(chosen, return_index=True)  # of stars that want the same detection, the cheapest
    star, detection = star[first], chosen[first]
    order = np.argsort(star)
    return np.column_stack([on[star], detection])[order], distance[star, best[star]][order]


def _fit_rotation(
    star_field: StarField, limits: SearchLimits, pairs: IntArray, rotation: FloatArray
) -> FloatArray:
    """Least-squares rotation; the twist is held to its limit as by a Gaussian of half of it."""
    prior = (limits.tolerance_px / 4.0) ** 2 / max(0.5 * limits.max_twist_rad, 1e-9) ** 2
    observed = star_field.detected_plane[pairs[:, 1]]
    for _ in range(2):  # the second step takes up the curvature of the first
        place = star_field.plane(star_field.stars[pairs[:, 0]] @ rotation.T)
        residual = observed - place
        slope = np.column_stack([-place[:, 1], place[:, 0]])
        mean_residual, mean_slope = residual.mean(axis=0), slope.mean(axis=0)
        slope, residual = slope - mean_slope, residual - mean_residual
        twist = float(shift_and_twist(rotation, star_field.focal_px)[1])
        step = (np.sum(slope * residual) - prior * twist) / (np.sum(slope**2) + prior)
        step = float(np.clip(twist + step, -limits.max_twist_rad, limits.max_twist_rad)) - twist
        shift = mean_residual - step * mean_slope
        turn = np.array([-shift[1] / star_field.focal_px, shift[0] / star_field.focal_px, step])
        rotation = rotation_from_vector(turn) @ rotation
    return rotation


# ---- One star alone.

SINGLE_STAR_CANDIDATES = 3  # brightest stars that may be the only one seen
SINGLE_STAR_TWIST_RAD = 0.1  # with a twist less known than this one star says nothing


def single_star_hypotheses(star_field: StarField, limits: SearchLimits) -> list[RotationHypothesis]:
    """One of the brightest stars alone, as each of the detections within reach."""
    if limits.max_twist_rad > SINGLE_STAR_TWIST_RAD:
        return []
    place = star_field.places(np.eye(3))
    inside = star_field.inside(place)
    stars = np.argsort(np.where(inside | ~inside.any(), star_field.magnitude, np.inf), kind="stable")
    singles: list[RotationHypothesis] = []
    for star in stars[: min(SINGLE_STAR_CANDIDATES, max(int(inside.sum()), 1))]:
        near = np.hypot(*(star_field.detected_plane - place[star]).T) <= limits.max_shift_px
        if not np.isnan(star_field.zero_point_mag):
            difference = star_field.detected_mag + star_field.zero_point_mag - star_field.magnitude[star]
            near &= (np.abs(difference) <= MAGNITUDE_TOLERANCE) | star_field.saturated
        singles.extend(
            _single_star_hypothesis(star_field, int(star), int(detection))
            for detection in np.flatnonzero(near)
        )
    return singles


def _single_star_hypothesis(star_field: StarField, star: int, detection: int) -> RotationHypothesis:
    first, second = star_field.stars[star], star_field.detected[detection]
    across = np.cross(first, second)
    angle = np.arctan2(np.linalg.norm(across), first @ second)
    turn = across * (angle / max(float(np.linalg.norm(across)), np.finfo(float).tiny))
    pairs = np.array([[star, detection]], np.int64)
    return RotationHypothesis(rotation_from_vector(turn), pairs, np.zeros(1), star_field.zero_point_mag)
