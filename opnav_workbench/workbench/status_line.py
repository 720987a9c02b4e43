"""The status line: what happened last, in plain words; and what keeps an exception from vanishing.

Tracebacks of unforeseen errors go to ``workbench_errors.log`` in the session's folder.
"""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from opnav_workbench.errors import OpNavError

__all__ = ["Status", "plain_words"]

LOG_FILE = "workbench_errors.log"


def plain_words(error: BaseException) -> str:
    """Return an exception as one line for a person; a defect of ours says so.

    Examples
    --------
    >>> plain_words(OpNavError("no stars are predicted yet: call predict() first."))
    'no stars are predicted yet: call predict() first.'
    >>> plain_words(KeyError("x"))
    "unforeseen KeyError: 'x'; nothing was changed. Please report it."
    """
    words = " ".join(str(error).split())
    if isinstance(error, OpNavError):
        return words
    return f"unforeseen {type(error).__name__}: {words}; nothing was changed. Please report it."


@dataclass(slots=True)
class Status:
    """One line, its kind, and where tracebacks of unforeseen errors go.

    Attributes
    ----------
    kind : {"info", "done", "busy", "error"}
    log_folder
        Folder of the session's files, where ``workbench_errors.log`` then is.
    """

    message: str = "Ready. Press ? for the keys."
    kind: str = "info"
    log_folder: Path | None = None
    changed: Callable[[], None] = field(default=lambda: None, repr=False)

    def say(self, message: str, kind: str = "info") -> None:
        """Show a message."""
        self.message, self.kind = message, kind
        self.changed()

    def fail(self, error: BaseException) -> None:
        """Show an exception in plain words; the traceback of an unforeseen one goes to the log."""
        if not isinstance(error, OpNavError):
            self._log(error)
        self.say(plain_words(error), "error")

    def _log(self, error: BaseException) -> None:
        if self.log_folder is None:
            return
        entry = f"{datetime.now(UTC).isoformat(timespec='seconds')}\n{''.join(traceback.format_exception(error))}\n"
        try:
            self.log_folder.mkdir(parents=True, exist_ok=True)
            with (self.log_folder / LOG_FILE).open("a", encoding="utf-8") as stream:
                stream.write(entry)
        except OSError:
            return  # the line on the screen still says what happened

    @contextmanager
    def reporting(self, done: str | Callable[[], str] = "") -> Iterator[None]:
        """Report what a block did, or why it failed; the exception ends here."""
        try:
            yield
        except Exception as error:  # whatever a callback raises must reach the analyst
            self.fail(error)
        else:
            message = done() if callable(done) else done
            if message:
                self.say(message, "done")
