"""``opnav kernels check`` as a person reads it: the eight kinds, windows as bars, gaps and overlaps, what is missing."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from opnav_workbench.arrays import FloatArray
from opnav_workbench.cli.kernels_output import plain_table, short_utc
from opnav_workbench.spice import CoverageRow, KernelCheck
from opnav_workbench.spice.timeline import covered_share

__all__ = ["print_check"]

OTHER_COLUMNS = 78  # characters of the coverage table beside its bars
SHORTEST_BAR, LONGEST_BAR = 6, 60  # at 80 columns a frame such as NH_SPACECRAFT still fits beside it
MINUTES = 16  # characters of a time to the minute
FULL, PART, EMPTY, HERE = "█", "▒", "·", "┃"
ALL_BUT = 0.999  # a cell covered this far is drawn full: windows end within a second of each other
SHOWN_FILES = 3
SHOWN_NAMES = 4  # of bodies that share a gap, or that nobody asked about
SHOWN_STRETCHES = 2  # gaps or overlaps of one row: those nearest to the time asked, or else the longest
DAY_S, HOUR_S, MINUTE_S = 86_400.0, 3_600.0, 60.0


def print_check(console: Console, check: KernelCheck) -> None:
    """Print a check; the LSK must be at hand for the times."""
    console.print(_kinds(check))
    if check.rows:
        console.print()
        axis = check.axis_et()
        console.print(_coverage(check, axis, console.width))
        console.print(
            f"[dim]bars: {short_utc(axis[0])} to {short_utc(axis[1])} UTC{_mark_words(check)}[/]",
            highlight=False,
        )
    if unasked := _unasked(check):
        console.print(f"[dim]{escape(unasked)}[/]", highlight=False)
    _print_stretches(console, check)
    console.print()
    for problem in check.problems:
        console.print(f"[bold red]missing[/] {escape(problem)}", highlight=False, soft_wrap=True)
    if check.ok:
        served = "" if check.et is None else f", and {short_utc(check.et)} UTC is served"
        console.print(f"[green]All eight kinds are there{served}.[/]", highlight=False)


def _mark_words(check: KernelCheck) -> str:
    return "" if check.et is None else f"; {HERE} {short_utc(check.et)}"


def _kinds(check: KernelCheck) -> Table:
    table = plain_table(("kind", "files"))
    for kind in check.kinds:
        table.add_row(kind.kind, _files(kind.files) if kind.files else "[bold red]missing[/]")
    others = [k.path for k in check.kernels if k.kind in ("DSK", "TEXT", "EK")]
    if others:
        table.add_row("other", _files(others))
    return table


def _files(paths: Sequence[Path]) -> str:
    more = f" [dim]and {len(paths) - SHOWN_FILES} more[/]" if len(paths) > SHOWN_FILES else ""
    return escape(", ".join(p.name for p in paths[:SHOWN_FILES])) + more


def _coverage(check: KernelCheck, axis: tuple[float, float], width: int) -> Table:
    cells = int(np.clip(width - OTHER_COLUMNS, SHORTEST_BAR, LONGEST_BAR))
    table = plain_table(("kind", "of", "from (UTC)", "to (UTC)", "cover"))
    if check.et is not None:
        table.add_column("then", no_wrap=True)
    last = ""
    for row in (row for row in check.rows if row.needed):
        ends = [
            short_utc(t)[:MINUTES] for t in (row.windows_et[[0, -1], [0, 1]] if len(row.windows_et) else ())
        ]
        cells_of = ["" if row.kind == last else row.kind, escape(row.name), *(ends or ("–", "–"))]
        then = [] if check.et is None else [_then(row, check.et)]
        table.add_row(*cells_of, _bar(row, axis, cells, check.et), *then)
        last = row.kind
    return table


def _unasked(check: KernelCheck) -> str:
    names = [row.name for row in check.rows if not row.needed]
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    return f"also there: {', '.join(names[:SHOWN_NAMES])}{more}" if names else ""


def _then(row: CoverageRow, et: float) -> str:
    return "[green]yes[/]" if row.covers(et) else "[bold red]no[/]"


def _bar(row: CoverageRow, axis: tuple[float, float], cells: int, et: float | None) -> Text:
    edges = np.linspace(*axis, cells + 1)
    share = covered_share(row.windows_et, edges)
    begun = np.array(
        [
            bool(((row.windows_et[:, 0] < stop) & (row.windows_et[:, 1] >= start)).any())
            for start, stop in pairwise(edges)
        ]
    )
    signs = np.where(share > ALL_BUT, FULL, np.where(begun, PART, EMPTY)).tolist()
    bar = Text("".join(signs), style="cyan")
    if et is not None and axis[0] <= et <= axis[1]:
        here = min(int((et - axis[0]) / (axis[1] - axis[0]) * cells), cells - 1)
        bar = Text.assemble(
            ("".join(signs[:here]), "cyan"), (HERE, "bold yellow"), ("".join(signs[here + 1 :]), "cyan")
        )
    return bar


def _print_stretches(console: Console, check: KernelCheck) -> None:
    """Name the gaps and overlaps worth a person's look, those of what was asked about only."""
    found: dict[str, list[str]] = {}
    for row in check.rows:
        for words in _stretches(row, check.et) if row.needed else ():
            found.setdefault(words, []).append(row.name)
    if found:
        console.print()
    for words, names in found.items():
        more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
        text = words.format(escape(", ".join(names[:SHOWN_NAMES]) + more))
        console.print(text, highlight=False, soft_wrap=True)


def _stretches(row: CoverageRow, et: float | None) -> Iterator[str]:
    for start, stop in _chosen(row.gaps_et, et):
        yield f"[yellow]gap[/]     {row.kind} of {{}}: {_stretch(start, stop)}"
    for start, stop in _chosen(row.overlaps_et, et):
        winner = row.files_at(0.5 * (start + stop))[-1].name
        yield f"overlap {row.kind} of {{}}: {_stretch(start, stop)}, {escape(winner)} wins"


def _stretch(start: float, stop: float) -> str:
    return f"{short_utc(start)} to {short_utc(stop)} ({_length(stop - start)})"


def _chosen(stretches: FloatArray, et: float | None) -> list[tuple[float, float]]:
    if et is None:
        order = np.argsort(stretches[:, 0] - stretches[:, 1], kind="stable")
    else:
        away = np.maximum(stretches[:, 0] - et, et - stretches[:, 1])
        order = np.argsort(np.maximum(away, 0.0), kind="stable")
    return [(float(a), float(b)) for a, b in stretches[np.sort(order[:SHOWN_STRETCHES])]]


def _length(seconds: float) -> str:
    for unit, size in (("d", DAY_S), ("h", HOUR_S), ("min", MINUTE_S)):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} s"
