"""``opnav mission``: which missions there are, what their cameras rest on, and a new one from a kernel and a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from opnav_workbench.camera import Camera, Origin
from opnav_workbench.cli.terminal import error_console, folding_table, shown
from opnav_workbench.commissioning import NewMission, Wanted
from opnav_workbench.commissioning import new_mission as make_mission
from opnav_workbench.commissioning.cameras import Numbers
from opnav_workbench.errors import MissionError
from opnav_workbench.mission import load_mission, mission_names

__all__ = ["mission_app"]

mission_app = typer.Typer(
    name="mission",
    help="Missions: list, show, and a new one from an instrument kernel or numbers, and a picture.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
HOW_STYLES = {"known": "green", "derived": "cyan", "guessed": "yellow"}


@mission_app.command("list")
def list_missions() -> None:
    """List the missions that come with the package, and their cameras.

    [bold]Example[/]

      opnav mission list
    """
    table = folding_table(("mission", "spacecraft", "cameras"))
    for name in mission_names():
        mission = load_mission(name)
        table.add_row(name, mission.spacecraft_name, ", ".join(mission.camera_names))
    Console().print(table)


@mission_app.command("show")
def show_mission(
    mission: Annotated[str, typer.Argument(help="Name, or path of a mission file.", show_default=False)],
) -> None:
    """Show a mission's cameras: optics, what has confirmed them, and which values were known, derived or guessed.

    [bold]Example[/]

      opnav mission show dawn
    """
    console, content = Console(), load_mission(mission)
    console.print(
        f"[bold]{shown(content.name)}[/]: {shown(content.spacecraft_name)} ({content.spacecraft_id}), {content.path}"
    )
    for choice in content.cameras:
        camera = Camera.from_yaml(choice.file)
        console.print(f"\n[bold]{shown(choice.file.stem)}[/]  {_optics(camera)}", highlight=False)
        console.print(f"  source: {shown(camera.source)}", highlight=False)
        _print_confirmed(console, camera)
        _print_origins(console, camera.origins)


def _optics(camera: Camera) -> str:
    scale = camera.pixel_scale_rad * 1e6
    return (
        f"{shown(camera.name)}: {camera.n_pixel} x {camera.n_line}, {camera.focal_length_mm:g} mm, {scale:.4g} urad/px, "
        f"frame {shown(camera.frame)}"
    )


def _print_confirmed(console: Console, camera: Camera) -> None:
    told = camera.confirmed_by and f"  confirmed by {shown(camera.confirmed_by)}"
    console.print(
        told or "  [yellow]no picture or label is known to have confirmed this camera[/]", highlight=False
    )


def _print_origins(console: Console, origins: Sequence[Origin]) -> None:
    for how, style in HOW_STYLES.items():
        for origin in origins:
            if origin.how == how:
                console.print(
                    f"  [{style}]{how:8}[/] {shown(origin.field)}: {shown(origin.text)}", highlight=False
                )


@mission_app.command("new")
def new(
    name: Annotated[str, typer.Argument(help="Of the mission: small letters.", show_default=False)],
    image: Annotated[Path | None, typer.Option(help="A picture of the camera.", show_default=False)] = None,
    ik: Annotated[
        list[str] | None,
        typer.Option(help="Instrument kernel; ISIS addendum and FK too, one --ik each.", show_default=False),
    ] = None,
    isd: Annotated[
        Path | None,
        typer.Option(help="Image support data (ALE's JSON) instead of a kernel.", show_default=False),
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(help="NAIF number or part of the name, of several.", show_default=False)
    ] = None,
    kernels: Annotated[
        str | None, typer.Option(help="Flight kernels of the picture.", show_default=False)
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Body whose limb tells the orientation.", show_default=False)
    ] = None,
    focal_mm: Annotated[
        float | None, typer.Option(min=0.01, help="Focal length.", show_default=False)
    ] = None,
    pixel_um: Annotated[
        float | None, typer.Option(min=0.1, help="Size of a pixel.", show_default=False)
    ] = None,
    fov_deg: Annotated[
        float | None,
        typer.Option(min=0.001, max=170.0, help="Field of view along pixel.", show_default=False),
    ] = None,
    size: Annotated[
        str | None, typer.Option(help="Pixels and lines, such as 1024x1024.", show_default=False)
    ] = None,
    line_time_s: Annotated[
        float | None,
        typer.Option(
            help="Rolling shutter, line scan: from line to line, s; below 0: last first.", show_default=False
        ),
    ] = None,
    line_scan: Annotated[
        bool, typer.Option("--line-scan", help="A line scanner: its motion (--kernels) makes the lines.")
    ] = False,
    catalog: Annotated[str, typer.Option(help="Star catalog of the whole sky.")] = "bundled",
    out: Annotated[Path | None, typer.Option(help="Folder; default: the name.", show_default=False)] = None,
    compare: Annotated[bool, typer.Option(help="Simulate a picture to compare.")] = True,
) -> None:
    """Make a mission: its files, from an instrument kernel, image support data or numbers, and a picture.

    Tries the eight orientations of the detector against the stars, or the limb of a target, and says what it knew, derived
    and guessed.

    [bold]Examples[/]

      opnav mission new probe --ik probe_cam.ti --image first_light.fit
      opnav mission new cubesat --fov-deg 20 --image night.fits

      opnav mission new mapped --isd frame.json --image frame.cub

      opnav mission new scanner --ik scan.ti --line-scan --line-time-s 0.004 --image strip.fit --kernels flight.tm
    """
    numbers = Numbers(focal_mm, pixel_um, fov_deg, _size(size), line_time_s, line_scan)
    folder = Path(name) if out is None else out
    wanted = Wanted(
        name, folder, image, tuple(ik or ()), kernels, instrument, numbers, target, catalog, compare, isd
    )
    with error_console().status("") as status:
        made = make_mission(wanted, lambda words: status.update(shown(words)))
    _print_new(Console(), made, wanted)


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.strip().isdigit() and int(part) > 0 for part in parts):
        raise MissionError(f"--size {text!r}: give pixels and lines, such as 1024x1024.")
    return int(parts[0]), int(parts[1])


def _print_new(console: Console, made: NewMission, wanted: Wanted) -> None:
    console.print(f"[bold]{_optics(made.camera)}[/]", highlight=False)
    _print_origins(console, made.origins)
    console.print(f"[bold]orientation[/]  {shown(made.orientation)}", highlight=False)
    if made.mirrored:
        console.print(
            "[yellow]the picture is mirrored[/] against what kernel or guess said: the axes now say so"
        )
    if made.solved:
        console.print(f"[bold]picture[/]      {shown(made.solved)}", highlight=False)
    if made.known_mission:
        console.print(
            f"[cyan]this picture is one of mission {shown(made.known_mission)}, which comes with opnav[/]"
        )
    folder = shown(str(made.folder))
    console.print(f"\nMission in {folder}/: mission.yaml, cameras/camera.yaml", highlight=False)
    views = ", ".join(path.name for path in made.simulated if path.suffix in (".fit", ".png"))
    if views:
        console.print(f"Simulated to compare, in {folder}/simulated/: {shown(views)}", highlight=False)
    for caution in made.cautions:
        console.print(f"[yellow]star_field: {shown(caution)}[/]", highlight=False, soft_wrap=True)
    picture = shown(str(wanted.image)) if wanted.image else f"{folder}/simulated/star_field.fit"
    if wanted.image is None and not views:
        picture = "PICTURE"
    kernels = f" --kernels {shown(wanted.kernels)}" if wanted.kernels else ""
    if wanted.numbers.scans and not wanted.kernels:
        kernels = f" --kernels {folder}/kernels/star_fields.tm"
        made_first = f"Next: opnav kernels make {folder}/star_fields.yaml --out {folder}/kernels"
        console.print(f"{made_first}   (a scan is solved with its motion)", highlight=False)
    console.print(f"Next: opnav process {picture} --mission {folder}{kernels}", highlight=False)
