"""Kernel files in loading order, loaded for a block of code, and everything back as it was afterwards.

A metakernel is followed by the files that it lists, a folder stands for its kernels in the order LSK, SCLK, PCK, FK,
IK, SPK, CK; all missing files are named at once, before anything is loaded. Nothing here knows names of kernel sets:
that is the matter of `opnav_workbench.kernels.kernel_set`, which stands above the making of kernels, as this module
stands below it.

Source: NAIF, Kernel Required Reading (metakernels; a path has at most 255 bytes).
"""

import contextlib
import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self, cast

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import coverage as cover
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.calls import SpiceRequest, spice_call, time_text
from opnav_workbench.kernels.coverage import Coverage
from opnav_workbench.kernels.files import KINDS, KernelFile, kernel_file, looks_like_kernel
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import exists, is_file, is_folder

if TYPE_CHECKING:
    import spiceypy
    from astropy.table import QTable
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "KernelSource",
    "LoadedKernels",
    "MissingFile",
    "entries_at",
    "kernel_files",
    "listed_files",
    "none_missing",
    "require_short_path",
]


# ---- From what a person names (a scenario, a metakernel, files, a folder) to the kernel files, in order.

LONGEST_PATH_BYTES = 255  # CSPICE: N0067, FURNSH
CONTINUED = "+"  # ends a pool string whose rest follows in the next one
META_VARIABLES = ("KERNELS_TO_LOAD", "PATH_VALUES", "PATH_SYMBOLS")

KernelSource = str | os.PathLike[str]


@dataclass(frozen=True, slots=True)
class MissingFile:
    """A file that is not there, and the metakernel that lists it."""

    path: Path
    listed_in: Path | None

    def __str__(self) -> str:
        return f"{self.path} (listed in {self.listed_in.name})" if self.listed_in else str(self.path)


def kernel_files(paths: Iterable[Path]) -> tuple[KernelFile, ...]:
    """Return the kernels at some paths in loading order: files, metakernels with what they list, folders.

    Raises
    ------
    KernelError
        Files are missing (all are named); a file is no whole kernel; a path is too long.
    """
    return none_missing(entry for path in paths for entry in entries_at(path.absolute()))


def none_missing(entries: Iterable[KernelFile | MissingFile]) -> tuple[KernelFile, ...]:
    """Return the entries, all of them files; else raise KernelError that names all missing ones."""
    found = list(entries)
    missing = [e for e in found if isinstance(e, MissingFile)]
    if missing:
        count = "1 kernel is" if len(missing) == 1 else f"{len(missing)} kernels are"
        raise KernelError(
            f"{count} missing: {', '.join(str(m) for m in missing)}; correct the paths or fetch the files. "
            "Nothing was loaded."
        )
    return tuple(e for e in found if isinstance(e, KernelFile))


def entries_at(path: Path, *, named: bool = False) -> Iterator[KernelFile | MissingFile]:
    """Yield a file, followed by what it lists, or the kernels of a folder; `named` as in `listed_files` (not here_first)."""
    require_short_path(path)
    if is_folder(path):
        yield from _folder_kernels(path)
    else:
        yield from _expanded_file(path, named=named)


def _folder_kernels(folder: Path) -> Iterator[KernelFile | MissingFile]:
    """Return all kernels of a folder in loading order, but no metakernels: their files stand there, too."""
    files = [p for p in sorted(folder.iterdir()) if p.is_file() and looks_like_kernel(p)]
    for path in files:
        require_short_path(path)
    entries = [e for e in map(kernel_file, files) if e.kind != "META"]
    if not entries:
        inner = ", ".join(sorted(p.name for p in folder.iterdir() if p.is_dir())) or "none"
        raise KernelError(
            f"no kernels in the folder {folder}; folders within: {inner}. Give one that holds kernels."
        )
    yield from sorted(entries, key=lambda e: (KINDS.index(e.kind), e.path.name))


