"""A file from the web, attempt after attempt, until it is whole and right.

While it grows the file is called NAME.part; what has arrived stays for the next attempt, in this call or in a
later one.
"""

import time
from collections.abc import Callable
from pathlib import Path

from opnav_workbench.downloads.addresses import require_web_address, web_opener
from opnav_workbench.downloads.job import Job, Opener, Progress, TryAgain
from opnav_workbench.downloads.transfer import transfer

__all__ = ["download"]

TIMEOUT_S = 60.0  # archives on tape or behind a slow link answer within this
RETRIES = 3
PAUSE_S = 1.0  # before the second attempt; twice as long before each further one


def download(
    url: str,
    path: Path,
    *,
    size: int | None = None,
    sha256: str | None = None,
    progress: Progress | None = None,
    timeout_s: float = TIMEOUT_S,
    retries: int = RETRIES,
    opener: Opener | None = None,
    check: Callable[[Path], None] | None = None,
) -> Path:
    """Fetch a file, or what is still missing of it, and return its path.

    Parameters
    ----------
    url : str
        http or https.
    path : Path
        The file; its folder is made if it is not there. An older file of that name is replaced only once the
        new one is whole and right. For names that come from outside use `opnav_workbench.files.inside`.
    size, sha256 : optional
        What the file must have; checked as far as given.
    progress : callable, optional
        Called with the bytes that are there and those in all (None: the server does not say).
    timeout_s : float
        Longest wait for an answer or for the next bytes, s.
    retries : int
        Further attempts after a cut, a silence or a passing failure of the server.
    opener : Opener, optional
        Another way to open requests.
    check : callable, optional
        Looks at the whole file before it gets its name, and raises if it is not right.

    Raises
    ------
    DownloadError
        The address is not of the web, the file is not there, the server cannot be reached or fails, the file
        has another size or digest, or it cannot be written. What has arrived is kept as ``NAME.part``, unless
        it is wrong.
    """
    require_web_address(url)
    job = Job(url, path, size, sha256, progress or _silent, timeout_s, opener or web_opener())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _fetch(job, retries)
        if check is not None:
            _look_at(job, check)
        job.part.replace(path)
        job.note.unlink(missing_ok=True)
    except OSError as error:
        raise job.disk_failure(error) from error
    return path


def _fetch(job: Job, retries: int) -> None:
    for attempt in range(retries + 1):
        resumed = job.there > 0
        try:
            transfer(job)
            if resumed and job.digest_differs():  # the part was of another version: once more from the start
                job.discard()
                transfer(job)
        except TryAgain as error:
            if attempt == retries:
                count = f" ({retries + 1} attempts)" if retries else ""
                raise job.failure(f"{error}{count}", "check the connection and try again") from error
            time.sleep(PAUSE_S * 2**attempt)
        else:
            break
    job.verify()


def _look_at(job: Job, check: Callable[[Path], None]) -> None:
    try:
        check(job.part)
    except Exception:
        job.discard()
        raise


def _silent(there: int, total: int | None) -> None:
    """Report nothing."""
