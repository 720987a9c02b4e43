"""session.json: everything needed to continue a session on another machine, except the picture itself."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.bodies import TargetState
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import CatalogError, KernelError, SessionError
from opnav_workbench.files import atomic_path, json_text
from opnav_workbench.mission import Mission, load_mission, mission_names
from opnav_workbench.observables import Observable, observables_table
from opnav_workbench.scene import Observer
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.gather import InputSource
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import Inputs
from opnav_workbench.version import __version__

__all__ = [
    "RESULT_FILE",
    "SESSION_FILE",
    "SavedSession",
    "load_session",
    "session_dict",
    "write_data",
    "write_session",
    "write_table",
    "write_together",
]

SCHEMA = 1
SESSION_FILE = "session.json"
RESULT_FILE = "result.json"
TABLE_FILE = "observables.ecsv"


@dataclass(frozen=True, slots=True, eq=False)
class SavedSession:
    """A session as read back from its file."""

    context: Context
    source: InputSource
    inputs: Inputs
    journal: tuple[JournalEntry, ...]


def session_dict(
    context: Context, source: InputSource, inputs: Inputs, journal: Iterable[JournalEntry]
) -> dict[str, Any]:
    """Return a session as plain values."""
    return {
        "schema": SCHEMA,
        "version": __version__,
        "image": str(context.frame.path.resolve()),
        "sha256": context.frame.sha256,
        "mission": _mission_spec(context.mission),
        "settings": context.settings.to_dict(),
        "catalog": source.catalog,
        "target_stars": None if source.target_stars is None else str(source.target_stars.resolve()),
        "attitude": source.attitude,
        "inputs": {
            "et": inputs.et,
            "utc": inputs.utc,
            "observer": _columns(inputs.observer),
            "a_priori_camera_from_j2000": inputs.a_priori_camera_from_j2000,
            "attitude_source": inputs.attitude_source,
            "stars": _columns(inputs.stars),
            "wide_stars": None if inputs.wide_stars is None else _columns(inputs.wide_stars),
            "targets": {name: _columns(target) for name, target in inputs.targets.items()},
        },
        "journal": [item.to_dict() for item in journal],
    }


def _mission_spec(mission: Mission) -> str:
    """Return the name of a mission that comes with the package, valid on any machine; else its file's path."""
    name = mission.path.parent.name
    ours = name in mission_names() and load_mission(name).path == mission.path
    return name if ours else str(mission.path)


def _columns(instance: Any) -> dict[str, Any]:
    return {field.name: getattr(instance, field.name) for field in fields(instance)}


def load_session(path: Path, image: str | Path | None) -> SavedSession:
    """Read ``session.json`` and the picture it belongs to.

    Raises
    ------
    SessionError
        The file is missing, damaged or of a newer schema; the picture is missing or another one.
    """
    data = _read(path)
    try:
        context = _context(data, image)
        source = InputSource(
            data["catalog"],
            None if data["target_stars"] is None else Path(data["target_stars"]),
            data["attitude"],
        )
        journal = tuple(JournalEntry(**item) for item in data["journal"])
        return SavedSession(context, source, _inputs(data["inputs"]), journal)
    except (AttributeError, KeyError, TypeError, ValueError, CatalogError, KernelError) as error:
        raise SessionError(f"{path} is damaged ({error!r}); process the picture again.") from error


def _read(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SessionError(
            f"no session can be read from {path}: {error}. Give a folder that save() wrote."
        ) from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise SessionError(f"{path} is not a session of schema {SCHEMA}; use the version that wrote it.")
    return data


def _context(data: Mapping[str, Any], image: str | Path | None) -> Context:
    path = Path(image or data["image"])
    if not path.is_file():
        raise SessionError(
            f"the picture {path} is not there; say where it is now: resume(folder, image=PATH)."
        )
    context = open_context(path, load_mission(data["mission"]), Settings.from_dict(data["settings"]))
    if context.frame.sha256 != data["sha256"]:
        raise SessionError(
            f"{path} is not the picture of this session (SHA-256 differs); give the original file."
        )
    return context


def _inputs(data: Mapping[str, Any]) -> Inputs:
    return Inputs(
        et=float(data["et"]),
        utc=data["utc"],
        observer=_rebuild(Observer, data["observer"]),
        a_priori_camera_from_j2000=np.array(data["a_priori_camera_from_j2000"], dtype=np.float64),
        attitude_source=data["attitude_source"],
        stars=_star_table(data["stars"]),
        targets=MappingProxyType({n: _rebuild(TargetState, t) for n, t in data["targets"].items()}),
        wide_stars=None if data.get("wide_stars") is None else _star_table(data["wide_stars"]),
    )


def _rebuild(cls: type[Any], values: Mapping[str, Any]) -> Any:
    arrays = {k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in values.items()}
    return cls(**arrays)


def _star_table(columns: Mapping[str, Any]) -> StarTable:
    """Rebuild the catalog rows; null stands for a number that is not known."""
    text = {"id", "band"}
    arrays: dict[str, Any] = {
        name: np.array(values) if name in text else np.array(values, dtype=np.float64)
        for name, values in columns.items()
        if name != "motion_known"
    }
    arrays["sigma"] = arrays["sigma"].reshape(-1, 5)  # with no star at all, JSON has forgotten the five
    return StarTable(**arrays, motion_known=np.array(columns["motion_known"], dtype=bool))


def write_session(
    folder: str | Path, result: Mapping[str, Any], observables: Sequence[Observable], saved: Mapping[str, Any]
) -> Path:
    """Write result, table and session into a folder, together; return the folder.

    Raises
    ------
    SessionError
        A file cannot be written; the older files stay as they were.
    """
    target = Path(folder)
    write_together(
        {
            target / RESULT_FILE: partial(write_data, result),
            target / TABLE_FILE: partial(write_table, observables),
            target / SESSION_FILE: partial(write_data, saved),
        }
    )
    return target


def write_together(writers: Mapping[Path, Callable[[Path], None]]) -> None:
    """Write several files that belong together: none takes its name before all are written.

    Raises
    ------
    SessionError
        A file cannot be written; the older files stay as they were.
    """
    with ExitStack() as stack:
        for path, write in writers.items():
            write(stack.enter_context(atomic_path(path)))


def write_data(data: Mapping[str, Any], path: Path) -> None:
    """Write `data` as JSON, down to the disk."""
    with path.open("w", encoding="utf-8") as stream:
        stream.write(json_text(data) + "\n")
        stream.flush()
        os.fsync(stream.fileno())


def write_table(observables: Sequence[Observable], path: Path) -> None:
    """Write `observables_table` as ECSV."""
    observables_table(observables).write(path, format="ascii.ecsv", overwrite=True)
