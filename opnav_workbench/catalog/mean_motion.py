"""Mean motion of stars whose own motion is unknown: the Sun's reflex and the rotation of the Galaxy.

A star of unknown motion is most likely not at rest: the Sun moves through the stars around it, and the Galaxy turns. Over a
field all stars share this motion, so that leaving it out would shift the pointing as a whole: by 0.2 arcsec in 20 years.

    mu = -s(m) [S - r (S . r)] + A [(y, x, 0)]_perp + B (-y, x, 0)

with r = (x, y, z) the galactic direction, S the unit vector of the Sun's motion among the stars, s(m) its size over the
typical distance of stars of magnitude m, and A, B the Oort constants divided by 4.74. Source: Mignard (2000), A&A 354, 522
(the equations). Numbers: fitted robustly, by magnitude, to the displacement of 446,000 stars of magnitude 6 to 10 between
Tycho-2 (J2000) and Gaia (J2016). Hipparcos motions alone would give 30 % more: its faint stars were chosen for being near.
"""

from dataclasses import replace

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog.priors import RAD_PER_MAS
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.geometry import tangent_basis, unit_from_radec

__all__ = ["mean_motion_rad_yr", "with_mean_motion"]

# Size of the solar reflex at magnitude 8, mas/yr, its trend, and where the trend is held.
REFLEX_AT_8_MAS_YR = 10.6
REFLEX_DEX_PER_MAG = -0.075
REFLEX_MAG_RANGE = (4.0, 16.0)
SOLAR_MOTION = np.array([0.482, 0.802, 0.352])  # toward galactic center, rotation, north pole
OORT_A_MAS_YR, OORT_B_MAS_YR = 3.2, -2.7


def _galactic_from_j2000() -> FloatArray:
    axes = SkyCoord(np.eye(3) * u.one, frame="galactic", representation_type="cartesian").icrs
    return np.asarray(axes.cartesian.xyz.value.T)


GALACTIC_FROM_J2000 = _galactic_from_j2000()


def mean_motion_rad_yr(ra_rad: ArrayLike, dec_rad: ArrayLike, mag: ArrayLike) -> FloatArray:
    """Return the mean motion of stars of a magnitude in a direction.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) array_like
        J2000 (ICRS).
    mag : (n,) array_like
        Near V or G.

    Returns
    -------
    (n, 2) array
        Motion in RA (cos dec included) and Dec, rad per Julian year.

    Examples
    --------
    Toward Proxima Centauri stars of magnitude 10.5 drift to the south-west:

    >>> (mean_motion_rad_yr([3.794], [-1.094], [10.5]) / RAD_PER_MAS).round(0).tolist()
    [[-7.0, -6.0]]
    """
    ra, dec = np.asarray(ra_rad, float), np.asarray(dec_rad, float)
    x, y, _ = GALACTIC_FROM_J2000 @ np.moveaxis(unit_from_radec(ra, dec), -1, 0)
    bounded = np.clip(np.asarray(mag, float), *REFLEX_MAG_RANGE)
    reflex = REFLEX_AT_8_MAS_YR * 10.0 ** (REFLEX_DEX_PER_MAG * (bounded - 8.0))
    zero = np.zeros_like(x)
    rotation = OORT_A_MAS_YR * np.stack([y, x, zero]) + OORT_B_MAS_YR * np.stack([-y, x, zero])
    drift = (rotation - reflex * SOLAR_MOTION[:, None]).T @ GALACTIC_FROM_J2000
    east, north = tangent_basis(ra, dec)
    motion = np.stack([np.sum(east * drift, axis=-1), np.sum(north * drift, axis=-1)], axis=-1)
    return np.asarray(motion * RAD_PER_MAS)


def with_mean_motion(stars: StarTable) -> StarTable:
    """Return the stars with the mean motion where their own is unknown; `motion_known` stays False there."""
    if len(stars) == 0 or stars.motion_known.all():
        return stars
    mean = mean_motion_rad_yr(stars.ra_rad, stars.dec_rad, stars.mag)
    return replace(
        stars,
        pmra_rad_yr=np.where(stars.motion_known, stars.pmra_rad_yr, mean[:, 0]),
        pmdec_rad_yr=np.where(stars.motion_known, stars.pmdec_rad_yr, mean[:, 1]),
    )
