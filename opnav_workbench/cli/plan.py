"""``opnav plan``: what the pictures of a sequence will show, how well they navigate, and which are worth taking."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.cli.plan_output import print_plan, sequence_listing
from opnav_workbench.cli.terminal import picture_progress
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path, make_folder
from opnav_workbench.planning import Plan, load_sequence, plan_sequence, write_plan
from opnav_workbench.report.plan_figure import field_chart, timeline_figure
from opnav_workbench.report.plan_page import write_plan_page
from opnav_workbench.report.png import png_bytes, write_png

__all__ = ["plan"]

Done = Callable[[int, int, str], None]


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
        names = _written(planned, make_folder(out))
        console.print(f"Written to {escape(str(out))}/: {', '.join(names)}", highlight=False, soft_wrap=True)


def _written(planned: Plan, folder: Path) -> list[str]:
    """Write all files of a plan and return their names."""
    tables = [path.name for path in write_plan(planned, folder)]
    write_plan_page(planned, folder / "plan.html", _charts(planned, folder))
    if not planned.pictures:
        return ["plan.html", *tables]
    write_png(timeline_figure(planned.pictures, planned.sequence.description), folder / "timeline.png")
    return ["plan.html", *tables, "timeline.png", "charts/"]


def _charts(planned: Plan, folder: Path) -> dict[str, bytes]:
    """Draw the chart of each field, as a file and for the page."""
    drawn = {}
    with _progress("drawing") as done:
        for number, picture in enumerate(planned.pictures):
            done(number, len(planned.pictures), picture.name)
            drawn[picture.name] = png_bytes(field_chart(picture))
            with atomic_path(make_folder(folder / "charts") / f"{picture.name}.png") as temporary:
                temporary.write_bytes(drawn[picture.name])
    return drawn


@contextmanager
def _progress(first: str) -> Iterator[Done]:
    """Show progress on standard error, where a person sees it."""
    with picture_progress() as bar:
        task = bar.add_task(first, total=None)

        def done(number: int, total: int, name: str) -> None:
            bar.update(task, completed=number, total=total, description=escape(name))

        yield done
