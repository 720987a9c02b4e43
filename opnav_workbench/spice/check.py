"""What a set of kernels covers and what it lacks: the eight kinds, every body and structure, and one time.

The paper's eight kinds of kernel (AAS 13-443, section on the use of SPICE) are looked for one by one; of what
moves or turns, windows, gaps and overlaps are told; and at a time everything that a picture then needs is tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.spice import pool
from opnav_workbench.spice.check_rows import CoverageRow, Question, coverage_rows
from opnav_workbench.spice.check_time import problems_at, time_of
from opnav_workbench.spice.coverage import bodies_in
from opnav_workbench.spice.files import KernelFile
from opnav_workbench.spice.guard import spice_call
from opnav_workbench.spice.kernels import KernelSet
from opnav_workbench.spice.manifest import KERNEL_KINDS
from opnav_workbench.spice.sources import Source

__all__ = ["CoverageRow", "KernelCheck", "KindCheck", "check_kernels"]

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
    kernels : tuple of KernelFile
        In loading order.
    kinds : tuple of KindCheck
        The eight kinds.
    rows : tuple of CoverageRow
        Trajectories, then attitudes.
    et : float or None
        The time asked for.
    problems : tuple of str
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

    def axis_et(self) -> tuple[float, float]:
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
    source: Source | Sequence[Source],
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
    time : str or float, optional
        UTC, a reading of the spacecraft clock (``3/0299171897:33600``), or TDB s past J2000.
    spacecraft : int, optional
        Its NAIF number; by default every spacecraft of the SPKs.
    targets : sequence of str or int
        Bodies that must be seen from the spacecraft; by default all bodies of the SPKs must have a position.
    frame : str, optional
        The camera's frame: only the attitudes that orient it must be there; by default those of all CKs.

    Raises
    ------
    KernelError
        The kernels cannot be opened, or the time cannot be read.

    Examples
    --------
    >>> from opnav_workbench.spice.leapseconds import packaged_leap_seconds
    >>> with packaged_leap_seconds() as lsk:
    ...     check = check_kernels(lsk, "2015-07-14T11:50:00")
    >>> [kind.kind for kind in check.kinds if kind.files], check.ok
    (['LSK'], False)
    """
    with KernelSet(source) as kernels, spice_call("checking kernels"):
        asked = Question(spacecraft, targets, frame)
        et = None if time is None else time_of(time, asked.crafts)
        rows = coverage_rows(asked)
        kinds = tuple(_kind(kind, kernels.kernels(), asked.crafts) for kind in KERNEL_KINDS)
        problems = [f"{k.kind}: none; {k.remedy}" for k in kinds if not k.files]
        problems += asked.problems
        if et is not None:
            problems += problems_at(et, asked, rows)
        return KernelCheck(kernels.kernels(), kinds, rows, et, tuple(problems))


def _kind(kind: str, kernels: Sequence[KernelFile], crafts: Sequence[int]) -> KindCheck:
    """Find the files of a kind: by their own word, or else by the variables that they bring."""
    if kind.endswith("SPK"):
        of_craft = kind.startswith("spacecraft")
        spks = [k.path for k in kernels if k.kind == "SPK"]
        return KindCheck(
            kind, tuple(p for p in spks if any((b in crafts or b < 0) is of_craft for b in bodies_in(p)))
        )
    files = tuple(k.path for k in kernels if k.kind == kind)
    if not files and kind in VARIABLES and pool.pool_names(VARIABLES[kind]):
        files = tuple(k.path for k in kernels if k.kind not in ("SPK", "CK", "DSK", "META"))
    return KindCheck(kind, files)
