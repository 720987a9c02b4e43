"""``opnav campaign``: many runs in one archive, questions to it, its observables, its trends, and stacks of its pictures.

ingest  takes runs into the archive; damaged ones are named and skipped (exit status 3)
query   pictures, pointings, bodies, stars, decisions, journal, provenance or history as a table, CSV or JSON
export  observables as one file
plot    trends, with outliers named
compare two nights or kernel sets: how far the same pictures' answers moved, in sigmas
serve   the archive in a browser
prune   a night's folder made smaller by age
stack   many solved pictures of a faint target as one
"""

import csv
import io
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from astropy.table import Table
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table as Printed

from opnav_workbench import report
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.campaign import (
    ARCHIVE_FILE,
    Campaign,
    Comparison,
    Ingested,
    IngestReport,
    Trends,
    trends,
)
from opnav_workbench.campaign import compare as compare_archives
from opnav_workbench.campaign.archive import EXPORT_FORMATS, export_observables
from opnav_workbench.campaign.queries import QUESTIONS
from opnav_workbench.campaign.run_folder import find_runs
from opnav_workbench.campaign.stacking import (
    Growth,
    Stacked,
    StackProducts,
    find_in_stack,
    pictures_of_runs,
    snr_growth,
    stack_pictures,
    write_stack,
)
from opnav_workbench.cli.campaign_prune import prune_night
from opnav_workbench.cli.campaign_serve import serve
from opnav_workbench.cli.terminal import EXIT_PARTLY, named_progress, shown
from opnav_workbench.errors import SessionError, counted
from opnav_workbench.files import json_text, plain_cell, write_text
from opnav_workbench.kernels import KernelSet

__all__ = ["campaign_app", "stack"]


# ---- What ``opnav campaign`` prints and writes.

