"""What ``opnav kernels`` prints: kernel sets, fetched and made kernels, briefs, and the coverage that a check found.

Coverage stands as bars, with gaps and overlaps named; of many files, bodies or stretches the first, nearest or
longest are shown and the others counted. Times need an LSK at hand.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.filesize import decimal
from rich.table import Table
from rich.text import Text

from opnav_workbench.arrays import FloatArray
from opnav_workbench.cli.terminal import folding_table, shown
from opnav_workbench.constants import DAY_S, HOUR_S, MINUTE_S
from opnav_workbench.errors import some_of
from opnav_workbench.kernels import (
    CoverageRow,
    FetchedKernels,
    KernelBrief,
    KernelCheck,
    KernelSetInfo,
    brief,
    kernels_folder,
    load_manifest,
    manifest_missions,
    utc_from_et,
)
from opnav_workbench.kernels.coverage import covered_share
from opnav_workbench.paths import is_file

__all__ = ["print_brief", "print_check", "print_fetched", "print_kernel_sets", "print_made"]


# ---- Tables of the ``opnav kernels`` commands.

SHOWN_COMMENTS = 4
SHOWN_SPANS = 4
SHOWN_VARIABLES = 30
SHOWN_BODIES = 6


def short_utc(et: float) -> str:
    """Return a time to the second, as a person reads it; an LSK must be loaded."""
    return utc_from_et(et, 0).replace("T", " ")


def print_kernel_sets(console: Console, sets: Sequence[KernelSetInfo]) -> None:
    """Print what can be opened by name, and what can be fetched."""
    table = folding_table(("kernel set", "from (UTC)", "to (UTC)", "what"))
    for known in sets:
        about = known.description.partition(". ")[0]
        state = "" if known.built else " [dim](built on first use)[/]"
        table.add_row(known.name, known.start[:10], known.end[:10], shown(about) + state)
    console.print(table)
    console.print()
    table = folding_table(("flight kernels", "files", "here", "what"))
    for mission in manifest_missions():
        manifest, _ = load_manifest(mission)
        folder = kernels_folder(mission)
        here = sum((folder / kernel.file).is_file() for kernel in manifest.kernels)
        table.add_row(f"{mission}/flight", str(len(manifest.kernels)), str(here), shown(manifest.description))
    console.print(table)
    console.print(
        "\nUse one by its name: --kernels NAME. Fetch flight kernels: opnav kernels fetch MISSION.",
        highlight=False,
    )


def print_fetched(console: Console, fetched: FetchedKernels) -> None:
    """Print what was fetched, what was trusted, and how to use it."""
    table = folding_table(("kind", "file", "size", "state"))
    table.columns[2].justify = "right"
    for item in fetched.kernels:
        state = "was here" if item.already_present else "[green]fetched[/]"
        digest = "[yellow]trusted, first time[/]" if item.trusted else "verified"
        table.add_row(item.kernel.kind, shown(item.kernel.file), decimal(item.size), f"{state}, {digest}")
    console.print(table)
    count = sum(item.trusted for item in fetched.kernels)
    if count:
        console.print(
            f"{count} of them {'has' if count == 1 else 'have'} no published digest: what came now is trusted, and "
            "its digest kept in manifest.lock.json; from now on every change is noticed.",
            highlight=False,
        )
    console.print(f"Metakernel: {shown(str(fetched.metakernel))}", highlight=False, soft_wrap=True)


def print_made(console: Console, files: Sequence[Path], metakernels: Sequence[Path]) -> None:
    """Print what was written and what it holds."""
    table = folding_table(("kind", "file", "size", "holds"))
    table.columns[2].justify = "right"
    for path in files:
        told = brief(path, [f for f in files if f.suffix in (".tsc", ".tf")])
        table.add_row(told.file.kind, shown(path.name), decimal(told.size), shown(_content_words(told)))
    console.print(table)
    for metakernel in metakernels:
        console.print(f"Metakernel: {shown(str(metakernel))}", highlight=False, soft_wrap=True)


def _content_words(told: KernelBrief) -> str:
    if not told.rows:
        return f"{len(told.variables)} variables"
    names = list(dict.fromkeys(row.name for row in told.rows))
    spans = [span for row in told.rows for span in row.spans]
    first, last = (min(s for s, _ in spans)[:10], max(s for _, s in spans)[:10]) if spans else ("", "")
    when = f", {first} to {last}" if first != last else f", {first}" if first else ""
    notes = ", ".join(dict.fromkeys(row.note for row in told.rows if row.note))
    return some_of(names, SHOWN_BODIES) + when + (f", {notes}" if notes else "")


def print_brief(console: Console, told: KernelBrief) -> None:
    """Print what one kernel holds."""
    console.print(
        f"[bold]{shown(told.file.path.name)}[/]  {told.file.kind}  {decimal(told.size)}", highlight=False
    )
    for line in told.comments[:SHOWN_COMMENTS]:
        console.print(f"[dim]{shown(line)}[/]", highlight=False, overflow="ellipsis", no_wrap=True)
    if told.rows:
        console.print(_segment_table(told))
    if told.variables:
        console.print(_variable_table(told))
    for path in told.listed:
        here = "" if is_file(path) else "  [bold red]not there[/]"
        console.print(f"  {shown(str(path))}{here}", highlight=False, soft_wrap=True)


def _segment_table(told: KernelBrief) -> Table:
    timed = any(row.spans for row in told.rows)
    relative = {"SPK": "about", "DSK": "frame"}.get(told.file.kind, "relative to")
    table = folding_table(("of", relative, "type", *(("from (UTC)", "to (UTC)") if timed else ()), ""))
    for row in told.rows:
        name = row.name if row.name == str(row.number) else f"{row.name} ({row.number})"
        head = [shown(name), shown(row.relative_to), str(row.data_type)]
        spans = [[_plain_time(t) for t in span] for span in row.spans[:SHOWN_SPANS]] or [["", ""]]
        note = _segment_note(row.note, row.frame, len(row.spans))
        table.add_row(*head, *(spans[0] if timed else ()), shown(note))
        for span in spans[1:]:
            table.add_row("", "", "", *span, "")
    return table


def _segment_note(note: str, frame: str, n_spans: int) -> str:
    more = f"{n_spans - SHOWN_SPANS} more stretches" if n_spans > SHOWN_SPANS else ""
    return ", ".join(part for part in (frame, note, more) if part)


def _plain_time(text: str) -> str:
    return text.removesuffix(" UTC").replace("T", " ").partition(".")[0] if text.endswith("UTC") else text


def _variable_table(told: KernelBrief) -> Table:
    table = folding_table(("variable", "values", "first"))
    table.columns[1].justify = "right"
    for variable in told.variables[:SHOWN_VARIABLES]:
        table.add_row(shown(variable.name), str(variable.count), shown(variable.first))
    if len(told.variables) > SHOWN_VARIABLES:
        table.add_row(f"[dim]and {len(told.variables) - SHOWN_VARIABLES} more[/]", "", "")
    return table


# ---- ``opnav kernels check`` as a person reads it.

OTHER_COLUMNS = 78  # characters of the coverage table beside its bars
SHORTEST_BAR, LONGEST_BAR = 6, 60  # at 80 columns a frame such as NH_SPACECRAFT still fits beside it
MINUTES = 16  # characters of a time to the minute
FULL, PART, EMPTY, HERE = "█", "▒", "·", "┃"
ALL_BUT = 0.999  # a cell covered this far is drawn full: windows end within a second of each other
SHOWN_FILES = 3
SHOWN_NAMES = 4  # of bodies that share a gap, or that nobody asked about
SHOWN_STRETCHES = 2  # gaps or overlaps of one row: those nearest to the time asked, or else the longest


def print_check(console: Console, check: KernelCheck) -> None:
    """Print a check; the LSK must be at hand for the times."""
    console.print(_kind_table(check))
    if check.rows:
        console.print()
        axis = check.plot_span_et()
        console.print(_coverage_table(check, axis, console.width))
        console.print(
            f"[dim]bars: {short_utc(axis[0])} to {short_utc(axis[1])} UTC{_mark_words(check)}[/]",
            highlight=False,
        )
    if unasked := _unasked_names(check):
        console.print(f"[dim]{shown(unasked)}[/]", highlight=False)
    _print_stretches(console, check)
    console.print()
    for problem in check.problems:
        console.print(f"[bold red]missing[/] {shown(problem)}", highlight=False, soft_wrap=True)
    if check.ok:
        served = "" if check.et is None else f", and {short_utc(check.et)} UTC is served"
        console.print(f"[green]All eight kinds are there{served}.[/]", highlight=False)


def _mark_words(check: KernelCheck) -> str:
    return "" if check.et is None else f"; {HERE} {short_utc(check.et)}"


def _kind_table(check: KernelCheck) -> Table:
    table = folding_table(("kind", "files"))
    for kind in check.kinds:
        table.add_row(kind.kind, _file_names(kind.files) if kind.files else "[bold red]missing[/]")
    others = [k.path for k in check.kernels if k.kind in ("DSK", "TEXT", "EK")]
    if others:
        table.add_row("other", _file_names(others))
    return table


def _file_names(paths: Sequence[Path]) -> str:
    more = f" [dim]and {len(paths) - SHOWN_FILES} more[/]" if len(paths) > SHOWN_FILES else ""
    return shown(", ".join(p.name for p in paths[:SHOWN_FILES])) + more


def _coverage_table(check: KernelCheck, axis: tuple[float, float], width: int) -> Table:
    cells = int(np.clip(width - OTHER_COLUMNS, SHORTEST_BAR, LONGEST_BAR))
    table = folding_table(("kind", "of", "from (UTC)", "to (UTC)", "cover"))
    if check.et is not None:
        table.add_column("then", no_wrap=True)
    last = ""
    for row in (row for row in check.rows if row.needed):
        ends = [
            short_utc(t)[:MINUTES] for t in (row.windows_et[[0, -1], [0, 1]] if len(row.windows_et) else ())
        ]
        cells_of = ["" if row.kind == last else row.kind, shown(row.name), *(ends or ("–", "–"))]
        then = [] if check.et is None else [_covers_time(row, check.et)]
        table.add_row(*cells_of, _bar(row, axis, cells, check.et), *then)
        last = row.kind
    return table


def _unasked_names(check: KernelCheck) -> str:
    names = [row.name for row in check.rows if not row.needed]
    return f"also there: {some_of(names, SHOWN_NAMES)}" if names else ""


def _covers_time(row: CoverageRow, et: float) -> str:
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
        text = words.format(shown(some_of(names, SHOWN_NAMES)))
        console.print(text, highlight=False, soft_wrap=True)


def _stretches(row: CoverageRow, et: float | None) -> Iterator[str]:
    for start, stop in _chosen_stretches(row.gaps_et, et):
        yield f"[yellow]gap[/]     {row.kind} of {{}}: {_stretch(start, stop)}"
    for start, stop in _chosen_stretches(row.overlaps_et, et):
        winner = row.files_at(0.5 * (start + stop))[-1].name
        yield f"overlap {row.kind} of {{}}: {_stretch(start, stop)}, {shown(winner)} wins"


def _stretch(start: float, stop: float) -> str:
    return f"{short_utc(start)} to {short_utc(stop)} ({_duration(stop - start)})"


def _chosen_stretches(stretches: FloatArray, et: float | None) -> list[tuple[float, float]]:
    if et is None:
        order = np.argsort(stretches[:, 0] - stretches[:, 1], kind="stable")
    else:
        away = np.maximum(stretches[:, 0] - et, et - stretches[:, 1])
        order = np.argsort(np.maximum(away, 0.0), kind="stable")
    return [(float(a), float(b)) for a, b in stretches[np.sort(order[:SHOWN_STRETCHES])]]


def _duration(seconds: float) -> str:
    for unit, size in (("d", DAY_S), ("h", HOUR_S), ("min", MINUTE_S)):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} s"
