"""The parts of a picture sequence: pointings, pictures, approach searches, limits, the Sun."""

from datetime import datetime
from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from opnav_workbench.simulation.scenario_parts import Pair, PictureEntry
from opnav_workbench.spice.scenario_parts import FileStem, Strict, Utc

__all__ = ["ApproachSearch", "Limits", "PlannedPicture", "Pointing", "SunRule"]

Degrees90 = Annotated[float, Field(ge=-90.0, le=90.0)]
StrayLight = tuple[Annotated[float, Field(ge=0.0, le=180.0)], NonNegativeFloat]


def _names(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_names)]


class Pointing(Strict):
    """Where the camera looks: the CK (``kernels``), the middle of bodies (``track``), or a direction.

    ``twist_deg`` is the position angle, east of north, of increasing line; ``offset_px`` moves what is tracked, or the
    direction, from the boresight's place on the detector along pixel and line.
    """

    kernels: bool = False
    track: Names = ()
    ra_deg: float | None = None
    dec_deg: Degrees90 | None = None
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


def _pointing(value: Any) -> Any:
    return {"kernels": True} if value == "kernels" else value


PointingField = Annotated[Pointing, BeforeValidator(_pointing)]


class PlannedPicture(PictureEntry):
    """A picture, or a cadence of them from `start` to `stop`; what is not given is the sequence's."""

    pointing: PointingField | None = None


class ApproachSearch(Strict):
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
            raise ValueError(f"stop {_text(self.stop)} is not after start {_text(self.start)}")
        return self


def _text(moment: datetime) -> str:
    return moment.isoformat()


class SunRule(Strict):
    """What the Sun allows, as the mission states it.

    ``stray_light_dn_s`` has pairs of solar elongation (deg, increasing) and level (DN per second and pixel); between
    them it is interpolated in the logarithm, outside the nearest holds.
    """

    keep_out_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    stray_light_dn_s: tuple[StrayLight, ...] = ()
    source: str = ""

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        angles = [angle for angle, _ in self.stray_light_dn_s]
        if any(b <= a for a, b in pairwise(angles)):
            raise ValueError("the elongations of stray_light_dn_s must increase")
        return self


class Limits(Strict):
    """What makes a picture good, marginal or bad."""

    star_snr: PositiveFloat = 5.0  # a fainter star is not used: what processing has by default
    min_stars: PositiveInt = 3  # fewer: marginal (nothing tells a wrong star from a right one)
    target_snr: PositiveFloat = 5.0  # below: bad, the body is not found
    clear_snr: PositiveFloat = 10.0  # below: marginal
    target_sigma_px: PositiveFloat | None = None  # above: marginal
    target_sigma_km: PositiveFloat | None = None
    edge_sigmas: NonNegativeFloat = 3.0  # of the a priori pointing, that a target keeps from the edge