SHOWN_DIFFERENCES = 24  # rows on the terminal
OUTPUT_FORMATS = ("table", "csv", "json")
STATUS_STYLES = {
    "ok": "green",
    "used": "green",
    "partial": "yellow",
    "uncertain": "yellow",
    "failed": "bold red",
}
# A row of an answer, as people call it.
ROW_NOUNS = {
    "images": "picture",
    "pointings": "pointing",
    "bodies": "target",
    "stars": "star",
    "differences": "difference",
    "decisions": "decision",
    "journal": "step",
    "provenance": "picture",
    "history": "older answer",
}
# What a terminal has room for: heading, column, format.
SHOWN_COLUMNS: dict[str, tuple[tuple[str, str, str], ...]] = {
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
    "differences": (
        ("picture", "image", ""),
        ("of", "what", ""),
        ("axis", "axis", ""),
        ("moved", "moved", "+.3g"),
        ("", "unit", ""),
        ("sigma", "sigma", ".2g"),
        ("sigmas", "sigmas", ".2f"),
    ),
    "decisions": (
        ("picture", "image", ""),
        ("subject", "subject", ""),
        ("verdict", "verdict", ""),
        ("reason", "reason", ""),
    ),
    "journal": (
        ("picture", "image", ""),
        ("when (UTC)", "time_utc", ""),
        ("step", "step", ""),
        ("outcome", "outcome", ""),
        ("reason", "reason", ""),
    ),
    "provenance": (
        ("picture", "image", ""),
        ("version", "version", ""),
        ("catalog", "catalog", ""),
        ("attitude", "attitude_source", ""),
        ("observer", "observer_source", ""),
    ),
    "history": (
        ("picture", "image", ""),
        ("status", "status", ""),
        ("made (UTC)", "processed_utc", ""),
        ("replaced (UTC)", "ingested_utc", ""),
        ("folder", "folder", ""),
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
        task = progress.add_task(", ".join(shown(str(run)) for run in runs), total=None)

        def advance(item: Ingested) -> None:
            progress.update(task, advance=1, description=shown(item.folder.name))
            if item.result == "skipped":
                console.print(
                    f"[bold red]skipped:[/] {shown(str(item.folder))}: {shown(item.reason)}",
                    highlight=False,
                )

        yield advance


def print_ingested(console: Console, ingested: IngestReport, archive: Path) -> None:
    """Print what became of the runs, in one line."""
    words = {
        "new": "new",
        "replaced": "replaced an older run",
        "unchanged": "unchanged",
        "older": "older than what stands",
        "skipped": "skipped",
    }
    counts = [f"{ingested.count(what)} {said}" for what, said in words.items() if ingested.count(what)]  # type: ignore[arg-type]
    number = "1 run" if len(ingested.results) == 1 else f"{len(ingested.results)} runs"
    console.print(f"{number}: {', '.join(counts)}", highlight=False)
    console.print(f"Archive: {shown(str(archive))}", highlight=False)


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
        console = Console(soft_wrap=True)
        console.print(f"{_rows_told(len(table), what)} in {shown(str(out))}", highlight=False)


def print_outliers(console: Console, found: Trends) -> None:
    """Name the pictures that are off a trend."""
    for image, series, deviation in found.outliers():
        console.print(
            f"[yellow]outlier[/] {shown(image)}: {shown(series)} is {deviation:+.1f} robust sigmas off",
            highlight=False,
        )


def _rows_told(count: int, what: str) -> str:
    noun = ROW_NOUNS[what]
    return counted(count, noun) if count else f"no {noun}s"


def _print_table(what: str, table: Table) -> None:
    console = Console(soft_wrap=False)
    if len(table) == 0:  # headings alone say nothing
        console.print(_rows_told(0, what), highlight=False)
        return
    shown = SHOWN_COLUMNS[what]
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
    console.print(_rows_told(len(table), what), highlight=False)


def _cell(value: Any, form: str) -> str:
    if value is None or value == "":
        return "–" if form else ""
    if form:
        return format(value, form)
    text = str(value).partition(".")[0].replace("T", " ") if _is_time(value) else str(value)
    style = STATUS_STYLES.get(text)
    return (
        f"[{style}]{shown(text)}[/]"
        if style
        else shown(text.replace("_", " ") if text in STATUS_STYLES else text)
    )


def _is_time(value: Any) -> bool:
    text = str(value)
    return len(text) >= 19 and text[4:5] == "-" and text[10:11] == "T"


def _rows(table: Table) -> list[dict[str, Any]]:
    """Rows as plain values; what is not known is None."""
    columns = {name: _plain_values(table[name]) for name in table.colnames}
    return [{name: columns[name][row] for name in table.colnames} for row in range(len(table))]


def _plain_values(column: Any) -> list[Any]:
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
    writer.writerows(
        {k: plain_cell(v) if isinstance(v, str) else v for k, v in row.items()} for row in _rows(table)
    )
    return stream.getvalue()


# ---- ``opnav campaign stack``: many solved pictures of a faint target as one.

CENTER_STYLES = {"ok": "green", "uncertain": "yellow"}


def stack(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Run folders of solved pictures, or folders of them.", show_default=False),
    ],
    target: Annotated[
        str | None,
        typer.Option(
            "--target", "-t", help="Body whose motion is followed; none: the stars.", show_default=False
        ),
    ] = None,
    kernels: Annotated[
        str | None,
        typer.Option(help="Kernels, for a target that the runs have not met.", show_default=False),
    ] = None,
    subtract_stars: Annotated[
        bool,
        typer.Option("--subtract-stars", help="Take the star field away, as the other pictures show it."),
    ] = False,
    search_radius: Annotated[
        float, typer.Option(min=1.0, help="How far from its prediction the target may be, px.")
    ] = 3.0,
    window: Annotated[
        int | None,
        typer.Option(
            min=16,
            help="Side of the stacked part, px; default 64 about a target, else all.",
            show_default=False,
        ),
    ] = None,
    keep_hits: Annotated[
        bool, typer.Option("--keep-hits", help="Do not mask what is in one picture only.")
    ] = False,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the stack's own folder.")] = Path(
        "stacks"
    ),
) -> None:
    """Stack pictures for a target too faint for each of them.

    [bold]Example[/]

      opnav campaign stack run/c* --target CHARON --kernels new_horizons/pluto_opnav --out stacks

    Pictures are brought onto one grid by their solved pointings, distortion honoured, hits masked. Writes
    OUT/stack_.../ with the stack as FITS (picture, noise, pictures in each pixel), result.json, observables.ecsv and a
    figure; `opnav campaign ingest` takes that folder as it takes a picture's.
    """
    folders = list(dict.fromkeys(folder for run in runs for folder in find_runs(run)))
    console = Console(stderr=True, soft_wrap=True)
    with ExitStack() as opened:
        if kernels is not None:
            opened.enter_context(KernelSet(kernels))
        with named_progress(console, len(folders)) as say:
            pictures = pictures_of_runs(folders, target, lambda name: say(name, "taking up its session"))
        for run, reason in pictures.left_out:
            console.print(f"[yellow]left out[/] {shown(run)}: {shown(reason)}", highlight=False)
        with console.status("stacking") if console.is_terminal else ExitStack():
            stacked = stack_pictures(
                pictures.pictures,
                "stars" if target is None else "target",
                window_px=window,
                reject_hits=not keep_hits,
                subtract=subtract_stars,
            )
            center = (
                None if target is None else find_in_stack(stacked, target, search_radius_px=search_radius)
            )
        products = write_stack(
            stacked,
            center,
            out,
            mission=pictures.mission,
            reference_body=pictures.reference_body,
            left_out=pictures.left_out,
        )
    _write_figure(stacked, center, products)
    _print_stack(Console(soft_wrap=True), stacked, center, products)


