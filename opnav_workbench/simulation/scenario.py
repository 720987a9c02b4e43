"""Picture scenarios: YAML files that say what is photographed, by which camera, and what is true but not known.

A scenario names a mission, its kernels and a star catalog, how its bodies look, how the true attitude and
ephemerides differ from the predicted ones, what the detector does, and a list of pictures. Ready ones stand in
``kernels_meta/<mission>/pictures`` and are called ``<mission>/<name>``; those files are examples of the schema.
`varied` returns a scenario with a few things changed (exposure, noise, surface, ephemeris), for trade studies and
sliders.
"""

from collections.abc import Mapping
from datetime import datetime, timedelta
from os import PathLike
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator, model_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.simulation.attitude_path import CameraMotion
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario_file import BodyAppearance, PicturesFile, require_distinct, word_for
from opnav_workbench.yaml_file import Also, FileStem, Pair, StrictModel, Utc, Vector3, check_model

__all__ = [
    "ActualAttitude",
    "ApparentPlaceEffects",
    "AttitudePlan",
    "BodyOffset",
    "MotionPlan",
    "Perturbations",
    "PictureEntry",
    "PictureScenario",
    "PredictedAttitude",
    "SpacecraftOffset",
    "load_picture_scenario",
    "picture_scenario_names",
    "require_short_series",
    "varied",
]


# ---- The parts of a picture scenario beside its bodies: attitude, perturbations of the truth, pictures.

ZERO3: Vector3 = (0.0, 0.0, 0.0)


class PredictedAttitude(StrictModel):
    """What the header says: ``kernels``, the CK; ``fixed``, boresight and twist, or a SPICE quaternion."""

    source: Literal["kernels", "fixed"]
    ra_deg: float | None = None
    dec_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    twist_deg: float = 0.0
    quaternion_camera_from_j2000: tuple[float, float, float, float] | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = (self.ra_deg is not None, self.dec_deg is not None, bool(self.quaternion_camera_from_j2000))
        wanted = (
            ((False, False, False),)
            if self.source == "kernels"
            else ((True, True, False), (False, False, True))
        )
        if given not in wanted:
            raise ValueError("with source: fixed give ra_deg and dec_deg, or quaternion_camera_from_j2000")
        return self


class ActualAttitude(StrictModel):
    """How the true attitude differs from the predicted one.

    ``none``: not at all; ``random``: an error of the camera's a priori size, from the seed; ``error``: `shift_px` and
    `twist_deg`; ``kernels``: the attitude of other kernels.
    """

    source: Literal["none", "random", "error", "kernels"]
    shift_px: Pair = (0.0, 0.0)  # where the boresight's sky moves on the detector: pixel, line
    twist_deg: float = 0.0  # true minus predicted
    kernels: str | None = None  # metakernel or kernel-set name with the CK as flown

    @model_validator(mode="after")
    def _fits_source(self) -> Self:
        if (self.source == "kernels") != (self.kernels is not None):
            raise ValueError("give kernels with source: kernels, and only then")
        if self.source != "error" and (self.shift_px != (0.0, 0.0) or self.twist_deg != 0.0):
            raise ValueError("shift_px and twist_deg need source: error")
        return self


class MotionPlan(StrictModel):
    """How the camera turns during the exposure."""

    rate_px_s: Pair = (0.0, 0.0)  # of the boresight's sky on the detector: pixel, line
    twist_rate_deg_s: float = 0.0
    jitter_px: NonNegativeFloat = 0.0  # 1 sigma of each axis
    jitter_hz: PositiveFloat = 5.0  # band in which it is
    from_kernels: bool = False  # add the turning that the CK has

    def camera_motion(self) -> CameraMotion:
        """Return the motion, but for what the CK has."""
        return CameraMotion(**self.model_dump(exclude={"from_kernels"}))


class AttitudePlan(StrictModel):
    """Predicted attitude (it stands in the header), true one, and motion during the exposure."""

    predicted: Annotated[PredictedAttitude, word_for("source"), Also(("string",))] = PredictedAttitude(
        source="kernels"
    )
    actual: Annotated[ActualAttitude, word_for("source"), Also(("string",))] = ActualAttitude(source="random")
    motion: MotionPlan = MotionPlan()


# -- truth ---------------------------------------------------------------------------------------------------------


class BodyOffset(StrictModel):
    """Moves a body, or a barycenter with all that belongs to it, from where the kernels have it."""

    name: Annotated[str, Field(min_length=1)]
    offset_km: Vector3 = ZERO3  # J2000
    toward_sun_km: float = 0.0  # along the line from the body to the Sun
    turned_rad: Vector3 = (
        ZERO3  # rotation vector about the body's axes, from the kernels' orientation to the true one
    )


class SpacecraftOffset(StrictModel):
    """True minus predicted state of the spacecraft, J2000."""

    position_km: Vector3 = ZERO3
    velocity_km_s: Vector3 = ZERO3


class Perturbations(StrictModel):
    """What is true but not in the kernels."""

    bodies: tuple[BodyOffset, ...] = ()
    spacecraft: SpacecraftOffset = SpacecraftOffset()


class ApparentPlaceEffects(StrictModel):
    """Effects on places, to see what each of them does; flight pictures have them all."""

    aberration: bool = True
    parallax: bool = True
    proper_motion: bool = True
    distortion: bool = True


# -- pictures ------------------------------------------------------------------------------------------------------


MOST_OF_SERIES = 10_000  # pictures; more is a misprint


