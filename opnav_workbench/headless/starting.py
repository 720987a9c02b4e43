"""How a picture's process begins: as a copy of one that has loaded everything (warm), or as a new Python (cold).

Both carry out the same job file with the same notebook and come to the same bits; warm costs less than half.  Where no
process can be copied (on other systems than Linux, or where a library's threads forbid it), a night is cold and says why.
"""

import atexit
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from opnav_workbench.constants import ONE_THREAD
from opnav_workbench.files import json_text
from opnav_workbench.headless.warm_server import WarmServer, WarmServerError, can_fork

__all__ = ["Child", "ColdStarter", "Starter", "WarmStarter", "starter_of_this_process"]

RUNNER = Path(__file__).with_name("notebook_run.py")
OF_A_PICTURE = ("image", "out")
WARM_TRIES = 2  # servers that may be lost before they do anything


class Child(Protocol):
    """A picture's process."""

    pid: int
    returncode: Any

    def poll(self) -> int | None:
        """Return how it ended; None while it runs."""
        ...

    def wait(self, timeout: float | None = None) -> Any:
        """Wait for its end, or for some seconds."""
        ...


class Starter(Protocol):
    """Begins pictures' processes."""

    def start(self, job: Path, parameters: Mapping[str, Any], log: Path) -> Child:
        """Have a job file carried out; `parameters` are the notebook's."""
        ...

    def close(self) -> None:
        """End what was kept for more."""
        ...


class ColdStarter:
    """A new Python for every picture, and a kernel besides."""

    def start(self, job: Path, parameters: Mapping[str, Any], log: Path) -> Child:  # noqa: ARG002
        """Have a job file carried out."""
        with log.open("wb") as said:
            return subprocess.Popen(  # noqa: S603  our own interpreter and file
                [sys.executable, "-P", str(RUNNER), str(job)],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
                env=os.environ | ONE_THREAD,
            )

    def close(self) -> None:
        """Nothing is kept."""


class WarmStarter:
    """Copies of a process that has loaded everything; one such process for all threads.

    Parameters
    ----------
    notice
        Told, once, why pictures go the cold way after all.
    """

    def __init__(self, notice: Callable[[str], None] = lambda _: None) -> None:
        self._notice = notice
        self._lock = threading.Lock()
        self._server: WarmServer | None = None
        self._opened = ""
        self._lost = 0
        self._closed = False
        self._cold = ColdStarter()

    def start(self, job: Path, parameters: Mapping[str, Any], log: Path) -> Child:
        """Have a job file carried out.

        Raises
        ------
        WarmServerError
            The starter has been closed.
        """
        while self._lost < WARM_TRIES:
            server = None
            try:
                server = self._server_for(parameters)
                child = server.start(job)
            except WarmServerError as error:
                self._give_up(server, str(error))
            else:
                self._lost = 0
                return child
        return self._cold.start(job, parameters, log)

    def _server_for(self, parameters: Mapping[str, Any]) -> WarmServer:
        """Return a server that has opened what these parameters ask for."""
        how = {name: value for name, value in parameters.items() if name not in OF_A_PICTURE}
        with self._lock:
            self._check_open()
            if self._server is None or not self._server.alive or self._opened != json_text(how):
                if self._server is not None:
                    self._server.close()
                self._server, self._opened = WarmServer(how, os.environ | ONE_THREAD), json_text(how)
            return self._server

    def _give_up(self, server: WarmServer | None, why: str) -> None:
        with self._lock:
            self._check_open()
            if server is not None and server is not self._server:
                return  # another thread was faster
            self._lost += 1
            if self._server is not None:
                self._server.close()
                self._server = None
            if self._lost == WARM_TRIES:
                self._notice(f"pictures go the cold way, two to three times slower: {why}")

    def _check_open(self) -> None:
        if self._closed:
            raise WarmServerError("stopped")

    def close(self) -> None:
        """End the process that copies are made of, and all copies; none is begun any more."""
        with self._lock:
            self._closed = True
            if self._server is not None:
                self._server.close()
                self._server = None


_OF_THIS_PROCESS: list[Starter] = []


def starter_of_this_process(*, warm: bool) -> Starter:
    """Return what begins processes on a cluster's worker: warm for as long as the worker lives."""
    if not (warm and can_fork()):
        return ColdStarter()
    if not _OF_THIS_PROCESS:
        _OF_THIS_PROCESS.append(WarmStarter())
        atexit.register(_OF_THIS_PROCESS[0].close)
    return _OF_THIS_PROCESS[0]
