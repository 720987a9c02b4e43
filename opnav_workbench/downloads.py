"""Files fetched over http and https: resumed after a cut, checked for size and SHA-256, whole or not there.

Attempt follows attempt until the file is whole and right. While it grows it is called NAME.part; what has arrived stays
for the next attempt, in this call or in a later one. Beside it NAME.part.json holds the server's mark of the version,
so that one file is never made of two. Only web addresses are opened, also after redirects, which never lead from https
back to http.

Source: RFC 9110, sections 13.1.5 (If-Range), 14.2 (Range), 15.3.7 (206 Partial Content) and 15.5.17 (416).
"""

import errno
import http.client
import json
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit
from urllib.request import Request

from opnav_workbench.errors import DownloadError
from opnav_workbench.files import json_value, sha256_of, text_of
from opnav_workbench.version import __version__

__all__ = ["Opener", "Progress", "download", "require_web_address"]


# ---- Which addresses may be opened: those of the web, also after redirects.

SCHEMES = ("http", "https")


def require_web_address(url: str) -> None:
    """Raise DownloadError unless an address begins with http or https and names a server.

    Examples
    --------
    >>> require_web_address("file:///etc/passwd")
    Traceback (most recent call last):
    opnav_workbench.errors.DownloadError: 'file:///etc/passwd' is no web address; give one with http or https.
    """
    parts = urlsplit(url)
    if parts.scheme.lower() not in SCHEMES or not parts.hostname:
        raise DownloadError(f"{url!r} is no web address; give one with http or https.")


