"""``opnav nightly``: the notebook of a picture for hundreds of them, each on its own, stopped and continued at will."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from opnav_workbench.cli.processing_options import processing_of, processing_options, with_options
from opnav_workbench.cli.terminal import EXIT_PARTLY
from opnav_workbench.errors import SessionError
from opnav_workbench.headless.night import Night, NightPlan, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec, load_night
from opnav_workbench.headless.night_summary import SUMMARY_PAGE, write_night_summary
from opnav_workbench.headless.night_workers import ClusterPool, LocalPool, NightPool, NotebookOutcome

__all__ = ["nightly"]

YAML_SUFFIXES = (".yaml", ".yml")
SHOWN = 20  # reasons printed; the page has all


@processing_options()
def nightly(
    sources: Annotated[
        list[str],
        typer.Argument(
            help="A night file (YAML), or pictures: files, folders, quoted patterns.", show_default=False
        ),
    ],
    given: dict[str, Any],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("night"),
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", help="Pictures at a time; default one a core.", show_default=False),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler; its workers see the same folders.", show_default=False
        ),
    ] = None,
    only_new: Annotated[
        bool, typer.Option("--only-new", help="Leave pictures alone that were processed before.")
    ] = False,
    archive: Annotated[
        Path | None, typer.Option(help="Campaign archive; default OUT/campaign.sqlite.", show_default=False)
    ] = None,
) -> None:
    """Process many pictures headless: the notebook of each, an archive, and a page that tells what came out.

    [bold]Examples[/]

      opnav nightly "incoming/lor_*.fit" --mission new_horizons --kernels flight.tm --out night

      opnav nightly night.yaml --jobs 8 --out night

    Each picture has its folder in OUT, as of opnav process, with the executed notebook beside it; OUT has summary.html,
    summary.json, queue.json and campaign.sqlite.

    Run again, it goes on where it stopped: what is done is not done twice, and an analyst's session is left alone.

    Exit status: 0 all pictures solved, 2 bad input, 3 some pictures failed (the others are kept).
    """
    spec = _night_spec(sources, given)
    console = Console(stderr=True, soft_wrap=True)
    plan = plan_night(spec, out, only_new=only_new)
    _print_plan(console, plan)
    pool: NightPool = (
        ClusterPool(scheduler) if scheduler else LocalPool(os.cpu_count() or 1 if jobs is None else jobs)
    )
    summary = _run_plan(console, plan, pool, archive)
    _print_summary(Console(soft_wrap=True), summary, out)
    if summary["counts"].get("failed"):
        raise typer.Exit(EXIT_PARTLY)


def _night_spec(sources: list[str], given: Mapping[str, Any]) -> NightSpec:
    """Build the night from its file, or from pictures; options outrank the file."""
    files = [source for source in sources if source.lower().endswith(YAML_SUFFIXES)]
    if not files:
        how = processing_of(given).with_full_paths()
        return NightSpec.checked({**dict(how), "images": tuple(sources)}, "night")
    if len(sources) > 1:
        raise SessionError(f"give one night file alone, or pictures; got {', '.join(sources)}.")
    return with_options(load_night(files[0]), given)


def _print_plan(console: Console, plan: NightPlan) -> None:
    states = [picture.state for picture in plan.pictures]
    told = [
        f"{states.count(state)} {words}"
        for state, words in (
            ("done", "done before"),
            ("older", "done before with other inputs"),
            ("kept", "left to their analyst"),
        )
        if state in states
    ]
    aside = f" ({', '.join(told)})" if told else ""
    console.print(f"{len(plan.todo)} of {len(plan.pictures)} pictures to process{aside}.", highlight=False)


def _run_plan(console: Console, plan: NightPlan, pool: NightPool, archive: Path | None) -> dict[str, Any]:
    """Process with progress; the summary is written whatever ends it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    night = Night(plan)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pictures", total=len(plan.todo))

        def say(verdict: NotebookOutcome) -> None:
            progress.advance(task)
            if verdict.fault:
                console.print(
                    f"[bold red]failed:[/] {escape(f'{verdict.name}: {verdict.reason}')}", highlight=False
                )

        try:
            run_night(night, pool, archive=archive, say=say)
        finally:
            summary = write_night_summary(night)
    return summary


def _print_summary(console: Console, summary: Mapping[str, Any], out: Path) -> None:
    counts = summary["counts"]
    words = (("ok", "green"), ("partial", "yellow"), ("failed", "bold red"))
    console.print(
        ", ".join(f"[{style}]{counts.get(status, 0)} {status}[/]" for status, style in words), highlight=False
    )
    waiting = [row for row in summary["images"] if row["attention"]]
    for row in waiting[:SHOWN]:
        said = f"{row['name']} ({row['status']}): {'; '.join(row['attention'])}"
        console.print(f"[yellow]needs an analyst[/] {escape(said)}", highlight=False)
    if len(waiting) > SHOWN:
        console.print(f"... and {len(waiting) - SHOWN} more, on the page.", highlight=False)
    for reason in summary["not_archived"]:
        console.print(f"[yellow]not in the archive[/] {escape(reason)}", highlight=False)
    console.print(f"Page: {escape(str(out / SUMMARY_PAGE))}", highlight=False)
    if waiting:
        console.print(f"Next: opnav lab --queue {escape(str(out))}", highlight=False)
