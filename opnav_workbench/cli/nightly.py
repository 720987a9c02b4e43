"""``opnav nightly``: the notebook of a picture for hundreds of them, each on its own, stopped and continued at will."""

import difflib
import os
import shlex
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from opnav_workbench import report
from opnav_workbench.cli.processing_options import processing_of, processing_options, with_options
from opnav_workbench.cli.terminal import EXIT_PARTLY, EXIT_STOPPED, ended_by_signals, named_progress, shown
from opnav_workbench.errors import SessionError, some_of
from opnav_workbench.headless.night import Night, NightPlan, check_place, plan_night, run_night
from opnav_workbench.headless.night_pages import SUMMARY_FILE, SUMMARY_PAGE
from opnav_workbench.headless.night_psf import MAX_PICTURES, learn_night_psf
from opnav_workbench.headless.night_spec import NightSpec, load_night
from opnav_workbench.headless.night_summary import (
    NOT_PROCESSED,
    night_summary_dict,
    not_archived,
    write_night_summary,
)
from opnav_workbench.headless.night_workers import ClusterPool, LocalPool, NightPool, NotebookOutcome
from opnav_workbench.headless.watching import NightWatch
from opnav_workbench.image.picture_files import NoPictures
from opnav_workbench.parts import need

__all__ = ["nightly"]

YAML_SUFFIXES = (".yaml", ".yml")
STATE_WORDS = {
    "new": "to be processed",
    "done": "done, nothing has changed",
    "older": "done with other inputs, left alone (--only-new)",
    "kept": "left to its analyst",
    "arriving": "not now: still being written, or tried a moment ago",
}
RETRY_AFTER_S = 1800.0  # while more pictures are watched for
QUIET_S = 10.0  # a file that is being copied is written to more often than this
NOTIFY_S = 60.0
wait = time.sleep  # between two looks
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
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Process again what failed, whatever the reason.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Process all again; analysts' sessions are left alone.")
    ] = False,
    pages: Annotated[
        str | None,
        typer.Option(
            help="Notebooks written as HTML, too: flagged | all | none; default those that need a person.",
            show_default=False,
        ),
    ] = None,
    cold: Annotated[
        bool,
        typer.Option(
            "--cold", help="A new Python for every picture: the same results, two to three times slower."
        ),
    ] = False,
    why: Annotated[
        str | None,
        typer.Option(help="Only tell why this picture would be processed, or not.", show_default=False),
    ] = None,
    archive: Annotated[
        Path | None, typer.Option(help="Campaign archive; default OUT/campaign.sqlite.", show_default=False)
    ] = None,
    log: Annotated[Path | None, typer.Option(help="Log; default OUT/night.log.", show_default=False)] = None,
    watch: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            help="Look for more every so many seconds until stopped; files still being written are let be.",
            show_default=False,
        ),
    ] = None,
    notify: Annotated[
        str | None,
        typer.Option(
            help="Program to run after pictures were processed; it is given summary.json.", show_default=False
        ),
    ] = None,
) -> None:
    """Process many pictures headless: the notebook of each, an archive, and a page that tells what came out.

    [bold]Examples[/]

      opnav nightly "incoming/lor_*.fit" --mission new_horizons --kernels flight.tm --out night

      opnav nightly night.yaml --jobs 8 --out night

    Each picture has its folder in OUT, as of opnav process, with the executed notebook beside it; OUT has summary.html,
    summary.json, queue.json and campaign.sqlite.

    Run again, it goes on where it stopped: what is done is not done twice, what the machine failed is tried again, and
    an analyst's session is left alone. A picture is done again when its file, its options, its catalog or a kernel that
    covers it has other content.

    Four or more pictures of an undersampled camera first teach the night one effective PSF, kept in OUT/.psf and used by all
    of them (in a night file, learn_psf: false prevents it); opnav process -m takes the mission.yaml there, too.

    While it runs, OUT has night.log, status.json and night.prom (Prometheus); without a terminal a line a minute tells
    how it goes.

    Exit status: 0 all pictures processed now are solved, 2 bad input, 3 some of them failed or could not be archived (the
    others are kept), 130 or 143 stopped by Ctrl-C or SIGTERM (what is finished is kept, and in the summary).
    """
    how = {"pages": pages} if pages else {}
    spec = _night_spec(sources, given).changed("options", **how | ({"warm": False} if cold else {}))
    if why is None:
        need("lab", "a night runs a notebook for each picture: opnav nightly")
    console = Console(stderr=True, soft_wrap=True)
    plan = partial(
        plan_night if why is not None else partial(_learned_and_planned, console),
        spec,
        out,
        only_new=only_new,
        force=force,
        retry_failed=retry_failed,
        quiet_s=QUIET_S if watch else 0.0,
    )
    if why is not None:
        _print_why(Console(soft_wrap=True), plan(), why)
        return
    night = partial(
        _whole_night,
        console,
        pool=partial(_pool, console, scheduler, jobs, warm=spec.warm),
        archive=archive,
        log=log,
    )
    if watch is None:
        with ended_by_signals():  # of many pictures learning and planning take minutes
            planned = plan()
        status = night(planned, notify=notify)
    else:
        status = _watch(console, plan, night, watch, notify)
    if status:
        raise typer.Exit(status)


