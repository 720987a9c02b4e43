"""A run folder read: ``result.json``, ``observables.ecsv`` and ``session.json`` of one picture, checked, as rows.

A folder that holds less, or files that do not belong together (a program killed between two of them), is damaged: it is
named and skipped, never half taken.

No column of an observables file is lost on its way into rows and back into a table with units.  The runs of a night share
its header, and reading that (YAML) takes longer than all else: it is read once for all of them.
"""

import csv
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from astropy import units as u
from astropy.table import QTable, Table

from opnav_workbench.campaign.schema import BODIES, IMAGES, POINTINGS, PROVENANCE, STARS, row_of
from opnav_workbench.errors import SessionError
from opnav_workbench.files import digest, files_named, read_json, text_of
from opnav_workbench.format_versions import as_of_today, unstamped
from opnav_workbench.paths import exists, is_file, is_folder, is_text
from opnav_workbench.session.storage import RESULT_FILE, SESSION_FILE, TABLE_FILE
from opnav_workbench.version import __version__

__all__ = [
    "ObservableColumn",
    "Reading",
    "RunRows",
    "attention_reasons",
    "find_runs",
    "moment_of",
    "observables_from_rows",
    "read_run",
    "without_times",
]


# ---- Observables between their ECSV file, the archive's rows, and a table with units again.

HEADERS_KEPT = 16  # kept: as many versions of the program as one is likely to meet at once
NO_TEXT = "-"


@dataclass(frozen=True, slots=True)
class ObservableColumn:
    """A column of an observables file: its name, unit and description; `unit` None for text."""

    name: str
    unit: str | None
    description: str


def read_observables(path: Path) -> tuple[tuple[ObservableColumn, ...], list[dict[str, Any]]]:
    """Read an observables file as its columns and one mapping a row; unknown numbers are None.

    Raises
    ------
    SessionError
        The file is no ECSV table of observables.
    """
    try:
        lines = text_of(path).splitlines()
        head = list(takewhile(lambda line: line.startswith("#"), lines))
        body = lines[len(head) :]
        columns, delimiter = _header("\n".join([*head, body[0]]))
        rows = list(csv.reader(body[1:], delimiter=delimiter, strict=True))
        convert = [_text_cell if column.unit is None else _number_cell for column in columns]
        cells = [_cells(columns, convert, row) for row in rows]
        assert all(isinstance(cell[name], str) for cell in cells for name in ("body", "method"))
    except Exception as error:  # a damaged file leads astropy's reader to whatever it may
        raise SessionError(f"{path.name} is damaged ({error!r:.120}); process the picture again") from error
    return columns, cells


@lru_cache(maxsize=HEADERS_KEPT)
def _header(text: str) -> tuple[tuple[ObservableColumn, ...], str]:
    table = Table.read(text, format="ascii.ecsv")
    return tuple(_column(table, name) for name in table.colnames), "," if "delimiter: ','" in text else " "


def _column(table: Table, name: str) -> ObservableColumn:
    column = table[name]
    text = column.dtype.kind in "US"
    unit = None if text else ("" if column.unit is None else column.unit.to_string())
    return ObservableColumn(name, unit, column.info.description or "")


def _cells(
    columns: Sequence[ObservableColumn], convert: Sequence[Callable[[str], Any]], row: Sequence[str]
) -> dict[str, Any]:
    return {column.name: read(value) for column, read, value in zip(columns, convert, row, strict=True)}


def _text_cell(value: str) -> str:
    return value or NO_TEXT


def _number_cell(value: str) -> float | None:
    number = float(value or "nan")
    return number if np.isfinite(number) else None


def observables_from_rows(columns: Sequence[ObservableColumn], cells: Sequence[Mapping[str, Any]]) -> QTable:
    """Return rows as the table that `opnav_workbench.observables.observables_table` makes."""
    table = QTable()
    for column in columns:
        values = [cell.get(column.name) for cell in cells]
        if column.unit is None:
            table[column.name] = np.array([NO_TEXT if v is None else str(v) for v in values], dtype=str)
        else:
            numbers = np.array([np.nan if v is None else v for v in values], dtype=float)
            table[column.name] = u.Quantity(numbers, u.Unit(column.unit))
        table[column.name].info.description = column.description
    return table


# ---- The folder.

READINGS, PAUSE_S = 8, 0.05  # of a folder that changes while it is read
IMAGE_STATUSES = ("ok", "partial", "failed")
# Keys whose values tell when something was done, not what came out: two runs that differ in them alone are one.
TIMES = frozenset(
    {"time_utc", "when_utc", "when", "time", "processed_utc", "started_utc", "finished_utc", "duration_s", "elapsed_s"}
)  # fmt: skip
# Lists of decisions in a result's provenance, and what each of them says.
DECISIONS = {
    "decisions": None,
    "placed_stars": "placed",
    "circles": "circle",
    "limb_scans": "scans chosen",
    "notes": "note",
}
PARTS_OF_RESULT = ("pointing", "stars", "bodies", "provenance", "attention")


