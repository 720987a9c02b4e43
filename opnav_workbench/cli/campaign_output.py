"""What ``opnav campaign`` prints and writes: progress of an ingest, answers as tables, CSV or JSON, outliers."""

import csv
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table as Printed

from opnav_workbench.campaign import Ingested, IngestReport, Trends
from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text, write_text

__all__ = ["OUTPUT_FORMATS", "ingest_progress", "print_answer", "print_ingested", "print_outliers"]

OUTPUT_FORMATS = ("table", "csv", "json")
STYLES = {"ok": "green", "used": "green", "partial": "yellow", "uncertain": "yellow", "failed": "bold red"}
# What a terminal has room for: heading, column, format.
SHOWN: dict[str, tuple[tuple[str, str, str], ...]] = {
    "images": (
        ("picture", "image", ""),
        ("time (UTC)", "utc", ""),
        ("status", "status", ""),
        ("camera", "camera", ""),
        ("needs an analyst", "attention", ""),
    ),
    "pointings": (
        ("picture", "image", ""),
        ("time (UTC)", "utc", ""),
        ("stars", "n_stars", "d"),
        ("Δpixel", "delta_pixel", "+.2f"),
        ("Δline", "delta_line", "+.2f"),
        ("Δtwist°", "delta_twist_deg", "+.4f"),
        ("rms px", "rms_px", ".3f"),
    ),
    "bodies": (
        ("picture", "image", ""),
        ("target", "body", ""),
        ("method", "method", ""),
        ("status", "status", ""),
        ("pixel", "observed_pixel", ".3f"),
        ("line", "observed_line", ".3f"),
        ("O−C", "residual_pixel", "+.3f"),
        ("O−C", "residual_line", "+.3f"),
    ),
    "stars": (
        ("picture", "image", ""),
        ("star", "star", ""),
        ("mag", "mag", ".2f"),
        ("status", "status", ""),
        ("pixel", "observed_pixel", ".3f"),
        ("line", "observed_line", ".3f"),
        ("O−C", "residual_pixel", "+.3f"),
        ("O−C", "residual_line", "+.3f"),
    ),
}


@contextmanager
def ingest_progress(runs: Sequence[Path]) -> Iterator[Callable[[Ingested], None]]:
    """Show which run is read, and name at once the ones that are skipped."""
    console = Console(stderr=True, soft_wrap=True)
    columns = (SpinnerColumn(), TextColumn("{task.completed:.0f} runs  {task.description}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(", ".join(escape(str(run)) for run in runs), total=None)

        def advance(item: Ingested) -> None:
            progress.update(task, advance=1, description=escape(item.folder.name))
            if item.what == "skipped":
                console.print(
                    f"[bold red]skipped:[/] {escape(str(item.folder))}: {escape(item.reason)}",
                    highlight=False,
                )

        yield advance


def print_ingested(console: Console, report: IngestReport, archive: Path) -> None:
    """Print what became of the runs, in one line."""
    words = {
        "new": "new",
        "replaced": "replaced an older run",
        "unchanged": "unchanged",
        "older": "older than what stands",
        "skipped": "skipped",
    }
    counts = [f"{report.count(what)} {said}" for what, said in words.items() if report.count(what)]  # type: ignore[arg-type]
    number = "1 run" if len(report.items) == 1 else f"{len(report.items)} runs"
    console.print(f"{number}: {', '.join(counts)}", highlight=False)
    console.print(f"Archive: {escape(str(archive))}", highlight=False)


def print_answer(what: str, table: Table, format_: str, out: Path | None) -> None:
    """Print an answer, or write it.

    Raises
    ------
    SessionError
        An unknown format, or a table for people asked into a file.
    """
    if format_ not in OUTPUT_FORMATS:
        raise SessionError(f"unknown format {format_!r}; choose one of {', '.join(OUTPUT_FORMATS)}.")
    if format_ == "table":
        if out is not None:
            raise SessionError("a table is for the terminal; write a file with --format csv or json.")
        _print_table(what, table)
        return
    text = _csv(table) if format_ == "csv" else json_text({what: _rows(table)}) + "\n"
    if out is None:
        sys.stdout.write(text)
    else:
        write_text(out, text)
        Console(soft_wrap=True).print(f"{len(table)} {what} in {escape(str(out))}", highlight=False)


def print_outliers(console: Console, found: Trends) -> None:
    """Name the pictures that are off a trend."""
    for image, series, deviation in found.outliers():
        console.print(
            f"[yellow]outlier[/] {escape(image)}: {escape(series)} is {deviation:+.1f} robust sigmas off",
            highlight=False,
        )


def _print_table(what: str, table: Table) -> None:
    console = Console(soft_wrap=False)
    shown = SHOWN[what]
    printed = Printed(box=None, header_style="bold", pad_edge=False)
    for position, (heading, _, form) in enumerate(shown):
        last_words = heading == "needs an analyst"
        printed.add_column(
            heading,
            justify="right" if form else "left",
            no_wrap=not (position == 0 or last_words),
            overflow="fold",
        )
    for row in _rows(table):
        printed.add_row(*[_cell(row[name], form) for _, name, form in shown])
    console.print(printed)
    console.print(f"{len(table)} {what}", highlight=False)


def _cell(value: Any, form: str) -> str:
    if value is None or value == "":
        return "–" if form else ""
    if form:
        return format(value, form)
    text = str(value).partition(".")[0].replace("T", " ") if _is_time(value) else str(value)
    style = STYLES.get(text)
    return (
        f"[{style}]{escape(text)}[/]" if style else escape(text.replace("_", " ") if text in STYLES else text)
    )


def _is_time(value: Any) -> bool:
    text = str(value)
    return len(text) >= 19 and text[4:5] == "-" and text[10:11] == "T"


def _rows(table: Table) -> list[dict[str, Any]]:
    """Rows as plain values; what is not known is None."""
    columns = {name: _plain(table[name]) for name in table.colnames}
    return [{name: columns[name][row] for name in table.colnames} for row in range(len(table))]


def _plain(column: Any) -> list[Any]:
    masked = np.ma.getmaskarray(column) if hasattr(column, "mask") else np.zeros(len(column), bool)
    values = np.ma.getdata(column).tolist()
    return [
        None if hidden or (isinstance(value, float) and not np.isfinite(value)) else value
        for value, hidden in zip(values, masked, strict=True)
    ]


def _csv(table: Table) -> str:
    stream = io.StringIO()
    writer = csv.DictWriter(stream, table.colnames, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_rows(table))
    return stream.getvalue()
