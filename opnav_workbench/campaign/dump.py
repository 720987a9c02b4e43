"""The archive's content as plain values, free of everything that depends on when, where and in what order it was filled."""

import hashlib
import json
from typing import Any

import sqlalchemy as sa

from opnav_workbench.campaign.run_folder import without_times
from opnav_workbench.campaign.schema import PARTS, tables

__all__ = ["content_digest", "content_of"]

# Where the files were, and when: not what came out.
PLACES = ("id", "image_id", "folder", "path", "processed_utc", "ingested_utc")


def content_of(connection: sa.Connection) -> dict[str, list[dict[str, Any]]]:
    """Return every row of every table, in the order of pictures' keys."""
    images = tables["images"]
    content = {"images": _rows(connection, sa.select(images).order_by(images.c.key))}
    for name in PARTS:
        table = tables[name]
        order = (table.c.position,) if "position" in table.c else ()
        query = sa.select(images.c.key.label("picture"), table).join(images).order_by(images.c.key, *order)
        content[name] = _rows(connection, query)
    history, columns = tables["history"], tables["observable_columns"]
    content["history"] = _rows(
        connection, sa.select(history).order_by(history.c.key, history.c.content_sha256)
    )
    content["observable_columns"] = _rows(
        connection, sa.select(columns.c.name, columns.c.unit, columns.c.description).order_by(columns.c.name)
    )
    return content


def content_digest(connection: sa.Connection) -> str:
    """Return the SHA-256 of `content_of`."""
    text = json.dumps(content_of(connection), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _rows(connection: sa.Connection, query: "sa.Select[Any]") -> list[dict[str, Any]]:
    rows = connection.execute(query).mappings()
    return [without_times({k: v for k, v in row.items() if k not in PLACES}) for row in rows]
