"""session.json: everything needed to continue a session on another machine, except the picture itself."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from opnav_workbench.files import atomic_path, json_text
from opnav_workbench.mission import Mission, load_mission, mission_names
from opnav_workbench.observables import Observable, observables_table
from opnav_workbench.session.context import Context
from opnav_workbench.session.gather import InputSource
from opnav_workbench.session.inputs_file import inputs_dict
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.state import Inputs
from opnav_workbench.version import __version__

__all__ = [
    "RESULT_FILE",
    "SCHEMA",
    "SESSION_FILE",
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


def session_dict(
    context: Context, source: InputSource, inputs: Inputs, journal: Iterable[JournalEntry], session: str
) -> dict[str, Any]:
    """Return a session as plain values."""
    return {
        "schema": SCHEMA,
        "version": __version__,
        "session": session,
        "image": str(context.frame.path.resolve()),
        "sha256": context.frame.sha256,
        "mission": _mission_spec(context.mission),
        "settings": context.settings.to_dict(),
        "catalog": source.catalog,
        "target_stars": None if source.target_stars is None else str(source.target_stars.resolve()),
        "attitude": source.attitude,
        "inputs": inputs_dict(inputs),
        "journal": [item.to_dict() for item in journal],
    }


def _mission_spec(mission: Mission) -> str:
    """Return the name of a mission that comes with the package, valid on any machine; else its file's path."""
    name = mission.path.parent.name
    ours = name in mission_names() and load_mission(name).path == mission.path
    return name if ours else str(mission.path)


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
