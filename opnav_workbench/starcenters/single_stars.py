"""One star alone: the brightest expected, as each of the detections within reach; nothing can be cross-checked."""

import numpy as np

from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.starcenters.sky_scene import Hypothesis, Limits, Scene
from opnav_workbench.starcenters.voting import MAGNITUDE_TOLERANCE

__all__ = ["single_stars"]

SINGLE_STARS = 3  # brightest stars that may be the only one seen
SINGLE_STAR_TWIST_RAD = 0.1  # with a twist less known than this one star says nothing


def single_stars(scene: Scene, limits: Limits) -> list[Hypothesis]:
    """One of the brightest stars alone, as each of the detections within reach."""
    if limits.max_twist_rad > SINGLE_STAR_TWIST_RAD:
        return []
    place = scene.places(np.eye(3))
    inside = scene.inside(place)
    stars = np.argsort(np.where(inside | ~inside.any(), scene.magnitude, np.inf), kind="stable")
    singles: list[Hypothesis] = []
    for star in stars[: min(SINGLE_STARS, max(int(inside.sum()), 1))]:
        near = np.hypot(*(scene.detected_plane - place[star]).T) <= limits.max_shift_px
        if not np.isnan(scene.zero_point_mag):
            difference = scene.detected_mag + scene.zero_point_mag - scene.magnitude[star]
            near &= (np.abs(difference) <= MAGNITUDE_TOLERANCE) | scene.censored
        singles.extend(_single(scene, int(star), int(detection)) for detection in np.flatnonzero(near))
    return singles


def _single(scene: Scene, star: int, detection: int) -> Hypothesis:
    first, second = scene.stars[star], scene.detected[detection]
    across = np.cross(first, second)
    angle = np.arctan2(np.linalg.norm(across), first @ second)
    turn = across * (angle / max(float(np.linalg.norm(across)), np.finfo(float).tiny))
    pairs = np.array([[star, detection]], np.int64)
    return Hypothesis(rotation_from_vector(turn), pairs, np.zeros(1), scene.zero_point_mag)
