"""One writer per session folder: a lock of the operating system, which a process that dies gives up by itself.

`filelock` takes it.  Ours is what filelock has not: the lock file says who holds it, and where the file system knows no
locks, that word is taken for it instead of the file's mere existence: a process of this machine that no longer runs has
left a stale lock, which is taken over.

The lock file stands in the folder, and folders move: a night puts a new one into the place of an old one. So a lock counts
only while its file still stands at its path, which is looked at once it is taken; what was opened just before the move is
given back and taken anew. For the same reason a lock file that is given up can be deleted.
"""

import errno
import getpass
import json
import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from filelock import FileLock, Timeout

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_value, text_of

__all__ = ["FolderInUse", "FolderLock", "check_unlocked"]

LOCK_FILE = ".session.lock"
# A night holds the lock while it moves a folder, a reader while it asks for it: less than this, and not worth a refusal.
PATIENCE_S, PAUSE_S = 0.25, 0.02
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)  # of a file system that knows none


class FolderInUse(SessionError):  # noqa: N818  no fault: it is at work
    """Another process writes into a folder.

    Attributes
    ----------
    holder
        Who, in words.
    """

    def __init__(self, folder: Path, holder: str) -> None:
        self.holder = holder
        super().__init__(
            f"{folder} is being written by {holder}; close the session there, or resume it here without autosave and save "
            "it into another folder."
        )


class FolderLock:
    """The right to write into a session's folder, until `release`, the end of a ``with`` block or that of the process.

    Parameters
    ----------
    folder
        Must be there.

    Raises
    ------
    FolderInUse
        Another process holds it.
    SessionError
        The folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_FILE
        try:
            self._lock = _taken(self._path)
        except OSError as error:
            holder = _holder(self._path)  # of another user, whose lock we may not even ask about
            signed = f" (its lock is signed by {_named(holder)})" if holder else ""
            raise SessionError(
                f"cannot write into {folder}: {error.strerror}{signed}. Choose another folder."
            ) from error
        self._held = True
        self._sign()

    def _sign(self) -> None:
        """Say who holds the lock; a full disk keeps nobody from working."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        with suppress(OSError):
            self._path.write_text(
                json.dumps(
                    {"user": _user(), "pid": os.getpid(), "host": socket.gethostname(), "since": since}
                ),
                encoding="utf-8",
            )

    def release(self) -> None:
        """Let others write."""
        if not self._held:
            return
        with suppress(OSError):  # what cannot be deleted (an open file in Windows) stays, and says nothing
            if _stands(self._lock, self._path):
                os.truncate(self._path, 0)
                if self._lock.is_locked:
                    self._path.unlink()
        self._lock.release()
        self._held = False

    @property
    def stands(self) -> bool:
        """Whether the lock still counts: its file was not deleted, nor its folder."""
        return _stands(self._lock, self._path)

    def moved(self, folder: Path) -> None:
        """Say where the folder is after whoever holds the lock has renamed it."""
        self._path = folder / LOCK_FILE

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


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
    """Return the lock, taken, its file where it belongs; waits a moment for one who holds it for a moment.

    Raises
    ------
    SessionError
        Another process holds it.
    OSError
        The file cannot be written.
    """
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            lock = _asked(path)
            if _stands(lock, path):
                return lock
            lock.release()  # of a folder that was moved away since its file was opened
        except SessionError:
            if time.monotonic() > deadline:
                raise
        time.sleep(PAUSE_S)


def _asked(path: Path) -> FileLock:
    """Return the lock, taken; one of a file system without locks is not, but nobody else says that he has it."""
    # Who may write into the folder may hold it, whatever the umask of the first who came.
    mode = path.parent.stat().st_mode & 0o666
    lock = FileLock(path, mode=mode, blocking=False, thread_local=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise FolderInUse(path.parent, _named(_holder(path))) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        holder = _holder(path)
        if _runs_here(holder) or holder.get("host") not in (None, socket.gethostname()):
            raise FolderInUse(path.parent, _named(holder)) from error
    return lock


def _stands(lock: FileLock, path: Path) -> bool:
    """Tell whether the file that is locked is the one at its path."""
    descriptor = lock._context.lock_file_fd  # noqa: SLF001  filelock gives no other way to its file
    if descriptor is None:  # a file system without locks
        return True
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _holder(path: Path) -> Mapping[str, Any]:
    try:
        holder = json_value(text_of(path))
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


def _named(holder: Mapping[str, Any]) -> str:
    if not holder:
        return "another process"
    user = f"{holder['user']}, " if holder.get("user") else ""
    return f"{user}process {holder.get('pid')} on {holder.get('host')} (since {holder.get('since')})"


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a number without a name, as in containers
        return str(os.getuid()) if hasattr(os, "getuid") else ""
