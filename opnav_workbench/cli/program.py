"""The ``opnav`` program: the table of its commands, loaded when they are called, and how errors reach a person.

Help over all commands needs their names and one line on each: both stand in `COMMANDS`, so that ``opnav --help`` loads
nothing that navigates. A test holds the table and the commands together.
"""

import gc
import io
import sys
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from opnav_workbench.cli.terminal import EXIT_BAD_INPUT, EXIT_STOPPED, error_console, shown
from opnav_workbench.errors import OpNavError
from opnav_workbench.parts import missing_part
from opnav_workbench.version import __version__

__all__ = ["COMMANDS", "CommandEntry", "app", "main"]

# At Python's 700 the garbage collector looks through what imports made so often that it takes a tenth of a short command.
OBJECTS_BETWEEN_COLLECTIONS = 10_000


class CommandEntry(NamedTuple):
    """Where a command stands: its module in this package, the function or `typer.Typer` in it, and its line of help."""

    module: str
    attribute: str
    help: str


COMMANDS = {
    "demo": CommandEntry(
        "demo",
        "demo",
        "Simulate New Horizons approach pictures, process them, and print truth beside solution.",
    ),
    "process": CommandEntry("process", "process", "Solve pointing and target centers of pictures."),
    "lab": CommandEntry(
        "lab",
        "lab",
        "Open the workbench on pictures, alone in a browser window, in a JupyterLab of its own; Ctrl-C stops it.",
    ),
    "nightly": CommandEntry(
        "nightly",
        "nightly",
        "Process many pictures headless: the notebook of each, an archive, and a page that tells what came out.",
    ),
    "export": CommandEntry("export", "export", "Export observables of many pictures to one file."),
    "check": CommandEntry(
        "check", "check", "Check files that opnav reads or writes: one line for each fault, with its field."
    ),
    "simulate": CommandEntry("simulate", "simulate", "Simulate pictures, each with its truth and a preview."),
    "plan": CommandEntry(
        "plan",
        "plan",
        "Plan pictures: stars, sizes, expected errors, Sun, first detection, best exposure, and a verdict on each.",
    ),
    "docs": CommandEntry("docs", "docs", "Build the documentation site offline, and open it."),
    "doctor": CommandEntry(
        "doctor",
        "doctor",
        "Show versions, missions, kernels, catalogs and notebook parts, and what to do about what is missing.",
    ),
    "ort": CommandEntry(
        "ort",
        "ort",
        "Operational readiness tests: a blinded package, its solution, and the score once the truth is opened.",
    ),
    "campaign": CommandEntry(
        "campaign",
        "campaign_app",
        "Many pictures: archive their runs, ask it, export observables, plot trends, stack faint targets.",
    ),
    "mission": CommandEntry(
        "mission",
        "mission_app",
        "Missions: list, show, and a new one from an instrument kernel or numbers, and a picture.",
    ),
    "kernels": CommandEntry(
        "kernels",
        "kernels_app",
        "SPICE kernels: list, check, fetch and make them, look into them, and use them.",
    ),
    "landmarks": CommandEntry(
        "landmarks",
        "landmarks_app",
        "Landmarks: make maplets of a body from its shape and albedo map, and show what a file of them holds.",
    ),
    "catalog": CommandEntry("catalog", "catalog_app", "Star catalogs: list, info, build, fetch, cone."),
    "calibrate": CommandEntry(
        "calibrate",
        "calibrate",
        "Calibrate a camera from its own star frames: optics and mounting, or its PSF.",
    ),
}


class CommandOnCall(TyperCommand):
    """A command or group of commands known by name and line of help; its module is imported when it is called."""

    def __init__(self, name: str, entry: CommandEntry) -> None:
        super().__init__(name, help=entry.help)
        self._entry = entry

    # The context carries the command that runs: from here on the one that was loaded does everything.
    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Load the command and let it read its arguments."""
        return self.loaded().make_context(info_name, args, parent, **extra)

    def loaded(self) -> Any:
        """Import the command's module and return the command."""
        found = getattr(import_module(f"opnav_workbench.cli.{self._entry.module}"), self._entry.attribute)
        owner = typer.Typer(rich_markup_mode="rich")
        if isinstance(found, typer.Typer):
            owner.add_typer(found, name=self.name)
        else:
            owner.command(self.name)(found)
        return get_group(owner).commands[str(self.name)]


class CommandTable(TyperGroup):
    """The group of all commands in `COMMANDS`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: CommandOnCall(name, entry) for name, entry in COMMANDS.items()}


app = typer.Typer(
    name="opnav",
    cls=CommandTable,
    help="Optical navigation: stars give the pointing, the pointing gives the target's direction.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


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
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that is no text must not end a run
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        app()
    except (OpNavError, ModuleNotFoundError) as error:
        known = missing_part(error) if isinstance(error, ModuleNotFoundError) else error
        if known is None:
            raise
        error_console().print(f"[bold red]error:[/] {shown(str(known))}", highlight=False)
        sys.exit(EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        Console(stderr=True).print("stopped; finished images are kept.")
        sys.exit(EXIT_STOPPED)
