"""Observables as a CCSDS Tracking Data Message: right ascension and declination of each body, and its range.

Reference: CCSDS 503.0-B-2, Tracking Data Message, Blue Book, Issue 2 (2020), keyword-value notation.

The standard has no pixels (1.2.5 d) and no covariances. Angles are those of the observed center through the solved
attitude; their covariance, with the pointing's share, stands in comments at the head of the data, which a reader may
ignore. One segment holds one target, one method and one quality, for a keyword may carry a time only once in a segment,
and degraded data belong in segments of their own (3.4.11, table 3-3).

`parse_tdm` and `read_tdm` read any of the standard's messages (sections 3 and 4); `tdm_table` takes the angles out, and the
covariances from the comments of our own.

The reader is our own and not ccsds-ndm's, which is in a 0.0 version, gives no place for keywords of other issues of the
standard, and is what the tests hold the writer against: one library on both sides would prove nothing.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.errors import SessionError
from opnav_workbench.files import text_of, write_text
from opnav_workbench.format_versions import FORMAT_KEY, PRESENT_VERSION
from opnav_workbench.geometry.times import et_from_text, text_from_et
from opnav_workbench.observables.explanation import ASTROMETRIC, Origin, origin_lines
from opnav_workbench.observables.observable import Observable
from opnav_workbench.version import __version__

__all__ = ["TdmOptions", "TrackingMessage", "parse_tdm", "read_tdm", "tdm_table", "tdm_text", "write_tdm"]


# ---- Observables as a CCSDS Tracking Data Message.

TDM_VERSION = "2.0"
TIME_DECIMALS = 6  # of a second; a spacecraft moves centimeters in a microsecond
ANGLE_DECIMALS = 13  # with three digits before the point the standard's sixteen (4.3.4): 4e-10 arcsec
TDM_LINE_LENGTH = 254  # 4.2.1
TDM_FRAMES = ("ICRF", "EME2000")
TDM_ABERRATIONS = ("removed", "kept")
TDM_QUALITY = {"ok": "RAW", "uncertain": "DEGRADED"}  # other statuses have no center
VALIDATED = "VALIDATED"  # said by a person, of what is "ok"


@dataclass(frozen=True, slots=True)
class TdmOptions:
    """What a message says beside the observables.

    Attributes
    ----------
    observer
        Spacecraft, for observables that do not name theirs.
    originator
        Agency, as registered with SANA.
    aberration : {"removed", "kept"}
        Angles with stellar aberration removed (comparable with star catalogs) or as seen.
    frame : {"ICRF", "EME2000"}
        Name of the reference frame. SPICE's J2000 has the axes of the ICRF; 23 mas from EME2000 taken by the letter.
    creation_date
        UTC; empty for now.
    message_id
        Left out when empty.
    comments
        For the header.
    validated_by
        Who has looked at the observables: what is "ok" is then ``VALIDATED``. Without a name it is ``RAW``, for no program
        can vouch for itself; what is "uncertain" is ``DEGRADED`` in either case.
    """

    observer: str = ""
    originator: str = "OPNAV_WORKBENCH"
    aberration: str = "removed"
    frame: str = "ICRF"
    creation_date: str = ""
    message_id: str = ""
    comments: tuple[str, ...] = ()
    validated_by: str = ""

    def __post_init__(self) -> None:
        for name, allowed in (("aberration", TDM_ABERRATIONS), ("frame", TDM_FRAMES)):
            if getattr(self, name) not in allowed:
                raise SessionError(
                    f"unknown {name} {getattr(self, name)!r}; choose one of {', '.join(allowed)}."
                )


def tdm_text(
    observables: Sequence[Observable], options: TdmOptions | None = None, origins: Sequence[Origin] = ()
) -> str:
    """Return the message; observables without a center are left out. Comments say how they came about (`origins`).

    Raises
    ------
    SessionError
        No observable has a center, or the spacecraft is not known.
    """
    options = options or TdmOptions()
    segments = _segments(observables)
    if not segments:
        raise SessionError(
            f"none of {len(observables)} observables has a center with status ok or uncertain and a direction on the sky; "
            "a tracking data message needs one."
        )
    lines = [
        *_header_lines(options, origins),
        *(line for group in segments for line in _segment_lines(group, options)),
    ]
    return "\n".join(_ascii(line) for line in lines) + "\n"


def write_tdm(
    observables: Sequence[Observable],
    path: str | Path,
    origins: Sequence[Origin] = (),
    options: TdmOptions | None = None,
) -> None:
    """Write observables as a CCSDS Tracking Data Message (KVN), whole or not at all; see `tdm_text`."""
    write_text(path, tdm_text(observables, options, origins))


def _segments(observables: Sequence[Observable]) -> list[list[Observable]]:
    """Groups of one spacecraft, target, method and quality, in time order, none with a time twice."""
    usable = [o for o in observables if o.has_direction and o.status in TDM_QUALITY]
    groups: dict[tuple[str, ...], list[list[Observable]]] = {}
    for o in sorted(usable, key=lambda o: o.et):
        layers = groups.setdefault((o.observer, o.name, o.method, o.status), [])
        for layer in layers:
            if _time_tag(layer[-1]) != _time_tag(o):
                layer.append(o)
                break
        else:
            layers.append([o])
    return [layer for key in sorted(groups) for layer in groups[key]]


def _header_lines(options: TdmOptions, origins: Sequence[Origin]) -> Iterable[str]:
    yield f"CCSDS_TDM_VERS = {TDM_VERSION}"
    yield from (f"COMMENT {words}" for words in options.comments)
    yield f"COMMENT Written by opnav_workbench {__version__}, {FORMAT_KEY} {PRESENT_VERSION['observables']}"
    yield from (f"COMMENT {line}" for line in origin_lines(origins))
    yield f"CREATION_DATE = {options.creation_date or datetime.now(UTC).strftime('%Y-%m-%dT%H:%M:%S')}"
    yield f"ORIGINATOR = {options.originator}"
    if options.message_id:
        yield f"MESSAGE_ID = {options.message_id}"


def _segment_lines(group: Sequence[Observable], options: TdmOptions) -> Iterable[str]:
    first, last = group[0], group[-1]
    with_range = any(np.isfinite(o.measured_range_km) for o in group)
    yield from ("", "META_START", *_convention_comments(first, options, with_range))
    yield f"TRACK_ID = {_tdm_name(first.name)}_{first.method}_{_time_tag(first)}"
    yield f"DATA_TYPES = ANGLE_1,ANGLE_2{',RANGE' if with_range else ''}"
    yield "TIME_SYSTEM = UTC"
    yield f"START_TIME = {_time_tag(first)}"
    yield f"STOP_TIME = {_time_tag(last)}"
    yield f"PARTICIPANT_1 = {_observer_name(first, options)}"
    yield f"PARTICIPANT_2 = {_tdm_name(first.name)}"
    yield "MODE = SEQUENTIAL"
    yield "PATH = 2,1"  # light goes from the target to the camera
    yield "TIMETAG_REF = RECEIVE"
    if with_range:
        yield "RANGE_UNITS = km"
    yield "ANGLE_TYPE = RADEC"
    yield f"REFERENCE_FRAME = {options.frame}"
    yield f"DATA_QUALITY = {_quality(first, options)}"
    yield from ("META_STOP", "DATA_START")
    yield "COMMENT COVARIANCE time, of RA cos(Dec) | RA cos(Dec) with Dec | Dec, arcsec**2; sigma of range, km; picture"
    yield from (_covariance_comment(o) for o in group)
    for o in group:
        yield from _data_lines(o, options)
    yield "DATA_STOP"


def _quality(first: Observable, options: TdmOptions) -> str:
    return VALIDATED if options.validated_by and first.status == "ok" else TDM_QUALITY[first.status]


def _convention_comments(first: Observable, options: TdmOptions, with_range: bool) -> Iterable[str]:
    yield f"COMMENT Center of figure of {first.name}, measured in pictures with stars, method {first.method}"
    if options.aberration == "removed":
        yield f"COMMENT Angles are {ASTROMETRIC}"
        yield "COMMENT Stellar aberration is removed as SPICE's STELAB has it, spacecraft relative to the SSB"
    else:
        yield "COMMENT Angles are apparent, as seen: stellar aberration is not removed"
        yield "COMMENT The body is seen where it was one light time before the time tag"
    yield "COMMENT Axes of the frame are those of SPICE's J2000 (ICRF)"
    yield "COMMENT Time tags are the middle of the exposure, at the spacecraft, in UTC"
    if options.validated_by and first.status == "ok":
        yield f"COMMENT Validated by {options.validated_by}"
    if with_range:
        yield "COMMENT Range is from the measured size of the body, its radius taken as known"


def _data_lines(o: Observable, options: TdmOptions) -> Iterable[str]:
    removed = options.aberration == "removed"
    ra, dec = (o.ra_deg, o.dec_deg) if removed else (o.apparent_ra_deg, o.apparent_dec_deg)
    yield f"ANGLE_1 = {_time_tag(o)} {_angle(ra)}"
    yield f"ANGLE_2 = {_time_tag(o)} {_angle(dec)}"
    if np.isfinite(o.measured_range_km):
        yield f"RANGE = {_time_tag(o)} {o.measured_range_km:.15E}"


def _covariance_comment(o: Observable) -> str:
    known = o.residual_covariance_arcsec2
    matrix = np.full((2, 2), np.nan) if known is None else known
    numbers = (matrix[0, 0], matrix[0, 1], matrix[1, 1], o.range_sigma_km)
    words = " ".join(repr(float(n)) if np.isfinite(n) else "-" for n in numbers)
    return f"COMMENT COVARIANCE {_time_tag(o)} {words} {o.image}"


def _observer_name(first: Observable, options: TdmOptions) -> str:
    name = first.observer or options.observer
    if not name:
        raise SessionError(
            f"the observables of {first.image} do not name their spacecraft; say it (--spacecraft NAME)."
        )
    return _tdm_name(name)


def _tdm_name(text: str) -> str:
    return "_".join(text.split())  # an underscore counts as a blank (4.3.8)


def _time_tag(o: Observable) -> str:
    return text_from_et(o.et, TIME_DECIMALS)


def _angle(degrees: float) -> str:
    text = f"{degrees:.{ANGLE_DECIMALS}f}"
    return f"{0.0:.{ANGLE_DECIMALS}f}" if abs(float(text)) in (0.0, 360.0) else text


def _ascii(line: str) -> str:
    """Only printable ASCII, and no line longer than the standard allows (4.2.1)."""
    plain = line.encode("ascii", "replace").decode("ascii")
    return "".join(c if c.isprintable() else "?" for c in plain)[:TDM_LINE_LENGTH]


# ---- Reading a CCSDS Tracking Data Message (KVN): any of the standard's messages, and the angles of ours.

TDM_ASSIGNMENT = re.compile(r"([A-Z0-9_]+)\s*=\s*(\S.*)")
TDM_DELIMITERS = ("META_START", "META_STOP", "DATA_START", "DATA_STOP")
HEADER, METADATA, BETWEEN, DATA = "header", "metadata", "between metadata and data", "data"
# What each delimiter ends and begins.
TDM_TURNS = {
    "META_START": (HEADER, METADATA),
    "META_STOP": (METADATA, BETWEEN),
    "DATA_START": (BETWEEN, DATA),
    "DATA_STOP": (DATA, HEADER),
}


@dataclass(frozen=True, slots=True)
class TdmRecord:
    """One measurement: keyword, time tag as written, value."""

    keyword: str
    time: str
    value: float


@dataclass(frozen=True, slots=True)
class TdmSegment:
    """Metadata by keyword, records in the order of the file, comments of both sections."""

    metadata: Mapping[str, str]
    records: tuple[TdmRecord, ...]
    comments: tuple[str, ...] = ()
    data_comments: tuple[str, ...] = ()

    def participants(self) -> tuple[str, ...]:
        """Return the participants along the signal's path, transmitter first; blanks for underscores."""
        path = [f"PARTICIPANT_{n.strip()}" for n in self.metadata.get("PATH", "1").split(",")]
        return tuple(self.metadata.get(key, "").replace("_", " ") for key in path)


