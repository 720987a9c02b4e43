"""The pictures of a night processed several at a time, each in a process of its own, watched.

How such a process begins is the matter of `opnav_workbench.headless.starting`.  `process_picture` takes and returns plain
values, so that it runs in a thread here or on a worker of a Dask cluster that sees the same folders.  It bounds time and
memory, tells a fault of the picture from one of the notebook or the machine, and writes into the picture's working folder
only; the night moves that to its place.
"""

import contextlib
import importlib
import os
import subprocess
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
from opnav_workbench.files import fitting_name, json_value, text_of, write_json
from opnav_workbench.headless.faults import FAULTS, fault_of_report
from opnav_workbench.headless.starting import (
    Child,
    ColdStarter,
    Starter,
    WarmStarter,
    starter_of_this_process,
)
from opnav_workbench.headless.warm_server import WarmServerError, can_fork
from opnav_workbench.headless.worker_check import unfit_because, what_to_ask
from opnav_workbench.parts import install_command
from opnav_workbench.processing.pictures import failed_result
from opnav_workbench.session import RESULT_FILE
from opnav_workbench.supervised import cause_of_end

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
WATCH_INTERVAL_S = 0.2
ASLEEP_S = 2.0  # between two looks: more than a loaded machine needs, less than limits are long
END_S = 60.0  # after SIGKILL, which a hanging file server puts off
MB = 1 << 20


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
    pages : {"flagged", "all", "none"}
        Which notebooks are written as HTML, too.
    warm
        Whether its process may be a copy of one that has loaded everything.
    contents
        Digest of what `parameters` stand for: what a process has loaded serves as long as it is the same.
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
    pages: str = "flagged"
    warm: bool = True
    contents: str = ""

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


def process_picture(
    values: Mapping[str, Any], stop: threading.Event | None = None, starter: Starter | None = None
) -> dict[str, Any]:
    """Execute the notebook for one picture.

    Parameters
    ----------
    values
        A `NotebookRequest` as plain values.
    stop
        Ends the work when set.
    starter
        Default: one that this process keeps, as a cluster's worker needs it.

    Returns
    -------
    dict
        A `NotebookOutcome` as plain values. A picture that failed by its own fault has a ``result.json`` that says why.
    """
    job, stop = NotebookRequest(**values), stop or threading.Event()
    starter = starter or starter_of_this_process(warm=job.warm)
    for count in range(1, job.retries + 2):
        verdict = replace(_one_try(job, stop, starter), tries=count)
        if not FAULTS[verdict.fault].again_at_once or stop.is_set():
            break
    return asdict(verdict)


def _one_try(job: NotebookRequest, stop: threading.Event, starter: Starter) -> NotebookOutcome:
    # Its own for every try: what a lost process may still write harms nobody.
    folder = Path(job.folder) / fitting_name(job.name, f"-{uuid.uuid4().hex[:8]}")
    try:
        with _running(job, folder, starter) as child:
            started = time.monotonic()
            fault, reason, peak = _watch(child, job, folder / REPORT_FILE, stop)
    except WarmServerError as error:
        return NotebookOutcome(job.name, str(folder), "machine", str(error), 0.0, 0.0)
    if not fault:
        fault, reason = _read_report(folder, child.returncode)
    if not fault and (folder / EXECUTED_FILE).is_file() and not (folder / RESULT_FILE).is_file():
        fault, reason = "notebook", f"the notebook wrote no {RESULT_FILE}"
    if fault and FAULTS[fault].is_result:
        _write_failure(job, folder, reason)
    seconds = round(time.monotonic() - started, 2)
    return NotebookOutcome(job.name, str(folder), fault, reason, seconds, round(peak, 1))


@contextlib.contextmanager
def _running(job: NotebookRequest, folder: Path, starter: Starter) -> Iterator[Child]:
    """Start the notebook's process; at the end neither it nor its kernel is left."""
    task = {
        "starter": os.getpid(),
        "notebook": job.notebook,
        "executed": str(folder / EXECUTED_FILE),
        "html": str(folder / HTML_FILE),
        "pages": job.pages,
        "result": str(folder / RESULT_FILE),
        "log": str(folder / LOG_FILE),
        "report": str(folder / REPORT_FILE),
        "parameters": {**job.parameters, "out": str(folder)},
        "cwd": str(folder),
    }
    write_json(folder / JOB_FILE, task)
    # A worker of a cluster lives for many nights: a file of the same name may have other contents in the next.
    loaded = {**job.parameters, "contents": job.contents}
    child = starter.start(folder / JOB_FILE, loaded, folder / LOG_FILE)
    try:
        yield child
    finally:
        if child.poll() is None:  # else its number may be another's by now
            _kill_family(child.pid)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(END_S)
        (folder / JOB_FILE).unlink(missing_ok=True)


