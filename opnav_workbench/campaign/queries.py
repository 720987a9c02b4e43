"""Questions to the archive, answered as astropy tables with units and descriptions."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa
from astropy import units as u
from astropy.table import Column as AstropyColumn
from astropy.table import MaskedColumn, QTable, Table

from opnav_workbench.campaign.run_folder import ObservableColumn, observables_from_rows
from opnav_workbench.campaign.schema import BODIES, IMAGES, POINTINGS, PROVENANCE, STARS, Column, tables
from opnav_workbench.errors import SessionError

__all__ = [
    "QUESTIONS",
    "query_observables",
    "query_origins",
    "query_plain",
    "query_solutions",
    "query_table",
]

QUESTIONS = ("images", "pointings", "stars", "bodies", "decisions", "journal", "provenance", "history")
DECISIONS = (
    Column("subject", "text", "", "star, body or other subject"),
    Column("verdict", "text", "", "what the analyst decided"),
    Column("reason", "text", "", "why, in the analyst's words"),
)
JOURNAL = (
    Column("step", "text", "", "of the session"),
    Column("outcome", "text", "", "what came out"),
    Column("reason", "text", "", "why, in the analyst's words"),
    Column("time_utc", "text", "", "when, UTC"),
)
HISTORY = (
    Column("image", "text", "", "name of the picture"),
    Column("status", "text", "", "of the run that stood before"),
    Column("processed_utc", "text", "", "when it was made, UTC"),
    Column("ingested_utc", "text", "", "when something else took its place, UTC"),
    Column("folder", "text", "", "where the run was"),
    Column("content_sha256", "text", "", "of all that came out"),
)
PART_COLUMNS: dict[str, tuple[Column, ...]] = {
    "pointings": POINTINGS,
    "stars": STARS,
    "bodies": BODIES,
    "decisions": DECISIONS,
    "journal": JOURNAL,
    "provenance": PROVENANCE,
}
MADE_WITH = ("version", "catalog", "attitude_source", "observer_source", "kernels", "settings")
# Of the picture, beside the rows of its parts.
IMAGE_COLUMNS = ("image", "utc", "et")
ARCHIVE_COLUMNS = (
    Column("attention", "json", "", "why an analyst should look; empty: need not"),
    Column("folder", "text", "", "where the run is"),
)
TEXT_LISTS = ("messages", "attention")
EMPTY: dict[str, Any] = {"number": np.nan, "whole": 0, "flag": False, "text": "", "json": ""}
BEGINS_A_DATE = re.compile(r"\d{4}(-\d|-?$)")  # as exact as need be: 2015, 2015-04, 2015-099T12
AFTER_ALL_TEXT = "\uffff"  # after every text that begins alike: 2015-04-09 as an end holds the whole day


def query_table(
    connection: sa.Connection, what: str, filters: Mapping[str, str | None], only: Sequence[str] | None = None
) -> Table:
    """Return the rows of a part of the archive.

    Parameters
    ----------
    what : {"images", "pointings", "stars", "bodies", "decisions", "journal", "provenance", "history"}
        History: what stood before and was replaced, the oldest first.
    filters
        ``status, body, method, image, star, mission, camera``: equal to that, in any case; several with commas.
        ``since, until``: UTC, ISO, as exact as need be.
    only
        Names of the columns wanted, but for ``history``; None: all, and what a newer version's results hold beside them.

    Raises
    ------
    SessionError
        An unknown question, or a filter that it does not have.
    """
    if what not in QUESTIONS:
        raise SessionError(f"unknown table {what!r}; choose one of {', '.join(QUESTIONS)}.")
    if what == "history":
        return _history(connection, filters)
    images = tables["images"]
    if what == "images":
        columns = _in_tables((*IMAGES, *ARCHIVE_COLUMNS))
        places: list[Any] = [images.c[c.name] for c in columns]
        source, extra = sa.select().select_from(images), images.c.extra
    else:
        table = tables[what]
        parts = _in_tables(PART_COLUMNS[what])
        columns = (*[c for c in IMAGES if c.name in IMAGE_COLUMNS], *parts)
        places = [*[images.c[n] for n in IMAGE_COLUMNS], *[table.c[c.name] for c in parts]]
        source, extra = sa.select().join_from(images, table), table.c.extra
    if only is not None:  # the rest is most of an archive's bytes
        wanted = [
            (column, place) for column, place in zip(columns, places, strict=True) if column.name in only
        ]
        columns, places = tuple(c for c, _ in wanted), [p for _, p in wanted]
    chosen = source.add_columns(*places, extra if only is None else sa.null().label("extra"))
    return _table(connection.execute(_filtered(chosen, what, filters)).all(), columns)


def _in_tables(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return the columns that a table shows; of those that hold lists only the ones that read as text."""
    return tuple(column for column in columns if column.kind != "json" or column.name in TEXT_LISTS)


