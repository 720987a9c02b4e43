"""The queue of a run: pictures that need an analyst, and how they are opened and processed (``queue.json``).

::

    {"schema": 1, "mission": "new_horizons", "kernels": "...", "catalog": "bundled",
     "targets": ["PLUTO"],
     "images": [{"image": "/data/lor_0299.fit", "folder": "lor_0299", "status": "partial", "reasons": ["..."]}]}

``folder`` is relative to the file; it holds the session to go on with, where there is one.  Other fields of `Processing`
stand beside ``targets`` where they differ from their defaults; empty targets are the mission's own, ``["none"]`` none.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import inside, json_value, text_of, write_json
from opnav_workbench.paths import is_file, is_folder
from opnav_workbench.processing.model import NO_TARGETS, Processing
from opnav_workbench.session.storage import SESSION_FILE

__all__ = ["AnalystQueue", "QueuedImage", "read_queue", "write_queue"]


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
    """All pictures that wait, and how they are processed.

    Attributes
    ----------
    images
    how
        As the run had it; None where that is unknown.
    """

    images: tuple[QueuedImage, ...] = ()
    how: Processing | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the file."""
        content: dict[str, Any] = {"images": [asdict(item) for item in self.images]}
        content |= {"mission": "", "kernels": "", "catalog": "", "targets": []}
        if self.how is not None:
            targets = [NO_TARGETS] if self.how.targets == () else list(self.how.targets or ())
            content |= {"mission": self.how.mission, "catalog": self.how.catalog}
            content |= self.how.plain.said() | {"targets": targets}
        return content | {"schema": SCHEMA}


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
    write_json(path, queue.to_dict())
    return path


def read_queue(folder: str | Path) -> AnalystQueue:
    """Read the queue of a run's folder; one without the file queues every session in it.

    Raises
    ------
    SessionError
        No such folder, nothing in it to work on, or a damaged file.
    """
    place = Path(folder)
    if not is_folder(place):
        raise SessionError(f"there is no folder {place}; give one that opnav nightly or opnav process wrote.")
    path = place / QUEUE_FILE
    if not is_file(path):
        return _queue_of_sessions(place)
    try:
        data = json_value(text_of(path))
        if data["schema"] != SCHEMA:
            raise SessionError(
                f"{path} has schema {data['schema']}, this version reads {SCHEMA}; update opnav_workbench."
            )
        images = tuple(
            QueuedImage(**(item | {"reasons": tuple(item["reasons"])})) for item in data.pop("images")
        )
        queue = AnalystQueue(images, _read_processing(data, path))
    except (OSError, UnicodeDecodeError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(
            f"{path} cannot be read ({error!r}); run opnav nightly again, it writes it anew."
        ) from error
    for item in images:
        inside(place, item.folder)
    return queue


def _read_processing(values: Mapping[str, Any], path: Path) -> Processing | None:
    """Return how the pictures are processed; what is empty was not given."""
    given = {name: value for name, value in values.items() if name != "schema" and value not in ("", [], {})}
    return Processing.checked(given, f"queue {path}") if "mission" in given else None


def _queue_of_sessions(place: Path) -> AnalystQueue:
    folders = sorted(file.parent for file in place.glob(f"*/{SESSION_FILE}"))
    if not folders:
        raise SessionError(
            f"{place} holds neither {QUEUE_FILE} nor a session; give a folder that opnav nightly wrote."
        )
    return AnalystQueue(tuple(_queued_session(folder) for folder in folders))


def _queued_session(folder: Path) -> QueuedImage:
    try:
        data: Any = json_value(text_of(folder / SESSION_FILE))
        image = str(data["image"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SessionError(
            f"{folder / SESSION_FILE} cannot be read ({error!r}); process the picture again."
        ) from error
    return QueuedImage(image, folder.name, "partial")
