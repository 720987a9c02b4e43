"""What scenario files of every kind share: where they were read, ready ones by name, errors that name their lines."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import NonNegativeInt, PositiveFloat, PrivateAttr, field_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.resources import ready_file, ready_names
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario_surfaces import BodyOptions
from opnav_workbench.spice.scenario_parts import Strict
from opnav_workbench.yaml_file import Location, check_model, line_of, read_model

__all__ = ["PicturesFile", "ScenarioFile", "beside", "require_distinct"]


class ScenarioFile(Strict):
    """The content of a YAML file, with the place of that file, which relative paths count from."""

    WHAT: ClassVar[str]  # its kind, for messages
    FOLDER: ClassVar[str]  # of the ready ones, in a mission's ``kernels_meta``
    UNTITLED: ClassVar[str]  # the name of one that is in no file
    _path: Path | None = PrivateAttr(default=None)

    @classmethod
    def ready_names(cls) -> tuple[str, ...]:
        """Return the names ``<mission>/<name>`` of the ready files, sorted."""
        return ready_names(cls.FOLDER)

    @classmethod
    def load(cls, source: str | PathLike[str] | Mapping[str, Any]) -> Self:
        """Read and check a file.

        Parameters
        ----------
        source : str, path or mapping
            Name of a ready one, YAML file, or its content.

        Raises
        ------
        MissionError
            The name is unknown (the message lists the known), or the file breaks the schema: the message names the
            line, the field and what may stand there.
        """
        if isinstance(source, Mapping):
            return check_model(source, cls, cls.WHAT, MissionError)
        path = ready_file(source, cls.FOLDER, cls.WHAT, MissionError)
        return read_model(path, cls, cls.WHAT, MissionError).at_path(path.resolve())

    @property
    def path(self) -> Path | None:
        """The file it was read from."""
        return self._path

    @property
    def folder(self) -> Path:
        """Where relative paths count from."""
        return Path.cwd() if self._path is None else self._path.parent

    @property
    def name(self) -> str:
        """A short name, for titles and files: the file's stem."""
        return self.UNTITLED if self._path is None else self._path.stem

    @property
    def label(self) -> str:
        """Kind and file, for messages."""
        return self.WHAT if self._path is None else f"{self.WHAT} {self._path}"

    def at_path(self, path: Path | None) -> Self:
        """Return the same as the content of a file."""
        copy = self.model_copy()
        copy._path = path  # noqa: SLF001 - of the same class
        return copy

    def source(self, named: str) -> str:
        """Return a path that counts from the file as such, and a name as it is."""
        return beside(named, self.folder)

    def fault(self, place: Location, message: str) -> MissionError:
        """Return the error for a field that the schema lets pass; it names file, line and field."""
        line = "" if self._path is None else f"line {line_of(self._path, place)}: "
        return MissionError(f"{self.label}: {line}{'.'.join(str(part) for part in place)}: {message}")


class PicturesFile(ScenarioFile):
    """What pictures that are simulated and pictures that are planned have in common."""

    description: str = ""
    mission: str  # name or YAML file
    kernels: str | None = None  # kernel-set name, metakernel or folder; a relative path counts from this file
    catalog: str = "bundled"
    magnitude_limit: float = 30.0  # of catalog stars
    seed: NonNegativeInt = 0  # of all that is random
    bodies: tuple[BodyOptions, ...] = ()
    psf_sigma_px: tuple[PositiveFloat, PositiveFloat] | None = None  # in place of the camera's own PSF
    detector: DetectorEffects = DetectorEffects()

    @field_validator("bodies")
    @classmethod
    def _bodies_once(cls, bodies: tuple[BodyOptions, ...]) -> tuple[BodyOptions, ...]:
        require_distinct([body.name.upper() for body in bodies])
        return bodies

    def with_options(
        self, *, kernels: str | None = None, catalog: str | None = None, seed: int | None = None
    ) -> Self:
        """Return the same with other sources; what is None stays. A path counts from the working folder."""
        if kernels is not None and Path(kernels).exists():
            kernels = str(Path(kernels).absolute())
        given = {"kernels": kernels, "catalog": catalog, "seed": seed}
        return self.model_copy(update={name: value for name, value in given.items() if value is not None})

    def kernel_source(self) -> str | None:
        """Return the kernel set to open: a name, or a path; None where none is named."""
        return None if self.kernels is None else self.source(self.kernels)


def beside(named: str, folder: Path) -> str:
    """Return a path that counts from `folder` as such, and a name as it is."""
    path = folder / named
    return str(path) if path.exists() else named


def require_distinct(names: Sequence[str]) -> None:
    """Raise ValueError where a name stands twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)} is given twice; give each its own name")
