"""``opnav plan``: what the pictures of a sequence will show, how well they navigate, and which are worth taking.

Prints verdicts with reasons, stars and pointing, targets and first detections; writes table, page and charts.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench import report
from opnav_workbench.cli.terminal import picture_progress, plain_table, shown
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path, make_folder
from opnav_workbench.planning import (
    PicturePlan,
    Plan,
    TargetPlan,
    catalog_words,
    load_sequence,
    plan_sequence,
    sequence_names,
    write_plan,
)

__all__ = ["plan"]


# ---- What ``opnav plan`` prints: verdicts with reasons, stars and pointing, targets, first detections.

GRADE_STYLES = {"good": "green", "marginal": "yellow", "bad": "bold red"}
WIDE_COLUMNS = 120  # a terminal this wide has room for directions beside sigmas


def sequence_listing() -> Table:
    """Return the table of ready sequences."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("sequence", no_wrap=True)
    table.add_column("pictures", justify="right")
    table.add_column("searches", justify="right")
    table.add_column("what it plans")
    for name in sequence_names():
        content = load_sequence(name)
        words = " ".join(content.description.split())
        table.add_row(name, str(len(content.expanded())), str(len(content.search)), words)
    return table


def print_plan(console: Console, plan: Plan) -> None:
    """Print a plan as tables, and what stands out in words."""
    wide = console.width >= WIDE_COLUMNS
    if plan.pictures:
        console.print(_picture_table(plan.pictures, wide))
        rows = [(p.name, target) for p in plan.pictures if p.prediction for target in p.prediction.targets]
        if rows:
            console.print(_target_table(rows, wide))
            _print_limb_note(console, rows)
        _print_reasons(console, plan.pictures)
    for approach in plan.searches:
        search = approach.search
        head = f"[bold]{shown(search.name)}[/] ({shown(search.camera)}, {search.exposure_s:g} s)"
        lines = [approach.problem] if approach.problem else [d.words for d in approach.detections]
        for line in lines:
            console.print(f"{head}: {shown(line)}", highlight=False, soft_wrap=True)
    console.print(f"Catalog: {shown(catalog_words(plan))}", highlight=False, soft_wrap=True)
    counts = ", ".join(f"[{GRADE_STYLES[grade]}]{plan.count(grade)} {grade}[/]" for grade in GRADE_STYLES)
    console.print(f"Pictures: {counts}", highlight=False)


def _picture_table(pictures: Sequence[PicturePlan], wide: bool) -> Table:
    more = ("σ twist°", "mag", "limit", "Sun°", "RA°", "Dec°", "best s") if wide else ("σ twist°",)
    texts = ("picture", "UTC", "verdict")
    table = plain_table(
        "Pictures (stars and pointing)", texts, ("exp s", "stars", "σ pixel", "σ line", *more), first_width=14
    )
    for plan in pictures:
        grade = plan.verdict.grade
        utc = (plan.utc[:16] if wide else plan.utc[5:16]).replace("T", " ")
        head = (shown(plan.name), utc, f"[{GRADE_STYLES[grade]}]{grade}[/]")
        table.add_row(*head, f"{plan.picture.exposure_s:g}", *_picture_cells(plan)[: 3 + len(more)])
    return table


def _picture_cells(plan: PicturePlan) -> list[str]:
    p = plan.prediction
    if p is None:
        return ["–"] * 10
    usable, pointing = p.stars.mag[p.stars.usable], p.pointing
    mags = f"{usable.min():.1f}–{usable.max():.1f}" if len(usable) else "–"
    sigmas = ["–"] * 3
    if pointing is not None:
        sigmas = [*(_three_digits(s) for s in pointing.sigma_px), f"{pointing.twist_sigma_deg:.4f}"]
    best = "–" if p.best_exposure is None else _three_digits(p.best_exposure.best_s)
    sky = [f"{p.limit_mag:.1f}", f"{p.elongation_deg:.0f}", f"{p.ra_deg:.3f}", f"{p.dec_deg:+.3f}"]
    return [f"{len(usable)}/{len(p.stars)}", *sigmas, mags, *sky, best]


def _target_table(rows: Sequence[tuple[str, TargetPlan]], wide: bool) -> Table:
    more = ("pixel", "line", "phase°", "V", "σ center") if wide else ()
    numbers = ("size px", "SNR", "σ px", "σ ″", "σ km", *more)
    table = plain_table(
        "Targets (σ with pointing, larger axis)", ("picture", "target"), numbers, first_width=14
    )
    for name, target in rows:
        table.add_row(shown(name), shown(target.name), *_target_cells(target)[: len(numbers)])
    return table


