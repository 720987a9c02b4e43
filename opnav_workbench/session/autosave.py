"""Autosave: every step is on disk when its method returns, and a crash at any moment loses none.

Steps are appended to the journal file.  Once it would take long to carry them out again, the state that they led to is
kept too.  The kept state is a cache and no more: it counts only for the very steps, picture and version that it was made
of, and for classes whose fields are still the same; anything wrong with it is as good as its absence, and the journal
alone says what the session is.  Values are rebuilt bit by bit: arrays from an npz file, everything else from a description
in JSON; no class from outside the package is touched.
"""

import importlib
import json
import os
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, digest, make_folder, write_json
from opnav_workbench.session.folder_lock import FolderLock
from opnav_workbench.session.history import JOURNAL_FILE, History, JournalEntry, KeptState, journal_line
from opnav_workbench.session.inputs import Inputs, inputs_added
from opnav_workbench.session.state import SessionState
from opnav_workbench.session.storage import SESSION_FILE, SessionOnDisk, session_on_disk
from opnav_workbench.version import __version__

__all__ = ["STATE_FILE", "Autosave", "read_state", "start_autosave", "write_state"]


# ---- The kept state.

STATE_FILE = ".state.npz"
PACKAGE = "opnav_workbench."
MOST_BYTES = 200_000_000  # a larger state is quicker made again than read
PLAIN = (str, int, float, bool, type(None))


def write_state(folder: Path, sha256: str, standing: Sequence[JournalEntry], state: SessionState) -> None:
    """Keep the state after the standing steps; where that is not possible, nothing is kept."""
    packer = _Packer()
    try:
        tree = {
            "key": _key(sha256, standing),
            "count": len(standing),
            "state": packer.pack(state),
        }
    except TypeError:
        return
    if sum(array.nbytes for array in packer.arrays) > MOST_BYTES:
        return
    text = np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)
    with suppress(SessionError), atomic_path(folder / STATE_FILE) as temporary:
        arrays: dict[str, Any] = {f"a{i}": array for i, array in enumerate(packer.arrays)}
        np.savez(temporary, tree=text, **arrays)


def read_state(folder: Path, sha256: str, standing: Sequence[JournalEntry]) -> KeptState | None:
    """Return the kept state, if it belongs to the first of these steps."""
    try:
        with (folder / STATE_FILE).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            tree = json.loads(file["tree"].tobytes())
            count = int(tree["count"])
            if not 0 < count <= len(standing) or tree["key"] != _key(sha256, standing[:count]):
                return None
            state = _unpacked(tree["state"], file)
    except Exception:
        return None
    return KeptState(count, state) if isinstance(state, SessionState) else None


def _key(sha256: str, standing: Sequence[JournalEntry]) -> str:
    """Return what a state depends on, as a hash."""
    steps = [[entry.step, entry.parameters, entry.time_utc] for entry in standing]
    return digest([__version__, sha256, steps])


class _Packer:
    """Describes values in JSON; arrays are collected, each once."""

    def __init__(self) -> None:
        self.arrays: list[np.ndarray[Any, Any]] = []
        self._known: dict[int, int] = {}

    def pack(self, value: Any) -> Any:
        """Return the description of a value.

        Raises
        ------
        TypeError
            It holds something that cannot be described.
        """
        if isinstance(value, Enum):
            return {"enum": _class_name(type(value)), "value": value.value}
        if isinstance(value, np.generic):
            return {"scalar": self._index(np.asarray(value))}
        if isinstance(value, PLAIN):
            return value
        if isinstance(value, np.ndarray):
            return {"array": self._index(value)}
        if isinstance(value, tuple | list):
            return {type(value).__name__: [self.pack(item) for item in value]}
        if isinstance(value, Mapping):
            kind = "proxy" if isinstance(value, MappingProxyType) else "dict"
            return {kind: [[self.pack(key), self.pack(item)] for key, item in value.items()]}
        if isinstance(value, Path):
            return {"path": str(value)}
        if is_dataclass(value) and not isinstance(value, type):
            content = {field.name: self.pack(getattr(value, field.name)) for field in fields(value)}
            return {"class": _class_name(type(value)), "fields": content}
        raise TypeError(f"{type(value).__name__} cannot be kept")

    def _index(self, array: np.ndarray[Any, Any]) -> int:
        if array.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        if id(array) not in self._known:
            self._known[id(array)] = len(self.arrays)
            self.arrays.append(array)  # held here, so that its id stays its own
        return self._known[id(array)]


