"""Image support data that lie beside a picture: its attitude, where spacecraft and Sun were, and the body in it.

ALE's users keep them as ``PICTURE.json`` beside ``PICTURE.cub``. They stand in for what the picture's own header does not
tell, and for the kernels of the one body that they are about; what kernels tell comes first.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.camera.support_data import SupportData, read_support_data
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import CameraError, OpNavError, SessionError
from opnav_workbench.files import read_json
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.image import HeaderGeometry, Picture, unknown_velocity_sigma_km_s
from opnav_workbench.image.formats.sidecar import find_sidecar, holds_support_data
from opnav_workbench.targets import TargetState

__all__ = ["ToldBeside", "body_beside", "told_beside"]

GRID = 9  # points along each edge of a picture, by which two descriptions of its camera are compared
SAME_CAMERA_PX = 1.0  # more than two descriptions of one camera differ by: a focal length of a filter, a distortion left out
# ALE has the rate of the Sun's apparent place for its velocity, in which the target's acceleration counts times the light
# time to the Sun: 0.001 km/s of Ceres, 1.9 of Io, 3.3 of Enceladus (as its slice's kernels show), 5.3 of Mimas.
MOON_VELOCITY_SIGMA_KM_S = 3.0
SAME_TIME_S = 1.0  # as far as labels and clocks differ, too


@dataclass(frozen=True, slots=True)
class ToldBeside:
    """What image support data beside a picture tell, and the file's name."""

    name: str
    data: SupportData


def told_beside(picture: Picture, camera: Camera) -> tuple[Picture, ToldBeside | None]:
    """Return the picture with the geometry that image support data beside it tell, where its header tells none.

    Messages say what is taken from them, and contradictions that they are of another picture or camera; what describes no
    frame camera is told and not used. Other files of the picture's name are left alone.
    """
    path = find_sidecar(picture.path)
    if path is None or not _has_support_data(path):
        return picture, None
    try:
        told = ToldBeside(path.name, read_support_data(path))
        attitude, off_px = _attitude(told.data, camera)
    except OpNavError as error:
        said = f"{error} It is not used."
        return replace(picture, messages=(*picture.messages, said)), None
    wrong = _of_another(told, picture, off_px)
    if wrong:
        return replace(
            picture, messages=(*picture.messages, *wrong), contradictions=(*picture.contradictions, *wrong)
        ), None
    geometry, taken = _completed(picture.header_geometry, told, attitude)
    if not taken:
        return picture, told
    said = f"{' and '.join(taken)} by {told.name}, image support data"
    return replace(picture, header_geometry=geometry, messages=(*picture.messages, said)), told


def _has_support_data(path: Path) -> bool:
    try:
        return path.suffix.lower() == ".json" and holds_support_data(read_json(path, ""))
    except SessionError:  # no JSON of whatever kind
        return False


def _attitude(told: SupportData, camera: Camera) -> tuple[FloatArray, float]:
    """Return ``camera_from_j2000`` for our camera, and how far it then sees another sky, px.

    Support data have axes of their own (Z to the sky); what both descriptions share are the pixels.
    """
    axes = (np.linspace(0.0, size - 1.0, GRID) for size in (camera.n_pixel, camera.n_line))
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    ours, sky = camera.unproject(points), told.camera.unproject(points) @ told.camera_from_j2000
    known = np.isfinite(ours).all(axis=1) & np.isfinite(sky).all(axis=1)
    if np.count_nonzero(known) < GRID:
        raise CameraError(f"image support data and {camera.name} share no part of the picture.")
    turn, _ = Rotation.align_vectors(ours[known], sky[known])
    attitude = turn.as_matrix()
    off = camera.project(sky[known] @ attitude.T) - points[known]
    return np.asarray(attitude), float(np.nan_to_num(np.abs(off), nan=np.inf).max())


def _of_another(told: ToldBeside, picture: Picture, off_px: float) -> tuple[str, ...]:
    said = []
    if picture.et is not None and abs(told.data.et - picture.et) > SAME_TIME_S + float(
        np.nan_to_num(picture.exposure_s)
    ):
        said.append(f"{told.name} is of another time, {told.data.et - picture.et:+.3f} s; it is not used")
    if off_px > SAME_CAMERA_PX:
        said.append(f"{told.name} describes another camera, {off_px:.1f} px apart; it is not used")
    return tuple(said)


def _completed(
    header: HeaderGeometry | None, told: ToldBeside, attitude: FloatArray
) -> tuple[HeaderGeometry | None, list[str]]:
    """Return what a header tells with what support data add, and what that is."""
    known = header or HeaderGeometry(None, None, None, "")
    data, taken = told.data, []
    if known.camera_from_j2000 is None:
        known, taken = replace(known, camera_from_j2000=attitude), ["attitude"]
    if (
        known.spacecraft_from_sun_km is None
        and data.position_km is not None
        and data.sun_position_km is not None
    ):
        away_km = float(np.linalg.norm(data.position_km - data.sun_position_km))
        velocity_km_s, sigma_km_s = _velocity(data, away_km)
        place = _from_sun(data, velocity_km_s)
        known = replace(
            known,
            spacecraft_from_sun_km=place,
            spacecraft_velocity_km_s=velocity_km_s,
            velocity_sigma_km_s=sigma_km_s,
        )
        taken = [*taken, "the spacecraft's state"]
    return (known if taken else header), taken


