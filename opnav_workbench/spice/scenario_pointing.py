"""The pointing plan in a scenario file; calendar times are UTC."""

from typing import Annotated, Self

from pydantic import Field, PositiveFloat, model_validator

from opnav_workbench.spice.scenario_parts import BodyName, BodyRef, Strict, Utc

__all__ = ["AttitudeError", "Pointing", "Window"]


class Window(Strict):
    """A time during which the camera is held on something: targets, or a fixed direction."""

    start: Utc
    end: Utc
    step_s: PositiveFloat = 600.0
    track: tuple[BodyRef, ...] = ()  # several: the middle of their directions
    ra_deg: float | None = None
    dec_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    twist_deg: float = 0.0  # position angle of increasing line, east of J2000 north
    offset_px: tuple[float, float] = (0.0, 0.0)  # pixel, line of what is tracked, from the boresight

    @model_validator(mode="after")
    def _one_aim(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        fixed = self.ra_deg is not None and self.dec_deg is not None
        if fixed == bool(self.track) or (self.ra_deg is None) != (self.dec_deg is None):
            raise ValueError("give either track or both of ra_deg and dec_deg")
        return self


class AttitudeError(Strict):
    """How the flown attitude differs from the predicted one; see `delta_pixel, delta_line, delta_twist`."""

    shift_px: tuple[float, float] = (0.0, 0.0)  # where the boresight's sky moves on the detector
    twist_deg: float = 0.0


class Pointing(Strict):
    """The plan for one camera; what carries it follows."""

    instrument: BodyName
    windows: Annotated[tuple[Window, ...], Field(min_length=1)]
    actual: AttitudeError | None = None