def _expanded_file(
    path: Path, above: tuple[Path, ...] = (), *, named: bool = False
) -> Iterator[KernelFile | MissingFile]:
    listed_in = above[-1] if above else None
    if path in above:
        raise KernelError(f"{path} lists itself through {above[-1]}; remove it from KERNELS_TO_LOAD.")
    require_short_path(path, listed_in)
    if not is_file(path):
        yield MissingFile(path, listed_in)
        return
    entry = kernel_file(path)
    yield entry
    if entry.kind == "META":
        for inner in listed_files(path, here_first=not named):
            yield from _expanded_file(inner, (*above, path), named=named)


def require_short_path(path: Path, listed_in: Path | None = None) -> None:
    """Raise KernelError where a path is longer than SPICE takes, or no text."""
    try:
        length = len(str(path).encode())
    except UnicodeEncodeError as error:  # a name of any bytes
        raise KernelError(
            f"the path {path} has bytes that are no UTF-8, which SPICE cannot be told; rename it, or give a symbolic link."
        ) from error
    if length > LONGEST_PATH_BYTES:
        within = f" (listed in {listed_in})" if listed_in else ""
        raise KernelError(
            f"the path {path}{within} has {length} bytes, SPICE takes {LONGEST_PATH_BYTES}; move the kernels "
            "or give them a shorter path by a symbolic link."
        )


def listed_files(metakernel: Path, *, here_first: bool) -> list[Path]:
    """Return the files that a metakernel lists, as absolute paths; SPICE itself parses the text.

    Relative paths count from the working folder, as in SPICE, or else from the metakernel's own. The other
    way round for the package's own metakernels: a file of the same name in the working folder must not slip
    in.
    """
    request = SpiceRequest(f"reading the metakernel {metakernel}")
    with spice_call(request, needs_kernels=False), pool.isolated():
        spiceypy.ldpool(str(metakernel))
        names, values, symbols = (_continued_strings(pool.pool_value(v)) for v in META_VARIABLES)
    if len(values) != len(symbols):
        raise KernelError(
            f"{metakernel} gives {len(values)} PATH_VALUES for {len(symbols)} PATH_SYMBOLS; make them pairs."
        )
    paths = dict(zip(symbols, values, strict=True))
    folders = (Path.cwd(), metakernel.parent)[:: 1 if here_first else -1]
    return [_located(_substituted(name, paths, metakernel), folders) for name in names]


def _continued_strings(value: pool.PoolValue | None) -> list[str]:
    """Join pool strings that continue in the next one."""
    joined: list[str] = []
    going_on = False
    for part in (str(v) for v in value or ()):
        text = part.rstrip()
        if going_on:
            joined[-1] += text.removesuffix(CONTINUED)
        else:
            joined.append(text.removesuffix(CONTINUED))
        going_on = text.endswith(CONTINUED)
    return joined


def _substituted(name: str, paths: dict[str, str], metakernel: Path) -> str:
    def value(match: re.Match[str]) -> str:
        rest = match[1]
        symbol = max((s for s in paths if rest.startswith(s)), key=len, default=None)
        if symbol is None:
            raise KernelError(
                f"{metakernel} uses the symbol ${rest}; add it to PATH_SYMBOLS and PATH_VALUES."
            )
        return paths[symbol] + rest[len(symbol) :]

    return re.sub(r"\$(\w+)", value, name)


def _located(name: str, folders: tuple[Path, ...]) -> Path:
    candidates = [Path(os.path.normpath(folder / name)) for folder in folders]
    return next((c for c in candidates if exists(c)), candidates[-1])


# ---- Kernel sets: SPICE kernels opened for a block of code, and everything back as it was afterwards.

# What a "no" looks like; the last one is a time outside the spacecraft clock's partitions.
NO_DATA_FAILURES = (
    "SPKINSUFFDATA",
    "NOLOADEDFILES",
    "NOFRAMECONNECT",
    "FRAMEDATANOTFOUND",
    "VALUEOUTOFRANGE",
)