def _history(connection: sa.Connection, filters: Mapping[str, str | None]) -> Table:
    table = tables["history"]
    query = sa.select(*[table.c[c.name] for c in HISTORY], sa.null().label("extra"))
    for name, value in filters.items():
        if value is None:
            continue
        if name not in ("image", "status"):
            raise SessionError(f"history has no {name}; leave that filter out.")
        options = [option.strip().casefold() for option in value.split(",") if option.strip()]
        query = query.where(sa.func.lower(table.c[name]).in_(options))
    return _table(connection.execute(query.order_by(table.c.processed_utc, table.c.key)).all(), HISTORY)


def query_plain(connection: sa.Connection, what: str) -> list[dict[str, Any]]:
    """Return all rows of ``decisions, journal, provenance`` (each with its picture) or ``history`` as plain values."""
    images, table = tables["images"], tables[what]
    if what == "history":
        query = sa.select(table).order_by(table.c.processed_utc, table.c.key)
        return [dict(row) for row in connection.execute(query).mappings()]
    own = [column for column in table.c if column.name != "image_id"]
    query = sa.select(images.c.image, *own).join_from(images, table)
    return [dict(row) for row in connection.execute(_ordered(query, table)).mappings()]


def query_origins(connection: sa.Connection) -> list[dict[str, Any]]:
    """Return mission, camera, program, catalog and kernels of every picture."""
    images, made = tables["images"], tables["provenance"]
    columns = (
        images.c.image,
        images.c.mission,
        images.c.camera,
        made.c.version,
        made.c.catalog,
        made.c.kernels,
    )
    query = sa.select(*columns).join_from(images, made)
    return [dict(row) for row in connection.execute(_ordered(query, made)).mappings()]


def query_solutions(connection: sa.Connection) -> dict[str, dict[str, Any]]:
    """Return what was solved in every picture, by the picture's key.

    Returns
    -------
    mapping of str to dict
        ``image, et, status, quaternion, covariance, model, version, catalog, attitude_source, observer_source, kernels,
        settings`` and ``bodies``: by "BODY, method" their ``status``, ``residual`` (pixel, line; None where not measured)
        and its ``covariance``.
    """
    images, pointings, made = tables["images"], tables["pointings"], tables["provenance"]
    query = sa.select(
        *[images.c[name] for name in ("key", "image", "et", "status")],
        pointings.c.quaternion_camera_from_j2000.label("quaternion"),
        pointings.c.covariance_rad2.label("covariance"),
        pointings.c.model,
        *[made.c[name] for name in MADE_WITH],
    ).select_from(images.outerjoin(pointings).outerjoin(made))
    found = {row["key"]: {**row, "bodies": {}} for row in connection.execute(query).mappings()}
    bodies = tables["bodies"]
    names = ["body", "method", "status", "residual_pixel", "residual_line"]
    names += ["covariance_oc_pixel_pixel", "covariance_oc_pixel_line", "covariance_oc_line_line"]
    query = sa.select(images.c.key, *[bodies.c[name] for name in names]).join_from(images, bodies)
    for row in connection.execute(query):
        key, body, method, status, pixel, line, xx, xy, yy = tuple(row)
        residual = None if pixel is None or line is None else (pixel, line)
        covariance = None if None in (xx, xy, yy) else ((xx, xy), (xy, yy))
        found[key]["bodies"][f"{body}, {method}"] = {
            "status": status,
            "residual": residual,
            "covariance": covariance,
        }
    return found


