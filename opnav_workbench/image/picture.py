"""A picture in memory, and how it comes from a file: pixels, masks, exposure, mid-exposure time, header pointing.

Flow    file -> `StoredPicture` (`formats`) -> planes and masks (`planes`) -> time, pointing (`header`) -> `Picture`

Enter by `read_image`. Times are mid-exposure: a start time is shifted by half the exposure. Two statements of time in one
header must agree to their last printed digits; what contradicts itself is kept as such (`contradictions`). Warnings of the
libraries below do not escape; they end in ``Picture.messages``.
"""

import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import ImageError, plain_line
from opnav_workbench.files import sha256_of
from opnav_workbench.geometry.times import et_from_text, text_from_et
from opnav_workbench.image.contradictions import check_exposure, check_order, time_tolerance_s
from opnav_workbench.image.file_bytes import file_bytes, image_error
from opnav_workbench.image.formats import StoredPicture, read_stored
from opnav_workbench.image.header import (
    Header,
    HeaderGeometry,
    HeaderValue,
    KeywordMap,
    bare_word,
    header_geometry,
    header_matches,
    header_number,
    stated_unit_s,
    unread_units,
    unread_words,
)
from opnav_workbench.image.planes import make_planes

__all__ = ["Picture", "StatedSpan", "picture_from_stored", "read_image", "stated_span"]


# ---- A picture in memory: pixels, masks and what the header says of time and pointing.


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture with its masks, time and header; arrays are read-only and indexed ``[line, pixel]``.

    Attributes
    ----------
    sha256
        Of the file that holds the pixels.
    image_dn : (n_line, n_pixel) array
        Native float64; 0 in pixels without a value, which are `bad` too.
    error_dn : (n_line, n_pixel) array or None
        One-sigma error as the file has it, positive everywhere. For the reader: measurements take `pixel_noise`,
        which knows what this picture's sky really scatters by.
    bad, saturated : (n_line, n_pixel) bool arrays
        Pixels not to use, and pixels whose value is only a lower bound. A saturated pixel need not be bad.
    exposure_s
        nan where no keyword for it is known.
    et
        Mid-exposure, TDB seconds past J2000.
    utc
        Mid-exposure, ISO calendar.
    sclk
        Spacecraft clock as the header has it, never shifted to mid-exposure.
    messages
        What a navigator should know about the file: masked pixels, departures from the standard, doubts.
    contradictions
        Which of the header's facts contradict each other, or cannot be (see `opnav_workbench.image.contradictions`); but
        for ET against UTC, on which a clock may decide: `rival_et`.
    rival_et
        Mid-exposure by the header's UTC, where its ET states another time; None where they agree.
    keywords
        Under which its words were found: the mission's, and those of a sidecar; None: not read from a file.
    """

    path: Path
    sha256: str
    image_dn: FloatArray
    error_dn: FloatArray | None
    bad: BoolArray
    saturated: BoolArray
    header: Header
    exposure_s: float
    et: float | None
    utc: str | None
    sclk: str | None
    header_geometry: HeaderGeometry | None
    messages: tuple[str, ...]
    contradictions: tuple[str, ...] = ()
    rival_et: float | None = None
    keywords: KeywordMap | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def name(self) -> str:
        """The file's name as people and tables read it: what is no text in it is written as such (see `plain_line`)."""
        return plain_line(self.path.name)

    def with_saturated(self, saturated: ArrayLike) -> "Picture":
        """Return the same picture with another saturation mask.

        Raises
        ------
        ImageError
            The mask has another shape than the picture.
        """
        mask = np.array(saturated, dtype=bool)
        if mask.shape != self.image_dn.shape:
            raise ImageError(
                f"{self.name}: a saturation mask of shape {mask.shape} does not fit a picture of shape "
                f"{self.image_dn.shape}; give one flag a pixel."
            )
        return replace(self, saturated=mask)


# ---- From the arrays and header of a file to a `Picture`: mission, planes, exposure, mid-exposure time.

# s past J2000: from Sputnik's launch to a century and a half of J2000 on; other numbers count something else.
FIRST_PICTURE_ET, LAST_PICTURE_ET = -1_333_000_000.0, 4_733_000_000.0
ISO_CALENDAR = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d+)?")


