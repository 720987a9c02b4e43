"""How a night goes, for whoever does not look at its terminal: a log with times, ``status.json``, metrics, a heartbeat.

Files  OUT/night.log      one line an event, UTC; nights follow each other in it
       OUT/status.json    what is done and left, how fast, when it will be ready; written every few seconds
       OUT/night.prom     the same as Prometheus' text format, for node_exporter's textfile collector

None of them is worth a night: where they cannot be written it goes on without.
"""

import logging
import os
import shutil
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_json, write_text
from opnav_workbench.format_versions import stamped
from opnav_workbench.headless.faults import FAULTS
from opnav_workbench.headless.night import NightPlan
from opnav_workbench.headless.night_workers import NotebookOutcome
from opnav_workbench.headless.records import result_field
from opnav_workbench.version import __version__

__all__ = ["LOG_FILE", "METRICS_FILE", "STATUS_FILE", "NightWatch"]

LOG_FILE, STATUS_FILE, METRICS_FILE = "night.log", "status.json", "night.prom"
WRITE_EVERY_S = 5.0
HEARTBEAT_S = 60.0
MB = 1 << 20
# Metrics: what they are called, what they mean, and where the status has them.
METRICS = (
    ("pictures_total", "Pictures of the night.", ("pictures", "total")),
    ("pictures_to_process", "Pictures that this night was to process.", ("pictures", "to_process")),
    ("pictures_processed", "Pictures processed so far.", ("pictures", "processed")),
    ("pictures_failed", "Pictures of these that failed.", ("pictures", "failed")),
    ("retries", "Further tries after faults of the machine.", ("pictures", "retries")),
    ("pictures_per_minute", "Rate of this night.", ("pictures_per_minute",)),
    ("disk_free_mb", "Space left for results.", ("disk_free_mb",)),
    ("updated_timestamp_seconds", "When this was written.", ("updated_s",)),
    ("running", "1 while the night runs.", ("running",)),
)


