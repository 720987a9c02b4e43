"""What hostile inputs are made with: mutants of good files and arguments, within limits of time and memory."""

import contextlib
import io
import os
import resource
import signal
import sys
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

SECONDS = 10.0  # of one input: a hang; good ones take milliseconds, a picture half a second
GROWTH_MB = 1500  # of the process over all its inputs
LONGEST_LINE = 2100

WORDS = [
    b"nan", b"inf", b"-1", b"0", b"1e400", b"999999999", b"9" * 400, b"[" * 60, b"&a [*a]", b"!!int \"\"", b"2015-02-30",
    b"''", b"\x00", b"\xff\xfe", b"(", b"\"", b"{", b"~", b"1:2:3", b"<<: *a", b"$x", b"../../etc", b"\r", b"=", b"-0.0",
    b"9223372036854775808", b"true", b"\\u0000", b"\xed\xa0\x80",
]  # fmt: skip
STOPS = b" \n\r,:=()[]{}'\""


# ---- Mutants of files.


def mutant(good: bytes, rng: np.random.Generator, *, text: bool) -> bytes:
    """Change a file in one place, or in some: half of them are near enough to be taken."""
    data = bytearray(good)
    for _ in range(1 if rng.random() < 0.5 else rng.integers(2, 5)):
        at = int(rng.integers(0, len(data) + 1))
        way = rng.integers(0, 9)
        if way == 0 and data:
            data[min(at, len(data) - 1)] ^= 1 << rng.integers(0, 8)
        elif way == 1:
            data[at : at + int(rng.integers(1, 60))] = b""
        elif way == 2:
            start = int(rng.integers(0, len(data) + 1))
            data[at:at] = data[start : start + int(rng.integers(1, 200))]
        elif way == 3:
            data[at:] = b""
        elif way == 4 and not text:
            data[at : at + 8] = rng.bytes(8)
        elif way in (5, 6):
            _replace_digit(data, rng, at)
        else:
            _replace_token(data, rng, at)
    return bytes(data)


def _replace_digit(data: bytearray, rng: np.random.Generator, at: int) -> None:
    """Misprint a number."""
    for place in (*range(at, len(data)), *range(at)):
        if 48 <= data[place] <= 57:
            data[place] = 48 + int(rng.integers(0, 10))
            return


def _replace_token(data: bytearray, rng: np.random.Generator, at: int) -> None:
    """Put an odd word in the place of a number or word, as a slip of a keyboard or a broken writer does."""
    start = at
    while start < len(data) and data[start] in STOPS:
        start += 1
    end = start
    while end < len(data) and data[end] not in STOPS:
        end += 1
    data[start:end] = WORDS[rng.integers(0, len(WORDS))]


# ---- Mutants of arguments. A shell hands on any bytes but NUL.
# No path here is absolute: these commands write, and a test may run as root.

ODD_ARGUMENTS = [os.fsdecode(word) for word in WORDS if b"\x00" not in word] + [
    "", "-", "--", "=", "--help", "loop", "pipe", "zero", "a" * 300, ".", "1e9", "-5", "\u202egnp", "nul\x1b[31m",
]  # fmt: skip


def mutant_arguments(good: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Leave out, repeat, misprint or replace an argument or two; the command itself stays."""
    arguments = list(good)
    for _ in range(rng.integers(1, 3)):
        at = int(rng.integers(1, len(arguments))) if len(arguments) > 1 else len(arguments)
        way = rng.integers(0, 6)
        if way == 0:
            del arguments[at : at + 1]
        elif way == 1:
            arguments.insert(at, arguments[int(rng.integers(0, len(arguments)))])
        elif way == 2 and at < len(arguments) and arguments[at]:
            letters = bytearray(os.fsencode(arguments[at]))
            letters[rng.integers(0, len(letters))] = rng.integers(1, 256)
            arguments[at] = os.fsdecode(bytes(letters)).lstrip("/~")  # never out of the folder of the test
        else:
            arguments[at : at + 1] = [ODD_ARGUMENTS[rng.integers(0, len(ODD_ARGUMENTS))]]
    return arguments


# ---- Limits.


class LateError(BaseException):
    """No reader's own `except Exception` takes it for a fault of the file."""


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Limit processor time, and real time to five times as much: a busy machine is no hang, a pipe that blocks is one."""

    def late(*_: object) -> None:
        raise LateError(f"more than {seconds:g} s")

    timers = (
        (signal.ITIMER_PROF, signal.SIGPROF, seconds),
        (signal.ITIMER_REAL, signal.SIGALRM, 5.0 * seconds),
    )
    before = [signal.signal(number, late) for _, number, _ in timers]
    for timer, _, limit in timers:
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for (timer, number, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


# ---- Commands in this process.


def answer(arguments: Sequence[str]) -> tuple[int, str, str]:
    """Run the program; return exit status, standard output and standard error."""
    # The readers' own tests need not load it.
    from opnav_workbench.cli.program import main

    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(sys, "argv", ["opnav", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
    return int(ended.value.code or 0), out.getvalue(), err.getvalue()
