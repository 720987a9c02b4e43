"""The workbench's notebook in the analyst's folder, with its parameters set."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.resources import notebooks_dir

__all__ = ["NOTEBOOK", "LabParameters", "put_notebook"]

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
            f"# Set by opnav lab\n{_listed('images', self.images)}"
            f"{_listed('folders', self.folders) if self.folders else ''}"
            f"mission = {json.dumps(self.mission)}\nkernels = {kernels}\ncatalog = {json.dumps(self.catalog)}\n"
            f"{_listed('targets', self.targets) if self.targets else ''}"
            'out = "."'
        )


def _listed(name: str, values: tuple[str, ...]) -> str:
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
        _set(notebook["cells"], parameters)
    except (OSError, ValueError, KeyError, TypeError, StopIteration) as error:
        raise SessionError(
            f"{source} cannot be read, or has no cell tagged {PARAMETERS_TAG!r}; move it away, and it is made anew."
        ) from error
    write_text(path, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
    return path.resolve()


def _set(cells: list[dict[str, Any]], parameters: LabParameters) -> None:
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
