"""``opnav ort``: operational readiness tests, from the blinded package to the score.

new    makes the package: pictures, predicted kernels, a briefing, and the truth under seal
solve  the automatic blind run
score  writes down what was delivered, opens the truth, and holds the one against the other
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench import report
from opnav_workbench.cli.process import Reporter
from opnav_workbench.cli.processing_options import processing_options, with_options
from opnav_workbench.cli.terminal import EXIT_PARTLY, picture_progress, plain_table, shown
from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import EstimationError, MissionError
from opnav_workbench.estimation import Acceleration, CenterBias, Pointing
from opnav_workbench.files import write_json, write_text
from opnav_workbench.headless.rehearsal_run import package_processing, process_package
from opnav_workbench.processing import Processing
from opnav_workbench.processing.model import shape_file
from opnav_workbench.rehearsal.filtering import FilterOptions
from opnav_workbench.rehearsal.making import new_rehearsal
from opnav_workbench.rehearsal.orbit.scoring import OrbitScore
from opnav_workbench.rehearsal.orbit.solution import OrbitSolution, solve_orbit_rehearsal
from opnav_workbench.rehearsal.package import OrtPackage, open_rehearsal
from opnav_workbench.rehearsal.results import picture_results
from opnav_workbench.rehearsal.scenario import load_ort_scenario, ort_scenario_names
from opnav_workbench.rehearsal.score import OrtScore, score_rehearsal
from opnav_workbench.rehearsal.sealed_truth import log_path, logged_delivery, reveal
from opnav_workbench.rehearsal.solution import SOLUTION_FILE, OrtSolution, solve_rehearsal
from opnav_workbench.rehearsal.truth_checks import SolutionScore, TruthCheck

__all__ = ["new", "ort", "solve"]


# ---- What ``opnav ort`` prints: tables of a solution and of a score.

GOOD, POOR, WRONG = "green", "yellow", "bold red"
STYLES = {"good": GOOD, "poor": POOR, "A": GOOD, "B": GOOD, "C": POOR}


def print_solution(console: Console, solution: OrtSolution) -> None:
    """Print corrections and flyby, each with what was known before, and what is to be known of the fit."""
    table = plain_table(
        "Estimated, true minus predicted", ("quantity",), ("value", "sigma", "before", "unit")
    )
    if solution.filter:
        allowed = "; ".join(solution.filter["allowed_for"]) or "nothing beside the batch's parameters"
        console.print(f"By the filter, which allows for {shown(allowed)}", highlight=False, soft_wrap=True)
    rows = zip(
        solution.labels,
        solution.correction,
        solution.sigma,
        solution.sigma_before,
        solution.units,
        strict=True,
    )
    for label, *numbers, unit in rows:
        table.add_row(label.replace("_", " "), *(_number(n) for n in numbers), unit)
    flight = zip(
        ("B·T", "B·R", "time of flight"),
        solution.b_plane_shift,
        solution.b_plane_sigma,
        solution.b_plane_sigma_before,
        ("km", "km", "s"),
        strict=True,
    )
    for label, *numbers, unit in flight:
        table.add_row(label, *(_number(n) for n in numbers), unit)
    console.print(table)
    if solution.history:
        console.print(_history_table(solution))
    if solution.filter:
        console.print(_passing_table(solution))
    console.print(
        f"chi-squared {solution.chi2_after:.1f} for {solution.degrees_of_freedom} degrees of freedom, probability "
        f"{solution.probability:.2g}",
        highlight=False,
    )
    for words in solution.messages:
        console.print(f"[yellow]note[/] {shown(words)}", highlight=False, soft_wrap=True)
    for words in solution.left_out:
        console.print(f"left out: {shown(words)}", highlight=False, soft_wrap=True, style="dim")


def print_orbit_solution(console: Console, solution: OrbitSolution) -> None:
    """Print corrections of orbit, body and map, the predicted place, and what tells each picture's attitude."""
    table = plain_table("Estimated, true minus believed", ("quantity",), ("value", "sigma", "before", "unit"))
    numbers = (solution.correction, solution.sigma, solution.sigma_before)
    for label, *values, unit in zip(solution.labels, *numbers, solution.units, strict=True):
        table.add_row(label, *(_number(n) for n in _shown_angles(values, unit)), SHOWN_UNITS.get(unit, unit))
    moved = solution.place_km - solution.place_before_km
    covariances = (solution.place_covariance_km2, solution.place_covariance_before_km2)
    sigmas = [np.sqrt(np.diag(covariance)) for covariance in covariances]
    for row in zip("xyz", moved, *sigmas, strict=True):
        table.add_row(f"place at {solution.predict_utc[:16]} {row[0]}", *(_number(n) for n in row[1:]), "km")
    console.print(table)
    told = plain_table("Attitudes", ("picture", "told by"), ("landmarks",))
    for name, one in solution.attitudes.items():
        told.add_row(shown(name), str(one["source"]), str(one["n_landmarks"]))
    console.print(told)
    console.print(
        f"chi-squared {solution.chi2:.1f} for {solution.degrees_of_freedom} degrees of freedom, probability "
        f"{solution.probability:.2g}",
        highlight=False,
    )
    for words in (*solution.words, *solution.messages):
        console.print(f"[yellow]note[/] {shown(words)}", highlight=False, soft_wrap=True)
    for words in solution.left_out:
        console.print(f"left out: {shown(words)}", highlight=False, soft_wrap=True, style="dim")


