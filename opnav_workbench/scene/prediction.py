"""Predicted places of stars and bodies on the detector.

Flow   catalog rows or body states -> apparent directions (J2000) -> camera frame -> (pixel, line)
Frame  J2000 until ``camera_from_j2000`` is applied; covariances of catalog places in px^2
Units  km, km/s, rad, px

A star's direction carries space motion, parallax at the spacecraft and stellar aberration; a body's carries light
time (in the state it comes with) and the same stellar aberration, so that both share one convention.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable, unknown_motion_mixture
from opnav_workbench.geometry import (
    angle_between,
    apparent_direction,
    limb_points,
    radec_from_unit,
    tangent_basis,
)
from opnav_workbench.photometry import instrument_magnitude
from opnav_workbench.scene.following import following
from opnav_workbench.scene.states import Observer
from opnav_workbench.targets import TargetState

__all__ = [
    "BodyPrediction",
    "StarPrediction",
    "apparent_stars",
    "camera_magnitudes",
    "predict_body",
    "predict_stars",
]

UNKNOWN_BAND_SIGMA_MAG = 0.5  # between the bands of catalogs and cameras lie some tenths of a magnitude
LIMB_POINTS = 180  # one point every 2 deg: the polygon's area is short of the ellipse's by 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class StarPrediction:
    """Predicted stars, in the order of the table they came from.

    Attributes
    ----------
    id : (n,) array of str
        Catalog designations.
    mag, mag_sigma : (n,) arrays
        Magnitudes in the camera's band and their 1 sigma, see `camera_magnitudes`.
    directions : (n, 3) array
        Apparent unit vectors, J2000.
    pixel_line : (n, 2) array
        Predicted centers, px.
    covariance_px2 : (n, 2, 2) array
        The catalog's share of the uncertainty, px^2; unknown motions with the variance of all that they may be.
    on_detector : (n,) array of bool
    motion_px2 : (n, 2, 2) array
        What of `covariance_px2` is unknown motion.
    motion_shares, motion_variances : (n, 3) arrays
        Parts of the mixture that unknown motions are: share of the stars, and variance as a multiple of the whole's.
    """

    id: NDArray[np.str_]
    mag: FloatArray
    mag_sigma: FloatArray
    directions: FloatArray
    pixel_line: FloatArray
    covariance_px2: FloatArray
    on_detector: BoolArray
    motion_px2: FloatArray
    motion_shares: FloatArray
    motion_variances: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.mag)

    def take(self, rows: NDArray[Any]) -> "StarPrediction":
        """Return some of the stars, by index or mask."""
        return StarPrediction(*(getattr(self, field.name)[rows] for field in fields(self)))

    def predicted_with(self, camera: Camera, camera_from_j2000: FloatArray) -> "StarPrediction":
        """Return the same stars at the places that another attitude predicts, px (nan out of the camera's sight)."""
        places = self.places(camera, camera_from_j2000)
        return replace(self, pixel_line=places, on_detector=camera.on_detector(places))

    def places(self, camera: Camera, camera_from_j2000: FloatArray) -> FloatArray:
        """Return where the stars fall (n, 2), px, with another attitude than the one they were predicted with."""
        return camera.standing(camera_from_j2000).project(self.directions @ camera_from_j2000.T)


@dataclass(frozen=True, slots=True, eq=False)
class BodyPrediction:
    """A body's predicted place, size and limb.

    Attributes
    ----------
    pixel_line : (2,) array
        Projected center of figure, px (nan behind the camera).
    direction : (3,) array
        Apparent unit vector of the center, J2000.
    diameter_px
        Diameter of the circle with the area of the projected limb; 0 for a star, nan without radii.
    phase_rad
        Sun - body - spacecraft angle; nan where no Sun direction is known.
    limb_px : (k, 2) array
        The projected limb (k = 0 for a star or a body without radii).
    """

    name: str
    pixel_line: FloatArray
    direction: FloatArray
    range_km: float
    diameter_px: float
    phase_rad: float
    limb_px: FloatArray
    on_detector: bool

    def __post_init__(self) -> None:
        freeze_arrays(self)


def apparent_stars(stars: StarTable, et: float, observer: Observer) -> FloatArray:
    """Apparent J2000 unit vectors (n, 3) of catalog stars as the observer sees them at `et`."""
    return apparent_direction(stars.directions(et, observer.position_km), observer.velocity_km_s)


def camera_magnitudes(stars: StarTable, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Magnitudes (n,) of catalog stars in the camera's band, and their 1 sigma (n,).

    From V and B-V where the catalog has them or they follow from its bands; a star without a V keeps its catalog
    magnitude, with `UNKNOWN_BAND_SIGMA_MAG`.
    """
    mag, sigma = instrument_magnitude(stars.v_mag, stars.v_sigma, stars.b_v, stars.b_v_sigma, camera.color)
    unknown = np.isnan(mag)
    return np.where(unknown, stars.mag, mag), np.where(unknown, UNKNOWN_BAND_SIGMA_MAG, sigma)


def predict_stars(
    stars: StarTable,
    et: float,
    observer: Observer,
    camera: Camera,
    camera_from_j2000: FloatArray,
    margin_px: float = 0.0,
) -> StarPrediction:
    """Predict the places of catalog stars, keeping those within `margin_px` of the detector.

    Parameters
    ----------
    stars
        n catalog rows.
    et
        TDB seconds past J2000.
    observer
        Barycentric state of the spacecraft.
    camera_from_j2000 : (3, 3) array
    margin_px
        Stars up to this far outside the detector are kept (with ``on_detector`` False).
    """
    camera = camera.standing(camera_from_j2000)
    directions = apparent_stars(stars, et, observer)
    in_camera = directions @ camera_from_j2000.T
    pixel_line = camera.project(in_camera)
    keep = camera.on_detector(pixel_line, margin_px)
    chosen = stars.take(keep)
    mag, mag_sigma = camera_magnitudes(chosen, camera)
    jacobian = _pixels_of_sky(directions[keep], camera, camera_from_j2000)
    sky, motion, shares, variances = _catalog_covariance(chosen, et, observer)
    return StarPrediction(
        id=np.asarray(chosen.id),
        mag=mag,
        mag_sigma=mag_sigma,
        directions=directions[keep],
        pixel_line=pixel_line[keep],
        covariance_px2=jacobian @ sky @ np.swapaxes(jacobian, -1, -2),
        on_detector=camera.on_detector(pixel_line[keep]),
        motion_px2=jacobian @ motion @ np.swapaxes(jacobian, -1, -2),
        motion_shares=shares,
        motion_variances=variances,
    )


def _pixels_of_sky(directions: FloatArray, camera: Camera, camera_from_j2000: FloatArray) -> FloatArray:
    """d(pixel, line) / d(east, north), (n, 2, 2), px/rad."""
    tangent = np.stack(tangent_basis(*radec_from_unit(directions)), axis=-1)
    jacobian: FloatArray = camera.project_jacobian(directions @ camera_from_j2000.T)
    return jacobian @ camera_from_j2000 @ tangent


def _catalog_covariance(
    stars: StarTable, et: float, observer: Observer
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Covariances (n, 2, 2) rad^2 of the places, what of them is unknown motion, and the parts of that (n, 3) each."""
    shares, sigmas = unknown_motion_mixture(stars.ra_rad, stars.dec_rad, stars.mag)
    whole = np.sum(shares * sigmas**2, axis=1)
    unknown = ~stars.motion_known
    sigma = np.array(stars.sigma)
    sigma[unknown, 3:] = 0.0
    rest = replace(stars, sigma=sigma).sky_covariance(et, observer.position_km)
    sigma[unknown, 3:] = np.sqrt(whole[unknown, None])
    total = replace(stars, sigma=sigma).sky_covariance(et, observer.position_km)
    return total, total - rest, shares, sigmas**2 / whole[:, None]


def predict_body(
    target: TargetState, observer: Observer, camera: Camera, camera_from_j2000: FloatArray
) -> BodyPrediction:
    """Predict a body's center, size, phase and limb on the detector."""
    camera = following(camera, target, observer.velocity_km_s, camera_from_j2000)
    range_km = float(np.linalg.norm(target.position_km))
    direction = apparent_direction(target.position_km / range_km, observer.velocity_km_s)
    pixel_line = camera.project((camera_from_j2000 @ direction)[None])[0]
    limb = _limb_px(target, observer, camera, camera_from_j2000)
    return BodyPrediction(
        name=target.name,
        pixel_line=pixel_line,
        direction=direction,
        range_km=range_km,
        diameter_px=_diameter(target, limb),
        phase_rad=_phase(target),
        limb_px=limb,
        on_detector=bool(camera.on_detector(pixel_line[None])[0]),
    )


def _limb_px(
    target: TargetState, observer: Observer, camera: Camera, camera_from_j2000: FloatArray
) -> FloatArray:
    if target.radii_km is None or not np.all(np.asarray(target.radii_km) > 0.0):
        return np.empty((0, 2))
    body_from_j2000 = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
    # The limb is geometric; aberration then moves each of its points as it moves the stars.
    points = limb_points(target.position_km, target.radii_km, body_from_j2000.T, LIMB_POINTS)
    apparent = apparent_direction(points, observer.velocity_km_s)
    return camera.project(apparent @ camera_from_j2000.T)


def _diameter(target: TargetState, limb_px: FloatArray) -> float:
    if len(limb_px) == 0:
        return 0.0 if target.is_star else float("nan")
    x, y = (limb_px - limb_px[0]).T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return float(2.0 * np.sqrt(area / np.pi))


def _phase(target: TargetState) -> float:
    if target.sun_position_km is None:
        return float("nan")
    return float(angle_between(np.asarray(target.sun_position_km), -np.asarray(target.position_km)))
