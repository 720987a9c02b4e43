"""What a night leaves beside a picture's results: what was done, so that it is done once (``night.json``).

The file moves into place together with the results, in one rename: a folder has both or neither, whenever a night is killed.
"""

import hashlib
import json
import shutil
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text, sha256_of, write_json
from opnav_workbench.session.journal_file import JOURNAL_FILE
from opnav_workbench.session.storage import SESSION_FILE

__all__ = ["RECORD_FILE", "Record", "digest_of_session", "fingerprint", "read_record", "settle"]

RECORD_FILE = "night.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Record:
    """How a picture was processed.

    Attributes
    ----------
    image : str
    fingerprint : str
        Of everything that the result depends on; empty where another try may come to another result.
    session : str
        Digest of the session as the night left it; another one tells of an analyst's work since.
    fault, reason : str
        As in `night_worker.Verdict`.
    seconds, peak_mb : float
    tries : int
    """

    image: str
    fingerprint: str
    session: str
    fault: str = ""
    reason: str = ""
    seconds: float = 0.0
    peak_mb: float = 0.0
    tries: int = 1


def fingerprint(image: Path, inputs: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a picture and of what it is processed with."""
    text = json_text({"image": sha256_of(image), **inputs})
    return hashlib.sha256(text.encode()).hexdigest()


def digest_of_session(folder: Path) -> str:
    """Return the SHA-256 of a folder's session and journal; empty where there is none."""
    found = [folder / name for name in (SESSION_FILE, JOURNAL_FILE) if (folder / name).is_file()]
    if not found:
        return ""
    return hashlib.sha256("".join(sha256_of(path) for path in found).encode()).hexdigest()


def read_record(folder: Path) -> Record | None:
    """Return the record of a picture's folder; None where there is none that can be read."""
    try:
        data = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        return Record(**data["record"]) if data["schema"] == SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def settle(work: Path, final: Path, record: Record, attic: Path) -> None:
    """Move a working folder to its place, with its record; what stood there goes.

    Parameters
    ----------
    work, final : path
    record : Record
    attic : path
        Folder on the same file system for what is about to be deleted.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    write_json(work / RECORD_FILE, {"schema": SCHEMA, "record": asdict(record)})
    attic.mkdir(parents=True, exist_ok=True)
    old = attic / f"{final.name}-{uuid.uuid4().hex[:8]}"
    try:
        if final.exists():
            final.rename(old)
        work.rename(final)
    except OSError as error:
        raise SessionError(
            f"cannot move results to {final}: {error.strerror}; what is finished is kept, run the same command again."
        ) from error
    shutil.rmtree(old, ignore_errors=True)