SHOWN_UNITS = {"rad": "deg", "rad/s": "deg/day", "of it": "%"}


def _shown_angles(values: list[float], unit: str) -> list[float]:
    """Return numbers in the units that people read."""
    degree = float(np.degrees(1.0))
    scale = {"rad": degree, "rad/s": degree * DAY_S, "of it": 100.0}.get(unit, 1.0)
    return [scale * value for value in values]


def _history_table(solution: OrtSolution) -> Table:
    """Return the flyby after each picture: solved minus predicted, each with its sigma."""
    names = ("pictures", "B·T km", "σ", "B·R km", "σ", "arrival s", "σ")
    table = plain_table("Flyby by data cutoff, solved minus predicted", ("last picture",), names)
    for row in solution.history:
        shift = row["b_plane"] - solution.b_plane_before
        sigma = np.sqrt(np.diag(row["covariance"]))
        cells = [_number(value) for pair in zip(shift, sigma, strict=True) for value in pair]
        table.add_row(shown(str(row["picture"])), str(row["pictures"]), *cells)
    return table


def _passing_table(solution: OrtSolution) -> Table:
    """Return O-C of centers on their way through the filter: by the pictures before, and by all."""
    names = ("by those before", "off by σ", "by all", "off by σ")
    table = plain_table("Through the filter, O−C in px", ("picture", "body"), names)
    for row in solution.residuals:
        if row["kind"] == "center":
            left = "" if row["used"] else " (left out)"
            values = (row["predicted"], [row["predicted_sigmas"]], row["after"], [row["sigmas"]])
            table.add_row(shown(Path(row["image"]).stem), shown(row["body"]) + left, *map(_residual, values))
    return table


def _residual(values: Sequence[float | None]) -> str:
    return ", ".join("–" if v is None else f"{v:.2f}" for v in values)


def print_score(console: Console, score: OrtScore) -> None:
    """Print what was wrong, how the solution compares, the points, and the grade."""
    for words in score.perturbed:
        console.print(f"wrong on purpose: {shown(words)}", highlight=False, soft_wrap=True)
    if score.solution is not None:
        table = plain_table(
            "Solution against truth", ("quantity",), ("solved", "true", "error", "sigma", "error / σ", "unit")
        )
        for check in _checks(score.solution):
            _add_check_rows(table, check)
        console.print(table)
    points = plain_table("Points", ("section",), ("points", "of"))
    points.add_column("lost by")
    for section in score.grade.sections:
        points.add_row(
            section.name,
            f"{section.earned:.1f}",
            f"{section.possible:.0f}",
            shown("; ".join(section.losses)),
        )
    console.print(points)
    for fault in score.grade.faults:
        console.print(
            f"[bold red]at most {fault.letter}:[/] {shown(fault.words)}", highlight=False, soft_wrap=True
        )
    letter = score.grade.letter
    console.print(
        f"Grade [{STYLES.get(letter, WRONG)}]{letter}[/], {score.grade.points:.0f} of 100 points",
        highlight=False,
    )


