"""Approach pictures: what a spacecraft in the active kernel set sees, with a pointing error that only the truth knows."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import open_catalog
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path, write_json
from opnav_workbench.geometry import quaternion_from_matrix, radec_from_unit, rotation_from_vector
from opnav_workbench.image import KeywordMap
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.picture import body_points, render_picture
from opnav_workbench.scene import (
    Observer,
    body_target,
    observer_from_kernels,
    predict_body,
    predict_stars,
)
from opnav_workbench.spice import camera_attitude, et_from_utc, sclk_from_et, state, utc_from_et

__all__ = ["PictureRequest", "Truth", "simulate_picture"]

SUN = 10


@dataclass(frozen=True, slots=True)
class PictureRequest:
    """A picture to simulate.

    Attributes
    ----------
    name : str
        File name stem.
    utc : str
        Mid-exposure.
    header : mapping
        Header values that identify mission and camera (such as ``SFORMAT``).
    exposure_s : float
    targets : tuple of str
    sigma_px : float
        Width of the true PSF.
    sky_dn : float
    seed : int
    """

    name: str
    utc: str
    header: Mapping[str, Any]
    exposure_s: float
    targets: tuple[str, ...]
    sigma_px: float
    sky_dn: float
    seed: int

    def reseeded(self, offset: int) -> "PictureRequest":
        """Return the request with its seed moved by `offset`."""
        return replace(self, seed=self.seed + offset)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the simulated picture really shows.

    Attributes
    ----------
    picture : Path
    camera_from_j2000 : (3, 3) array
    predicted_camera_from_j2000 : (3, 3) array
        What the header says.
    bodies : mapping of str to (2,) array
        True centers of figure, px.
    stars : int
        Stars on the detector.
    """

    picture: Path
    camera_from_j2000: FloatArray
    predicted_camera_from_j2000: FloatArray
    bodies: Mapping[str, FloatArray]
    stars: int


def simulate_picture(request: PictureRequest, mission: Mission, catalog: str, out: Path) -> Truth:
    """Simulate one picture with the active `KernelSet`; truth goes to a file of its own.

    The kernels' attitude is the predicted one and stands in the header; the true one differs by a random error of the
    camera's a priori size, drawn from the seed.

    Parameters
    ----------
    request : PictureRequest
    mission : Mission
    catalog : str
        Catalog spec of the true stars.
    out : Path
        Folder; gets ``NAME.fit`` and ``NAME.truth.json``.

    Raises
    ------
    KernelError, CameraError, CatalogError, MissionError
    """
    camera = mission.camera_for(request.header)
    et = et_from_utc(request.utc)
    observer = observer_from_kernels(mission.spacecraft_id, et)
    predicted = camera_attitude(camera.frame, et)
    actual = _misaligned(predicted, camera, request.seed)
    picture, bodies, stars = _picture(request, mission, camera, et, observer, actual, catalog)
    path = out / f"{request.name}.fit"
    cards = _header(request, mission, et, predicted)
    _write_fits(path, picture, cards, mission.keywords, camera)
    write_json(
        out / f"{request.name}.truth.json",
        {"picture": path.name, "camera_from_j2000": actual, "bodies": bodies, "stars_on_detector": stars},
    )
    return Truth(path, actual, predicted, bodies, stars)


def _misaligned(predicted: FloatArray, camera: Camera, seed: int) -> FloatArray:
    """Turn an attitude by a random error about the camera's pixel, line and boresight axes."""
    sigma = camera.attitude_sigma
    cross = sigma.cross_px * camera.pixel_scale_rad
    error = np.random.default_rng([seed, 0]).normal(0.0, [cross, cross, np.radians(sigma.twist_deg)])
    return rotation_from_vector(camera.focal_from_camera.T @ error) @ predicted


def _picture(
    request: PictureRequest,
    mission: Mission,
    camera: Camera,
    et: float,
    observer: Observer,
    attitude: FloatArray,
    catalog: str,
) -> tuple[FloatArray, dict[str, FloatArray], int]:
    ra, dec = (float(a) for a in radec_from_unit(attitude.T @ camera.boresight))
    table = open_catalog(catalog).cone(ra, dec, 1.1 * camera.half_diagonal_rad, et_s=et)
    stars = predict_stars(table, et, observer, camera, attitude, margin_px=10.0)
    centers: dict[str, FloatArray] = {}
    rendered = []
    for name in request.targets:
        target = mission.with_magnitude(body_target(name, mission.spacecraft_id, et))
        if target.magnitude is None:
            raise MissionError(f"{mission.path}: target_photometry has no {name}; give its absolute_mag.")
        centers[name] = predict_body(target, observer, camera, attitude).pixel_line
        places, shares = body_points(target, observer, camera, attitude)
        rendered.append((places, shares, target.magnitude))
    picture = render_picture(
        camera, stars, rendered, request.exposure_s, request.sigma_px, request.sky_dn, request.seed
    )
    return picture, centers, int(stars.on_detector.sum())


def _header(request: PictureRequest, mission: Mission, et: float, predicted: FloatArray) -> dict[str, Any]:
    """Header cards under the mission's own keywords, so that the flight reader takes the file for one of its own."""
    names = KeywordMap(**mission.keywords)
    sun = state(SUN, et, mission.spacecraft_id, correction="LT")
    quaternion = quaternion_from_matrix(
        predicted.T if names.quaternion_sense == "camera_to_j2000" else predicted
    )
    stamp = et - 0.5 * request.exposure_s if names.time_reference == "start" else et
    # The request's header holds what the mission requires, or no camera would have been found.
    cards: dict[str, Any] = {"RADESYS": "ICRS", "SIMULATE": True, **request.header}
    values = (
        (names.exposure_s, request.exposure_s / names.exposure_scale),
        (names.et, stamp),
        (names.utc, utc_from_et(stamp)),
        (names.sclk, sclk_from_et(mission.clock_id, et)),
    )
    cards |= {keyword: value for keyword, value in values if keyword is not None}
    for keywords, vector in (
        (names.quaternion, quaternion),
        (names.sun_position, sun.position_km),
        (names.sun_velocity, sun.velocity_km_s),
    ):
        if keywords is not None:
            cards |= zip(keywords, vector.tolist(), strict=True)
    return cards


def _write_fits(
    path: Path, picture: FloatArray, cards: Mapping[str, Any], names: Mapping[str, Any], camera: Camera
) -> None:
    """Write the picture with the mission's error and quality planes."""
    hdus = fits.HDUList([fits.PrimaryHDU(picture.astype(np.float32))])
    for key, value in cards.items():
        hdus[0].header[key] = value
    gain, read_noise = camera.require("gain_e_per_dn"), camera.require("read_noise_dn")
    error = np.sqrt(read_noise**2 + np.maximum(picture, 0.0) / gain)
    planes = (
        ("error_extension", error.astype(np.float32)),
        ("quality_extension", np.zeros(picture.shape, np.uint16)),
    )
    for field, plane in planes:
        if names.get(field) is not None:
            hdus.append(fits.ImageHDU(plane, name=str(names[field])))
    with atomic_path(path) as temporary:
        hdus.writeto(temporary, overwrite=True)