@dataclass(frozen=True, slots=True)
class TrackingMessage:
    """A tracking data message: header by keyword, comments, segments."""

    header: Mapping[str, str]
    comments: tuple[str, ...]
    segments: tuple[TdmSegment, ...]


@dataclass(slots=True)
class _MessageDraft:
    header: dict[str, str] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)
    segments: list[TdmSegment] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    notes: dict[str, list[str]] = field(default_factory=dict)
    records: list[TdmRecord] = field(default_factory=list)


def read_tdm(path: str | Path) -> TrackingMessage:
    """Read a tracking data message in keyword-value notation.

    Raises
    ------
    SessionError
        The file cannot be read or breaks the standard's syntax; the message names the line.
    """
    try:
        text = text_of(path)
        text.encode("ascii")
    except (OSError, ValueError) as error:
        raise SessionError(
            f"no tracking data message can be read from {path}: {error}. Give a file in keyword-value notation."
        ) from error
    return parse_tdm(text, str(path))


def parse_tdm(text: str, source: str = "message") -> TrackingMessage:
    """Parse the text of a message; see `read_tdm`.

    Examples
    --------
    >>> lines = ("CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2015-07-13T00:00:00", "ORIGINATOR = KINETX")
    >>> parse_tdm(chr(10).join(lines)).header["ORIGINATOR"]
    'KINETX'
    """
    draft, section = _MessageDraft(), HEADER
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.strip()
        if words in TDM_DELIMITERS:
            ends, begins = TDM_TURNS[words]
            if section != ends:
                raise SessionError(f"{source}, line {number}: {words} in the {section} section.")
            section = begins
            _change_section(draft, words)
        elif words:
            _read_line(draft, section, words, f"{source}, line {number}")
    if section != HEADER or "CCSDS_TDM_VERS" not in draft.header:
        raise SessionError(
            f"{source} is no complete tracking data message (it ends in the {section} section)."
        )
    return TrackingMessage(MappingProxyType(draft.header), tuple(draft.comments), tuple(draft.segments))


