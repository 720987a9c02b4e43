"""Which words of a picture's header hold what: the usual ones, tried in order, with what was known and what was guessed.

Words of one meaning are tried in the order of the tables below: those that say more precisely what they hold come first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from opnav_workbench.camera import Origin
from opnav_workbench.camera.origins import How
from opnav_workbench.image import Header, KeywordMap
from opnav_workbench.image.header import OF_UNIT, stated_unit_s

__all__ = ["HeaderWords", "header_words", "instrument_words", "word_of_lines"]

EXPOSURES = {  # scale to seconds; None: the word itself does not say
    "XPOSURE": 1.0, "EXPTIME": 1.0, "EXPOSURE_S": 1.0, "EXPOSURE_DURATION": None, "EXPOSUREDURATION": None, "EXPOSURE": None,
    "EXP_TIME": None, "EXPOSURE_TIME": None, "INTEGRATION_DURATION": None,
}  # fmt: skip
TIMES = {  # what the word refers to; with ?: the word alone does not say
    "DATE-AVG": "middle", "SPCUTCAL": "middle", "IMAGE_MID_TIME": "middle", "MID_TIME": "middle", "DATE-BEG": "start",
    "START_TIME": "start", "STARTTIME": "start", "DATE-OBS": "start?", "DATE_OBS": "start?", "IMAGE_TIME": "middle?",
    "UTC": "middle?", "TIME": "middle?", "OBSERVATION_TIME": "middle?",
}  # fmt: skip
STOPS = ("STOP_TIME", "STOPTIME", "DATE-END")
QUATERNIONS = (
    (("SPCQA", "SPCQX", "SPCQY", "SPCQZ"), "camera_to_j2000"),
    (("QUAT0", "QUAT1", "QUAT2", "QUAT3"), ""),
    (("QW", "QX", "QY", "QZ"), ""),
    (("Q0", "Q1", "Q2", "Q3"), ""),
    (("QUATERNION_W", "QUATERNION_X", "QUATERNION_Y", "QUATERNION_Z"), ""),
    (("QUATERNION[1]", "QUATERNION[2]", "QUATERNION[3]", "QUATERNION[4]"), ""),
)
SUN_STATES = (
    (("SUNPOSX", "SUNPOSY", "SUNPOSZ"), ("SUNVELX", "SUNVELY", "SUNVELZ")),
    (("SPCSSCX", "SPCSSCY", "SPCSSCZ"), ("SPCSSCVX", "SPCSSCVY", "SPCSSCVZ")),
)
TARGETS = ("TARGET_NAME", "TARGETNAME", "TARGET", "OBJECT")
INSTRUMENTS = (
    "INSTRUMENT_ID",
    "INSTRUMENTID",
    "INSTRUME",
    "INSTRUMENT_NAME",
    "INSTRUMENTNAME",
    "INSTRU",
    "DETECTOR",
)
FILTERS = ("FILTER_NUMBER", "FILTERNUMBER", "FILTER_NAME", "FILTERNAME", "FILTER")
CRAFTS = (
    "INSTRUMENT_HOST_NAME", "SPACECRAFT_NAME", "SPACECRAFTNAME", "TELESCOP", "HOSTNAME", "MISSION", "MISSION_NAME",
)  # fmt: skip
LINE_COUNTS = ("NAXIS2", "LINES", "IMAGE_LINES", "NL")
CLOCKS = ("SPACECRAFT_CLOCK_START_COUNT", "SPACECRAFTCLOCKSTARTCOUNT", "SPCSCLK", "SCLK")
SCALES = (1.0, 1e-3, 1e-6)
SHORTEST_MS = 1.0  # few cameras expose less
ALIKE = 0.3  # an exposure may differ by this part from the time between its start and end: readout, rounding


@dataclass(frozen=True, slots=True)
class HeaderWords:
    """What a mission file says of header words, and how it is known.

    Attributes
    ----------
    keywords
        As in a mission file.
    match
        Word and value that tell the camera; empty where the header has none.
    spacecraft, utc
        What the header says of them; empty where it does not.
    exposure_s
    """

    keywords: dict[str, Any]
    match: dict[str, Any]
    spacecraft: str
    utc: str
    exposure_s: float | None
    origins: tuple[Origin, ...]


def header_words(values: Mapping[str, Any]) -> HeaderWords:
    """Return what the words of a header seem to hold.

    Examples
    --------
    >>> words = header_words({"EXPTIME": 2.0, "DATE-OBS": "2031-01-01T00:00:00", "TELESCOP": "PROBE", "OBJECT": "MARS"})
    >>> words.keywords["exposure_s"], words.keywords["time_reference"], words.spacecraft
    ('EXPTIME', 'start', 'PROBE')
    """
    header, origins = Header(values), list[Origin]()
    keywords: dict[str, Any] = {}
    craft = _first(header, CRAFTS)
    if craft:
        keywords["required"] = {craft: header[craft]}
        origins.append(Origin("required", "known", f"{craft} = {header[craft]}"))
    exposure_s = _exposure(header, keywords, origins)
    utc = _time(header, keywords, origins)
    _attitude(header, keywords, origins)
    for field, names in (("target", TARGETS), ("instrument", INSTRUMENTS), ("sclk", CLOCKS)):
        word = _first(header, names)
        if word:
            keywords[field] = word
            origins.append(Origin(field, "known", f"{word} = {header[word]}"))
    instrument = keywords.get("instrument")
    match = {} if instrument is None else {instrument: header[instrument]}
    return HeaderWords(keywords, match, str(header[craft]) if craft else "", utc, exposure_s, tuple(origins))


def instrument_words(header: Header) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what a header says of the instrument, and of the filter, that took its picture.

    Examples
    --------
    >>> instrument_words(Header({"INSTRUMENT_ID": "FC2", "FILTER_NUMBER": "6"}))
    (('FC2',), ('6',))
    """
    instruments, filters = (
        [str(header[name]).strip() for name in names if name in header] for names in (INSTRUMENTS, FILTERS)
    )
    return tuple(filter(None, instruments)), tuple(filter(None, filters))


