"""Picture sequences: YAML files that say what is to be photographed, when, and how.

A sequence names a mission, its kernels and a star catalog, how its bodies look, what the detector does (as a picture
scenario of `opnav_workbench.simulation` does), and a list of pictures with times or cadences, pointings, exposures and
cameras. Ready ones stand in ``kernels_meta/<mission>/sequences`` and are called ``<mission>/<name>``; those files are
examples of the schema.
"""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import NonNegativeInt, PositiveFloat, PrivateAttr, field_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.planning.sequence_parts import (
    ApproachSearch,
    Limits,
    PlannedPicture,
    Pointing,
    PointingField,
    SunRule,
)
from opnav_workbench.resources import ready_file, ready_names
from opnav_workbench.simulation import DetectorEffects, PictureScenario
from opnav_workbench.simulation.scenario_parts import Motion
from opnav_workbench.simulation.scenario_surfaces import BodyOptions
from opnav_workbench.spice.scenario_parts import Strict
from opnav_workbench.yaml_file import Location, check_model, line_of, read_model

__all__ = ["PictureSequence", "load_sequence", "sequence_names"]

FOLDER = "sequences"
WHAT = "picture sequence"


class PictureSequence(Strict):
    """A whole sequence; see the files in ``kernels_meta/<mission>/sequences``."""

    description: str = ""
    mission: str  # name or YAML file
    kernels: str | None = None  # kernel-set name, metakernel or folder; a relative path counts from this file
    catalog: str = "bundled"
    magnitude_limit: float = 30.0  # of catalog stars
    seed: NonNegativeInt = 0  # of shake, and of pictures that confirm the plan
    bodies: tuple[BodyOptions, ...] = ()
    psf_sigma_px: tuple[PositiveFloat, PositiveFloat] | None = None  # in place of the camera's own PSF
    detector: DetectorEffects = DetectorEffects()
    motion: Motion = Motion()
    pointing: PointingField = Pointing(kernels=True)
    targets: tuple[str, ...] | None = None  # None: the mission's default targets
    sun: SunRule = SunRule()
    limits: Limits = Limits()
    pictures: tuple[PlannedPicture, ...] = ()
    search: tuple[ApproachSearch, ...] = ()
    _path: Path | None = PrivateAttr(default=None)

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[PlannedPicture, ...]) -> tuple[PlannedPicture, ...]:
        names = [picture.name for entry in pictures for picture in entry.expanded()]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is given twice; give each its own name")
        return pictures

    @property
    def path(self) -> Path | None:
        """The file it was read from."""
        return self._path

    @property
    def name(self) -> str:
        """A short name, for titles and files."""
        return "sequence" if self._path is None else self._path.stem

    def at_path(self, path: Path | None) -> "PictureSequence":
        """Return the sequence as the content of a file."""
        copy = self.model_copy()
        copy._path = path  # noqa: SLF001 - of the same class
        return copy

    def with_options(
        self, *, kernels: str | None = None, catalog: str | None = None, seed: int | None = None
    ) -> "PictureSequence":
        """Return the sequence with other sources; what is None stays. A path counts from the working folder."""
        if kernels is not None and Path(kernels).exists():
            kernels = str(Path(kernels).absolute())
        given = {"kernels": kernels, "catalog": catalog, "seed": seed}
        return self.model_copy(update={name: value for name, value in given.items() if value is not None})

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
            raise MissionError(f"{self._label()}: nothing to plan; give pictures, or a search.")
        shared = (
            "mission",
            "kernels",
            "catalog",
            "magnitude_limit",
            "seed",
            "bodies",
            "psf_sigma_px",
            "detector",
        )
        scenario = PictureScenario(pictures=pictures, **{name: getattr(self, name) for name in shared})
        return scenario.at_path(self._path)

    def fault(self, place: Location, message: str) -> MissionError:
        """Return the error for a field that the schema lets pass; it names file, line and field."""
        line = "" if self._path is None else f"line {line_of(self._path, place)}: "
        return MissionError(f"{self._label()}: {line}{'.'.join(str(part) for part in place)}: {message}")

    def _label(self) -> str:
        return WHAT if self._path is None else f"{WHAT} {self._path}"


def sequence_names() -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the ready sequences, sorted.

    Examples
    --------
    >>> "osiris_rex/bennu_approach" in sequence_names()
    True
    """
    return ready_names(FOLDER)


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
    if isinstance(source, Mapping):
        return check_model(source, PictureSequence, WHAT, MissionError)
    path = ready_file(source, FOLDER, WHAT, MissionError)
    return read_model(path, PictureSequence, WHAT, MissionError).at_path(path.resolve())
