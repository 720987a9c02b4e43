"""What stands in for astrometry that a catalog does not give: values of zero with honest sigmas.

A star without a known motion is not a star at rest, so its position sigma has to grow with the years from the
catalog epoch; the same holds for parallax and the observer's distance from the Sun.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray

__all__ = [
    "RAD_PER_DEG",
    "RAD_PER_MAS",
    "UNKNOWN_MOTION_MAS_YR",
    "unknown_parallax_sigma_mas",
    "unstated_motion_sigma_mas_yr",
    "unstated_parallax_sigma_mas",
]

RAD_PER_DEG = np.pi / 180.0
RAD_PER_MAS = np.pi / (180.0 * 3.6e6)

# One axis, 1 sigma, for a star of which no motion is known. Between Tycho-2 (J2000) and Gaia (J2016) 68 % of
# the 356,000 bundled stars without a motion (magnitude 7 to 10) moved by less than 12.4 mas/yr an axis.
UNKNOWN_MOTION_MAS_YR = 15.0

# 68 % of all stars of magnitude 7 lie below this parallax: 6.2 mas of the Gaia DR3 stars with G 6.5..7, 6.8
# mas of the Hipparcos stars with Hp 7..8, where Hipparcos was still nearly complete. Fainter Hipparcos
# stars were chosen for being near, so the trend of the complete range, 25 mas at magnitude 3.5 to 6.5 mas
# at 7, is continued.
PARALLAX_SIGMA_AT_7_MAS = 6.8
PARALLAX_DEX_PER_MAG = -0.15
PARALLAX_MAG_RANGE = (0.0, 20.0)  # the trend is held at its end values outside

# What a file with motions but without their sigmas gets: motions of catalogs with positions good to s mas
# are good to s mas/yr or better (Gaia, Hipparcos: observed for a few years), and never much worse than
# those of Tycho-2, 2.5 mas/yr for positions of 60 mas (Hog et al. 2000, A&A 355, L27). Parallaxes likewise:
# 1 mas is Hipparcos.
UNSTATED_MOTION_SIGMA_MAS_YR = 2.5
UNSTATED_PARALLAX_SIGMA_MAS = 1.0


def unknown_parallax_sigma_mas(mag: ArrayLike) -> FloatArray:
    """Return the 1 sigma of a parallax of zero, assumed for stars of magnitude `mag` (n,), in mas.

    Examples
    --------
    >>> unknown_parallax_sigma_mas([4.0, 7.0, 12.0]).round(1)
    array([19.2,  6.8,  1.2])
    """
    bounded = np.clip(np.asarray(mag, dtype=np.float64), *PARALLAX_MAG_RANGE)
    return np.asarray(PARALLAX_SIGMA_AT_7_MAS * 10.0 ** (PARALLAX_DEX_PER_MAG * (bounded - 7.0)))


def unstated_motion_sigma_mas_yr(position_sigma_mas: ArrayLike) -> FloatArray:
    """Return the sigma taken for motions of which only the sigma of the position is stated, mas/yr."""
    return np.minimum(np.asarray(position_sigma_mas, dtype=np.float64), UNSTATED_MOTION_SIGMA_MAS_YR)


def unstated_parallax_sigma_mas(position_sigma_mas: ArrayLike) -> FloatArray:
    """Return the sigma taken for parallaxes of which only the sigma of the position is stated, mas."""
    return np.minimum(np.asarray(position_sigma_mas, dtype=np.float64), UNSTATED_PARALLAX_SIGMA_MAS)
