"""``opnav lab``: JupyterLab with the workbench open on pictures, given, simulated, or left over from a night.

The workbench's notebook is put into the analyst's folder with its parameters set in a cell after its own, as
papermill does; cells that the analyst added to an older one are kept.
"""

import json
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from opnav_workbench.cli.lab_server import LabServer
from opnav_workbench.cli.processing_options import processing_of, processing_options, with_options
from opnav_workbench.cli.terminal import shown
from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.parts import need
from opnav_workbench.paths import exists, is_file
from opnav_workbench.processing import Processing
from opnav_workbench.processing.model import NO_TARGETS
from opnav_workbench.processing.queue_file import read_queue
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
WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
OWN_MARK = (
    "opnav_lab"  # static/bench.js of the extension runs a notebook that has it, and shows the workbench alone
)
PARAMETERS_TAG, SET_TAG = "parameters", "injected-parameters"  # papermill's words


@dataclass(frozen=True, slots=True)
class LabParameters:
    """What the notebook opens.

    Attributes
    ----------
    images
        Picture files or folders, in full.
    folders
        Names of the pictures' folders; empty: named after the pictures.
    """

    images: tuple[str, ...]
    how: Processing
    folders: tuple[str, ...] = ()

    def source(self) -> str:
        """Return the source of the parameters cell.

        Examples
        --------
        >>> print(LabParameters(("/data/a.fit",), Processing(mission="new_horizons", targets="PLUTO:limb_scan")).source())
        # Set by opnav lab
        images = [
            "/data/a.fit",
        ]
        mission = "new_horizons"
        kernels = None
        catalog = "bundled"
        targets = [
            "PLUTO",
        ]
        methods = {"PLUTO": "limb_scan"}
        out = "."
        """
        how = self.how
        values: dict[str, Any] = {"images": self.images}
        values |= {"folders": self.folders} if self.folders else {}
        values |= {"mission": how.mission, "kernels": how.kernels, "catalog": how.catalog}
        values |= {name: getattr(how, name) for name in how.said() if name not in values}
        values |= {"targets": NO_TARGETS} if how.targets == () else {}
        lines = [_assignment(name, value) for name, value in (values | {"out": "."}).items()]
        return "\n".join(["# Set by opnav lab", *lines])


def _assignment(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        lines = "".join(f"    {json.dumps(item)},\n" for item in value)
        return f"{name} = [\n{lines}]"
    return f"{name} = {'None' if value is None else json.dumps(value)}"


def put_notebook(folder: Path, parameters: LabParameters) -> Path:
    """Write the workbench's notebook into `folder`; cells that the analyst added to an older one are kept.

    Raises
    ------
    SessionError
        The folder cannot be written, or the notebook in it has lost its parameters cell.
    """
    make_folder(folder)
    path = folder / NOTEBOOK
    source = path if is_file(path) else notebooks_dir() / NOTEBOOK
    try:
        notebook: dict[str, Any] = json.loads(source.read_text(encoding="utf-8"))
        _set_parameters(notebook["cells"], parameters)
        notebook["metadata"][OWN_MARK] = True
        _drop_dead_views(notebook["cells"])
    except (OSError, ValueError, KeyError, TypeError, StopIteration) as error:
        raise SessionError(
            f"{source} cannot be read, or has no cell tagged {PARAMETERS_TAG!r}; move it away, and it is made anew."
        ) from error
    write_text(path, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
    return path.resolve()


def _drop_dead_views(cells: list[dict[str, Any]]) -> None:
    """Take out what showed the widgets of a kernel that is gone: the new one knows nothing of them."""
    for cell in cells:
        if "outputs" in cell:
            cell["outputs"] = [one for one in cell["outputs"] if WIDGET_VIEW not in one.get("data", {})]


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


@processing_options()
def lab(
    given: dict[str, Any],
    images: Annotated[
        list[Path] | None, typer.Argument(help="Pictures, or folders of them.", show_default=False)
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
    """Open the workbench on pictures, alone in a browser window, in a JupyterLab of its own; Ctrl-C stops it.

    [bold]Examples[/]

      opnav lab --demo

      opnav lab lor_*.fit --mission new_horizons --kernels approach.tm --out run

      opnav lab --queue night_2015-04-09

    Every decision is saved in OUT/<picture> as it is made; the same command goes on where it was left.
    """
    need("lab", "opnav lab")
    console = Console(soft_wrap=True, highlight=False)
    if sum([bool(images), queue is not None, demo]) != 1:
        raise SessionError("give pictures, or --queue DIR, or --demo: exactly one of them.")
    if queue is not None:
        parameters = _queued_pictures(queue, given, console)
        folder = out or queue
    elif demo:
        folder = out or Path("opnav_lab")
        parameters = _demo_pictures(folder, given, console)
    else:
        folder = out or Path("opnav_lab")
        parameters = _given_pictures(images or [], given)
    notebook = put_notebook(folder, parameters)
    _serve(notebook, console, browser=browser, port=port)


def _given_pictures(images: list[Path], given: Mapping[str, Any]) -> LabParameters:
    how = processing_of(given).with_full_paths()
    missing = [image for image in images if not exists(image)]
    how.opened()  # what is wrong is told here, not in the notebook
    if missing:
        raise SessionError(f"there is no picture {missing[0]}; check the path.")
    return LabParameters(tuple(str(image.resolve()) for image in images), how)


def _queued_pictures(folder: Path, given: Mapping[str, Any], console: Console) -> LabParameters:
    queue = read_queue(folder)
    if not queue.images:
        raise SessionError(f"nothing waits in {folder}: every picture of it was solved.")
    there = [item for item in queue.images if Path(item.image).is_file()]
    for item in queue.images:
        if item not in there:
            console.print(f"[yellow]left out[/] {shown(item.image)}: it is not there any more.")
    if not there:
        raise SessionError(
            f"none of the pictures that wait in {folder} is there; bring them back, or run the night anew."
        )
    if queue.how is None and "mission" not in given:
        raise SessionError(f"{folder} does not say which mission its pictures are of; give --mission.")
    how = processing_of(given) if queue.how is None else with_options(queue.how, given)
    return LabParameters(
        tuple(item.image for item in there), how.with_full_paths(), tuple(item.folder for item in there)
    )


def _demo_pictures(folder: Path, given: Mapping[str, Any], console: Console) -> LabParameters:
    demo = Processing(mission=DEMO_MISSION, kernels=DEMO_KERNELS, catalog=DEMO_CATALOG)
    how = with_options(demo, given)
    pictures = folder / "pictures"
    paths = [pictures / f"{request.name}.fit" for request in DEMO_PICTURES]
    if not all(path.is_file() for path in paths):
        console.print("Simulating two pictures of New Horizons on approach to Pluto ...")
        with KernelSet(DEMO_KERNELS):
            mission = load_mission(DEMO_MISSION)
            paths = [simulate_picture(r, mission, DEMO_CATALOG, pictures).picture for r in DEMO_PICTURES]
    return LabParameters(tuple(str(path.resolve()) for path in paths), how)


def _serve(notebook: Path, console: Console, *, browser: bool, port: int) -> None:
    with LabServer(notebook, port) as server:
        console.print(f"JupyterLab is at {server.url}", style="bold")
        console.print("The workbench opens there by itself. Ctrl-C stops JupyterLab; decisions are kept.")
        if browser and not webbrowser.open(server.browser_page()):
            console.print("No browser could be opened; open the address above yourself.")
        server.wait()
    console.print("JupyterLab has stopped.")
