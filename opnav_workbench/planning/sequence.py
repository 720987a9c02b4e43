"""Picture sequences: YAML files that say what is to be photographed, when, and how.

A sequence names a mission, its kernels and a star catalog, how its bodies look, what the detector does (as a picture
scenario of `opnav_workbench.simulation` does), and a list of pictures with times or cadences, pointings, exposures and
cameras. Ready ones stand in ``kernels_meta/<mission>/sequences`` and are called ``<mission>/<name>``; those files are
examples of the schema.
"""

from collections.abc import Mapping
from os import PathLike
from typing import Any, ClassVar

from pydantic import field_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.planning.sequence_parts import (
    ApproachSearch,
    Limits,
    PlannedPicture,
    Pointing,
    PointingField,
    SunRule,
)
from opnav_workbench.simulation import PictureScenario
from opnav_workbench.simulation.scenario_file import PicturesFile, require_distinct
from opnav_workbench.simulation.scenario_parts import Motion

__all__ = ["PictureSequence", "load_sequence", "sequence_names"]


class PictureSequence(PicturesFile):
    """A whole sequence; see the files in ``kernels_meta/<mission>/sequences``."""

    WHAT: ClassVar[str] = "picture sequence"
    FOLDER: ClassVar[str] = "sequences"
    UNTITLED: ClassVar[str] = "sequence"
    motion: Motion = Motion()
    pointing: PointingField = Pointing(kernels=True)
    targets: tuple[str, ...] | None = None  # None: the mission's default targets
    sun: SunRule = SunRule()
    limits: Limits = Limits()
    pictures: tuple[PlannedPicture, ...] = ()
    search: tuple[ApproachSearch, ...] = ()

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[PlannedPicture, ...]) -> tuple[PlannedPicture, ...]:
        require_distinct([picture.name for entry in pictures for picture in entry.expanded()])
        return pictures

    def expanded(self) -> tuple[tuple[int, PlannedPicture], ...]:
        """Return every single picture with the index of its entry."""
        return tuple((i, picture) for i, entry in enumerate(self.pictures) for picture in entry.expanded())

    def scenario(self) -> PictureScenario:
        """Return what the pictures share, as a picture scenario without perturbations.

        Raises
        ------
        MissionError
            The sequence has neither a picture nor a search.
        """
        pictures: tuple[Any, ...] = tuple(self.pictures)[:1] or tuple(
            PlannedPicture(name=s.name, utc=s.start, camera=s.camera, exposure_s=s.exposure_s)
            for s in self.search[:1]
        )
        if not pictures:
            raise MissionError(f"{self.label}: nothing to plan; give pictures, or a search.")
        shared = {name: getattr(self, name) for name in PicturesFile.model_fields}
        return PictureScenario(pictures=pictures, **shared).at_path(self.path)


def sequence_names() -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the ready sequences, sorted.

    Examples
    --------
    >>> "osiris_rex/bennu_approach" in sequence_names()
    True
    """
    return PictureSequence.ready_names()


def load_sequence(source: str | PathLike[str] | Mapping[str, Any]) -> PictureSequence:
    """Read and check a picture sequence.

    Parameters
    ----------
    source : str, path or mapping
        Name of a ready sequence, YAML file, or its content.

    Raises
    ------
    MissionError
        The name is unknown (the message lists the known), or the file breaks the schema: the message names the line,
        the field and what may stand there.

    Examples
    --------
    >>> load_sequence({"mission": "new_horizons", "pictures": [{"name": "a", "exposure_s": 0}]})
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: picture sequence: pictures.0.exposure_s: Input should be greater than 0...
    """
    return PictureSequence.load(source)