class LoadedKernels:
    """Kernel files, loaded on entering the block and unloaded on leaving it.

    On entering, SPICE holds these kernels and nothing else; on leaving, also through an exception, exactly
    the files and variables it held before. Sets nest, and one set may be opened again inside itself. SPICE
    has one kernel pool per process: while a set is open, another thread may use it and may open the same
    kernels, but no others. `KernelSet` is the one that takes names.

    Parameters
    ----------
    files
        In loading order, as `kernel_files` returns them.
    """

    def __init__(self, files: Sequence[KernelFile]) -> None:
        self._files = tuple(files)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({[p.name for p in self.paths]})"

    @staticmethod
    def active() -> "LoadedKernels | None":
        """Return the innermost open set, or None."""
        return cast("LoadedKernels | None", pool.active())

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
                pool.opened.append(pool.OpenedSet(self, before, thread))
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

    def _join(self, outer: pool.OpenedSet, thread: int) -> None:
        if outer.owner.paths != self.paths:
            names = ", ".join(p.name for p in outer.owner.paths[:3])
            raise KernelError(
                f"another thread has other kernels open ({names}, ...), and SPICE holds one set per process; "
                "open one KernelSet around all threads, or use processes."
            )
        pool.opened.append(pool.OpenedSet(self, None, thread))

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
        with self._call(SpiceRequest("coverage")):
            kinds = ("SPK", "CK") if kind is None else (kind,)
            return tuple(c for k in kinds for c in cover.loaded_windows(k))

    def coverage_table(self) -> "QTable":
        """Return `coverage` as a table, a row per window: kind, body, name, start, stop (s, UTC), files."""
        rows = [(c, start, stop) for c in self.coverage() for start, stop in c.intervals_et.tolist()]
        with self._call(SpiceRequest("coverage")):
            utc = [[time_text(t).removesuffix(" UTC") for t in (start, stop)] for _, start, stop in rows]
        from astropy import units  # noqa: PLC0415
        from astropy.table import QTable  # noqa: PLC0415 (a fifth of a short command; few need a table)

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
        with self._call(SpiceRequest(f"attitude of {frame}", frame=frame)):
            return set(cover.held_bodies("CK")).issuperset(cover.ck_structures(cover.frame_number(frame)))

    def covers_attitude(self, frame: str, et: float) -> bool:
        """Tell whether the attitude of a frame is known at a time, along its chain of CKs.

        Raises
        ------
        KernelError
            The frame is unknown, or the SCLK or LSK kernel is missing: then no time can be told.
        """
        with self._call(SpiceRequest(f"attitude of {frame}", et, frame=frame)):
            structures = cover.ck_structures(cover.frame_number(frame))
            if not set(cover.held_bodies("CK")).issuperset(structures):
                return False
            for structure in structures:  # without its clock SPICE says "no data", which would mislead
                spiceypy.scpart(spiceypy.ckmeta(structure, "SCLK"))
            return _has_data(lambda: spiceypy.pxform("J2000", frame, et))

    def covers_state(
        self, target: str | int, observer: str | int, et: float, correction: str = "NONE"
    ) -> bool:
        """Tell whether the state of a body relative to another is known at a time.

        Parameters
        ----------
        target, observer
            Names or NAIF numbers.
        et
            TDB s past J2000.
        correction
            With light time ("LT", "CN", "CN+S") the target must be known one light time earlier, too, and
            both relative to the solar system barycenter.

        Raises
        ------
        KernelError
            A body is unknown.
        """
        request = SpiceRequest(f"state of {target} relative to {observer}", et, (target, observer))
        with self._call(request):
            return _has_data(lambda: spiceypy.spkezr(str(target), et, "J2000", correction, str(observer)))

    @contextlib.contextmanager
    def _call(self, request: SpiceRequest) -> Iterator[None]:
        with spice_call(request, needs_kernels=True):
            if pool.active() is not self and self.paths != cast("LoadedKernels", pool.active()).paths:
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


def _has_data(call: Callable[[], object]) -> bool:
    """Tell whether SPICE answers, or finds no data; other failures pass."""
    try:
        call()
    except spiceypy.SpiceyError as error:
        if getattr(error, "short", "").removeprefix("SPICE(").removesuffix(")") not in NO_DATA_FAILURES:
            raise
        return False
    return True
