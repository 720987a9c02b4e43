"""A process that has loaded everything once, and makes a copy of itself for every picture.

Imports, catalog and mission are most of what a picture costs by itself.  Here they are loaded once; each picture has a
process of its own all the same, forked when it begins and ended when it is done: nothing of one picture can reach the
next, and a crash, a hang or a bomb costs one.  What is loaded is shared in memory until somebody writes to it.

Flow    `WarmServer` -> a job file's path -> fork -> `notebook_run` with `warm_engine` -> {"job", "pid"}, {"job", "status"}

No kernel of SPICE is open here, since copies would share their places in the files; only their digests are known.  The
server has one thread, as a fork asks for; where a library starts another, it says so and ends, and the night goes the cold
way.
"""

import contextlib
import gc
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

__all__ = ["WarmChild", "WarmServer", "WarmServerError", "can_fork"]

START_S = 180.0  # on a loaded machine
TOLD_CHARACTERS = 300  # of what a server said before it ended
OOM_SCORE = "600"  # where memory ends, the system takes a picture's process first
DEATH_SIGNAL = 1  # prctl's PR_SET_PDEATHSIG
LIBRARIES = (
    "opnav_workbench.campaign.run_folder",
    "opnav_workbench.headless.warm_engine",
    "opnav_workbench.observables",
    "opnav_workbench.processing.notebook",
    "opnav_workbench.report.summary",
    "opnav_workbench.session.session",
    "IPython.core.completerlib",
    "IPython.core.crashhandler",
    "IPython.core.magics",
    "IPython.display",
    "ipykernel.comm.manager",
    "ipykernel.inprocess.ipkernel",
    "jinja2.ext",
    "matplotlib.backends.backend_agg",
    "matplotlib_inline.backend_inline",
    "nbconvert",
    "nbconvert.exporters.html",
    "pygments.lexers.python",
    "pygments.styles.default",
    "tornado.platform.asyncio",
)


class WarmServerError(Exception):
    """The server cannot be started, or has ended; one line."""


def can_fork() -> bool:
    """Tell whether processes can be copied here: elsewhere system libraries do not survive it."""
    return sys.platform == "linux" and hasattr(os, "pidfd_open")


# ---- The night's side.


class WarmChild:
    """A picture's process, as `subprocess.Popen` shows one."""

    def __init__(self) -> None:
        self.pid = 0
        self.returncode: int | None = None
        self.begun, self._over = threading.Event(), threading.Event()

    def poll(self) -> int | None:
        """Return how it ended; None while it runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end."""
        self._over.wait(timeout)
        return self.returncode

    def ended(self, status: int) -> None:
        """Take down its end, once."""
        if self.returncode is None:
            self.returncode = status
        self.begun.set()
        self._over.set()


class WarmServer:
    """The server's process, and what it says of its children.

    Parameters
    ----------
    how
        Parameters of the notebook: what to open beforehand.
    environment
        Of the process.

    Raises
    ------
    WarmServerError
        It does not start.
    """

    def __init__(self, how: Mapping[str, Any], environment: Mapping[str, str]) -> None:
        above = str(Path(__file__).parents[2])
        paths = os.pathsep.join(filter(None, [above, environment.get("PYTHONPATH", "")]))
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  as long as the process
        self._lock = threading.Lock()
        self._children: dict[str, WarmChild] = {}
        try:
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter and module
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                env={**environment, "PYTHONPATH": paths},
                start_new_session=True,  # Ctrl-C is the night's matter
            )
            self._send(dict(how))
        except OSError as error:
            self._said.close()
            raise WarmServerError(f"a process cannot be started ({error})") from error
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    @property
    def pid(self) -> int:
        """Number of the server's process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it can be given more."""
        return self._process.poll() is None

    def start(self, job: Path) -> WarmChild:
        """Have a job file carried out by a process of its own.

        Raises
        ------
        WarmServerError
            The server has ended, or does not answer.
        """
        child = WarmChild()
        try:
            with self._lock:
                self._children[str(job)] = child
                self._send(str(job))
        except OSError as error:
            raise WarmServerError(self._why()) from error
        if not child.begun.wait(START_S):
            raise WarmServerError(f"no answer from the warm process within {START_S:g} s")
        if not child.pid:
            raise WarmServerError(self._why())
        return child

    def close(self) -> None:
        """End the server and all of its children."""
        with contextlib.suppress(OSError):
            self._process.kill()  # its children end with it
        self._process.wait()
        self._listener.join()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def _send(self, message: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(message).encode() + b"\n")
        self._process.stdin.flush()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            answer = json.loads(line)
            child = self._children[answer["job"]]
            if "pid" in answer:
                child.pid = answer["pid"]
                child.begun.set()
            else:
                child.ended(answer["status"])
                del self._children[answer["job"]]
        with self._lock:
            for child in self._children.values():
                child.ended(-signal.SIGKILL)

    def _why(self) -> str:
        """Return the last words of a server that ended."""
        with contextlib.suppress(OSError, subprocess.TimeoutExpired, ValueError):
            self._process.wait(1.0)
            self._said.seek(0)
            lines = self._said.read().decode(errors="replace").strip().splitlines()
            if lines:
                return f"the warm process ended: {lines[-1][:TOLD_CHARACTERS]}"
        return "the warm process ended"


