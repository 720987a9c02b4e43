"""Runs into the archive: each in one transaction, the same content only once, whatever the order.

Of several runs of one picture the one processed last stands; the others are history. What a folder held before
is history too once something else stands in it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy.dialects.sqlite import insert

from opnav_workbench.campaign.run_folder import Reading, RunRows
from opnav_workbench.campaign.schema import PARTS, tables

__all__ = ["IngestReport", "Ingested", "KnownRun", "changes_nothing", "known_runs", "put_readings", "put_run"]

IngestResult = Literal["new", "unchanged", "replaced", "older", "skipped"]
IMAGES, HISTORY, COLUMNS = tables["images"], tables["history"], tables["observable_columns"]
READINGS = tables["readings"]


@dataclass(frozen=True, slots=True)
class Ingested:
    """What became of one run folder.

    Attributes
    ----------
    image
        Empty where the folder could not be read.
    result : {"new", "unchanged", "replaced", "older", "skipped"}
        "older": a later run of the same picture stands already; this one is kept as history.
    reason
        Why it was skipped.
    """

    folder: Path
    image: str
    result: IngestResult
    reason: str = ""


@dataclass(frozen=True, slots=True)
class IngestReport:
    """What became of many run folders, in their order."""

    results: tuple[Ingested, ...]

    def count(self, result: IngestResult) -> int:
        """Return how many folders have this result."""
        return sum(ingested.result == result for ingested in self.results)

    @property
    def skipped(self) -> tuple[Ingested, ...]:
        """Folders that could not be read, each with its reason."""
        return tuple(ingested for ingested in self.results if ingested.result == "skipped")


@dataclass(frozen=True, slots=True)
class KnownRun:
    """A run that stands in the archive.

    Attributes
    ----------
    image
        Name of its picture.
    moment
        When its folder's files were written (`run_folder.moment_of`); as long as they tell the same they hold the same.
    """

    image: str
    moment: str


def known_runs(connection: sa.Connection) -> dict[str, KnownRun]:
    """Return by folder what stands and need not be read as long as its files were not written."""
    same = (READINGS.c.folder == IMAGES.c.folder) & (READINGS.c.content_sha256 == IMAGES.c.content_sha256)
    query = sa.select(IMAGES.c.folder, IMAGES.c.image, READINGS.c.moment).join(READINGS, same)
    return {folder: KnownRun(image, moment) for folder, image, moment in connection.execute(query)}


def put_readings(connection: sa.Connection, readings: Iterable[Reading]) -> None:
    """Keep when the files of runs were written; call it in a transaction."""
    for folder, moment, content_sha256 in readings:
        row = {"moment": moment, "content_sha256": content_sha256}
        kept = insert(READINGS).values(folder=folder, **row)
        connection.execute(kept.on_conflict_do_update(index_elements=[READINGS.c.folder], set_=row))


def changes_nothing(connection: sa.Connection, run: RunRows) -> bool:
    """Tell whether exactly this run stands already; asked before the lock is taken."""
    standing = _standing(connection, run.key)
    same = standing is not None and standing.content_sha256 == run.content_sha256
    return same and standing.folder == str(run.folder)


def put_run(connection: sa.Connection, run: RunRows) -> IngestResult:
    """Put a run into its place; call it in a transaction."""
    put_readings(connection, [run.reading])
    for row in connection.execute(
        sa.select(IMAGES).where(IMAGES.c.folder == str(run.folder), IMAGES.c.key != run.key)
    ).all():
        _move_to_history(connection, row)
    if _older_than_named(connection, run):
        return "older"
    standing = _standing(connection, run.key)
    if standing is None:
        _insert(connection, run)
        return "new"
    order = (run.processed_utc, run.content_sha256), (standing.processed_utc, standing.content_sha256)
    if standing.content_sha256 == run.content_sha256:
        if order[0] > order[1]:  # where it was found last
            _move(connection, standing.id, run)
        return "unchanged"
    if standing.folder != str(run.folder) and order[0] < order[1]:
        _add_to_history(connection, _entry_of(run))
        return "older"
    _move_to_history(connection, standing)
    _insert(connection, run)
    return "replaced"


def _older_than_named(connection: sa.Connection, run: RunRows) -> bool:
    """Settle a run that could not even read its picture with one that could; True where the other came later.

    The first knows the picture by its name alone. Whichever was made last tells what became of it.
    """
    named = run.name_key == run.key
    others = IMAGES.c.key.startswith("name:", autoescape=True)
    same = (IMAGES.c.image == run.image["image"]) & (IMAGES.c.mission == run.image["mission"])
    query = sa.select(IMAGES).where(same, ~others if named else others)
    for row in connection.execute(query).all():
        if named and row.processed_utc > run.processed_utc:
            _add_to_history(connection, _entry_of(run))
            return True
        if not named and row.processed_utc < run.processed_utc:
            _move_to_history(connection, row)
    return False


def _standing(connection: sa.Connection, key: str) -> Any:
    return connection.execute(sa.select(IMAGES).where(IMAGES.c.key == key)).one_or_none()


def _insert(connection: sa.Connection, run: RunRows) -> None:
    place = {
        "key": run.key,
        "content_sha256": run.content_sha256,
        "folder": str(run.folder),
        "processed_utc": run.processed_utc,
        "ingested_utc": _now(),
    }
    made = connection.execute(IMAGES.insert().values(**run.image, **place)).inserted_primary_key
    assert made is not None
    number = made[0]
    for part in PARTS:
        _insert_rows(connection, tables[part], number, run.parts[part])
    for position, column in enumerate(run.observable_columns):
        row = {"name": column.name, "unit": column.unit, "description": column.description}
        connection.execute(insert(COLUMNS).values(**row, position=position).on_conflict_do_nothing())
    same = (HISTORY.c.key == run.key) & (HISTORY.c.content_sha256 == run.content_sha256)
    connection.execute(HISTORY.delete().where(same))  # what stands is not history


def _insert_rows(connection: sa.Connection, table: sa.Table, number: int, rows: Any) -> None:
    if rows:
        ordered = "position" in table.c
        own = [
            {"image_id": number, **({"position": i} if ordered else {}), **row} for i, row in enumerate(rows)
        ]
        connection.execute(table.insert(), own)


def _move(connection: sa.Connection, number: int, run: RunRows) -> None:
    place = {"folder": str(run.folder), "path": run.image["path"], "processed_utc": run.processed_utc}
    connection.execute(IMAGES.update().where(IMAGES.c.id == number).values(**place))


def _move_to_history(connection: sa.Connection, row: Any) -> None:
    """Take a picture's rows out and keep in the history what they said."""
    values = row._mapping  # noqa: SLF001 - the documented way to a row's mapping
    entry = {
        name: values[name] for name in ("key", "content_sha256", "image", "status", "folder", "processed_utc")
    }
    _add_to_history(connection, entry | {"summary": _summary(connection, row.id, values["messages"])})
    connection.execute(IMAGES.delete().where(IMAGES.c.id == row.id))


def _add_to_history(connection: sa.Connection, entry: Mapping[str, Any]) -> None:
    connection.execute(insert(HISTORY).values(**entry, ingested_utc=_now()).on_conflict_do_nothing())


def _summary(connection: sa.Connection, number: int, messages: Any) -> dict[str, Any]:
    parts: dict[str, Any] = {"messages": messages}
    for name in ("pointings", "bodies"):
        query = sa.select(tables[name]).where(tables[name].c.image_id == number)
        rows = [dict(row) for row in connection.execute(query).mappings()]
        parts[name] = [{k: v for k, v in row.items() if k not in ("image_id", "position")} for row in rows]
    return parts


def _entry_of(run: RunRows) -> dict[str, Any]:
    return {
        "key": run.key,
        "content_sha256": run.content_sha256,
        "image": run.image["image"],
        "status": run.image["status"],
        "summary": {
            "messages": run.image["messages"],
            "pointings": list(run.parts["pointings"]),
            "bodies": list(run.parts["bodies"]),
        },
        "folder": str(run.folder),
        "processed_utc": run.processed_utc,
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