def _write_figure(stacked: Stacked, center: BodyCenter | None, products: StackProducts) -> None:
    growth: Growth | None = None
    if center is not None and center.pixel_line is not None and stacked.subtractions is None:
        growth = snr_growth(stacked, center.pixel_line)
    figure = report.stack_figure(stacked, center, growth, products.folder.name)
    report.write_png(figure, products.picture.with_suffix(".png"))


def _print_stack(
    console: Console, stacked: Stacked, center: BodyCenter | None, products: StackProducts
) -> None:
    names = [picture.name for picture in stacked.pictures]
    console.print(
        f"{len(names)} pictures, {shown(names[0])} to {shown(names[-1])}, mean epoch "
        f"{products.result['utc']} UTC; {sum(stacked.hits)} pixels masked",
        highlight=False,
    )
    if center is not None:
        console.print(_center_words(center, products), highlight=False)
        _print_notes(console, center.messages)
    _print_notes(console, stacked.messages)
    console.print(f"Stack in {shown(str(products.folder))}/", highlight=False)


def _center_words(center: BodyCenter, products: StackProducts) -> str:
    status = f"[{CENTER_STYLES.get(center.status, 'bold red')}]{center.status.replace('_', ' ')}[/]"
    seen = products.observable
    if center.pixel_line is None or seen is None or seen.residual_px is None:
        return f"{shown(center.name)}: {status}"
    sigma = [seen.total_covariance_px2[i, i] ** 0.5 for i in (0, 1)]
    offsets = " and ".join(
        f"{value:+.3f} ± {error:.3f} px" for value, error in zip(seen.residual_px, sigma, strict=True)
    )
    return (
        f"{shown(center.name)}: {status}, SNR {center.snr:.1f}, pixel {center.pixel_line[0]:.3f}, line "
        f"{center.pixel_line[1]:.3f}, O−C {offsets}"
    )


def _print_notes(console: Console, messages: Sequence[str]) -> None:
    for message in messages:
        console.print(f"[yellow]note[/] {shown(message)}", highlight=False)


# ---- ``opnav campaign``.


