"""Tables of the campaign archive (SQLite), made from `columns`.

images ─┬─ pointings (at most one)   provenance (one)
        ├─ stars   bodies   observables   decisions   journal      (in the order of the result)
history    what stood before, one row a picture and content
observable_columns   units and descriptions of the observables' columns, as their files state them
"""

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from opnav_workbench.campaign.columns import BODIES, IMAGES, POINTINGS, PROVENANCE, STARS, Column

__all__ = ["APPLICATION_ID", "PARTS", "SCHEMA_VERSION", "metadata", "tables"]

SCHEMA_VERSION = 2
APPLICATION_ID = 0x4F504E56  # "OPNV": says to `file` and to us whose database this is

metadata = sa.MetaData()
JSON = sa.JSON(none_as_null=True)
TYPES: dict[str, sa.types.TypeEngine[Any]] = {
    "text": sa.Text(),
    "number": sa.Float(),
    "whole": sa.Integer(),
    "flag": sa.Boolean(),
    "json": JSON,
}


def _columns(columns: Sequence[Column]) -> list["sa.Column[Any]"]:
    return [sa.Column(column.name, TYPES[column.kind]) for column in columns]


def _of_image(name: str, *columns: "sa.Column[Any]", single: bool = False) -> sa.Table:
    """A table of rows that belong to a picture and go with it; `position` keeps their order."""
    owner: sa.Column[Any] = sa.Column(
        "image_id", sa.ForeignKey("images.id", ondelete="CASCADE"), primary_key=True
    )
    order = [] if single else [sa.Column("position", sa.Integer, primary_key=True)]
    return sa.Table(name, metadata, owner, *order, *columns)


images = sa.Table(
    "images",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("key", sa.Text, nullable=False, unique=True),  # the picture's own, wherever it was processed
    *_columns(IMAGES),
    sa.Column("attention", JSON, nullable=False),  # why an analyst should look; empty: need not
    sa.Column("extra", JSON),
    sa.Column("path", sa.Text),  # of the picture, as the session knew it
    sa.Column("folder", sa.Text, nullable=False, index=True),
    sa.Column("content_sha256", sa.Text, nullable=False),
    sa.Column("processed_utc", sa.Text, nullable=False),
    sa.Column("ingested_utc", sa.Text, nullable=False),
    sa.Index("images_by_time", "et"),
)
pointings = _of_image("pointings", *_columns(POINTINGS), sa.Column("extra", JSON), single=True)
provenance = _of_image("provenance", *_columns(PROVENANCE), sa.Column("extra", JSON), single=True)
stars = _of_image("stars", *_columns(STARS), sa.Column("extra", JSON))
bodies = _of_image("bodies", *_columns(BODIES), sa.Column("extra", JSON))
observables = _of_image(
    "observables",
    sa.Column("body", sa.Text),
    sa.Column("method", sa.Text),
    sa.Column("cells", JSON, nullable=False),
)
decisions = _of_image(
    "decisions",
    sa.Column("subject", sa.Text),
    sa.Column("verdict", sa.Text),
    sa.Column("reason", sa.Text),
    sa.Column("extra", JSON),
)
journal = _of_image(
    "journal",
    sa.Column("step", sa.Text, nullable=False),
    sa.Column("parameters", JSON),
    sa.Column("reason", sa.Text),
    sa.Column("outcome", sa.Text),
    sa.Column("time_utc", sa.Text),
    sa.Column("extra", JSON),
)
observable_columns = sa.Table(
    "observable_columns",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("unit", sa.Text),
    sa.Column("description", sa.Text),
    sa.Column("position", sa.Integer, nullable=False),
)
history = sa.Table(
    "history",
    metadata,
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("content_sha256", sa.Text, primary_key=True),
    sa.Column("image", sa.Text),
    sa.Column("status", sa.Text),
    sa.Column("summary", JSON),
    sa.Column("folder", sa.Text),
    sa.Column("processed_utc", sa.Text),
    sa.Column("ingested_utc", sa.Text),
)

PARTS: tuple[str, ...] = (
    "pointings", "provenance", "stars", "bodies", "observables", "decisions", "journal",
)  # fmt: skip
tables: dict[str, sa.Table] = dict(metadata.tables)
