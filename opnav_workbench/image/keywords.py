"""Which header keywords hold what: the part of a mission file that speaks of pictures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal

from opnav_workbench.errors import MissionError
from opnav_workbench.image.frame import Header, HeaderValue
from opnav_workbench.image.masks import QUALITY_TABLES

__all__ = ["KeywordMap", "number"]

ABSENT_TEXTS = frozenset({"", "N/A", "NA", "UNK", "UNKNOWN", "NULL", "NONE", "TBD"})
ABSENT_NUMBERS = (-1e32, -999.0)  # New Horizons; many PDS3 products use the second
SAME_NUMBER = 1e-9  # relative: -1E+32 as printed and as read
CHOICES = {
    "quaternion_sense": ("camera_to_j2000", "j2000_to_camera"),
    "time_reference": ("middle", "start"),
    "quality_table": tuple(QUALITY_TABLES),
}
LENGTHS = {"quaternion": 4, "sun_position": 3, "sun_velocity": 3}


@dataclass(frozen=True, kw_only=True)
class KeywordMap:
    """Names of the header keywords that hold time, exposure, pointing and trajectory; every one is optional.

    Attributes
    ----------
    exposure_s : str
        Exposure time; times `exposure_scale` it is in seconds.
    et, utc, sclk : str
        Time of the picture: TDB seconds past J2000, UTC text, spacecraft clock.
    time_reference : {"middle", "start"}
        What `et` and `utc` refer to; a start time is shifted by half the exposure.
    quaternion : sequence of 4 str
        SPICE order, scalar first; its sense is `quaternion_sense`.
    sun_position, sun_velocity : sequence of 3 str
        Sun with respect to the spacecraft, km and km/s, J2000.
    target, instrument, geometry_quality : str
        Text about the picture.
    bits : str
        Bits of the digitizer: the highest value that they can hold is saturated.
    image_extension, error_extension, quality_extension : str or int
        FITS extensions by name or index; the image is the first two-dimensional one unless named.
    quality_table : str
        Name of a table in `opnav_workbench.image.masks.QUALITY_TABLES`.
    expansion_keyword : str
        Says how values were squeezed on board; `expansion` has the table of what it may say.
    expansion : mapping of str to sequence of float
        DN by stored value.
    dark_columns : mapping of int to int
        Width of a raw frame to the number of dark columns at its right end, which are cut off.
    housekeeping_pixels : int
        Pixels at the start of line 0 that carry telemetry instead of sky.
    required : mapping of str to value or values
        Keywords that tell this mission's frames from others.
    missing_values : sequence of float
        Numbers that mean "no value".

    Raises
    ------
    MissionError
        A field has a value that it cannot have; the message names it.

    Examples
    --------
    >>> KeywordMap(exposure_s="EXPTIME").value(Header({"EXPTIME": 0.5}), "exposure_s")
    0.5
    """

    exposure_s: str | None = None
    exposure_scale: float = 1.0
    et: str | None = None
    utc: str | None = None
    sclk: str | None = None
    time_reference: Literal["middle", "start"] = "middle"
    quaternion: Sequence[str] | None = None
    quaternion_sense: Literal["camera_to_j2000", "j2000_to_camera"] = "camera_to_j2000"
    sun_position: Sequence[str] | None = None
    sun_velocity: Sequence[str] | None = None
    target: str | None = None
    instrument: str | None = None
    geometry_quality: str | None = None
    bits: str | None = None
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
            _refuse_unless(
                getattr(self, name) in choices, name, getattr(self, name), "one of " + ", ".join(choices)
            )
        for name, length in LENGTHS.items():
            value = getattr(self, name)
            good = value is None or (not isinstance(value, str) and len(value) == length)
            _refuse_unless(good, name, value, f"a list of {length} keywords")
        scale = self.exposure_scale
        _refuse_unless(0.0 < scale < math.inf, "exposure_scale", scale, "a positive number of seconds")
        for item in fields(self):
            object.__setattr__(self, item.name, _frozen(getattr(self, item.name)))

    def value(self, header: Header, name: str) -> HeaderValue | None:
        """Return what the header says for a field of this map, None where it says nothing or "missing"."""
        keyword = getattr(self, name)
        return None if keyword is None else self.known(header, keyword)

    def known(self, header: Header, keyword: str) -> HeaderValue | None:
        """Return the value of a header keyword, None where it is absent or stands for "missing"."""
        value = header.get(keyword)
        if isinstance(value, str):
            text = value.strip()
            return None if text.upper() in ABSENT_TEXTS else text
        if value is None or isinstance(value, bool):
            return value
        absent = any(math.isclose(value, gone, rel_tol=SAME_NUMBER) for gone in self.missing_values)
        return None if absent else value


def number(value: HeaderValue | None) -> float | None:
    """Return a header value as a float, None where it is absent or no number ("8.87E-5 " is one)."""
    try:
        return None if value is None or isinstance(value, bool) else float(value)
    except ValueError:
        return None


def _refuse_unless(good: bool, name: str, value: Any, wanted: str) -> None:
    if not good:
        raise MissionError(f"keywords: {name} is {value!r}, expected {wanted}.")


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return MappingProxyType(dict(value))
    return tuple(value) if isinstance(value, list | tuple) else value
