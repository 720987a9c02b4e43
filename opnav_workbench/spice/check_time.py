"""One time: how a person may write it, and what of the kernels does not serve it."""

import re
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.spice import pool
from opnav_workbench.spice.attitude import body_attitude
from opnav_workbench.spice.check_rows import CoverageRow, Question
from opnav_workbench.spice.coverage import name_of
from opnav_workbench.spice.explain import Request, time_text, unlisted_explanation
from opnav_workbench.spice.states import body_radii_km
from opnav_workbench.spice.time import et_from_sclk, et_from_utc

__all__ = ["gap_texts", "problems_at", "time_of"]

CLOCK_READING = re.compile(r"\d+/[\d:.-]+|\d+:\d+")  # with a partition, or counts and subcounts alone
BARYCENTER = "0"  # of the solar system
ARTICLE = {"CK": "a CK", "spacecraft SPK": "an SPK", "target SPK": "an SPK"}
SHOWN_NAMES = 6  # of bodies that share a gap


def time_of(time: str | float, crafts: Sequence[int]) -> float:
    """Return the et of a UTC string, a spacecraft clock reading or a number of TDB seconds.

    Raises
    ------
    KernelError
        It cannot be read, or the kernel that it needs is not loaded.
    """
    try:
        return float(time)
    except ValueError:
        text = str(time).strip()
    if CLOCK_READING.fullmatch(text):
        clocks = [c for c in crafts if pool.pool_value(f"SCLK_DATA_TYPE_{-c}") is not None]
        if not clocks:
            raise KernelError(
                f"the clock reading {text!r} needs the SCLK kernel of the spacecraft; add it, or give UTC."
            )
        return et_from_sclk(clocks[0], text)
    return et_from_utc(text)


def problems_at(et: float, asked: Question, rows: Sequence[CoverageRow]) -> list[str]:
    """Return what does not serve a time, each with its remedy; lock held."""
    missing = [
        row
        for row in rows
        if row.needed and not row.covers(et) and (row.files or row.kind != "CK" or asked.frame)
    ]
    kinds = {row.kind for row in missing}
    found = gap_texts(missing, et)
    if not kinds - {"CK"}:
        found += _unconnected(et, asked)
    if "CK" not in kinds and asked.frame is not None and not asked.problems:
        found += _tried(Request(f"attitude of {asked.frame}", et, frame=asked.frame))
    found += _clock_problems(et, asked.crafts)
    return found + _constants(et, asked.targets)


def gap_texts(rows: Sequence[CoverageRow], et: float) -> list[str]:
    """Return where a time lies outside windows, and what helps; rows that end together share a line.

    Examples
    --------
    >>> none = np.empty((0, 2))
    >>> gap_texts([CoverageRow("CK", -98000, "NH_SPACECRAFT", none, none, none, ())], 0.0)
    ['CK of NH_SPACECRAFT: none; load a CK that covers et 0.000 s']
    """
    alike: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        alike.setdefault((row.kind, _gap(row, et)), []).append(row.name)
    return [
        f"{kind} of {_names(names)}: {gap}; load {ARTICLE[kind]} that covers {time_text(et)}"
        for (kind, gap), names in alike.items()
    ]


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    return ", ".join(names[:SHOWN_NAMES]) + more


def _gap(row: CoverageRow, et: float) -> str:
    start, stop = row.gap_at(et)
    if not len(row.windows_et):
        return "none"
    if not np.isfinite(start):
        return f"begins only at {time_text(stop)}"
    if not np.isfinite(stop):
        return f"ends at {time_text(start)}"
    return f"gap from {time_text(start)} to {time_text(stop)}"


def _unconnected(et: float, asked: Question) -> list[str]:
    """Return failures of positions whose bodies have windows: a center is missing, or one light time of data."""
    if not asked.crafts:
        return []
    if asked.targets:
        pairs = [(str(t), str(c), "CN+S") for t in asked.targets for c in asked.crafts]
    else:
        pairs = [(str(b), BARYCENTER, "NONE") for b in asked.bodies if b != 0]
    found = []
    for target, observer, correction in pairs:
        names = [name_of("SPK", int(b)) for b in (target, observer)]
        request = Request(f"{names[0]} from {names[1]}", et, (target, observer))
        try:
            spiceypy.spkezr(target, et, "J2000", correction, observer)
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            found.append(unlisted_explanation(error, request))
    return found


def _tried(request: Request) -> list[str]:
    try:
        spiceypy.pxform("J2000", str(request.frame), request.et)
    except spiceypy.SpiceyError as error:
        spiceypy.reset()
        return [unlisted_explanation(error, request)]
    return []


def _clock_problems(et: float, crafts: Sequence[int]) -> list[str]:
    found = []
    for craft in crafts:
        if pool.pool_value(f"SCLK_DATA_TYPE_{-craft}") is None:
            continue
        try:
            spiceypy.sce2s(craft, et)
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            found.append(unlisted_explanation(error, Request(f"reading of clock {craft}", et)))
    return found


def _constants(et: float, targets: Sequence[int]) -> list[str]:
    return [text for target in targets for text in _constants_of(et, target)]


def _constants_of(et: float, target: int) -> Iterator[str]:
    """Try size and rotation: without them a body can be shown as a point only."""
    for constant in (partial(body_radii_km, target), partial(body_attitude, target, et)):
        try:
            constant()
        except KernelError as error:
            yield str(error).partition(". Loaded kernels:")[0]