def _watch(child: Child, job: NotebookRequest, report: Path, stop: threading.Event) -> tuple[str, str, float]:
    """Wait for the process; return fault, reason and the most memory (MB) that it and its kernel held."""
    now, peak = time.monotonic(), 0.0
    deadline = now + job.time_limit_s
    while child.poll() is None:
        before, now = now, time.monotonic()
        # All of us were stopped meanwhile, or the machine slept.
        deadline += max(now - before - ASLEEP_S, 0.0)
        peak = max(peak, _memory_mb(child.pid))
        if peak > job.memory_limit_mb:
            return (
                "limit",
                _limit_reason("memory", f"{peak:.0f} MB", f"{job.memory_limit_mb:.0f} MB", "memory_limit_mb"),
                peak,
            )
        if now > deadline and report.is_file():
            break  # it is done, and only its end is not known yet
        if now > deadline and _is_suspended(child.pid):
            return "machine", "its process was suspended, and not continued within the time limit", peak
        if now > deadline:
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


def _is_suspended(pid: int) -> bool:
    with contextlib.suppress(psutil.Error):
        return any(process.status() == psutil.STATUS_STOPPED for process in _process_family(pid))
    return False


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
            f"the notebook's process ended ({cause_of_end(code)}) before it was done (see {LOG_FILE})",
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
UNFIT_PAUSE_S = 2.0  # others are faster to take what an unfit worker hands back


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
    warm
        Whether their processes are copies of one that has loaded everything, where that is possible.
    notice
        Told why they are not after all.
    """

    def __init__(
        self, count: int, *, warm: bool = True, notice: Callable[[str], None] = lambda _: None
    ) -> None:
        if count < 1:
            raise SessionError(f"{count} jobs at a time; give at least 1.")
        self._count = count
        self._warm, self._notice = warm and can_fork(), notice

    def run(self, jobs: Sequence[NotebookRequest]) -> Generator[NotebookOutcome, None, None]:
        """Yield the verdicts as they come; closing the iterator stops what is running."""
        stop = threading.Event()
        starter: Starter = WarmStarter(self._notice) if self._warm else ColdStarter()
        with ThreadPoolExecutor(self._count) as threads:
            futures = [threads.submit(process_picture, job.to_dict(), stop, starter) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield NotebookOutcome(**future.result())
            finally:
                stop.set()
                for future in futures:
                    future.cancel()
                starter.close()


_ASKED: dict[str, str] = {}  # of a worker: why it is not fit for a night, by the night's word


def work_if_fit(
    work: Callable[[Mapping[str, Any]], dict[str, Any]], values: Mapping[str, Any], asked: Mapping[str, Any]
) -> dict[str, Any]:
    """Do a picture on a worker that may have come after the night began; one that is not fit hands it back."""
    if asked["word"] not in _ASKED:
        _ASKED[asked["word"]] = unfit_because(asked)
    if _ASKED[asked["word"]]:
        time.sleep(UNFIT_PAUSE_S)
        distributed: Any = importlib.import_module("distributed")
        raise distributed.Reschedule(_ASKED[asked["word"]])
    return work(values)


class ClusterPool:
    """Workers of a Dask cluster, which must see the same folders; a worker that dies is replaced by another.

    Each is asked first whether it can do the night's pictures; one that cannot is named and given none.

    Parameters
    ----------
    address
        Of the scheduler.
    notice
        Told of workers that are not fit, and when none is there: pictures wait for one.
    work
        What is done with a picture; takes and returns what `process_picture` does.

    Raises
    ------
    SessionError
        Dask is not installed, or the scheduler does not answer.
    """

    def __init__(
        self,
        address: str,
        notice: Callable[[str], None] = lambda _: None,
        work: Callable[[Mapping[str, Any]], dict[str, Any]] = process_picture,
    ) -> None:
        self._address, self._notice, self._work = address, notice, work
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
        """Yield the verdicts as they come; closing the iterator drops what has not begun.

        Raises
        ------
        SessionError
            Workers are there, and none of them is fit.
        """
        try:
            asked, fit = self._fit_workers(jobs)
        except BaseException:
            self._client.close()
            raise
        night = uuid.uuid4().hex[:8]
        futures = {
            self._client.submit(
                work_if_fit,
                self._work,
                job.to_dict(),
                asked,
                key=f"opnav-{job.name}-{night}",
                retries=job.retries,
                workers=fit,
            ): job
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

    def _fit_workers(self, jobs: Sequence[NotebookRequest]) -> tuple[dict[str, Any], list[str] | None]:
        """Return what to ask of workers that come later, and the addresses of those that are fit; None: all are."""
        if not jobs:
            return {}, None
        images = [jobs[i].image for i in sorted({0, len(jobs) // 2, len(jobs) - 1})]
        asked = what_to_ask(Path(jobs[0].folder), jobs[0].parameters, images)
        found = self._client.run(unfit_because, asked, on_error="return")
        unfit = {address: why for address, why in found.items() if why != ""}
        said = [f"the worker {address} is given no picture: {why}" for address, why in unfit.items()]
        if found and len(unfit) == len(found):
            raise SessionError(f"no worker can do this night's pictures: {'; '.join(said)}.")
        for words in said:
            self._notice(words)
        return asked, [address for address in found if address not in unfit] if unfit else None

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
