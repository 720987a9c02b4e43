"""What a set of kernels covers and what it lacks: the eight kinds, every body and structure, and one time.

The eight kinds of kernel that optical navigation needs (AAS 13-443, section on the use of SPICE) are looked for one by
one; of what moves or turns, windows, gaps and overlaps are told; and at a time (UTC, clock reading or et) everything
that a picture then needs is tried. Every problem comes with its remedy.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.constants import SOLAR_SYSTEM_BARYCENTER_ID
from opnav_workbench.errors import KernelError, some_of
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.calls import (
    SpiceRequest,
    spice_call,
    time_text,
    unknown_body,
    unlisted_explanation,
)
from opnav_workbench.kernels.coverage import (
    bodies_in,
    body_or_structure_name,
    ck_structures,
    frame_number,
    gaps_between,
    held_bodies,
    merged_windows,
    overlaps_of,
    windows_contain,
)
from opnav_workbench.kernels.files import KernelFile
from opnav_workbench.kernels.kernel_set import KernelSet
from opnav_workbench.kernels.loading import KernelSource
from opnav_workbench.kernels.manifest import KERNEL_KINDS
from opnav_workbench.kernels.states import body_attitude, body_radii_km
from opnav_workbench.kernels.time import et_from_sclk, et_from_utc

__all__ = ["CoverageRow", "KernelCheck", "KindCheck", "check_kernels"]


# ---- Windows, gaps and overlaps of everything in the loaded kernels that moves or turns.

SPACECRAFT_IDS = range(-999, 0)  # NAIF: structures and instruments of a spacecraft have longer numbers


@dataclass(frozen=True, slots=True, eq=False)
class CoverageRow:
    """When one body's position or one structure's attitude is known, and from which files.

    Attributes
    ----------
    kind
        "target SPK", "spacecraft SPK" or "CK".
    body
        NAIF number of the body or structure.
    windows_et : (k, 2) array
        Of all files together, TDB s past J2000.
    gaps_et : (m, 2) array
        Between the windows.
    overlaps_et : (m, 2) array
        Where two or more files know it: the one loaded last wins.
    files : tuple of (Path, (k, 2) array)
        In loading order, each with its own windows.
    needed
        Whether the question was about it.
    """

    kind: str
    body: int
    name: str
    windows_et: FloatArray
    gaps_et: FloatArray
    overlaps_et: FloatArray
    files: tuple[tuple[Path, FloatArray], ...]
    needed: bool = True

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def covers(self, et: float) -> bool:
        """Tell whether a time lies in a window, ends included."""
        return windows_contain(self.windows_et, et)

    def gap_at(self, et: float) -> tuple[float, float]:
        """Return the stretch without data around a time, ends infinite before the first and after the last window."""
        starts, stops = self.windows_et.T
        return float(stops[stops < et].max(initial=-np.inf)), float(starts[starts > et].min(initial=np.inf))

    def overlap_at(self, et: float) -> tuple[float, float] | None:
        """Return the overlap around a time."""
        found = self.overlaps_et[(self.overlaps_et[:, 0] <= et) & (et <= self.overlaps_et[:, 1])]
        return (float(found[0, 0]), float(found[0, 1])) if len(found) else None

    def files_at(self, et: float) -> tuple[Path, ...]:
        """Return the files that know it at a time, in loading order: the last one is used."""
        return tuple(path for path, windows in self.files if windows_contain(windows, et))


class CheckScope:
    """What a check is about: the spacecraft, the bodies it must see, the structures that must be oriented.

    Parameters
    ----------
    spacecraft, targets, frame
        As for `opnav_workbench.kernels.check.check_kernels`; lock held.
    """

    def __init__(self, spacecraft: int | None, targets: Sequence[str | int], frame: str | None) -> None:
        self.problems: list[str] = []
        held = held_bodies("SPK")
        self.spacecraft_ids = (
            (spacecraft,) if spacecraft is not None else tuple(b for b in held if b in SPACECRAFT_IDS)
        )
        self.targets = tuple(number for target in targets for number in self._number(target))
        self.bodies = tuple(dict.fromkeys((*self.spacecraft_ids, *self.targets))) if targets else tuple(held)
        self.frame = frame
        self.structures = self._structures(frame)

    def _number(self, target: str | int) -> Iterator[int]:
        try:
            yield int(spiceypy.bods2c(str(target)))
        except spiceypy.NotFoundError:
            self.problems.append("; ".join(unknown_body((target,))))

    def _structures(self, frame: str | None) -> tuple[int, ...]:
        if frame is None:
            return tuple(held_bodies("CK"))
        try:
            return ck_structures(frame_number(frame))
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            self.problems.append(
                unlisted_explanation(error, SpiceRequest(f"camera frame {frame}", frame=frame))
            )
            return ()


def coverage_rows(asked: CheckScope) -> tuple[CoverageRow, ...]:
    """Return the rows of all bodies and structures, spacecraft first, then bodies, then attitudes; lock held."""
    bodies = sorted({*held_bodies("SPK"), *asked.bodies}, key=lambda b: (b >= 0, abs(b)))
    structures = sorted({*held_bodies("CK"), *asked.structures}, reverse=True)
    rows = [_row("SPK", b, b in asked.bodies, asked) for b in bodies]
    return (*rows, *(_row("CK", s, s in asked.structures, asked) for s in structures))


def _row(kind: str, body: int, needed: bool, asked: CheckScope) -> CoverageRow:
    paths = tuple(f.path for f in pool.loaded_files() if f.kind == kind and body in bodies_in(f.path))
    name = body_or_structure_name(kind, body)
    try:
        merged = merged_windows(kind, body, paths)
        files = tuple((path, merged_windows(kind, body, (path,))) for path in paths)
    except spiceypy.SpiceyError as error:  # the clock of a CK, or the leap seconds, are missing
        spiceypy.reset()
        asked.problems.append(unlisted_explanation(error, SpiceRequest(f"times of the CK of {name}")))
        merged, files = np.empty((0, 2)), tuple((path, np.empty((0, 2))) for path in paths)
    of_spacecraft = body in asked.spacecraft_ids or body < 0
    title = "CK" if kind == "CK" else "spacecraft SPK" if of_spacecraft else "target SPK"
    overlaps = overlaps_of([windows for _, windows in files])
    return CoverageRow(title, body, name, merged, gaps_between(merged), overlaps, files, needed)


# ---- One time: how a person may write it, and what of the kernels does not serve it.

CLOCK_READING = re.compile(r"\d+/[\d:.-]+|\d+:\d+")  # with a partition, or counts and subcounts alone
ARTICLE = {"CK": "a CK", "spacecraft SPK": "an SPK", "target SPK": "an SPK"}
SHOWN_NAMES = 6  # of bodies that share a gap


def et_from_any_time(time: str | float, spacecraft_ids: Sequence[int]) -> float:
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
        clocks = [c for c in spacecraft_ids if pool.has_clock(c)]
        if not clocks:
            raise KernelError(
                f"the clock reading {text!r} needs the SCLK kernel of the spacecraft; add it, or give UTC."
            )
        return et_from_sclk(clocks[0], text)
    return et_from_utc(text)


def problems_at(et: float, asked: CheckScope, rows: Sequence[CoverageRow]) -> list[str]:
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
        found += _attitude_problems(SpiceRequest(f"attitude of {asked.frame}", et, frame=asked.frame))
    found += _clock_problems(et, asked.spacecraft_ids)
    return found + _constant_problems(et, asked.targets)


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
        f"{kind} of {some_of(names, SHOWN_NAMES)}: {gap}; load {ARTICLE[kind]} that covers {time_text(et)}"
        for (kind, gap), names in alike.items()
    ]


def _gap(row: CoverageRow, et: float) -> str:
    start, stop = row.gap_at(et)
    if not len(row.windows_et):
        return "none"
    if not np.isfinite(start):
        return f"begins only at {time_text(stop)}"
    if not np.isfinite(stop):
        return f"ends at {time_text(start)}"
    return f"gap from {time_text(start)} to {time_text(stop)}"


def _unconnected(et: float, asked: CheckScope) -> list[str]:
    """Return failures of positions whose bodies have windows: a center is missing, or one light time of data."""
    if not asked.spacecraft_ids:
        return []
    if asked.targets:
        pairs = [(str(t), str(c), "CN+S") for t in asked.targets for c in asked.spacecraft_ids]
    else:
        pairs = [(str(b), str(SOLAR_SYSTEM_BARYCENTER_ID), "NONE") for b in asked.bodies if b != 0]
    found = []
    for target, observer, correction in pairs:
        names = [body_or_structure_name("SPK", int(b)) for b in (target, observer)]
        request = SpiceRequest(f"{names[0]} from {names[1]}", et, (target, observer))
        try:
            spiceypy.spkezr(target, et, "J2000", correction, observer)
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            found.append(unlisted_explanation(error, request))
    return found


def _attitude_problems(request: SpiceRequest) -> list[str]:
    try:
        spiceypy.pxform("J2000", str(request.frame), request.et)
    except spiceypy.SpiceyError as error:
        spiceypy.reset()
        return [unlisted_explanation(error, request)]
    return []


def _clock_problems(et: float, spacecraft_ids: Sequence[int]) -> list[str]:
    found = []
    for spacecraft in spacecraft_ids:
        if not pool.has_clock(spacecraft):
            continue
        try:
            spiceypy.sce2s(spacecraft, et)
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            found.append(unlisted_explanation(error, SpiceRequest(f"reading of clock {spacecraft}", et)))
    return found


def _constant_problems(et: float, targets: Sequence[int]) -> list[str]:
    return [text for target in targets for text in _constant_problems_of(et, target)]


def _constant_problems_of(et: float, target: int) -> Iterator[str]:
    """Try size and rotation: without them a body can be shown as a point only."""
    for constant in (partial(body_radii_km, target), partial(body_attitude, target, et)):
        try:
            constant()
        except KernelError as error:
            yield str(error).partition(". Loaded kernels:")[0]


# ---- What a set of kernels covers and what it lacks: the eight kinds, every body and structure, and one time.

HALF_AXIS_S = 43_200.0  # half a day on either side of a single instant
VARIABLES = {
    "LSK": "DELTET/DELTA_AT", "SCLK": "SCLK_DATA_TYPE_*", "PCK": "BODY*_RADII", "FK": "FRAME_*_CLASS",
    "IK": "INS*",
}  # fmt: skip
REMEDIES = {
    "LSK": "add naif0012.tls: opnav kernels fetch generic",
    "SCLK": "add the spacecraft's clock kernel: without it no CK can be read",
    "PCK": "add pck00011.tpc: opnav kernels fetch generic",
    "FK": "add the mission's frame kernel: without it cameras have no frames",
    "IK": "add the instrument kernel, or work from the mission's camera files, which need none",
    "target SPK": "add the target's ephemeris, and one of the planets: opnav kernels fetch generic",
    "spacecraft SPK": "add the trajectory, or make one: opnav kernels make SCENARIO.yaml",
    "CK": "add the attitude, make one: opnav kernels make SCENARIO.yaml, or take it from the pictures' headers",
}


@dataclass(frozen=True, slots=True)
class KindCheck:
    """One of the eight kinds of kernel: the files that bring it, and what to do if there is none."""

    kind: str
    files: tuple[Path, ...]

    @property
    def remedy(self) -> str:
        """What helps against its absence; empty where it is there."""
        return "" if self.files else REMEDIES[self.kind]


@dataclass(frozen=True, slots=True)
class KernelCheck:
    """What kernels cover.

    Attributes
    ----------
    kernels
        In loading order.
    kinds
        The eight kinds.
    rows
        Trajectories, then attitudes.
    et
        The time asked for.
    problems
        What is missing, each with its remedy; empty if nothing is.
    """

    kernels: tuple[KernelFile, ...]
    kinds: tuple[KindCheck, ...]
    rows: tuple[CoverageRow, ...]
    et: float | None
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether all eight kinds are there and the time asked for is served."""
        return not self.problems

    def plot_span_et(self) -> tuple[float, float]:
        """Return the stretch of time worth drawing: where spacecraft and attitude are known, and the time asked."""
        ends = [row.windows_et for row in self.rows if row.kind != "target SPK" and len(row.windows_et)]
        ends = ends or [row.windows_et for row in self.rows if len(row.windows_et)]
        times = [t for windows in ends for t in (windows[0, 0], windows[-1, 1])]
        times += [self.et] if self.et is not None else []
        if not times:
            return 0.0, 1.0
        start, stop = float(min(times)), float(max(times))
        return (start, stop) if stop > start else (start - HALF_AXIS_S, stop + HALF_AXIS_S)