def _class_name(kind: type) -> str:
    if not kind.__module__.startswith(PACKAGE) or "." in kind.__qualname__:
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept")
    return f"{kind.__module__}:{kind.__qualname__}"


def _class_named(name: str) -> Any:
    module, _, kind = name.partition(":")
    if not module.startswith(PACKAGE):
        raise TypeError(f"{name} is not of this package")
    return getattr(importlib.import_module(module), kind)


def _unpacked(value: Any, arrays: Mapping[str, Any]) -> Any:
    if isinstance(value, PLAIN):
        return value
    kind, content = next(iter(value.items()))
    if kind in ("array", "scalar"):
        array = arrays[f"a{content}"]
        array.setflags(write=False)
        return array if kind == "array" else array[()]
    if kind in ("tuple", "list"):
        items = [_unpacked(item, arrays) for item in content]
        return tuple(items) if kind == "tuple" else items
    if kind in ("proxy", "dict"):
        mapping = {_unpacked(key, arrays): _unpacked(item, arrays) for key, item in content}
        return MappingProxyType(mapping) if kind == "proxy" else mapping
    if kind == "path":
        return Path(content)
    if kind == "enum":
        return _class_named(content)(value["value"])
    return _rebuilt(_class_named(content), value["fields"], arrays)


def _rebuilt(kind: Any, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Any:
    """Return an instance with its fields as they were; nothing is checked or computed again."""
    if not is_dataclass(kind) or {field.name for field in fields(kind)} != set(content):
        raise TypeError(f"{kind} is no dataclass of the fields {', '.join(content)}")
    instance: Any = object.__new__(kind)  # type: ignore[arg-type]
    for name, value in content.items():
        object.__setattr__(instance, name, _unpacked(value, arrays))
    return instance


# ---- The journal file, and who writes it.

KEEP_AFTER_S = 0.4  # of steps to be carried out again: with the picture itself, a session resumes in a second

_WRITERS: "dict[Path, weakref.ref[Autosave]]" = {}  # of this process


class Autosave:
    """The journal file of one session, open for appending.

    Parameters
    ----------
    folder
        Made where it is not there.
    session, sha256
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

    def append_new(self, history: History, cost_s: float = 0.0) -> None:
        """Append what the journal has gained; keep the state once it would take long to make it again.

        Parameters
        ----------
        cost_s
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
        for number, entry in enumerate(fresh, start=self._count):
            lines.append(journal_line(self._session, number, before, entry, added))
            before, added = entry, {}
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

    def holds(self, history: History) -> bool:
        """Whether every entry of the journal is on disk, and this is who writes there."""
        return not self._taken_over and self._count == len(history.journal)

    def give_way(self) -> None:
        """Stop writing for a newer session of this process."""
        self._taken_over = True
        self.close()

    def close(self) -> None:
        """Stop writing, and let others write."""
        self._lock.release()


def start_autosave(folder: Path, history: History, saved: Mapping[str, Any]) -> Autosave:
    """Open a folder for a session, and bring what it holds up to date.

    Parameters
    ----------
    folder
        Made where it is not there.
    history
        Of the session.
    saved
        The session as `session_dict` returns it.

    Raises
    ------
    SessionError
        The folder cannot be written, another process writes into it, or it holds another session or newer steps of this
        one.
    """
    writer = Autosave(folder, saved["session"], saved["sha256"])
    try:
        stored = session_on_disk(writer.folder)
        if stored is None or (stored.sha256 == saved["sha256"] and not stored.journal):
            write_json(writer.folder / SESSION_FILE, saved)
            writer.start(history, len(history.journal), 0)
        else:
            _check_continued(writer.folder, stored, history, saved["session"])
            writer.start(history, len(stored.journal), stored.tail_bytes)
            writer.append_new(history)
    except BaseException:
        writer.close()
        raise
    return writer


def _check_continued(folder: Path, stored: SessionOnDisk, history: History, session: str) -> None:
    """Refuse a folder whose session is not this one, or knows more."""
    count = len(stored.journal)
    if stored.session == session and stored.journal == history.journal[:count]:
        return
    what = "newer steps of this session" if stored.session == session else "another session"
    raise SessionError(
        f"{folder} holds {what} ({count} entries in its journal); continue it with ImageSession.resume, or choose "
        "another folder."
    )