class _LogFile(logging.FileHandler):
    """A log whose file cannot be written any more costs no night: the first reason is kept, and nothing printed."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, encoding="utf-8")
        self.fault = ""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: ARG002, N802  as logging calls it
        """Keep why a line was not written."""
        self.fault = self.fault or str(sys.exc_info()[1])

    def close(self) -> None:
        """Close the file; what could not be written is tried once more."""
        try:
            super().close()
        except OSError as error:
            self.fault = self.fault or str(error)


class NightWatch:
    """Writes how a night goes, as long as the block.

    Parameters
    ----------
    log
        Default ``OUT/night.log``.
    heartbeat
        Called with a line every minute, where nobody sees a progress bar.
    every_s
        How often; for tests.
    """

    def __init__(
        self,
        plan: NightPlan,
        log: Path | None = None,
        heartbeat: Callable[[str], None] | None = None,
        every_s: float = HEARTBEAT_S,
    ) -> None:
        self._plan, self._heartbeat, self._every_s = plan, heartbeat, every_s
        self._began, self._began_at = time.time(), time.monotonic()
        self._statuses: Counter[str] = Counter()
        self._faults: Counter[str] = Counter()
        self._retries = 0
        self._last: dict[str, Any] = {}
        self._state = ""
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._path = log or plan.out / LOG_FILE
        self._file: _LogFile | None = None
        self._unopened = ""
        self._log = logging.Logger("night")  # its own, so that no other program's set-up reaches it

    def begin(self) -> None:
        """Write from now on: the folder is this night's."""
        plan, self._state = self._plan, "running"
        self._began, self._began_at = time.time(), time.monotonic()
        try:
            self._file = _LogFile(self._path)
        except OSError as error:
            self._unopened = error.strerror or str(error)
            self._log.addHandler(logging.NullHandler())  # without any, logging prints
        else:
            formatter = logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%SZ")
            formatter.converter = time.gmtime
            self._file.setFormatter(formatter)
            self._log.addHandler(self._file)
        states = dict(Counter(picture.state for picture in plan.pictures))
        self._log.info("begins: %d pictures, %s; version %s", len(plan.pictures), states, __version__)
        self._log.info(
            "mission %s, kernels %s, catalog %s",
            plan.spec.mission,
            plan.spec.kernels or "none",
            plan.spec.catalog,
        )
        self._write()
        threading.Thread(target=self._beat, daemon=True).start()

    def __enter__(self) -> "NightWatch":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if not self._state:
            return
        self._state = "finished"
        if kind is not None:
            self._state = "stopped" if issubclass(kind, KeyboardInterrupt) else "failed"
            self._log.error("%s: %s %s", self._state, kind.__name__, error)
        self._write()
        self._log.info("ends: %s", self.line())
        if self._file is not None:
            self._file.close()

    @property
    def fault(self) -> str:
        """Why the log is not whole; empty where it is."""
        why = self._unopened if self._file is None else self._file.fault
        return f"the log {self._path} is not whole: {why}" if why else ""

    def said(self, verdict: NotebookOutcome) -> None:
        """Take down what became of a picture."""
        status = (
            "failed" if verdict.fault else result_field(self._plan.out / verdict.name, "status") or "failed"
        )
        self._statuses[status] += 1
        self._faults[verdict.fault] += bool(verdict.fault)
        self._retries += verdict.tries - 1
        self._last = {"name": verdict.name, "status": status, "reason": verdict.reason}
        level = logging.WARNING if status == "failed" else logging.INFO
        what = f"{FAULTS[verdict.fault].words}: {verdict.reason}" if verdict.fault else status
        self._log.log(
            level,
            "%s %s (%.1f s, %.0f MB, try %d)",
            verdict.name,
            what,
            verdict.seconds,
            verdict.peak_mb,
            verdict.tries,
        )

    def note(self, words: str) -> None:
        """Take down something else."""
        self._log.warning("%s", words)

    def status(self) -> dict[str, Any]:
        """Return how the night goes, as plain values."""
        now, todo = time.time(), len(self._plan.todo)
        done = sum(self._statuses.values())
        rate = done / max(time.monotonic() - self._began_at, 1e-9) * 60.0  # whatever happens to the clock
        left = todo - done
        ready = _utc(now + left / rate * 60.0) if rate > 0.0 and self._state == "running" else None
        content = {
            "version": __version__,
            "state": self._state,
            "running": int(self._state == "running"),
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "started_utc": _utc(self._began),
            "updated_utc": _utc(now),
            "updated_s": round(now, 3),
            "pictures": {
                "total": len(self._plan.pictures),
                "to_process": todo,
                "processed": done,
                "left": left,
                "failed": self._statuses["failed"],
                "by_status": dict(self._statuses),
                "by_fault": {name: count for name, count in self._faults.items() if count},
                "retries": self._retries,
            },
            "pictures_per_minute": round(rate, 3),
            "ready_utc": ready,
            "last": self._last,
            "disk_free_mb": _free_mb(self._plan.out),
        }
        return stamped("status", content)

    def line(self) -> str:
        """Return the same in a line."""
        status = self.status()
        counts = status["pictures"]
        ready = f", ready about {status['ready_utc']}" if status["ready_utc"] else ""
        return (
            f"{counts['processed']} of {counts['to_process']} pictures done, {counts['failed']} failed, "
            f"{status['pictures_per_minute']:.1f} a minute{ready}"
        )

    def _beat(self) -> None:
        spoken = time.monotonic()
        while not self._over.wait(min(WRITE_EVERY_S, self._every_s)):
            self._write()
            if self._heartbeat is not None and time.monotonic() - spoken >= self._every_s:
                spoken = time.monotonic()
                self._heartbeat(self.line())

    def _write(self) -> None:
        with self._lock, suppress(SessionError):
            status = self.status()
            write_json(self._plan.out / STATUS_FILE, status)
            write_text(self._plan.out / METRICS_FILE, metrics_text(status))


def metrics_text(status: dict[str, Any]) -> str:
    """Return a night's status in Prometheus' text format.

    Examples
    --------
    >>> print(metrics_text({"running": 1}))
    # HELP opnav_night_running 1 while the night runs.
    # TYPE opnav_night_running gauge
    opnav_night_running 1
    <BLANKLINE>
    """
    lines = []
    for name, words, path in METRICS:
        value: Any = status
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None:
            lines += [f"# HELP opnav_night_{name} {words}", f"# TYPE opnav_night_{name} gauge"]
            lines.append(f"opnav_night_{name} {value}")
    return "\n".join(lines) + "\n"


def _free_mb(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free // MB
    except OSError:
        return None


def _utc(seconds: float) -> str:
    return (datetime.fromtimestamp(0, UTC) + timedelta(seconds=round(seconds))).isoformat()