def query_observables(connection: sa.Connection, filters: Mapping[str, str | None]) -> QTable:
    """Return the observables with the units and descriptions of their files; filters as in `ask`."""
    images, table, columns = tables["images"], tables["observables"], tables["observable_columns"]
    known = connection.execute(sa.select(columns).order_by(columns.c.position, columns.c.name)).all()
    chosen = sa.select(table.c.cells).join_from(images, table)
    rows = connection.execute(_filtered(chosen, "observables", filters)).scalars().all()
    status = filters.get("status")
    if status:
        wanted = {s.strip().casefold() for s in status.split(",")}
        rows = [cells for cells in rows if str(cells.get("status", "")).casefold() in wanted]
    return observables_from_rows([ObservableColumn(c.name, c.unit, c.description) for c in known], rows)


def _ordered(query: "sa.Select[Any]", table: sa.Table) -> "sa.Select[Any]":
    images = tables["images"]
    order = [images.c.et, images.c.image, images.c.key]
    return query.order_by(*order, *([table.c.position] if "position" in table.c else []))


def _filtered(query: "sa.Select[Any]", what: str, filters: Mapping[str, str | None]) -> "sa.Select[Any]":
    images, table = tables["images"], tables[what]
    for name, value in filters.items():
        if value is None or (what == "observables" and name == "status"):
            continue
        if name in ("since", "until"):
            begins = value.strip().replace(" ", "T").removesuffix("Z")
            if not BEGINS_A_DATE.match(begins):
                raise SessionError(
                    f"--{name} {value!r} is no date; write it like 2015-04-09 or 2015-04-09T12:30."
                )
            limit = images.c.utc >= begins if name == "since" else images.c.utc <= begins + AFTER_ALL_TEXT
            query = query.where(limit)
            continue
        owner = table if name in table.c else images
        if name not in owner.c:
            raise SessionError(f"{what} have no {name}; leave that filter out.")
        options = [option.strip().casefold() for option in value.split(",") if option.strip()]
        query = query.where(sa.func.lower(owner.c[name]).in_(options))
    return _ordered(query, table)


def _table(rows: Sequence[Sequence[Any]], columns: Sequence[Column]) -> Table:
    """A table of rows, each with its extra values last; unknown numbers are nan, flags and counts masked, lists one text."""
    table = Table()
    of_columns: list[Sequence[Any]] = list(zip(*rows, strict=True)) or [()] * (len(columns) + 1)
    for column, values in zip(columns, of_columns, strict=False):
        table[column.name] = _cells(values, column)
    extra = [values or {} for values in of_columns[-1]]
    for name in _extra_names(extra, set(table.colnames)):
        more = [values.get(name) for values in extra]
        table[name] = _cells(more, _guessed_column(name, more))
    return table


def _cells(values: Sequence[Any], column: Column) -> Any:
    if column.kind == "json":
        values = ["; ".join(map(str, value)) if isinstance(value, list) else value for value in values]
    filled = [EMPTY[column.kind] if value is None else value for value in values]
    dtype = {"number": float, "whole": int, "flag": bool}.get(column.kind, str)
    common = {"description": column.description, "dtype": dtype}
    if column.kind in ("whole", "flag"):
        return MaskedColumn(filled, mask=[value is None for value in values], **common)
    unit = u.Unit(column.unit) if column.unit else None
    return AstropyColumn(filled, unit=unit, **common)


def _extra_names(extra: Iterable[Mapping[str, Any]], taken: set[str]) -> list[str]:
    """Names of plain values that no column stands for: a newer version's results are not hidden."""
    names: dict[str, None] = {}
    for values in extra:
        for name, value in values.items():
            if isinstance(value, str | int | float) and name not in taken:
                names.setdefault(name)
    return list(names)


def _guessed_column(name: str, values: Sequence[Any]) -> Column:
    known = [value for value in values if value is not None]
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in known):
        return Column(name, "number")
    return Column(name, "flag" if all(isinstance(value, bool) for value in known) else "json")
