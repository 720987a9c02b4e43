"""How a rehearsal's scenario states its perturbations: each as a number, or as a distribution that the seed draws from.

The names are those of Jackman & Dumont, AAS 13-443: target barycenter, time of flight, B-plane target, spacecraft
ephemeris, attitude, albedo, camera, lost images, cosmic rays.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    model_validator,
)

from opnav_workbench.spice.scenario_parts import Strict

__all__ = [
    "AlbedoError",
    "Amount",
    "AttitudeError",
    "BPlaneShift",
    "CameraFault",
    "DataGaps",
    "Distribution",
    "LostImages",
    "OrtPerturbations",
    "SpacecraftError",
    "Storm",
    "TargetShift",
]


class Distribution(Strict):
    """A number to draw: normal with a sigma, or uniform between two ends; `either_sign` lets the seed turn its sign."""

    normal: PositiveFloat | None = None
    mean: float = 0.0
    uniform: tuple[float, float] | None = None
    either_sign: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.normal is None) == (self.uniform is None):
            raise ValueError("give normal (a sigma) or uniform (two ends)")
        if self.uniform is not None and (self.uniform[1] < self.uniform[0] or self.mean):
            raise ValueError("uniform takes its two ends, the lower first, and no mean")
        return self


def _stated(value: Any) -> Any:
    """Let a bare number stand for a distribution without width."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"uniform": (value, value)}
    return value


Amount = Annotated[Distribution, BeforeValidator(_stated)]
Three = tuple[Amount, Amount, Amount]
NOTHING = Distribution(uniform=(0.0, 0.0))


class TargetShift(Strict):
    """Moves the target's barycenter, and all that belongs to it, from where the predicted kernels have it."""

    body: Annotated[str, Field(min_length=1)]
    toward_sun_km: Amount = NOTHING
    any_direction_km: Amount = NOTHING  # a length, in a direction that the seed draws
    position_km: Three = (NOTHING,) * 3  # J2000
    velocity_km_s: Three = (NOTHING,) * 3

    def moves_position(self) -> bool:
        """Return whether a position is off at the epoch."""
        return _given((self.toward_sun_km, self.any_direction_km, *self.position_km))


class SpacecraftError(Strict):
    """True minus predicted state of the spacecraft at the epoch."""

    any_direction_km: Amount = NOTHING
    position_km: Three = (NOTHING,) * 3  # J2000
    velocity_km_s: Three = (NOTHING,) * 3

    def moves_position(self) -> bool:
        """Return whether a position is off at the epoch."""
        return _given((self.any_direction_km, *self.position_km))


class BPlaneShift(Strict):
    """Moves the spacecraft's incoming asymptote across, in the axes of the predicted B-plane."""

    b_dot_t_km: Amount = NOTHING
    b_dot_r_km: Amount = NOTHING


class AttitudeError(Strict):
    """True against predicted attitude; where it is left out, an error of the camera's a priori size."""

    shift_px: Amount = NOTHING  # length, in a direction that the seed draws
    twist_deg: Amount = NOTHING
    every_picture: bool = True  # an error of its own for each picture; else one for all


class AlbedoError(Strict):
    """A mottled surface where the team has a uniform one, and light that is not the predicted."""

    bodies: Annotated[tuple[str, ...], Field(min_length=1)]
    dark: Annotated[float, Field(ge=0.0, le=2.0)] = 0.2
    bright: Annotated[float, Field(gt=0.0, le=2.0)] = 0.8

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.bright <= self.dark:
            raise ValueError(f"bright {self.bright} is not above dark {self.dark}")
        return self


class CameraFault(Strict):
    """The true camera against the calibrated one."""

    focal_length: Amount = NOTHING  # relative: 1e-3 is a focal length longer by a thousandth
    corner_px: Amount = NOTHING  # radial (cubic) distortion that is not in the calibration, at the corners


class LostImages(Strict):
    """Pictures that never arrive, or only in part."""

    missing: NonNegativeInt = 0
    truncated: NonNegativeInt = 0
    spare: tuple[str, ...] = ()  # pictures that are never lost


class DataGaps(Strict):
    """Lines and blocks that telemetry loses in some of the pictures."""

    pictures: PositiveInt
    lines: NonNegativeInt = 0
    blocks: NonNegativeInt = 0
    block_px: PositiveInt = 32


class Storm(Strict):
    """A storm of energetic particles while some of the pictures are taken."""

    pictures: PositiveInt
    rate_per_cm2_s: Amount
    electrons_per_um: NonNegativeFloat = 80.0


class OrtPerturbations(Strict):
    """All of them; what is left out is as predicted."""

    target_barycenter: TargetShift | None = None
    spacecraft_ephemeris: SpacecraftError | None = None
    b_plane_target: BPlaneShift | None = None
    time_of_flight_s: Amount = NOTHING  # positive: the spacecraft arrives later than predicted
    attitude: AttitudeError | None = None
    albedo: AlbedoError | None = None
    camera: CameraFault | None = None
    lost_images: LostImages | None = None
    data_gaps: DataGaps | None = None
    cosmic_ray_storm: Storm | None = None

    def moved(self) -> tuple[str, ...]:
        """Return the estimator's parameters that they change."""
        groups: list[str] = []
        for mover, error in (("target", self.target_barycenter), ("spacecraft", self.spacecraft_ephemeris)):
            if error is not None:
                groups += [f"{mover}_position"] if error.moves_position() else []
                groups += [f"{mover}_velocity"] if _given(error.velocity_km_s) else []
        flyby = self.b_plane_target is not None or _given((self.time_of_flight_s,))
        return tuple(dict.fromkeys([*groups, *(["spacecraft_position"] if flyby else [])]))


def _given(amounts: Sequence[Distribution]) -> bool:
    return any(amount != NOTHING for amount in amounts)