class _WebRedirects(urllib.request.HTTPRedirectHandler):
    """Redirects stay on the web, and never lead from https back to http."""

    def redirect_request(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        require_web_address(newurl)
        if req.full_url.startswith("https:") and not newurl.startswith("https:"):
            raise DownloadError(
                f"{req.full_url} redirects to {newurl}, which is not encrypted; fetch it by hand."
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def web_opener() -> urllib.request.OpenerDirector:
    """Return an opener for web addresses, with the proxies of the environment."""
    return urllib.request.build_opener(_WebRedirects)


# ---- One file to fetch: what it must be, what of it is there already, and the words when it cannot be had.

Progress = Callable[[int, int | None], None]  # bytes there, bytes in all (None: unknown)


class Opener(Protocol):
    """What opens a request; `urllib.request.OpenerDirector` does."""

    def open(self, fullurl: Request, data: None = None, timeout: float | None = None) -> Any:
        """Return the response."""


class TransientError(Exception):
    """An attempt failed in a way that the next may not."""


@dataclass(frozen=True, slots=True)
class RemoteFile:
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
            note = json_value(text_of(self.note))
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


# ---- One attempt to fetch a file, or what is still missing of it.

CHUNK_BYTES = 1 << 16
SLOWEST_BYTES = 1024  # that must arrive in every `timeout_s`; a server that drips less is as good as silent
SPARE_BYTES = 1 << 20  # of free disk beside what is fetched
OK, PARTIAL = 200, 206
RANGE_NOT_SATISFIABLE = 416
TRANSIENT_STATUSES = frozenset({408, 425, 429, 500, 502, 503, 504})  # statuses that another attempt may cure
MISSING_STATUSES = frozenset({404, 410})


def transfer(job: RemoteFile) -> None:
    """Bring the partial file to its full length.

    Raises
    ------
    TransientError
        The connection failed, was cut or fell silent, or the server has a passing trouble.
    DownloadError
        The file is not to be had.
    OSError
        It cannot be written.
    """
    offset = job.resume_offset()
    if job.size is not None and offset == job.size:
        return
    try:
        response = job.opener.open(_request(job, offset), timeout=job.timeout_s)
    except urllib.error.HTTPError as error:
        with error:
            _refused(job, error, offset)
        return
    except urllib.error.URLError as error:
        raise TransientError(_network_text(job, error.reason)) from error
    except (OSError, http.client.HTTPException) as error:
        raise TransientError(_network_text(job, error)) from error
    with response:
        _receive(job, response, offset)


def _request(job: RemoteFile, offset: int) -> urllib.request.Request:
    headers = {"User-Agent": f"opnav_workbench/{__version__}", "Accept-Encoding": "identity"}
    if offset:
        headers["Range"] = f"bytes={offset}-"
        if job.validator:
            headers["If-Range"] = job.validator  # a file that has changed comes whole
    return urllib.request.Request(job.url, headers=headers)  # noqa: S310 (its scheme is checked on entry)


def _receive(job: RemoteFile, response: Any, offset: int) -> None:
    if response.status == PARTIAL and _range_start(response) == offset:
        start = offset
    elif response.status == OK:
        start = 0  # the server knows no ranges, or the file has changed
    else:
        job.discard()
        raise TransientError(f"the server sent another part of the file (status {response.status})")
    length = _whole_number(response.headers.get("Content-Length"))
    total = job.size if length is None else start + length
    if job.size is not None and total != job.size:
        job.discard()
        raise job.failure(
            f"the server's file has {total} bytes, {job.size} are expected",
            "see whether its archive has announced a new version",
        )
    _require_room(job, start, total)
    validator = response.headers.get("ETag") or response.headers.get("Last-Modified") or ""
    job.remember("" if validator.startswith("W/") else validator)  # a weak mark cannot vouch for bytes
    _write_body(job, response, start, total)


def _write_body(job: RemoteFile, response: Any, start: int, total: int | None) -> None:
    there, mark, deadline = start, start, time.monotonic() + job.timeout_s
    with job.part.open("r+b" if start else "wb") as stream:
        stream.seek(start)
        stream.truncate()
        job.progress(there, total)
        while (total is None or there <= total) and (chunk := _next_bytes(job, response)):
            stream.write(chunk)
            there += len(chunk)
            job.progress(there, total)
            if time.monotonic() > deadline:
                if there - mark < SLOWEST_BYTES:
                    raise TransientError(f"only {there - mark} bytes came in {job.timeout_s:g} s")
                mark, deadline = there, time.monotonic() + job.timeout_s
    if total is not None and there > total:
        job.discard()
        raise job.failure(
            f"it is larger than the {total} bytes expected", "see whether there is a new version"
        )
    if total is not None and there < total:
        raise TransientError(f"the connection was cut after {there} of {total} bytes")


def _next_bytes(job: RemoteFile, response: Any) -> bytes:
    try:
        return bytes(response.read1(CHUNK_BYTES))
    except (OSError, http.client.HTTPException) as error:
        raise TransientError(_network_text(job, error)) from error


def _refused(job: RemoteFile, error: urllib.error.HTTPError, offset: int) -> None:
    """Deal with a status that is no success; only a part that was the whole file already may pass."""
    reason = f"the server answers {error.code} {error.reason}"
    if error.code == RANGE_NOT_SATISFIABLE and offset:
        if _whole_number(str(error.headers.get("Content-Range", "")).rpartition("/")[2]) == offset:
            return
        job.discard()
        raise TransientError("what had arrived is no part of the server's file") from error
    if error.code in MISSING_STATUSES:
        raise job.failure(reason, "its archive may have moved it: look at the folder it was in") from error
    if error.code in TRANSIENT_STATUSES:
        raise TransientError(reason) from error
    raise job.failure(reason, "check the address, and whether it needs an account") from error


def _require_room(job: RemoteFile, start: int, total: int | None) -> None:
    free = shutil.disk_usage(job.path.parent).free
    if total is not None and total - start + SPARE_BYTES > free:
        raise job.failure(
            f"it needs {total - start} more bytes, the disk of {job.path.parent} has {free} free",
            "free some space or choose another folder",
        )


def _range_start(response: Any) -> int | None:
    """Return the first byte that a 206 answer holds: ``Content-Range: bytes 100-199/200``."""
    header = str(response.headers.get("Content-Range", ""))
    return _whole_number(header.removeprefix("bytes ").partition("-")[0])


def _whole_number(text: str | None) -> int | None:
    return int(text) if text is not None and text.isdecimal() else None


def _network_text(job: RemoteFile, reason: object) -> str:
    if isinstance(reason, TimeoutError):
        return f"no answer for {job.timeout_s:g} s"
    words = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
    return f"the connection to {urlsplit(job.url).netloc} failed ({words})"


# ---- A file from the web, attempt after attempt, until it is whole and right.

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
    url
        http or https.
    path
        The file; its folder is made if it is not there. An older file of that name is replaced only once the
        new one is whole and right. For names that come from outside use `opnav_workbench.files.inside`.
    size, sha256
        What the file must have; checked as far as given.
    progress : callable, optional
        Called with the bytes that are there and those in all (None: the server does not say).
    timeout_s
        Longest wait for an answer or for the next bytes, s.
    retries
        Further attempts after a cut, a silence or a passing failure of the server.
    opener
        Another way to open requests.
    check
        Looks at the whole file before it gets its name, and raises if it is not right.

    Raises
    ------
    DownloadError
        The address is not of the web, the file is not there, the server cannot be reached or fails, the file
        has another size or digest, or it cannot be written. What has arrived is kept as ``NAME.part``, unless
        it is wrong.
    """
    require_web_address(url)
    job = RemoteFile(url, path, size, sha256, progress or _no_progress, timeout_s, opener or web_opener())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _fetch_with_retries(job, retries)
        if check is not None:
            _apply_check(job, check)
        job.part.replace(path)
        job.note.unlink(missing_ok=True)
    except OSError as error:
        raise job.disk_failure(error) from error
    return path


def _fetch_with_retries(job: RemoteFile, retries: int) -> None:
    for attempt in range(retries + 1):
        resumed = job.there > 0
        try:
            transfer(job)
            if resumed and job.digest_differs():  # the part was of another version: once more from the start
                job.discard()
                transfer(job)
        except TransientError as error:
            if attempt == retries:
                count = f" ({retries + 1} attempts)" if retries else ""
                raise job.failure(f"{error}{count}", "check the connection and try again") from error
            time.sleep(PAUSE_S * 2**attempt)
        else:
            break
    job.verify()


def _apply_check(job: RemoteFile, check: Callable[[Path], None]) -> None:
    try:
        check(job.part)
    except Exception:
        job.discard()
        raise


def _no_progress(there: int, total: int | None) -> None:
    """Report nothing."""
