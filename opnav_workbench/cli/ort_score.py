"""``opnav ort score``: what was delivered is written down, the truth is opened, and the one is held against the other."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.cli.ort_output import print_score
from opnav_workbench.files import write_json, write_text
from opnav_workbench.rehearsal.ort_package import open_rehearsal
from opnav_workbench.rehearsal.ort_score import score_rehearsal
from opnav_workbench.rehearsal.ort_score_log import log_path, logged_delivery
from opnav_workbench.rehearsal.ort_solution import SOLUTION_FILE, OrtSolution
from opnav_workbench.rehearsal.ort_solution_pictures import picture_results
from opnav_workbench.rehearsal.ort_truth import reveal
from opnav_workbench.report.ort_page import score_page

__all__ = ["EXIT_FAILED", "score"]

EXIT_FAILED = 3
PAGE_FILE = "score.html"


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
    solution = OrtSolution.read(path) if path.is_file() else None
    key_file = key or package.key_path
    with logged_delivery(key_file, package.name, solutions, names, path) as delivery:
        truth = reveal(package, key_file)
    result = score_rehearsal(package, truth, solutions, solution, delivery=delivery)
    page = out or solutions / PAGE_FILE
    write_text(page, score_page(result))
    write_json(page.with_suffix(".json"), result.to_dict())
    console = Console(soft_wrap=False)
    print_score(console, result)
    console.print(
        f"Report in {escape(str(page))}; reveal logged in {escape(str(log_path(key_file)))}",
        highlight=False,
        soft_wrap=True,
    )
    if not result.grade.passed:
        raise typer.Exit(EXIT_FAILED)
