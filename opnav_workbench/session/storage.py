"""session.json: everything needed to continue a session on another machine, except the picture itself.

Written together with ``result.json`` and ``observables.ecsv``: none of the files takes its name before all are written.
Read back, the journal file's steps are added, and the picture must be the same one (SHA-256).
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from opnav_workbench.errors import CatalogError, KernelError, SessionError
from opnav_workbench.files import atomic_path, json_text, read_json
from opnav_workbench.format_versions import as_of_today, stamped
from opnav_workbench.image.picture_files import FolderOwner
from opnav_workbench.kernels.shape_files import ShapeFile
from opnav_workbench.mission import Mission, load_mission, mission_names
from opnav_workbench.observables import Observable, Origin, ecsv_text
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.history import (
    JOURNAL_FILE,
    STEPS_BY_HAND,
    JournalEntry,
    JournalTail,
    read_journal_file,
    stored_entry,
)
from opnav_workbench.session.inputs import (
    Inputs,
    InputSource,
    inputs_dict,
    inputs_from,
    with_inputs_added,
    with_sweep,
)
from opnav_workbench.session.settings import Settings
from opnav_workbench.version import __version__

__all__ = [
    "ATTIC",
    "RESULT_FILE",
    "SESSION_FILE",
    "SessionOnDisk",
    "load_session",
    "session_dict",
    "session_on_disk",
    "session_owner",
    "set_aside",
    "write_data",
    "write_session",
    "write_table",
    "write_together",
]


ATTIC = ".attic"  # what was found where something else had to go
SESSION_FILE = "session.json"
RESULT_FILE = "result.json"
TABLE_FILE = "observables.ecsv"


def session_dict(
    context: Context, source: InputSource, inputs: Inputs, journal: Iterable[JournalEntry], session: str
) -> dict[str, Any]:
    """Return a session as plain values."""
    content = {
        "version": __version__,
        "session": session,
        "image": str(context.picture.path.resolve()),
        "sha256": context.picture.sha256,
        "mission": _mission_spec(context.mission),
        "settings": context.settings.to_dict(),
        "catalog": source.catalog,
        "target_stars": None if source.target_stars is None else str(source.target_stars.resolve()),
        "attitude": source.attitude,
        **({"shapes": _shape_values(source)} if source.shapes else {}),
        "inputs": inputs_dict(inputs),
        "journal": [item.to_dict() for item in journal],
    }
    return stamped("session", content)


def _shape_values(source: InputSource) -> dict[str, list[str]]:
    return {body: [str(file.path.resolve()), file.unit] for body, file in source.shapes.items()}


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
            target / TABLE_FILE: partial(write_table, observables, Origin.of_result(result)),
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
    with path.open("w", encoding="utf-8", errors="backslashreplace") as stream:
        stream.write(json_text(data) + "\n")
        stream.flush()
        os.fsync(stream.fileno())


def write_table(observables: Sequence[Observable], origin: Origin, path: Path) -> None:
    """Write them as ECSV."""
    path.write_text(ecsv_text(observables, (origin,)), encoding="utf-8", errors="backslashreplace")


# ---- Sessions read back from their folders.


@dataclass(frozen=True, slots=True, eq=False)
class LoadedSession:
    """A session as read back from its folder.

    Attributes
    ----------
    session
        Its id.
    context, source, inputs
    journal
        Of both files.
    tail
        What the journal file adds.
    """

    session: str
    context: Context
    source: InputSource
    inputs: Inputs
    journal: tuple[JournalEntry, ...]
    tail: JournalTail


def load_session(folder: Path, image: str | Path | None) -> LoadedSession:
    """Read a session's folder and the picture it belongs to.

    Raises
    ------
    SessionError
        A file is missing, damaged or of a newer schema; the picture is missing or another one.
    """
    path = folder / SESSION_FILE
    data = _session_file(path)
    try:
        context = _reopened_context(data, image)
        source = InputSource(
            data["catalog"],
            None if data["target_stars"] is None else Path(data["target_stars"]),
            data["attitude"],
            MappingProxyType(
                {body: ShapeFile(Path(path), unit) for body, (path, unit) in data.get("shapes", {}).items()}
            ),
        )
        session = str(data.get("session", ""))
        stored = tuple(stored_entry(item) for item in data["journal"])
        tail = read_journal_file(folder / JOURNAL_FILE, session, stored)
        inputs = inputs_from(data["inputs"])
        for added in tail.inputs:
            inputs = with_inputs_added(inputs, added)
        context = with_sweep(context, inputs.sweep)
        return LoadedSession(session, context, source, inputs, stored + tail.entries, tail)
    except (AttributeError, KeyError, TypeError, ValueError, OSError, CatalogError, KernelError) as error:
        raise SessionError(f"{path} is damaged ({error!r}); process the picture again.") from error


@dataclass(frozen=True, slots=True)
class SessionOnDisk:
    """What a folder says of its session, without its picture.

    Attributes
    ----------
    session, sha256
        Its id, and the picture's SHA-256.
    tail_bytes
        Whole bytes of the journal file.
    """

    session: str
    sha256: str
    journal: tuple[JournalEntry, ...]
    tail_bytes: int


def session_on_disk(folder: Path) -> SessionOnDisk | None:
    """Return what a folder says of its session; None where it has none.

    Raises
    ------
    SessionError
        There is one, but it cannot be read.
    """
    if not (folder / SESSION_FILE).exists():
        return None
    data = _session_file(folder / SESSION_FILE)
    try:
        session, stored = str(data.get("session", "")), tuple(stored_entry(e) for e in data["journal"])
        tail = read_journal_file(folder / JOURNAL_FILE, session, stored)
        return SessionOnDisk(session, str(data["sha256"]), stored + tail.entries, tail.length)
    except (KeyError, TypeError, OSError) as error:
        raise SessionError(
            f"{folder / SESSION_FILE} is damaged ({error!r}); choose another folder."
        ) from error


def set_aside(folder: Path, session: str, journal: Sequence[JournalEntry]) -> Path | None:
    """Put an analyst's session away before another one takes its files' names; its folder must be locked.

    Parameters
    ----------
    session, journal
        Of the one that comes. It may be the same said again, then nothing is put away.

    Returns
    -------
    Path or None
        ``FOLDER/.attic/<time>``, which resumes like any other; None where nothing a person said would be lost.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    try:
        stored = session_on_disk(folder)
        if stored is None or stored.session == session:
            return None
        if _by_hand(stored.journal) == [] or _by_hand(stored.journal) == _by_hand(journal):
            return None
    except SessionError:  # damaged: what it holds may still be worth something
        pass
    place = folder / ATTIC / datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    try:
        place.mkdir(parents=True)
        for name in (SESSION_FILE, JOURNAL_FILE):
            if (folder / name).exists():
                (folder / name).rename(place / name)
    except OSError as error:
        raise SessionError(
            f"cannot put the session in {folder} away: {error.strerror}. Choose another folder."
        ) from error
    return place


def _by_hand(journal: Iterable[JournalEntry]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(entry.step, entry.parameters) for entry in journal if entry.step in STEPS_BY_HAND]


def session_owner(folder: Path) -> FolderOwner | None:
    """Return the picture that a folder's session is of; None where there is none that can be read."""
    try:
        data = _session_file(folder / SESSION_FILE)
        return FolderOwner(Path(data["image"]), str(data["sha256"]))
    except (SessionError, KeyError, TypeError):
        return None


def _session_file(path: Path) -> dict[str, Any]:
    data = read_json(path, "give a folder that save() wrote.")
    return as_of_today("session", data, str(path), SessionError)


def _reopened_context(data: Mapping[str, Any], image: str | Path | None) -> Context:
    path = Path(image or data["image"])
    if not path.is_file():
        raise SessionError(
            f"the picture {path} is not there; say where it is now: resume(folder, image=PATH)."
        )
    context = open_context(path, load_mission(data["mission"]), Settings.from_dict(data["settings"]))
    if context.picture.sha256 != data["sha256"]:
        raise SessionError(
            f"{path} is not the picture of this session (SHA-256 differs); give the original file."
        )
    return context