def _change_section(draft: _MessageDraft, word: str) -> None:
    if word == "META_START":
        draft.metadata, draft.notes, draft.records = {}, {METADATA: [], DATA: []}, []
    elif word == "DATA_STOP":
        notes = (tuple(draft.notes[section]) for section in (METADATA, DATA))
        draft.segments.append(TdmSegment(MappingProxyType(draft.metadata), tuple(draft.records), *notes))


def _read_line(draft: _MessageDraft, section: str, words: str, where: str) -> None:
    if words.split(maxsplit=1)[0] == "COMMENT":
        comment = words.removeprefix("COMMENT").strip()
        (draft.comments if section == HEADER else draft.notes.setdefault(section, [])).append(comment)
        return
    match = TDM_ASSIGNMENT.fullmatch(words)
    if match is None or section == BETWEEN:
        raise SessionError(f"{where}: {words[:60]!r} is no assignment of the {section} section.")
    keyword, value = match.groups()
    if section == DATA:
        draft.records.append(_parse_record(keyword, value, where))
        return
    target = draft.header if section == HEADER else draft.metadata
    if keyword in target:
        raise SessionError(f"{where}: {keyword} is given twice.")
    target[keyword] = value.strip()


def _parse_record(keyword: str, value: str, where: str) -> TdmRecord:
    try:
        time, number = value.split()
        return TdmRecord(keyword, time, float(number))
    except ValueError:
        raise SessionError(f"{where}: {keyword} needs a time and a number, not {value!r}.") from None


