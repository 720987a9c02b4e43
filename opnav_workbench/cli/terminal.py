"""What several commands show on a terminal: progress over pictures, and plain tables."""

from collections.abc import Sequence

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

__all__ = ["error_console", "picture_progress", "plain_table"]


def error_console() -> Console:
    """Return a console on standard error, which breaks no line."""
    return Console(stderr=True, soft_wrap=True)


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
