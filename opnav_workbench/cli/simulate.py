"""``opnav simulate``: pictures with known truth, from a scenario file."""

import math
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench.cli.terminal import error_console, picture_progress, plain_table, shown
from opnav_workbench.errors import MissionError
from opnav_workbench.mission import load_mission
from opnav_workbench.simulation import (
    PictureReport,
    PictureScenario,
    chosen_pictures,
    load_picture_scenario,
    picture_scenario_names,
)
from opnav_workbench.simulation import simulate as simulate_pictures

__all__ = ["simulate"]

FEW_PICTURES = 3  # starting a process costs about as much as two star fields


def simulate(
    scenario: Annotated[
        str | None, typer.Argument(help="Scenario YAML, or the name of a ready one.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("simulated"),
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: all cores.", show_default=False)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="In place of the scenario's seed.", show_default=False)
    ] = None,
    kernels: Annotated[
        str | None, typer.Option(help="In place of the scenario's kernels.", show_default=False)
    ] = None,
    catalog: Annotated[
        str | None, typer.Option(help="In place of the scenario's star catalog.", show_default=False)
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Only the picture (or series) of this name.", show_default=False)
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the ready scenarios.")] = False,
) -> None:
    """Simulate pictures, each with its truth and a preview.

    [bold]Example[/]

      opnav simulate new_horizons/pluto_charon --out simulated

    Writes for each picture NAME.fit (as the mission's own files, with the predicted attitude), its truth in files of their
    own, and NAME_log.png or NAME_linear.png. The same scenario and seed give the same bytes.
    """
    console = Console(soft_wrap=False)
    if list_ or scenario is None:
        if not list_:
            raise MissionError(
                "no scenario given; give a YAML file, or a name that opnav simulate --list shows."
            )
        console.print(_scenario_table())
        return
    content = load_picture_scenario(scenario).with_options(seed=seed, kernels=kernels, catalog=catalog)
    reports = _run(content, out, jobs, only or ())
    console.print(_picture_table(reports))
    if any(report.bodies for report in reports):
        console.print(_body_table(reports))
    for report in reports:
        for caution in report.cautions:
            console.print(
                f"[yellow]{shown(report.name)}: {shown(caution)}[/]", highlight=False, soft_wrap=True
            )
    console.print(f"Pictures in {shown(str(out))}/: {_files(reports)}", highlight=False, soft_wrap=True)
    console.print(f"Next: {shown(_next_command(content, out, reports))}", highlight=False, soft_wrap=True)


def _next_command(scenario: PictureScenario, out: Path, reports: Sequence[PictureReport]) -> str:
    """Return the command that solves the pictures, with the kernels and the catalog that they were made of."""
    pictures = (
        shlex.quote(str(reports[0].files[0])) if len(reports) == 1 else f"{shlex.quote(str(out))}/*.fit"
    )
    options = {"mission": scenario.mission, "kernels": scenario.kernels, "catalog": scenario.catalog}
    usual = PictureScenario.model_fields["catalog"].default
    said = [(name, value) for name, value in options.items() if value and value != usual]
    bare = all(picture.targets == () for picture in scenario.pictures)
    if scenario.mission and bare and load_mission(scenario.source(scenario.mission)).default_targets:
        said.append(
            ("targets", "none")
        )  # the mission's own, which nobody drew, and which their kernels do not know
    return " ".join(["opnav process", pictures, *(f"--{name} {shlex.quote(value)}" for name, value in said)])


def _run(
    scenario: PictureScenario, out: Path, jobs: int | None, only: Sequence[str]
) -> tuple[PictureReport, ...]:
    errors = error_console()
    count = len(chosen_pictures(scenario, only))
    processes = jobs or (1 if count <= FEW_PICTURES else os.cpu_count() or 1)
    with picture_progress(errors) as progress:
        task = progress.add_task("opening kernels and catalog", total=count)
        try:
            return simulate_pictures(
                scenario,
                out,
                jobs=processes,
                only=only,
                done=lambda report: progress.update(task, advance=1, description=shown(report.name)),
            )
        except KeyboardInterrupt:
            errors.print(f"stopped; the finished pictures are kept in {shown(str(out))}/", highlight=False)
            raise


def _scenario_table() -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("scenario", no_wrap=True)
    table.add_column("pictures", justify="right")
    table.add_column("what it shows")
    for name in picture_scenario_names():
        content = load_picture_scenario(name)
        count = sum(len(entry.expanded()) for entry in content.pictures)
        table.add_row(name, str(count), " ".join(content.description.split()))
    return table


def _picture_table(reports: Sequence[PictureReport]) -> Table:
    table = plain_table("Pictures", ("picture", "UTC", "camera"), ("exposure s", "stars", "brightest mag"))
    for report in reports:
        table.add_row(
            shown(report.name),
            report.utc.removesuffix(".000"),
            report.camera,
            f"{report.exposure_s:g}",
            str(report.stars_drawn),
            "–" if report.brightest_mag is None else f"{report.brightest_mag:.1f}",
        )
    return table


def _body_table(reports: Sequence[PictureReport]) -> Table:
    table = plain_table(
        "Bodies", ("picture", "body", "drawn as"), ("pixel", "line", "diameter px", "SNR", "hidden")
    )
    for report in reports:
        for body in report.bodies:
            table.add_row(
                shown(report.name),
                shown(body.name),
                body.regime,
                *("–" if math.isnan(value) else f"{value:.2f}" for value in body.center_px),
                f"{body.diameter_px:.2f}",
                f"{body.snr:.0f}",
                f"{body.occulted_fraction:.0%}",
            )
    return table


def _files(reports: Sequence[PictureReport]) -> str:
    """Name the files of the first picture; the others have the same endings."""
    names = [path.name for path in reports[0].files]
    more = f", and as many for each of the other {len(reports) - 1}" if len(reports) > 1 else ""
    return ", ".join(names) + more