class Reading(NamedTuple):
    """What a folder's files held at a moment (`moment_of`)."""

    folder: str
    moment: str
    content_sha256: str


@dataclass(frozen=True, slots=True, eq=False)
class RunRows:
    """One picture's run as rows of the archive.

    Attributes
    ----------
    folder
        Absolute.
    key
        The picture's own, wherever it was processed: the SHA-256 of its file, else `name_key`.
    name_key
        Mission and name of the picture.
    content_sha256
        Of all that came out, times left out.
    image
        Row of ``images``.
    parts
        Rows of the other tables, in order.
    moment
        As `moment_of` tells it: when the files were written that were read.
    """

    folder: Path
    key: str
    name_key: str
    content_sha256: str
    processed_utc: str
    image: Mapping[str, Any]
    parts: Mapping[str, Sequence[Mapping[str, Any]]]
    observable_columns: Sequence[ObservableColumn]
    moment: str = ""

    @property
    def reading(self) -> Reading:
        """Folder, moment and content."""
        return Reading(str(self.folder), self.moment, self.content_sha256)


def find_runs(path: str | Path) -> Iterator[Path]:
    """Yield the run folders at or below `path`, in the order of their names; hidden ones below it are the nights' own.

    Raises
    ------
    SessionError
        There is no such folder, or no run in it.
    """
    top = Path(path)
    if not is_folder(top):
        raise SessionError(
            f"there is no folder {top}; give run folders (with {RESULT_FILE}) or folders of them."
        )
    found = sorted({file.parent for file in files_named(top, RESULT_FILE, SESSION_FILE)})
    if not found:
        raise SessionError(f"{top} holds no run: no {RESULT_FILE} in it or below; process pictures first.")
    yield from found


def read_run(folder: str | Path) -> RunRows:
    """Read a run folder.

    A night or a session that writes into the folder meanwhile is waited for: what is read is one moment's.

    Raises
    ------
    SessionError
        A file is missing or damaged, or they do not belong together.
    """
    place = Path(folder).resolve()
    if not is_text(place):
        raise SessionError(
            f"the path {place} has bytes that are no UTF-8, which an archive cannot keep; rename it"
        )
    for left in reversed(range(READINGS)):
        before = _moment(place)
        try:
            run = _read(place)
        except SessionError:
            if left == 0 or _moment(place) == before:
                raise
        else:
            if _moment(place) == before:
                return replace(run, moment=_moment_text(before))
        time.sleep(PAUSE_S)
    raise SessionError("it is being written; take it in again when that is done")


def _moment(place: Path) -> tuple[tuple[int, ...], ...]:
    """Return what changes whenever one of a run's files does, or the folder itself."""
    found = []
    for path in (place, *(place / name for name in (RESULT_FILE, TABLE_FILE, SESSION_FILE))):
        with suppress(OSError):
            status = path.stat()
            # Beside the folder's files others come and go; a file's second time changes whatever its first is set to.
            times = (0, 0) if path == place else (status.st_mtime_ns, status.st_ctime_ns)
            found.append((status.st_ino, status.st_size, *times))
    return tuple(found)


def moment_of(place: Path) -> str:
    """Return a text that is another one as soon as a file of the run has been written, or another version would read it."""
    return _moment_text(_moment(place))


def _moment_text(moment: tuple[tuple[int, ...], ...]) -> str:
    return "/".join((__version__, *(" ".join(map(str, numbers)) for numbers in moment)))


def _read(place: Path) -> RunRows:
    result = _read_mapping(place / RESULT_FILE)
    # A picture that failed early has a result only; a session beside it is that of an earlier run.
    with_session = "provenance" in result and (place / SESSION_FILE).is_file()
    session = _read_mapping(place / SESSION_FILE) if with_session else None
    try:
        return _run(place, result, session)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{RESULT_FILE} is damaged ({error}); process the picture again") from error


def _run(place: Path, result: Mapping[str, Any], session: Mapping[str, Any] | None) -> RunRows:
    if result.get("status") not in IMAGE_STATUSES:
        raise ValueError(f"status {result.get('status')!r} is none of {', '.join(IMAGE_STATUSES)}")
    if session is not None and result.get("sha256", session["sha256"]) != session["sha256"]:
        raise SessionError(f"{RESULT_FILE} and {SESSION_FILE} are of different pictures; process it again")
    name_key = f"name:{result.get('mission')}/{result['image']}"
    columns, cells = _observables(place, result)
    parts = _part_rows(result, session, cells)
    content = {
        "result": without_times(result),
        "observables": cells,
        "journal": without_times(parts["journal"]),
    }
    image = row_of(result, IMAGES, PARTS_OF_RESULT)
    return RunRows(
        folder=place,
        key=result.get("sha256") or name_key,
        name_key=name_key,
        content_sha256=digest(content),
        processed_utc=_processed_utc(place, parts["journal"]),
        image=image
        | {"attention": list(_attention(result)), "path": None if session is None else session["image"]},
        parts=parts,
        observable_columns=columns,
    )


