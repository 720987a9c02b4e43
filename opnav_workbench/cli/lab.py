"""``opnav lab``: JupyterLab with the workbench open on pictures."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.campaign.queue_file import read_queue
from opnav_workbench.cli.lab_notebook import LabParameters, put_notebook
from opnav_workbench.cli.lab_server import LabServer
from opnav_workbench.errors import SessionError
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.spice import KernelSet

__all__ = ["lab"]


def lab(
    images: Annotated[
        list[Path] | None, typer.Argument(help="Pictures, or folders of them.", show_default=False)
    ] = None,
    mission: Annotated[
        str | None, typer.Option("--mission", "-m", help="Mission name or mission YAML.", show_default=False)
    ] = None,
    kernels: Annotated[
        str | None, typer.Option(help="Metakernel, kernel folder or kernel-set name.", show_default=False)
    ] = None,
    catalog: Annotated[
        str | None,
        typer.Option(help="Catalog spec; see opnav catalog list. Default: bundled.", show_default=False),
    ] = None,
    queue: Annotated[
        Path | None,
        typer.Option(
            help="Work through the pictures that opnav nightly left in this folder.", show_default=False
        ),
    ] = None,
    demo: Annotated[bool, typer.Option("--demo", help="Simulate two pictures and open those.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for notebook, decisions and results. Default: opnav_lab.", show_default=False
        ),
    ] = None,
    browser: Annotated[bool, typer.Option(help="Open a browser window.")] = True,
    port: Annotated[int, typer.Option(help="Port of JupyterLab; 0 takes a free one.")] = 0,
) -> None:
    """Start JupyterLab with the workbench open on pictures; Ctrl-C stops it.

    [bold]Examples[/]

      opnav lab --demo

      opnav lab lor_*.fit --mission new_horizons --kernels approach.tm --out run

      opnav lab --queue night_2015-04-09

    Every decision is saved in OUT/<picture> as it is made; the same command goes on where it was left.
    """
    console = Console(soft_wrap=True, highlight=False)
    if sum([bool(images), queue is not None, demo]) != 1:
        raise SessionError("give pictures, or --queue DIR, or --demo: exactly one of them.")
    if queue is not None:
        parameters = _queued(queue, mission, kernels, catalog, console)
        folder = out or queue
    elif demo:
        folder = out or Path("opnav_lab")
        parameters = _demo(folder, console)
    else:
        folder = out or Path("opnav_lab")
        parameters = _given(images or [], mission, kernels, catalog)
    notebook = put_notebook(folder, parameters)
    _serve(notebook, console, browser=browser, port=port)


def _given(
    images: list[Path], mission: str | None, kernels: str | None, catalog: str | None
) -> LabParameters:
    if mission is None:
        raise SessionError("--mission is missing; name the mission (new_horizons) or its YAML file.")
    load_mission(mission)  # a wrong name is told here, not in the notebook
    missing = [image for image in images if not image.exists()]
    if missing:
        raise SessionError(f"there is no picture {missing[0]}; check the path.")
    paths = tuple(str(image.resolve()) for image in images)
    return LabParameters(paths, _in_full(mission), _in_full(kernels or ""), catalog or "bundled")


def _queued(
    folder: Path, mission: str | None, kernels: str | None, catalog: str | None, console: Console
) -> LabParameters:
    queue = read_queue(folder)
    if not queue.images:
        raise SessionError(f"nothing waits in {folder}: every picture of it was solved.")
    there = [item for item in queue.images if Path(item.image).is_file()]
    for item in queue.images:
        if item not in there:
            console.print(f"[yellow]left out[/] {escape(item.image)}: it is not there any more.")
    if not there:
        raise SessionError(
            f"none of the pictures that wait in {folder} is there; bring them back, or run the night anew."
        )
    mission = mission or queue.mission
    if not mission:
        raise SessionError(f"{folder} does not say which mission its pictures are of; give --mission.")
    return LabParameters(
        tuple(item.image for item in there),
        _in_full(mission),
        _in_full(kernels or queue.kernels),
        catalog or queue.catalog or "bundled",
        tuple(item.folder for item in there),
        queue.targets,
    )


def _demo(folder: Path, console: Console) -> LabParameters:
    pictures = folder / "pictures"
    paths = [pictures / f"{request.name}.fit" for request in DEMO_PICTURES]
    if not all(path.is_file() for path in paths):
        console.print("Simulating two pictures of New Horizons on approach to Pluto ...")
        with KernelSet(DEMO_KERNELS):
            mission = load_mission(DEMO_MISSION)
            paths = [simulate_picture(r, mission, DEMO_CATALOG, pictures).picture for r in DEMO_PICTURES]
    return LabParameters(
        tuple(str(path.resolve()) for path in paths), DEMO_MISSION, DEMO_KERNELS, DEMO_CATALOG
    )


def _in_full(name: str) -> str:
    """Return a path in full, because the notebook runs in another folder; a name of something as it is."""
    return str(Path(name).resolve()) if name and Path(name).exists() else name


def _serve(notebook: Path, console: Console, *, browser: bool, port: int) -> None:
    with LabServer(notebook, port) as server:
        console.print(f"JupyterLab is at {server.url}", style="bold")
        console.print("Run > Run All Cells shows the workbench. Ctrl-C stops JupyterLab; decisions are kept.")
        if browser and not webbrowser.open(server.url):
            console.print("No browser could be opened; open the address above yourself.")
        server.wait()
    console.print("JupyterLab has stopped.")