def _checks(solution: SolutionScore | OrbitScore) -> tuple[TruthCheck, ...]:
    if isinstance(solution, OrbitScore):
        return (solution.prediction, *solution.parameters)
    return (solution.b_plane, solution.arrival, *solution.parameters)


def _add_check_rows(table: Table, check: TruthCheck) -> None:
    style = STYLES.get(check.verdict, WRONG)
    rows = zip(
        check.labels,
        check.solved,
        check.truth,
        check.error,
        check.sigma,
        check.component_sigmas,
        check.units,
        strict=True,
    )
    for label, *numbers, sigmas, unit in rows:
        name = f"{check.name.replace('_', ' ')} {label}".strip()
        cells = (_number(n) for n in _shown_angles(numbers, unit))
        table.add_row(name, *cells, f"[{style}]{sigmas:+.2f}[/]", SHOWN_UNITS.get(unit, unit))


def _number(value: float) -> str:
    return f"{value:,.3f}" if abs(value) >= 0.1 else f"{value:.3g}"


# ---- ``opnav ort score``.

SCORE_PAGE_FILE = "score.html"


def score(
    folder: Annotated[Path, typer.Argument(help="Package of the rehearsal.", show_default=False)],
    solutions: Annotated[
        Path, typer.Option(help="The team's folder, as opnav ort solve writes it.", show_default=False)
    ],
    key: Annotated[
        Path | None, typer.Option(help="The director's key; default FOLDER.key.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The report; default SOLUTIONS/score.html.", show_default=False)
    ] = None,
) -> None:
    """Open the truth of a rehearsal, grade what the team delivered, and write the report.

    [bold]Example[/]

      opnav ort score ort_1 --solutions run_1

    Before the truth is opened, the SHA-256 of every delivered file is written to
    KEY.reveals.jsonl: a later edit shows.

    Exit status: 0 passed (C or better), 2 bad input or no key, 3 not passed.
    """
    package = open_rehearsal(folder)
    names = [picture.name for picture in package.pictures]
    path = solutions / SOLUTION_FILE
    picture_results(names, solutions)  # what cannot be read must not cost the seal
    kind = OrtSolution if package.orbit is None else OrbitSolution
    solution = kind.read(path) if path.is_file() else None
    key_file = key or package.key_path
    with logged_delivery(key_file, package.name, solutions, names, path) as delivery:
        truth = reveal(package, key_file)
    result = score_rehearsal(package, truth, solutions, solution, delivery=delivery)
    page = out or solutions / SCORE_PAGE_FILE
    write_text(page, report.score_page(result))
    write_json(page.with_suffix(".json"), result.to_dict())
    console = Console(soft_wrap=False)
    print_score(console, result)
    console.print(
        f"Report in {shown(str(page))}; reveal logged in {shown(str(log_path(key_file)))}",
        highlight=False,
        soft_wrap=True,
    )
    if not result.grade.passed:
        raise typer.Exit(EXIT_PARTLY)


# ---- ``opnav ort solve``: the automatic blind run of a rehearsal.

FEW_PICTURES = 3  # starting a process costs about as much as a picture
SOLUTION_PAGE_FILE = "solution.html"


