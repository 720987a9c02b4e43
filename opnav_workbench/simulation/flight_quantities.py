"""What a flight header can say of a picture: quantities by name, worked out from the predicted attitude and the kernels.

A quantity that the kernels do not know is None; one that is known to be meaningless (a position angle of the boresight)
is the header's own number for that.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeVar

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import (
    angle_between,
    pointing_angles,
    quaternion_from_matrix,
    radec_from_unit,
    tangent_basis,
)
from opnav_workbench.image.times import text_from_et
from opnav_workbench.mission import Mission
from opnav_workbench.simulation.detector_values import DetectorValues, Level
from opnav_workbench.spice import State, body_attitude, body_id, sclk_from_et, state, utc_from_et

__all__ = ["FlightRecord", "if_known", "mid_exposure_sclk", "quantities", "sun_state", "utc_text"]

SUN, EARTH = 10, 399
ALONG_BORESIGHT = 0.5  # cosine above which an axis has no useful position angle
NO_ANGLE = -999.0
J2000_JD, DAY_S = 2451545.0, 86400.0

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, eq=False)
class FlightRecord:
    """What the header of a picture is made of: all of it known before the picture is analysed.

    Attributes
    ----------
    mission : Mission
    camera : Camera
    et : float
        Mid-exposure.
    exposure_s : float
    camera_from_j2000 : (3, 3) array
        The predicted attitude.
    identity : mapping
        Cards that tell mission and camera, and any others; they outrank those made here.
    target : str or None
        Body that the header names; its geometry comes from the kernels.
    """

    mission: Mission
    camera: Camera
    et: float
    exposure_s: float
    camera_from_j2000: FloatArray
    identity: Mapping[str, Any]
    target: str | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def if_known(value: Callable[[], Value]) -> Value | None:
    """Return what the kernels say, None where they say nothing."""
    try:
        return value()
    except KernelError:
        return None


def utc_text(et: float) -> str:
    """Return UTC by the kernels' leap seconds, else by astropy's."""
    return if_known(lambda: utc_from_et(et)) or text_from_et(et)


def mid_exposure_sclk(record: FlightRecord) -> str | None:
    """Return the clock at mid-exposure with its partition, None without a clock kernel."""
    return if_known(lambda: sclk_from_et(record.mission.clock_id, record.et))


def sun_state(record: FlightRecord) -> State | None:
    """Return the Sun from the spacecraft as headers give it: light time, no stellar aberration."""
    return if_known(lambda: state(SUN, record.et, record.mission.spacecraft_id, correction="LT"))


def quantities(record: FlightRecord, values: DetectorValues, level: Level) -> dict[str, Any]:
    """Return every quantity by name; None where it is not known."""
    found: dict[str, Any] = {}
    for part in (_times(record), _pointing(record), _camera(record, values, level), _geometry(record)):
        found |= dict(part)
    return found


def _times(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    half = 0.5 * record.exposure_s
    utc = utc_text(record.et)
    date = datetime.fromisoformat(utc.split("T")[0])
    yield "et", record.et
    yield "utc", utc
    yield "utc_day_of_year", f"{date.year:04d}-{date.timetuple().tm_yday:03d}T{utc.split('T')[1]}"
    yield "utc_julian", f"JD {_julian(record, record.et):.7f}"
    yield "sclk", mid_exposure_sclk(record)
    for name, et in (("start", record.et - half), ("stop", record.et + half)):
        clock = if_known(lambda et=et: sclk_from_et(record.mission.clock_id, et))  # type: ignore[misc]
        yield f"sclk_{name}", None if clock is None else clock.partition("/")[2]
        yield f"met_{name}", None if clock is None else _seconds(clock)
        if name == "stop":
            yield "met", None if clock is None else int(_seconds(clock)) + 1
    yield "exposure_s", record.exposure_s
    yield "exposure_ms", round(1000.0 * record.exposure_s)
    yield "half_exposure_s", half


def _seconds(clock: str) -> float:
    """Return a clock reading ``P/SSSSSSSSSS:FFFFF`` in its seconds; the field after the colon counts 20 microseconds."""
    whole, _, fraction = clock.partition("/")[2].partition(":")
    return float(whole) + float(fraction or 0.0) / 50000.0


def _julian(record: FlightRecord, et: float) -> float:
    """Return the Julian date, UTC, of another time of the record."""
    day, clock = utc_text(record.et).split("T")
    hours, minutes, seconds = (float(part) for part in clock.split(":"))
    midnight = datetime.fromisoformat(day).toordinal() + 1721424.5
    return midnight + (3600.0 * hours + 60.0 * minutes + seconds + (et - record.et)) / DAY_S


def _pointing(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    attitude, camera = record.camera_from_j2000, record.camera
    ra, dec, twist = np.degrees(pointing_angles(attitude, camera.focal_from_camera))
    yield "boresight_ra_deg", float(ra)
    yield "boresight_dec_deg", float(dec)
    yield "twist_deg", float(twist)
    for i, part in enumerate(quaternion_from_matrix(attitude.T)):
        yield f"camera_to_j2000_q{i}", float(part)
    east, north = tangent_basis(np.radians(ra), np.radians(dec))
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        if abs(axis @ camera.boresight) > ALONG_BORESIGHT:
            yield f"position_angle_{name}_deg", NO_ANGLE
        else:
            yield f"position_angle_{name}_deg", _position_angle(attitude.T @ axis, east, north)


def _position_angle(direction: FloatArray, east: FloatArray, north: FloatArray) -> float:
    return float(np.degrees(np.arctan2(direction @ east, direction @ north)) % 360.0)


def _camera(record: FlightRecord, values: DetectorValues, level: Level) -> Iterator[tuple[str, Any]]:
    yield "gain_e_per_dn", values.gain_e_per_dn
    yield "read_noise_dn", values.read_noise_dn
    yield "bias_dn", values.bias_dn or None
    yield "zero_point_mag", record.camera.zero_point_mag
    yield "n_pixel", record.camera.n_pixel
    yield "n_line", record.camera.n_line
    yield "instrument_id", record.camera.instrument_id
    yield "frame", record.camera.frame
    yield "spacecraft_id", record.mission.spacecraft_id
    yield "bus_frame", record.mission.bus_frame
    done = {True: "PERFORM", False: "OMIT"}
    yield "if_calibrated", done[level == "calibrated"]
    yield "if_smear_removed", done[level == "calibrated" and values.transfer is not None]
    yield "if_dark_removed", done[level == "calibrated" and values.dark_e_s > 0.0]


def _geometry(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    craft, et = record.mission.spacecraft_id, record.et
    sun = sun_state(record)
    earth = if_known(lambda: state(EARTH, et, craft, correction="LT"))
    yield from _vectors("sun_from_craft", sun)
    yield from _vectors("craft_from_earth", earth, -1.0)
    for name, seen in (("sun", sun), ("earth", earth)):
        yield f"{name}_julian", None if seen is None else f"JD {_julian(record, et - seen.light_time_s):.7f}"
        toward = record.camera_from_j2000.T @ record.camera.boresight
        yield (
            f"{name}_elongation_deg",
            None if seen is None else float(np.degrees(angle_between(seen.position_km, toward))),
        )
    yield from _sun_angle(record, sun)
    yield from _target(record)


def _sun_angle(record: FlightRecord, sun: State | None) -> Iterator[tuple[str, Any]]:
    toward = record.camera_from_j2000.T @ record.camera.boresight
    east, north = tangent_basis(*radec_from_unit(toward))
    yield "position_angle_sun_deg", None if sun is None else _position_angle(sun.position_km, east, north)


def _target(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    seen = sun = earth = body = number = None
    emitted, name = record.et, record.target
    if name is not None:
        number = if_known(lambda: body_id(name))
        seen = if_known(lambda: state(name, record.et, record.mission.spacecraft_id, correction="LT"))
    if name is not None and seen is not None:
        emitted = record.et - seen.light_time_s
        sun = if_known(lambda: state(SUN, emitted, name, correction="LT"))
        earth = if_known(lambda: state(EARTH, emitted, name))
        body = if_known(lambda: body_attitude(name, emitted))
    yield "target", name or "UNKNOWN"
    yield "target_or_unknown", "UNKNOWN" if seen is None else name
    yield "target_id", number
    yield "target_julian", f"JD {_julian(record, emitted):.7f}"
    yield from _vectors("craft_from_target", seen, -1.0)
    yield from _vectors("sun_from_target", sun)
    yield from _vectors("earth_from_target", earth)
    yield from _sub_point("craft", body, seen, -1.0)
    yield from _sub_point("sun", body, sun, 1.0)


def _sub_point(
    what: str, body: FloatArray | None, seen: State | None, sign: float
) -> Iterator[tuple[str, Any]]:
    """Planetocentric latitude and east longitude of the point that has another body overhead."""
    latitude = longitude = None
    if body is not None and seen is not None:
        longitude, latitude = (
            float(np.degrees(a)) for a in radec_from_unit(body @ (sign * seen.position_km))
        )
    yield f"sub_{what}_lat_deg", latitude
    yield f"sub_{what}_lon_deg", longitude


def _vectors(name: str, seen: State | None, sign: float = 1.0) -> Iterator[tuple[str, Any]]:
    position = [None] * 3 if seen is None else (sign * seen.position_km).tolist()
    velocity = [None] * 3 if seen is None else (sign * seen.velocity_km_s).tolist()
    for axis, x, v in zip("xyz", position, velocity, strict=True):
        yield f"{name}_{axis}_km", x
        yield f"{name}_v{axis}_km_s", v
    yield f"{name}_range_km", None if seen is None else float(np.linalg.norm(seen.position_km))
