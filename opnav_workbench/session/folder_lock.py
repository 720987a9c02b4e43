"""One writer per session folder: a lock of the operating system, which a process that dies gives up by itself.

`filelock` takes it.  Ours is what filelock has not: the lock file says who holds it, and where the file system knows no
locks, that word is taken for it instead of the file's mere existence: a process of this machine that no longer runs has
left a stale lock, which is taken over.
"""

import errno
import json
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from opnav_workbench.errors import SessionError

__all__ = ["FolderLock", "check_unlocked"]

LOCK_FILE = ".session.lock"
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)  # of a file system that knows none


class FolderLock:
    """The right to write into a session's folder, until `release`, its own end or that of the process.

    Raises
    ------
    SessionError
        Another process holds it (it is named), or the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_FILE
        try:
            self._lock = _taken(self._path)
        except OSError as error:
            raise SessionError(
                f"cannot write into {folder}: {error.strerror}. Choose another folder."
            ) from error
        self._held = True
        self._sign()

    def _sign(self) -> None:
        """Say who holds the lock; a full disk keeps nobody from working."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        with suppress(OSError):
            self._path.write_text(
                json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since}),
                encoding="utf-8",
            )

    def release(self) -> None:
        """Let others write."""
        if not self._held:
            return
        with suppress(OSError):
            os.truncate(self._path, 0)
        self._lock.release()
        self._held = False


def check_unlocked(folder: Path) -> None:
    """Refuse a folder that another process writes into; leaves no lock behind.

    Raises
    ------
    SessionError
        The process is named.
    """
    path = folder / LOCK_FILE
    if path.exists():
        with suppress(OSError):  # writing will say what is wrong
            _taken(path).release()


def _taken(path: Path) -> FileLock:
    """Return the lock, taken; one of a file system without locks is not, but nobody else says that he has it.

    Raises
    ------
    SessionError
        Another process holds it.
    OSError
        The file cannot be written.
    """
    lock = FileLock(path, blocking=False, thread_local=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise SessionError(_refusal(path, _holder(path))) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        holder = _holder(path)
        if _runs_here(holder) or holder.get("host") not in (None, socket.gethostname()):
            raise SessionError(_refusal(path, holder)) from error
    return lock


def _holder(path: Path) -> Mapping[str, Any]:
    try:
        holder = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return holder if isinstance(holder, dict) else {}


def _runs_here(holder: Mapping[str, Any]) -> bool:
    pid = holder.get("pid")
    if not isinstance(pid, int) or holder.get("host") != socket.gethostname() or pid == os.getpid():
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _refusal(path: Path, holder: Mapping[str, Any]) -> str:
    who = "another process"
    if holder:
        who = f"process {holder.get('pid')} on {holder.get('host')} (since {holder.get('since')})"
    return (
        f"{path.parent} is being written by {who}; close the session there, or resume it here without autosave "
        "and save it into another folder."
    )