campaign_app = typer.Typer(
    name="campaign",
    help="Many pictures: archive their runs, ask it, export observables, plot trends, stack faint targets.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

ArchiveOption = Annotated[Path, typer.Option("--archive", "-a", help="Archive file, or the folder it is in.")]
SinceOption = Annotated[
    str | None, typer.Option(help="From this UTC on, such as 2015-04-09.", show_default=False)
]
UntilOption = Annotated[
    str | None, typer.Option(help="Up to this UTC; a date holds its whole day.", show_default=False)
]
MissionOption = Annotated[str | None, typer.Option(help="Only of this mission.", show_default=False)]
CameraOption = Annotated[str | None, typer.Option(help="Only of this camera.", show_default=False)]
BodyOption = Annotated[
    str | None, typer.Option(help="Only of these bodies, comma-separated.", show_default=False)
]
MethodOption = Annotated[str | None, typer.Option(help="Only by these methods.", show_default=False)]
StatusOption = Annotated[str | None, typer.Option(help="Only with these statuses.", show_default=False)]
DEFAULT_ARCHIVE = Path(ARCHIVE_FILE)


@campaign_app.command()
def ingest(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, or folders of them.", show_default=False)],
    archive: ArchiveOption = DEFAULT_ARCHIVE,
) -> None:
    """Take runs into the archive; the same run twice changes nothing, a reprocessed picture replaces its older run.

    [bold]Example[/]

      opnav campaign ingest night1 night2 --archive campaign.sqlite

    Damaged runs are named and skipped. Exit status: 0 all taken in, 2 bad input, 3 some skipped.
    """
    with Campaign(archive) as campaign, ingest_progress(runs) as advance:
        ingested = campaign.ingest(runs, advance)
        where = campaign.path
    print_ingested(Console(soft_wrap=True), ingested, where)
    if ingested.skipped:
        raise typer.Exit(EXIT_PARTLY)


@campaign_app.command()
def query(
    what: Annotated[str, typer.Argument(help=" | ".join(QUESTIONS))] = "images",
    archive: ArchiveOption = DEFAULT_ARCHIVE,
    status: StatusOption = None,
    body: BodyOption = None,
    method: MethodOption = None,
    image: Annotated[str | None, typer.Option(help="Only of these pictures.", show_default=False)] = None,
    since: SinceOption = None,
    until: UntilOption = None,
    mission: MissionOption = None,
    camera: CameraOption = None,
    attention: Annotated[
        bool, typer.Option("--attention", help="Only pictures that need an analyst.")
    ] = False,
    format_: Annotated[str, typer.Option("--format", "-f", help=" | ".join(OUTPUT_FORMATS))] = "table",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write csv or json here.", show_default=False)
    ] = None,
) -> None:
    """Ask the archive for pictures, pointings, bodies or stars; for decisions, steps, provenance, and what stood before.

    [bold]Examples[/]

      opnav campaign query bodies --body PLUTO --status ok --since 2015-04-01 --format csv

      opnav campaign query history --image lor_0299.fit

    The table shows what fits a terminal; csv and json hold every column.
    """
    filters = {"status": status, "body": body, "method": method, "image": image}
    filters |= {"since": since, "until": until, "mission": mission, "camera": camera}
    if what not in QUESTIONS and Path(what).exists():  # other commands take a night as their argument
        raise SessionError(
            f"{what} is a place, no question; ask it so: opnav campaign query images --archive {what}."
        )
    with Campaign(archive, create=False) as campaign:
        table = campaign.query(what, **filters)
    if attention:
        if what != "images":
            raise SessionError(f"--attention chooses images; {what} have none.")
        table = table[table["attention"] != ""]
    print_answer(what, table, format_, out)


@campaign_app.command()
def export(
    out: Annotated[Path, typer.Argument(help="File to write.", show_default=False)],
    archive: ArchiveOption = DEFAULT_ARCHIVE,
    body: BodyOption = None,
    method: MethodOption = None,
    status: StatusOption = None,
    since: SinceOption = None,
    until: UntilOption = None,
    format_: Annotated[
        str | None,
        typer.Option("--format", "-f", help=" | ".join(EXPORT_FORMATS) + "; default by the file's name."),
    ] = None,
) -> None:
    """Export the observables of all pictures as one file.

    [bold]Example[/]

      opnav campaign export pluto.ecsv --body PLUTO --status ok
    """
    filters = {"body": body, "method": method, "status": status, "since": since, "until": until}
    with Campaign(archive, create=False) as campaign:
        count = export_observables(campaign, out, format_, **filters)
    Console(soft_wrap=True).print(f"{count} observables in {shown(str(out))}", highlight=False)


