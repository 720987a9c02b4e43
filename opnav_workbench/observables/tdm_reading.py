"""Reading a CCSDS Tracking Data Message (KVN): any of the standard's messages, and the angles of ours.

Reference: CCSDS 503.0-B-2, sections 3 and 4.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.errors import SessionError
from opnav_workbench.image.times import et_from_text

__all__ = ["TdmRecord", "TdmSegment", "TrackingMessage", "parse_tdm", "read_tdm", "tdm_table"]

ASSIGNMENT = re.compile(r"([A-Z0-9_]+)\s*=\s*(\S.*)")
SECTIONS = ("META_START", "META_STOP", "DATA_START", "DATA_STOP")
HEADER, METADATA, BETWEEN, DATA = "header", "metadata", "between metadata and data", "data"
# What each delimiter ends and begins.
TURNS = {
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
class _Draft:
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
        text = Path(path).read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
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
    draft, section = _Draft(), HEADER
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.strip()
        if words in SECTIONS:
            ends, begins = TURNS[words]
            if section != ends:
                raise SessionError(f"{source}, line {number}: {words} in the {section} section.")
            section = begins
            _turn(draft, words)
        elif words:
            _read_line(draft, section, words, f"{source}, line {number}")
    if section != HEADER or "CCSDS_TDM_VERS" not in draft.header:
        raise SessionError(
            f"{source} is no complete tracking data message (it ends in the {section} section)."
        )
    return TrackingMessage(MappingProxyType(draft.header), tuple(draft.comments), tuple(draft.segments))


def _turn(draft: _Draft, word: str) -> None:
    if word == "META_START":
        draft.metadata, draft.notes, draft.records = {}, {METADATA: [], DATA: []}, []
    elif word == "DATA_STOP":
        notes = (tuple(draft.notes[section]) for section in (METADATA, DATA))
        draft.segments.append(TdmSegment(MappingProxyType(draft.metadata), tuple(draft.records), *notes))


def _read_line(draft: _Draft, section: str, words: str, where: str) -> None:
    if words.split(maxsplit=1)[0] == "COMMENT":
        comment = words.removeprefix("COMMENT").strip()
        (draft.comments if section == HEADER else draft.notes.setdefault(section, [])).append(comment)
        return
    match = ASSIGNMENT.fullmatch(words)
    if match is None or section == BETWEEN:
        raise SessionError(f"{where}: {words[:60]!r} is no assignment of the {section} section.")
    keyword, value = match.groups()
    if section == DATA:
        draft.records.append(_record(keyword, value, where))
        return
    target = draft.header if section == HEADER else draft.metadata
    if keyword in target:
        raise SessionError(f"{where}: {keyword} is given twice.")
    target[keyword] = value.strip()


def _record(keyword: str, value: str, where: str) -> TdmRecord:
    try:
        time, number = value.split()
        return TdmRecord(keyword, time, float(number))
    except ValueError:
        raise SessionError(f"{where}: {keyword} needs a time and a number, not {value!r}.") from None


def tdm_table(message: TrackingMessage) -> QTable:
    """Return a message's right ascensions and declinations, one row a time and segment.

    Parameters
    ----------
    message : TrackingMessage
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
    rows = [row for segment in message.segments for row in _rows(segment)]
    table = QTable()
    for name in ("target", "observer", "frame", "quality", "utc", "image"):
        table[name] = np.array([row[name] for row in rows], dtype=str)
    units = {"et": u.s, "ra": u.deg, "dec": u.deg, "range": u.km, "sigma_range": u.km}
    for name, unit in units.items():
        table[name] = u.Quantity(np.array([row[name] for row in rows], dtype=float), unit)
    covariance = np.array([row["covariance"] for row in rows], dtype=float).reshape(-1, 2, 2)
    table["covariance"] = u.Quantity(covariance, u.arcsec**2)
    return table


def _rows(segment: TdmSegment) -> Iterator[dict[str, Any]]:
    if segment.metadata.get("ANGLE_TYPE") != "RADEC":
        return
    if segment.metadata.get("TIME_SYSTEM") != "UTC":
        raise SessionError(
            f"time system {segment.metadata.get('TIME_SYSTEM')} of a segment; only UTC is understood."
        )
    target, observer = segment.participants()[-2:]
    notes = _covariances(segment.data_comments)
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


def _covariances(comments: Sequence[str]) -> dict[str, dict[str, Any]]:
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
