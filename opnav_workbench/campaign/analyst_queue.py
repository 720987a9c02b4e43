"""Pictures that need an analyst: why, as their results tell it, and the queue of a run (``queue.json``).

::

    {"schema": 1, "mission": "new_horizons", "kernels": "...", "catalog": "bundled",
     "targets": ["PLUTO"],
     "images": [{"image": "/data/lor_0299.fit", "folder": "lor_0299", "status": "partial", "reasons": ["..."]}]}

``folder`` is relative to the file; it holds the session to go on with, where there is one.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import inside, write_json
from opnav_workbench.session.storage import SESSION_FILE

__all__ = ["AnalystQueue", "QueuedImage", "attention_reasons", "read_queue", "write_queue"]


# ---- Why an analyst should look at a picture, as its result tells it.


def attention_reasons(
    status: str, messages: Iterable[str], bodies: Iterable[tuple[str | None, str | None]] = ()
) -> tuple[str, ...]:
    """Return the reasons to look at a picture; none where all is well.

    Parameters
    ----------
    status
        Of the picture: ok, partial or failed.
    messages
        Of the picture.
    bodies : iterable of (name, status)

    Examples
    --------
    >>> attention_reasons("ok", ["3 pixels masked"])
    ()
    >>> attention_reasons("partial", [], [("PLUTO", "ok"), ("NIX", "uncertain")])
    ('NIX: uncertain',)
    """
    if status == "ok":
        return ()
    said = tuple(dict.fromkeys(messages))
    doubtful = tuple(
        f"{name}: {verdict.replace('_', ' ')}"
        for name, verdict in bodies
        if verdict not in (None, "ok") and not any(message.startswith(f"{name}:") for message in said)
    )
    return (*said, *doubtful) or (f"status {status}",)


# ---- The analyst's queue.

QUEUE_FILE = "queue.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class QueuedImage:
    """A picture that waits for an analyst.

    Attributes
    ----------
    image
        The picture file.
    folder
        Folder of its run, relative to the queue's.
    status : {"partial", "failed"}
    """

    image: str
    folder: str
    status: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AnalystQueue:
    """All pictures that wait, and how they are opened.

    Attributes
    ----------
    mission, kernels, catalog
        As the run had them; empty where unknown.
    targets
        Bodies that the run looked for; empty: the mission's own.
    """

    images: tuple[QueuedImage, ...] = ()
    mission: str = ""
    kernels: str = ""
    catalog: str = ""
    targets: tuple[str, ...] = ()
    schema: int = field(default=SCHEMA, repr=False)


def write_queue(folder: str | Path, queue: AnalystQueue) -> Path:
    """Write ``queue.json`` into a folder and return its path.

    Raises
    ------
    SessionError
        The folder cannot be written, or a picture's folder lies outside it.
    """
    for item in queue.images:
        inside(folder, item.folder)
    path = Path(folder) / QUEUE_FILE
    write_json(path, asdict(queue))
    return path


def read_queue(folder: str | Path) -> AnalystQueue:
    """Read the queue of a run's folder; one without the file queues every session in it.

    Raises
    ------
    SessionError
        No such folder, nothing in it to work on, or a damaged file.
    """
    place = Path(folder)
    if not place.is_dir():
        raise SessionError(f"there is no folder {place}; give one that opnav nightly or opnav process wrote.")
    path = place / QUEUE_FILE
    if not path.is_file():
        return _queue_of_sessions(place)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["schema"] != SCHEMA:
            raise SessionError(
                f"{path} has schema {data['schema']}, this version reads {SCHEMA}; update opnav_workbench."
            )
        images = tuple(
            QueuedImage(**(item | {"reasons": tuple(item["reasons"])})) for item in data.pop("images")
        )
        queue = AnalystQueue(images, **(data | {"targets": tuple(data.get("targets", ()))}))
    except (OSError, UnicodeDecodeError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(
            f"{path} cannot be read ({error!r}); run opnav nightly again, it writes it anew."
        ) from error
    for item in images:
        inside(place, item.folder)
    return queue


def _queue_of_sessions(place: Path) -> AnalystQueue:
    folders = sorted(file.parent for file in place.glob(f"*/{SESSION_FILE}"))
    if not folders:
        raise SessionError(
            f"{place} holds neither {QUEUE_FILE} nor a session; give a folder that opnav nightly wrote."
        )
    return AnalystQueue(tuple(_queued_session(folder) for folder in folders))


def _queued_session(folder: Path) -> QueuedImage:
    try:
        data: Any = json.loads((folder / SESSION_FILE).read_text(encoding="utf-8"))
        image = str(data["image"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SessionError(
            f"{folder / SESSION_FILE} cannot be read ({error!r}); process the picture again."
        ) from error
    return QueuedImage(image, folder.name, "partial")