def _part_rows(
    result: Mapping[str, Any], session: Mapping[str, Any] | None, cells: Sequence[Mapping[str, Any]]
) -> dict[str, list[dict[str, Any]]]:
    pointing, origin = result.get("pointing"), result.get("provenance") or {}
    return {
        "pointings": [] if pointing is None else [row_of(pointing, POINTINGS)],
        "provenance": [row_of(origin, PROVENANCE, tuple(DECISIONS))] if origin else [],
        "stars": [row_of(star, STARS) for star in result.get("stars") or ()],
        "bodies": [row_of(body, BODIES) for body in result.get("bodies") or ()],
        "observables": [{"body": c["body"], "method": c["method"], "cells": c} for c in cells],
        "decisions": [
            _decision(item, verdict) for kind, verdict in DECISIONS.items() for item in origin.get(kind) or ()
        ],
        "journal": [_entry(item) for item in (session or {}).get("journal") or ()],
    }


def _decision(item: Any, verdict: str | None) -> dict[str, Any]:
    """A verdict on a star, or another decision: its subject, what was decided, why, and the rest as it stands."""
    if not isinstance(item, Mapping):
        return {"subject": None, "verdict": verdict, "reason": str(item), "extra": {}}
    named = next((key for key in ("star", "body", "name") if key in item), None)
    known = {named, "verdict", "reason"}
    return {
        "subject": None if named is None else str(item[named]),
        "verdict": item.get("verdict", verdict),
        "reason": item.get("reason"),
        "extra": {key: value for key, value in item.items() if key not in known},
    }


def _entry(item: Mapping[str, Any]) -> dict[str, Any]:
    known = ("step", "parameters", "reason", "outcome", "time_utc")
    row = {key: item.get(key) for key in known}
    return row | {"extra": {key: value for key, value in item.items() if key not in known}}


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


def _attention(result: Mapping[str, Any]) -> tuple[str, ...]:
    """What the run itself says an analyst should look at, else what its statuses say."""
    if "attention" in result:
        reasons = result["attention"] or ()
        return (reasons,) if isinstance(reasons, str) else tuple(str(reason) for reason in reasons)
    bodies = [(body.get("name"), body.get("status")) for body in result.get("bodies") or ()]
    return attention_reasons(result["status"], result.get("messages") or (), bodies)


def _observables(
    place: Path, result: Mapping[str, Any]
) -> tuple[tuple[ObservableColumn, ...], list[dict[str, Any]]]:
    """The observables' file, which must be there and agree with the result, except for a picture that failed early."""
    wanted = [(body["name"], body["method"]) for body in result.get("bodies") or ()]
    path = place / TABLE_FILE
    if not is_file(path):
        if wanted:
            raise SessionError(f"{TABLE_FILE} is missing; process the picture again")
        return (), []
    columns, cells = read_observables(path)
    if sorted((c["body"], c["method"]) for c in cells) != sorted(wanted):
        if result["status"] == "failed" and not wanted:  # a failure beside the files of an earlier success
            return (), []
        raise SessionError(
            f"{TABLE_FILE} and {RESULT_FILE} tell of different bodies; process the picture again"
        )
    return columns, cells


def _processed_utc(place: Path, journal: Sequence[Mapping[str, Any]]) -> str:
    """When the run was made: its last step, else when its result was written."""
    last = journal[-1].get("time_utc") if journal else None
    if isinstance(last, str) and re.match(r"\d{4}-\d\d-\d\dT", last):
        return last
    written = datetime.fromtimestamp((place / RESULT_FILE).stat().st_mtime, UTC)
    return written.isoformat(timespec="milliseconds")


def _read_mapping(path: Path) -> dict[str, Any]:
    if not exists(path):
        raise SessionError(f"{path.name} is missing; the run was not finished, process the picture again")
    written = read_json(path, "process the picture again")
    today = as_of_today(path.stem, written, path.name, SessionError)  # result or session
    return unstamped(today)  # the archive has a schema of its own


def without_times(value: Any) -> Any:
    """Return plain values without the keys that tell when something was done.

    Examples
    --------
    >>> without_times([{"step": "predict", "time_utc": "2026-01-01T00:00:00"}])
    [{'step': 'predict'}]
    """
    if isinstance(value, Mapping):
        return {key: without_times(item) for key, item in value.items() if key not in TIMES}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [without_times(item) for item in value]
    return value
