"""The field from two stars that the analyst has marked, named or not."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.starcenters.boxes import check_points
from opnav_workbench.starcenters.detections import Detections
from opnav_workbench.starcenters.evidence import log_ratio_of_others
from opnav_workbench.starcenters.flags import StarFlag
from opnav_workbench.starcenters.identification import TOLERANCE_PX, identify_scene
from opnav_workbench.starcenters.judging import Identification, answer, in_camera
from opnav_workbench.starcenters.matching import refine
from opnav_workbench.starcenters.sky_scene import Hypothesis, Scene, camera_scene, checked_limits
from opnav_workbench.starcenters.voting import pair_rotations

__all__ = ["identify_marked"]

MARK_RADIUS_PX = 5.0  # a mark means the nearest detection within this
SEPARATION_TOLERANCE_PX = 6.0  # two marks without detections are off by this together
MIN_MARKS_APART_PX = 10.0  # closer marks leave the twist open
CANDIDATES = 4000  # pairs of stars of the right separation that are looked at


def identify_marked(
    directions: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    camera: Camera,
    marks_px: ArrayLike,
    stars: tuple[int, int] | None = None,
    *,
    max_shift_px: float,
    zero_point_mag: float | None = None,
    tolerance_px: float = TOLERANCE_PX,
) -> Identification:
    """Find the rotation that brings two stars onto two marked places; any twist.

    Parameters
    ----------
    directions, magnitude, detections, camera, zero_point_mag, tolerance_px
        As in `identify_sky`.
    marks_px : (2, 2) array_like
        Marked places (pixel, line); each means the nearest detection, or itself where there is none.
    stars : (int, int), optional
        Rows of the stars that were marked; without it they are looked for.
    max_shift_px : float
        Where the stars are not named: how far the pointing may be off.

    Returns
    -------
    Identification
        For named stars confidence is what the other stars say: 0.5 where none can confirm or deny them. For others as
        in `identify_sky`.

    Raises
    ------
    CenterfindingError
        Not two marks, marks on one and the same detection, or named stars of another separation.
    """
    marks = check_points(marks_px, "marks_px")
    if len(marks) != 2 or np.hypot(*(marks[1] - marks[0])) < MIN_MARKS_APART_PX:
        raise CenterfindingError(
            f"mark two stars at least {MIN_MARKS_APART_PX:g} px apart, got {np.round(marks, 1).tolist()}."
        )
    detections, chosen = _marked(detections, marks)
    scene, kept = camera_scene(directions, magnitude, detections, camera, zero_point_mag)
    marked = np.searchsorted(kept, chosen)
    limits = checked_limits(max_shift_px, np.pi, tolerance_px)
    if stars is None:
        found = identify_scene(scene, limits, marked, CANDIDATES)
        return in_camera(found, kept, camera.focal_from_camera)
    pairs = np.column_stack([np.asarray(stars, np.int64), marked])
    _check_separation(scene, pairs)
    start = pair_rotations(scene, pairs[None, :, 0], pairs[None, :, 1])[0]
    refined = refine(scene, limits, start)
    named = np.isin(pairs @ [1 << 32, 1], refined.pairs @ [1 << 32, 1]).all()
    best = refined if named else Hypothesis(start, pairs, np.zeros(2), scene.zero_point_mag)
    confidence = float(1.0 / (1.0 + np.exp(-log_ratio_of_others(scene, best, pairs))))
    return in_camera(answer(scene, best, confidence), kept, camera.focal_from_camera)


def _marked(detections: Detections, marks: FloatArray) -> tuple[Detections, IntArray]:
    """Return the detections, with the marks that have none added, and the rows that the marks mean."""
    places = detections.pixel_line.reshape(-1, 2)
    distance = np.linalg.norm(places - marks[:, None], axis=2)
    nearest = distance.argmin(axis=1) if len(places) else np.zeros(2, np.int64)
    seen = np.array([row.min(initial=np.inf) <= MARK_RADIUS_PX for row in distance])
    if seen.all() and nearest[0] == nearest[1]:
        raise CenterfindingError(
            f"both marks mean the detection at {np.round(places[nearest[0]], 1).tolist()}; mark two stars."
        )
    new = np.flatnonzero(~seen)
    rows = np.where(seen, nearest, len(places) + np.cumsum(~seen) - 1)
    ones = np.ones(len(new))
    # Of unknown brightness, as a saturated star is.
    flags = np.full(len(new), int(StarFlag.SATURATED), np.int64)
    return Detections(
        np.vstack([places, marks[new]]),
        np.r_[detections.flux_dn, ones * np.median(detections.flux_dn) if len(places) else ones],
        np.r_[detections.snr, ones],
        np.r_[detections.sharpness, ones],
        np.r_[detections.flags, flags],
        detections.limit_dn,
    ), rows.astype(np.int64)


def _check_separation(scene: Scene, pairs: IntArray) -> None:
    stars, seen = scene.stars[pairs[:, 0]], scene.detected[pairs[:, 1]]
    expected = scene.focal_px * float(np.linalg.norm(stars[1] - stars[0]))
    measured = scene.focal_px * float(np.linalg.norm(seen[1] - seen[0]))
    if abs(expected - measured) > SEPARATION_TOLERANCE_PX:
        raise CenterfindingError(
            f"the marked places are {measured:.1f} px apart, the two stars {expected:.1f} px: "
            "another star is marked, or another camera took the picture."
        )