@campaign_app.command()
def plot(
    archive: ArchiveOption = DEFAULT_ARCHIVE,
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG to write.")] = Path("campaign.png"),
    body: BodyOption = None,
    method: MethodOption = None,
    since: SinceOption = None,
    until: UntilOption = None,
    mission: MissionOption = None,
    camera: CameraOption = None,
) -> None:
    """Plot trends: O-C of each body, pointing error, star residuals and detections; outliers are named.

    [bold]Example[/]

      opnav campaign plot --archive campaign.sqlite --body PLUTO,CHARON --out trends.png
    """
    filters = {"since": since, "until": until, "mission": mission, "camera": camera}
    with Campaign(archive, create=False) as campaign:
        found = trends(campaign, body=body, method=method, **filters)
        name = campaign.path.name
    report.write_png(report.trends_figure(found, name), out)
    console = Console(soft_wrap=True)
    print_outliers(console, found)
    console.print(f"Trends in {shown(str(out))}", highlight=False)


@campaign_app.command()
def compare(
    first: Annotated[
        Path, typer.Argument(help="Archive of a night, or the night's folder.", show_default=False)
    ],
    second: Annotated[
        Path,
        typer.Argument(help="Another, of the same pictures; told as second minus first.", show_default=False),
    ],
    above: Annotated[float, typer.Option(min=0.0, help="List what moved by more sigmas than this.")] = 1.0,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="PNG to write: what moved, over time.", show_default=False)
    ] = None,
    format_: Annotated[str, typer.Option("--format", "-f", help=" | ".join(OUTPUT_FORMATS))] = "table",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write csv or json here.", show_default=False)
    ] = None,
) -> None:
    """Compare two nights of the same pictures: with other kernels, another catalog, other options or another version.

    [bold]Example[/]

      opnav campaign compare night_old_spk night_new_spk --plot moved.png

    Pictures are matched by content. Differences of pointing (about the camera's axes) and of O-C are in sigmas of one such
    solution: both rest on the same pixels, so what nothing has changed does not move at all.
    """
    with Campaign(first, create=False) as one, Campaign(second, create=False) as other:
        found = compare_archives(one, other)
    moved = found.table(above)
    if format_ == "table" and out is None:
        console = Console(soft_wrap=True)
        _print_comparison(console, found)
        if len(moved):
            print_answer("differences", moved[:SHOWN_DIFFERENCES], format_, out)
            console.print(COMPARED, highlight=False)
        else:
            console.print(f"no difference above {above:g} sigma", highlight=False)
        if len(moved) > SHOWN_DIFFERENCES:
            console.print(f"the largest of {len(moved)}; --format csv gives all", highlight=False)
    else:
        print_answer("differences", moved, format_, out)
    if plot is not None:
        report.write_png(report.comparison_figure(found, f"{first} and {second}"), plot)
        Console(soft_wrap=True, stderr=True).print(f"Plot in {shown(str(plot))}", highlight=False)


COMPARED = (
    "moved: second minus first, pointing about the camera's axes; sigma: of one such solution; "
    "sigmas: of all axes of it together, with their correlations"
)


def _print_comparison(console: Console, found: Comparison) -> None:
    others = [
        f"{len(names)} only in the {which}"
        for which, names in (("first", found.only_first), ("second", found.only_second))
        if names
    ]
    console.print(", ".join([f"{found.pictures} pictures in both", *others]), highlight=False)
    for name, before, now in found.made_with:
        console.print(f"{shown(name)}: {shown(before)}, now {shown(now)}", highlight=False)
    changes = Counter((before, now) for _, before, now in found.statuses)
    for (before, now), count in changes.most_common():
        console.print(f"[yellow]status[/] {count} {shown(before)}, now {shown(now)}", highlight=False)
    kinds = Counter((what, before, now) for _, what, before, now in found.bodies)
    for (what, before, now), count in kinds.most_common():
        console.print(
            f"[yellow]status[/] {shown(what)}: {count} {shown(before)}, now {shown(now)}", highlight=False
        )
    for what in sorted({d.what for d in found.differences}):
        moved = np.array([d.sigmas for d in found.of(what)])
        console.print(
            f"{shown(what)}: {len(moved)} solved in both, moved by {np.nanmedian(moved):.2f} sigmas (median), "
            f"{np.nanmax(moved):.2f} at most"
            if np.isfinite(moved).any()
            else f"{shown(what)}: {len(moved)} solved in both, sigmas unknown",
            highlight=False,
        )


campaign_app.command()(serve)
campaign_app.command("prune")(prune_night)
campaign_app.command()(stack)
