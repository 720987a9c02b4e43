"""Community Sensor Model image support data: camera, attitude and states of one picture in a JSON file.

ALE makes these files for ISIS' users; mapping programs take pointing from them. `read_support_data` reads one, and
`support_data` says one for a picture whose attitude is known.

Lines and samples there count 0.5 at the first pixel's center, focal planes have mm, quaternions are SPICE's (J2000 to
frame), positions are km in J2000 and count from the target: the spacecraft's, and the Sun's. `PlaceConvention` says how they
are corrected for light time and aberration, which `opnav_workbench.session.beside` takes back.

Source: DOI-USGS/ale (CC0), ``formatters/formatter.py``, ``base/data_naif.py``; DOI-USGS/usgscsm, ``Distortion.cpp``;
DOI-USGS/ISIS3, ``SpacecraftPosition.cpp``.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.camera.distortion import BrownDistortion, Distortion, NoDistortion
from opnav_workbench.camera.instrument_kernel import SHORTEST_FOCAL_MM, nearest_axes
from opnav_workbench.camera.lens_models import RadialDistortion, TaylorDistortion, centered
from opnav_workbench.camera.model import Camera
from opnav_workbench.errors import CameraError, OpNavError
from opnav_workbench.files import read_json
from opnav_workbench.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    from scipy.spatial import transform
else:
    transform = module_on_demand("scipy.spatial.transform")

__all__ = ["PlaceConvention", "SupportData", "read_support_data", "support_data"]

FRAME_MODEL = "USGS_ASTRO_FRAME_SENSOR_MODEL"
FIRST_CENTER = 0.5  # line and sample of the first pixel's center in a Community Sensor Model
J2000 = 1
FIT_POINTS, FIT_PX = 41, 0.01  # along an edge of the detector; what a description of distortion may be off
# Of X and Y in the terms of transverse distortion
TAYLOR_POWERS = np.array(
    [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)], dtype=np.float64
)


@dataclass(frozen=True, slots=True)
class PlaceConvention:
    """How the spacecraft's place in image support data is corrected: ISIS' addenda say it, ALE does as they say.

    Attributes
    ----------
    craft_observes
        Light is timed as it comes from the target to the spacecraft, ``INS<id>_SWAP_OBSERVER_TARGET``. Otherwise the target
        observes the spacecraft, as ISIS does where no addendum says anything: 2.3 km from there for Cassini at 24,400 km.
    light_time, aberration
        By ``INS<id>_LIGHTTIME_CORRECTION``: "LT+S" both, "NONE" neither.
    to_surface
        ``INS<id>_LT_SURFACE_CORRECT``: light comes from the target's surface, a radius nearer; without aberration.
    """

    craft_observes: bool = False
    light_time: bool = True
    aberration: bool = True
    to_surface: bool = False


WRITTEN = PlaceConvention(craft_observes=True)


@dataclass(frozen=True, slots=True, eq=False)
class SupportData:
    """Camera, attitude and states of one picture.

    Attributes
    ----------
    et
        Middle of the exposure, TDB s past J2000.
    camera_from_j2000 : (3, 3) array
    position_km, velocity_km_s, sun_position_km, sun_velocity_km_s : (3,) arrays or None
        Of the spacecraft and of the Sun, from the target, J2000.
    body_from_j2000 : (3, 3) array or None
    radii_km : (2,) array or None
        Equatorial and polar radius of the target.
    spacecraft, sensor
        Their names.
    target_id
        NAIF's number of the target; None where it is not told.
    places
        How `position_km` is corrected.
    """

    camera: Camera
    et: float
    camera_from_j2000: FloatArray
    position_km: FloatArray | None = None
    velocity_km_s: FloatArray | None = None
    sun_position_km: FloatArray | None = None
    sun_velocity_km_s: FloatArray | None = None
    body_from_j2000: FloatArray | None = None
    radii_km: FloatArray | None = None
    spacecraft: str = ""
    sensor: str = ""
    target_id: int | None = None
    places: PlaceConvention = WRITTEN


# ---- Reading.


def read_support_data(path: str | PathLike[str]) -> SupportData:
    """Read image support data of a frame camera.

    Raises
    ------
    CameraError
        The file is no such JSON, is of another kind of sensor, or describes no camera; the message says why.
    """
    try:
        data = read_json(path, "give image support data as ALE writes them")
        return _read(data)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise CameraError(f"{Path(path)}: image support data lack or spoil {error}.") from error
    except OpNavError as error:
        raise CameraError(f"{Path(path)}: {error}") from error


def _read(data: Mapping[str, Any]) -> SupportData:
    model = data.get("name_model")
    if model != FRAME_MODEL:
        scans = "; a line scanner's instrument kernel is read: opnav mission new NAME --ik FILE --line-scan"
        raise CameraError(
            f"image support data of a {model}; only frame cameras ({FRAME_MODEL}) are read"
            f"{scans if 'LINE_SCANNER' in str(model) else ''}."
        )
    et = float(data["center_ephemeris_time"])
    position = _states(data.get("instrument_position"), et)
    sun = _states(data.get("sun_position"), et)
    radii = data.get("radii")
    return SupportData(
        camera=_camera(data),
        et=et,
        camera_from_j2000=_attitude(data["instrument_pointing"], et),
        position_km=None if position is None else position[0],
        velocity_km_s=None if position is None else position[1],
        sun_position_km=None if sun is None else sun[0],
        sun_velocity_km_s=None if sun is None else sun[1],
        body_from_j2000=_attitude(data["body_rotation"], et) if "body_rotation" in data else None,
        radii_km=None if radii is None else _vector([radii["semimajor"], radii["semiminor"]], 2) * _km(radii),
        spacecraft=str(data.get("name_platform", "")),
        sensor=str(data.get("name_sensor", "")),
        target_id=_body_code(data.get("naif_keywords")),
        places=_convention(data.get("naif_keywords")),
    )


def _body_code(keywords: Any) -> int | None:
    code = keywords.get("BODY_CODE") if isinstance(keywords, Mapping) else None
    code = code[0] if isinstance(code, list) and len(code) == 1 else code
    return code if isinstance(code, int) else None


def _convention(keywords: Any) -> PlaceConvention:
    told = keywords if isinstance(keywords, Mapping) else {}

    def said(name: str, otherwise: str) -> str:
        """What the addendum of the one instrument says that the file is about."""
        values = [value for key, value in told.items() if str(key).endswith(name)]
        return str(values[0]).strip().upper() if values else otherwise

    correction = said("_LIGHTTIME_CORRECTION", "LT+S")
    corrected = correction != "NONE"
    to_surface = corrected and said("_LT_SURFACE_CORRECT", "FALSE") == "TRUE"
    return PlaceConvention(
        craft_observes=said("_SWAP_OBSERVER_TARGET", "FALSE") == "TRUE",
        light_time=corrected,
        aberration=correction.endswith("+S") and not to_surface,
        to_surface=to_surface,
    )


def _km(values: Mapping[str, Any]) -> float:
    return 1e-3 if values.get("unit") == "m" else 1.0


def _vector(values: Any, count: int) -> FloatArray:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (count,) or not np.isfinite(vector).all():
        raise CameraError(f"image support data: {values!r} should be {count} finite numbers.")
    return readonly(vector)


def _number(values: Mapping[str, Any], name: str) -> float:
    """A number that must be told: ALE leaves null where a cube's label does not hold it."""
    value = values[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise CameraError(f"image support data: {name} is {json.dumps(value)}; a number is needed.")
    return float(value)


def _camera(data: Mapping[str, Any]) -> Camera:
    focal_mm = _number(data["focal_length_model"], "focal_length")
    if focal_mm < SHORTEST_FOCAL_MM:
        raise CameraError(f"image support data: focal_length is {focal_mm:g} mm; it seems to be in m.")
    rows = np.array([data["focal2pixel_samples"], data["focal2pixel_lines"]], dtype=np.float64)
    summing = np.array([float(data.get(f"detector_{axis}_summing") or 1) for axis in ("sample", "line")])
    start = np.array([float(data.get(f"starting_detector_{axis}") or 0) for axis in ("sample", "line")])
    center = np.array([_number(data["detector_center"], axis) for axis in ("sample", "line")])
    focal_axes, matrix = _aligned(rows[:, 1:])
    lens, moved_mm = centered(_distortion(data.get("optical_distortion") or {}, focal_mm, focal_axes))
    frame = (
        data["instrument_pointing"].get("constant_frames")
        or data["instrument_pointing"]["time_dependent_frames"]
    )
    return Camera(
        name=str(data.get("name_sensor", "camera")),
        frame=f"FRAME {frame[0]}",
        instrument_id=int(frame[0]),
        n_pixel=int(data["image_samples"]),
        n_line=int(data["image_lines"]),
        focal_length_mm=focal_mm,
        center_pixel_line=(center + rows[:, 0] + matrix @ moved_mm - start) / summing - FIRST_CENTER,
        pixel_from_mm=matrix / summing[:, None],
        focal_from_camera=focal_axes,
        distortion=lens,
        source="image support data of a Community Sensor Model",
    )


def _aligned(pixel_from_xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Focal axes along X and Y of the sensor's frame as sample and line run most along them, and px/mm in these."""
    turn, axes = nearest_axes(pixel_from_xy), np.eye(3)
    axes[:2, :2] = turn
    return axes, pixel_from_xy @ turn.T


def _distortion(told: Mapping[str, Any], focal_mm: float, axes: FloatArray) -> Distortion:
    kind = next(iter(told), "radial")
    values = told.get(kind, {})
    coefficients = values.get("coefficients", [v for v in values.values() if not isinstance(v, list)])
    if kind == "transverse":
        signs = np.diag(axes)[:2]
        if not signs.all():
            raise CameraError(
                "image support data: transverse distortion on a detector turned by 90 deg is not read."
            )
        mirrored = signs[0] ** TAYLOR_POWERS[:, 0] * signs[1] ** TAYLOR_POWERS[:, 1]
        x, y = (_vector(values[name], 10) * mirrored for name in "xy")
        return TaylorDistortion(x * signs[0], y * signs[1])
    if not any(coefficients):
        return NoDistortion()
    if kind == "radial":
        return RadialDistortion(*(float(c) for c in coefficients[:4]))
    if kind == "dawnfc":
        return BrownDistortion(focal_mm, k1=float(coefficients[0]) * focal_mm**2)
    raise CameraError(
        f"image support data: a distortion of type {kind} is not read; radial, transverse and dawnfc are."
    )


def _attitude(told: Mapping[str, Any], et: float) -> FloatArray:
    """Rotation of a frame from J2000 at a time: the turning part, then the constant one."""
    if told.get("reference_frame", J2000) != J2000:
        raise CameraError(
            f"image support data: attitude from frame {told['reference_frame']}; J2000 (1) is read."
        )
    times = np.array(told["ephemeris_times"], dtype=np.float64)
    matrices = np.stack([matrix_from_quaternion(q) for q in told["quaternions"]])
    if len(times) != len(matrices):
        raise CameraError("image support data: as many quaternions as ephemeris_times are needed.")
    if len(times) > 1:
        attitudes = transform.Slerp(times, transform.Rotation.from_matrix(matrices))
        turning = attitudes(np.clip(et, times[0], times[-1])).as_matrix()
    else:
        turning = matrices[0]
    constant = told.get("constant_rotation")
    fixed = np.eye(3) if constant is None else _vector(constant, 9).reshape(3, 3)
    return readonly(fixed @ turning)


def _states(told: Mapping[str, Any] | None, et: float) -> tuple[FloatArray, FloatArray | None] | None:
    """Position km and velocity km/s at a time, between the two nearest."""
    if not told or not told.get("positions"):
        return None
    times = np.array(told["ephemeris_times"], dtype=np.float64)
    positions = np.array(told["positions"], dtype=np.float64) * _km(told)
    velocities = told.get("velocities")
    at = float(np.clip(et, times[0], times[-1]))
    place = readonly(np.array([np.interp(at, times, column) for column in positions.T]))
    if not velocities:
        return place, None
    speeds = np.array(velocities, dtype=np.float64) * _km(told)
    return place, readonly(np.array([np.interp(at, times, column) for column in speeds.T]))


# ---- Writing.


def support_data(data: SupportData, target_frame: int = 0) -> dict[str, Any]:
    """Return image support data as ALE writes them, for a picture whose attitude is known.

    Parameters
    ----------
    data
        `body_from_j2000`, the positions and `radii_km` are needed: mapping programs place the picture on the target.
    target_frame
        SPICE number of the target's frame, told only.

    Raises
    ------
    CameraError
        Something is missing, or the camera's distortion is none that a Community Sensor Model knows.
    """
    needed = {
        name: getattr(data, name)
        for name in ("position_km", "sun_position_km", "body_from_j2000", "radii_km")
    }
    missing = [name for name, value in needed.items() if value is None]
    if missing:
        raise CameraError(f"image support data need {', '.join(missing)}; load the kernels that give them.")
    camera = data.camera
    attitude = _sensor_axes(camera) @ data.camera_from_j2000
    return {
        "isis_camera_version": 1,
        "image_lines": camera.n_line,
        "image_samples": camera.n_pixel,
        "name_platform": data.spacecraft,
        "name_sensor": data.sensor or camera.name,
        "reference_height": {"maxheight": 1000, "minheight": -1000, "unit": "m"},
        "name_model": FRAME_MODEL,
        "interpolation_method": "lagrange",
        "center_ephemeris_time": data.et,
        "starting_ephemeris_time": data.et,
        "radii": {
            **dict(zip(("semimajor", "semiminor"), _list(needed["radii_km"]), strict=True)),
            "unit": "km",
        },
        "body_rotation": _turning(needed["body_from_j2000"], data.et, target_frame),
        "instrument_pointing": {
            **_turning(attitude, data.et, camera.instrument_id),
            "constant_frames": [camera.instrument_id],
            "constant_rotation": np.eye(3).ravel().tolist(),
        },
        "naif_keywords": {
            **({"BODY_CODE": target_frame} if target_frame else {}),
            **_told_convention(camera.instrument_id, data.places),
        },
        **_told_optics(camera),
        "instrument_position": _moving(needed["position_km"], data.velocity_km_s, data.et),
        "sun_position": _moving(needed["sun_position_km"], data.sun_velocity_km_s, data.et),
    }


def _told_optics(camera: Camera) -> dict[str, Any]:
    """The words of the detector and the lens."""
    pixel, line = (float(center) + FIRST_CENTER for center in camera.center_pixel_line)
    matrix = camera.pixel_from_mm * _handedness(camera)
    return {
        "detector_sample_summing": 1,
        "detector_line_summing": 1,
        "focal_length_model": {"focal_length": camera.focal_length_mm},
        "detector_center": {"line": line, "sample": pixel},
        "starting_detector_line": 0,
        "starting_detector_sample": 0,
        "focal2pixel_samples": [0.0, *matrix[0].tolist()],
        "focal2pixel_lines": [0.0, *matrix[1].tolist()],
        "optical_distortion": _told_distortion(camera),
    }


def _told_convention(instrument_id: int, places: PlaceConvention) -> dict[str, Any]:
    """The words of an addendum that say how places are corrected."""
    correction = "LT" if places.light_time else "NONE"
    return {
        f"INS{instrument_id}_SWAP_OBSERVER_TARGET": places.craft_observes,
        f"INS{instrument_id}_LIGHTTIME_CORRECTION": correction
        + ("+S" if places.aberration or places.to_surface else ""),
        f"INS{instrument_id}_LT_SURFACE_CORRECT": places.to_surface,
    }


def _sensor_axes(camera: Camera) -> FloatArray:
    """The sensor's frame: Z to the sky, X along increasing pixel, Y making it right-handed."""
    return np.append(_handedness(camera), 1.0)[:, None] * camera.focal_from_camera


def _handedness(camera: Camera) -> FloatArray:
    """Signs of the sensor's X and Y along pixel and line: Y runs against the lines of a mirrored camera."""
    return np.array([1.0, np.sign(np.linalg.det(camera.focal_from_camera))])


def _told_distortion(camera: Camera) -> dict[str, Any]:
    """The first form of a Community Sensor Model that holds the distortion over the detector to `FIT_PX`."""
    if isinstance(camera.distortion, NoDistortion):
        return {"radial": {"coefficients": [0.0, 0.0, 0.0]}}
    signs, corners = _handedness(camera), (camera.n_pixel, camera.n_line)
    axes = (np.linspace(-0.5, n - 0.5, FIT_POINTS) for n in corners)
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    mm = (grid - camera.center_pixel_line) @ np.linalg.inv(camera.pixel_from_mm).T
    ideal, measured = camera.distortion.undistort(mm) * signs, mm * signs
    scale_px = float(np.abs(camera.pixel_from_mm).max())
    radial, worst = _radial_fit(ideal, measured)
    if worst * scale_px < FIT_PX:
        return {"radial": {"coefficients": radial}}
    transverse, worst = _taylor_fit(ideal, measured)
    if worst * scale_px < FIT_PX:
        return {"transverse": transverse}
    raise CameraError(
        f"{camera.name}: the polynomials of a Community Sensor Model hold its distortion to {worst * scale_px:.2g} px only."
    )


def _radial_fit(ideal: FloatArray, measured: FloatArray) -> tuple[list[float], float]:
    """k0, k1, k2 of ``ideal = measured (1 - k0 - k1 r^2 - k2 r^4)``, and the largest error, mm."""
    r2 = (measured * measured).sum(axis=-1)
    terms = np.stack([r2**n for n in range(3)], axis=-1)[:, None, :] * measured[..., None]
    design, scale = terms.reshape(-1, 3), r2.max() ** np.arange(3)
    fit = np.linalg.lstsq(design / scale, (measured - ideal).ravel(), rcond=None)[0] / scale
    return fit.tolist(), float(np.abs(design @ fit - (measured - ideal).ravel()).max())


def _taylor_fit(ideal: FloatArray, measured: FloatArray) -> tuple[dict[str, list[float]], float]:
    """Coefficients of polynomials of third degree, measured of ideal, and the largest error, mm."""
    terms = (ideal[:, None, :] ** TAYLOR_POWERS).prod(axis=-1)
    scale = np.abs(terms).max(axis=0)
    fit = np.linalg.lstsq(terms / scale, measured, rcond=None)[0] / scale[:, None]
    return {"x": fit[:, 0].tolist(), "y": fit[:, 1].tolist()}, float(np.abs(terms @ fit - measured).max())


def _list(array: FloatArray) -> list[float]:
    return [float(v) for v in array]


def _turning(rotation: FloatArray, et: float, frame: int) -> dict[str, Any]:
    return {
        "time_dependent_frames": [frame, J2000],
        "ck_table_start_time": et,
        "ck_table_end_time": et,
        "ck_table_original_size": 1,
        "ephemeris_times": [et],
        "quaternions": [quaternion_from_matrix(rotation).tolist()],
        "angular_velocities": [[0.0, 0.0, 0.0]],
        "reference_frame": J2000,
    }


def _moving(position_km: FloatArray, velocity_km_s: FloatArray | None, et: float) -> dict[str, Any]:
    return {
        "spk_table_start_time": et,
        "spk_table_end_time": et,
        "spk_table_original_size": 1,
        "ephemeris_times": [et],
        "positions": [_list(position_km)],
        "velocities": [[0.0, 0.0, 0.0] if velocity_km_s is None else _list(velocity_km_s)],
        "reference_frame": J2000,
    }
