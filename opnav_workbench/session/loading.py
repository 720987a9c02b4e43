"""Sessions read back from their folders."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.errors import CatalogError, KernelError, SessionError
from opnav_workbench.mission import load_mission
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.gather import InputSource
from opnav_workbench.session.inputs_file import inputs_from, with_added
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.journal_file import JOURNAL_FILE, JournalTail, read_tail
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import Inputs
from opnav_workbench.session.storage import SCHEMA, SESSION_FILE

__all__ = ["SavedSession", "StoredSession", "load_session", "stored_session"]


@dataclass(frozen=True, slots=True, eq=False)
class SavedSession:
    """A session as read back from its folder.

    Attributes
    ----------
    session : str
        Its id.
    context, source, inputs
    journal : tuple of JournalEntry
    stored : int
        Entries that ``session.json`` holds; the others are in the journal file.
    tail : JournalTail
        What the journal file adds.
    """

    session: str
    context: Context
    source: InputSource
    inputs: Inputs
    journal: tuple[JournalEntry, ...]
    stored: int
    tail: JournalTail


def load_session(folder: Path, image: str | Path | None) -> SavedSession:
    """Read a session's folder and the picture it belongs to.

    Raises
    ------
    SessionError
        A file is missing, damaged or of a newer schema; the picture is missing or another one.
    """
    path = folder / SESSION_FILE
    data = _read(path)
    try:
        context = _context(data, image)
        source = InputSource(
            data["catalog"],
            None if data["target_stars"] is None else Path(data["target_stars"]),
            data["attitude"],
        )
        session = str(data.get("session", ""))
        stored = tuple(JournalEntry(**item) for item in data["journal"])
        tail = read_tail(folder / JOURNAL_FILE, session, stored)
        inputs = inputs_from(data["inputs"])
        for added in tail.inputs:
            inputs = with_added(inputs, added)
        return SavedSession(session, context, source, inputs, stored + tail.entries, len(stored), tail)
    except (AttributeError, KeyError, TypeError, ValueError, OSError, CatalogError, KernelError) as error:
        raise SessionError(f"{path} is damaged ({error!r}); process the picture again.") from error


@dataclass(frozen=True, slots=True)
class StoredSession:
    """What a folder says of its session, without its picture.

    Attributes
    ----------
    session, sha256 : str
        Its id, and the picture's SHA-256.
    journal : tuple of JournalEntry
    tail_bytes : int
        Whole bytes of the journal file.
    """

    session: str
    sha256: str
    journal: tuple[JournalEntry, ...]
    tail_bytes: int


def stored_session(folder: Path) -> StoredSession | None:
    """Return what a folder says of its session; None where it has none.

    Raises
    ------
    SessionError
        There is one, but it cannot be read.
    """
    if not (folder / SESSION_FILE).exists():
        return None
    data = _read(folder / SESSION_FILE)
    try:
        session, stored = str(data.get("session", "")), tuple(JournalEntry(**e) for e in data["journal"])
        tail = read_tail(folder / JOURNAL_FILE, session, stored)
        return StoredSession(session, str(data["sha256"]), stored + tail.entries, tail.length)
    except (KeyError, TypeError, OSError) as error:
        raise SessionError(
            f"{folder / SESSION_FILE} is damaged ({error!r}); choose another folder."
        ) from error


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