# ---- The process itself: ``python -m opnav_workbench.headless.warm_server``.


def main() -> None:
    """Load everything, then make a copy for every line that comes, until none does."""
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print belongs to nobody
    requests = os.dup(0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    lines = _Lines(requests)
    warm_up(json.loads(lines.first()))
    if (number := threads_here()) != 1:
        sys.exit(f"libraries started {number - 1} threads, with which no process can be copied")
    gc.collect()
    gc.freeze()  # what stays for ever need not be looked through, page by page, in each copy
    _serve(lines, answers)


def warm_up(how: Mapping[str, Any]) -> None:
    """Load what pictures need, and open what they share; what cannot be opened each picture will tell of itself."""
    import importlib  # noqa: PLC0415  this process alone
    import warnings  # noqa: PLC0415

    from opnav_workbench.headless.notebook_run import load_papermill  # noqa: PLC0415

    load_papermill()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sys.modules["debugpy"] = None  # type: ignore[assignment]  # no debugger comes to a night
        for name in LIBRARIES:
            importlib.import_module(name)
        from opnav_workbench.errors import OpNavError  # noqa: PLC0415
        from opnav_workbench.processing.model import Processing, keep_opened  # noqa: PLC0415
        from opnav_workbench.processing.notebook import checked_parameters  # noqa: PLC0415

        known = {name: value for name, value in how.items() if name in Processing.model_fields}
        with contextlib.suppress(OpNavError, OSError):
            keep_opened(checked_parameters(known, Processing))


def threads_here() -> int:
    """Return how many threads this process has, those of libraries too."""
    return len(os.listdir("/proc/self/task"))  # noqa: PTH208


class _Lines:
    """Lines of a pipe, read without a buffer that a copy would share."""

    def __init__(self, pipe: int) -> None:
        self.pipe, self._rest = pipe, b""

    def first(self) -> bytes:
        """Wait for a line."""
        while b"\n" not in self._rest:
            if not (piece := os.read(self.pipe, 65536)):
                sys.exit()
            self._rest += piece
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def at_hand(self) -> list[bytes] | None:
        """Wait for more, and return whole lines; None at the end of all."""
        if not (piece := os.read(self.pipe, 65536)):
            return None
        self._rest += piece
        return self.left()

    def left(self) -> list[bytes]:
        """Return whole lines that have been read already."""
        *whole, self._rest = self._rest.split(b"\n")
        return whole


def _serve(lines: "_Lines", answers: int) -> None:
    events = select.epoll()
    events.register(lines.pipe, select.EPOLLIN | select.EPOLLHUP)
    running: dict[int, tuple[int, str]] = {}  # by the descriptor that tells of a process' end: number and job
    _begin(lines.left(), lines, answers, events, running)
    while True:
        for descriptor, _ in events.poll():
            if descriptor != lines.pipe:
                pid, job = running.pop(descriptor)
                events.unregister(descriptor)
                _end_group(pid)  # what its own processes left; its number is not free before it is waited for
                _, status = os.waitpid(pid, 0)
                os.close(descriptor)
                _say(answers, {"job": job, "status": os.waitstatus_to_exitcode(status)})
            elif (jobs := lines.at_hand()) is not None:
                _begin(jobs, lines, answers, events, running)
            else:  # the night is over
                for pid, _ in running.values():
                    _end_group(pid)
                return


def _begin(
    jobs: list[bytes], lines: _Lines, answers: int, events: Any, running: dict[int, tuple[int, str]]
) -> None:
    for line in jobs:
        job = json.loads(line)
        server, pid = os.getpid(), os.fork()
        if pid == 0:
            for descriptor in (lines.pipe, answers, *running):
                os.close(descriptor)
            events.close()
            _carry_out(Path(job), server)
        descriptor = os.pidfd_open(pid)
        running[descriptor] = (pid, job)
        events.register(descriptor, select.EPOLLIN)
        _say(answers, {"job": job, "pid": pid})


def _end_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def _say(answers: int, answer: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):  # the night is gone; so are we, at the next look
        os.write(answers, json.dumps(answer).encode() + b"\n")


def _carry_out(job: Path, server: int) -> None:
    """Be a picture's process."""
    status = 1
    try:
        _settle_in(json.loads(job.read_text(encoding="utf-8"))["log"], server)
        from opnav_workbench.headless import notebook_run  # noqa: PLC0415  loaded already
        from opnav_workbench.headless.warm_engine import ENGINE  # noqa: PLC0415

        notebook_run.main(str(job), engine=ENGINE)
        status = 0
    except BaseException:  # a copy must never go on as the server
        import traceback  # noqa: PLC0415

        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _settle_in(log: str, server: int) -> None:
    """Leave the server's group, streams and chance behind; end when it ends."""
    os.setsid()
    import ctypes  # noqa: PLC0415

    ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != server:  # it has ended before we could ask to be told
        os._exit(1)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.close(file)
    import numpy as np  # noqa: PLC0415

    np.random.seed()  # noqa: NPY002  the old global one, for notebooks that use it: not the same in every picture


if __name__ == "__main__":
    main()
