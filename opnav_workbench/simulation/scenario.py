"""Picture scenarios: YAML files that say what is photographed, by which camera, and what is true but not known.

A scenario names a mission, its kernels and a star catalog, how its bodies look, how the true attitude and ephemerides
differ from the predicted ones, what the detector does, and a list of pictures. Ready ones stand in
``kernels_meta/<mission>/pictures`` and are called ``<mission>/<name>``; those files are examples of the schema.
"""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import NonNegativeInt, PositiveFloat, PrivateAttr, field_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.resources import ready_file, ready_names
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario_parts import (
    AttitudePlan,
    Perturbations,
    PictureEntry,
    Switches,
)
from opnav_workbench.simulation.scenario_surfaces import BodyOptions
from opnav_workbench.spice.scenario_parts import Strict
from opnav_workbench.yaml_file import Location, check_model, line_of, read_model

__all__ = ["PictureScenario", "load_picture_scenario", "picture_scenario_names"]

FOLDER = "pictures"
WHAT = "picture scenario"


class PictureScenario(Strict):
    """A whole picture scenario; see the files in ``kernels_meta/<mission>/pictures``."""

    description: str = ""
    mission: str  # name or YAML file
    kernels: str | None = None  # kernel-set name, metakernel or folder; a relative path counts from this file
    catalog: str = "bundled"
    magnitude_limit: float = 30.0  # of catalog stars
    seed: NonNegativeInt = 0
    bodies: tuple[BodyOptions, ...] = ()
    psf_sigma_px: tuple[PositiveFloat, PositiveFloat] | None = None  # in place of the camera's own PSF
    detector: DetectorEffects = DetectorEffects()
    attitude: AttitudePlan = AttitudePlan()
    perturbations: Perturbations = Perturbations()
    switches: Switches = Switches()
    pictures: tuple[PictureEntry, ...]
    _path: Path | None = PrivateAttr(default=None)

    @field_validator("bodies")
    @classmethod
    def _bodies_once(cls, bodies: tuple[BodyOptions, ...]) -> tuple[BodyOptions, ...]:
        _require_distinct([body.name.upper() for body in bodies])
        return bodies

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[PictureEntry, ...]) -> tuple[PictureEntry, ...]:
        if not pictures:
            raise ValueError("no picture; give at least one")
        _require_distinct([picture.name for entry in pictures for picture in entry.expanded()])
        return pictures

    @property
    def path(self) -> Path | None:
        """The file it was read from."""
        return self._path

    def at_path(self, path: Path | None) -> "PictureScenario":
        """Return the scenario as the content of a file."""
        copy = self.model_copy()
        copy._path = path  # noqa: SLF001 - of the same class
        return copy

    def with_options(
        self, *, seed: int | None = None, kernels: str | None = None, catalog: str | None = None
    ) -> "PictureScenario":
        """Return the scenario with other sources; what is None stays. A path counts from the working folder."""
        if kernels is not None and Path(kernels).exists():
            kernels = str(Path(kernels).absolute())
        given = {"seed": seed, "kernels": kernels, "catalog": catalog}
        return self.model_copy(update={name: value for name, value in given.items() if value is not None})

    @property
    def folder(self) -> Path:
        """Where relative paths count from."""
        return Path.cwd() if self._path is None else self._path.parent

    def body(self, name: str) -> BodyOptions:
        """Return how a body is drawn; one that is not listed has the defaults."""
        return next((b for b in self.bodies if b.name.upper() == name.upper()), BodyOptions(name=name))

    def kernel_source(self) -> str | None:
        """Return the kernel set to open: a name, or a path; None where the scenario names none."""
        if self.kernels is None:
            return None
        beside = self.folder / self.kernels
        return str(beside) if beside.exists() else self.kernels

    def fault(self, place: Location, message: str) -> MissionError:
        """Return the error for a field that the schema lets pass; it names file, line and field."""
        label = WHAT if self._path is None else f"{WHAT} {self._path}"
        line = "" if self._path is None else f"line {line_of(self._path, place)}: "
        return MissionError(f"{label}: {line}{'.'.join(str(part) for part in place)}: {message}")


def _require_distinct(names: Sequence[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)} is given twice; give each its own name")


def picture_scenario_names() -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the ready scenarios, sorted."""
    return ready_names(FOLDER)


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
    if isinstance(source, Mapping):
        return check_model(source, PictureScenario, WHAT, MissionError)
    path = ready_file(source, FOLDER, WHAT, MissionError)
    return read_model(path, PictureScenario, WHAT, MissionError).at_path(path.resolve())