def _velocity(data: SupportData, from_sun_km: float) -> tuple[FloatArray, float]:
    """Return the spacecraft's velocity from the Sun, and its sigma on each axis."""
    if data.velocity_km_s is None or data.sun_velocity_km_s is None:
        return np.zeros(3), unknown_velocity_sigma_km_s(from_sun_km)
    known = data.target_id is not None and not _is_moon(data.target_id)
    return data.velocity_km_s - data.sun_velocity_km_s, 0.0 if known else MOON_VELOCITY_SIGMA_KM_S


def _is_moon(naif_id: int) -> bool:
    """Tell by NAIF's numbers: 301 and 65035 are moons, 399 is a planet, 2000001 a small body."""
    return (100 < naif_id < 1000 and naif_id % 100 != 99) or 10_000 <= naif_id < 100_000


def _from_sun(data: SupportData, craft_velocity_km_s: FloatArray) -> FloatArray:
    """Return the spacecraft's place from the Sun at the time of the picture, but for the Sun's way while its light came."""
    away = _from_body(data, craft_velocity_km_s)
    moved = _light_s(away) * _body_velocity(
        data, craft_velocity_km_s
    )  # since the light left that the camera saw
    return away - moved - _sun_from_body(data, craft_velocity_km_s)


def _from_body(data: SupportData, craft_velocity_km_s: FloatArray) -> FloatArray:
    """Return the spacecraft's place at the time of the picture, km from where the body was one light time before."""
    told, places = np.asarray(data.position_km), data.places
    body_velocity = _body_velocity(data, craft_velocity_km_s)
    seconds = _light_s(told)
    delay = _delay_s(data)
    if places.craft_observes:
        seen = -_unaberrated(-told, craft_velocity_km_s) if places.aberration else told
        return seen + (seconds - delay) * body_velocity
    seen = _unaberrated(told, body_velocity) if places.aberration else told
    return seen + delay * craft_velocity_km_s + seconds * body_velocity


def _delay_s(data: SupportData) -> float:
    """How long before the picture the one stood, in the data's convention, that the other observes."""
    if not data.places.light_time:
        return 0.0
    radius_km = 0.0 if data.radii_km is None or not data.places.to_surface else float(np.mean(data.radii_km))
    return _light_s(np.asarray(data.position_km)) - radius_km / SPEED_OF_LIGHT_KM_S


def _sun_from_body(data: SupportData, craft_velocity_km_s: FloatArray) -> FloatArray:
    """Return the Sun's place from the body: the body observes it, whatever the spacecraft's place is corrected for."""
    return _unaberrated(np.asarray(data.sun_position_km), _body_velocity(data, craft_velocity_km_s))


def _unaberrated(apparent_km: FloatArray, observer_velocity_km_s: FloatArray) -> FloatArray:
    range_km = float(np.linalg.norm(apparent_km))
    return range_km * geometric_direction(apparent_km / range_km, observer_velocity_km_s)


def _body_velocity(data: SupportData, craft_velocity_km_s: FloatArray) -> FloatArray:
    return craft_velocity_km_s - (np.zeros(3) if data.velocity_km_s is None else data.velocity_km_s)


def _light_s(place_km: FloatArray) -> float:
    return float(np.linalg.norm(place_km)) / SPEED_OF_LIGHT_KM_S


def body_beside(
    told: ToldBeside, name: str, observer_velocity_km_s: FloatArray, velocity_sigma_km_s: float = 0.0
) -> TargetState | None:
    """Return the body that support data are about, as the spacecraft sees it; None where they do not tell its place.

    Light time and aberration are taken back as the data's own words say they were applied (`PlaceConvention`). Where the
    body observed, or nobody, velocities from the Sun are in its range, and the error of these in its covariance; its
    direction as the camera sees it depends on none.

    Parameters
    ----------
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter.
    velocity_sigma_km_s
        Of each axis of it.
    """
    data = told.data
    if data.position_km is None:
        return None
    away, radii = _from_body(data, observer_velocity_km_s), data.radii_km
    seconds, delay = _light_s(np.asarray(data.position_km)), _delay_s(data)
    along_s = seconds - delay if data.places.craft_observes else seconds + delay
    across_s = 0.0 if data.places.aberration else delay
    sight = np.outer(away, away) / float(away @ away)
    shares = along_s**2 * sight + across_s**2 * (np.eye(3) - sight)
    return TargetState(
        name,
        -away,
        radii_km=None if radii is None else np.array([radii[0], radii[0], radii[1]]),
        body_from_j2000=data.body_from_j2000,
        sun_position_km=None
        if data.sun_position_km is None
        else _sun_from_body(data, observer_velocity_km_s),
        covariance_km2=velocity_sigma_km_s**2 * shares if velocity_sigma_km_s > 0.0 else None,
    )
