"""One file to fetch: what it must be, what of it is there already, and the words when it cannot be had."""

import errno
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from urllib.request import Request

from opnav_workbench.errors import DownloadError
from opnav_workbench.files import sha256_of

__all__ = ["Job", "Opener", "Progress", "TryAgain"]

Progress = Callable[[int, int | None], None]  # bytes there, bytes in all (None: unknown)


class Opener(Protocol):
    """What opens a request; `urllib.request.OpenerDirector` does."""

    def open(self, fullurl: Request, data: None = None, timeout: float | None = None) -> Any:
        """Return the response."""


class TryAgain(Exception):  # noqa: N818 (no failure yet)
    """An attempt failed in a way that the next may not."""


@dataclass(frozen=True, slots=True)
class Job:
    """A file to fetch."""

    url: str
    path: Path
    size: int | None
    sha256: str | None
    progress: Progress
    timeout_s: float
    opener: Opener

    @property
    def part(self) -> Path:
        """The partial file."""
        return self.path.with_name(self.path.name + ".part")

    @property
    def note(self) -> Path:
        """Where the partial file comes from, so that one file is never made of two."""
        return self.path.with_name(self.path.name + ".part.json")

    @property
    def there(self) -> int:
        """Bytes of the partial file."""
        return self.part.stat().st_size if self.part.exists() else 0

    @property
    def validator(self) -> str:
        """The server's mark of the file that the partial one belongs to; empty if there is none."""
        try:
            note = json.loads(self.note.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return ""
        same = isinstance(note, dict) and note.get("url") == self.url
        return str(note.get("validator") or "") if same else ""

    def remember(self, validator: str) -> None:
        """Keep the server's mark beside the partial file."""
        self.note.write_text(json.dumps({"url": self.url, "validator": validator}), encoding="utf-8")

    def resume_offset(self) -> int:
        """Return where to go on: only in a file that its digest, or the server's mark, tells to be the same."""
        there = self.there
        sure = self.sha256 is not None or bool(self.validator)
        if there and sure and not (self.size is not None and there > self.size):
            return there
        self.discard()
        return 0

    def discard(self) -> None:
        """Remove what has arrived."""
        self.part.unlink(missing_ok=True)
        self.note.unlink(missing_ok=True)

    def digest_differs(self) -> bool:
        """Tell whether what has arrived is not what is wanted, as far as its digest is known."""
        return self.sha256 is not None and sha256_of(self.part) != self.sha256.lower()

    def verify(self) -> None:
        """Raise DownloadError, and throw away what has arrived, unless its size and digest are right."""
        there = self.there
        if self.size is not None and there != self.size:
            self.discard()
            raise self.failure(
                f"it has {there} bytes, {self.size} are expected", "see whether there is a new version"
            )
        if self.digest_differs():
            found = sha256_of(self.part)
            self.discard()
            raise self.failure(
                f"its SHA-256 is {found}, expected is {self.sha256}; it was thrown away",
                "try again, or see whether its archive has announced a new version",
            )

    def failure(self, reason: str, remedy: str) -> DownloadError:
        """Return the error for a file that cannot be had."""
        kept = f" {self.there} bytes are kept; the next attempt goes on there." if self.there else ""
        return DownloadError(f"cannot fetch {self.url}: {reason}; {remedy}.{kept}")

    def disk_failure(self, error: OSError) -> DownloadError:
        """Return the error for a file that cannot be written."""
        reason = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
        return DownloadError(
            f"cannot write {self.path}: {reason}. Free some space or choose another folder, and try again; "
            "what has arrived is kept."
        )
