"""A night's campaign archive: a damaged one is put aside and made anew from the folders of the pictures."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from opnav_workbench.campaign import ARCHIVE_FILE, ArchiveBusy, ArchiveDamaged, Campaign, KnownRun, find_runs
from opnav_workbench.errors import OpNavError, SessionError

__all__ = ["NightArchive"]

BESIDE = ("", "-wal", "-shm", "-journal")  # an SQLite file, and what belongs to it


class NightArchive:
    """The archive that a night fills, open as long as the block.

    Parameters
    ----------
    out
        Folder of the pictures' folders.
    path
        Default ``OUT/campaign.sqlite``.
    say
        Told what was put aside.

    Raises
    ------
    SessionError
        It is another program's or a newer version's, or cannot be written.
    """

    def __init__(self, out: Path, path: Path | None, say: Callable[[str], None]) -> None:
        self._out, self._path, self._say = out, path or out / ARCHIVE_FILE, say
        self._late: list[Path] = []
        if self._path.is_dir():
            self._path /= ARCHIVE_FILE
        self._known: dict[str, KnownRun] = {}
        self._campaign = self._opened()

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def _opened(self) -> Campaign:
        try:
            campaign = Campaign(self._path)
        except ArchiveDamaged as error:
            return self._made_anew(error)
        try:
            self._known = campaign.known_runs()  # at once: read one by one, 100,000 take minutes
        except ArchiveDamaged as error:
            campaign.close()
            return self._made_anew(error)
        except SessionError:  # each picture says it, and is read
            pass
        return campaign

    def _made_anew(self, error: OpNavError) -> Campaign:
        ending = f".damaged-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
        self._known = {}
        for end in BESIDE:
            file = self._path.with_name(self._path.name + end)
            if file.exists():
                file.rename(file.with_name(file.name + ending))
        campaign = Campaign(self._path)
        count = 0
        try:
            for folder in find_runs(self._out):
                count += campaign.ingest_run(folder).result != "skipped"
        except SessionError:  # no run in it yet
            pass
        self._say(
            f"the archive was damaged ({error}); it is kept as {self._path.name}{ending}, and {self._path.name} was made "
            f"anew from {count} folders in {self._out}. Runs elsewhere: opnav campaign ingest them."
        )
        return campaign

    def take(self, folder: Path) -> str:
        """Take a picture's folder in; return why not, empty where it was, or waits for `take_late`."""
        if self._late:  # the next minute would be lost as the last one was
            self._late.append(folder)
            return ""
        try:
            return self._taken(folder)
        except ArchiveBusy:
            self._late.append(folder)
            return ""

    def take_late(self) -> Iterator[tuple[Path, str]]:
        """Take in what had to wait, as another program wrote into the archive; yield what is not, and why.

        One that is busy still is waited for once: the next night finds the pictures in their folders.
        """
        late, busy = self._late, ""
        self._late = []
        for folder in late:
            try:
                reason = busy or self._taken(folder)
            except ArchiveBusy as error:
                reason = busy = str(error)
            if reason:
                yield folder, reason
        if not busy:
            self._campaign.keep_readings()

    def _taken(self, folder: Path) -> str:
        try:
            try:
                taken = self._campaign.ingest_run(folder, self._known)
            except ArchiveDamaged as error:
                self._campaign.close()
                self._campaign = self._made_anew(error)
                taken = self._campaign.ingest_run(folder)
        except ArchiveBusy:
            raise
        except OpNavError as error:
            return str(error)
        return taken.reason if taken.result == "skipped" else ""

    def __enter__(self) -> "NightArchive":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._campaign.close()
