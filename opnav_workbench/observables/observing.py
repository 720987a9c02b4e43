"""From a measured center to an observable: residuals, covariances and partials.

`observe` compares a body's measured center with its place predicted by ephemeris and solved attitude, in pixels and, with
stellar aberration removed from both, on the sky. `center_cross` takes from centers found jointly the covariances of one
with the others.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies import BodyCenter, JointCenters
from opnav_workbench.camera import Camera
from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import (
    aberration_jacobian,
    apparent_direction,
    geometric_direction,
    radec_from_unit,
    tangent_basis,
)
from opnav_workbench.observables.observable import LIGHT_TIMES, Observable
from opnav_workbench.observables.partials import (
    numerical_position_partials,
    numerical_target_partials,
    seen_place_jacobian,
)
from opnav_workbench.targets import TargetState

__all__ = ["center_cross", "diameter_partials", "is_outside", "observe"]


# ---- From a measured center to an observable: residuals, covariances and partials.


@dataclass(frozen=True, slots=True, eq=False)
class _SeenBody:
    """A body seen through a camera: what every part of an observable is computed from."""

    target: TargetState
    camera: Camera
    camera_from_j2000: FloatArray
    velocity_km_s: FloatArray
    target_velocity_km_s: FloatArray | None  # where the light time is to be solved

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def apparent(self) -> FloatArray:
        return apparent_direction(self.target.direction, self.velocity_km_s)

    def partials(self, function: Any) -> FloatArray:
        """Call one of the functions of `partials`."""
        return np.asarray(
            function(
                self.target.position_km,
                self.velocity_km_s,
                self.camera,
                self.camera_from_j2000,
                target_velocity_km_s=self.target_velocity_km_s,
            )
        )


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
    observer: str = "",
    light_time: str = "fixed",
    center_cross_px2: Mapping[str, FloatArray] | None = None,
    pointing_doubt: str = "",
) -> Observable:
    """Turn a measured center into an observable.

    A center that is ``ok`` is an observable that is ``uncertain`` where the pointing is in doubt: in the picture it is
    measured, on the sky it stands no surer than the stars.

    Parameters
    ----------
    target
        The body as the spacecraft sees it, from ephemeris.
    center
        Where it was measured.
    camera_from_j2000 : (3, 3) array
        Solved attitude.
    attitude_covariance_rad2 : (3, 3) array
        As in `PointingSolution`.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter.
    a_priori_px : (2,) array
        Place predicted with the a priori attitude.
    diameter_px, image, et, utc, reference_body, observer
        Copied into the result.
    light_time : {"fixed", "solved"}
        What the partials do with the light time, see `partials`; "solved" needs `TargetState.velocity_km_s`, and stays
        "fixed" where that is not known.
    center_cross_px2 : mapping of str to (2, 2) array, optional
        See `center_cross`.
    pointing_doubt
        Why the pointing is not ok, in words.

    Raises
    ------
    PointingError
        An unknown `light_time`.
    """
    if light_time not in LIGHT_TIMES:
        raise PointingError(f"unknown light time {light_time!r}; choose one of {', '.join(LIGHT_TIMES)}.")
    solved = light_time == "solved" and target.velocity_km_s is not None
    velocity = np.asarray(observer_velocity_km_s, float)
    view = _SeenBody(target, camera, camera_from_j2000, velocity, target.velocity_km_s if solved else None)
    predicted = camera.project((camera_from_j2000 @ view.apparent)[None])[0]
    return Observable(
        image=image,
        utc=utc,
        et=et,
        reference_body=reference_body,
        observer=observer,
        light_time="solved" if solved else "fixed",
        a_priori_px=a_priori_px,
        predicted_px=predicted,
        residual_px=None if center.pixel_line is None else center.pixel_line - predicted,
        diameter_px=diameter_px,
        position_km=target.position_km,
        range_km=target.range_km,
        observer_velocity_km_s=velocity,
        target_velocity_km_s=target.velocity_km_s,
        attitude_covariance_rad2=attitude_covariance_rad2,
        center_cross_px2=center_cross_px2 or {},
        **_measured_values(center),
        **_judgement(center, pointing_doubt, outside=is_outside(camera, predicted, diameter_px)),
        **_measured_range(center),
        **_directions(view, center),
        **_derivatives(view, center, np.asarray(attitude_covariance_rad2, float), diameter_px, predicted),
    )


def diameter_partials(target: TargetState, diameter_px: float) -> FloatArray:
    """Return d(diameter)/d(spacecraft position), (3,) px/km, of a body much smaller than the field.

    The angular radius of a sphere is asin(R/d), its gnomonic picture R / sqrt(d^2 - R^2): coming nearer by dx widens it
    by the share d dx / (d^2 - R^2).
    """
    radius_km = 0.0 if target.radii_km is None else float(np.mean(target.radii_km))
    range_km = target.range_km
    return np.asarray(diameter_px * range_km / (range_km**2 - radius_km**2) * target.direction)


def _measured_values(center: BodyCenter) -> dict[str, Any]:
    return {
        "name": center.name,
        "method": center.method,
        "observed_px": center.pixel_line,
        "covariance_px2": center.covariance_px2,
        "measured_diameter_px": center.diameter_px,
        "diameter_sigma_px": center.diameter_sigma_px,
        "snr": center.snr,
    }


def is_outside(camera: Camera, predicted_px: FloatArray, diameter_px: float) -> bool:
    """Tell whether no part of a body is expected on the detector; nan: behind the camera, or a point."""
    return not camera.on_detector(predicted_px, 0.5 * float(np.nan_to_num(diameter_px)))


def _judgement(center: BodyCenter, pointing_doubt: str, *, outside: bool) -> dict[str, Any]:
    """Status and messages of the center, and what pointing and prediction make of them."""
    if center.status == "not_detected" and outside:  # it was searched beyond its ephemeris' error, in vain
        messages = (*center.messages, "no part of it is expected on the detector")
        return {"status": "off_detector", "messages": messages}
    if center.pixel_line is None or not pointing_doubt:
        return {"status": center.status, "messages": center.messages}
    status = "uncertain" if center.status == "ok" else center.status
    return {"status": status, "messages": (*center.messages, pointing_doubt)}


def _measured_range(center: BodyCenter) -> dict[str, Any]:
    """Range from the body's size; none where the size was not solved for, or the center itself is in doubt."""
    known = center.status == "ok" and 0.0 < center.range_sigma_km < np.inf
    return {
        "measured_range_km": center.range_km if known else np.nan,
        "range_sigma_km": center.range_sigma_km if known else np.nan,
    }


