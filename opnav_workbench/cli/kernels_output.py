"""Tables of the ``opnav kernels`` commands."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.filesize import decimal
from rich.markup import escape
from rich.table import Table

from opnav_workbench.spice import (
    FetchedKernels,
    KernelBrief,
    KernelSetInfo,
    brief,
    kernels_folder,
    load_manifest,
    manifest_missions,
    utc_from_et,
)

__all__ = ["plain_table", "print_brief", "print_fetched", "print_kernel_sets", "print_made", "short_utc"]

SHOWN_COMMENTS = 4
SHOWN_SPANS = 4
SHOWN_VARIABLES = 30
SHOWN_BODIES = 6


def plain_table(columns: Sequence[str], title: str | None = None) -> Table:
    """Return an empty table in the house style: no lines; words fold, times and numbers do not."""
    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for name in columns:
        table.add_column(name, overflow="fold", no_wrap=name.endswith("(UTC)") or name == "cover")
    return table


def short_utc(et: float) -> str:
    """Return a time to the second, as a person reads it; an LSK must be loaded."""
    return utc_from_et(et, 0).replace("T", " ")


def print_kernel_sets(console: Console, sets: Sequence[KernelSetInfo]) -> None:
    """Print what can be opened by name, and what can be fetched."""
    table = plain_table(("kernel set", "from (UTC)", "to (UTC)", "what"))
    for known in sets:
        about = known.description.partition(". ")[0]
        state = "" if known.built else " [dim](built on first use)[/]"
        table.add_row(known.name, known.start[:10], known.end[:10], escape(about) + state)
    console.print(table)
    console.print()
    table = plain_table(("flight kernels", "files", "here", "what"))
    for mission in manifest_missions():
        manifest, _ = load_manifest(mission)
        folder = kernels_folder(mission)
        here = sum((folder / kernel.file).is_file() for kernel in manifest.kernels)
        table.add_row(
            f"{mission}/flight", str(len(manifest.kernels)), str(here), escape(manifest.description)
        )
    console.print(table)
    console.print(
        "\nUse one by its name: --kernels NAME. Fetch flight kernels: opnav kernels fetch MISSION.",
        highlight=False,
    )


def print_fetched(console: Console, fetched: FetchedKernels) -> None:
    """Print what was fetched, what was trusted, and how to use it."""
    table = plain_table(("kind", "file", "size", "state"))
    table.columns[2].justify = "right"
    for item in fetched.kernels:
        state = "was here" if item.was_there else "[green]fetched[/]"
        digest = "[yellow]trusted, first time[/]" if item.trusted else "verified"
        table.add_row(item.kernel.kind, escape(item.kernel.file), decimal(item.size), f"{state}, {digest}")
    console.print(table)
    count = sum(item.trusted for item in fetched.kernels)
    if count:
        console.print(
            f"{count} of them {'has' if count == 1 else 'have'} no published digest: what came now is trusted, and "
            "its digest kept in manifest.lock.json; from now on every change is noticed.",
            highlight=False,
        )
    console.print(f"Metakernel: {escape(str(fetched.metakernel))}", highlight=False, soft_wrap=True)


def print_made(console: Console, files: Sequence[Path], metakernels: Sequence[Path]) -> None:
    """Print what was written and what it holds."""
    table = plain_table(("kind", "file", "size", "holds"))
    table.columns[2].justify = "right"
    for path in files:
        told = brief(path, [f for f in files if f.suffix in (".tsc", ".tf")])
        table.add_row(told.file.kind, escape(path.name), decimal(told.size), escape(_holds(told)))
    console.print(table)
    for metakernel in metakernels:
        console.print(f"Metakernel: {escape(str(metakernel))}", highlight=False, soft_wrap=True)


def _holds(told: KernelBrief) -> str:
    if not told.rows:
        return f"{len(told.variables)} variables"
    names = list(dict.fromkeys(row.name for row in told.rows))
    more = f" and {len(names) - SHOWN_BODIES} more" if len(names) > SHOWN_BODIES else ""
    spans = [span for row in told.rows for span in row.spans]
    first, last = (min(s for s, _ in spans)[:10], max(s for _, s in spans)[:10]) if spans else ("", "")
    when = f", {first} to {last}" if first != last else f", {first}" if first else ""
    notes = ", ".join(dict.fromkeys(row.note for row in told.rows if row.note))
    return ", ".join(names[:SHOWN_BODIES]) + more + when + (f", {notes}" if notes else "")


def print_brief(console: Console, told: KernelBrief) -> None:
    """Print what one kernel holds."""
    console.print(
        f"[bold]{escape(told.file.path.name)}[/]  {told.file.kind}  {decimal(told.size)}", highlight=False
    )
    for line in told.comments[:SHOWN_COMMENTS]:
        console.print(f"[dim]{escape(line)}[/]", highlight=False, overflow="ellipsis", no_wrap=True)
    if told.rows:
        console.print(_segments(told))
    if told.variables:
        console.print(_variables(told))
    for path in told.listed:
        here = "" if path.is_file() else "  [bold red]not there[/]"
        console.print(f"  {escape(str(path))}{here}", highlight=False, soft_wrap=True)


def _segments(told: KernelBrief) -> Table:
    timed = any(row.spans for row in told.rows)
    relative = {"SPK": "about", "DSK": "frame"}.get(told.file.kind, "relative to")
    table = plain_table(("of", relative, "type", *(("from (UTC)", "to (UTC)") if timed else ()), ""))
    for row in told.rows:
        name = row.name if row.name == str(row.number) else f"{row.name} ({row.number})"
        head = [escape(name), escape(row.relative_to), str(row.data_type)]
        spans = [[_plain_time(t) for t in span] for span in row.spans[:SHOWN_SPANS]] or [["", ""]]
        note = _segment_note(row.note, row.frame, len(row.spans))
        table.add_row(*head, *(spans[0] if timed else ()), escape(note))
        for span in spans[1:]:
            table.add_row("", "", "", *span, "")
    return table


def _segment_note(note: str, frame: str, n_spans: int) -> str:
    more = f"{n_spans - SHOWN_SPANS} more stretches" if n_spans > SHOWN_SPANS else ""
    return ", ".join(part for part in (frame, note, more) if part)


def _plain_time(text: str) -> str:
    return text.removesuffix(" UTC").replace("T", " ").partition(".")[0] if text.endswith("UTC") else text


def _variables(told: KernelBrief) -> Table:
    table = plain_table(("variable", "values", "first"))
    table.columns[1].justify = "right"
    for variable in told.variables[:SHOWN_VARIABLES]:
        table.add_row(escape(variable.name), str(variable.count), escape(variable.first))
    if len(told.variables) > SHOWN_VARIABLES:
        table.add_row(f"[dim]and {len(told.variables) - SHOWN_VARIABLES} more[/]", "", "")
    return table
