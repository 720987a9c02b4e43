"""A night's folder made smaller by age: notebooks and figures that can be made again, and what lies in the attic.

What a solution is (result, observables, session, record) stays for ever.  A file goes only where a night wrote it and nobody
has changed it since, its picture is solved, and no analyst has worked on it or has it open.  The attic holds what is not a
night's to delete: it goes only when its own age is given.
"""

import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.headless.night_pages import forget_missing_files
from opnav_workbench.headless.records import RECORD_FILE, is_of_an_analyst, read_record, session_digest
from opnav_workbench.paths import is_folder
from opnav_workbench.session.folder_lock import FolderLock, check_unlocked
from opnav_workbench.session.storage import ATTIC

__all__ = ["FIGURES", "NOTEBOOKS", "Retention", "Superfluous", "prune", "superfluous"]

NOTEBOOKS = ("notebook.ipynb", "notebook.html", "notebook.log")
FIGURES = ("summary.png",)
DAMAGED = "*.damaged-*"  # archives that were put aside


@dataclass(frozen=True, slots=True)
class Retention:
    """How many days to keep; None: for ever.

    Attributes
    ----------
    notebooks, figures
        Of pictures that are solved, counted from when they were processed.
    attic
        What nights put aside, and archives that were damaged.
    """

    notebooks: float | None = None
    figures: float | None = None
    attic: float | None = None


@dataclass(frozen=True, slots=True)
class Superfluous:
    """Something that may go.

    Attributes
    ----------
    kind : {"notebook", "figure", "attic"}
    """

    path: Path
    kind: str
    size_bytes: int


def superfluous(out: Path, keep: Retention) -> tuple[Superfluous, ...]:
    """Return what is older than it must be.

    Raises
    ------
    SessionError
        There is no such folder.
    """
    if not is_folder(out):
        raise SessionError(f"no folder {out}; give a night's.")
    return tuple(_found(out, keep, time.time()))


def _found(out: Path, keep: Retention, now: float) -> Iterator[Superfluous]:
    for record in sorted(out.glob(f"*/{RECORD_FILE}")):
        age = (now - record.stat().st_mtime) / DAY_S
        for names, kind, days in ((NOTEBOOKS, "notebook", keep.notebooks), (FIGURES, "figure", keep.figures)):
            if days is not None and age > days:
                yield from (
                    Superfluous(path, kind, path.stat().st_size) for path in _own(record.parent, names)
                )
    if keep.attic is not None:
        for path in (*sorted((out / ATTIC).glob("*/*")), *sorted(out.glob(DAMAGED))):
            if (now - path.stat().st_mtime) / DAY_S > keep.attic:
                yield Superfluous(path, "attic", _size(path))


def _own(folder: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files of these names that the night which solved this picture wrote, as they are."""
    record = read_record(folder)
    if record is None or record.status != "ok" or is_of_an_analyst(record, session_digest(folder)):
        return
    try:
        check_unlocked(folder)
    except SessionError:  # somebody looks at it
        return
    for name in names:
        path = folder / name
        if path.is_file() and record.files.get(name) == sha256_of(path):
            yield path


def _size(path: Path) -> int:
    inside = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in inside if file.is_file())


def prune(out: Path, keep: Retention) -> tuple[Superfluous, ...]:
    """Delete what is older than it must be, and return what has gone; whoever opens a picture meanwhile keeps all of it.

    The night's summary and pages are written anew, without the files that have gone.

    Raises
    ------
    SessionError
        There is no such folder, or it cannot be written.
    """
    gone = []
    for item in superfluous(out, keep):
        try:
            if item.kind == "attic":
                shutil.rmtree(item.path) if item.path.is_dir() else item.path.unlink()
                with suppress(OSError):
                    item.path.parent.rmdir()  # the last of its picture
            elif not _deleted(item):
                continue
        except OSError as error:
            raise SessionError(f"cannot delete {item.path}: {error.strerror or error}.") from error
        gone.append(item)
    if any(item.kind != "attic" for item in gone):
        forget_missing_files(out)
    return tuple(gone)


def _deleted(item: Superfluous) -> bool:
    """Delete a file of a picture's folder under its lock, if it still may go."""
    try:
        lock = FolderLock(item.path.parent)
    except SessionError:
        return False
    try:
        record = read_record(item.path.parent)
        known = record is not None and record.files.get(item.path.name)
        if is_of_an_analyst(record, session_digest(item.path.parent)) or known != sha256_of(item.path):
            return False
        item.path.unlink()
        return True
    finally:
        lock.release()
