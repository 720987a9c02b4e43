"""Windows, gaps and overlaps of everything in the loaded kernels that moves or turns, and what of it is needed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.spice import coverage as cover
from opnav_workbench.spice import pool
from opnav_workbench.spice.explain import Request, unknown_body, unlisted_explanation
from opnav_workbench.spice.timeline import gaps_between, overlaps_of

__all__ = ["SPACECRAFT_IDS", "CoverageRow", "Question", "coverage_rows"]

SPACECRAFT_IDS = range(-999, 0)  # NAIF: structures and instruments of a spacecraft have longer numbers


@dataclass(frozen=True, slots=True, eq=False)
class CoverageRow:
    """When one body's position or one structure's attitude is known, and from which files.

    Attributes
    ----------
    kind : str
        "target SPK", "spacecraft SPK" or "CK".
    body : int
        NAIF number of the body or structure.
    name : str
    windows_et : (k, 2) array
        Of all files together, TDB s past J2000.
    gaps_et : (m, 2) array
        Between the windows.
    overlaps_et : (m, 2) array
        Where two or more files know it: the one loaded last wins.
    files : tuple of (Path, (k, 2) array)
        In loading order, each with its own windows.
    needed : bool
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
        return _contains(self.windows_et, et)

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
        return tuple(path for path, windows in self.files if _contains(windows, et))


def _contains(windows: FloatArray, et: float) -> bool:
    return bool(((windows[:, 0] <= et) & (et <= windows[:, 1])).any())


class Question:
    """What a check is about: the spacecraft, the bodies it must see, the structures that must be oriented.

    Parameters
    ----------
    spacecraft, targets, frame
        As for `opnav_workbench.spice.check.check_kernels`; lock held.
    """

    def __init__(self, spacecraft: int | None, targets: Sequence[str | int], frame: str | None) -> None:
        self.problems: list[str] = []
        held = held_bodies("SPK")
        self.crafts = (
            (spacecraft,) if spacecraft is not None else tuple(b for b in held if b in SPACECRAFT_IDS)
        )
        self.targets = tuple(number for target in targets for number in self._number(target))
        self.bodies = tuple(dict.fromkeys((*self.crafts, *self.targets))) if targets else tuple(held)
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
            return cover.ck_structures(cover.frame_number(frame))
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            self.problems.append(unlisted_explanation(error, Request(f"camera frame {frame}", frame=frame)))
            return ()


def held_bodies(kind: str) -> list[int]:
    """Return the bodies of all loaded SPKs, or the structures of all loaded CKs; lock held."""
    files = (f.path for f in pool.loaded_files() if f.kind == kind)
    return sorted({body for path in files for body in cover.bodies_in(path)})


def coverage_rows(asked: Question) -> tuple[CoverageRow, ...]:
    """Return the rows of all bodies and structures, spacecraft first, then bodies, then attitudes; lock held."""
    bodies = sorted({*held_bodies("SPK"), *asked.bodies}, key=lambda b: (b >= 0, abs(b)))
    structures = sorted({*held_bodies("CK"), *asked.structures}, reverse=True)
    rows = [_row("SPK", b, b in asked.bodies, asked) for b in bodies]
    return (*rows, *(_row("CK", s, s in asked.structures, asked) for s in structures))


def _row(kind: str, body: int, needed: bool, asked: Question) -> CoverageRow:
    paths = tuple(f.path for f in pool.loaded_files() if f.kind == kind and body in cover.bodies_in(f.path))
    name = cover.name_of(kind, body)
    try:
        merged = cover.merged_windows(kind, body, paths)
        files = tuple((path, cover.merged_windows(kind, body, (path,))) for path in paths)
    except spiceypy.SpiceyError as error:  # the clock of a CK, or the leap seconds, are missing
        spiceypy.reset()
        asked.problems.append(unlisted_explanation(error, Request(f"times of the CK of {name}")))
        merged, files = np.empty((0, 2)), tuple((path, np.empty((0, 2))) for path in paths)
    title = "CK" if kind == "CK" else "spacecraft SPK" if body in asked.crafts or body < 0 else "target SPK"
    overlaps = overlaps_of([windows for _, windows in files])
    return CoverageRow(title, body, name, merged, gaps_between(merged), overlaps, files, needed)
