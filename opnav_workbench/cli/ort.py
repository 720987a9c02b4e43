"""``opnav ort``: operational readiness tests, from the blinded package to the score."""

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from opnav_workbench.cli.ort_score import score
from opnav_workbench.cli.ort_solve import solve
from opnav_workbench.cli.terminal import picture_progress, plain_table
from opnav_workbench.errors import MissionError
from opnav_workbench.rehearsal.ort_package import OrtPackage, new_rehearsal
from opnav_workbench.rehearsal.ort_scenario import load_ort_scenario, ort_scenario_names

__all__ = ["new", "ort"]

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
    list_: Annotated[bool, typer.Option("--list", help="List the ready scenarios.")] = False,
) -> None:
    """Make the package of a rehearsal: pictures, predicted kernels, a briefing, and the truth under seal.

    [bold]Example[/]

      opnav ort new new_horizons/pluto_final_approach --out ort_1

    The team gets the folder ort_1 (start with ort_1/briefing.html).
    The director keeps ort_1.key, which alone opens the truth.
    """
    console = Console(soft_wrap=False)
    if list_ or scenario is None or out is None:
        if not list_:
            raise MissionError(
                "give a scenario and --out FOLDER; opnav ort new --list shows the ready scenarios."
            )
        console.print(_listing())
        return
    with picture_progress() as progress:
        task = progress.add_task("opening kernels and catalog", total=None)
        package = new_rehearsal(
            scenario,
            out,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
            pictures=pictures,
            progress=lambda done, total, words: progress.update(
                task, completed=done, total=total, description=escape(words)
            ),
        )
    _tell(console, package)


def _listing() -> Table:
    table = plain_table("", ("scenario",), ("pictures",))
    table.add_column("what is rehearsed")
    for name in ort_scenario_names():
        content = load_ort_scenario(name)
        table.add_row(name, str(len(content.sequence())), content.title)
    return table


def _tell(console: Console, package: OrtPackage) -> None:
    console.print(f"[bold]{escape(package.title)}[/]", highlight=False)
    table = plain_table("Pictures", ("picture", "UTC", "camera"), ("exposure s",))
    for picture in package.pictures:
        table.add_row(
            escape(picture.name),
            str(picture.utc)[:19],
            escape(str(picture.camera)),
            f"{picture.exposure_s:g}",
        )
    console.print(table)
    for words in (
        f"For the team: {package.folder} (start with {package.folder / 'briefing.html'})",
        f"For the director alone: {package.key_path}, which opens the truth",
        f"Next: opnav ort solve {package.folder} --out RUN, or picture by picture with opnav lab",
    ):
        console.print(escape(words), highlight=False, soft_wrap=True)


ort.command()(solve)
ort.command()(score)
