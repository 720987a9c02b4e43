"""``opnav lab``: JupyterLab with the workbench open on pictures, given, simulated, or left over from a night.

The workbench's notebook is put into the analyst's folder with its parameters set in a cell after its own, as
papermill does; cells that the analyst added to an older one are kept.
"""

import json
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.campaign.analyst_queue import read_queue
from opnav_workbench.cli.lab_server import LabServer
from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.resources import notebooks_dir

__all__ = ["LabParameters", "lab", "put_notebook"]


# ---- The workbench's notebook in the analyst's folder, with its parameters set.

NOTEBOOK = "workbench.ipynb"
PARAMETERS_TAG, SET_TAG = "parameters", "injected-parameters"  # papermill's words


@dataclass(frozen=True, slots=True)
class LabParameters:
    """What the notebook opens.

    Attributes
    ----------
    images : tuple of str
        Picture files or folders, in full.
    mission : str
    kernels : str
        Empty: none.
    catalog : str
    folders : tuple of str
        Names of the pictures' folders; empty: named after the pictures.
    targets : tuple of str
        Empty: the mission's own.
    """

    images: tuple[str, ...]
    mission: str
    kernels: str
    catalog: str
    folders: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()

    def source(self) -> str:
        """Return the source of the parameters cell.

        Examples
        --------
        >>> print(LabParameters(("/data/a.fit",), "new_horizons", "", "bundled").source())
        # Set by opnav lab
        images = [
            "/data/a.fit",
        ]
        mission = "new_horizons"
        kernels = None
        catalog = "bundled"
        out = "."
        """
        kernels = json.dumps(self.kernels) if self.kernels else "None"
        return (
            f"# Set by opnav lab\n{_list_source('images', self.images)}"
            f"{_list_source('folders', self.folders) if self.folders else ''}"
            f"mission = {json.dumps(self.mission)}\nkernels = {kernels}\ncatalog = {json.dumps(self.catalog)}\n"
            f"{_list_source('targets', self.targets) if self.targets else ''}"
            'out = "."'
        )


def _list_source(name: str, values: tuple[str, ...]) -> str:
    lines = "".join(f"    {json.dumps(value)},\n" for value in values)
    return f"{name} = [\n{lines}]\n"


def put_notebook(folder: Path, parameters: LabParameters) -> Path:
    """Write the workbench's notebook into `folder`; cells that the analyst added to an older one are kept.

    Raises
    ------
    SessionError
        The folder cannot be written, or the notebook in it has lost its parameters cell.
    """
    make_folder(folder)
    path = folder / NOTEBOOK
    source = path if path.is_file() else notebooks_dir() / NOTEBOOK
    try:
        notebook: dict[str, Any] = json.loads(source.read_text(encoding="utf-8"))
        _set_parameters(notebook["cells"], parameters)
    except (OSError, ValueError, KeyError, TypeError, StopIteration) as error:
        raise SessionError(
            f"{source} cannot be read, or has no cell tagged {PARAMETERS_TAG!r}; move it away, and it is made anew."
        ) from error
    write_text(path, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
    return path.resolve()


def _set_parameters(cells: list[dict[str, Any]], parameters: LabParameters) -> None:
    """Put the parameters into the cell after the notebook's own, as papermill does."""
    tags = [cell["metadata"].get("tags", ()) for cell in cells]
    after = next(number for number, tag in enumerate(tags) if PARAMETERS_TAG in tag) + 1
    if after == len(cells) or SET_TAG not in tags[after]:
        cell: dict[str, Any] = {
            "cell_type": "code",
            "execution_count": None,
            "id": "set-by-opnav-lab",
            "outputs": [],
        }
        cells.insert(after, cell | {"metadata": {"tags": [SET_TAG]}})
    cells[after]["source"] = parameters.source().splitlines(keepends=True)


# ---- ``opnav lab``: JupyterLab with the workbench open on pictures.


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
        parameters = _queued_pictures(queue, mission, kernels, catalog, console)
        folder = out or queue
    elif demo:
        folder = out or Path("opnav_lab")
        parameters = _demo_pictures(folder, console)
    else:
        folder = out or Path("opnav_lab")
        parameters = _given_pictures(images or [], mission, kernels, catalog)
    notebook = put_notebook(folder, parameters)
    _serve(notebook, console, browser=browser, port=port)


def _given_pictures(
    images: list[Path], mission: str | None, kernels: str | None, catalog: str | None
) -> LabParameters:
    if mission is None:
        raise SessionError("--mission is missing; name the mission (new_horizons) or its YAML file.")
    load_mission(mission)  # a wrong name is told here, not in the notebook
    missing = [image for image in images if not image.exists()]
    if missing:
        raise SessionError(f"there is no picture {missing[0]}; check the path.")
    paths = tuple(str(image.resolve()) for image in images)
    return LabParameters(paths, _absolute(mission), _absolute(kernels or ""), catalog or "bundled")


def _queued_pictures(
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
        _absolute(mission),
        _absolute(kernels or queue.kernels),
        catalog or queue.catalog or "bundled",
        tuple(item.folder for item in there),
        queue.targets,
    )


def _demo_pictures(folder: Path, console: Console) -> LabParameters:
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


def _absolute(name: str) -> str:
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
