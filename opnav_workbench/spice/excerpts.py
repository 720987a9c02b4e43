"""Excerpts of SPK files: segments of some bodies over some time, copied without loss.

Source: NAIF, SPK Required Reading, "SPKSUB".
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.spice.daf import Segment
from opnav_workbench.spice.explain import time_text
from opnav_workbench.spice.files import segments
from opnav_workbench.spice.guard import spice_call

__all__ = ["SpkExcerpt", "copy_excerpt", "excerpts"]

SOLAR_SYSTEM_BARYCENTER = 0
SUMMARY_WORDS = 5  # two doubles, and six integers in the room of three


@dataclass(frozen=True, slots=True)
class SpkExcerpt:
    """The segments of one body in an SPK file, between two times."""

    source: Path
    target: int
    center: int
    start_et: float
    end_et: float


def excerpts(source: Path, target: int, start_et: float, end_et: float) -> tuple[SpkExcerpt, ...]:
    """Return excerpts for a body and the centers it refers to, down to the Solar System barycenter.

    Raises
    ------
    KernelError
        The file does not hold the body, or not over the whole time.

    Examples
    --------
    >>> from opnav_workbench.spice.planets import planet_ephemeris
    >>> [(e.target, e.center) for e in excerpts(planet_ephemeris(), 399, 0.0, 86400.0)]
    [(399, 3), (3, 0)]
    """
    found: list[SpkExcerpt] = []
    body = target
    while body != SOLAR_SYSTEM_BARYCENTER and body not in {e.target for e in found}:
        center = _covering_center(source, body, start_et, end_et)
        found.append(SpkExcerpt(source, body, center, start_et, end_et))
        body = center
    return tuple(found)


def copy_excerpt(handle: int, excerpt: SpkExcerpt) -> None:
    """Copy an excerpt into the SPK open for writing; lock held."""
    with _opened(excerpt.source) as source:
        for segment in _segments_of(excerpt.source, excerpt.target):
            start = max(segment.doubles[0], excerpt.start_et)
            end = min(segment.doubles[1], excerpt.end_et)
            if start < end and segment.integers[1] == excerpt.center:
                summary = spiceypy.dafps(2, 6, list(segment.doubles), list(segment.integers))[:SUMMARY_WORDS]
                title = f"{excerpt.target} about {excerpt.center}, from {excerpt.source.name}"
                spiceypy.spksub(source, summary, title[:40], start, end, handle)


def _segments_of(source: Path, body: int) -> list[Segment]:
    return [s for s in segments(source) if s.integers[0] == body]


def _covering_center(source: Path, body: int, start_et: float, end_et: float) -> int:
    """Return the center of the body's segments, which must leave no gap."""
    found = _segments_of(source, body)
    if not found:
        held = sorted({s.integers[0] for s in segments(source)})
        raise KernelError(f"{source.name} does not hold the body {body}; it holds {held}.")
    center = found[-1].integers[1]
    reached = start_et
    for start, end in sorted(s.doubles for s in found if s.integers[1] == center):
        if start <= reached:
            reached = max(reached, end)
    first, last = min(s.doubles[0] for s in found), max(s.doubles[1] for s in found)
    if reached < end_et or first > start_et:
        raise KernelError(
            f"{source.name} covers the body {body} from {_when(first)} to {_when(last)}, "
            f"not all of {_when(start_et)} to {_when(end_et)}."
        )
    return center


def _when(et: float) -> str:
    with spice_call("time"):
        return time_text(et)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    handle = spiceypy.dafopr(str(path))
    try:
        yield handle
    finally:
        spiceypy.dafcls(handle)
