"""One body's observable: where it was seen, where it was predicted, how well, and what moves it."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies import TargetState
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import (
    apparent_direction,
    geometric_direction,
    radec_from_unit,
    tangent_basis,
)
from opnav_workbench.observables.partials import attitude_partials, numerical_position_partials

__all__ = ["Observable", "observe"]

ARCSEC_PER_RAD = 206264.80624709636


@dataclass(frozen=True, slots=True, eq=False)
class Observable:
    """What orbit determination takes of one body in one picture; arrays are read-only.

    Attributes
    ----------
    image, utc : str
    et : float
        Mid-exposure, TDB seconds past J2000.
    name, method, status : str
        Body, centerfinder and its verdict.
    reference_body : str
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
    diameter_px : float
        Predicted.
    measured_diameter_px : float
        As the centerfinder measured it; nan where it does not.
    partials_px_per_km : (2, 3) array or None
        d(pixel, line) / d(spacecraft position relative to the reference body, J2000).
    partials_px_per_rad : (2, 3) array or None
        d(pixel, line) / d(rotation of the attitude about the camera frame's axes).
    apparent_ra_deg, apparent_dec_deg : float
        Observed direction, J2000, through the solved attitude.
    ra_deg, dec_deg : float
        The same with stellar aberration removed.
    residual_arcsec : (2,) array or None
        Observed minus predicted direction: (RA cos dec, Dec), aberration removed from both.
    snr : float
    messages : tuple of str
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

    def __post_init__(self) -> None:
        freeze_arrays(self)


def observe(
    target: TargetState,
    center: BodyCenter,
    camera: Camera,
    camera_from_j2000: FloatArray,
    attitude_covariance_rad2: FloatArray,
    *,
    observer_velocity_km_s: FloatArray,
    a_priori_px: FloatArray,
    diameter_px: float,
    image: str,
    et: float,
    utc: str,
    reference_body: str,
) -> Observable:
    """Turn a measured center into an observable.

    Parameters
    ----------
    target : TargetState
        The body as the spacecraft sees it, from ephemeris.
    center : BodyCenter
        Where it was measured.
    camera : Camera
    camera_from_j2000 : (3, 3) array
        Solved attitude.
    attitude_covariance_rad2 : (3, 3) array
        As in `PointingSolution`.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter.
    a_priori_px : (2,) array
        Place predicted with the a priori attitude.
    diameter_px, image, et, utc, reference_body
        Copied into the result.
    """
    apparent = apparent_direction(target.direction, observer_velocity_km_s)
    predicted = camera.project((camera_from_j2000 @ apparent)[None])[0]
    seen = bool(np.isfinite(predicted).all())
    by_attitude = attitude_partials(apparent, camera, camera_from_j2000) if seen else None
    by_position = (
        numerical_position_partials(target.position_km, observer_velocity_km_s, camera, camera_from_j2000)
        if seen
        else None
    )
    total = center.covariance_px2
    if by_attitude is not None:
        total = symmetric(total + by_attitude @ attitude_covariance_rad2 @ by_attitude.T)
    directions = _directions(center, target, camera, camera_from_j2000, observer_velocity_km_s)
    return Observable(
        image=image,
        utc=utc,
        et=et,
        name=center.name,
        method=center.method,
        status=center.status,
        reference_body=reference_body,
        a_priori_px=a_priori_px,
        predicted_px=predicted,
        observed_px=center.pixel_line,
        residual_px=None if center.pixel_line is None else center.pixel_line - predicted,
        covariance_px2=center.covariance_px2,
        total_covariance_px2=total,
        diameter_px=diameter_px,
        measured_diameter_px=center.diameter_px,
        partials_px_per_km=by_position,
        partials_px_per_rad=by_attitude,
        apparent_ra_deg=directions[0],
        apparent_dec_deg=directions[1],
        ra_deg=directions[2],
        dec_deg=directions[3],
        residual_arcsec=directions[4],
        snr=center.snr,
        messages=center.messages,
    )


def _directions(
    center: BodyCenter,
    target: TargetState,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
) -> tuple[float, float, float, float, FloatArray | None]:
    """Apparent RA and Dec, the same without aberration (deg), and O-C on the sky (arcsec)."""
    if center.pixel_line is None:
        return np.nan, np.nan, np.nan, np.nan, None
    apparent = camera.unproject(center.pixel_line[None])[0] @ camera_from_j2000
    geometric = geometric_direction(apparent, velocity_km_s)
    computed = target.direction
    tangent = np.stack(tangent_basis(*radec_from_unit(computed)))
    # Gnomonic about the computed direction: exact to the third order of an offset that is arcseconds small.
    residual = tangent @ geometric / float(computed @ geometric) * ARCSEC_PER_RAD
    apparent_ra, apparent_dec = (float(np.degrees(a)) for a in radec_from_unit(apparent))
    ra, dec = (float(np.degrees(a)) for a in radec_from_unit(geometric))
    return apparent_ra, apparent_dec, ra, dec, residual
