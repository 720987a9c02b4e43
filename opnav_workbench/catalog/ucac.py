"""What UCAC2 and UCAC4 rows have in common: positions carried to J2000 from their mean epochs, motions that are missing.

Both catalogs give positions at J2000.0 (moved there by the motion given), but sigmas at central epochs of observation
of their own in RA and dec. With c the years from there to J2000:

    sigma(J2000)^2 = sigma^2 + c^2 sigma_motion^2,    cov(position, motion) = c sigma_motion^2

so that the propagated sigma is smallest at the central epoch, as it is. Stars without a motion were not moved: their
position is that of the central epoch, which then is the epoch of the row (RA and dec apart by months at most: their mean).
"""

from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.catalog.priors import RAD_PER_MAS, UNKNOWN_MOTION_MAS_YR, unknown_parallax_sigma_mas

__all__ = ["UCAC_BAND", "astrometry_columns"]

UCAC_BAND = "UCAC"  # 579-642 nm, between V and R


def astrometry_columns(
    motion: FloatArray,
    motion_sigma: FloatArray,
    place_sigma: FloatArray,
    central_jyear: FloatArray,
    known: BoolArray,
    mag: FloatArray,
) -> dict[str, Any]:
    """Return the columns of motion, sigma and epoch of a `StarTable`.

    Parameters
    ----------
    motion, motion_sigma : (n, 2) array
        RA cos(dec) and dec, mas/yr.
    place_sigma, central_jyear : (n, 2) array
        Sigma in mas at the central epochs, RA cos(dec) and dec.
    known : (n,) array of bool
        Whether the star has a motion.
    mag : (n,) array
        For the parallax, which neither catalog gives.
    """
    moving, spread, years = motion * RAD_PER_MAS, motion_sigma, 2000.0 - central_jyear
    epoch = np.full(len(mag), 2000.0)
    if not known.all():
        still = ~known
        moving, spread = moving.copy(), spread.copy()
        moving[still], spread[still], years[still] = 0.0, UNKNOWN_MOTION_MAS_YR, 0.0
        epoch[still] = central_jyear[still].mean(axis=1)
    sigma = np.empty((len(mag), 5))
    sigma[:, :2] = np.sqrt(place_sigma**2 + (years * spread) ** 2)
    sigma[:, 2], sigma[:, 3:] = unknown_parallax_sigma_mas(mag), spread
    return {
        "pmra_rad_yr": moving[:, 0],
        "pmdec_rad_yr": moving[:, 1],
        "parallax_rad": np.zeros(len(mag)),
        "rv_km_s": np.full(len(mag), np.nan),
        "epoch_jyear": epoch,
        "sigma": sigma * RAD_PER_MAS,
        "position_motion": years * spread**2 * RAD_PER_MAS**2,
        "motion_known": known,
    }
