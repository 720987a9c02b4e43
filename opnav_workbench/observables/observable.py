"""One body's observable: where it was seen, where it was predicted, how well, and what moves it.

Bodies of one picture share its pointing error, and centers found jointly have errors in common:
`joint_covariance_px2` is the covariance of several observables' O-C.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly, symmetric

__all__ = ["LIGHT_TIMES", "Observable", "cross_covariance_px2", "joint_covariance_px2"]


# ---- One body's observable: where it was seen, where it was predicted, how well, and what moves it.

LIGHT_TIMES = ("fixed", "solved")


def _nothing() -> Mapping[str, FloatArray]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class Observable:
    """What orbit determination takes of one body in one picture; arrays are read-only.

    Attributes
    ----------
    et
        Mid-exposure, TDB seconds past J2000.
    name, method, status
        Body, centerfinder and its verdict; ``ok`` only on a pointing from stars in a sure field.
    reference_body
        Body that the spacecraft's position in the partials refers to.
    a_priori_px, predicted_px : (2,) array
        Computed places with the a priori and with the solved pointing, center of figure.
    observed_px : (2,) array or None
    residual_px : (2,) array or None
        Observed minus predicted.
    covariance_px2 : (2, 2) array
        Of the observed center alone; nan without one.
    total_covariance_px2 : (2, 2) array
        The same with the pointing's share, that is of O-C.
    diameter_px
        Predicted.
    measured_diameter_px
        As the centerfinder measured it; nan where it does not.
    partials_px_per_km : (2, 3) array or None
        d(pixel, line) / d(spacecraft position relative to the reference body, J2000). The bodies are held fixed among
        each other, so for another body than the reference (Charon relative to Pluto) these are the partials of its
        own place.
    partials_px_per_rad : (2, 3) array or None
        d(pixel, line) / d(rotation of the attitude about the camera frame's axes).
    apparent_ra_deg, apparent_dec_deg
        Observed direction, J2000, through the solved attitude.
    ra_deg, dec_deg
        The same with stellar aberration removed: astrometric, as `position_km`.
    residual_arcsec : (2,) array or None
        Observed minus predicted direction: (RA cos dec, Dec), aberration removed from both.
    observer
        Spacecraft.
    light_time : {"fixed", "solved"}
        Whether the partials hold the light time fixed (as the paper) or solve it anew, see `partials`.
    position_km : (3,) array or None
        Predicted, J2000, astrometric: from the spacecraft at `et` to where the body was one light time before, without
        stellar aberration; what `ra_deg` and `dec_deg` are compared with.
    observer_velocity_km_s, target_velocity_km_s : (3,) array or None
        With respect to the solar-system barycenter, J2000, at mid-exposure and when the light left.
    target_partials_px_per_km, target_partials_px_per_km_s : (2, 3) array or None
        d(pixel, line) / d(position, velocity of the body at mid-exposure, J2000), spacecraft held fixed.
    attitude_covariance_rad2 : (3, 3) array or None
        Of the solved attitude, which all bodies of a picture share.
    sky_partials_px_per_rad : (2, 2) array or None
        d(pixel, line) / d(RA cos dec, Dec) at the observed place (predicted where none), aberration removed.
    residual_covariance_arcsec2 : (2, 2) array or None
        Of `residual_arcsec`, pointing included.
    diameter_sigma_px
        Of the measured diameter.
    diameter_partials_px_per_km : (3,) array or None
        d(diameter) / d(spacecraft position), for a sphere.
    range_km, measured_range_km, range_sigma_km
        Predicted; and from the body's size, where the method solved it (the body's radius taken as known) and its center
        is ``ok``; else nan.
    range_partials : (3,) array or None
        d(range) / d(spacecraft position), km/km.
    center_cross_px2 : mapping of str to (2, 2) array
        Covariance of this center (rows) with those of other bodies (columns) that were found jointly with it; pointing
        not included.
    """

    image: str
    utc: str
    et: float
    name: str
    method: str
    status: str
    reference_body: str
    a_priori_px: FloatArray
    predicted_px: FloatArray
    observed_px: FloatArray | None
    residual_px: FloatArray | None
    covariance_px2: FloatArray
    total_covariance_px2: FloatArray
    diameter_px: float
    measured_diameter_px: float
    partials_px_per_km: FloatArray | None
    partials_px_per_rad: FloatArray | None
    apparent_ra_deg: float
    apparent_dec_deg: float
    ra_deg: float
    dec_deg: float
    residual_arcsec: FloatArray | None
    snr: float
    messages: tuple[str, ...]
    observer: str = ""
    light_time: str = "fixed"
    position_km: FloatArray | None = None
    observer_velocity_km_s: FloatArray | None = None
    target_velocity_km_s: FloatArray | None = None
    target_partials_px_per_km: FloatArray | None = None
    target_partials_px_per_km_s: FloatArray | None = None
    attitude_covariance_rad2: FloatArray | None = None
    sky_partials_px_per_rad: FloatArray | None = None
    residual_covariance_arcsec2: FloatArray | None = None
    diameter_sigma_px: float = np.nan
    diameter_partials_px_per_km: FloatArray | None = None
    range_km: float = np.nan
    measured_range_km: float = np.nan
    range_sigma_km: float = np.nan
    range_partials: FloatArray | None = None
    center_cross_px2: Mapping[str, FloatArray] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        cross = {name: readonly(value, (2, 2), name) for name, value in self.center_cross_px2.items()}
        object.__setattr__(self, "center_cross_px2", MappingProxyType(cross))
        freeze_arrays(self)

    @property
    def has_direction(self) -> bool:
        """Whether it was measured, and on the sky: not so where the attitude is unknown."""
        return self.observed_px is not None and bool(np.isfinite(self.ra_deg))

    @property
    def has_residual(self) -> bool:
        """Whether its direction was measured and an ephemeris told it, so that it can correct one."""
        return self.has_direction and self.residual_px is not None


# ---- Covariance of several bodies' O-C: bodies of one picture share its pointing error.


def cross_covariance_px2(first: Observable, second: Observable) -> FloatArray:
    """Return the covariance (2, 2) px^2 of two observables' O-C, rows of the first; zero for different pictures.

    Both share the picture's attitude error, eps: O-C = center error - J eps, so that the covariance is J P J'; centers
    found jointly have a share of their own.

    Notes
    -----
    Two methods on the same body use the same pixels; how their centers are correlated nobody computes. The result then
    holds the pointing's share alone.
    """
    cross = np.zeros((2, 2))
    if first.image != second.image:
        return cross
    left, right = first.partials_px_per_rad, second.partials_px_per_rad
    if left is not None and right is not None and first.attitude_covariance_rad2 is not None:
        cross = cross + left @ first.attitude_covariance_rad2 @ right.T
    if first.method == second.method and second.name in first.center_cross_px2:
        cross = cross + first.center_cross_px2[second.name]
    return cross


def joint_covariance_px2(observables: Sequence[Observable]) -> FloatArray:
    """Return the covariance (2 n, 2 n) px^2 of n observables' O-C: pixel 0, line 0, pixel 1, ...

    Blocks on the diagonal are `Observable.total_covariance_px2`, the others `cross_covariance_px2`; nan for an observable
    without a center.

    Examples
    --------
    >>> joint_covariance_px2([]).shape
    (0, 0)
    """
    n = len(observables)
    blocks = np.zeros((n, 2, n, 2))
    for i, first in enumerate(observables):
        blocks[i, :, i] = first.total_covariance_px2
        for j in (j for j in range(i) if observables[j].image == first.image):
            blocks[i, :, j] = cross_covariance_px2(first, observables[j])
            blocks[j, :, i] = blocks[i, :, j].T
    return symmetric(blocks.reshape(2 * n, 2 * n))
