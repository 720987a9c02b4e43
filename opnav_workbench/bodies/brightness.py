"""What a mission file knows of a target's brightness, and its magnitude at the spacecraft.

The absolute magnitude is given, or follows from a magnitude measured at a known geometry (from Earth) or from albedo
and size; a phase law takes it to the spacecraft's geometry.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from opnav_workbench.bodies.phase_functions import (
    hg_phase_function,
    lambert_phase_function,
    lommel_seeliger_phase_function,
)
from opnav_workbench.bodies.photometry import disk_magnitude, distance_magnitude
from opnav_workbench.bodies.target import TargetState
from opnav_workbench.geometry import AU_KM, angle_between

__all__ = ["EarthApparent", "Photometry"]

PHASE_FUNCTIONS = {"lambert": lambert_phase_function, "lommel_seeliger": lommel_seeliger_phase_function}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class EarthApparent(_Strict):
    """A V magnitude measured from Earth (or anywhere), and where the body was then."""

    mag: float
    sun_au: PositiveFloat
    range_au: PositiveFloat
    phase_deg: Annotated[float, Field(ge=0.0, lt=180.0)] = 0.0


class Photometry(_Strict):
    """Brightness of a target.

    One of `absolute_mag`, `earth_apparent` and `geometric_albedo` says how bright it is, and at most one of
    `slope_mag_deg`, `g` and `law` how that changes with the phase angle (not at all by default, for an albedo as a
    Lambert sphere).

    Attributes
    ----------
    absolute_mag : float or None
        V at 1 au from Sun and observer and phase 0 as the phase law extrapolates it: H.
    earth_apparent : EarthApparent or None
        A measured magnitude.
    geometric_albedo : float or None
    diameter_km : float or None
        With an albedo; that of the body's radii where it is not given.
    slope_mag_deg : float or None
        Linear phase law.
    g : float or None
        Slope parameter of the H,G system.
    law : "lambert" or "lommel_seeliger" or None
        Phase function of a sphere.
    b_v : float
        Color, from which a camera's magnitude follows; the Sun's by default.

    Examples
    --------
    >>> pluto = Photometry(
    ...     earth_apparent={"mag": 14.2, "sun_au": 32.8, "range_au": 31.9, "phase_deg": 0.9}, slope_mag_deg=0.0294
    ... )
    >>> round(pluto.magnitude(32.9 * AU_KM, 6.3e6, np.radians(15.0)), 2)
    0.22
    """

    absolute_mag: float | None = None
    earth_apparent: EarthApparent | None = None
    geometric_albedo: Annotated[float, Field(gt=0.0)] | None = None
    diameter_km: PositiveFloat | None = None
    slope_mag_deg: float | None = None
    g: float | None = None
    law: Literal["lambert", "lommel_seeliger"] | None = None
    b_v: float = 0.65

    @model_validator(mode="after")
    def _one_of_each(self) -> "Photometry":
        given = [
            name
            for name in ("absolute_mag", "earth_apparent", "geometric_albedo")
            if getattr(self, name) is not None
        ]
        if len(given) != 1:
            raise ValueError("give one of absolute_mag, earth_apparent and geometric_albedo")
        laws = [name for name in ("slope_mag_deg", "g", "law") if getattr(self, name) is not None]
        if len(laws) > 1:
            raise ValueError(f"give one of {' and '.join(laws)}")
        if self.diameter_km is not None and self.geometric_albedo is None:
            raise ValueError("diameter_km goes with geometric_albedo")
        return self

    def magnitude(
        self, sun_km: float, range_km: float, phase_rad: float, radius_km: float | None = None
    ) -> float | None:
        """Return V at a distance from the Sun and from the observer and at a phase angle.

        None where only the albedo is known and neither `diameter_km` nor `radius_km` is; infinite for a body that
        shows no lit surface.
        """
        absolute = self._absolute(radius_km)
        if absolute is None:
            return None
        return absolute + distance_magnitude(sun_km, range_km) + self._fading(phase_rad)

    def of(self, target: TargetState) -> float | None:
        """Return V of a target as it is seen; None where it, or where the Sun is, is not known."""
        if target.sun_position_km is None:
            return None
        radius = None if target.radii_km is None else float(np.cbrt(np.prod(target.radii_km)))
        phase = float(angle_between(target.sun_position_km, -target.position_km))
        mag = self.magnitude(
            float(np.linalg.norm(target.sun_position_km)), target.range_km, phase, radius or None
        )
        return mag if mag is not None and np.isfinite(mag) else None

    def _absolute(self, radius_km: float | None) -> float | None:
        if self.absolute_mag is not None:
            return self.absolute_mag
        if self.earth_apparent is not None:
            seen = self.earth_apparent
            distance = distance_magnitude(seen.sun_au * AU_KM, seen.range_au * AU_KM)
            return seen.mag - distance - self._fading(float(np.radians(seen.phase_deg)))
        radius = radius_km if self.diameter_km is None else 0.5 * self.diameter_km
        if radius is None or self.geometric_albedo is None:
            return None
        return disk_magnitude(self.geometric_albedo, radius, AU_KM, AU_KM, 0.0)

    def _fading(self, phase_rad: float) -> float:
        """Magnitudes that the phase angle takes away."""
        if self.g is not None:
            light = hg_phase_function(phase_rad, self.g)
        elif self.law is not None or (self.geometric_albedo is not None and self.slope_mag_deg is None):
            light = PHASE_FUNCTIONS[self.law or "lambert"](phase_rad)
        else:
            return (self.slope_mag_deg or 0.0) * float(np.degrees(phase_rad))
        with np.errstate(divide="ignore"):
            return float(-2.5 * np.log10(np.maximum(light, 0.0)))
