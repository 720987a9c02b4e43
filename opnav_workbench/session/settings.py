"""What a session may be told to do differently; every threshold with its unit and reason."""

from dataclasses import asdict, dataclass, fields
from typing import Any

from opnav_workbench.errors import SessionError

__all__ = ["Settings"]


@dataclass(frozen=True, slots=True)
class Settings:
    """Thresholds of a session.

    Attributes
    ----------
    max_shift_px
        How far the a priori pointing may be off; the paper speaks of "more than 40 pixels".
    max_twist_deg
        How far the a priori twist may be off; 0.2 deg was measured on LORRI frames.
    wider_shift_px, wider_twist_deg
        How far a second search goes where the field is not identified for sure within these limits; 0 px: no such search.
    widest_shift_px, widest_twist_deg
        The same for a last search; 180 deg is any twist.
    search_radius_px
        How far from its expected place a star is searched once the field is identified.
    refined_radius_px
        The same once the pointing is solved: the expected place is then known to a fraction of a pixel.
    min_snr
        A star below this signal-to-noise ratio counts as not detected: noise alone exceeds 5 sigma within the
        search area once in about 1e5 stars.
    max_magnitude_error
        A detection this much (mag) off the frame's own zero point is not the catalog star: colours of late-type stars
        reach 2.5 mag between V and a broad red band.
    blend_radius_px
        Two catalog stars nearer than this are not separate pictures of stars where centers are of correlations; least
        squares fits neighbors together and separates them from 1.5 sigma of the PSF on.
    blend_magnitude
        ... unless the fainter is this much (mag) fainter, when it moves the center by less than 3 % of their distance.
    max_stars
        At most so many stars, the brightest, are used.
    mag_limit
        Faintest catalog magnitude asked for.
    focal_scale
        By what the focal length of the camera file is multiplied.
    carry_within_s
        A picture whose stars do not tell its pointing takes it from pictures of the same call that were taken within so
        many seconds; 0: never.
    carry_jitter_px, carry_walk_px, carry_drift_px_s
        How the error of the a priori attitude may change between such pictures, 1 sigma about each axis: of every picture
        its own (px), random walk (px per square root of a second), constant rate (px/s). A pixel is what moves the sky
        across the boresight by one; use what your attitude system's error budget says.
    lost_detections
        Where the field is not identified for sure around its a priori place, the whole sky is searched if so many
        detections may be stars; 0: never.
    """

    max_shift_px: float = 60.0
    max_twist_deg: float = 0.5
    wider_shift_px: float = 200.0
    wider_twist_deg: float = 2.0
    widest_shift_px: float = 1000.0
    widest_twist_deg: float = 180.0
    search_radius_px: float = 4.0
    refined_radius_px: float = 2.5
    min_snr: float = 5.0
    max_magnitude_error: float = 2.5
    blend_radius_px: float = 4.0
    blend_magnitude: float = 4.0
    max_stars: int = 300
    mag_limit: float = 30.0
    focal_scale: float = 1.0
    lost_detections: int = 8
    carry_within_s: float = 0.0
    carry_jitter_px: float = 0.5
    carry_walk_px: float = 0.05
    carry_drift_px_s: float = 0.0

    @property
    def wide_searches(self) -> tuple[tuple[float, float], ...]:
        """Limits (px, deg) of the searches beyond the first, nearest first."""
        both = (self.wider_shift_px, self.wider_twist_deg), (self.widest_shift_px, self.widest_twist_deg)
        return tuple(limits for limits in both if limits[0] > 0.0)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Settings":
        """Build settings from a mapping.

        Raises
        ------
        SessionError
            A name is not a setting (all settings are listed).
        """
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise SessionError(
                f"unknown setting {', '.join(unknown)}; settings are {', '.join(sorted(known))}."
            )
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values."""
        return asdict(self)
