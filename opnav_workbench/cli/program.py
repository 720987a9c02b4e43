"""The ``opnav`` program: the table of its commands, loaded when they are called, and how errors reach a person.

Help over all commands needs their names and one line on each: both stand in `COMMANDS`, so that ``opnav --help`` loads
nothing that navigates. A test holds the table and the commands together.
"""

import gc
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from opnav_workbench.cli.terminal import EXIT_BAD_INPUT, EXIT_STOPPED, error_console, shown
from opnav_workbench.errors import OpNavError
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.parts import missing_part
from opnav_workbench.threads import begin_with_one
from opnav_workbench.version import __version__

__all__ = ["COMMANDS", "CommandEntry", "app", "main"]

# At Python's 700 the garbage collector looks through what imports made so often that it takes a tenth of a short command.
OBJECTS_BETWEEN_COLLECTIONS = 10_000
# What typer raises of arguments, under whatever name it has its click.
MISUSE: type[Exception] = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException"
)


# A plugin of pydantic watches models; to look for one goes through all that is installed.
NO_PLUGINS = {"PYDANTIC_DISABLE_PLUGINS": "__all__"}
# SciPy copies the whole namespace of NumPy, and so loads of it what neither uses: a Fortran compiler's front end, tools
# for tests.
NUMPY_ON_DEMAND = ("f2py", "testing", "ctypeslib", "polynomial", "ma")
SPICE_LIBRARY_NAMES = {"win32": "cspice.dll", "darwin": "libcspice.dylib"}  # elsewhere libcspice.so


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
    "body": CommandEntry(
        "body",
        "body_app",
        "Bodies from sequences of pictures: size, axes, pole, spin, center of figure.",
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
        _spare_numpy()
        with _uncollected():
            module = import_module(f"opnav_workbench.cli.{self._entry.module}")
        found = getattr(module, self._entry.attribute)
        owner = typer.Typer(rich_markup_mode="rich")
        if isinstance(found, typer.Typer):
            owner.add_typer(found, name=self.name)
        else:
            owner.command(self.name)(found)
        return get_group(owner).commands[str(self.name)]


@contextmanager
def _uncollected() -> Iterator[None]:
    """Load modules without garbage collection, now and later: what they make stays, and to look through it takes long."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collecting:
            gc.enable()


def _spare_numpy() -> None:
    """Let parts of NumPy be loaded when something of them is used, and not when SciPy copies their names."""
    numpy = import_module("numpy")
    for name in NUMPY_ON_DEMAND:
        if name not in vars(numpy):  # an import of the part puts the part itself there
            setattr(numpy, name, module_on_demand(f"numpy.{name}"))


class CommandTable(TyperGroup):
    """The group of all commands in `COMMANDS`; Ctrl-C ends any of them with a line and a status of its own."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: CommandOnCall(name, entry) for name, entry in COMMANDS.items()}

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was called."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            error_console().print("stopped; what was finished is kept.")
            raise typer.Exit(getattr(stop, "status", EXIT_STOPPED)) from stop


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
    """Run the program; what was wrong is one line on standard error, and exit status 2."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if sys.argv[1:2] != ["lab"]:  # whose kernels are the user's own
        begin_with_one()
        for variable, value in (NO_PLUGINS | _packaged_spice()).items():
            os.environ.setdefault(variable, value)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that is no text must not end a run
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        status = app(prog_name="opnav", standalone_mode=False)
        _flush()
    except Exception as error:
        reason = _reason(error)
        if reason is None:
            raise
        if reason:
            error_console().print(f"[bold red]error:[/] {shown(reason)}", highlight=False)
        sys.exit(EXIT_BAD_INPUT)
    sys.exit(status if isinstance(status, int) else 0)


def _packaged_spice() -> dict[str, str]:
    """Tell spiceypy to take the CSPICE that it was packaged with; it looks for others first, and runs a compiler for it."""
    found = find_spec("spiceypy")
    library = SPICE_LIBRARY_NAMES.get(sys.platform, "libcspice.so")
    for folder in (found and found.submodule_search_locations) or ():
        path = Path(folder) / "utils" / library
        if path.is_file():
            return {"CSPICE_SHARED_LIB": str(path)}
    return {}  # a packager's own: spiceypy finds it


def _flush() -> None:
    """Write what is printed, so that a full disk is told; a pipe that nobody reads any more is no fault."""
    try:
        sys.stdout.flush()
    except OSError as error:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  Python flushes once more at its end
        if not isinstance(error, BrokenPipeError):
            raise


def _reason(error: Exception) -> str | None:
    """Return what a person is told of an error; None of a defect of ours."""
    if isinstance(error, ModuleNotFoundError):
        part = missing_part(error)
        return None if part is None else str(part)
    if isinstance(error, OpNavError):
        return str(error)
    if isinstance(error, MISUSE):
        return _misuse(error)
    if isinstance(error, OSError):  # of the machine: a disk that is full, a folder that is gone
        where = "" if error.filename is None else f" ({os.fsdecode(error.filename)})"
        return f"{error.strerror or error}{where}; see to that, and call it again."
    if isinstance(error, MemoryError):
        return "not enough memory for this; give less at a time, or a machine that has more."
    return None


def _misuse(error: Any) -> str:
    """Return in one line what is wrong with the arguments; empty where help was shown instead."""
    words = " ".join(error.format_message().split())
    context = getattr(error, "ctx", None)
    help_of = "opnav" if context is None else context.command_path
    if not words or type(error).__name__ == "NoArgsIsHelpError":
        return ""
    return f"{words.removesuffix('.')}; {help_of} --help tells what it takes."
