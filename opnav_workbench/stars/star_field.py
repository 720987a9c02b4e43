"""A star field to be identified: catalog stars and detections as directions, and what is known of their brightness.

Frame  focal axes of the camera (x along pixel, y along line, z the boresight), stars as the a priori attitude has
       them; a rotation R turns them into those of the picture: v_picture = R @ v_a_priori
Units  unit vectors; the tangent plane ``plane`` is scaled to pixels at the boresight, free of distortion

Directions, not pixels, so that distortion and the camera's field do not matter, however far the pointing is off.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import unit
from opnav_workbench.geometry.near_places import NearPlaces
from opnav_workbench.stars.boxes import check_points
from opnav_workbench.stars.detection import Detections
from opnav_workbench.stars.flags import StarFlag

__all__ = [
    "RotationHypothesis",
    "SearchLimits",
    "StarField",
    "checked_limits",
    "shift_and_twist",
    "star_field_in_camera",
    "star_field_in_plane",
]

MIN_DEPTH = 0.05  # cosine: 87 deg off the boresight, beyond any camera with a tangent plane
LONG_FOCUS_PX = 1e7  # of the camera that stands for a plane picture: its field is flat to 1e-7 px


@dataclass(frozen=True, slots=True, eq=False)
class StarField:
    """Stars and detections to be matched; magnitudes of detections are -2.5 log10(flux)."""

    stars: FloatArray  # (n, 3)
    magnitude: FloatArray  # (n,)
    detected: FloatArray  # (m, 3)
    detected_mag: FloatArray  # (m,)
    sharper_than_star: BoolArray  # (m,) sharper than a star
    saturated: BoolArray  # (m,) saturated: brighter than detected_mag says
    limit_mag: float  # detected_mag of the faintest star that is detected
    zero_point_mag: float  # magnitude of 1 DN, nan where unknown
    focal_px: float  # pixels per radian at the boresight
    pixel_from_plane: FloatArray  # (2, 2)
    center_px: FloatArray  # (2,) of the boresight
    size_px: FloatArray  # (2,) of the detector
    detected_plane: FloatArray = field(init=False)  # (m, 2)
    near: NearPlaces = field(init=False)  # of detected_plane

    def __post_init__(self) -> None:
        object.__setattr__(self, "detected_plane", self.plane(self.detected))
        object.__setattr__(self, "near", NearPlaces(self.detected_plane))
        freeze_arrays(self)

    def plane(self, vectors: FloatArray) -> FloatArray:
        """Return tangent-plane places (..., 2), px; far away for what is not in front of the camera."""
        depth = vectors[..., 2:]
        return np.asarray(self.focal_px * vectors[..., :2] / np.where(depth > MIN_DEPTH, depth, MIN_DEPTH))

    def places(self, rotation: FloatArray) -> FloatArray:
        """Return where the stars are in the tangent plane with rotations (..., 3, 3); (..., n, 2)."""
        return self.plane(self.stars @ np.swapaxes(rotation, -1, -2))

    def inside(self, plane_px: FloatArray) -> BoolArray:
        """Tell for places (..., 2) of the tangent plane whether they are on the detector."""
        pixel_line = plane_px @ self.pixel_from_plane.T + self.center_px
        return np.asarray(((pixel_line > -0.5) & (pixel_line < self.size_px - 0.5)).all(axis=-1))

    @property
    def area_px2(self) -> float:
        """Area of the detector."""
        return float(np.prod(self.size_px))

    @property
    def half_diagonal_px(self) -> float:
        """From the boresight to the farthest corner."""
        return float(np.hypot(*np.maximum(self.center_px, self.size_px - 1.0 - self.center_px)))


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """How far the truth may be from the prediction."""

    max_shift_px: float
    max_twist_rad: float
    tolerance_px: float  # between a moved prediction and its detection


@dataclass(frozen=True, slots=True, eq=False)
class RotationHypothesis:
    """One rotation, and the pairs (star, detection) that it makes."""

    rotation: FloatArray  # (3, 3)
    pairs: IntArray  # (k, 2)
    distance_px: FloatArray  # (k,)
    zero_point_mag: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def shift_and_twist(rotation: FloatArray, focal_px: float) -> tuple[FloatArray, FloatArray]:
    """Return where the a priori boresight moves to (..., 2), px in the tangent plane, and twists (...)."""
    depth = np.maximum(rotation[..., 2, 2], MIN_DEPTH)[..., None]
    shift = focal_px * rotation[..., :2, 2] / depth
    twist = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    return np.asarray(shift), np.asarray(twist)


def checked_limits(max_shift_px: float, max_twist_rad: float, tolerance_px: float) -> SearchLimits:
    """Return limits, a twist beyond half a turn as half a turn.

    Raises
    ------
    CenterfindingError
        One is negative, or the tolerance not positive.
    """
    if not (max_shift_px >= 0.0 and max_twist_rad >= 0.0 and tolerance_px > 0.0):
        raise CenterfindingError(
            f"limits must not be negative: {max_shift_px} px, {max_twist_rad} rad, {tolerance_px} px."
        )
    return SearchLimits(max_shift_px, min(max_twist_rad, np.pi), tolerance_px)


def star_field_in_camera(
    directions: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    camera: Camera,
    zero_point_mag: float | None,
) -> tuple[StarField, IntArray]:
    """Return the star field of a camera, stars (n, 3) in its own frame, and the detections (m,) kept in it.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, or directions that are not finite.
    """
    stars = np.asarray(directions, float).reshape(-1, 3)
    if not np.isfinite(stars).all():
        raise CenterfindingError("a star's direction is not finite; leave out stars without a place.")
    seen = camera.unproject(detections.pixel_line.reshape(-1, 2))
    kept = np.flatnonzero(np.isfinite(seen).all(axis=1))
    focal_px = 1.0 / camera.pixel_scale_rad
    star_field = StarField(
        stars=stars @ camera.focal_from_camera.T,
        magnitude=_star_magnitudes(magnitude, len(stars)),
        detected=seen[kept] @ camera.focal_from_camera.T,
        **_detected_brightness(detections.take(kept), zero_point_mag),
        focal_px=focal_px,
        pixel_from_plane=camera.pixel_from_mm * camera.focal_length_mm / focal_px,
        center_px=np.asarray(camera.center_pixel_line),
        size_px=np.array([camera.n_pixel, camera.n_line], float),
    )
    return star_field, kept


def star_field_in_plane(
    predicted_px: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    center_px: ArrayLike,
    zero_point_mag: float | None,
) -> StarField:
    """Return the star field of a plane picture, predicted stars (n, 2) in its pixels.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, or places that are not finite.
    """
    center, predicted = check_points(center_px, "center_px"), check_points(predicted_px, "predicted_px")
    if len(center) != 1:
        raise CenterfindingError(f"center_px must be one point (pixel, line), got {len(center)}.")
    return StarField(
        stars=_distant_directions(predicted - center),
        magnitude=_star_magnitudes(magnitude, len(predicted)),
        detected=_distant_directions(detections.pixel_line.reshape(-1, 2) - center),
        **_detected_brightness(detections, zero_point_mag),
        focal_px=LONG_FOCUS_PX,
        pixel_from_plane=np.eye(2),
        center_px=center[0],
        size_px=2.0 * center[0] + 1.0,
    )


def _distant_directions(plane_px: FloatArray) -> FloatArray:
    return unit(np.column_stack([plane_px, np.full(len(plane_px), LONG_FOCUS_PX)]))


def _star_magnitudes(magnitude: ArrayLike, count: int) -> FloatArray:
    """Magnitudes of the stars; an unknown one counts as that of the faintest star: it votes last."""
    mags = np.asarray(magnitude, float).reshape(-1)
    if len(mags) != count:
        raise CenterfindingError(f"{count} stars need as many magnitudes, got {len(mags)}.")
    known = mags[np.isfinite(mags)]
    return np.where(np.isfinite(mags), mags, np.max(known) if known.size else 0.0)


def _detected_brightness(detections: Detections, zero_point_mag: float | None) -> dict[str, Any]:
    mag = -2.5 * np.log10(np.maximum(detections.flux_dn, np.finfo(float).tiny))
    faintest = float(np.max(mag, initial=-np.inf))
    return {
        "detected_mag": mag,
        "sharper_than_star": (detections.flags & StarFlag.COSMIC_RAY) > 0,
        "saturated": (detections.flags & StarFlag.SATURATED) > 0,
        "limit_mag": -2.5 * float(np.log10(detections.limit_dn)) if detections.limit_dn > 0.0 else faintest,
        "zero_point_mag": np.nan if zero_point_mag is None else zero_point_mag,
    }