def picture_from_stored(
    path: Path, sha256: str, source: StoredPicture, keywords: KeywordMap, saturation_dn: float | None
) -> Picture:
    """Make a `Picture` of what a reader found.

    Raises
    ------
    ImageError
        See `read_image`.
    """
    name, header = path.name, Header(source.header)
    keywords = source.keywords or keywords
    _check_mission(name, header, keywords)
    planes = make_planes(name, source, header, keywords, saturation_dn)
    exposure_s = _exposure(name, header, keywords)
    time = _time(name, header, keywords, exposure_s)
    times = [et for et in (time.et, time.rival_et) if et is not None]
    read = header_geometry(header, keywords, times)
    sclk = keywords.value(header, "sclk")
    wrong = (
        *_exposure_contradictions(header, keywords, exposure_s, time),
        *_order_contradictions(header, keywords, time),
        *read.contradictions,
        *unread_units(header, keywords),
        *_clock_contradictions(header, keywords, sclk),
        *_repeated_words(header, keywords, source.repeated),
    )
    return Picture(
        path=path,
        sha256=sha256,
        image_dn=planes.image_dn,
        error_dn=planes.error_dn,
        bad=planes.bad,
        saturated=planes.saturated,
        header=Header(source.header | _size_words(planes.image_dn.shape)),
        exposure_s=exposure_s,
        et=time.et,
        utc=time.utc,
        sclk=None if sclk is None else str(sclk),
        header_geometry=read.geometry,
        messages=(*planes.messages, *time.messages, *read.messages, *wrong),
        contradictions=(*time.contradictions, *wrong),
        rival_et=time.rival_et,
        keywords=keywords,
    )


def _repeated_words(
    header: Header, keywords: KeywordMap, repeated: Mapping[str, HeaderValue]
) -> tuple[str, ...]:
    """Return a line for each word of the mission's that the header has twice with different values."""
    asked = {word for field in fields(keywords) for word in _words_in(getattr(keywords, field.name))}
    return tuple(
        f"{word} stands twice in the header, as {header[word]!r} and {other!r}; the first is used"
        for word, other in repeated.items()
        if word in asked
    )


def _words_in(value: object) -> tuple[str, ...]:
    """Return the keywords in a field of a keyword map, without signs and numbers of pieces."""
    listed = value if isinstance(value, tuple) else value.keys() if isinstance(value, Mapping) else (value,)
    return tuple(bare_word(word)[0].split("[")[0].upper() for word in listed if isinstance(word, str))


CLOCK_READING = re.compile(r"(?:\d+/)?(?P<seconds>\d+)")
CLOCK_S = 2.0  # a count of whole seconds, begin and end counted likewise


def _clock_contradictions(header: Header, keywords: KeywordMap, sclk: HeaderValue | None) -> tuple[str, ...]:
    """Return what a clock reading says against itself, or against a begin and end that are counts of the same clock."""
    if sclk is None:
        return ()
    reading = CLOCK_READING.search(str(sclk))
    if reading is None:
        return (f"{keywords.sclk} = {sclk!r} is no reading of a clock",)
    span = [header_number(keywords.value(header, name)) for name in ("begin", "end")]
    known = [seconds for seconds in span if seconds is not None]
    if len(known) < len(span) or min(known) - CLOCK_S <= float(reading["seconds"]) <= max(known) + CLOCK_S:
        return ()
    span_words = f"{keywords.begin} = {known[0]:.12g} to {keywords.end} = {known[1]:.12g}"
    return (f"the clock reading {keywords.sclk} = {sclk} lies outside {span_words}",)


def _size_words(shape: tuple[int, ...]) -> dict[str, HeaderValue]:
    """Return words by which a mission tells cameras whose pictures differ in their size: what was read, not what is said."""
    return {"PICTURE.LINES": shape[0], "PICTURE.SAMPLES": shape[1]}


def _check_mission(name: str, header: Header, keywords: KeywordMap) -> None:
    for keyword, wanted in keywords.required.items():
        found = header.get(keyword)
        if not header_matches(found, wanted):
            choices = wanted if isinstance(wanted, list | tuple) else (wanted,)
            expected = " or ".join(repr(choice) for choice in choices)
            state = f"has {keyword} = {found!r}" if found is not None else f"has no {keyword}"
            raise image_error(
                name,
                f"is not a frame of this mission: its header {state}, expected {expected}; choose the "
                "mission file that describes this picture (--mission).",
            )


def _exposure(name: str, header: Header, keywords: KeywordMap) -> float:
    if keywords.exposure_s is None:
        return math.nan
    value = keywords.value(header, "exposure_s")
    seconds = header_number(value)
    if seconds is None:
        raise image_error(
            name,
            f"no exposure time: {keywords.exposure_s} is {value!r}; correct the header or the mission file.",
        )
    if not 0.0 < seconds < math.inf:
        raise image_error(
            name,
            f"exposure time {keywords.exposure_s} = {value!r} is not positive; leave this picture out.",
        )
    unit_s = stated_unit_s(header, keywords.exposure_s)
    return seconds * (keywords.exposure_scale if unit_s is None else unit_s)


@dataclass(frozen=True, slots=True)
class _StatedTime:
    """Mid-exposure et and UTC, None where only a clock is known; `rival_et`: by the UTC, where that is another time."""

    et: float | None
    utc: str | None
    messages: tuple[str, ...] = ()
    rival_et: float | None = None
    contradictions: tuple[str, ...] = ()