def _learned_and_planned(console: Console, spec: NightSpec, out: Path, **choice: Any) -> NightPlan:
    """Plan a night that has learned the PSF of its undersampled cameras, where it can."""
    check_place(out)  # before anything is written there
    with named_progress(console, MAX_PICTURES) as say:
        learned = learn_night_psf(spec, out, say)
    for one in learned:
        console.print(shown(one.words), highlight=False)
    return plan_night(spec, out, **choice)


def _pool(console: Console, scheduler: str | None, jobs: int | None, *, warm: bool) -> NightPool:
    def notice(words: str) -> None:
        console.print(shown(words), highlight=False)

    if scheduler:
        return ClusterPool(scheduler, notice)
    return LocalPool(os.cpu_count() or 1 if jobs is None else jobs, warm=warm, notice=notice)


def _whole_night(
    console: Console,
    plan: NightPlan,
    *,
    pool: Callable[[], NightPool],
    archive: Path | None,
    log: Path | None,
    notify: str | None,
) -> int:
    """Process what is planned, and tell of it; return the exit status."""
    _print_plan(console, plan)
    summary, stopped = _run_plan(console, plan, pool(), archive, log)
    _print_summary(Console(soft_wrap=True), summary, plan.out)
    if notify and summary["processed_now"]:
        _notify(console, notify, plan.out / SUMMARY_FILE)
    wanting = summary["failed_now"] or summary["not_archived_now"]
    return stopped or (EXIT_PARTLY if wanting else 0)


def _notify(console: Console, command: str, summary: Path) -> None:
    """Run somebody's program; what becomes of it is theirs, but a word on it is said."""
    words = [*shlex.split(command), str(summary)]
    try:
        ended = str(subprocess.run(words, check=False, timeout=NOTIFY_S).returncode)  # noqa: S603
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        ended = f"{type(error).__name__}: {error}"
    if ended != "0":
        console.print(f"[yellow]note[/] --notify {shown(command)}: {shown(ended)}", highlight=False)


def _watch(
    console: Console,
    plan: Callable[..., NightPlan],
    night: Callable[..., int],
    every_s: float,
    notify: str | None,
) -> int:
    """Process what comes until the program is told to end; return the exit status of that."""
    once: dict[str, bool] = {}
    tried: dict[tuple[str, str], float] = {}
    try:
        with ended_by_signals():
            while True:
                with suppress(NoPictures):  # none has come yet
                    planned = _not_again(plan(**once), tried)
                    if planned.todo:
                        status = night(planned, notify=notify)
                        if status > EXIT_PARTLY:
                            return status
                        once = {"force": False, "retry_failed": False}  # what was asked for is done
                wait(every_s)
    except KeyboardInterrupt as stop:
        console.print(f"stopped ({str(stop) or 'Ctrl-C'}); what is finished is kept.", highlight=False)
        return getattr(stop, "status", EXIT_STOPPED)