def _derivatives(
    view: _SeenBody,
    center: BodyCenter,
    attitude_covariance: FloatArray,
    diameter_px: float,
    predicted_px: FloatArray,
) -> dict[str, Any]:
    """Partials, and the covariances that go through them; none where nothing is predicted."""
    if not np.isfinite(predicted_px).all():
        names = ("px_per_km", "px_per_rad")
        return {f"partials_{n}": None for n in names} | {"total_covariance_px2": center.covariance_px2}
    by_attitude = view.camera.attitude_jacobian(view.camera_from_j2000 @ view.apparent)
    total = symmetric(center.covariance_px2 + by_attitude @ attitude_covariance @ by_attitude.T)
    by_target = view.partials(numerical_target_partials)
    by_sky = _sky_partials(view, center)
    to_sky = np.linalg.inv(by_sky) * ARCSEC_PER_RAD
    sized = np.isfinite(diameter_px) and view.target.radii_km is not None
    return {
        "partials_px_per_km": view.partials(numerical_position_partials),
        "partials_px_per_rad": by_attitude,
        "total_covariance_px2": total,
        "target_partials_px_per_km": by_target[:, :3],
        "target_partials_px_per_km_s": by_target[:, 3:],
        "sky_partials_px_per_rad": by_sky,
        "residual_covariance_arcsec2": None
        if center.pixel_line is None
        else symmetric(to_sky @ total @ to_sky.T),
        "diameter_partials_px_per_km": diameter_partials(view.target, diameter_px) if sized else None,
        "range_partials": -view.target.direction
        @ seen_place_jacobian(view.target.position_km, view.target_velocity_km_s),
    }


def _sky_partials(view: _SeenBody, center: BodyCenter) -> FloatArray:
    """d(pixel, line)/d(RA cos dec, Dec) where the body was seen; where it was predicted if it was not."""
    direction = view.target.direction
    if center.pixel_line is not None:
        direction = _observed_direction(view, center.pixel_line)
    apparent = apparent_direction(direction, view.velocity_km_s)
    tangent = np.stack(tangent_basis(*radec_from_unit(direction)), axis=-1)
    of_pixel = view.camera.project_jacobian((view.camera_from_j2000 @ apparent)[None])[0]
    by_apparent = of_pixel @ view.camera_from_j2000
    return np.asarray(by_apparent @ aberration_jacobian(direction, view.velocity_km_s) @ tangent)


def _observed_direction(view: _SeenBody, pixel_line: FloatArray) -> FloatArray:
    """Unit vector (3,) J2000 toward what was seen at a place, aberration removed."""
    apparent = view.camera.unproject(pixel_line[None])[0] @ view.camera_from_j2000
    return geometric_direction(apparent, view.velocity_km_s)


def _directions(view: _SeenBody, center: BodyCenter) -> dict[str, Any]:
    """Apparent RA and Dec, the same without aberration (deg), and O-C on the sky (arcsec)."""
    names = ("apparent_ra_deg", "apparent_dec_deg", "ra_deg", "dec_deg")
    if center.pixel_line is None:
        return dict.fromkeys(names, np.nan) | {"residual_arcsec": None}
    geometric = _observed_direction(view, center.pixel_line)
    apparent = apparent_direction(geometric, view.velocity_km_s)
    computed = view.target.direction
    tangent = np.stack(tangent_basis(*radec_from_unit(computed)))
    # Gnomonic about the computed direction: exact to the third order of an offset that is arcseconds small.
    residual = tangent @ geometric / float(computed @ geometric) * ARCSEC_PER_RAD
    angles = [float(np.degrees(a)) for d in (apparent, geometric) for a in radec_from_unit(d)]
    return dict(zip(names, angles, strict=True)) | {"residual_arcsec": residual}


# ---- Covariance of several bodies' O-C: bodies of one picture share its pointing error.


def center_cross(joint: JointCenters, name: str) -> Mapping[str, FloatArray]:
    """Return the covariances (2, 2) px^2 of one body's center (rows) with the others found jointly (columns).

    Raises
    ------
    CenterfindingError
        The body is not among them.
    """
    joint.center(name)
    names = [center.name for center in joint.centers]
    row = 2 * names.index(name)
    cross = np.asarray(joint.covariance_px2)[row : row + 2]
    return {
        other: cross[:, 2 * i : 2 * i + 2]
        for i, other in enumerate(names)
        if other != name and joint.centers[i].pixel_line is not None
    }