def word_of_lines(header: Header, count: int) -> str:
    """Return the word by which a header tells how many lines its picture has; empty where none does.

    Examples
    --------
    >>> word_of_lines(Header({"NAXIS2": 5064}), 5064)
    'NAXIS2'
    """
    return next((name for name in LINE_COUNTS if _number(header, name) == count), "")


def _first(header: Header, names: tuple[str, ...]) -> str:
    """The first word of a list that the header has with a value."""
    return next((name for name in names if name in header and str(header[name]).strip()), "")


def _number(header: Header, name: str) -> float | None:
    try:
        return float(str(KeywordMap().known(header, name)).split()[0])
    except (ValueError, IndexError):
        return None


def _exposure(header: Header, keywords: dict[str, Any], origins: list[Origin]) -> float | None:
    for name, told in EXPOSURES.items():
        value = _number(header, name)
        if value is None or value < 0.0:
            continue
        scale, how, text = _scale(header, name, value, told)
        keywords["exposure_s"] = name
        if scale != 1.0:
            keywords["exposure_scale"] = scale
        origins.append(Origin("exposure_s", how, f"{name} = {value:g}, {text}"))
        return value * scale
    origins.append(Origin("exposure_s", "guessed", "no word of the header holds it"))
    return None


def _scale(header: Header, name: str, value: float, told: float | None) -> tuple[float, How, str]:
    """What an exposure is to be multiplied by for seconds, and how that is known."""
    unit_s = stated_unit_s(header, name)
    if unit_s is not None:
        return unit_s, "known", f"in {header[name + OF_UNIT]}"
    if told is not None:
        return told, "known", "in s"
    spanned = _spanned_s(header)
    for scale in SCALES:
        if spanned and abs(value * scale - spanned) < ALIKE * spanned:
            return scale, "derived", f"times {scale:g} s as from start to stop"
    of_pds = name in ("EXPOSURE_DURATION", "EXPOSUREDURATION")  # ms, where no unit says otherwise
    usual = 1e-3 if of_pds and value >= SHORTEST_MS else 1.0
    return usual, "guessed", f"taken as {'ms' if usual < 1.0 else 's'}"


def _spanned_s(header: Header) -> float:
    start, stop = _first(header, ("START_TIME", "STARTTIME", "DATE-BEG")), _first(header, STOPS)
    if not (start and stop):
        return 0.0
    try:
        ends = [datetime.fromisoformat(str(header[name]).strip().rstrip("Z")) for name in (start, stop)]
    except ValueError:
        return 0.0
    return (ends[1] - ends[0]).total_seconds()


def _time(header: Header, keywords: dict[str, Any], origins: list[Origin]) -> str:
    for name, reference in TIMES.items():
        if name in header and str(header[name]).strip():
            keywords["utc"], keywords["time_reference"] = name, reference.rstrip("?")
            how = f"{name} = {header[name]}, {keywords['time_reference']} of the exposure"
            origins.append(Origin("utc", "guessed" if reference.endswith("?") else "known", how))
            return str(header[name]).strip()
    return ""


def _attitude(header: Header, keywords: dict[str, Any], origins: list[Origin]) -> None:
    for names, sense in QUATERNIONS:
        if all(_number(header, name) is not None for name in names):
            keywords["quaternion"], keywords["quaternion_sense"] = list(names), sense or "j2000_to_camera"
            how = f"{', '.join(names)}, scalar first, {keywords['quaternion_sense']}"
            origins.append(Origin("quaternion", "known" if sense else "guessed", how))
            break
    for position, velocity in SUN_STATES:
        if all(_number(header, name) is not None for name in (*position, *velocity)):
            keywords["sun_position"], keywords["sun_velocity"] = list(position), list(velocity)
            origins.append(
                Origin(
                    "sun_position, sun_velocity", "known", f"{position[0]} ..., {velocity[0]} ..., km, km/s"
                )
            )
            return
