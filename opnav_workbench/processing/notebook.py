"""A `Processing` as flat parameters of notebooks, and back; the job of the notebook ``process_image.ipynb``.

Papermill, and an analyst in a parameters cell, give plain values; empty text means "not given".
"""

import ast
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar

from pydantic import Field

from opnav_workbench.errors import SessionError
from opnav_workbench.processing.automatic import Progress, open_or_resume, run_policy
from opnav_workbench.processing.model import OpenedProcessing, Processing, targets_text
from opnav_workbench.session import ImageSession

__all__ = ["PictureJob", "checked_parameters", "notebook_parameters", "picture_job"]

# What every notebook for pictures has; others are given only where they differ from their defaults, so that a notebook
# which does not know them serves as long as nobody wants them.
ALWAYS_GIVEN = (
    "mission",
    "kernels",
    "catalog",
    "targets",
    "methods",
    "target_stars",
    "decisions",
    "attitude",
    "model",
    "centers",
)
# What a notebook's namespace holds besides its parameters.
NOTEBOOK_NAMES = frozenset({"In", "Out"})

Job = TypeVar("Job", bound=Processing)


def notebook_parameters(how: Processing) -> dict[str, Any]:
    """Return what a notebook is given so that its job processes pictures in this way.

    Examples
    --------
    >>> how = Processing(mission="new_horizons", targets="PLUTO:limb_scan", model="image_plane")
    >>> given = notebook_parameters(how)
    >>> given["targets"], given["methods"], given["kernels"], "method" in given
    ('PLUTO', {'PLUTO': 'limb_scan'}, '', False)
    """
    different = [name for name in how.said() if name in Processing.model_fields and name not in ALWAYS_GIVEN]
    values = {name: getattr(how, name) for name in (*ALWAYS_GIVEN, *different)}
    values["targets"] = targets_text(how.targets)
    return {name: "" if value is None else value for name, value in values.items()}


def checked_parameters(namespace: Mapping[str, Any], model: type[Job]) -> Job:
    """Check a notebook's parameters: what its cells have assigned so far, not what a start-up file of IPython left there.

    A cell that is run again may find what later cells have made.

    Parameters
    ----------
    namespace
        The notebook's ``globals()`` after its parameters.
    model
        What the parameters describe.

    Raises
    ------
    SessionError
        A parameter is unknown, missing or of the wrong kind; papermill alone would only warn.
    """
    again = any(isinstance(value, model) for value in namespace.values())
    known = model.model_fields.keys() if again else _assigned(namespace)
    values = {
        name: value for name, value in namespace.items() if name in known and _is_parameter(name, value)
    }
    return model.checked(values, "notebook parameters")


def _assigned(namespace: Mapping[str, Any]) -> Collection[str]:
    """Return the names that the cells so far assign; outside a notebook all names."""
    cells = namespace.get("In")
    if not isinstance(cells, list):
        return namespace.keys()
    names: set[str] = set()
    for cell in cells:
        with suppress(SyntaxError, ValueError, TypeError):  # a cell for the shell assigns no parameter
            names |= {target.id for target in _targets(ast.parse(cell)) if isinstance(target, ast.Name)}
    return names


def _targets(cell: ast.Module) -> Iterator[ast.expr]:
    for statement in cell.body:
        if isinstance(statement, ast.Assign):
            yield from statement.targets
        elif isinstance(statement, ast.AnnAssign):
            yield statement.target


def _is_parameter(name: str, value: Any) -> bool:
    if name.startswith("_") or name in NOTEBOOK_NAMES or isinstance(value, Callable | ModuleType):  # type: ignore[arg-type]
        return False
    return value is not None and not (isinstance(value, str | list | tuple | dict) and len(value) == 0)


class PictureJob(Processing):
    """One picture and how it is to be processed.

    Attributes
    ----------
    ready
        Mission, catalog and decisions, read once.
    """

    image: str = Field(description="A picture file.")
    mode: Literal["interactive", "headless"] = Field(
        default="headless",
        description="Interactive shows the workbench, headless the same pictures as they are; the processing is the same.",
    )
    out: str = Field(
        default="", description="Folder of the picture's results; empty: run/<name of the picture>."
    )

    @property
    def interactive(self) -> bool:
        """Whether a person looks on."""
        return self.mode == "interactive"

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return Path(self.out) if self.out else Path("run") / Path(self.image).stem

    @cached_property
    def ready(self) -> OpenedProcessing:
        """Mission, catalog and decisions; raises as `opened`."""
        return self.opened()

    def open(self) -> ImageSession:
        """Open the picture, or continue the session that its folder holds; every step is saved there.

        Raises
        ------
        OpNavError
            As `ImageSession.open_or_resume`.
        """
        return open_or_resume(self.image, self.folder, self.ready)

    def process(self, session: ImageSession, say: Progress = print) -> None:
        """Carry out the decisions, else the automatic policy; a session that was worked on before stays as it is.

        Raises
        ------
        OpNavError
            A step cannot be carried out.
        """
        if session.standing:
            say(f"continuing a session of {len(session.standing)} steps")
        else:
            run_policy(session, self.ready, say)


def picture_job(namespace: Mapping[str, Any]) -> PictureJob:
    """Check the parameters of ``process_image.ipynb``.

    Parameters
    ----------
    namespace
        The notebook's ``globals()`` after its parameters.

    Raises
    ------
    SessionError
        As `checked_parameters`.

    Examples
    --------
    >>> picture_job({"image": "lor_0299.fit", "mission": "new_horizons"}).folder.as_posix()
    'run/lor_0299'
    """
    if not namespace.get("image"):
        raise SessionError(
            "no image given; set the parameter image to a picture's path (papermill: -p image FILE)."
        )
    return checked_parameters(namespace, PictureJob)
