"""Picture scenarios: YAML files that say what is photographed, by which camera, and what is true but not known.

A scenario names a mission, its kernels and a star catalog, how its bodies look, how the true attitude and ephemerides
differ from the predicted ones, what the detector does, and a list of pictures. Ready ones stand in
``kernels_meta/<mission>/pictures`` and are called ``<mission>/<name>``; those files are examples of the schema.
"""

from collections.abc import Mapping
from os import PathLike
from typing import Any, ClassVar

from pydantic import field_validator

from opnav_workbench.simulation.scenario_file import PicturesFile, require_distinct
from opnav_workbench.simulation.scenario_parts import (
    AttitudePlan,
    Perturbations,
    PictureEntry,
    Switches,
)
from opnav_workbench.simulation.scenario_surfaces import BodyOptions

__all__ = ["PictureScenario", "load_picture_scenario", "picture_scenario_names"]


class PictureScenario(PicturesFile):
    """A whole picture scenario; see the files in ``kernels_meta/<mission>/pictures``."""

    WHAT: ClassVar[str] = "picture scenario"
    FOLDER: ClassVar[str] = "pictures"
    UNTITLED: ClassVar[str] = "scenario"
    attitude: AttitudePlan = AttitudePlan()
    perturbations: Perturbations = Perturbations()
    switches: Switches = Switches()
    pictures: tuple[PictureEntry, ...]

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[PictureEntry, ...]) -> tuple[PictureEntry, ...]:
        if not pictures:
            raise ValueError("no picture; give at least one")
        require_distinct([picture.name for entry in pictures for picture in entry.expanded()])
        return pictures

    def body(self, name: str) -> BodyOptions:
        """Return how a body is drawn; one that is not listed has the defaults."""
        return next((b for b in self.bodies if b.name.upper() == name.upper()), BodyOptions(name=name))


def picture_scenario_names() -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the ready scenarios, sorted."""
    return PictureScenario.ready_names()


def load_picture_scenario(source: str | PathLike[str] | Mapping[str, Any]) -> PictureScenario:
    """Read and check a picture scenario.

    Parameters
    ----------
    source : str, path or mapping
        Name of a ready scenario, YAML file, or its content.

    Raises
    ------
    MissionError
        The name is unknown (the message lists the known), or the file breaks the schema: the message names the line,
        the field and what may stand there.

    Examples
    --------
    >>> load_picture_scenario({"mission": "new_horizons", "pictures": [{"name": "a", "exposure_s": 0}]})
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: picture scenario: pictures.0.exposure_s: Input should be greater than 0...
    """
    return PictureScenario.load(source)
