"""The CSPICE kernel pool: one per process, not thread-safe, so taken by lock and given back as found.

All that touches the pool's files and variables stands here: the lock around every call into spiceypy, the stack of
opened kernel sets, and snapshots by which a set leaves the pool exactly as it was. Only the other modules of
`opnav_workbench.kernels` use it; everybody else comes through `KernelSet`.
"""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "LOCK",
    "OpenedSet",
    "PoolValue",
    "Snapshot",
    "active",
    "capture",
    "has_clock",
    "isolated",
    "loaded_files",
    "opened",
    "pool_names",
    "pool_value",
    "restore",
]

LOCK = threading.RLock()  # around every call into spiceypy
# Pool variable names fetched at first, and then at a time: every place asked for costs time; the pool holds 26 003 at most.
FIRST_NAMES, NAMES_PER_CALL = 50, 5000

PoolValue = tuple[float, ...] | tuple[str, ...]


class OpenableSet(Protocol):
    """What can stand on the stack of opened kernel sets."""

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files in loading order."""


@dataclass(frozen=True, slots=True)
class LoadedFile:
    """One row of the pool's own list of files."""

    name: str  # as it was given to SPICE
    path: Path  # absolute, taken when the row was read
    kind: str  # SPICE's word: SPK, CK, PCK, DSK, EK, TEXT or META
    source: str  # the metakernel that loaded it; empty if loaded by itself


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that SPICE held at one moment."""

    folder: Path  # working folder: names may be relative to it
    files: tuple[LoadedFile, ...]
    variables: dict[str, PoolValue]


@dataclass(slots=True)
class OpenedSet:
    """One opened kernel set."""

    owner: OpenableSet
    before: Snapshot | None  # None: it joined a set that was open already, and the pool was not touched
    thread: int


opened: list[OpenedSet] = []  # innermost last


def active() -> OpenableSet | None:
    """Return the innermost opened kernel set."""
    return opened[-1].owner if opened else None


def loaded_files() -> tuple[LoadedFile, ...]:
    """Return SPICE's list of loaded files, in loading order. Call it with the lock held."""
    rows = (spiceypy.kdata(i, "ALL") for i in range(spiceypy.ktotal("ALL")))
    return tuple(LoadedFile(name, Path(name).absolute(), kind, source) for name, kind, source, _ in rows)


def capture() -> Snapshot:
    """Return all that SPICE holds now. Call it with the lock held."""
    variables = {name: value for name in pool_names("*") if (value := pool_value(name)) is not None}
    return Snapshot(Path.cwd(), loaded_files(), variables)


def restore(before: Snapshot) -> None:
    """Empty the pool and bring back what a snapshot remembers, files and variables; lock held.

    Raises
    ------
    SpiceyError
        A file of the snapshot is gone; the others are loaded nevertheless.
    """
    spiceypy.kclear()
    failures = []
    for name in _names_to_load(before):
        try:
            spiceypy.furnsh(name)
        except spiceypy.SpiceyError as error:
            failures.append(error)
    _restore_variables(before.variables)
    if failures:
        raise failures[0]


@contextlib.contextmanager
def isolated() -> Iterator[None]:
    """Give the block an empty pool, and bring everything back afterwards. Call it with the lock held."""
    before = capture()
    spiceypy.kclear()
    try:
        yield
    finally:
        restore(before)


def _names_to_load(before: Snapshot) -> list[str]:
    if Path.cwd() == before.folder:  # SPICE finds relative names again, those inside metakernels too
        return [f.name for f in before.files if not f.source]
    return [str(f.path) for f in before.files if f.kind != "META"]


def _restore_variables(wanted: dict[str, PoolValue]) -> None:
    """Set what is missing or differs: variables set by hand, or changed after their file was loaded."""
    for name in set(pool_names("*")) - wanted.keys():
        spiceypy.dvpool(name)
    for name, value in wanted.items():
        if pool_value(name) != value:
            put = spiceypy.pcpool if isinstance(value[0], str) else spiceypy.pdpool
            put(name, value)


def pool_names(template: str) -> list[str]:
    """Return the names of pool variables that match a template with ``*`` and ``%``; lock held."""
    names: list[str] = []
    room = FIRST_NAMES
    try:
        while True:
            page: Any = spiceypy.gnpool(template, len(names), room)
            names.extend(page)
            if len(page) < room:
                break
            room = NAMES_PER_CALL
    except spiceypy.NotFoundError:
        pass  # SPICE's way to say: no (more) names
    return names


def pool_value(name: str) -> PoolValue | None:
    """Return all values of one pool variable, or None if there is none; lock held."""
    try:
        size, kind = spiceypy.dtpool(name)
        if kind == "C":
            return tuple(str(v) for v in spiceypy.gcpool(name, 0, size))
        return tuple(float(v) for v in spiceypy.gdpool(name, 0, size))
    except spiceypy.NotFoundError:
        return None


def has_clock(clock: int) -> bool:
    """Tell whether a loaded kernel describes the clock of this (negative) number; lock held."""
    return pool_value(f"SCLK_DATA_TYPE_{-clock}") is not None
