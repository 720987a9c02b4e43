"""The parts of a picture scenario beside its bodies: attitude, perturbations of the truth, pictures."""

from datetime import timedelta
from typing import Annotated, Any, Literal, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from opnav_workbench.simulation.scenario_surfaces import word_for
from opnav_workbench.spice.scenario_parts import FileStem, Strict, Utc

__all__ = [
    "ActualAttitude",
    "AttitudePlan",
    "BodyOffset",
    "Motion",
    "Perturbations",
    "PictureEntry",
    "PredictedAttitude",
    "SpacecraftOffset",
    "Switches",
]

Vector3 = tuple[float, float, float]
Pair = tuple[float, float]
ZERO3: Vector3 = (0.0, 0.0, 0.0)


class PredictedAttitude(Strict):
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


class ActualAttitude(Strict):
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


class Motion(Strict):
    """How the camera turns during the exposure."""

    rate_px_s: Pair = (0.0, 0.0)  # of the boresight's sky on the detector: pixel, line
    twist_rate_deg_s: float = 0.0
    jitter_px: NonNegativeFloat = 0.0  # 1 sigma of each axis
    jitter_hz: PositiveFloat = 5.0  # band in which it is
    from_kernels: bool = False  # add the turning that the CK has


class AttitudePlan(Strict):
    """Predicted attitude (it stands in the header), true one, and motion during the exposure."""

    predicted: Annotated[PredictedAttitude, word_for("source")] = PredictedAttitude(source="kernels")
    actual: Annotated[ActualAttitude, word_for("source")] = ActualAttitude(source="random")
    motion: Motion = Motion()


# -- truth ---------------------------------------------------------------------------------------------------------


class BodyOffset(Strict):
    """Moves a body, or a barycenter with all that belongs to it, from where the kernels have it."""

    name: Annotated[str, Field(min_length=1)]
    offset_km: Vector3 = ZERO3  # J2000
    toward_sun_km: float = 0.0  # along the line from the body to the Sun


class SpacecraftOffset(Strict):
    """True minus predicted state of the spacecraft, J2000."""

    position_km: Vector3 = ZERO3
    velocity_km_s: Vector3 = ZERO3


class Perturbations(Strict):
    """What is true but not in the kernels."""

    bodies: tuple[BodyOffset, ...] = ()
    spacecraft: SpacecraftOffset = SpacecraftOffset()


class Switches(Strict):
    """Effects on places, to see what each of them does; flight pictures have them all."""

    aberration: bool = True
    parallax: bool = True
    proper_motion: bool = True
    distortion: bool = True


# -- pictures ------------------------------------------------------------------------------------------------------


class PictureEntry(Strict):
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
        if self.start is not None and self.stop is not None and self.stop < self.start:
            raise ValueError(f"stop {self.stop.isoformat()} is before start {self.start.isoformat()}")
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
