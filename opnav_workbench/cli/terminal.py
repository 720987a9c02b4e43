"""What several commands show on a terminal: consoles, progress bars, plain tables, exit statuses.

Results go to standard output, progress and complaints to standard error; a bar is shown on terminals only.
"""

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from opnav_workbench.errors import plain_line

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_PARTLY",
    "EXIT_STOPPED",
    "Terminated",
    "ended_by_signals",
    "error_console",
    "folding_table",
    "named_progress",
    "picture_progress",
    "plain_table",
    "shown",
]


# ---- Exit statuses of all commands; 0 is all well.

EXIT_BAD_INPUT = 2  # bad input or usage, or something needed is missing
EXIT_PARTLY = (
    3  # done, but not all of it: pictures failed, runs skipped, kernels with a gap, a rehearsal not passed
)
EXIT_STOPPED = 130  # by the keyboard; as shells say it: 128 and the number of SIGINT


# ---- Signals that end a command.


class Terminated(KeyboardInterrupt):
    """The machine or its operator ends this program; what is done is to be kept, as after Ctrl-C.

    Attributes
    ----------
    status
        What to exit with.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


AGAIN_S = 0.05  # until whatever swallowed a signal's exception is done


def _tell_main_thread(number: int) -> None:
    if hasattr(signal, "pthread_kill"):  # so that it does not go on waiting
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        signal.raise_signal(number)


class _Reminder:
    """Tells the main thread of a signal until it has heard: one that comes just before it waits does not wake it."""

    def __init__(self) -> None:
        self._told: list[tuple[int, threading.Event, threading.Thread]] = []

    def begin(self, number: int) -> None:
        """Tell of a signal."""
        heard = threading.Event()
        thread = threading.Thread(target=self._tell, args=(number, heard), daemon=True)
        self._told.append((number, heard, thread))
        thread.start()

    @staticmethod
    def _tell(number: int, heard: threading.Event) -> None:
        while not heard.wait(AGAIN_S):
            _tell_main_thread(number)

    def heard(self) -> list[int]:
        """Tell no more; return what was still to be told."""
        left = [number for number, heard, _ in self._told if not heard.is_set()]
        for _, heard, _ in self._told:
            heard.set()
        return left

    def end(self) -> None:
        """Tell no more, from now on."""
        self.heard()
        for _, _, thread in self._told:
            thread.join()


@contextmanager
def ended_by_signals() -> Iterator[Callable[[], None]]:
    """Raise `Terminated` in the block when the process is told to end (SIGTERM, SIGHUP), once.

    Where Python swallows it, as in what runs while garbage is collected, it is raised again a moment later, at the latest
    when the block ends.

    Yields
    ------
    callable
        From its call on the signals are passed over: what is done is being written down.
    """
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():  # only there signals can be handled
        numbers = []
    reminder = _Reminder()

    def pass_over() -> None:
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)
        reminder.heard()

    def end(number: int, _frame: FrameType | None) -> None:
        pass_over()
        raise Terminated(number)

    tell = sys.unraisablehook

    def swallowed(what: "sys.UnraisableHookArgs") -> None:
        if isinstance(what.exc_value, Terminated):
            number = what.exc_value.status - 128
            signal.signal(number, end)
            reminder.begin(number)
        else:
            tell(what)

    before = {number: signal.signal(number, end) for number in numbers}
    sys.unraisablehook = swallowed
    try:
        yield pass_over
        for number in reminder.heard():
            end(number, None)
    finally:
        pass_over()
        reminder.end()  # before the handlers are those of before, which are not to be told
        sys.unraisablehook = tell
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- Consoles, progress and tables.


def shown(text: str) -> str:
    """Return text of files and people as a console shall show it: no markup, no control characters, not too long."""
    return escape(plain_line(text))


def error_console() -> Console:
    """Return a console on standard error, which breaks no line."""
    return Console(stderr=True, soft_wrap=True, emoji=False)


def picture_progress(console: Console | None = None) -> Progress:
    """Return a progress bar, shown on terminals only; without a console on standard error."""
    shown = console or error_console()
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=shown,
        transient=True,
        disable=not shown.is_terminal,
    )


def plain_table(
    title: str, texts: Sequence[str], numbers: Sequence[str], *, first_width: int | None = None
) -> Table:
    """Return an empty table: columns of text, then of numbers; on a narrow terminal only the first folds."""
    table = Table(title=title or None, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for i, name in enumerate(texts):
        table.add_column(name, no_wrap=i > 0, overflow="fold", min_width=first_width if i == 0 else None)
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def folding_table(columns: Sequence[str], title: str | None = None) -> Table:
    """Return an empty table in the house style: no lines; words fold, times and numbers do not."""
    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for name in columns:
        table.add_column(name, overflow="fold", no_wrap=name.endswith("(UTC)") or name == "cover")
    return table


@contextmanager
def named_progress(console: Console, total: int) -> Iterator[Callable[[str, str], None]]:
    """Show how far the pictures are; the yielded function tells of the next one."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=total)
        begun = [0]

        def say(name: str, words: str) -> None:
            progress.update(task, description=f"{shown(name)}: {shown(words)}", completed=begun[0])
            begun[0] += 1

        yield say
