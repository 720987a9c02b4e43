"""One picture of a night in a process of its own, watched: time, memory, and what became of it.

`process_picture` takes and returns plain values, so that it runs in a thread here or on a worker elsewhere that sees the
same folders.  It writes into the picture's working folder only; the night moves that to its place.
"""

import contextlib
import errno
import json
import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import psutil

from opnav_workbench import errors
from opnav_workbench.files import write_json
from opnav_workbench.headless.outcome import failed_result
from opnav_workbench.session import RESULT_FILE

__all__ = ["EXECUTED_FILE", "HTML_FILE", "Job", "Verdict", "process_picture"]

EXECUTED_FILE, HTML_FILE, LOG_FILE = "notebook.ipynb", "notebook.html", "notebook.log"
JOB_FILE, REPORT_FILE = ".job.json", ".report.json"
RUNNER = Path(__file__).with_name("notebook_run.py")
WATCH_S = 0.2
NO_ROOM = os.strerror(errno.ENOSPC)
MB = 1 << 20
# One picture runs in one thread: that is fastest for many at once, and sums do not depend on the number of cores.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class Job:
    """A picture to process.

    Attributes
    ----------
    image, name : str
        The file, and the name of its folder.
    folder : str
        Where its working folders are made, one a try.
    notebook : str
    parameters : mapping
        Of the notebook, but ``out``: that is the working folder.
    mission : str
        For the result of a picture that fails.
    time_limit_s, memory_limit_mb : float
    retries : int
        Further tries after a fault of the machine.
    """

    image: str
    name: str
    folder: str
    notebook: str
    parameters: Mapping[str, Any]
    mission: str
    time_limit_s: float
    memory_limit_mb: float
    retries: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a picture.

    Attributes
    ----------
    name : str
    folder : str
        Working folder with what it wrote.
    fault : {"", "picture", "notebook", "limit", "machine"}
        What went wrong: nothing; the picture or its inputs; a cell of the notebook; time or memory; the machine (another try
        may succeed).
    reason : str
        One line.
    seconds, peak_mb : float
        Of the last try.
    tries : int
    """

    name: str
    folder: str
    fault: str
    reason: str
    seconds: float
    peak_mb: float
    tries: int = 1


def process_picture(values: Mapping[str, Any], stop: threading.Event | None = None) -> dict[str, Any]:
    """Execute the notebook for one picture.

    Parameters
    ----------
    values : mapping
        A `Job` as plain values.
    stop : Event, optional
        Ends the work when set.

    Returns
    -------
    dict
        A `Verdict` as plain values.  A picture that failed, with any fault, has a ``result.json`` that says why.
    """
    job, stop = Job(**values), stop or threading.Event()
    for count in range(1, job.retries + 2):
        verdict = replace(_tried(job, stop), tries=count)
        if verdict.fault != "machine" or stop.is_set():
            break
    return asdict(verdict)


def _tried(job: Job, stop: threading.Event) -> Verdict:
    started = time.monotonic()
    # Its own for every try: what a lost process may still write harms nobody.
    folder = Path(job.folder) / f"{job.name}-{uuid.uuid4().hex[:8]}"
    with _running(job, folder) as child:
        fault, reason, peak = _watched(child, job, stop)
    if not fault:
        fault, reason = _reported(folder, child.returncode)
    if fault:
        _write_failure(job, folder, reason)
    seconds = round(time.monotonic() - started, 2)
    return Verdict(job.name, str(folder), fault, reason, seconds, round(peak, 1))


@contextlib.contextmanager
def _running(job: Job, folder: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Start the notebook's process; at the end neither it nor its kernel is left."""
    task = {
        "starter": os.getpid(),
        "notebook": job.notebook,
        "executed": str(folder / EXECUTED_FILE),
        "html": str(folder / HTML_FILE),
        "report": str(folder / REPORT_FILE),
        "parameters": {**job.parameters, "out": str(folder)},
        "cwd": str(folder),
    }
    write_json(folder / JOB_FILE, task)
    with (folder / LOG_FILE).open("wb") as log:
        child = subprocess.Popen(  # noqa: S603  our own interpreter and file
            [sys.executable, "-P", str(RUNNER), str(folder / JOB_FILE)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=os.environ | ONE_THREAD,
        )
        try:
            yield child
        finally:
            _end(child.pid)
            child.wait()
            (folder / JOB_FILE).unlink(missing_ok=True)


def _watched(child: "subprocess.Popen[bytes]", job: Job, stop: threading.Event) -> tuple[str, str, float]:
    """Wait for the process; return fault, reason and the most memory (MB) that it and its kernel held."""
    deadline, peak = time.monotonic() + job.time_limit_s, 0.0
    while child.poll() is None:
        peak = max(peak, _memory_mb(child.pid))
        if peak > job.memory_limit_mb:
            return (
                "limit",
                _beyond("memory", f"{peak:.0f} MB", f"{job.memory_limit_mb:.0f} MB", "memory_limit_mb"),
                peak,
            )
        if time.monotonic() > deadline:
            return (
                "limit",
                _beyond("time", f"{job.time_limit_s:g} s", f"{job.time_limit_s:g} s", "time_limit_s"),
                peak,
            )
        if stop.wait(WATCH_S):
            return "machine", "stopped", peak
    return "", "", peak


def _beyond(what: str, used: str, limit: str, field: str) -> str:
    return f"stopped at its {what} limit ({used} of {limit}); raise {field} if such a picture needs more"


def _family(pid: int) -> list[psutil.Process]:
    try:
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _memory_mb(pid: int) -> float:
    total = 0
    for process in _family(pid):
        with contextlib.suppress(psutil.Error):
            total += process.memory_info().rss
    return total / MB


def _end(pid: int) -> None:
    for process in _family(pid):
        with contextlib.suppress(psutil.Error):
            process.kill()


def _reported(folder: Path, code: int) -> tuple[str, str]:
    """Fault and reason as the process left them."""
    try:
        report = json.loads((folder / REPORT_FILE).read_text(encoding="utf-8"))
        (folder / REPORT_FILE).unlink()
    except (OSError, ValueError):
        return (
            "machine",
            f"the notebook's process ended with status {code} before it was done (see {LOG_FILE})",
        )
    if report["ok"]:
        return "", ""
    said = " ".join(str(report["evalue"]).split())
    if report["kind"] == "machine":
        return "machine", f"{report['ename']}: {said}"
    known = getattr(errors, report["ename"], None)
    if isinstance(known, type) and issubclass(known, errors.OpNavError):
        # A full disk is no fault of the picture's; once there is room, the night goes on with it.
        return ("machine" if NO_ROOM in said else "picture"), said
    return "notebook", f"a cell raised {report['ename']}: {said} (see {EXECUTED_FILE})"


def _write_failure(job: Job, folder: Path, reason: str) -> None:
    """Leave a result that says why, in place of one that an earlier cell may have written."""
    result = failed_result(Path(job.image), job.mission, reason)
    with contextlib.suppress(errors.SessionError):  # a full disk: the night's own summary names the picture
        write_json(folder / RESULT_FILE, result)
