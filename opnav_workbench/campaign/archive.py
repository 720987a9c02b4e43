"""The campaign archive as users hold it: open, ingest runs, ask, export.

Its digest is free of everything that depends on when, where and in what order it was filled.  Exported observables are one
file: ECSV with every column that the runs' own files have, CSV, JSON or TDM.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import sqlalchemy as sa
from astropy.table import QTable, Table

from opnav_workbench.campaign import browsing
from opnav_workbench.campaign.database import ARCHIVE_FILE, Database
from opnav_workbench.campaign.ingest import (
    Ingested,
    IngestReport,
    KnownRun,
    changes_nothing,
    known_runs,
    put_readings,
    put_run,
)
from opnav_workbench.campaign.queries import (
    query_observables,
    query_origins,
    query_plain,
    query_solutions,
    query_table,
)
from opnav_workbench.campaign.run_folder import Reading, find_runs, moment_of, read_run, without_times
from opnav_workbench.campaign.schema import PARTS, tables
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, digest
from opnav_workbench.observables import (
    Observable,
    Origin,
    table_observables,
    write_csv,
    write_observables_json,
    write_tdm,
)
from opnav_workbench.observables.explanation import explanation, together
from opnav_workbench.paths import is_folder
from opnav_workbench.session.storage import SESSION_FILE

__all__ = ["ARCHIVE_FILE", "EXPORT_FORMATS", "Campaign", "ImageEntry", "export_observables"]


# ---- The content as plain values.

# Where the files were, and when: not what came out.
PLACES_AND_TIMES = ("id", "image_id", "folder", "path", "processed_utc", "ingested_utc")


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
    return digest(content_of(connection))


def _rows(connection: sa.Connection, query: "sa.Select[Any]") -> list[dict[str, Any]]:
    rows = connection.execute(query).mappings()
    return [without_times({k: v for k, v in row.items() if k not in PLACES_AND_TIMES}) for row in rows]


# ---- The archive itself.


@dataclass(frozen=True, slots=True)
class ImageEntry:
    """A picture of the campaign, as a list of pictures shows it.

    Attributes
    ----------
    et
        TDB seconds past J2000; None for a picture that could not be read.
    status : {"ok", "partial", "failed"}
    folder
        Its run; `ImageSession.resume` opens it where `resumable`.
    path
        The picture file, as the run knew it.
    attention
        Why an analyst should look; empty: need not.
    """

    image: str
    utc: str
    et: float | None
    status: str
    folder: Path
    path: Path | None
    mission: str
    attention: tuple[str, ...]

    @property
    def needs_analyst(self) -> bool:
        """Whether there is a reason to look."""
        return bool(self.attention)

    @property
    def resumable(self) -> bool:
        """Whether the run holds a session to go on with."""
        return (self.folder / SESSION_FILE).is_file()


class Campaign:
    """An archive of many pictures' runs: one SQLite file that many processes may use at once.

    Parameters
    ----------
    path
        The file; a folder means ``campaign.sqlite`` in it.
    create
        Make a new archive where there is none.

    Raises
    ------
    SessionError
        There is no archive (and none is to be made), or it is another program's, damaged or of a newer version.

    Examples
    --------
    ::

        with Campaign("night/campaign.sqlite") as campaign:
            campaign.ingest("night")
            print(campaign.bodies(body="PLUTO", status="ok"))
    """

    def __init__(self, path: str | Path, *, create: bool = True) -> None:
        file = Path(path)
        self._database = Database(file / ARCHIVE_FILE if is_folder(file) else file, create=create)
        self._readings: list[Reading] = []

    def __enter__(self) -> "Campaign":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    @property
    def path(self) -> Path:
        """The archive's file."""
        return self._database.path

    # -- in ----------------------------------------------------------------------------------------------------

    def ingest(
        self,
        runs: str | Path | Iterable[str | Path],
        say: Callable[[Ingested], None] = lambda _: None,
    ) -> IngestReport:
        """Take in run folders, or all below the given folders; the same content twice changes nothing.

        Each run is one transaction: stopped anywhere, the archive holds the runs before whole, and this one not at all.

        Parameters
        ----------
        runs : path, or many
        say
            Called with what became of each folder.

        Raises
        ------
        SessionError
            A folder does not exist or holds no run at all, or the archive cannot be written. Damaged runs are no
            error: they are skipped, and named in the report.
        """
        tops = [runs] if isinstance(runs, str | Path) else list(runs)
        folders = dict.fromkeys(folder for top in tops for folder in find_runs(top))
        known, results = self.known_runs(), []
        for folder in folders:
            results.append(self.ingest_run(folder, known))
            say(results[-1])
        self.keep_readings()
        return IngestReport(tuple(results))

    def known_runs(self) -> dict[str, KnownRun]:
        """Return by folder the runs that `ingest_run` need not read as long as their files are not written."""
        with self._database.read() as connection:
            return known_runs(connection)

    def keep_readings(self) -> None:
        """Keep what was read and found unchanged, so that it is known next time; an archive that is busy goes without."""
        found, self._readings = self._readings, []
        if found:
            with suppress(SessionError):
                self._database.write(lambda connection: put_readings(connection, found))

    def ingest_run(
        self, folder: str | Path, known: Mapping[str, KnownRun] = MappingProxyType({})
    ) -> Ingested:
        """Take in one run folder; never raises for what is wrong with it.

        Parameters
        ----------
        known
            From `known_runs`: what stands there as it stood is not read.
        """
        place = Path(folder)
        standing = known.get(str(place.resolve())) if known else None
        if standing is not None and standing.moment == moment_of(place):
            return Ingested(place, standing.image, "unchanged")
        try:
            run = read_run(place)
        except SessionError as error:
            return Ingested(place, "", "skipped", str(error))
        with self._database.read() as connection:
            if changes_nothing(connection, run):
                self._readings.append(run.reading)
                return Ingested(place, run.image["image"], "unchanged")
        result = self._database.write(lambda connection: put_run(connection, run))
        return Ingested(place, run.image["image"], result)

    # -- out ---------------------------------------------------------------------------------------------------

    def query(self, what: str, only: Sequence[str] | None = None, **filters: str | None) -> Table:
        """Return ``images``, ``pointings``, ``stars`` or ``bodies``; see `opnav_workbench.campaign.queries.query_table`."""
        with self._database.read() as connection:
            return query_table(connection, what, filters, only)

    def images(self, **filters: str | None) -> Table:
        """Return one row a picture; filters ``status, since, until, image, mission, camera``."""
        return self.query("images", **filters)

    def pointings(self, **filters: str | None) -> Table:
        """Return one row a solved pointing."""
        return self.query("pointings", **filters)

    def stars(self, **filters: str | None) -> Table:
        """Return one row a star and picture."""
        return self.query("stars", **filters)

    def bodies(self, **filters: str | None) -> Table:
        """Return one row a body, method and picture; filters also ``body, method``."""
        return self.query("bodies", **filters)

    def observables(self, **filters: str | None) -> QTable:
        """Return all observables, with the units and descriptions of their files."""
        with self._database.read() as connection:
            return query_observables(connection, filters)

    def decisions(self) -> list[dict[str, Any]]:
        """Return what analysts decided: picture, subject, verdict, reason."""
        return self._plain("decisions")

    def journal(self) -> list[dict[str, Any]]:
        """Return every step of every session."""
        return self._plain("journal")

    def provenance(self) -> list[dict[str, Any]]:
        """Return version, kernels, catalog and settings of every picture."""
        return self._plain("provenance")

    def origins(self, images: Iterable[str]) -> tuple[Origin, ...]:
        """Return how the observables of pictures came about: mission, camera, program, catalog, kernels."""
        wanted = {str(image) for image in images}
        with self._database.read() as connection:
            rows = query_origins(connection)
        return together(
            Origin.of_result({**row, "provenance": row}) for row in rows if row["image"] in wanted
        )

    def solutions(self) -> dict[str, dict[str, Any]]:
        """Return what was solved in every picture; see `opnav_workbench.campaign.queries.query_solutions`."""
        with self._database.read() as connection:
            return query_solutions(connection)

    # -- for pages ---------------------------------------------------------------------------------------------

    def overview(self) -> browsing.Overview:
        """Return the campaign in numbers."""
        with self._database.read() as connection:
            return browsing.overview(connection)

    def pictures_page(
        self, *, start: int = 0, count: int = 100, status: str = "", words: str = ""
    ) -> browsing.Page:
        """Return some pictures by time; see `opnav_workbench.campaign.browsing.pictures_page`."""
        with self._database.read() as connection:
            return browsing.pictures_page(connection, start=start, count=count, status=status, words=words)

    def picture(self, number: int) -> dict[str, Any] | None:
        """Return a picture by its number in the archive; None where there is none."""
        with self._database.read() as connection:
            return browsing.picture(connection, number)

    def made_with(self) -> list[dict[str, Any]]:
        """Return versions, catalogs and kernels, with the pictures that were made with them."""
        with self._database.read() as connection:
            return browsing.made_with_rows(connection)

    def changes(self) -> list[dict[str, Any]]:
        """Return what was processed again, the latest first."""
        with self._database.read() as connection:
            return browsing.changes_page(connection)

    def history(self) -> list[dict[str, Any]]:
        """Return what stood before and was replaced, oldest first."""
        return self._plain("history")

    def _plain(self, what: str) -> list[dict[str, Any]]:
        with self._database.read() as connection:
            return query_plain(connection, what)

    def entries(self) -> tuple[ImageEntry, ...]:
        """Return the pictures in the order of time, for a list to choose from."""
        images = tables["images"]
        query = sa.select(images).order_by(images.c.et, images.c.image, images.c.key)
        with self._database.read() as connection:
            rows = connection.execute(query).mappings().all()
        return tuple(
            ImageEntry(
                image=row["image"],
                utc=row["utc"] or "",
                et=row["et"],
                status=row["status"],
                folder=Path(row["folder"]),
                path=None if row["path"] is None else Path(row["path"]),
                mission=row["mission"] or "",
                attention=tuple(row["attention"]),
            )
            for row in rows
        )

    def attention(self) -> tuple[ImageEntry, ...]:
        """Return the pictures that need an analyst."""
        return tuple(entry for entry in self.entries() if entry.needs_analyst)

    def dump(self) -> dict[str, list[dict[str, Any]]]:
        """Return the whole content, free of paths, times of processing and order of ingest."""
        with self._database.read() as connection:
            return content_of(connection)

    def digest(self) -> str:
        """Return the SHA-256 of `dump`: equal for archives that hold the same."""
        with self._database.read() as connection:
            return content_digest(connection)


