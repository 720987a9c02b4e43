"""Autosave: every step is on disk when its method returns, and a crash at any moment loses none."""

import os
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder
from opnav_workbench.session.folder_lock import FolderLock
from opnav_workbench.session.history import History
from opnav_workbench.session.inputs_file import inputs_added
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.journal_file import JOURNAL_FILE, journal_line
from opnav_workbench.session.snapshot import write_state
from opnav_workbench.session.state import Inputs

__all__ = ["Autosave"]

KEEP_AFTER_S = 0.4  # of steps to be carried out again: with the picture itself, a session resumes in a second

_WRITERS: "dict[Path, weakref.ref[Autosave]]" = {}  # of this process


class Autosave:
    """The journal file of one session, open for appending.

    Parameters
    ----------
    folder : Path
        Made where it is not there.
    session, sha256 : str
        The session's id, and its picture's SHA-256.

    Raises
    ------
    SessionError
        The folder cannot be written, or another process writes into it. A session of this process that wrote there gives
        way: it is the same analyst, who ran a notebook's cell again.
    """

    def __init__(self, folder: Path, session: str, sha256: str) -> None:
        self.folder = make_folder(folder).resolve()
        self._session, self._sha256 = session, sha256
        self._unkept_s = 0.0
        self._taken_over = False
        older = _WRITERS.get(self.folder)
        if older is not None and (writer := older()) is not None:
            writer.give_way()
        self._lock = FolderLock(self.folder)
        self._path = self.folder / JOURNAL_FILE
        self._count = 0
        self._length = 0
        self._inputs: Inputs | None = None
        self._before: JournalEntry | None = None
        _WRITERS[self.folder] = weakref.ref(self)

    def start(self, history: History, count: int, length: int) -> None:
        """Go on after `count` entries that are on disk, of which the journal file holds `length` bytes.

        Raises
        ------
        SessionError
            The file cannot be written.
        """
        journal = history.journal
        self._count, self._length = count, length
        self._before = journal[count - 1] if count else None
        self._inputs = history.inputs if count == len(journal) else None
        try:
            with self._path.open("ab") as stream:
                stream.truncate(length)  # a line that a crash cut short
                os.fsync(stream.fileno())
        except OSError as error:
            raise self._failure(error, 0) from error

    def follow(self, history: History, cost_s: float = 0.0) -> None:
        """Append what the journal has gained; keep the state once it would take long to make it again.

        Parameters
        ----------
        history : History
        cost_s : float
            What its last step took.

        Raises
        ------
        SessionError
            The disk is full, or the file is not as it was left. What is missing is written with the next step.
        """
        fresh = history.journal[self._count :]
        if not fresh:
            return
        if self._taken_over:
            raise SessionError(
                f"{self.folder} is written by a newer session of this program; this one is kept in memory only: "
                "go on with the newer one, or save this one into another folder."
            )
        added: Mapping[str, Any] = inputs_added(self._inputs, history.inputs)
        lines, before = [], self._before
        for number, item in enumerate(fresh, start=self._count):
            lines.append(journal_line(self._session, number, before, item, added))
            before, added = item, {}
        self._append(b"".join(lines), len(fresh))
        self._count += len(fresh)
        self._before, self._inputs = before, history.inputs
        self._unkept_s += cost_s
        if self._unkept_s > KEEP_AFTER_S:
            write_state(self.folder, self._sha256, history.standing, history.state)
            self._unkept_s = 0.0

    def _append(self, data: bytes, steps: int) -> None:
        try:
            with self._path.open("r+b") as stream:
                size = os.fstat(stream.fileno()).st_size
                if size != self._length:
                    raise SessionError(
                        f"{self._path} was changed by another program ({size} bytes, {self._length} written here); the "
                        "session is kept in memory: save it into another folder."
                    )
                try:
                    stream.seek(self._length)
                    stream.write(data)
                    stream.flush()
                    os.fsync(stream.fileno())
                except OSError:
                    os.ftruncate(stream.fileno(), self._length)
                    raise
        except OSError as error:
            raise self._failure(error, steps) from error
        self._length += len(data)

    def _failure(self, error: OSError, steps: int) -> SessionError:
        kept = f"; {steps} steps are kept in memory and written with the next one" if steps else ""
        return SessionError(
            f"cannot write {self._path}: {error.strerror or error}{kept}. Free some space, or save the session into "
            "another folder."
        )

    def give_way(self) -> None:
        """Stop writing for a newer session of this process."""
        self._taken_over = True
        self.close()

    def close(self) -> None:
        """Stop writing, and let others write."""
        self._lock.release()