def _not_again(plan: NightPlan, tried: dict[tuple[str, str], float]) -> NightPlan:
    """Put off what was tried a moment ago and is as it was: what the machine failed then it fails now."""
    now = time.monotonic()
    pictures = []
    for picture in plan.pictures:
        key = (picture.name, picture.fingerprint)
        if picture.state == "new" and now < tried.get(key, -RETRY_AFTER_S) + RETRY_AFTER_S:
            pictures.append(replace(picture, state="arriving"))
            continue
        if picture.state == "new":
            tried[key] = now
        pictures.append(picture)
    return replace(plan, pictures=tuple(pictures))


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
            ("arriving", "not now"),
        )
        if state in states
    ]
    aside = f" ({', '.join(told)})" if told else ""
    console.print(f"{len(plan.todo)} of {len(plan.pictures)} pictures to process{aside}.", highlight=False)


def _print_why(console: Console, plan: NightPlan, wanted: str) -> None:
    """Tell what would be done with a picture, named by its folder, file or path, and why."""
    found = [
        p for p in plan.pictures if wanted in (p.name, p.image.name, str(p.image)) or p.image == Path(wanted)
    ]
    if not found:
        names = [picture.name for picture in plan.pictures]
        close = difflib.get_close_matches(wanted, names, n=3) or names[:3]
        raise SessionError(f"no picture {wanted} in this night; there are {', '.join(close)}, ...")
    for picture in found:
        console.print(f"{shown(picture.name)}: {STATE_WORDS[picture.state]}", highlight=False)
        for reason in picture.why:
            console.print(f"  {shown(reason)}", highlight=False)


def _run_plan(
    console: Console, plan: NightPlan, pool: NightPool, archive: Path | None, log: Path | None
) -> tuple[dict[str, Any], int]:
    """Process with progress; the summary is written whatever ends it. Returns it, and the exit status of a stop."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    night, status = Night(plan), 0
    heartbeat = None if console.is_terminal else lambda words: console.print(shown(words), highlight=False)
    watch = NightWatch(plan, log, heartbeat)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pictures", total=len(plan.todo))

        def say(verdict: NotebookOutcome) -> None:
            progress.advance(task)
            watch.said(verdict)
            if verdict.fault:
                console.print(
                    f"[bold red]failed:[/] {shown(f'{verdict.name}: {verdict.reason}')}", highlight=False
                )

        with ended_by_signals() as pass_over:
            try:
                with watch:
                    run_night(night, pool, archive=archive, say=say, begun=watch.begin)
                    for line in not_archived(night):
                        watch.note(f"not in the archive: {line}")
            except KeyboardInterrupt as stop:
                status = getattr(stop, "status", EXIT_STOPPED)
                console.print(
                    f"stopped ({str(stop) or 'Ctrl-C'}); what is finished is kept.", highlight=False
                )
            finally:
                pass_over()
                if watch.fault:
                    console.print(f"[yellow]note[/] {shown(watch.fault)}", highlight=False)
                # Where another night runs, the summary is that one's.
                summary = write_night_summary(night) if night.begun else night_summary_dict(night)
    return summary, status


def _print_summary(console: Console, summary: Mapping[str, Any], out: Path) -> None:
    counts = summary["counts"]
    words = [("ok", "green"), ("partial", "yellow"), ("failed", "bold red")]
    words += [("waiting", "yellow")] if "waiting" in counts else []
    console.print(
        ", ".join(f"[{style}]{counts.get(status, 0)} {status}[/]" for status, style in words), highlight=False
    )
    left = [row["name"] for row in summary["images"] if row["state"] == "waiting"]
    if left:
        console.print(f"[yellow]{NOT_PROCESSED}:[/] {shown(some_of(left))}", highlight=False)
    causes = report.night_causes(summary["images"])
    for cause in causes[:SHOWN]:
        row, count = cause.rows[0], len(cause.rows)
        others = f" and {count - 1} more like it" if count > 1 else ""
        said = f"{row['name']} ({row['status']}){others}: {cause.reason}"
        console.print(f"[yellow]needs an analyst[/] {shown(said)}", highlight=False)
    if len(causes) > SHOWN:
        console.print(f"... and {len(causes) - SHOWN} more reasons, on the page.", highlight=False)
    for note in summary["notes"]:
        console.print(f"[yellow]note[/] {shown(note)}", highlight=False)
    for reason in summary["not_archived"]:
        console.print(f"[yellow]not in the archive[/] {shown(reason)}", highlight=False)
    console.print(f"Page: {shown(str(out / SUMMARY_PAGE))}", highlight=False)
    if causes:
        console.print(f"Next: opnav lab --queue {shown(str(out))}", highlight=False)