def _time(name: str, header: Header, keywords: KeywordMap, exposure_s: float) -> _StatedTime:
    et, impossible = _stated_et(name, header, keywords)
    text = keywords.value(header, "utc")
    stated = None if text is None else _et_of(name, str(text), header, keywords)
    known = et if et is not None else stated
    if known is None:
        return _StatedTime(None, None, (*impossible, _without_time(name, header, keywords)), None, impossible)
    if not FIRST_PICTURE_ET < known < LAST_PICTURE_ET:
        raise image_error(
            name, f"{keywords.utc} = {text!r} is no date of a picture from space; correct the header."
        )
    shift_s = _to_middle_s(name, header, keywords, exposure_s)
    off = 0.0 if stated is None else known - stated
    agree = abs(off) <= time_tolerance_s(text, keywords.value(header, "et"))
    as_stated = agree and shift_s == 0.0 and _scale_of(header, keywords.utc) == "utc"
    keep = as_stated and text is not None and ISO_CALENDAR.fullmatch(str(text))
    utc = str(text) if keep else _utc_of(name, known + shift_s)
    if agree or stated is None:
        return _StatedTime(known + shift_s, utc, impossible, None, impossible)
    differ = f"{keywords.et} and {keywords.utc} differ by {off:+.3f} s"
    return _StatedTime(known + shift_s, utc, (differ,), stated + shift_s)


def _stated_et(name: str, header: Header, keywords: KeywordMap) -> tuple[float | None, tuple[str, ...]]:
    """Return what the header states as ET, None where that is no time of a picture, and why."""
    et = header_number(keywords.value(header, "et"))
    if et is None or not math.isfinite(et):
        return None, unread_words(header, keywords, ("et",))
    if FIRST_PICTURE_ET < et < LAST_PICTURE_ET:
        return et, ()
    if keywords.value(header, "utc") is None:
        raise image_error(
            name,
            f"{keywords.et} = {et:g} s past J2000 is no date of a picture from space; correct the header.",
        )
    return None, (f"{keywords.et} = {et:g} is no date of a picture from space; {keywords.utc} is used",)


# What FITS calls the scales of time (`TIMESYS`, of its words that begin with DATE), as `et_from_text` calls them.
TIME_SCALES = {
    **dict.fromkeys(("UTC", "UT", "GMT", ""), "utc"), **dict.fromkeys(("TT", "TDT"), "tt"),
    **dict.fromkeys(("TDB", "ET"), "tdb"), "TAI": "tai", "IAT": "tai",
}  # fmt: skip


def _scale_of(header: Header, keyword: str | None) -> str | None:
    """Return the scale of a word's time: UTC, unless ``TIMESYS`` says otherwise of a FITS word; None: unknown."""
    of_fits = str(keyword).upper().startswith("DATE")
    stated = str(header.get("TIMESYS", "")).strip().upper() if of_fits else ""
    return TIME_SCALES.get(stated)


def _et_of(name: str, text: str, header: Header, keywords: KeywordMap) -> float:
    scale = _scale_of(header, keywords.utc)
    if scale is None:
        raise image_error(
            name,
            f"TIMESYS = {header['TIMESYS']!r} is no scale of time that is known; state {keywords.utc} in UTC, TT or TDB.",
        )
    try:
        return et_from_text(text, scale)
    except ValueError as error:
        raise image_error(
            name, f"{keywords.utc} = {text!r} is no UTC ({error}); correct the header."
        ) from error


def _utc_of(name: str, et: float) -> str:
    try:
        return text_from_et(et)
    except (ValueError, OverflowError) as error:
        raise image_error(
            name, f"the time {et:g} s past J2000 is no date ({error}); correct the header."
        ) from error


# What the standards of files call the begin and the end of an exposure (FITS 4.0, PDS data dictionary).
STANDARD_SPANS = (("DATE-BEG", "DATE-END"), ("START_TIME", "STOP_TIME"))


def _exposure_contradictions(
    header: Header, keywords: KeywordMap, exposure_s: float, time: _StatedTime
) -> list[str]:
    if math.isnan(exposure_s) or keywords.exposure_s is None:
        return []
    span = stated_span(header, keywords)
    if span is None:
        return check_exposure(keywords.exposure_s, exposure_s, None, 0.0, math.nan)
    tolerance_s, middle_s = time_tolerance_s(*span.stated), math.nan
    if time.et is not None and all(isinstance(value, str) for value in span.stated):
        tolerance_s, middle_s = time_tolerance_s(*span.stated, time.utc), time.et
    return check_exposure(keywords.exposure_s, exposure_s, span.seconds, tolerance_s, middle_s)