# ---- All observables of a campaign as one file.

WRITERS: dict[str, Callable[[Sequence[Observable], Path, Sequence[Origin]], None]] = {
    "csv": write_csv,
    "json": write_observables_json,
    "tdm": write_tdm,
}
EXPORT_FORMATS = ("ecsv", *WRITERS)


def export_observables(
    campaign: Campaign, path: str | Path, format_name: str | None = None, **filters: str | None
) -> int:
    """Write the observables of a campaign, whole or not at all; return how many.

    Parameters
    ----------
    format_name : {"ecsv", "csv", "json", "tdm"}, optional
        By default the ending of `path`. ECSV holds every column that the runs' own files have.
    filters
        As of `Campaign.observables`.

    Raises
    ------
    SessionError
        An unknown format or filter, nothing to export, or the file cannot be written.
    """
    target = Path(path)
    name = (format_name or target.suffix.removeprefix(".")).lower()
    if name not in EXPORT_FORMATS:
        what = f"unknown format {name!r}" if name else "no format given"
        raise SessionError(
            f"{what}; choose --format {' | '.join(EXPORT_FORMATS)}, or a file name that ends so."
        )
    table = campaign.observables(**filters)
    if not len(table):
        raise SessionError("no observable to export; `opnav campaign query bodies` shows what there is.")
    origins = campaign.origins(table["image"])
    if name == "ecsv":
        table.meta.update(explanation(origins))
        with atomic_path(target) as temporary:
            table.write(temporary, format="ascii.ecsv", overwrite=True)
    else:
        WRITERS[name](table_observables(table), target, origins)
    return len(table)
