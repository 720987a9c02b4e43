"""What a centerfinder says of a body; arrays are read-only."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError

__all__ = ["BODY_STATUSES", "BodyCenter"]

BODY_STATUSES = ("ok", "uncertain", "not_detected", "off_detector", "saturated", "failed")


@dataclass(frozen=True, slots=True, eq=False)
class BodyCenter:
    """A body's center of figure, measured with one method.

    Attributes
    ----------
    name, method : str
    status : str
        One of `BODY_STATUSES`.
    pixel_line : (2,) array or None
        Center of figure (pixel, line); None where nothing was measured.
    covariance_px2 : (2, 2) array
        Of the center alone, pointing not included; nan without a center.
    flux_dn, snr : float
        Total flux and its signal-to-noise ratio; nan without a center.
    diameter_px : float
        Measured diameter; nan where the method gives none.
    messages : tuple of str
        What the analyst must know, and why a status is not ``ok``.
    """

    name: str
    method: str
    status: str
    pixel_line: FloatArray | None
    covariance_px2: FloatArray
    flux_dn: float = np.nan
    snr: float = np.nan
    diameter_px: float = np.nan
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.status not in BODY_STATUSES:
            raise CenterfindingError(
                f"unknown status {self.status!r}; it is one of {', '.join(BODY_STATUSES)}."
            )
        freeze_arrays(self)

    @classmethod
    def without_center(cls, name: str, method: str, status: str, *messages: str) -> "BodyCenter":
        """Return the answer of a method that found no center."""
        return cls(name, method, status, None, np.full((2, 2), np.nan), messages=messages)
