"""The ``opnav`` program: its commands, and how errors reach a person (one line, no traceback; exit status 2)."""

import sys
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.cli.calibrate import calibrate
from opnav_workbench.cli.campaign import campaign_app
from opnav_workbench.cli.catalog import catalog_app
from opnav_workbench.cli.demo import demo
from opnav_workbench.cli.doctor import doctor
from opnav_workbench.cli.export import export
from opnav_workbench.cli.kernels import kernels_app
from opnav_workbench.cli.lab import lab
from opnav_workbench.cli.nightly import nightly
from opnav_workbench.cli.ort import ort
from opnav_workbench.cli.plan import plan
from opnav_workbench.cli.process import process
from opnav_workbench.cli.simulate import simulate
from opnav_workbench.cli.terminal import EXIT_BAD_INPUT
from opnav_workbench.errors import OpNavError
from opnav_workbench.version import __version__

__all__ = ["app", "main"]

app = typer.Typer(
    name="opnav",
    help="Optical navigation: stars give the pointing, the pointing gives the target's direction.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command()(demo)
app.command()(process)
app.command()(lab)
app.command()(nightly)
app.command()(export)
app.command()(simulate)
app.command()(plan)
app.add_typer(ort)
app.add_typer(campaign_app)
app.add_typer(kernels_app)
app.add_typer(catalog_app)
app.add_typer(calibrate)
app.command()(doctor)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"opnav_workbench {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Optical navigation: stars give the pointing, the pointing gives the target's direction."""


def main() -> None:
    """Run the program; a known error is one line on standard error and exit status 2."""
    try:
        app()
    except OpNavError as error:
        Console(stderr=True, soft_wrap=True).print(
            f"[bold red]error:[/] {escape(str(error))}", highlight=False
        )
        sys.exit(EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        Console(stderr=True).print("stopped; finished images are kept.")
        sys.exit(130)
