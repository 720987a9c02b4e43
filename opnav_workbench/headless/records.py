"""What a night leaves beside a picture's results (``night.json``): what was done, with what, and what it wrote.

By it a picture is done once, a folder that an analyst worked on since is known, and files that no night wrote are told
from those that one did.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

from pydantic import TypeAdapter

from opnav_workbench.files import json_value, sha256_of, text_of, write_json
from opnav_workbench.session.history import JOURNAL_FILE
from opnav_workbench.session.storage import RESULT_FILE, SESSION_FILE

__all__ = [
    "RECORD_FILE",
    "NightRecord",
    "files_in",
    "is_of_an_analyst",
    "read_record",
    "result_field",
    "session_digest",
    "write_record",
]

RECORD_FILE = "night.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class NightRecord:
    """How a picture was processed.

    Attributes
    ----------
    fingerprint
        Of everything that the result depends on; empty where another try may come to another result.
    session
        Digest of the session as the night left it; another one tells of an analyst's work since.
    fault, reason
        As in `night_workers.NotebookOutcome`.
    status
        Of the result; empty where there is none.
    inputs
        What the fingerprint was made of, for people: what, and which.
    image_sha256, stamp, et
        Of the picture: its content, the file's size and times of change, and its time where its header could be read; known
        again as long as the stamp is the same.
    limits
        Under which it was processed.
    files
        What the night wrote: name and SHA-256.
    touched
        Files that were written to while it was processed, so that nobody knows what came of which content.
    """

    image: str
    fingerprint: str
    session: str
    fault: str = ""
    reason: str = ""
    seconds: float = 0.0
    peak_mb: float = 0.0
    tries: int = 1
    status: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    image_sha256: str = ""
    stamp: tuple[int, ...] = ()
    et: float | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    touched: tuple[str, ...] = ()


def read_record(folder: Path) -> NightRecord | None:
    """Return the record of a picture's folder; None where there is none that can be read.

    What it holds decides what is deleted, so all of it must be what a night writes.
    """
    try:
        data = json_value(text_of(folder / RECORD_FILE))
        if data["schema"] != SCHEMA or not data["record"].keys() <= NightRecord.__dataclass_fields__.keys():
            return None
        record = _whole_record().validate_python(data["record"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    inside = (not path.is_absolute() and ".." not in path.parts for path in map(Path, record.files))
    return record if all(inside) else None


@cache
def _whole_record() -> TypeAdapter[NightRecord]:
    return TypeAdapter(NightRecord)


def write_record(folder: Path, record: NightRecord) -> None:
    """Write the record of a picture's folder.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    write_json(folder / RECORD_FILE, {"schema": SCHEMA, "record": asdict(record)})


def session_digest(folder: Path) -> str:
    """Return the SHA-256 of a folder's session and journal; empty where there is none."""
    found = [folder / name for name in (SESSION_FILE, JOURNAL_FILE) if (folder / name).is_file()]
    if not found:
        return ""
    return hashlib.sha256("".join(sha256_of(path) for path in found).encode()).hexdigest()


def is_of_an_analyst(record: NightRecord | None, session: str) -> bool:
    """Tell whether a folder's session (its digest) is another than the one that a night left there."""
    return bool(session) if record is None else record.session != session


def result_field(folder: Path, name: str) -> str:
    """Return a text that a folder's result holds, such as its status; empty where there is none that can be read."""
    try:
        return str(json_value(text_of(folder / RESULT_FILE))[name] or "")
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def files_in(folder: Path) -> dict[str, str]:
    """Return name and SHA-256 of every file in and below a folder."""
    return {
        path.relative_to(folder).as_posix(): sha256_of(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
