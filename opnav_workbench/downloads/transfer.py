"""One attempt to fetch a file, or what is still missing of it.

Source: RFC 9110, sections 13.1.5 (If-Range), 14.2 (Range), 15.3.7 (206 Partial Content) and 15.5.17 (416).
"""

import http.client
import shutil
import time
import urllib.error
import urllib.request
from typing import Any
from urllib.parse import urlsplit

from opnav_workbench.downloads.job import Job, TryAgain
from opnav_workbench.version import __version__

__all__ = ["transfer"]

CHUNK_BYTES = 1 << 16
SLOWEST_BYTES = 1024  # that must arrive in every `timeout_s`; a server that drips less is as good as silent
SPARE_BYTES = 1 << 20  # of free disk beside what is fetched
OK, PARTIAL = 200, 206
RANGE_NOT_SATISFIABLE = 416
PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})  # statuses that another attempt may cure
MISSING = frozenset({404, 410})


def transfer(job: Job) -> None:
    """Bring the partial file to its full length.

    Raises
    ------
    TryAgain
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
        raise TryAgain(_network_text(job, error.reason)) from error
    except (OSError, http.client.HTTPException) as error:
        raise TryAgain(_network_text(job, error)) from error
    with response:
        _receive(job, response, offset)


def _request(job: Job, offset: int) -> urllib.request.Request:
    headers = {"User-Agent": f"opnav_workbench/{__version__}", "Accept-Encoding": "identity"}
    if offset:
        headers["Range"] = f"bytes={offset}-"
        if job.validator:
            headers["If-Range"] = job.validator  # a file that has changed comes whole
    return urllib.request.Request(job.url, headers=headers)  # noqa: S310 (its scheme is checked on entry)


def _receive(job: Job, response: Any, offset: int) -> None:
    if response.status == PARTIAL and _range_start(response) == offset:
        start = offset
    elif response.status == OK:
        start = 0  # the server knows no ranges, or the file has changed
    else:
        job.discard()
        raise TryAgain(f"the server sent another part of the file (status {response.status})")
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


def _write_body(job: Job, response: Any, start: int, total: int | None) -> None:
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
                    raise TryAgain(f"only {there - mark} bytes came in {job.timeout_s:g} s")
                mark, deadline = there, time.monotonic() + job.timeout_s
    if total is not None and there > total:
        job.discard()
        raise job.failure(
            f"it is larger than the {total} bytes expected", "see whether there is a new version"
        )
    if total is not None and there < total:
        raise TryAgain(f"the connection was cut after {there} of {total} bytes")


def _next_bytes(job: Job, response: Any) -> bytes:
    try:
        return bytes(response.read1(CHUNK_BYTES))
    except (OSError, http.client.HTTPException) as error:
        raise TryAgain(_network_text(job, error)) from error


def _refused(job: Job, error: urllib.error.HTTPError, offset: int) -> None:
    """Deal with a status that is no success; only a part that was the whole file already may pass."""
    reason = f"the server answers {error.code} {error.reason}"
    if error.code == RANGE_NOT_SATISFIABLE and offset:
        if _whole_number(str(error.headers.get("Content-Range", "")).rpartition("/")[2]) == offset:
            return
        job.discard()
        raise TryAgain("what had arrived is no part of the server's file") from error
    if error.code in MISSING:
        raise job.failure(reason, "its archive may have moved it: look at the folder it was in") from error
    if error.code in PASSING:
        raise TryAgain(reason) from error
    raise job.failure(reason, "check the address, and whether it needs an account") from error


def _require_room(job: Job, start: int, total: int | None) -> None:
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


def _network_text(job: Job, reason: object) -> str:
    if isinstance(reason, TimeoutError):
        return f"no answer for {job.timeout_s:g} s"
    words = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
    return f"the connection to {urlsplit(job.url).netloc} failed ({words})"
