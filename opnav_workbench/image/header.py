"""What a picture's header says: which keyword holds what, and pointing and trajectory from it.

`Header`
    The header as plain Python values, keywords found in any case.
`KeywordMap`
    Which keywords hold time, exposure, pointing, planes: the part of a mission file that speaks of pictures. Absent and
    "missing" values (``N/A``, -1e32, -999) are None.
`header_geometry`
    Attitude and spacecraft state as the header states them. Quaternions are in SPICE's order, scalar first. New Horizons
    headers give the Sun without stellar aberration (checked against SPICE on headers of 2007, to the 100 km by which the
    trajectories differ), so the vector turned round is the spacecraft's place.
`barycentric_from_heliocentric`
    From the Sun to the solar-system barycenter without kernels: ERFA ``epv00`` after VSOP2000 (Moisson & Bretagnon 2001,
    Celest. Mech. 80, 205), in which the Earth's places with respect to barycenter and Sun differ by the Sun's own. In
    2006-2030 that is at most 118 km from DE440's, nearly constant (DE440 counts the Kuiper belt into the barycenter), its
    velocity 0.3 mm/s.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import erfa
import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.constants import AU_KM, DAY_S, J2000_JD
from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.image.contradictions import believed_state, check_sun_distance
from opnav_workbench.image.masks import QUALITY_TABLES

__all__ = [
    "Header",
    "HeaderGeometry",
    "HeaderValue",
    "KeywordMap",
    "bare_word",
    "barycentric_from_heliocentric",
    "header_geometry",
    "header_matches",
    "header_number",
    "unread_words",
]


# ---- A picture in memory: pixels, masks and what the header says of time and pointing.

HeaderValue: TypeAlias = str | float | int | bool


class Header(Mapping[str, HeaderValue]):
    """The header as read-only plain Python values; keywords in capitals, found in any case.

    Examples
    --------
    >>> Header({"EXPTIME": 0.5})["exptime"]
    0.5
    """

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, HeaderValue]) -> None:
        self._values = {keyword.upper(): value for keyword, value in values.items()}

    def __getitem__(self, keyword: str) -> HeaderValue:
        return self._values[keyword.upper()]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"Header({self._values!r})"


def header_matches(found: Any, wanted: Any) -> bool:
    """Tell whether a header has a value, or one of several: as headers are written, blanks and case do not count.

    Examples
    --------
    >>> header_matches(" lor ", ["LOR", "MVIC"]), header_matches(1, 1.0), header_matches(None, "LOR")
    (True, True, False)
    """
    choices = wanted if isinstance(wanted, list | tuple) else (wanted,)
    return any(_same_value(found, choice) for choice in choices)


def _same_value(found: Any, wanted: Any) -> bool:
    if isinstance(found, str) or isinstance(wanted, str):
        return str(found).strip().casefold() == str(wanted).strip().casefold()
    return bool(found == wanted)


@dataclass(frozen=True, slots=True, eq=False)
class HeaderGeometry:
    """Pointing and trajectory as the header states them; arrays are read-only.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array or None
        Attitude, so that ``v_camera = camera_from_j2000 @ v_j2000``; None where the header tells none.
    spacecraft_from_sun_km, spacecraft_velocity_km_s : (3,) array or None
        Spacecraft with respect to the Sun, J2000; zeros where what is stated cannot be.
    quality
        What the header says of its own geometry ("PREDICT", "RECONSTRUCTED"), or "".
    velocity_sigma_km_s
        Of each axis, where the velocity cannot be what is stated and is not known; else 0.
    boresight_deg : (3,) array or None
        Right ascension, declination and twist as stated beside the attitude, or instead of it; the twist may be nan.
    earth_km : (3,) array or None
        Earth with respect to the spacecraft, as stated beside the Sun's.
    """

    camera_from_j2000: FloatArray | None
    spacecraft_from_sun_km: FloatArray | None
    spacecraft_velocity_km_s: FloatArray | None
    quality: str
    velocity_sigma_km_s: float = 0.0
    boresight_deg: FloatArray | None = None
    earth_km: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- Which header keywords hold what: the part of a mission file that speaks of pictures.

ABSENT_TEXTS = frozenset({"", "N/A", "NA", "UNK", "UNKNOWN", "NULL", "NONE", "TBD"})
ABSENT_NUMBERS = (-1e32, -999.0)  # New Horizons; many PDS3 products use the second
SAME_NUMBER = 1e-9  # relative: -1E+32 as printed and as read
EXPOSURES_TO_MIDDLE = {"middle": 0.0, "start": 0.5, "end": -0.5}
CHOICES = {
    "quaternion_sense": ("camera_to_j2000", "j2000_to_camera"),
    "sclk_at": ("exposure", "middle"),
    "time_reference": tuple(EXPOSURES_TO_MIDDLE),
    "quality_table": tuple(QUALITY_TABLES),
}
LENGTHS = {
    "quaternion": 4, "boresight": 2, "sun_position": 3, "sun_velocity": 3, "earth_position": 3, "earth_velocity": 3,
}  # fmt: skip
PIECE = re.compile(r"(?P<word>.+)\[(?P<number>[1-9]\d?)\]")  # of a word that holds several: QUATERNION[1]


@dataclass(frozen=True, kw_only=True)
class KeywordMap:
    """Names of the header keywords that hold time, exposure, pointing and trajectory; every one is optional.

    Attributes
    ----------
    exposure_s
        Exposure time; times `exposure_scale` it is in seconds.
    et, utc, sclk
        Time of the picture: TDB seconds past J2000, UTC text, spacecraft clock.
    sclk_at : {"exposure", "middle"}
        What `sclk` refers to: some instant from the command to the telemetry of the exposure, or its very middle.
    time_reference
        What `et` and `utc` refer to; the start or the end of the exposure is shifted by half of it.
    time_offset_s
        Added to `et` and `utc`: where a header's time is that of another event, so much before the one that it stands for.
    frame, frame_interval, frame_interval_extra_s
        Of one of several frames that share a time: its number, counted from 1, and the seconds from one to the next, which
        are longer than said by the last.
    begin, end
        When the exposure began and ended, in UTC or in seconds of the clock of `sclk`: what exposure and times are held
        against. Unless named, the standards' own: ``DATE-BEG`` and ``DATE-END`` (FITS), ``START_TIME``, ``STOP_TIME`` (PDS).
    quaternion : sequence of 4 str
        SPICE order, scalar first; its sense is `quaternion_sense`.
    boresight : sequence of 2 str
        Right ascension and declination of the boresight or the picture's middle, J2000, deg: what the quaternion is held
        against, and with `twist` the attitude where there is none.
    twist
        Position angle of increasing line at the boresight, east of J2000 north, deg.
    sun_position, sun_velocity : sequence of 3 str
        Sun with respect to the spacecraft, km and km/s, J2000.
    earth_position, earth_velocity : sequence of 3 str
        Earth with respect to the spacecraft, likewise, where it is or where its light left (no aberration): what the Sun's
        and the time are held against.
    target, instrument, geometry_quality
        Text about the picture.
    bits
        Bits of the digitizer: the highest value that they can hold is saturated.
    channel
        Which channel of a picture of several is taken, by name (red, green, blue) or number from 1.
    image_extension, error_extension, quality_extension
        FITS extensions by name or index; the image is the first two-dimensional one unless named.
    quality_table
        Name of a table in `opnav_workbench.image.masks.QUALITY_TABLES`.
    expansion_keyword
        Says how values were squeezed on board; `expansion` has the table of what it may say.
    expansion
        DN by stored value.
    dark_columns
        Width of a raw frame to the number of dark columns at its right end, which are cut off.
    housekeeping_pixels
        Pixels at the start of line 0 that carry telemetry instead of sky.
    required : mapping of str to value or values
        Keywords that tell this mission's frames from others.
    missing_values
        Numbers that mean "no value".

    Vectors, quaternions and angles: a minus before a keyword stands for the opposite of its value, and ``WORD[2]`` for the
    second of several that one word of a label holds. A label's own unit counts.

    Raises
    ------
    MissionError
        A field has a value that it cannot have; the message names it.

    Examples
    --------
    >>> KeywordMap(exposure_s="EXPTIME").value(Header({"EXPTIME": 0.5}), "exposure_s")
    0.5
    >>> KeywordMap(twist="-TWIST").numbers(Header({"TWIST": 10.0}), "twist")
    [-10.0]
    """

    exposure_s: str | None = None
    exposure_scale: float = 1.0
    et: str | None = None
    utc: str | None = None
    sclk: str | None = None
    sclk_at: Literal["exposure", "middle"] = "exposure"
    time_reference: Literal["middle", "start", "end"] = "middle"
    time_offset_s: float = 0.0
    frame: str | None = None
    frame_interval: str | None = None
    frame_interval_extra_s: float = 0.0
    begin: str | None = None
    end: str | None = None
    quaternion: Sequence[str] | None = None
    quaternion_sense: Literal["camera_to_j2000", "j2000_to_camera"] = "camera_to_j2000"
    boresight: Sequence[str] | None = None
    twist: str | None = None
    sun_position: Sequence[str] | None = None
    sun_velocity: Sequence[str] | None = None
    earth_position: Sequence[str] | None = None
    earth_velocity: Sequence[str] | None = None
    target: str | None = None
    instrument: str | None = None
    geometry_quality: str | None = None
    bits: str | None = None
    channel: str | int | None = None
    image_extension: str | int | None = None
    error_extension: str | int | None = None
    quality_extension: str | int | None = None
    quality_table: str = "any_nonzero"
    expansion_keyword: str | None = None
    expansion: Mapping[str, Sequence[float]] = field(default_factory=dict)
    dark_columns: Mapping[int, int] = field(default_factory=dict)
    housekeeping_pixels: int = 0
    required: Mapping[str, Any] = field(default_factory=dict)
    missing_values: Sequence[float] = ABSENT_NUMBERS

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            _refuse_keyword(
                getattr(self, name) in choices, name, getattr(self, name), "one of " + ", ".join(choices)
            )
        for name, length in LENGTHS.items():
            value = getattr(self, name)
            good = value is None or (not isinstance(value, str) and len(value) == length)
            _refuse_keyword(good, name, value, f"a list of {length} keywords")
        scale = self.exposure_scale
        _refuse_keyword(0.0 < scale < math.inf, "exposure_scale", scale, "a positive number of seconds")
        for name in ("time_offset_s", "frame_interval_extra_s"):
            _refuse_keyword(
                math.isfinite(getattr(self, name)), name, getattr(self, name), "a number of seconds"
            )
        for item in fields(self):
            object.__setattr__(self, item.name, _frozen(getattr(self, item.name)))

    def to_middle_s(self, exposure_s: float) -> float:
        """Return how long after `et` and `utc` the middle of an exposure is.

        Examples
        --------
        >>> KeywordMap(time_reference="end", time_offset_s=-2.0).to_middle_s(0.5)
        -2.25
        """
        parts = EXPOSURES_TO_MIDDLE[self.time_reference]
        return self.time_offset_s + (parts * exposure_s if parts else 0.0)

    def to_frame_s(self, header: Header) -> float | None:
        """Return how long after the first of several frames this one began; None where only its number is told."""
        number, interval = (header_number(self.value(header, name)) for name in ("frame", "frame_interval"))
        if number is None:
            return 0.0
        return None if interval is None else (number - 1.0) * (interval + self.frame_interval_extra_s)

    def value(self, header: Header, name: str) -> HeaderValue | None:
        """Return what the header says for a field of this map, None where it says nothing or "missing"."""
        keyword = getattr(self, name)
        return None if keyword is None else self.known(header, keyword)

    def known(self, header: Header, keyword: str) -> HeaderValue | None:
        """Return the value of a header keyword, None where it is absent or stands for "missing"."""
        value = header.get(keyword)
        if value is None and (piece := PIECE.fullmatch(keyword)):
            value = _piece(header.get(piece["word"]), int(piece["number"]))
        if isinstance(value, str):
            text = value.strip()
            return None if text.upper() in ABSENT_TEXTS else text
        if value is None or isinstance(value, bool):
            return value
        absent = any(math.isclose(value, gone, rel_tol=SAME_NUMBER) for gone in self.missing_values)
        return None if absent else value

    def words(self, name: str) -> tuple[str, ...]:
        """Return the keywords of a field of one or several, as a header has them."""
        return tuple(bare_word(word)[0] for word in self._named(name))

    def numbers(self, header: Header, name: str) -> list[float | None]:
        """Return what the words of a vector, quaternion or angle say, in km, km/s or deg; None where one is no number."""
        return [self._number(header, word) for word in self._named(name)]

    def _named(self, name: str) -> Sequence[str]:
        named = getattr(self, name) or ()
        return (named,) if isinstance(named, str) else tuple(named)

    def _number(self, header: Header, named: str) -> float | None:
        word, sign = bare_word(named)
        value = header_number(self.known(header, word))
        if value is None or not math.isfinite(value):
            return None
        return value * UNITS.get(unit_of(header, word), 1.0) * sign


def bare_word(named: str) -> tuple[str, float]:
    """Return a keyword of a map as a header has it, and -1 where a minus says that it holds the opposite, else 1."""
    word = named.removeprefix("-")
    return word, 1.0 if word == named else -1.0


def _piece(value: HeaderValue | None, number: int) -> HeaderValue | None:
    """Return one of the values of a word that holds several, None where there is none."""
    pieces = str(value).split(",") if isinstance(value, str) else []
    if number > len(pieces):
        return None
    told = header_number(pieces[number - 1])
    return pieces[number - 1] if told is None else told


OF_UNIT = " <UNIT>"  # after a keyword: what its value is counted in, where the label says it
UNITS = {  # in km, km/s and degrees
    **dict.fromkeys(("km", "kilometer", "kilometers", "km/s", "km/sec", "deg", "degree", "degrees", "n/a", ""), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "m/s", "m/sec"), 1e-3), "au": AU_KM, "arcsec": 1.0 / 3600.0,
    **dict.fromkeys(("rad", "radian", "radians"), math.degrees(1.0)),
}  # fmt: skip


def unit_of(header: Mapping[str, HeaderValue], word: str) -> str:
    """Return the unit that a label gives a word, or one of its pieces, in small letters; empty where it gives none."""
    piece = PIECE.fullmatch(word)
    return str(header.get((piece["word"] if piece else word) + OF_UNIT, "")).strip().lower()


SECONDS_OF_UNIT = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "microsecond", "microseconds", "microsec", "microsecs", "µs", "μs"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
}


def stated_unit_s(header: Mapping[str, HeaderValue], keyword: str) -> float | None:
    """Return the seconds of the unit that a label gives a value, None where it gives none, or none of time.

    Examples
    --------
    >>> stated_unit_s({"EXPOSURE": 20, "EXPOSURE <UNIT>": "MSEC"}, "EXPOSURE")
    0.001
    """
    return SECONDS_OF_UNIT.get(unit_of(header, keyword))


def unread_units(header: Header, keywords: KeywordMap) -> tuple[str, ...]:
    """Return a line for each word whose label counts it in a unit that is not known: it is taken as the mission says."""
    exposure = [(word, SECONDS_OF_UNIT) for word in keywords.words("exposure_s")]
    others = [(word, UNITS) for name in (*LENGTHS, "twist") for word in keywords.words(name)]
    said = (
        f"{word} is in <{unit}>, which is no unit of it that is known; it is taken as the mission file says"
        for word, known in (*exposure, *others)
        if (unit := unit_of(header, word)) and unit not in known and keywords.known(header, word) is not None
    )
    return tuple(dict.fromkeys(said))


def header_number(value: HeaderValue | None) -> float | None:
    """Return a header value as a float, None where it is absent or no number ("8.87E-5 " is one)."""
    try:
        return None if value is None or isinstance(value, bool) else float(value)
    except (ValueError, OverflowError):  # of a text that is none; of a whole number beyond any double
        return None


def _refuse_keyword(good: bool, name: str, value: Any, wanted: str) -> None:
    if not good:
        raise MissionError(f"keywords: {name} is {value!r}, expected {wanted}.")


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return MappingProxyType(dict(value))
    return tuple(value) if isinstance(value, list | tuple) else value


# ---- Pointing and trajectory from header keywords.

# Quaternions are printed with at least five digits; one that is further from length 1 is no attitude.
QUATERNION_NORM_TOLERANCE = 1e-3
# FK5 at J2000 is turned against the ICRS by about 23 mas.
SYSTEM_REMARK = (
    "header coordinates are {}, which differs from ICRS by about 0.02 arcsec; no correction is made"
)


@dataclass(frozen=True, slots=True, eq=False)
class GeometryRead:
    """What a header says of pointing and trajectory (None: nothing usable), remarks, and what contradicts itself."""

    geometry: HeaderGeometry | None
    messages: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()


def unread_words(header: Header, keywords: KeywordMap, names: Sequence[str]) -> tuple[str, ...]:
    """Return a line for each word that should hold a number and does not, though it says something.

    Parameters
    ----------
    names
        Fields of the map, each of one keyword or several.
    """
    said = []
    for keyword in (word for name in names for word in keywords.words(name)):
        value = keywords.known(header, keyword)
        number = header_number(value)
        if value is not None and (number is None or not math.isfinite(number)):
            said.append(f"{keyword} = {value!r} is no number; it is not used")
    return tuple(said)


SUN_DISTANCE = "SPACECRAFT_SOLAR_DISTANCE"  # km: the PDS data dictionary's word


def header_geometry(header: Header, keywords: KeywordMap, times: Sequence[float] = ()) -> GeometryRead:
    """Return what the header says of pointing and trajectory, as far as it can be believed.

    Parameters
    ----------
    times
        When the picture was taken by each of the header's statements, TDB s past J2000: where the planets were.

    Notes
    -----
    New Horizons headers give the Sun without stellar aberration (checked against SPICE in 2007 headers to the
    100 km by which the trajectories differ), so the vector turned round is the spacecraft's place. They give the Earth where
    its light left: to 59 km and below 0.1 m/s of the series, in headers of 2007 and 2020.
    """
    messages = _system_remarks(header)
    quaternion = _header_vector(header, keywords, "quaternion")
    wrong = () if quaternion is None else _no_rotation(quaternion, keywords)
    if keywords.quaternion is not None and quaternion is None:
        names = ", ".join(keywords.words("quaternion"))
        messages = (*messages, f"no header pointing: {names} are not all in the header")
    attitude = None if quaternion is None or wrong else _header_attitude(quaternion, keywords)
    earth = (
        _header_vector(header, keywords, "earth_position"),
        _header_vector(header, keywords, "earth_velocity"),
    )
    state = believed_state(
        _from_sun(header, keywords, "sun_position"),
        _from_sun(header, keywords, "sun_velocity"),
        (", ".join(keywords.words("sun_position")), ", ".join(keywords.words("sun_velocity"))),
        times,
        earth,
    )
    unread = unread_words(header, keywords, (*LENGTHS, "twist"))
    boresight = _boresight(header, keywords)
    nowhere = () if boresight is None else _no_direction(boresight, keywords)
    boresight = None if nowhere else boresight
    distance_km = header_number(keywords.known(header, SUN_DISTANCE))
    apart = check_sun_distance(state.position_km, distance_km, SUN_DISTANCE)
    contradictions = (*wrong, *nowhere, *unread, *state.contradictions, *apart)
    if attitude is None and boresight is None and state.position_km is None:
        return GeometryRead(None, messages, contradictions)
    geometry = HeaderGeometry(
        attitude,
        state.position_km,
        state.velocity_km_s,
        str(keywords.value(header, "geometry_quality") or ""),
        state.velocity_sigma_km_s,
        boresight,
        earth[0],
    )
    return GeometryRead(geometry, messages, contradictions)


def _no_rotation(quaternion: FloatArray, keywords: KeywordMap) -> tuple[str, ...]:
    """Return why four numbers are no rotation; nothing where they are one."""
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) <= QUATERNION_NORM_TOLERANCE:
        return ()
    names = ", ".join(keywords.words("quaternion"))
    return (f"no header pointing: the quaternion {names} has length {length:.6g} instead of 1",)


def _no_direction(boresight_deg: FloatArray, keywords: KeywordMap) -> tuple[str, ...]:
    """Return why a right ascension and declination are none; nothing where they are."""
    ra, dec, _ = boresight_deg
    if abs(dec) <= 90.0 and abs(ra) <= 360.0:
        return ()
    return (
        f"{', '.join(keywords.words('boresight'))} = {ra:g}, {dec:g} deg are no direction; they are not used",
    )


def _header_attitude(quaternion: FloatArray, keywords: KeywordMap) -> FloatArray:
    matrix = matrix_from_quaternion(quaternion)
    return matrix.T if keywords.quaternion_sense == "camera_to_j2000" else matrix


def _boresight(header: Header, keywords: KeywordMap) -> FloatArray | None:
    """Return right ascension, declination and twist (nan where it is not stated), deg; None without the first two."""
    radec = _header_vector(header, keywords, "boresight")
    twist = keywords.numbers(header, "twist")
    return (
        None if radec is None else np.array([*radec, *(np.nan if t is None else t for t in twist or [None])])
    )


def _from_sun(header: Header, keywords: KeywordMap, name: str) -> FloatArray | None:
    sun = _header_vector(header, keywords, name)
    return None if sun is None else -sun


def _header_vector(header: Header, keywords: KeywordMap, name: str) -> FloatArray | None:
    values = keywords.numbers(header, name)
    known = [v for v in values if v is not None]
    return np.array(known) if known and len(known) == len(values) else None


def _system_remarks(header: Header) -> tuple[str, ...]:
    system = header.get("RADESYS", header.get("RADECSYS"))
    if not isinstance(system, str) or system.strip().upper() in ("", "ICRS"):
        return ()
    return (SYSTEM_REMARK.format(system.strip()),)


# ---- From the Sun to the solar-system barycenter without kernels.


def barycentric_from_heliocentric(
    position_km: ArrayLike, velocity_km_s: ArrayLike, et: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Shift a state with respect to the Sun to one with respect to the solar-system barycenter, J2000.

    Parameters
    ----------
    position_km, velocity_km_s : (3,) or (n, 3) array_like
        With respect to the Sun.
    et : float or (n,) array_like
        TDB seconds past J2000.

    Returns
    -------
    position_km, velocity_km_s : arrays as given
        With respect to the solar-system barycenter.

    Notes
    -----
    Meant for 1900 to 2100, where the series holds.

    Examples
    --------
    >>> position, velocity = barycentric_from_heliocentric([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0)
    >>> from opnav_workbench.constants import SUN_RADIUS_KM
    >>> bool(np.linalg.norm(position) < 2.2 * SUN_RADIUS_KM)  # the Sun stays within two of its radii
    True
    """
    heliocentric, barycentric = erfa.epv00(J2000_JD, np.asarray(et, dtype=np.float64) / DAY_S)
    sun_km = (barycentric["p"] - heliocentric["p"]) * AU_KM
    sun_km_s = (barycentric["v"] - heliocentric["v"]) * AU_KM / DAY_S
    return np.asarray(position_km, float) + sun_km, np.asarray(velocity_km_s, float) + sun_km_s
