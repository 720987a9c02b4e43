"""What a centerfinder says of a body; arrays are read-only."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError

__all__ = ["BODY_STATUSES", "BodyCenter", "BodyPictures", "JointCenters"]

BODY_STATUSES = ("ok", "uncertain", "not_detected", "off_detector", "saturated", "failed")


@dataclass(frozen=True, slots=True, eq=False)
class BodyPictures:
    """The sub-array that a center was found in: data, model at the solution, and their difference.

    Attributes
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines on the detector.
    data_dn, model_dn, difference_dn : (n_line, n_pixel) arrays
        Background removed from the data; difference is data minus model.
    mask : (n_line, n_pixel) array of bool
        True where a pixel was used.
    """

    window: tuple[int, int, int, int]
    data_dn: FloatArray
    model_dn: FloatArray
    difference_dn: FloatArray
    mask: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


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
        Of the center alone, pointing not included: noise, and what the residuals say beyond it; nan without a
        center.
    flux_dn, snr : float
        Total flux and its signal-to-noise ratio; nan without a center.
    diameter_px : float
        Measured diameter; nan where the method gives none.
    messages : tuple of str
        What the analyst must know, and why a status is not ``ok``.
    flags : int
        Sum of `BodyFlag`.
    noise_covariance_px2 : (2, 2) array or None
        From the noise of the pixels alone.
    chi2_reduced : float
        Weighted square of the residuals per degree of freedom.
    diameter_sigma_px : float
    brightness_scale, brightness_scale_sigma : float
        Data over model.
    background_dn, background_sigma_dn : float
        What was left under the body.
    range_km, range_sigma_km : float
        Where the size was solved for.
    pictures : BodyPictures or None
    detail : object or None
        The method's own arrays.
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
    flags: int = 0
    noise_covariance_px2: FloatArray | None = None
    chi2_reduced: float = np.nan
    diameter_sigma_px: float = np.nan
    brightness_scale: float = np.nan
    brightness_scale_sigma: float = np.nan
    background_dn: float = np.nan
    background_sigma_dn: float = np.nan
    range_km: float = np.nan
    range_sigma_km: float = np.nan
    pictures: BodyPictures | None = None
    detail: object | None = None

    def __post_init__(self) -> None:
        if self.status not in BODY_STATUSES:
            raise CenterfindingError(
                f"unknown status {self.status!r}; it is one of {', '.join(BODY_STATUSES)}."
            )
        freeze_arrays(self)

    @classmethod
    def without_center(
        cls, name: str, method: str, status: str, *messages: str, flags: int = 0
    ) -> "BodyCenter":
        """Return the answer of a method that found no center."""
        return cls(name, method, status, None, np.full((2, 2), np.nan), messages=messages, flags=flags)


@dataclass(frozen=True, slots=True, eq=False)
class JointCenters:
    """Centers of several bodies found together, and how they are correlated.

    Attributes
    ----------
    centers : tuple of BodyCenter
    covariance_px2 : (2 n, 2 n) array
        In the order of the centers: pixel 0, line 0, pixel 1, ...; nan for a body without a center.
    """

    centers: tuple[BodyCenter, ...]
    covariance_px2: FloatArray

    def __post_init__(self) -> None:
        n = 2 * len(self.centers)
        if np.shape(self.covariance_px2) != (n, n):
            raise CenterfindingError(
                f"joint covariance of {len(self.centers)} centers has shape {np.shape(self.covariance_px2)}, "
                f"expected ({n}, {n})."
            )
        freeze_arrays(self)

    def center(self, name: str) -> BodyCenter:
        """Return the center of one body.

        Raises
        ------
        CenterfindingError
            No such body among them.
        """
        for center in self.centers:
            if center.name == name:
                return center
        raise CenterfindingError(
            f"no center of {name!r} among {', '.join(c.name for c in self.centers) or 'none'}."
        )

    @property
    def correlation(self) -> FloatArray:
        """Correlation coefficients (2 n, 2 n)."""
        sigma = np.sqrt(np.diag(self.covariance_px2))
        return np.asarray(self.covariance_px2 / np.outer(sigma, sigma))
