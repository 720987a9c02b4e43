"""Headers as the mission writes them, made of what is known before a picture is analysed.

Flow   `FlightRecord` -> quantities by name, from the predicted attitude and the kernels -> cards of the mission's templates,
       then whatever its keyword map asks for; and world coordinates

**Quantities.** One that the kernels do not know is None; one that is known to be meaningless (a position angle of
the boresight) is the header's own number for that.

**Templates** are YAML files ``headers/*.yaml`` beside the mission file. They list groups of cards ``[keyword,
value, comment]``; a value ``=name`` is a quantity, and a group with `when` is written only into pictures whose
header (or processing `level`) has those values.

**World coordinates** are a tangent plane at the predicted boresight, with SIP distortion. With u the offset of a
pixel from CRPIX and U = u + f(u, v), V = v + g(u, v) that of an ideal camera, the tangent-plane coordinates are CD
(U, V); f and g are polynomials fitted to the camera's own distortion. No aberration is applied: the coordinates are
those of apparent directions, as the attitude in a CK is. Source: Calabretta & Greisen (2002),
doi:10.1051/0004-6361:20021327; SIP after Shupe et al. (2005), ADASS XIV, 491.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.constants import DAY_S, EARTH_ID, HOUR_S, MINUTE_S, SUN_ID
from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.geometry import (
    angle_between,
    pointing_angles,
    quaternion_from_matrix,
    radec_from_unit,
    tangent_basis,
)
from opnav_workbench.geometry.times import text_from_et
from opnav_workbench.image import KeywordMap
from opnav_workbench.image.header import bare_word, header_matches
from opnav_workbench.kernels import State, body_attitude, body_id, sclk_from_et, state, utc_from_et
from opnav_workbench.mission import Mission
from opnav_workbench.simulation.detector_properties import DetectorValues, Level
from opnav_workbench.yaml_file import StrictModel, read_model

__all__ = ["FlightRecord", "flight_cards", "utc_text", "wcs_cards"]


# ---- What a flight header can say of a picture.

ALONG_BORESIGHT = 0.5  # cosine above which an axis has no useful position angle
NO_ANGLE = -999.0

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, eq=False)
class FlightRecord:
    """What the header of a picture is made of: all of it known before the picture is analysed.

    Attributes
    ----------
    et
        Mid-exposure.
    camera_from_j2000 : (3, 3) array
        The predicted attitude.
    identity
        Cards that tell mission and camera, and any others; they outrank those made here.
    target
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
    return if_known(lambda: state(SUN_ID, record.et, record.mission.spacecraft_id, correction="LT"))


def header_quantities(record: FlightRecord, values: DetectorValues, level: Level) -> dict[str, Any]:
    """Return every quantity by name; None where it is not known."""
    found: dict[str, Any] = {}
    for part in (
        _time_quantities(record),
        _pointing_quantities(record),
        _camera_quantities(record, values, level),
        _geometry_quantities(record),
    ):
        found |= dict(part)
    return found


