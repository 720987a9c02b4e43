"""Parts of the installation that not everybody needs, and the command that brings a missing one."""

import importlib.util
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from opnav_workbench.errors import OpNavError

__all__ = ["PARTS", "MissingPart", "install_command", "missing_part", "need", "told"]

# Extra of pyproject.toml: what it brings, and the modules by whose absence it is known.
PARTS: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "lab": (
            "JupyterLab, the workbench, notebooks and nights",
            (
                "jupyterlab",
                "jupyterlab_server",
                "bokeh",
                "ipywidgets",
                "anywidget",
                "traitlets",
                "IPython",
                "ipykernel",
                "papermill",
                "nbconvert",
                "nbformat",
            ),
        ),
        "docs": ("the documentation site", ("sphinx", "furo", "myst_parser")),
        "cluster": ("nights on a Dask cluster", ("distributed", "dask")),
        "online": ("catalogs of VizieR", ("astroquery",)),
    }
)


class MissingPart(OpNavError):  # noqa: N818  what is missing, not that it is an error
    """A part of the installation that is not there."""


def install_command(extra: str) -> str:
    """Return the command that brings a part.

    Examples
    --------
    >>> install_command("lab")
    'pip install "opnav_workbench[lab]"'
    """
    return f'pip install "opnav_workbench[{extra}]"'


def need(extra: str, what: str) -> None:
    """Stop before work begins that a part is needed for.

    Parameters
    ----------
    extra
        One of `PARTS`.
    what
        What needs it, for the message.

    Raises
    ------
    MissingPart
        A module of it is not installed.
    """
    for module in PARTS[extra][1]:
        if not _is_there(module):
            raise MissingPart(f"{what} needs {module}, which is not installed; {install_command(extra)}.")


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # hidden from this process
        return False


def missing_part(error: ModuleNotFoundError) -> MissingPart | None:
    """Return what a failed import tells a person; None where the module belongs to no part.

    Examples
    --------
    >>> str(missing_part(ModuleNotFoundError("no", name="bokeh.plotting")))
    'bokeh is not installed; for JupyterLab, the workbench, notebooks and nights: pip install "opnav_workbench[lab]".'
    """
    root = (error.name or "").partition(".")[0]
    for extra, (what, modules) in PARTS.items():
        if root in modules:
            return MissingPart(f"{root} is not installed; for {what}: {install_command(extra)}.")
    return None


def told(load: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a package's ``__getattr__`` that says which part is missing where an import fails."""

    def load_or_tell(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            part = missing_part(error)
            if part is None:
                raise
            raise part from error

    return load_or_tell
