"""The archive's file: opened by many processes at once, brought to the present schema, never half-written.

Write-ahead logging lets readers read while one process writes; a writer takes the lock before it reads what it will
change (``BEGIN IMMEDIATE``), waits its turn, and tries again where SQLite will not wait.  A process that dies leaves the
last complete transaction.  Any older schema is brought to the present one, step by step, in the transaction that opens
the archive:

version 1   the first archives: no journal, and no reasons for an analyst to look
version 2   ``journal``; ``images.attention``
version 3   ``readings``

Reference: https://sqlite.org/wal.html, https://sqlite.org/lang_transaction.html
"""

import contextlib
import itertools
import random
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import sqlalchemy as sa

from opnav_workbench.campaign.run_folder import attention_reasons
from opnav_workbench.campaign.schema import APPLICATION_ID, SCHEMA_VERSION, metadata, tables
from opnav_workbench.errors import SessionError
from opnav_workbench.paths import exists, regular_size

__all__ = ["ARCHIVE_FILE", "ArchiveBusy", "ArchiveDamaged", "Database"]


# ---- From any older schema to the present one, step by step, in the transaction that opens the archive.


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
            MIGRATIONS[step](connection)
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
        reasons = attention_reasons(row.status, row.messages or (), [(b.body, b.status) for b in found])
        connection.execute(images.update().where(images.c.id == row.id).values(attention=list(reasons)))


def _from_2(connection: sa.Connection) -> None:
    """Add the readings: none is known yet."""
    tables["readings"].create(connection)


MIGRATIONS: dict[int, Callable[[sa.Connection], None]] = {1: _from_1, 2: _from_2}


# ---- The archive's file: opened by many processes at once, brought to the present schema, never half-written.

ARCHIVE_FILE = "campaign.sqlite"  # in the folder of its runs
# A picture is ingested in milliseconds: a minute is a queue of thousands. SQLite itself waits that long as a rule; what it
# refuses at once (lock of a recovery, change of journal mode) is tried again meanwhile.
BUSY_TIMEOUT_S = 60.0
PAUSE_S = 0.05
SQLITE_MAGIC = b"SQLite format 3\x00"
FORMAT_BYTES = slice(18, 20)  # of a file's head: to write, to read
KNOWN_FORMATS = {1, 2}
WRITE = {"opnav_write": True}

Answer = TypeVar("Answer")
DatabaseError: TypeAlias = sa.exc.DBAPIError | sqlite3.Error


class ArchiveDamaged(SessionError):  # noqa: N818  what it is, not that it is an error
    """The archive's file is no whole SQLite file any more; it can be made anew from the run folders."""


class ArchiveBusy(SessionError):  # noqa: N818  nothing is wrong with it
    """Another program has been writing into the archive for longer than anybody waits."""