def _order_contradictions(header: Header, keywords: KeywordMap, time: _StatedTime) -> list[str]:
    if time.et is None:
        return []

    def seconds_of(word: str) -> tuple[HeaderValue, float] | None:
        names = [name for name in (word, word.replace("_", "")) if name not in (keywords.utc, keywords.et)]
        value = next((v for name in names if (v := keywords.known(header, name)) is not None), None)
        seconds = _seconds(value, "utc") if isinstance(value, str) else None
        return None if value is None or seconds is None else (value, seconds)

    span = stated_span(header, keywords)
    calendar = span is not None and all(isinstance(value, str) for value in span.stated)
    known = span if calendar else None  # a clock's counts are on no common scale
    tolerance_s = 0.0 if known is None else time_tolerance_s(*known.stated)
    return check_order(time.et, seconds_of, None if known is None else known.seconds, tolerance_s)


class StatedSpan(NamedTuple):
    """When an exposure began and ended: as the header states it, and in seconds of one scale."""

    stated: tuple[HeaderValue | None, HeaderValue | None]
    seconds: tuple[float, float]


def stated_span(header: Header, keywords: KeywordMap) -> StatedSpan | None:
    """Return begin and end of an exposure by the mission's words or the standards'; None where the header has neither."""
    named = (keywords.begin, keywords.end)
    for begin, end in (*([named] if all(named) else []), *STANDARD_SPANS):
        stated = (keywords.known(header, str(begin)), keywords.known(header, str(end)))
        first, last = (_seconds(value, _scale_of(header, begin) or "utc") for value in stated)
        if first is not None and last is not None:
            return StatedSpan(stated, (first, last))
    return None


def _seconds(value: HeaderValue | None, scale: str) -> float | None:
    """Return a time as seconds: past J2000, or of a clock's count; None where it is neither."""
    if isinstance(value, str) and ":" in value:
        with suppress(ValueError):
            return et_from_text(value, scale)
        return None
    seconds = header_number(value)
    return seconds if seconds is not None and math.isfinite(seconds) else None


def _to_middle_s(name: str, header: Header, keywords: KeywordMap, exposure_s: float) -> float:
    if math.isnan(exposure_s) and keywords.time_reference != "middle":
        raise image_error(
            name,
            f"the header gives the {keywords.time_reference} of the exposure, not its length; name that keyword in the "
            "mission.",
        )
    to_frame_s = keywords.to_frame_s(header)
    if to_frame_s is None or not math.isfinite(to_frame_s):
        raise image_error(
            name,
            f"its time is that of the first of several frames, and {keywords.frame} and {keywords.frame_interval} do not "
            "tell when this one began; correct the header.",
        )
    return keywords.to_middle_s(exposure_s) + to_frame_s


def _without_time(name: str, header: Header, keywords: KeywordMap) -> str:
    looked_for = [k for k in (keywords.et, keywords.utc, keywords.sclk) if k]
    if looked_for and keywords.value(header, "sclk") is None:
        raise image_error(
            name,
            f"no time in the header: looked for {', '.join(looked_for)}; correct it or the mission file.",
        )
    return "no time in the header but the spacecraft clock" if looked_for else "no time keyword is known"


# ---- From a file to a `Picture`.


def read_image(
    path: str | os.PathLike[str], keywords: KeywordMap, *, saturation_dn: float | None = None
) -> Picture:
    """Read a picture, told by content: FITS (also gzipped), VICAR, PDS3, PDS4, ISIS cube, PNG, TIFF, JPEG; raw by sidecar.

    Parameters
    ----------
    path : path-like
        Image file, or the label or sidecar beside it.
    keywords
        Which header keywords hold time, exposure and pointing.
    saturation_dn
        Pixels at or above this value count as saturated.

    Raises
    ------
    ImageError
        One line with the file's name, what is wrong and what to do: missing, empty, truncated or damaged
        file, unknown format, no picture, a cube, no usable pixel, another mission's picture, no time, bad
        exposure.

    Notes
    -----
    Warnings of the libraries below do not escape; they end in ``Picture.messages``.
    """
    file = Path(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = file_bytes(file)
        pixels, source = read_stored(file, data, keywords)
        digest = hashlib.sha256(data).hexdigest() if pixels == file else sha256_of(pixels)
        picture = picture_from_stored(pixels, digest, source, keywords, saturation_dn)
    return replace(picture, messages=(*picture.messages, *_remarks(caught)))


DUBIOUS = '"dubious year'  # as ERFA says it, once for each of its steps
BEYOND = "the time lies beyond the leap seconds that are known: UTC may be a second off"


def _remarks(caught: Iterable[warnings.WarningMessage]) -> tuple[str, ...]:
    texts = (" ".join(str(warning.message).split()) for warning in caught)
    return tuple(
        dict.fromkeys(BEYOND if DUBIOUS in text else f"remark while reading: {text}" for text in texts)
    )