def tdm_table(message: TrackingMessage) -> QTable:
    """Return a message's right ascensions and declinations, one row a time and segment.

    Parameters
    ----------
    message
        From this package or any other.

    Returns
    -------
    QTable
        ``target, observer, frame, quality, utc, et, ra, dec, range`` and, where comments of this package's messages
        tell them, ``covariance`` (n, 2, 2) of (RA cos(Dec), Dec), ``sigma_range`` and ``image``; nan where not known.

    Raises
    ------
    SessionError
        A time tag that is no UTC.
    """
    rows = [row for segment in message.segments for row in _angle_rows(segment)]
    table = QTable()
    for name in ("target", "observer", "frame", "quality", "utc", "image"):
        table[name] = np.array([row[name] for row in rows], dtype=str)
    units = {"et": u.s, "ra": u.deg, "dec": u.deg, "range": u.km, "sigma_range": u.km}
    for name, unit in units.items():
        table[name] = u.Quantity(np.array([row[name] for row in rows], dtype=float), unit)
    covariance = np.array([row["covariance"] for row in rows], dtype=float).reshape(-1, 2, 2)
    table["covariance"] = u.Quantity(covariance, u.arcsec**2)
    return table


def _angle_rows(segment: TdmSegment) -> Iterator[dict[str, Any]]:
    if segment.metadata.get("ANGLE_TYPE") != "RADEC":
        return
    if segment.metadata.get("TIME_SYSTEM") != "UTC":
        raise SessionError(
            f"time system {segment.metadata.get('TIME_SYSTEM')} of a segment; only UTC is understood."
        )
    target, observer = segment.participants()[-2:]
    notes = _covariances_in_comments(segment.data_comments)
    values: dict[str, dict[str, float]] = {}
    for record in segment.records:
        values.setdefault(record.time, {})[record.keyword] = record.value
    for time, measured in values.items():
        yield {
            "target": target,
            "observer": observer,
            "frame": segment.metadata.get("REFERENCE_FRAME", ""),
            "quality": segment.metadata.get("DATA_QUALITY", "RAW"),
            "utc": time,
            "et": _et(time),
            "ra": measured.get("ANGLE_1", np.nan) % 360.0,
            "dec": measured.get("ANGLE_2", np.nan),
            "range": measured.get("RANGE", np.nan),
            **notes.get(time, {"covariance": np.full((2, 2), np.nan), "sigma_range": np.nan, "image": ""}),
        }


def _et(time: str) -> float:
    try:
        return et_from_text(time)
    except ValueError as error:
        raise SessionError(f"the time tag {time!r} cannot be read: {error}.") from error


def _covariances_in_comments(comments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What this package's messages say of each time in comments; comments of others are passed over."""
    known: dict[str, dict[str, Any]] = {}
    for comment in comments:
        words = comment.split(maxsplit=6)
        if len(words) < 6 or words[0] != "COVARIANCE" or "T" not in words[1]:
            continue
        try:
            ra, mixed, dec, range_sigma = (np.nan if w == "-" else float(w) for w in words[2:6])
        except ValueError:
            continue
        known[words[1]] = {
            "covariance": np.array([[ra, mixed], [mixed, dec]]),
            "sigma_range": range_sigma,
            "image": words[6] if len(words) > 6 else "",
        }
    return known
