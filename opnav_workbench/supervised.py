"""Work that may end its process, in a process of its own: kept warm, watched, with limits of time and memory.

Compiled code that reads files of others (SPICE's readers of shapes, decompression of pictures) trusts what it reads, and
no check of ours proves all of it harmless. It is tried here first: a crash, a hang or a bomb costs one line. The process
starts at the first question, and stays: one start a session, not one a file.

Flow    `tried` -> one line of JSON: function, arguments -> the process calls it -> one line: well, or why not
"""

import atexit
import contextlib
import functools
import importlib.util
import json
import os
import selectors
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import IO, Any

__all__ = ["TrialError", "cause_of_end", "tried"]

SECONDS = 30.0  # of one question; the largest shapes and pictures take a few
MEMORY_BYTES = 4 << 30  # of address space beyond what the process starts with
PACKAGE = Path(__file__).parent
LONGEST_REASON = 500  # characters
ROOM_BYTES = 4 << 30  # that libraries reserve and never touch


class TrialError(Exception):
    """What was tried failed, ended its process, or took too long or too much; one line."""


class _Child:
    """The process, started when first asked and anew after a death."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    def answer(self, question: bytes, seconds: float) -> dict[str, Any]:
        with self._lock:
            process = self._process = self._process or _started()
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(question + b"\n")
                process.stdin.flush()
                line = _line_within(process.stdout, seconds)
            except OSError:
                line = b""
            if line is not None and line.endswith(b"\n"):
                return dict(json.loads(line))
            return {"failed": self._ended(process, hung=line is None, seconds=seconds)}

    def _ended(self, process: "subprocess.Popen[bytes]", *, hung: bool, seconds: float) -> str:
        self._process = None
        if hung:
            process.kill()
        with process:
            code = process.wait()
        if hung:
            return f"it takes more than {seconds:g} s"
        return f"it ends the process that reads it ({cause_of_end(code)})"

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(OSError), process:
                process.kill()


def tried(function: str, *arguments: str, seconds: float = SECONDS) -> None:
    """Call a function of this package in the supervised process; return when it came back well.

    Parameters
    ----------
    function
        ``file:name`` below the package, such as ``kernels/kernel_trial.py:try_dsk``. The file is loaded by its path, so
        that the process loads what the file imports and nothing else of this package; what it returns is dropped.
    arguments
        Texts, such as paths.
    seconds
        What it may take.

    Raises
    ------
    TrialError
        It raised, ended the process, hung, or wanted more memory than there is for it.
    """
    question = json.dumps({"function": function, "arguments": arguments}).encode()
    failed = _CHILD.answer(question, seconds).get("failed")
    if failed:
        raise TrialError(str(failed))


_CHILD = _Child()
atexit.register(_CHILD.close)
# A fork's child has the pipes of its parent's process: it starts one of its own.
os.register_at_fork(after_in_child=lambda: globals().update(_CHILD=_Child()))


def _started() -> "subprocess.Popen[bytes]":
    above = str(Path(__file__).parents[1])
    paths = os.pathsep.join(filter(None, [above, os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen(  # noqa: S603  our own interpreter and module
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": paths},
        start_new_session=True,  # Ctrl-C is the parent's matter
    )


def _line_within(stream: IO[bytes], seconds: float) -> bytes | None:
    """Return the next line; None where it does not come in time. Lines of ours are shorter than a pipe."""
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if selector.select(seconds) else None


def cause_of_end(code: int) -> str:
    """Return why a process ended: the name of a signal, or its status."""
    with contextlib.suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else f"status {code}"
    return f"status {code}"


# ---- The process itself: ``python -m opnav_workbench.supervised``.


def main() -> None:
    """Answer questions until there are none."""
    # What libraries print belongs to nobody; answers go where standard output went.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _limit()
    for line in sys.stdin.buffer:
        answers.write(json.dumps(_answer(json.loads(line))).encode() + b"\n")
        answers.flush()


def _limit() -> None:
    try:
        import resource  # noqa: PLC0415  where the system has it
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES + ROOM_BYTES, MEMORY_BYTES + ROOM_BYTES))


@functools.cache
def _loaded(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(Path(path).stem, PACKAGE / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _answer(question: dict[str, Any]) -> dict[str, str]:
    module, _, name = question["function"].partition(":")
    try:
        getattr(_loaded(module), name)(*question["arguments"])
    except MemoryError:
        return {"failed": "it wants more memory than there is for it"}
    except Exception as error:
        # SPICE's errors say their reason in a part; the whole has lines of signs.
        reason = getattr(error, "long", None) or getattr(error, "short", None) or error
        return {"failed": " ".join(f"{type(error).__name__}: {reason}".split())[:LONGEST_REASON]}
    return {}


if __name__ == "__main__":
    main()
