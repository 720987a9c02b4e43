"""``opnav campaign``: many runs in one archive, questions to it, its observables, its trends, and stacks of its pictures."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.campaign import ARCHIVE_FILE, Campaign, Ingested, trends
from opnav_workbench.campaign.export import EXPORT_FORMATS, export_observables
from opnav_workbench.campaign.queries import QUESTIONS
from opnav_workbench.cli.campaign_output import (
    OUTPUT_FORMATS,
    ingest_progress,
    print_answer,
    print_ingested,
    print_outliers,
)
from opnav_workbench.cli.campaign_stack import stack
from opnav_workbench.errors import SessionError
from opnav_workbench.report.campaign_figure import trends_figure
from opnav_workbench.report.png import write_png

__all__ = ["EXIT_SOME_SKIPPED", "campaign_app"]

EXIT_SOME_SKIPPED = 3

campaign_app = typer.Typer(
    name="campaign",
    help="Many pictures: archive their runs, ask it, export observables, plot trends, stack faint targets.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

Archive = Annotated[Path, typer.Option("--archive", "-a", help="Archive file, or the folder it is in.")]
Since = Annotated[str | None, typer.Option(help="From this UTC on, such as 2015-04-09.", show_default=False)]
Until = Annotated[
    str | None, typer.Option(help="Up to this UTC; a date holds its whole day.", show_default=False)
]
Mission = Annotated[str | None, typer.Option(help="Only of this mission.", show_default=False)]
Camera = Annotated[str | None, typer.Option(help="Only of this camera.", show_default=False)]
Body = Annotated[str | None, typer.Option(help="Only of these bodies, comma-separated.", show_default=False)]
Method = Annotated[str | None, typer.Option(help="Only by these methods.", show_default=False)]
Status = Annotated[str | None, typer.Option(help="Only with these statuses.", show_default=False)]
DEFAULT_ARCHIVE = Path(ARCHIVE_FILE)


@campaign_app.command()
def ingest(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, or folders of them.", show_default=False)],
    archive: Archive = DEFAULT_ARCHIVE,
) -> None:
    """Take runs into the archive; the same run twice changes nothing, a reprocessed picture replaces its older run.

    [bold]Example[/]

      opnav campaign ingest night1 night2 --archive campaign.sqlite

    Damaged runs are named and skipped. Exit status: 0 all taken in, 2 bad input, 3 some skipped.
    """
    with Campaign(archive) as campaign, ingest_progress(runs) as advance:

        def say(item: Ingested) -> None:
            advance(item)

        report = campaign.ingest(runs, say)
        where = campaign.path
    print_ingested(Console(soft_wrap=True), report, where)
    if report.skipped:
        raise typer.Exit(EXIT_SOME_SKIPPED)


@campaign_app.command()
def query(
    what: Annotated[str, typer.Argument(help=" | ".join(QUESTIONS))] = "images",
    archive: Archive = DEFAULT_ARCHIVE,
    status: Status = None,
    body: Body = None,
    method: Method = None,
    image: Annotated[str | None, typer.Option(help="Only of these pictures.", show_default=False)] = None,
    since: Since = None,
    until: Until = None,
    mission: Mission = None,
    camera: Camera = None,
    attention: Annotated[
        bool, typer.Option("--attention", help="Only pictures that need an analyst.")
    ] = False,
    format_: Annotated[str, typer.Option("--format", "-f", help=" | ".join(OUTPUT_FORMATS))] = "table",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write csv or json here.", show_default=False)
    ] = None,
) -> None:
    """Ask the archive for pictures, pointings, bodies or stars.

    [bold]Example[/]

      opnav campaign query bodies --body PLUTO --status ok --since 2015-04-01 --format csv

    The table shows what fits a terminal; csv and json hold every column.
    """
    filters = {"status": status, "body": body, "method": method, "image": image}
    filters |= {"since": since, "until": until, "mission": mission, "camera": camera}
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
    archive: Archive = DEFAULT_ARCHIVE,
    body: Body = None,
    method: Method = None,
    status: Status = None,
    since: Since = None,
    until: Until = None,
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
    Console(soft_wrap=True).print(f"{count} observables in {escape(str(out))}", highlight=False)


@campaign_app.command()
def plot(
    archive: Archive = DEFAULT_ARCHIVE,
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG to write.")] = Path("campaign.png"),
    body: Body = None,
    method: Method = None,
    since: Since = None,
    until: Until = None,
    mission: Mission = None,
    camera: Camera = None,
) -> None:
    """Plot trends: O-C of each body, pointing error, star residuals and detections; outliers are named.

    [bold]Example[/]

      opnav campaign plot --archive campaign.sqlite --body PLUTO,CHARON --out trends.png
    """
    filters = {"since": since, "until": until, "mission": mission, "camera": camera}
    with Campaign(archive, create=False) as campaign:
        found = trends(campaign, body=body, method=method, **filters)
        name = campaign.path.name
    write_png(trends_figure(found, name), out)
    console = Console(soft_wrap=True)
    print_outliers(console, found)
    console.print(f"Trends in {escape(str(out))}", highlight=False)


campaign_app.command()(stack)