def require_short_series(start: datetime, step_s: float, count: float) -> None:
    """Refuse a series of more pictures than a person means, or beyond the calendar.

    Raises
    ------
    ValueError
        With how many there would be.
    """
    if count > MOST_OF_SERIES:
        raise ValueError(f"{count:.0f} pictures; {MOST_OF_SERIES} at most")
    try:
        start + timedelta(seconds=(count - 1) * step_s)
    except OverflowError as error:
        raise ValueError(f"{count:.0f} pictures {step_s:g} s apart end beyond the calendar") from error


class PictureEntry(StrictModel):
    """One picture, or a series of them from `start` to `stop`."""

    name: FileStem
    utc: Utc | None = None  # mid-exposure
    start: Utc | None = None
    stop: Utc | None = None
    step_s: PositiveFloat | None = None
    camera: str | None = None  # name of the mission's camera file; or `header`
    header: dict[str, str | int | float] = Field(
        default_factory=dict
    )  # cards that tell the camera, and others to write
    exposure_s: PositiveFloat
    targets: tuple[str, ...] | None = None  # None: the bodies of the scenario
    level: Literal["raw", "calibrated"] = "calibrated"
    stretch: tuple[Literal["linear", "log"], ...] = ("log",)  # of the preview, one file each

    @model_validator(mode="after")
    def _one_time(self) -> Self:
        series = [value is not None for value in (self.start, self.stop, self.step_s)]
        if (self.utc is not None) == any(series) or (any(series) and not all(series)):
            raise ValueError("give either utc, or start, stop and step_s")
        if self.start is not None and self.stop is not None and self.step_s is not None:
            if self.stop < self.start:
                raise ValueError(f"stop {self.stop.isoformat()} is before start {self.start.isoformat()}")
            count = (self.stop - self.start).total_seconds() / self.step_s + 1
            require_short_series(self.start, self.step_s, count)
        return self

    def expanded(self) -> tuple[Self, ...]:
        """Return the pictures of a series, each with its own name (``NAME_0001``) and time."""
        if self.start is None or self.stop is None or self.step_s is None:
            return (self,)
        count = int((self.stop - self.start).total_seconds() / self.step_s + 1e-9) + 1
        plain: dict[str, Any] = {"start": None, "stop": None, "step_s": None}
        return tuple(
            self.model_copy(
                update={
                    **plain,
                    "name": f"{self.name}_{i + 1:04d}",
                    "utc": self.start + timedelta(seconds=i * self.step_s),
                }
            )
            for i in range(count)
        )


# ---- Picture scenarios.


class PictureScenario(PicturesFile):
    """A whole picture scenario; see the files in ``kernels_meta/<mission>/pictures``."""

    WHAT: ClassVar[str] = "picture scenario"
    FOLDER: ClassVar[str] = "pictures"
    UNTITLED: ClassVar[str] = "scenario"
    attitude: AttitudePlan = AttitudePlan()
    perturbations: Perturbations = Perturbations()
    switches: ApparentPlaceEffects = ApparentPlaceEffects()
    star_errors: bool = False  # stars are off by what their catalog leaves open, as the seed draws it
    pictures: tuple[PictureEntry, ...]

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[PictureEntry, ...]) -> tuple[PictureEntry, ...]:
        if not pictures:
            raise ValueError("no picture; give at least one")
        require_distinct([picture.name for entry in pictures for picture in entry.expanded()])
        return pictures

    def body(self, name: str) -> BodyAppearance:
        """Return how a body is drawn; one that is not listed has the defaults."""
        return next((b for b in self.bodies if b.name.upper() == name.upper()), BodyAppearance(name=name))


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


# ---- A scenario with a few things changed, for trade studies and sliders.


def varied(
    scenario: PictureScenario,
    *,
    exposure_s: float | None = None,
    noise: bool = True,
    law: str | None = None,
    albedo: Literal["uniform", "mottled"] | None = None,
    offset_body: str | None = None,
    toward_sun_km: float = 0.0,
) -> PictureScenario:
    """Return a scenario that differs from `scenario` in what is given; what is None stays.

    Parameters
    ----------
    exposure_s
        Of every picture.
    noise
        False: an ideal detector, electrons over gain.
    law
        Scattering law of every body, with its default parameters.
    albedo
        Surface of every body.
    offset_body
        Body or barycenter that is moved; its other offsets stay.
    toward_sun_km
        By how much, toward the Sun.

    Raises
    ------
    MissionError
        The scenario would break its schema (an exposure that is not positive, an unknown law).
    """
    content = scenario.model_dump()
    for picture in content["pictures"]:
        picture["exposure_s"] = picture["exposure_s"] if exposure_s is None else exposure_s
    content["bodies"] = [body | _changed_surface(law, albedo) for body in content["bodies"]]
    if not noise:
        content["detector"] = DetectorEffects.none()
    if offset_body is not None and toward_sun_km != 0.0:
        moved = {"name": offset_body, "toward_sun_km": toward_sun_km}
        content["perturbations"]["bodies"] = (*content["perturbations"]["bodies"], moved)
    changed = check_model(content, PictureScenario, PictureScenario.WHAT, MissionError)
    return changed.at_path(scenario.path)


def _changed_surface(law: str | None, albedo: str | None) -> dict[str, Any]:
    update: dict[str, Any] = {} if law is None else {"law": law}
    if albedo is not None:
        update["albedo"] = 0.5 if albedo == "uniform" else albedo
    return update
