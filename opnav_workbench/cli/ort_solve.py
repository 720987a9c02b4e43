"""``opnav ort solve``: the automatic blind run of a rehearsal."""

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.cli.ort_output import print_solution
from opnav_workbench.cli.summary import Reporter
from opnav_workbench.files import write_text
from opnav_workbench.headless.ort_run import process_package
from opnav_workbench.rehearsal.ort_package import OrtPackage, open_rehearsal
from opnav_workbench.rehearsal.ort_solution import DISK_SIGMA_PX, SOLUTION_FILE, solve_rehearsal
from opnav_workbench.report.ort_page import solution_page

__all__ = ["solve"]

FEW_PICTURES = 3  # starting a process costs about as much as a picture
PAGE_FILE = "solution.html"


def solve(
    folder: Annotated[Path, typer.Argument(help="Package of the rehearsal.", show_default=False)],
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
        typer.Option(min=0.0, help="Pixels added (in squares) to the sigmas of disks, for unknown surfaces."),
    ] = DISK_SIGMA_PX,
) -> None:
    """Process every picture of a rehearsal blind, and estimate what its briefing asks for.

    [bold]Examples[/]

      opnav ort solve ort_1 --out run_1

      opnav ort solve ort_1 --out run_1 --only-estimate

    Writes RUN/<picture>/ as opnav process does, RUN/solution.json and RUN/solution.html.
    A picture that is lost is a named failure, not a stop.

    Run again, it keeps what has a result: an analyst may do any picture over in between
    (opnav lab with --out RUN), and the estimate is made anew.
    """
    package = open_rehearsal(folder)
    if not only_estimate:
        _process(package, out, jobs, again)
    solution = solve_rehearsal(package, out, disk_sigma_px=disk_sigma)
    solution.write(out / SOLUTION_FILE)
    write_text(out / PAGE_FILE, solution_page(solution, package.title))
    console = Console(soft_wrap=False)
    print_solution(console, solution)
    console.print(
        f"Solution in {escape(str(out / SOLUTION_FILE))}, to look at in {PAGE_FILE}",
        highlight=False,
        soft_wrap=True,
    )


def _process(package: OrtPackage, out: Path, jobs: int | None, again: bool) -> None:
    count = len(package.pictures)
    processes = jobs or (1 if count <= FEW_PICTURES else os.cpu_count() or 1)
    with Reporter(count) as reporter:
        reporter.say(package.name, f"{count} pictures")
        outcomes = process_package(package, out, jobs=processes, again=again, done=reporter.done)
    reporter.table(outcomes, out)