@processing_options(without=("mission", "kernels"))
def solve(
    folder: Annotated[Path, typer.Argument(help="Package of the rehearsal.", show_default=False)],
    given: dict[str, Any],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("ort_run"),
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Processes; default: all cores.", show_default=False),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Process pictures anew that have a result already.")
    ] = False,
    only_estimate: Annotated[
        bool, typer.Option("--only-estimate", help="Keep the pictures' results as they are; estimate again.")
    ] = False,
    disk_sigma: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Pixels added (in squares) to the sigmas of disks, for centers that say nothing of unknown surfaces.",
        ),
    ] = 0.0,
    filter_: Annotated[
        bool, typer.Option("--filter", help="Estimate in the square-root filter instead of in one batch.")
    ] = False,
    acceleration: Annotated[
        str | None,
        typer.Option(
            help="Stochastic, of the spacecraft: km/s^2, and the days that it lasts.", metavar="SIGMA:DAYS"
        ),
    ] = None,
    pointing: Annotated[
        str | None,
        typer.Option(help="Of attitudes beyond their covariance, arcsec.", metavar="SIGMA[:DAYS]"),
    ] = None,
    bias: Annotated[
        str | None,
        typer.Option(help="Of centers beyond their covariance, px.", metavar="SIGMA[:DAYS]"),
    ] = None,
    consider: Annotated[
        list[str] | None,
        typer.Option(
            help="Not solved for, but in the covariance: a parameter, gm=SIGMA or focal_length=SIGMA.",
            metavar="NAME[=SIGMA]",
        ),
    ] = None,
) -> None:
    """Process every picture of a rehearsal blind, and estimate what its briefing asks for.

    [bold]Examples[/]

      opnav ort solve ort_1 --out run_1

      opnav ort solve ort_1 --out run_1 --only-estimate

      opnav ort solve ort_1 --out run_1 --only-estimate --acceleration 1e-12:5 --consider gm=0.5

    Writes RUN/<picture>/ as opnav process does, RUN/solution.json and RUN/solution.html.
    A picture that is lost is a named failure, not a stop.

    Run again, it keeps what has a result: an analyst may do any picture over in between
    (opnav lab with --out RUN), and the estimate is made anew.

    With --filter, or anything that it allows for, a square-root information filter and smoother takes the batch's
    place: the same pictures, the same solution.json, with residuals on their way through the filter. DAYS: how long
    noise remembers; without, each picture has its own; inf, all have the same.
    """
    package = open_rehearsal(folder)
    options = _filter_options(filter_, acceleration, pointing, bias, consider or ())
    if options is not None and package.orbit is not None:
        raise EstimationError(
            "the filter is for flybys: a rehearsal in orbit is solved in one batch; leave its options out."
        )
    if not only_estimate:
        _process_pictures(package, with_options(package_processing(package), given), out, jobs, again)
    console = Console(soft_wrap=False)
    if package.orbit is not None:
        in_orbit = solve_orbit_rehearsal(package, out)
        in_orbit.write(out / SOLUTION_FILE)
        write_text(out / SOLUTION_PAGE_FILE, report.orbit_solution_page(in_orbit, package.title))
        print_orbit_solution(console, in_orbit)
    else:
        solution = solve_rehearsal(package, out, disk_sigma_px=disk_sigma, history=True, filtered=options)
        solution.write(out / SOLUTION_FILE)
        write_text(out / SOLUTION_PAGE_FILE, report.solution_page(solution, package.title))
        print_solution(console, solution)
    console.print(
        f"Solution in {shown(str(out / SOLUTION_FILE))}, to look at in {SOLUTION_PAGE_FILE}",
        highlight=False,
        soft_wrap=True,
    )


def _filter_options(
    asked: bool, acceleration: str | None, pointing: str | None, bias: str | None, consider: Sequence[str]
) -> FilterOptions | None:
    """Return what the filter allows for; None where nobody asked for it."""
    given = (acceleration, pointing, bias)
    if not asked and not consider and given == (None, None, None):
        return None
    considered: dict[str, float | None] = {}
    for word in consider:
        name, named, sigma = word.partition("=")
        considered[name] = _float(f"--consider {name}", sigma) if named else None
    if acceleration is not None and ":" not in acceleration:
        raise EstimationError(
            f"--acceleration {acceleration}: say for how many days it lasts as well, such as {acceleration}:5."
        )
    pushed, turned, moved = (
        None if words is None else _sigma_and_time(name, words)
        for name, words in zip(("--acceleration", "--pointing", "--bias"), given, strict=True)
    )
    arcsec = float(np.radians(1.0 / 3600.0))
    return FilterOptions(
        acceleration=None if pushed is None else Acceleration(*pushed),
        pointing=None if turned is None else Pointing(arcsec * turned[0], turned[1]),
        bias=None if moved is None else CenterBias(*moved),
        consider=considered,
    )


