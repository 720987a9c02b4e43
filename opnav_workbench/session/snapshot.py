"""A kept state: what the steps so far led to, so that a session resumes without carrying all of them out again.

It is a cache and no more: it counts only for the very steps, picture and version that it was made of, anything wrong
with it is as good as its absence, and the journal alone says what the session is. Values are rebuilt bit by bit: arrays
from an npz file, everything else from a description in JSON; no class from outside the package is touched.
"""

import hashlib
import importlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, plain_values
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.state import SessionState
from opnav_workbench.version import __version__

__all__ = ["STATE_FILE", "KeptState", "read_state", "write_state"]

STATE_FILE = ".state.npz"
PACKAGE = "opnav_workbench."
MOST_BYTES = 200_000_000  # a larger state is quicker made again than read
PLAIN = (str, int, float, bool, type(None))


@dataclass(frozen=True, slots=True, eq=False)
class KeptState:
    """The state after the first `count` standing steps of a session."""

    count: int
    state: SessionState


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
    steps = [[item.step, item.parameters, item.time_utc] for item in standing]
    text = json.dumps(plain_values([__version__, sha256, steps]), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


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
            return {"enum": _name(type(value)), "value": value.value}
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
            return {"class": _name(type(value)), "fields": content}
        raise TypeError(f"{type(value).__name__} cannot be kept")

    def _index(self, array: np.ndarray[Any, Any]) -> int:
        if array.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        if id(array) not in self._known:
            self._known[id(array)] = len(self.arrays)
            self.arrays.append(array)  # held here, so that its id stays its own
        return self._known[id(array)]


def _name(kind: type) -> str:
    if not kind.__module__.startswith(PACKAGE) or "." in kind.__qualname__:
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept")
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> Any:
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
        return _class(content)(value["value"])
    return _rebuilt(_class(content), value["fields"], arrays)


def _rebuilt(kind: Any, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Any:
    """Return an instance with its fields as they were; nothing is checked or computed again."""
    if not is_dataclass(kind):
        raise TypeError(f"{kind} is no dataclass")
    instance: Any = object.__new__(kind)  # type: ignore[arg-type]
    for name, value in content.items():
        object.__setattr__(instance, name, _unpacked(value, arrays))
    return instance
