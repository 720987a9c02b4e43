"""The pictures of a night processed several at a time, each in a process of its own, watched.

`process_picture` takes and returns plain values, so that it runs in a thread here or on a worker of a Dask cluster that
sees the same folders.  It bounds time and memory, tells a fault of the picture from one of the notebook or the machine,
and writes into the picture's working folder only; the night moves that to its place.
"""

import contextlib
import importlib
import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import psutil

from opnav_workbench import errors
from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_value, text_of, write_json
from opnav_workbench.headless.faults import FAULTS, fault_of_report
from opnav_workbench.parts import install_command
from opnav_workbench.processing.pictures import failed_result
from opnav_workbench.session import RESULT_FILE

__all__ = [
    "EXECUTED_FILE",
    "HTML_FILE",
    "ClusterPool",
    "LocalPool",
    "NightPool",
    "NotebookOutcome",
    "NotebookRequest",
]


# ---- One picture of a night in a process of its own, watched: time, memory, and what became of it.

EXECUTED_FILE, HTML_FILE, LOG_FILE = "notebook.ipynb", "notebook.html", "notebook.log"
JOB_FILE, REPORT_FILE = ".job.json", ".report.json"
RUNNER = Path(__file__).with_name("notebook_run.py")
WATCH_INTERVAL_S = 0.2
MB = 1 << 20
# One picture runs in one thread: that is fastest for many at once, and sums do not depend on the number of cores.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class NotebookRequest:
    """A picture to process.

    Attributes
    ----------
    image, name
        The file, and the name of its folder.
    folder
        Where its working folders are made, one a try.
    parameters
        Of the notebook, but ``out``: that is the working folder.
    mission
        For the result of a picture that fails.
    retries
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
class NotebookOutcome:
    """What became of a picture.

    Attributes
    ----------
    folder
        Working folder with what it wrote.
    fault : {"", "picture", "notebook", "limit", "machine"}
        What went wrong: nothing; the picture or its inputs; a cell of the notebook; time or memory; the machine. What is
        done about it: `opnav_workbench.headless.faults`.
    reason
        One line.
    seconds, peak_mb
        Of the last try.
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
    values
        A `NotebookRequest` as plain values.
    stop
        Ends the work when set.

    Returns
    -------
    dict
        A `NotebookOutcome` as plain values. A picture that failed by its own fault has a ``result.json`` that says why.
    """
    job, stop = NotebookRequest(**values), stop or threading.Event()
    for count in range(1, job.retries + 2):
        verdict = replace(_one_try(job, stop), tries=count)
        if not FAULTS[verdict.fault].again_at_once or stop.is_set():
            break
    return asdict(verdict)


def _one_try(job: NotebookRequest, stop: threading.Event) -> NotebookOutcome:
    started = time.monotonic()
    # Its own for every try: what a lost process may still write harms nobody.
    folder = Path(job.folder) / f"{job.name}-{uuid.uuid4().hex[:8]}"
    with _running(job, folder) as child:
        fault, reason, peak = _watch(child, job, stop)
    if not fault:
        fault, reason = _read_report(folder, child.returncode)
    if fault and FAULTS[fault].is_result:
        _write_failure(job, folder, reason)
    seconds = round(time.monotonic() - started, 2)
    return NotebookOutcome(job.name, str(folder), fault, reason, seconds, round(peak, 1))


@contextlib.contextmanager
def _running(job: NotebookRequest, folder: Path) -> Iterator["subprocess.Popen[bytes]"]:
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
            _kill_family(child.pid)
            child.wait()
            (folder / JOB_FILE).unlink(missing_ok=True)


def _watch(
    child: "subprocess.Popen[bytes]", job: NotebookRequest, stop: threading.Event
) -> tuple[str, str, float]:
    """Wait for the process; return fault, reason and the most memory (MB) that it and its kernel held."""
    deadline, peak = time.monotonic() + job.time_limit_s, 0.0
    while child.poll() is None:
        peak = max(peak, _memory_mb(child.pid))
        if peak > job.memory_limit_mb:
            return (
                "limit",
                _limit_reason("memory", f"{peak:.0f} MB", f"{job.memory_limit_mb:.0f} MB", "memory_limit_mb"),
                peak,
            )
        if time.monotonic() > deadline:
            return (
                "limit",
                _limit_reason("time", f"{job.time_limit_s:g} s", f"{job.time_limit_s:g} s", "time_limit_s"),
                peak,
            )
        if stop.wait(WATCH_INTERVAL_S):
            return "machine", "stopped", peak
    return "", "", peak


def _limit_reason(what: str, used: str, limit: str, field: str) -> str:
    return f"stopped at its {what} limit ({used} of {limit}); raise {field} if such a picture needs more"


def _process_family(pid: int) -> list[psutil.Process]:
    try:
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _memory_mb(pid: int) -> float:
    total = 0
    for process in _process_family(pid):
        with contextlib.suppress(psutil.Error):
            total += process.memory_info().rss
    return total / MB


def _kill_family(pid: int) -> None:
    for process in _process_family(pid):
        with contextlib.suppress(psutil.Error):
            process.kill()


def _read_report(folder: Path, code: int) -> tuple[str, str]:
    """Fault and reason as the process left them."""
    try:
        report = json_value(text_of(folder / REPORT_FILE))
        (folder / REPORT_FILE).unlink()
    except (OSError, ValueError):
        return (
            "machine",
            f"the notebook's process ended with status {code} before it was done (see {LOG_FILE})",
        )
    return fault_of_report(report, EXECUTED_FILE)


def _write_failure(job: NotebookRequest, folder: Path, reason: str) -> None:
    """Leave a result that says why, in place of one that an earlier cell may have written."""
    result = failed_result(Path(job.image), job.mission, reason)
    with contextlib.suppress(errors.SessionError):  # a full disk: the night's own summary names the picture
        write_json(folder / RESULT_FILE, result)


# ---- Where the pictures of a night are processed: on this machine, or on a Dask cluster that stands already.

CONNECT_S = 10
WORKER_CHECK_S = 5.0


class NightPool(Protocol):
    """Processes pictures, several at a time."""

    def run(self, jobs: Sequence[NotebookRequest]) -> Generator[NotebookOutcome, None, None]:
        """Yield the verdicts as they come; closing the iterator stops what is running."""
        ...


class LocalPool:
    """Processes of this machine.

    Parameters
    ----------
    count
        Pictures at a time.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise SessionError(f"{count} jobs at a time; give at least 1.")
        self._count = count

    def run(self, jobs: Sequence[NotebookRequest]) -> Generator[NotebookOutcome, None, None]:
        """Yield the verdicts as they come; closing the iterator stops what is running."""
        stop = threading.Event()
        with ThreadPoolExecutor(self._count) as threads:
            futures = [threads.submit(process_picture, job.to_dict(), stop) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield NotebookOutcome(**future.result())
            finally:
                stop.set()
                for future in futures:
                    future.cancel()


class ClusterPool:
    """Workers of a Dask cluster, which must see the same folders; a worker that dies is replaced by another.

    Parameters
    ----------
    address
        Of the scheduler.
    notice
        Told when no worker is there: pictures wait for one.

    Raises
    ------
    SessionError
        Dask is not installed, or the scheduler does not answer.
    """

    def __init__(self, address: str, notice: Callable[[str], None] = lambda _: None) -> None:
        self._address, self._notice = address, notice
        try:
            distributed: Any = importlib.import_module("distributed")  # an optional part
        except ImportError as error:
            raise SessionError(f"a cluster needs Dask: {install_command('cluster')}.") from error
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise SessionError(
                f"no Dask scheduler answers at {address} ({error}); start one with: dask scheduler."
            ) from error
        self._as_completed = distributed.as_completed

    def run(self, jobs: Sequence[NotebookRequest]) -> Generator[NotebookOutcome, None, None]:
        """Yield the verdicts as they come; closing the iterator drops what has not begun."""
        futures = {
            self._client.submit(process_picture, job.to_dict(), pure=False, retries=job.retries): job
            for job in jobs
        }
        done = threading.Event()
        threading.Thread(target=self._watch_workers, args=(done,), daemon=True).start()
        try:
            for future in self._as_completed(list(futures)):
                error = future.exception()
                if error is None:
                    yield NotebookOutcome(**future.result())
                else:
                    name = futures[future].name
                    yield NotebookOutcome(
                        name,
                        "",
                        "machine",
                        f"its worker was lost ({type(error).__name__}: {error})",
                        0.0,
                        0.0,
                    )
        finally:
            done.set()
            self._client.cancel(list(futures))
            self._client.close()

    def _watch_workers(self, done: threading.Event) -> None:
        """Say when the cluster loses its last worker, or never had one, and when it has one again."""
        idle, waited = False, 0.0
        while not done.wait(waited):
            waited = WORKER_CHECK_S
            with contextlib.suppress(Exception):  # the client is being closed
                if idle != (not self._client.nthreads()):
                    idle = not idle
                    self._notice(
                        f"no worker is connected to {self._address}: pictures wait; start one: dask worker {self._address}"
                        if idle
                        else f"a worker is connected to {self._address}"
                    )
