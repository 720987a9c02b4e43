"""Coverage of the loaded kernels: SPK windows per body, CK windows per structure, a frame's chain of CKs.

Windows are arrays (k, 2) of start and stop in TDB s past J2000, disjoint and in order. Besides reading them from the
loaded files, this module does the arithmetic on them: gaps between windows, overlaps of several files, and the share
of a time axis that is covered.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.files import segments
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
    from spiceypy.utils import support_types
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")
    support_types = module_on_demand("spiceypy.utils.support_types")

__all__ = [
    "Coverage",
    "bodies_in",
    "body_or_structure_name",
    "ck_structures",
    "covered_share",
    "frame_number",
    "gaps_between",
    "gaps_within",
    "held_bodies",
    "loaded_windows",
    "merged_windows",
    "overlaps_of",
    "windows_contain",
    "windows_of",
]


# ---- What the loaded kernels cover: SPK windows per body, CK windows per structure, a frame's chain of CKs.

WINDOW_SIZES = (2_000, 200_000, 4_000_000)  # doubles; a CK of single pictures has two for each
PCK_FRAME, CK_FRAME, FIXED_OFFSET_FRAME = 2, 3, 4  # SPICE's frame classes
LONGEST_CHAIN = 20  # frames; real ones have 2 to 5


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """When the loaded kernels know one body's position or one structure's attitude."""

    kind: str  # "SPK" or "CK"
    body: int  # NAIF number of the body, or of the CK structure
    name: str
    intervals_et: FloatArray  # (k, 2) start and stop, TDB s past J2000, disjoint and in order
    paths: tuple[Path, ...]  # the files that contribute

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def path(self) -> Path:
        """The first of the files that contribute."""
        return self.paths[0]

    def contains(self, et: float) -> bool:
        """Tell whether a time lies in a window, ends included."""
        return windows_contain(self.intervals_et, et)


def loaded_windows(kind: str) -> tuple[Coverage, ...]:
    """Return the coverage of all bodies or structures over all loaded files, lock held.

    Raises
    ------
    SpiceyError
        A CK's clock is not loaded.
    """
    return tuple(windows_of(kind, body) for body in held_bodies(kind))


def windows_of(kind: str, body: int) -> Coverage:
    """Return the merged coverage of one body or structure; without windows if no file holds it; lock held."""
    paths = tuple(f.path for f in pool.loaded_files() if f.kind == kind and body in bodies_in(f.path))
    return Coverage(kind, body, body_or_structure_name(kind, body), merged_windows(kind, body, paths), paths)


def frame_number(frame: str) -> int:
    """Return the number of a frame, lock held.

    Raises
    ------
    SpiceyError
        The frame is unknown.
    """
    number = int(spiceypy.namfrm(frame))
    if number == 0:
        spiceypy.pxform("J2000", frame, 0.0)  # fails in SPICE's own words
    return number


def held_bodies(kind: str) -> list[int]:
    """Return the bodies of all loaded SPKs, or the structures of all loaded CKs, sorted; lock held."""
    return sorted({b for f in pool.loaded_files() if f.kind == kind for b in bodies_in(f.path)})


def ck_structures(frame_id: int) -> tuple[int, ...]:
    """Return the CK structures between a frame and the inertial one, nearest first, lock held.

    A CK may refer to another CK frame (a camera on a mechanism, the mechanism on the spacecraft), so the
    reference frames of the loaded segments are followed, too.
    """
    structures: list[int] = []
    waiting, seen = [frame_id], set[int]()
    while waiting and len(seen) < LONGEST_CHAIN:
        frame = waiting.pop(0)
        if frame in seen:
            continue
        seen.add(frame)
        _, frame_class, class_id = spiceypy.frinfo(frame)
        if frame_class == CK_FRAME:
            structures.append(class_id)
            waiting.extend(_references(class_id))
        elif frame_class == FIXED_OFFSET_FRAME:
            waiting.append(spiceypy.tkfram(class_id)[1])
    return tuple(structures)


def _references(structure: int) -> Iterable[int]:
    held = (s for f in pool.loaded_files() if f.kind == "CK" for s in segments(f.path))
    return sorted({s.integers[1] for s in held if s.integers[0] == structure})


def bodies_in(path: Path) -> frozenset[int]:
    """Return the bodies of an SPK, or the structures of a CK."""
    return frozenset(s.integers[0] for s in segments(path))


def body_or_structure_name(kind: str, body: int) -> str:
    """Return the name of a body or structure, its number where it has none; lock held."""
    # A CK structure's number is as a rule that of the frame it orients, and the frame's name says what it is.
    return str((kind == "CK" and spiceypy.frmnam(body)) or spiceypy.bodc2s(body))


def merged_windows(kind: str, body: int, paths: tuple[Path, ...]) -> FloatArray:
    """Return when some files together know a body or structure, (k, 2), TDB s; lock held."""
    for size in WINDOW_SIZES:
        window = support_types.SPICEDOUBLE_CELL(size)
        try:
            for path in paths:
                _fill(kind, str(path), body, window)
            break
        except spiceypy.SpiceyError as error:
            if "EXCESS" not in error.short or size == WINDOW_SIZES[-1]:
                raise
    return np.array(list(window), float).reshape(-1, 2)


def _fill(kind: str, path: str, body: int, window: Any) -> None:
    if kind == "CK":
        spiceypy.ckcov(path, body, False, "INTERVAL", 0.0, "TDB", window)
    else:
        spiceypy.spkcov(path, body, window)


# ---- Stretches of time: what lies between windows, and where windows of several files lie over one another.

NO_WINDOWS = np.empty((0, 2))


def windows_contain(windows: FloatArray, et: float) -> bool:
    """Tell whether a time lies in one of some windows (k, 2), ends included."""
    return bool(((windows[:, 0] <= et) & (et <= windows[:, 1])).any())


def gaps_between(windows: FloatArray) -> FloatArray:
    """Return the gaps (m, 2) between disjoint windows (k, 2) in order.

    Examples
    --------
    >>> gaps_between(np.array([[0.0, 1.0], [3.0, 4.0]]))
    array([[1., 3.]])
    """
    return np.column_stack([windows[:-1, 1], windows[1:, 0]]) if len(windows) > 1 else NO_WINDOWS


def gaps_within(windows: FloatArray, begin: float, end: float) -> FloatArray:
    """Return which parts (m, 2) of a stretch of time no window (k, 2) of some disjoint ones in order covers.

    Examples
    --------
    >>> gaps_within(np.array([[0.0, 1.0], [3.0, 4.0]]), 0.5, 5.0)
    array([[1., 3.],
           [4., 5.]])
    """
    edges = np.concatenate([[begin], np.clip(windows, begin, end).ravel(), [end]]).reshape(-1, 2)
    return edges[edges[:, 1] > edges[:, 0]]


def overlaps_of(windows: Sequence[FloatArray]) -> FloatArray:
    """Return where at least two of several sets of windows are valid, (m, 2), disjoint and in order.

    Windows that only touch do not overlap.

    Parameters
    ----------
    windows : sequence of (k, 2) arrays
        Each disjoint in itself.

    Examples
    --------
    >>> overlaps_of([np.array([[0.0, 2.0], [5.0, 6.0]]), np.array([[1.0, 5.0]])])
    array([[1., 2.]])
    """
    every = np.concatenate([*windows, NO_WINDOWS])
    edges = np.concatenate([every[:, 0], every[:, 1]])
    steps = np.repeat([1, -1], len(every))
    order = np.lexsort((steps, edges))  # at one instant ends come before starts
    depth = np.cumsum(steps[order])
    before = np.concatenate([[0], depth[:-1]])
    starts = edges[order][(before < 2) & (depth >= 2)]
    stops = edges[order][(before >= 2) & (depth < 2)]
    found = np.column_stack([starts, stops])
    return np.asarray(found[found[:, 1] > found[:, 0]], dtype=np.float64)


def covered_share(windows: FloatArray, edges: FloatArray) -> FloatArray:
    """Return how much of each cell between increasing edges the windows cover, 0 to 1, shape (n - 1,).

    Examples
    --------
    >>> covered_share(np.array([[1.0, 2.5]]), np.array([0.0, 1.0, 2.0, 3.0]))
    array([0. , 1. , 0.5])
    """
    starts, stops = windows.T
    lengths = np.concatenate([[0.0], np.cumsum(stops - starts)])
    index = np.searchsorted(starts, edges, side="right")  # windows that have begun
    beyond = np.maximum(stops[index - 1] - edges, 0.0) if len(windows) else np.zeros(len(edges))
    until = lengths[index] - np.where(index > 0, beyond, 0.0)
    return np.asarray(np.diff(until) / np.diff(edges), dtype=np.float64)
