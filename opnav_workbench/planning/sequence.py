"""Picture sequences: YAML files that say what is to be photographed, when, and how.

A sequence names a mission, its kernels and a star catalog, how its bodies look, what the detector does (as a
picture scenario of `opnav_workbench.simulation` does), and a list of pictures with times or cadences, pointings,
exposures and cameras; besides approach searches, the limits of a good picture, and what the Sun allows. Ready ones
stand in ``kernels_meta/<mission>/sequences`` and are called ``<mission>/<name>``; those files are examples of the
schema.
"""

from collections.abc import Mapping
from itertools import pairwise
from os import PathLike
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    field_validator,
    model_validator,
)

from opnav_workbench.errors import MissionError
from opnav_workbench.simulation import PictureScenario
from opnav_workbench.simulation.scenario import MotionPlan, PictureEntry
from opnav_workbench.simulation.scenario_file import PicturesFile, require_distinct
from opnav_workbench.yaml_file import Also, FileStem, Pair, StrictModel, Utc

__all__ = [
    "ApproachSearch",
    "PictureSequence",
    "PlanLimits",
    "PlannedPicture",
    "PlannedPointing",
    "SunRule",
    "load_sequence",
    "sequence_names",
]


# ---- The parts of a picture sequence: pointings, pictures, approach searches, limits, the Sun.

Declination = Annotated[float, Field(ge=-90.0, le=90.0)]
StrayLightLevel = tuple[Annotated[float, Field(ge=0.0, le=180.0)], NonNegativeFloat]


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_one_or_more), Also(("string",))]


class PlannedPointing(StrictModel):
    """Where the camera looks: the CK (``kernels``), the middle of bodies (``track``), or a direction.

    ``twist_deg`` is the position angle, east of north, of increasing line; ``offset_px`` moves what is tracked, or the
    direction, from the boresight's place on the detector along pixel and line.
    """

    kernels: bool = False
    track: Names = ()
    ra_deg: float | None = None
    dec_deg: Declination | None = None
    twist_deg: float = 0.0
    offset_px: Pair = (0.0, 0.0)

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.ra_deg is None) != (self.dec_deg is None):
            raise ValueError("give ra_deg and dec_deg together")
        if [self.kernels, bool(self.track), self.ra_deg is not None].count(True) != 1:
            raise ValueError("give one of: kernels, track: BODY, or ra_deg and dec_deg")
        if self.kernels and (self.twist_deg != 0.0 or self.offset_px != (0.0, 0.0)):
            raise ValueError("twist_deg and offset_px do not go with the pointing of the kernels")
        return self

    @property
    def words(self) -> str:
        """What it is, for people."""
        if self.kernels:
            return "from CK"
        if self.track:
            return "tracks " + " + ".join(self.track)
        return f"RA {self.ra_deg:.4f}°, Dec {self.dec_deg:+.4f}°"


def _bare_kernels(value: Any) -> Any:
    return {"kernels": True} if value == "kernels" else value


PlannedPointingField = Annotated[PlannedPointing, BeforeValidator(_bare_kernels), Also(("string",))]


class PlannedPicture(PictureEntry):
    """A picture, or a cadence of them from `start` to `stop`; what is not given is the sequence's."""

    pointing: PlannedPointingField | None = None


class ApproachSearch(StrictModel):
    """When a body that comes nearer is first bright enough."""

    name: FileStem
    target: str
    camera: str
    exposure_s: PositiveFloat
    start: Utc
    stop: Utc
    snr: PositiveFloat = 5.0
    stack: PositiveInt = 10  # pictures added
    stray_light: bool = True  # that of the sequence's table

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.stop <= self.start:
            raise ValueError(f"stop {self.stop.isoformat()} is not after start {self.start.isoformat()}")
        return self


class SunRule(StrictModel):
    """What the Sun allows, as the mission states it.

    ``stray_light_dn_s`` has pairs of solar elongation (deg, increasing) and level (DN per second and pixel); between
    them it is interpolated in the logarithm, outside the nearest holds.
    """

    keep_out_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    stray_light_dn_s: tuple[StrayLightLevel, ...] = ()
    source: str = ""

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        angles = [angle for angle, _ in self.stray_light_dn_s]
        if any(b <= a for a, b in pairwise(angles)):
            raise ValueError("the elongations of stray_light_dn_s must increase")
        return self


class PlanLimits(StrictModel):
    """What makes a picture good, marginal or bad."""

    star_snr: PositiveFloat = 5.0  # a fainter star is not used: what processing has by default
    min_stars: PositiveInt = 3  # fewer: marginal (nothing tells a wrong star from a right one)
    target_snr: PositiveFloat = 5.0  # below: bad, the body is not found
    clear_snr: PositiveFloat = 10.0  # below: marginal
    target_sigma_px: PositiveFloat | None = None  # above: marginal
    target_sigma_km: PositiveFloat | None = None
    edge_sigmas: NonNegativeFloat = 3.0  # of the a priori pointing, that a target keeps from the edge


# ---- Picture sequences: YAML files that say what is to be photographed, when, and how.


class PictureSequence(PicturesFile):
    """A whole sequence; see the files in ``kernels_meta/<mission>/sequences``."""

    WHAT: ClassVar[str] = "picture sequence"
    FOLDER: ClassVar[str] = "sequences"
    UNTITLED: ClassVar[str] = "sequence"
    motion: MotionPlan = MotionPlan()
    pointing: PlannedPointingField = PlannedPointing(kernels=True)
    targets: tuple[str, ...] | None = None  # None: the mission's default targets
    sun: SunRule = SunRule()
    limits: PlanLimits = PlanLimits()
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
        return PictureScenario(pictures=pictures, **shared).at_path(self.path, self.WHAT)


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