def _target_cells(t: TargetPlan) -> list[str]:
    seen = t.prediction
    return [
        _three_digits(seen.diameter_px),
        f"{t.snr:.0f}",
        _three_digits(float(max(t.sigma_px))),
        _three_digits(float(max(t.sigma_arcsec))),
        _three_digits(t.sigma_km),
        *(f"{value:.1f}" if math.isfinite(value) else "–" for value in seen.pixel_line),
        f"{math.degrees(seen.phase_rad):.1f}",
        f"{t.mag:.1f}" if math.isfinite(t.mag) else "–",
        _three_digits(float(max(t.center_sigma_px))),
    ]


def _three_digits(value: float) -> str:
    """Three significant digits, without an exponent where a person reads it at a glance."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0 or 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value) or 1.0)))}f}"
    return f"{value:.2e}"


def _print_limb_note(console: Console, rows: Sequence[tuple[str, TargetPlan]]) -> None:
    """Say where the bound is not what an unknown surface lets through."""
    limbs = list(
        dict.fromkeys(f"{target.name} in {name}" for name, target in rows if target.method == "limb_scan")
    )
    if limbs:
        words = f"The σ of {', '.join(limbs)} hold for a known albedo; a limb scan without it is some times worse."
        console.print(f"[yellow]note[/] {shown(words)}", highlight=False, soft_wrap=True)


def _print_reasons(console: Console, pictures: Sequence[PicturePlan]) -> None:
    for plan in pictures:
        grade = plan.verdict.grade
        if plan.verdict.reasons:
            words = f"[{GRADE_STYLES[grade]}]{grade}[/] {shown(plan.name)}: {shown(plan.verdict.words)}"
            console.print(words, highlight=False, soft_wrap=True)
        if plan.prediction is not None and plan.prediction.other_bodies:
            names = ", ".join(v.name for v in plan.prediction.other_bodies)
            console.print(f"[dim]also in the field[/] {shown(plan.name)}: {shown(names)}", highlight=False)


# ---- ``opnav plan``.

ProgressCall = Callable[[int, int, str], None]


def plan(
    sequence: Annotated[
        str | None, typer.Argument(help="Sequence YAML, or the name of a ready one.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for table, page and charts.", show_default=False)
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Only the picture, cadence or search of this name.", show_default=False),
    ] = None,
    kernels: Annotated[
        str | None, typer.Option(help="In place of the sequence's kernels.", show_default=False)
    ] = None,
    catalog: Annotated[
        str | None, typer.Option(help="In place of the sequence's star catalog.", show_default=False)
    ] = None,
    exposures: Annotated[bool, typer.Option(help="Search the best exposure of each picture.")] = True,
    list_: Annotated[bool, typer.Option("--list", help="List the ready sequences.")] = False,
) -> None:
    """Plan pictures: stars, sizes, expected errors, Sun, first detection, best exposure, and a verdict on each.

    [bold]Example[/]

      opnav plan osiris_rex/bennu_approach --out plan

    Prints the table; with --out also writes plan.ecsv, plan.json, plan.html (one page with everything), timeline.png and
    a chart of each field in charts/.
    """
    console = Console(soft_wrap=False)
    if list_ or sequence is None:
        if not list_:
            raise MissionError("no sequence given; give a YAML file, or a name that opnav plan --list shows.")
        console.print(sequence_listing())
        return
    content = load_sequence(sequence).with_options(kernels=kernels, catalog=catalog)
    with _progress("opening kernels and catalog") as done:
        planned = plan_sequence(content, only=only or (), exposures=exposures, done=done)
    print_plan(console, planned)
    if out is not None:
        names = _write_files(planned, make_folder(out))
        console.print(f"Written to {shown(str(out))}/: {', '.join(names)}", highlight=False, soft_wrap=True)


def _write_files(planned: Plan, folder: Path) -> list[str]:
    """Write all files of a plan and return their names."""
    tables = [path.name for path in write_plan(planned, folder)]
    report.write_plan_page(planned, folder / "plan.html", _draw_charts(planned, folder))
    if not planned.pictures:
        return ["plan.html", *tables]
    report.write_png(
        report.timeline_figure(planned.pictures, planned.sequence.description), folder / "timeline.png"
    )
    return ["plan.html", *tables, "timeline.png", "charts/"]


def _draw_charts(planned: Plan, folder: Path) -> dict[str, bytes]:
    """Draw the chart of each field, as a file and for the page."""
    drawn = {}
    with _progress("drawing") as done:
        for number, picture in enumerate(planned.pictures):
            done(number, len(planned.pictures), picture.name)
            drawn[picture.name] = report.png_bytes(report.field_chart(picture))
            with atomic_path(make_folder(folder / "charts") / f"{picture.name}.png") as temporary:
                temporary.write_bytes(drawn[picture.name])
    return drawn


@contextmanager
def _progress(first: str) -> Iterator[ProgressCall]:
    """Show progress on standard error, where a person sees it."""
    with picture_progress() as bar:
        task = bar.add_task(first, total=None)

        def done(number: int, total: int, name: str) -> None:
            bar.update(task, completed=number, total=total, description=shown(name))

        yield done
