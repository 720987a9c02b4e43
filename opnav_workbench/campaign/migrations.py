"""From any older schema to the present one, step by step, in the transaction that opens the archive.

version 1   the first archives: no journal, and no reasons for an analyst to look
version 2   ``journal``; ``images.attention``
"""

from collections.abc import Callable
from pathlib import Path

import sqlalchemy as sa

from opnav_workbench.campaign.attention import attention_of
from opnav_workbench.campaign.schema import APPLICATION_ID, SCHEMA_VERSION, metadata, tables
from opnav_workbench.errors import SessionError

__all__ = ["migrate"]


def migrate(connection: sa.Connection, path: Path) -> None:
    """Bring the archive to the present schema; a new file gets all of it.

    Raises
    ------
    SessionError
        The file is another program's, or of a newer version of this one.
    """
    version = _pragma(connection, "user_version")
    owner = _pragma(connection, "application_id")
    empty = not sa.inspect(connection).get_table_names()
    if (not empty and owner != APPLICATION_ID) or (empty and version != 0):
        raise SessionError(f"{path} is a database of another program; give another name.")
    if version > SCHEMA_VERSION:
        raise SessionError(
            f"{path} has schema {version}, this program knows {SCHEMA_VERSION} at most; use the newer opnav_workbench "
            "that wrote it (nothing has been changed)."
        )
    if version == SCHEMA_VERSION:
        return
    if empty:
        metadata.create_all(connection)
    else:
        for step in range(version, SCHEMA_VERSION):
            STEPS[step](connection)
    connection.exec_driver_sql(f"PRAGMA application_id={APPLICATION_ID}")
    connection.exec_driver_sql(f"PRAGMA user_version={SCHEMA_VERSION}")


def _pragma(connection: sa.Connection, name: str) -> int:
    return int(connection.exec_driver_sql(f"PRAGMA {name}").scalar_one())


def _from_1(connection: sa.Connection) -> None:
    """Add the journal, and why an analyst should look at a picture, as its status and messages tell it."""
    tables["journal"].create(connection)
    connection.exec_driver_sql("ALTER TABLE images ADD COLUMN attention JSON NOT NULL DEFAULT '[]'")
    images, bodies = tables["images"], tables["bodies"]
    for row in connection.execute(sa.select(images.c.id, images.c.status, images.c.messages)).all():
        found = connection.execute(
            sa.select(bodies.c.body, bodies.c.status)
            .where(bodies.c.image_id == row.id)
            .order_by(bodies.c.position)
        )
        reasons = attention_of(row.status, row.messages or (), [(b.body, b.status) for b in found])
        connection.execute(images.update().where(images.c.id == row.id).values(attention=list(reasons)))


STEPS: dict[int, Callable[[sa.Connection], None]] = {1: _from_1}
