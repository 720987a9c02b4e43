"""One writer per session folder: a lock of the operating system, which a process that dies gives up by itself.

The lock file says who holds it. Where the file system knows no locks, that word is taken for it: a process of this
machine that no longer runs has left a stale lock, which is taken over.
"""

import errno
import importlib
import json
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError

__all__ = ["FolderLock", "check_unlocked"]

fcntl: Any
try:
    fcntl = importlib.import_module("fcntl")
except ImportError:  # Windows
    fcntl = None

LOCK_FILE = ".session.lock"
HELD_ELSEWHERE = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)


class FolderLock:
    """The right to write into a session's folder, until `release` or the end of the process.

    Raises
    ------
    SessionError
        Another process holds it (it is named), or the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_FILE
        try:
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise SessionError(
                f"cannot write into {folder}: {error.strerror}. Choose another folder."
            ) from error
        try:
            _take(self._descriptor, self._path)
            self._sign()
        except BaseException:
            os.close(self._descriptor)
            raise

    def _sign(self) -> None:
        """Say who holds the lock; a full disk keeps nobody from working."""
        since = datetime.now(UTC).isoformat(timespec="seconds")
        text = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since})
        with suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, text.encode(), 0)

    def release(self) -> None:
        """Let others write."""
        if self._descriptor < 0:
            return
        with suppress(OSError):
            os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)
        self._descriptor = -1


def check_unlocked(folder: Path) -> None:
    """Refuse a folder that another process writes into; leaves no lock behind.

    Raises
    ------
    SessionError
        The process is named.
    """
    path = folder / LOCK_FILE
    if not path.exists():
        return
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return  # writing will say what is wrong
    try:
        _take(descriptor, path)
    finally:
        os.close(descriptor)


def _take(descriptor: int, path: Path) -> None:
    if _locked(descriptor, path):
        return
    holder = _holder(path)
    if _runs_here(holder) or holder.get("host") not in (None, socket.gethostname()):
        raise SessionError(_refusal(path, holder))


def _locked(descriptor: int, path: Path) -> bool:
    """Take the operating system's lock; False where there is none to take."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in HELD_ELSEWHERE:
            raise SessionError(_refusal(path, _holder(path))) from error
        return False
    return True


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
