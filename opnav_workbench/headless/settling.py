"""A picture's new folder put into its place, without taking anything from anybody.

Whether the place may be taken is asked when it is taken, under the lock that every session holds: an analyst may have come
since the night was planned.  What no night wrote is never deleted, it goes to the attic::

    OUT/.attic/<picture>/<time>/     a night's result whose place an analyst holds, or what an older folder held of others

An older folder goes to the attic whole before the new one is moved in, and only then what a night wrote is deleted from it;
so a kill between any two steps leaves all of it in one of two places, and `tidy_attic` takes up where it stopped.
"""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder, sha256_of
from opnav_workbench.headless.records import (
    RECORD_FILE,
    NightRecord,
    files_in,
    is_of_an_analyst,
    read_record,
    session_digest,
    write_record,
)
from opnav_workbench.session.folder_lock import LOCK_FILE, FolderInUse, FolderLock
from opnav_workbench.session.storage import ATTIC

__all__ = ["Settled", "settle", "tidy_attic"]


@dataclass(frozen=True, slots=True)
class Settled:
    """What became of a new folder.

    Attributes
    ----------
    placed
        Whether it stands in its place.
    note
        What was kept, why and where; empty as a rule.
    """

    placed: bool
    note: str = ""


def settle(work: Path, final: Path, record: NightRecord) -> Settled:
    """Move a working folder to its place, with its record, unless an analyst has it open or worked there.

    Parameters
    ----------
    work
        On the same file system as `final`.
    record
        Without the files, which are listed here.

    Raises
    ------
    SessionError
        The folders cannot be written.
    """
    try:
        return _settled(work, final, record)
    except OSError as error:
        raise SessionError(
            f"cannot move results to {final}: {error.strerror}; what is finished is kept, run the same command again."
        ) from error


def _settled(work: Path, final: Path, record: NightRecord) -> Settled:
    with ExitStack() as locks:
        new = locks.enter_context(
            FolderLock(work)
        )  # it arrives locked: nobody works in it before all is done
        old = None
        if final.exists():
            try:
                old = locks.enter_context(FolderLock(final))
            except FolderInUse as error:
                return _set_aside(work, final, new, f"it is open elsewhere ({error.holder})")
            except SessionError as error:
                return _set_aside(work, final, new, str(error))
            standing = read_record(final)
            if is_of_an_analyst(standing, session_digest(final)):
                return _set_aside(work, final, new, "an analyst has worked on it")
        written = files_in(work)
        written.pop(LOCK_FILE, None)
        write_record(work, replace(record, files=written))
        gone = None if old is None else _moved_to_attic(final, old)
        try:
            work.rename(final)
        except OSError as error:
            if not final.exists():
                raise
            return _set_aside(work, final, new, f"another has made its folder meanwhile ({error.strerror})")
        new.moved(final)
    return Settled(placed=True, note="" if gone is None else _emptied(gone))


def _set_aside(work: Path, final: Path, lock: FolderLock, why: str) -> Settled:
    """Keep a night's own result where it harms nobody; without a record it counts as nobody's to delete."""
    (work / RECORD_FILE).unlink(missing_ok=True)
    kept = _moved_to_attic(work, lock, final)
    return Settled(placed=False, note=f"left as it is: {why}; the night's own result is in {kept}")


def _moved_to_attic(folder: Path, lock: FolderLock, final: Path | None = None) -> Path:
    place = _attic_of(final or folder)
    folder.rename(place)
    lock.moved(place)
    return place


def _attic_of(final: Path) -> Path:
    now = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    return make_folder(final.parent / ATTIC / final.name) / f"{now}-{uuid.uuid4().hex[:6]}"


def _emptied(gone: Path) -> str:
    """Delete what a night wrote from an older folder; say where the rest is, if there is any."""
    record = read_record(gone)
    for name, sha256 in () if record is None else record.files.items():
        path = gone / name
        if path.is_file() and sha256_of(path) == sha256:
            path.unlink()
    if record is not None and record.files:
        (gone / LOCK_FILE).unlink(missing_ok=True)
        left = sorted(p for p in gone.rglob("*") if p.is_file() and p != gone / RECORD_FILE)
        if not left:  # the record goes last: until then this can be repeated
            shutil.rmtree(gone, ignore_errors=True)
            with suppress(OSError):
                gone.parent.rmdir()
            return ""
        (gone / RECORD_FILE).unlink(missing_ok=True)
        named = ", ".join(str(p.relative_to(gone)) for p in left[:3])
        return f"files that no night wrote ({named}{', ...' if len(left) > 3 else ''}) are kept in {gone}"
    return f"what stood there before is kept in {gone}"


def tidy_attic(out: Path) -> tuple[str, ...]:
    """Finish what a night that was killed had begun: give folders back whose place is empty, else empty them.

    Returns
    -------
    tuple of str
        What was given back.
    """
    said = []
    for entry in _unfinished(out / ATTIC):
        final = out / entry.parent.name
        if final.exists():
            _emptied(entry)
        else:
            entry.rename(final)
            with suppress(OSError):
                entry.parent.rmdir()
            said.append(f"{final.name}: given back from {entry}, where a night that was killed had put it")
    return tuple(said)


def _unfinished(attic: Path) -> Iterator[Path]:
    """Yield what has a record in the attic, the youngest first."""
    entries = sorted(attic.glob(f"*/*/{RECORD_FILE}"), key=lambda path: path.parent.name, reverse=True)
    yield from (path.parent for path in entries)