class Database:
    """An SQLite file with the archive's schema.

    Parameters
    ----------
    create
        Make the file where there is none.

    Raises
    ------
    SessionError
        It is missing and not to be made, is no archive, is of a newer version, or cannot be read or written.
    """

    def __init__(self, path: Path, *, create: bool) -> None:
        self.path = path
        _check_file(path, create)
        url = sa.URL.create("sqlite", database=str(path))
        self._engine = sa.create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_S})
        sa.event.listen(self._engine, "connect", _on_connect)
        sa.event.listen(self._engine, "begin", _on_begin)
        try:
            self._retried(self._prepare)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; the last process to do so folds the write-ahead log into it."""
        self._engine.dispose()

    def write(self, work: Callable[[sa.Connection], Answer]) -> Answer:
        """Return what `work` returns, all that it writes committed together, or nothing of it.

        Raises
        ------
        SessionError
            The archive cannot be written.
        """
        return self._retried(lambda: self._written(work))

    def _written(self, work: Callable[[sa.Connection], Answer]) -> Answer:
        with self._engine.connect().execution_options(**WRITE) as connection, connection.begin():
            return work(connection)

    @contextlib.contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """Yield a connection that sees one state of the archive, whatever others write meanwhile.

        Raises
        ------
        SessionError
            The archive cannot be read, or a cell of it is damaged.
        """
        try:
            with self._engine.connect() as connection, connection.begin():
                yield connection
        except sa.exc.DBAPIError as error:
            raise self._named(error) from error
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            TypeError,
            ValueError,
        ) as error:  # a damaged cell
            raise self._impossible(error) from error

    def _retried(self, work: Callable[[], Answer]) -> Answer:
        patience = time.monotonic() + BUSY_TIMEOUT_S
        for attempt in itertools.count():
            try:
                return work()
            except UnicodeDecodeError as error:  # a damaged name, in SQLite's own message
                raise self._impossible(error) from error
            except (sa.exc.DBAPIError, sqlite3.Error) as error:
                if not _busy(error) or time.monotonic() >= patience:
                    raise self._named(error) from error
                # Two that were refused together shall not come back together.
                time.sleep(PAUSE_S * min(1.0 + attempt, 20.0) * random.uniform(0.5, 1.5))  # noqa: S311
        raise AssertionError("unreachable")

    def _prepare(self) -> None:
        self._written(lambda connection: migrate(connection, self.path))
        with contextlib.closing(self._engine.raw_connection()) as connection:
            connection.cursor().execute("PRAGMA journal_mode=WAL")  # outside any transaction

    def _impossible(self, error: Exception) -> SessionError:
        return SessionError(
            f"campaign archive {self.path} holds what it cannot hold ({error!r}); "
            "`opnav campaign ingest` makes a new one from the run folders."
        )

    def _named(self, error: DatabaseError) -> SessionError:
        code = _code(error)
        if _busy(error):
            return ArchiveBusy(
                f"campaign archive {self.path}: another program has been writing into it for {BUSY_TIMEOUT_S:.0f} s; wait "
                "for it or end it, and call this again."
            )
        damaged = code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
        damaged |= code == sqlite3.SQLITE_READONLY and _has_strange_format(self.path)
        kind = ArchiveDamaged if damaged else SessionError
        return kind(
            f"campaign archive {self.path}: {getattr(error, 'orig', error)}. Check the file, its folder's permissions "
            "and free space; `opnav campaign ingest` makes a new one from the run folders."
        )


def _check_file(path: Path, create: bool) -> None:
    """Refuse early what SQLite would answer with riddles."""
    if not exists(path):
        if not create:
            raise SessionError(f"there is no campaign archive {path}; make one: opnav campaign ingest RUN.")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SessionError(f"cannot make the folder of {path}: {error.strerror or error}.") from error
        return
    try:
        regular_size(path)  # a pipe would block
        with path.open("rb") as stream:
            head = stream.read(len(SQLITE_MAGIC))
    except OSError as error:
        raise SessionError(f"cannot read {path}: {error.strerror or error}.") from error
    if not head and not create:  # SQLite would take it for a new database, and write it
        raise SessionError(
            f"{path} is empty (0 bytes), no campaign archive; make one: opnav campaign ingest RUN."
        )
    if head and head != SQLITE_MAGIC:
        # Of our own name it is ours, with a damaged head; of another it may be anything.
        kind = ArchiveDamaged if path.name == ARCHIVE_FILE else SessionError
        raise kind(f"{path} is not a campaign archive (no SQLite file); give another name.")


def _has_strange_format(path: Path) -> bool:
    """Tell whether a file's head names a format that SQLite does not have, and therefore only reads."""
    with path.open("rb") as stream:
        head = stream.read(FORMAT_BYTES.stop)
    return not set(head[FORMAT_BYTES]) <= KNOWN_FORMATS


def _busy(error: DatabaseError) -> bool:
    return _code(error) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


def _code(error: DatabaseError) -> int:
    return int(getattr(getattr(error, "orig", error), "sqlite_errorcode", 0)) & 0xFF


def _on_connect(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # transactions are begun below, not where sqlite3 guesses
    connection.execute("PRAGMA foreign_keys=ON")
    connection.execute(f"PRAGMA busy_timeout={int(1000 * BUSY_TIMEOUT_S)}")


def _on_begin(connection: sa.Connection) -> None:
    options = connection.get_execution_options()
    if "opnav_write" in options:
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    else:
        connection.exec_driver_sql("BEGIN")