def check_kernels(
    source: KernelSource | Sequence[KernelSource],
    time: str | float | None = None,
    *,
    spacecraft: int | None = None,
    targets: Sequence[str | int] = (),
    frame: str | None = None,
) -> KernelCheck:
    """Look at what kernels cover, in general and at one time.

    Parameters
    ----------
    source : str, path or sequence of them
        As for `KernelSet`.
    time
        UTC, a reading of the spacecraft clock (``3/0299171897:33600``), or TDB s past J2000.
    spacecraft
        Its NAIF number; by default every spacecraft of the SPKs.
    targets
        Bodies that must be seen from the spacecraft; by default all bodies of the SPKs must have a position.
    frame
        The camera's frame: only the attitudes that orient it must be there; by default those of all CKs.

    Raises
    ------
    KernelError
        The kernels cannot be opened, or the time cannot be read.

    Examples
    --------
    >>> from opnav_workbench.kernels.time import packaged_leap_seconds
    >>> with packaged_leap_seconds() as lsk:
    ...     check = check_kernels(lsk, "2015-07-14T11:50:00")
    >>> [kind.kind for kind in check.kinds if kind.files], check.ok
    (['LSK'], False)
    """
    with KernelSet(source) as kernels, spice_call("checking kernels"):
        asked = CheckScope(spacecraft, targets, frame)
        et = None if time is None else et_from_any_time(time, asked.spacecraft_ids)
        rows = coverage_rows(asked)
        kinds = tuple(_kind_check(kind, kernels.kernels(), asked.spacecraft_ids) for kind in KERNEL_KINDS)
        problems = [f"{k.kind}: none; {k.remedy}" for k in kinds if not k.files]
        problems += asked.problems
        if et is not None:
            problems += problems_at(et, asked, rows)
        return KernelCheck(kernels.kernels(), kinds, rows, et, tuple(problems))


def _kind_check(kind: str, kernels: Sequence[KernelFile], spacecraft_ids: Sequence[int]) -> KindCheck:
    """Find the files of a kind: by their own word, or else by the variables that they bring."""
    if kind.endswith("SPK"):
        of_craft = kind.startswith("spacecraft")
        spks = [k.path for k in kernels if k.kind == "SPK"]
        return KindCheck(
            kind,
            tuple(p for p in spks if any((b in spacecraft_ids or b < 0) is of_craft for b in bodies_in(p))),
        )
    files = tuple(k.path for k in kernels if k.kind == kind)
    if not files and kind in VARIABLES and pool.pool_names(VARIABLES[kind]):
        files = tuple(k.path for k in kernels if k.kind not in ("SPK", "CK", "DSK", "META"))
    return KindCheck(kind, files)
