"""session.json: everything needed to continue a session on another machine, except the picture itself."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.bodies import TargetState
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import SessionError
from opnav_workbench.mission import load_mission
from opnav_workbench.scene import Observer
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.gather import InputSource
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import Inputs
from opnav_workbench.version import __version__

__all__ = ["SavedSession", "load_session", "session_dict"]

SCHEMA = 1


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
        "mission": str(context.mission.path),
        "settings": context.settings.to_dict(),
        "catalog": source.catalog,
        "target_stars": None if source.target_stars is None else str(source.target_stars),
        "attitude": source.attitude,
        "inputs": {
            "et": inputs.et,
            "utc": inputs.utc,
            "observer": _columns(inputs.observer),
            "a_priori_camera_from_j2000": inputs.a_priori_camera_from_j2000,
            "attitude_source": inputs.attitude_source,
            "stars": _columns(inputs.stars),
            "targets": {name: _columns(target) for name, target in inputs.targets.items()},
        },
        "journal": [item.to_dict() for item in journal],
    }


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
    except (KeyError, TypeError, ValueError) as error:
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
    return StarTable(**arrays, motion_known=np.array(columns["motion_known"], dtype=bool))