def _sigma_and_time(option: str, words: str) -> tuple[float, float]:
    """Read SIGMA[:DAYS]; the time in seconds."""
    sigma, _, days = words.partition(":")
    return _float(option, sigma), _float(option, days or "0") * DAY_S


def _float(option: str, words: str) -> float:
    try:
        return float(words)
    except ValueError:
        raise EstimationError(f"{option}: {words!r} is no number; see opnav ort solve --help.") from None


def _process_pictures(package: OrtPackage, how: Processing, out: Path, jobs: int | None, again: bool) -> None:
    count = len(package.pictures)
    processes = jobs or (1 if count <= FEW_PICTURES else os.cpu_count() or 1)
    with Reporter(count) as reporter:
        reporter.say(package.name, f"{count} pictures")
        outcomes = process_package(package, out, how=how, jobs=processes, again=again, done=reporter.done)
    reporter.table(outcomes, out)


# ---- ``opnav ort``: operational readiness tests, from the blinded package to the score.

ort = typer.Typer(
    name="ort",
    help="Operational readiness tests: a blinded package, its solution, and the score once the truth is opened.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@ort.command()
def new(
    scenario: Annotated[
        str | None,
        typer.Argument(help="Scenario YAML, or the name of a ready one (--list).", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the package, which must not exist yet.", show_default=False)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Repeats a case; default: a random one.", show_default=False)
    ] = None,
    pictures: Annotated[
        int | None, typer.Option(min=1, help="At most so many pictures.", show_default=False)
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Processes; default: all cores.", show_default=False),
    ] = None,
    shape: Annotated[
        str | None,
        typer.Option(
            help="In orbit: a shape model in place of the made surface, in km unless told (bennu.obj:m).",
            show_default=False,
        ),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the ready scenarios.")] = False,
) -> None:
    """Make the package of a rehearsal: pictures, predicted kernels, a briefing, and the truth under seal.

    [bold]Example[/]

      opnav ort new new_horizons/pluto_final_approach --out ort_1

      opnav ort new osiris_rex/bennu_orbit --out ort_2 --shape bennu.obj:m

    The team gets the folder ort_1 (start with ort_1/briefing.html).
    The director keeps ort_1.key, which alone opens the truth.
    """
    console = Console(soft_wrap=False)
    if list_ or scenario is None or out is None:
        if not list_:
            raise MissionError(
                "give a scenario and --out FOLDER; opnav ort new --list shows the ready scenarios."
            )
        console.print(_scenario_table())
        return
    content = load_ort_scenario(scenario)
    if shape is not None:
        named = shape_file(shape)
        content = content.with_shape(named.path, named.unit)
    with picture_progress() as progress:
        task = progress.add_task("opening kernels and catalog", total=None)
        package = new_rehearsal(
            content,
            out,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
            pictures=pictures,
            progress=lambda done, total, words: progress.update(
                task, completed=done, total=total, description=shown(words)
            ),
        )
    _print_package(console, package)


def _scenario_table() -> Table:
    table = plain_table("", ("scenario",), ("pictures",))
    table.add_column("what is rehearsed")
    for name in ort_scenario_names():
        content = load_ort_scenario(name)
        table.add_row(name, str(len(content.sequence())), content.title)
    return table


def _print_package(console: Console, package: OrtPackage) -> None:
    console.print(f"[bold]{shown(package.title)}[/]", highlight=False)
    table = plain_table("Pictures", ("picture", "UTC", "camera"), ("exposure s",))
    for picture in package.pictures:
        table.add_row(
            shown(picture.name),
            str(picture.utc)[:19],
            shown(str(picture.camera)),
            f"{picture.exposure_s:g}",
        )
    console.print(table)
    for words in (
        f"For the team: {package.folder} (start with {package.folder / 'briefing.html'})",
        f"For the director alone: {package.key_path}, which opens the truth",
        f"Next: opnav ort solve {package.folder} --out RUN, or picture by picture with opnav lab",
    ):
        console.print(shown(words), highlight=False, soft_wrap=True)


ort.command()(solve)
ort.command()(score)
