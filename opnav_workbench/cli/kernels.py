"""``opnav kernels``: what there is, what it covers, and kernels fetched, made and told about."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from opnav_workbench.cli.kernels_check import print_check
from opnav_workbench.cli.kernels_make import made_from_scenario, made_from_shape
from opnav_workbench.cli.kernels_output import print_brief, print_fetched, print_kernel_sets, print_made
from opnav_workbench.cli.kernels_solutions import geometry, make_ck
from opnav_workbench.downloads import Progress as DownloadProgress
from opnav_workbench.errors import KernelError
from opnav_workbench.mission import load_mission
from opnav_workbench.report import write_coverage
from opnav_workbench.spice import (
    FetchedKernels,
    KernelKind,
    KernelSet,
    ManifestKernel,
    brief,
    check_kernels,
    fetch_kernels,
    kernel_sets,
    match_kinds,
    packaged_leap_seconds,
)

__all__ = ["EXIT_GAP", "kernels_app"]

EXIT_GAP = 3
SHAPE_SUFFIXES = (".obj", ".cmod")

kernels_app = typer.Typer(
    name="kernels",
    help="SPICE kernels: list, check, fetch and make them, look into them, and use them.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
Source = Annotated[
    list[str],
    typer.Argument(help="Metakernel, kernel folder, kernel files or kernel-set name.", show_default=False),
]


@kernels_app.command("list")
def list_() -> None:
    """List the kernel sets that come with the package, and the flight kernels that can be fetched.

    [bold]Example[/]

      opnav kernels list
    """
    print_kernel_sets(Console(), kernel_sets())


@kernels_app.command()
def check(
    kernels: Source,
    time: Annotated[
        str | None,
        typer.Option(help="UTC, clock reading (3/0299171897:00000) or TDB s past J2000.", show_default=False),
    ] = None,
    mission: Annotated[
        str | None,
        typer.Option(
            "--mission",
            "-m",
            help="Ask about this mission's spacecraft and targets only.",
            show_default=False,
        ),
    ] = None,
    targets: Annotated[
        str | None, typer.Option(help="Ask about these bodies only, comma-separated.", show_default=False)
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(help="Ask about the attitude of this frame only: NH_LORRI.", show_default=False),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the coverage as PNG.", show_default=False)
    ] = None,
) -> None:
    """Show what kernels cover and what they lack, kind by kind and at a time.

    Exit status 3 where one of the eight kinds is missing, or something does not cover the time.

    [bold]Example[/]

      opnav kernels check new_horizons/pluto_approach --time 2015-07-09T04:29:00 -m new_horizons
    """
    bodies = [t.strip() for t in targets.split(",") if t.strip()] if targets else []
    spacecraft = None
    if mission is not None:
        about = load_mission(mission)
        spacecraft, bodies = about.spacecraft_id, bodies or list(about.default_targets)
        camera = camera or about.bus_frame
    found = check_kernels(kernels, time, spacecraft=spacecraft, targets=bodies, frame=camera)
    with packaged_leap_seconds() as lsk, KernelSet(lsk):
        print_check(Console(), found)
        if picture is not None:
            write_coverage(found, picture)
            Console().print(f"Written: {escape(str(picture))}", highlight=False, soft_wrap=True)
    if not found.ok:
        raise typer.Exit(EXIT_GAP)


@kernels_app.command()
def fetch(
    mission: Annotated[str, typer.Argument(help="Mission name or manifest YAML.", show_default=False)],
    only: Annotated[
        str | None,
        typer.Option(
            help="Only these kinds, comma-separated: LSK, SCLK, PCK, FK, IK, SPK, CK.", show_default=False
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Folder; by default the cache, where MISSION/flight names them.", show_default=False
        ),
    ] = None,
) -> None:
    """Fetch a mission's flight kernels from NASA's archive; what is here already is verified, not fetched again.

    A fetch that was stopped goes on where it was. Every file is held to its SHA-256.

    [bold]Example[/]

      opnav kernels fetch generic --only LSK
    """
    kinds = tuple(kind for word in only.split(",") for kind in match_kinds(word)) if only else ()
    console = Console()
    fetched = _fetched(mission, into, kinds)
    print_fetched(console, fetched)
    name = f"{fetched.manifest.mission}/flight" if into is None else str(fetched.metakernel)
    console.print(f"Look at them: opnav kernels check {name}", highlight=False, soft_wrap=True)


def _fetched(mission: str, into: Path | None, kinds: tuple[KernelKind, ...]) -> FetchedKernels:
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:

        def begin(kernel: ManifestKernel) -> DownloadProgress:
            task = bars.add_task(kernel.file, total=kernel.size)
            return lambda there, total: bars.update(task, completed=there, total=total)

        return fetch_kernels(mission, into, kinds=kinds, progress=begin)


@kernels_app.command()
def make(
    source: Annotated[
        str,
        typer.Argument(
            help="Scenario YAML, kernel-set name, or shape model (.obj, .cmod).", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder, by default kernels/NAME; or the DSK file.", show_default=False),
    ] = None,
    actual: Annotated[
        bool, typer.Option("--actual", help="Also the attitudes as flown, with the scenario's errors.")
    ] = False,
    body: Annotated[
        str | None, typer.Option(help="Shape model: the body's name.", show_default=False)
    ] = None,
    body_id: Annotated[
        int | None,
        typer.Option(
            help="Shape model: its NAIF number, if SPICE does not know the name.", show_default=False
        ),
    ] = None,
    frame: Annotated[
        str | None, typer.Option(help="Shape model: its body-fixed frame.", show_default=False)
    ] = None,
    unit: Annotated[str, typer.Option(help="Shape model: km or m.")] = "km",
    kernels: Annotated[
        str | None, typer.Option(help="Shape model: kernels that define body and frame.", show_default=False)
    ] = None,
) -> None:
    """Make every kernel of a scenario and its metakernel, or a DSK of a shape model.

    [bold]Example[/]

      opnav kernels make new_horizons/pluto_approach --out kernels

      opnav kernels make bennu.obj --body BENNU --body-id 2101955 --frame IAU_BENNU --out bennu.bds
    """
    console = Console()
    if Path(source).suffix.lower() in SHAPE_SUFFIXES:
        if frame is None or (body is None and body_id is None):
            raise KernelError(
                f"{source} is a shape model: say --body (or --body-id) and --frame, such as IAU_BENNU."
            )
        print_made(console, [made_from_shape(Path(source), out, body, body_id, frame, unit, kernels)], [])
        return
    files, metakernels = made_from_scenario(source, out, actual=actual)
    print_made(console, files, metakernels)


@kernels_app.command("brief")
def brief_(
    files: Annotated[
        list[Path],
        typer.Argument(help="Kernels; an SCLK or FK among them helps to read a CK.", show_default=False),
    ],
    kernels: Annotated[
        str | None,
        typer.Option(help="Kernels that help to read: the SCLK of a CK, names.", show_default=False),
    ] = None,
) -> None:
    """Tell what kernels hold: bodies, frames, types, times, comments, variables.

    [bold]Example[/]

      opnav kernels brief attitude.bc clock.tsc
    """
    console = Console()
    helpers = [*KernelSet(kernels).paths] if kernels is not None else []
    helpers += [path for path in files if path.suffix.lower() in (".tsc", ".tf") and path.is_file()]
    for number, path in enumerate(files):
        if number:
            console.print()
        print_brief(console, brief(path, helpers))


kernels_app.command()(geometry)
kernels_app.command("make-ck")(make_ck)
