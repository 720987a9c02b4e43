"""Which detection is which star, whatever the pointing error within given limits, and how sure that is.

Pairs of stars and of detections vote for rotations, the best are refined (`hypotheses`) and weighed (`evidence`). An
analyst may mark two stars, named or not: the field is then the one that has them at the marked places, at any twist.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars.boxes import check_points
from opnav_workbench.stars.detection import Detections
from opnav_workbench.stars.evidence import (
    SURE_CONFIDENCE,
    Identification,
    best_identification,
    identification_from,
    in_camera_frame,
    log_evidence,
    log_ratio_of_other_stars,
    no_identification,
)
from opnav_workbench.stars.flags import StarFlag
from opnav_workbench.stars.hypotheses import (
    KEPT_HYPOTHESES,
    most_promising,
    pair_rotations,
    refine_rotation,
    single_star_hypotheses,
    vote_for_rotations,
)
from opnav_workbench.stars.star_field import (
    RotationHypothesis,
    SearchLimits,
    StarField,
    checked_limits,
    shift_and_twist,
    star_field_in_camera,
    star_field_in_plane,
)

__all__ = ["identify", "identify_marked", "identify_sky"]


# ---- Which detection is which star, whatever the pointing error within given limits, and how sure that is.

MAX_SHIFT_PX = 60.0  # attitude errors of 40 px are usual (AAS 13-443)
MAX_TWIST_RAD = float(np.radians(0.5))  # headers are off by 0.2 deg (LORRI, 2020)
TOLERANCE_PX = 2.0  # unmodeled proper motion and distortion, coarse centers
REFINED_HYPOTHESES = 12  # hypotheses refined, those that bring most stars near detections


def identify_sky(
    directions: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    camera: Camera,
    *,
    max_shift_px: float = MAX_SHIFT_PX,
    max_twist_rad: float = MAX_TWIST_RAD,
    tolerance_px: float = TOLERANCE_PX,
    zero_point_mag: float | None = None,
) -> Identification:
    """Match stars with detections through the camera's own geometry; for errors up to any shift and twist.

    Parameters
    ----------
    directions : (n, 3) array_like
        Apparent unit vectors of the catalog stars in the camera frame of the a priori attitude, on the detector and as
        far around it as the pointing may be off.
    magnitude : (n,) array_like
        Their magnitudes; nan where unknown.
    detections
        From `detect`; cosmic rays among them are expected.
    max_shift_px, max_twist_rad
        Limits of the pointing error; a twist of pi is any twist.
    tolerance_px
        Largest distance between a star and its detection, once the rotation is right.
    zero_point_mag
        Magnitude of a star of 1 DN total flux in this exposure; without it brightness only ranks.

    Returns
    -------
    Identification
        Without a match: no pairs, confidence 0, and a message that says why.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, directions that are not finite, or limits that are negative.

    Examples
    --------
    A picture turned by a quarter and 100 px off:

    >>> from opnav_workbench.geometry import rotation_from_vector
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> places = np.random.default_rng(1).uniform(0.0, 1000.0, (8, 2))
    >>> turn = rotation_from_vector(camera.focal_from_camera.T @ [0.0, 100.0 * camera.pixel_scale_rad, np.pi / 2])
    >>> seen = Detections(places, *np.ones((3, 8)), np.zeros(8, int))
    >>> stars = camera.unproject(places) @ turn
    >>> found = identify_sky(stars, np.full(8, 9.0), seen, camera, max_shift_px=200.0, max_twist_rad=np.pi)
    >>> len(found.pairs), found.sure, bool(np.allclose(found.rotation, turn, atol=1e-6))
    (8, True, True)
    """
    star_field, kept = star_field_in_camera(directions, magnitude, detections, camera, zero_point_mag)
    found = identify_star_field(star_field, checked_limits(max_shift_px, max_twist_rad, tolerance_px))
    return in_camera_frame(found, kept, camera.focal_from_camera)


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
    """Match predicted stars with detections in the plane of the picture, where distortion is small.

    Parameters
    ----------
    predicted_px : (n, 2) array_like
        A priori (pixel, line) of the catalog stars on and around the detector.
    magnitude, detections, max_shift_px, max_twist_rad, tolerance_px, zero_point_mag
        As in `identify_sky`.
    center_px : (2,) array_like
        Center of the detector (pixel, line), about which the twist turns; the detector ends at twice that.

    Returns
    -------
    Identification
        Without a match: no pairs, confidence 0, and a message that says why.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape or limits that are negative.

    Examples
    --------
    >>> stars = np.array([[20.0, 30.0], [200.0, 80.0], [90.0, 210.0], [150.0, 150.0]])
    >>> seen = Detections(stars + [12.0, -7.0], *np.ones((3, 4)), np.zeros(4, int))
    >>> found = identify(stars, np.full(4, 9.0), seen, center_px=(127.5, 127.5))
    >>> found.shift_px.round(3).tolist(), len(found.pairs), found.sure
    ([12.0, -7.0], 4, True)
    """
    star_field = star_field_in_plane(predicted_px, magnitude, detections, center_px, zero_point_mag)
    return identify_star_field(star_field, checked_limits(max_shift_px, max_twist_rad, tolerance_px))


def identify_star_field(
    star_field: StarField, limits: SearchLimits, voting: IntArray | None = None, kept: int = KEPT_HYPOTHESES
) -> Identification:
    """Return the likeliest rotation; all detections vote for it, or only some."""
    if len(star_field.stars) == 0:
        return no_identification(star_field, "no predicted star near the detector: nothing to identify")
    if len(star_field.detected) == 0:
        return no_identification(star_field, "no star detected in the image")
    rotations = most_promising(
        star_field, limits, vote_for_rotations(star_field, limits, voting, kept), REFINED_HYPOTHESES
    )
    hypotheses = [refine_rotation(star_field, limits, rotation) for rotation in rotations]
    hypotheses = [h for h in hypotheses if len(h.pairs) > 1 and _within_limits(star_field, limits, h)]
    evidence = [log_evidence(star_field, limits, h) for h in hypotheses]
    if voting is None and max(evidence, default=-np.inf) < np.log(1.0 / (1.0 - SURE_CONFIDENCE)):
        singles = [
            h for h in single_star_hypotheses(star_field, limits) if _within_limits(star_field, limits, h)
        ]
        hypotheses += singles
        evidence += [log_evidence(star_field, limits, h) for h in singles]
    if not hypotheses:
        within = f"{limits.max_shift_px:g} px and {np.degrees(limits.max_twist_rad):.3g} deg"
        return no_identification(
            star_field, f"no detection has place and brightness of a star within {within}"
        )
    return best_identification(star_field, limits, hypotheses, np.array(evidence))


def _within_limits(star_field: StarField, limits: SearchLimits, h: RotationHypothesis) -> bool:
    shift, _ = shift_and_twist(h.rotation, star_field.focal_px)
    return bool(np.hypot(*shift) <= limits.max_shift_px + limits.tolerance_px)


# ---- The field from two stars that the analyst has marked, named or not.

MARK_RADIUS_PX = 5.0  # a mark means the nearest detection within this
SEPARATION_TOLERANCE_PX = 6.0  # two marks without detections are off by this together
MIN_MARKS_APART_PX = 10.0  # closer marks leave the twist open
MARKED_PAIRS = 4000  # pairs of stars of the right separation that are looked at


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
    max_shift_px
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
    detections, chosen = _marked_detections(detections, marks)
    star_field, kept = star_field_in_camera(directions, magnitude, detections, camera, zero_point_mag)
    marked = np.searchsorted(kept, chosen)
    limits = checked_limits(max_shift_px, np.pi, tolerance_px)
    if stars is None:
        found = identify_star_field(star_field, limits, marked, MARKED_PAIRS)
        return in_camera_frame(found, kept, camera.focal_from_camera)
    pairs = np.column_stack([np.asarray(stars, np.int64), marked])
    _check_separation(star_field, pairs)
    start = pair_rotations(star_field, pairs[None, :, 0], pairs[None, :, 1])[0]
    refined = refine_rotation(star_field, limits, start)
    named = np.isin(pairs @ [1 << 32, 1], refined.pairs @ [1 << 32, 1]).all()
    best = refined if named else RotationHypothesis(start, pairs, np.zeros(2), star_field.zero_point_mag)
    confidence = float(1.0 / (1.0 + np.exp(-log_ratio_of_other_stars(star_field, best, pairs))))
    return in_camera_frame(identification_from(star_field, best, confidence), kept, camera.focal_from_camera)


def _marked_detections(detections: Detections, marks: FloatArray) -> tuple[Detections, IntArray]:
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


def _check_separation(star_field: StarField, pairs: IntArray) -> None:
    stars, seen = star_field.stars[pairs[:, 0]], star_field.detected[pairs[:, 1]]
    expected = star_field.focal_px * float(np.linalg.norm(stars[1] - stars[0]))
    measured = star_field.focal_px * float(np.linalg.norm(seen[1] - seen[0]))
    if abs(expected - measured) > SEPARATION_TOLERANCE_PX:
        raise CenterfindingError(
            f"the marked places are {measured:.1f} px apart, the two stars {expected:.1f} px: "
            "another star is marked, or another camera took the picture."
        )
