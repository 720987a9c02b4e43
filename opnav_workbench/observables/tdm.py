"""Observables as a CCSDS Tracking Data Message: right ascension and declination of each body, and its range.

Reference: CCSDS 503.0-B-2, Tracking Data Message, Blue Book, Issue 2 (2020), keyword-value notation.

The standard has no pixels (1.2.5 d) and no covariances. Angles are those of the observed center through the solved
attitude; their covariance, with the pointing's share, stands in comments at the head of the data, which a reader may
ignore. One segment holds one target, one method and one quality, for a keyword may carry a time only once in a segment,
and degraded data belong in segments of their own (3.4.11, table 3-3).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_text
from opnav_workbench.image.times import text_from_et
from opnav_workbench.observables.observable import Observable

__all__ = ["TDM_ABERRATIONS", "TDM_FRAMES", "TdmOptions", "tdm_text", "write_tdm"]

VERSION = "2.0"
TIME_DECIMALS = 6  # of a second; a spacecraft moves centimeters in a microsecond
ANGLE_DECIMALS = 13  # with three digits before the point the standard's sixteen (4.3.4): 4e-10 arcsec
LINE_LENGTH = 254  # 4.2.1
TDM_FRAMES = ("ICRF", "EME2000")
TDM_ABERRATIONS = ("removed", "kept")
QUALITY = {"ok": "VALIDATED", "uncertain": "DEGRADED"}  # other statuses have no center


@dataclass(frozen=True, slots=True)
class TdmOptions:
    """What a message says beside the observables.

    Attributes
    ----------
    observer : str
        Spacecraft, for observables that do not name theirs.
    originator : str
        Agency, as registered with SANA.
    aberration : {"removed", "kept"}
        Angles with stellar aberration removed (comparable with star catalogs) or as seen.
    frame : {"ICRF", "EME2000"}
        Name of the reference frame. SPICE's J2000 has the axes of the ICRF; 23 mas from EME2000 taken by the letter.
    creation_date : str
        UTC; empty for now.
    message_id : str
        Left out when empty.
    comments : tuple of str
        For the header.
    """

    observer: str = ""
    originator: str = "OPNAV_WORKBENCH"
    aberration: str = "removed"
    frame: str = "ICRF"
    creation_date: str = ""
    message_id: str = ""
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, allowed in (("aberration", TDM_ABERRATIONS), ("frame", TDM_FRAMES)):
            if getattr(self, name) not in allowed:
                raise SessionError(
                    f"unknown {name} {getattr(self, name)!r}; choose one of {', '.join(allowed)}."
                )


def tdm_text(observables: Sequence[Observable], options: TdmOptions | None = None) -> str:
    """Return the message; observables without a center are left out.

    Raises
    ------
    SessionError
        No observable has a center, or the spacecraft is not known.
    """
    options = options or TdmOptions()
    segments = _segments(observables)
    if not segments:
        raise SessionError(
            f"none of {len(observables)} observables has a center with status ok or uncertain; a tracking data "
            "message needs one."
        )
    lines = [*_header(options), *(line for group in segments for line in _segment(group, options))]
    return "\n".join(_ascii(line) for line in lines) + "\n"


def write_tdm(observables: Sequence[Observable], path: str | Path, options: TdmOptions | None = None) -> None:
    """Write observables as a CCSDS Tracking Data Message (KVN), whole or not at all; see `tdm_text`."""
    write_text(path, tdm_text(observables, options))


def _segments(observables: Sequence[Observable]) -> list[list[Observable]]:
    """Groups of one spacecraft, target, method and quality, in time order, none with a time twice."""
    usable = [o for o in observables if o.observed_px is not None and o.status in QUALITY]
    groups: dict[tuple[str, ...], list[list[Observable]]] = {}
    for o in sorted(usable, key=lambda o: o.et):
        layers = groups.setdefault((o.observer, o.name, o.method, o.status), [])
        for layer in layers:
            if _time(layer[-1]) != _time(o):
                layer.append(o)
                break
        else:
            layers.append([o])
    return [layer for key in sorted(groups) for layer in groups[key]]


def _header(options: TdmOptions) -> Iterable[str]:
    yield f"CCSDS_TDM_VERS = {VERSION}"
    yield from (f"COMMENT {words}" for words in options.comments)
    yield f"CREATION_DATE = {options.creation_date or datetime.now(UTC).strftime('%Y-%m-%dT%H:%M:%S')}"
    yield f"ORIGINATOR = {options.originator}"
    if options.message_id:
        yield f"MESSAGE_ID = {options.message_id}"


def _segment(group: Sequence[Observable], options: TdmOptions) -> Iterable[str]:
    first, last = group[0], group[-1]
    with_range = any(np.isfinite(o.measured_range_km) for o in group)
    yield from ("", "META_START", *_conventions(first, options, with_range))
    yield f"TRACK_ID = {_name(first.name)}_{first.method}_{_time(first)}"
    yield f"DATA_TYPES = ANGLE_1,ANGLE_2{',RANGE' if with_range else ''}"
    yield "TIME_SYSTEM = UTC"
    yield f"START_TIME = {_time(first)}"
    yield f"STOP_TIME = {_time(last)}"
    yield f"PARTICIPANT_1 = {_observer(first, options)}"
    yield f"PARTICIPANT_2 = {_name(first.name)}"
    yield "MODE = SEQUENTIAL"
    yield "PATH = 2,1"  # light goes from the target to the camera
    yield "TIMETAG_REF = RECEIVE"
    if with_range:
        yield "RANGE_UNITS = km"
    yield "ANGLE_TYPE = RADEC"
    yield f"REFERENCE_FRAME = {options.frame}"
    yield f"DATA_QUALITY = {QUALITY[first.status]}"
    yield from ("META_STOP", "DATA_START")
    yield "COMMENT COVARIANCE time, of RA cos(Dec) | RA cos(Dec) with Dec | Dec, arcsec**2; sigma of range, km; picture"
    yield from (_covariance(o) for o in group)
    for o in group:
        yield from _records(o, options)
    yield "DATA_STOP"


def _conventions(first: Observable, options: TdmOptions, with_range: bool) -> Iterable[str]:
    yield f"COMMENT Center of figure of {first.name}, measured in pictures with stars, method {first.method}"
    if options.aberration == "removed":
        yield "COMMENT Stellar aberration is removed from the angles (SPICE STELAB, spacecraft relative to the SSB)"
    else:
        yield "COMMENT Angles are as seen: stellar aberration is not removed"
    yield "COMMENT Light time is not removed: direction from the spacecraft at the time tag to where the light left"
    yield "COMMENT Time tags are mid-exposure at the spacecraft"
    if with_range:
        yield "COMMENT Range is from the measured size of the body, its radius taken as known"


def _records(o: Observable, options: TdmOptions) -> Iterable[str]:
    removed = options.aberration == "removed"
    ra, dec = (o.ra_deg, o.dec_deg) if removed else (o.apparent_ra_deg, o.apparent_dec_deg)
    yield f"ANGLE_1 = {_time(o)} {_angle(ra)}"
    yield f"ANGLE_2 = {_time(o)} {_angle(dec)}"
    if np.isfinite(o.measured_range_km):
        yield f"RANGE = {_time(o)} {o.measured_range_km:.15E}"


def _covariance(o: Observable) -> str:
    known = o.residual_covariance_arcsec2
    matrix = np.full((2, 2), np.nan) if known is None else known
    numbers = (matrix[0, 0], matrix[0, 1], matrix[1, 1], o.range_sigma_km)
    words = " ".join(repr(float(n)) if np.isfinite(n) else "-" for n in numbers)
    return f"COMMENT COVARIANCE {_time(o)} {words} {o.image}"


def _observer(first: Observable, options: TdmOptions) -> str:
    name = first.observer or options.observer
    if not name:
        raise SessionError(
            f"the observables of {first.image} do not name their spacecraft; say it (--spacecraft NAME)."
        )
    return _name(name)


def _name(text: str) -> str:
    return "_".join(text.split())  # an underscore counts as a blank (4.3.8)


def _time(o: Observable) -> str:
    return text_from_et(o.et, TIME_DECIMALS)


def _angle(degrees: float) -> str:
    text = f"{degrees:.{ANGLE_DECIMALS}f}"
    return f"{0.0:.{ANGLE_DECIMALS}f}" if abs(float(text)) in (0.0, 360.0) else text


def _ascii(line: str) -> str:
    """Only printable ASCII, and no line longer than the standard allows (4.2.1)."""
    plain = line.encode("ascii", "replace").decode("ascii")
    return "".join(c if c.isprintable() else "?" for c in plain)[:LINE_LENGTH]
