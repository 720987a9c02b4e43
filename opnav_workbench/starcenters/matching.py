"""From a first guess of the rotation to pairs of stars and detections, and back: match, fit, and again."""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.starcenters.sky_scene import Hypothesis, Limits, Scene, shift_and_twist
from opnav_workbench.starcenters.voting import MAGNITUDE_TOLERANCE

__all__ = ["MAGNITUDE_SIGMA", "most_promising", "refine"]

NEIGHBORS = 3  # detections considered for one star
MAGNITUDE_SIGMA = 0.6  # color of the star, and the filter's flux at unlucky pixel phases
MIN_STARS_FOR_ZERO_POINT = 3
REFINEMENTS = 4
FIRST_TOLERANCES = 2.5  # a guess from one pair is off by this many tolerances at the far end of the detector


def most_promising(scene: Scene, limits: Limits, rotations: FloatArray, count: int) -> FloatArray:
    """Return the `count` rotations (k, 3, 3) that bring most stars near detections, best first."""
    places = scene.places(rotations)
    on = scene.inside(places)
    reach = FIRST_TOLERANCES * limits.tolerance_px
    distance = np.full(on.shape, np.inf)
    found, index = scene.tree.query(places[on], distance_upper_bound=reach)
    seen = np.isfinite(found)
    if not np.isnan(scene.zero_point_mag):
        detection = np.where(seen, index, 0)
        difference = scene.detected_mag[detection] + scene.zero_point_mag - scene.magnitude[np.nonzero(on)[1]]
        seen &= (np.abs(difference) <= MAGNITUDE_TOLERANCE) | scene.censored[detection]
    distance[on] = np.where(seen, found, np.inf)
    score = np.sum(np.maximum(1.0 - 0.5 * (distance / reach) ** 2, 0.0), axis=1)
    return rotations[np.argsort(-score, kind="stable")[:count]]


def refine(scene: Scene, limits: Limits, rotation: FloatArray) -> Hypothesis:
    """Match one-to-one, fit the rotation, and again, with a zero point once there are stars for one."""
    zero_point = scene.zero_point_mag
    for step in range(REFINEMENTS):
        tolerance = limits.tolerance_px * (FIRST_TOLERANCES if step == 0 else 1.0)
        pairs, _ = _match(scene, tolerance, rotation, zero_point)
        if len(pairs) == 0:
            break
        rotation = _fit(scene, limits, pairs, rotation)
        clear = pairs[~scene.censored[pairs[:, 1]]]
        if len(clear) >= MIN_STARS_FOR_ZERO_POINT:
            zero_point = float(np.median(scene.magnitude[clear[:, 0]] - scene.detected_mag[clear[:, 1]]))
    pairs, distance = _match(scene, limits.tolerance_px, rotation, zero_point)
    return Hypothesis(rotation, pairs, distance, zero_point)


def _match(
    scene: Scene, tolerance_px: float, rotation: FloatArray, zero_point: float
) -> tuple[IntArray, FloatArray]:
    """One-to-one pairs within the tolerances: each star's best detection, each detection's best star."""
    places = scene.places(rotation)
    on = np.flatnonzero(scene.inside(places))
    nearest = scene.tree.query(places[on], k=NEIGHBORS, distance_upper_bound=tolerance_px)
    distance, index = np.asarray(nearest[0], float), np.asarray(nearest[1], np.int64)
    found = np.isfinite(distance)
    cost = np.where(found, (distance / tolerance_px) ** 2, np.inf)
    if not np.isnan(zero_point):
        detection = np.where(found, index, 0)
        difference = scene.detected_mag[detection] + zero_point - scene.magnitude[on][:, None]
        difference = np.where(scene.censored[detection], np.minimum(difference, 0.0), difference)
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


def _fit(scene: Scene, limits: Limits, pairs: IntArray, rotation: FloatArray) -> FloatArray:
    """Least-squares rotation; the twist is held to its limit as by a Gaussian of half of it."""
    prior = (limits.tolerance_px / 4.0) ** 2 / max(0.5 * limits.max_twist_rad, 1e-9) ** 2
    observed = scene.detected_plane[pairs[:, 1]]
    for _ in range(2):  # the second step takes up the curvature of the first
        place = scene.plane(scene.stars[pairs[:, 0]] @ rotation.T)
        residual = observed - place
        slope = np.column_stack([-place[:, 1], place[:, 0]])
        mean_residual, mean_slope = residual.mean(axis=0), slope.mean(axis=0)
        slope, residual = slope - mean_slope, residual - mean_residual
        twist = float(shift_and_twist(rotation, scene.focal_px)[1])
        step = (np.sum(slope * residual) - prior * twist) / (np.sum(slope**2) + prior)
        step = float(np.clip(twist + step, -limits.max_twist_rad, limits.max_twist_rad)) - twist
        shift = mean_residual - step * mean_slope
        turn = np.array([-shift[1] / scene.focal_px, shift[0] / scene.focal_px, step])
        rotation = rotation_from_vector(turn) @ rotation
    return rotation