def _time_quantities(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    half = 0.5 * record.exposure_s
    utc = utc_text(record.et)
    date = datetime.fromisoformat(utc.split("T")[0])
    yield "et", record.et
    yield "utc", utc
    yield "utc_day_of_year", f"{date.year:04d}-{date.timetuple().tm_yday:03d}T{utc.split('T')[1]}"
    yield "utc_julian", f"JD {_julian_date(record, record.et):.7f}"
    yield "sclk", mid_exposure_sclk(record)
    for name, et in (("start", record.et - half), ("stop", record.et + half)):
        clock = if_known(lambda et=et: sclk_from_et(record.mission.clock_id, et))  # type: ignore[misc]
        yield f"sclk_{name}", None if clock is None else clock.partition("/")[2]
        yield f"met_{name}", None if clock is None else _clock_seconds(clock)
        if name == "stop":
            yield "met", None if clock is None else int(_clock_seconds(clock)) + 1
    yield "exposure_s", record.exposure_s
    yield "exposure_ms", round(1000.0 * record.exposure_s)
    yield "half_exposure_s", half


def _clock_seconds(clock: str) -> float:
    """Return a clock reading ``P/SSSSSSSSSS:FFFFF`` in its seconds; the field after the colon counts 20 microseconds."""
    whole, _, fraction = clock.partition("/")[2].partition(":")
    return float(whole) + float(fraction or 0.0) / 50000.0


def _julian_date(record: FlightRecord, et: float) -> float:
    """Return the Julian date, UTC, of another time of the record."""
    day, clock = utc_text(record.et).split("T")
    hours, minutes, seconds = (float(part) for part in clock.split(":"))
    midnight = datetime.fromisoformat(day).toordinal() + 1721424.5
    return midnight + (HOUR_S * hours + MINUTE_S * minutes + seconds + (et - record.et)) / DAY_S


def _pointing_quantities(record: FlightRecord) -> Iterator[tuple[str, Any]]:
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


def _camera_quantities(
    record: FlightRecord, values: DetectorValues, level: Level
) -> Iterator[tuple[str, Any]]:
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


def _geometry_quantities(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    craft, et = record.mission.spacecraft_id, record.et
    sun = sun_state(record)
    earth = if_known(lambda: state(EARTH_ID, et, craft, correction="LT"))
    yield from _vectors("sun_from_craft", sun)
    yield from _vectors("craft_from_earth", earth, -1.0)
    for name, seen in (("sun", sun), ("earth", earth)):
        yield (
            f"{name}_julian",
            None if seen is None else f"JD {_julian_date(record, et - seen.light_time_s):.7f}",
        )
        toward = record.camera_from_j2000.T @ record.camera.boresight
        yield (
            f"{name}_elongation_deg",
            None if seen is None else float(np.degrees(angle_between(seen.position_km, toward))),
        )
    yield from _sun_angle(record, sun)
    yield from _target_quantities(record)


def _sun_angle(record: FlightRecord, sun: State | None) -> Iterator[tuple[str, Any]]:
    toward = record.camera_from_j2000.T @ record.camera.boresight
    east, north = tangent_basis(*radec_from_unit(toward))
    yield "position_angle_sun_deg", None if sun is None else _position_angle(sun.position_km, east, north)


def _target_quantities(record: FlightRecord) -> Iterator[tuple[str, Any]]:
    seen = sun = earth = body = number = None
    emitted, name = record.et, record.target
    if name is not None:
        number = if_known(lambda: body_id(name))
        seen = if_known(lambda: state(name, record.et, record.mission.spacecraft_id, correction="LT"))
    if name is not None and seen is not None:
        emitted = record.et - seen.light_time_s
        sun = if_known(lambda: state(SUN_ID, emitted, name, correction="LT"))
        earth = if_known(lambda: state(EARTH_ID, emitted, name))
        body = if_known(lambda: body_attitude(name, emitted))
    yield "target", name or "UNKNOWN"
    yield "target_or_unknown", "UNKNOWN" if seen is None else name
    yield "target_id", number
    yield "target_julian", f"JD {_julian_date(record, emitted):.7f}"
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


# ---- Headers as the mission writes them.

HEADER_FOLDER = "headers"
QUANTITY = "="  # a value that begins so is a quantity's name
UNKNOWN_GEOMETRY = "PREDICT"

CardValue = str | bool | int | float


@dataclass(frozen=True, slots=True)
class Card:
    """One header card."""

    keyword: str
    value: CardValue
    comment: str = ""


class _Group(StrictModel):
    when: dict[str, CardValue] = Field(default_factory=dict)
    cards: tuple[tuple[str, CardValue, str], ...]


class _Template(StrictModel):
    groups: tuple[_Group, ...]


def flight_cards(record: FlightRecord, values: DetectorValues, level: Level) -> tuple[Card, ...]:
    """Return the cards of a picture, in order, each keyword once.

    Parameters
    ----------
    values
        Gain, read noise and bias of the exposure.
    level : {"raw", "calibrated"}

    Raises
    ------
    MissionError
        A template that breaks the schema or names an unknown quantity.
    """
    cards: dict[str, Card] = {}
    for card in (*_template_cards(record, values, level), *_keyword_cards(record)):
        cards.setdefault(card.keyword, card)
    for keyword, value in record.identity.items():
        known = cards.get(keyword)
        cards[keyword] = Card(keyword, value, "" if known is None else known.comment)
    cards["SIMULATE"] = Card("SIMULATE", value=True, comment="Simulated picture")
    return tuple(cards.values())


def _template_cards(record: FlightRecord, values: DetectorValues, level: Level) -> Iterator[Card]:
    templates = sorted((record.mission.path.parent / HEADER_FOLDER).glob("*.yaml"))
    if not templates:
        return
    known = header_quantities(record, values, level)
    missing = KeywordMap(**record.mission.keywords).missing_values[0]
    told = {"level": level, **record.identity}
    for path in templates:
        template = _template(path, path.stat().st_mtime_ns)
        for group in template.groups:
            if all(header_matches(told.get(keyword), value) for keyword, value in group.when.items()):
                yield from (_card(card, known, missing, path.name) for card in group.cards)


@lru_cache(maxsize=16)
def _template(path: Path, _changed_ns: int) -> _Template:
    """Read a template once for all pictures, again when the file has changed."""
    return read_model(path, _Template, "header template", MissionError)


def _card(card: tuple[str, CardValue, str], known: Mapping[str, Any], missing: float, file: str) -> Card:
    keyword, value, comment = card
    if not (isinstance(value, str) and value.startswith(QUANTITY)):
        return Card(keyword, value, comment)
    name = value.removeprefix(QUANTITY)
    if name not in known:
        raise MissionError(
            f"header template {file}: {keyword}: unknown quantity {name!r}; known are {sorted(known)}."
        )
    found = known[name]
    return Card(keyword, missing if found is None else found, comment)


def _keyword_cards(record: FlightRecord) -> Iterator[Card]:
    """Yield time, exposure, pointing and trajectory under the mission's own keywords."""
    names = KeywordMap(**record.mission.keywords)
    rows = record.camera.rows
    lasts_s = record.exposure_s + (0.0 if rows is None else rows.span_s(record.camera.n_line))
    stamp = record.et - names.to_middle_s(lasts_s)
    single = (
        (names.exposure_s, record.exposure_s / names.exposure_scale),
        (names.et, stamp),
        (names.utc, utc_text(stamp)),
        (names.sclk, mid_exposure_sclk(record)),
        (names.target, record.target),
        (names.geometry_quality, UNKNOWN_GEOMETRY),
        (names.bits, record.camera.bits),
        ("RADESYS", "ICRS"),
    )
    yield from (
        Card(keyword, value) for keyword, value in single if keyword is not None and value is not None
    )
    attitude, sun = record.camera_from_j2000, sun_state(record)
    turned = attitude.T if names.quaternion_sense == "camera_to_j2000" else attitude
    for keywords, vector in (
        (names.quaternion, quaternion_from_matrix(turned)),
        (names.sun_position, None if sun is None else sun.position_km),
        (names.sun_velocity, None if sun is None else sun.velocity_km_s),
    ):
        if keywords is not None and vector is not None:
            for keyword, value in zip(keywords, vector.tolist(), strict=True):
                word, sign = bare_word(keyword)
                yield Card(word, sign * value)


# ---- World coordinates of a picture for its FITS header.

WCS_GRID = 33  # points along each side of the detector for the fits
SIP_ORDERS = (2, 3, 4, 5, 6, 7)
GOOD_SIP_PX = 0.001  # largest misfit that asks for no higher order
NO_DISTORTION_PX = 1e-6

Powers = tuple[tuple[int, int], ...]


def wcs_cards(camera: Camera, camera_from_j2000: ArrayLike) -> dict[str, Any]:
    """Return the WCS cards of a picture, the boresight's coordinates at CRVAL.

    Parameters
    ----------
    camera_from_j2000 : (3, 3) array_like
        The attitude that the header states.
    """
    attitude = np.asarray(camera_from_j2000, dtype=np.float64)
    axis = camera.project(camera.boresight)  # where the optical axis really falls
    pixels, ideal = _offsets_from_axis(camera, axis)
    distorted = np.abs(ideal - pixels).max() > NO_DISTORTION_PX
    linear, sip = _sip(pixels, ideal) if distorted else (np.eye(2), {})
    matrix = _tangent_from_ideal(camera, attitude) @ linear
    ra, dec = radec_from_unit(camera.boresight @ attitude)
    kind = "-SIP" if distorted else ""
    cards: dict[str, Any] = {
        "WCSAXES": 2,
        "CTYPE1": f"RA---TAN{kind}",
        "CTYPE2": f"DEC--TAN{kind}",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRPIX1": float(axis[0] + 1.0),  # FITS counts from 1
        "CRPIX2": float(axis[1] + 1.0),
        "CRVAL1": float(np.degrees(ra)),
        "CRVAL2": float(np.degrees(dec)),
    }
    cards |= {f"CD{i + 1}_{j + 1}": float(matrix[i, j]) for i in (0, 1) for j in (0, 1)}
    return cards | sip


def _offsets_from_axis(camera: Camera, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return offsets (n, 2), px, of points that see the sky from the optical axis, and those of an ideal camera."""
    x, y = np.meshgrid(
        np.linspace(0, camera.n_pixel - 1, WCS_GRID), np.linspace(0, camera.n_line - 1, WCS_GRID)
    )
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    a_b_c = camera.unproject(points) @ camera.focal_from_camera.T
    sees = np.isfinite(a_b_c).all(axis=1)  # not beyond a fisheye's circle
    points, a_b_c = points[sees], a_b_c[sees]
    ideal_mm = camera.focal_length_mm * a_b_c[:, :2] / a_b_c[:, 2:]
    return points - axis, ideal_mm @ camera.pixel_from_mm.T


def _tangent_from_ideal(camera: Camera, attitude: FloatArray) -> FloatArray:
    """Return d(east, north)/d(pixel, line), deg/px, of the ideal camera."""
    pixel_axis, line_axis, boresight = camera.focal_from_camera @ attitude
    sky = np.stack(tangent_basis(*radec_from_unit(boresight)))
    per_mm = sky @ np.stack([pixel_axis, line_axis], axis=1) / camera.focal_length_mm
    return np.asarray(np.degrees(per_mm @ np.linalg.inv(camera.pixel_from_mm)))


def _sip(pixels: FloatArray, ideal: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
    """Return the linear part of ideal(pixels), which belongs into CD, and the SIP cards of the rest."""
    powers, forward = _fit_polynomials(pixels, ideal - pixels)
    linear = np.eye(2) + forward[:2].T
    to_linear = np.linalg.inv(linear).T
    cards = _sip_cards(("A", "B"), powers[2:], forward[2:] @ to_linear)
    straight = ideal @ to_linear
    return linear, cards | _sip_cards(("AP", "BP"), *_fit_polynomials(straight, pixels - straight))


def _sip_cards(names: tuple[str, str], powers: Powers, coefficients: FloatArray) -> dict[str, Any]:
    cards: dict[str, Any] = {}
    for name, column in zip(names, coefficients.T, strict=True):
        cards[f"{name}_ORDER"] = max(p + q for p, q in powers)
        cards |= {f"{name}_{p}_{q}": float(c) for (p, q), c in zip(powers, column, strict=True)}
    return cards


def _fit_polynomials(points: FloatArray, shift: FloatArray) -> tuple[Powers, FloatArray]:
    """Fit polynomials without a constant: powers of both coordinates, x first, and coefficients (k, 2)."""
    scale = np.abs(points).max()
    for order in SIP_ORDERS:
        powers = tuple((p, n - p) for n in range(1, order + 1) for p in range(n, -1, -1))
        x, y = (points / scale).T
        basis = np.stack([x**p * y**q for p, q in powers], axis=1)
        fitted = np.linalg.lstsq(basis, shift, rcond=None)[0]
        if np.abs(basis @ fitted - shift).max() < GOOD_SIP_PX:
            break
    degree = np.array([p + q for p, q in powers])
    return powers, fitted / scale ** degree[:, None]
