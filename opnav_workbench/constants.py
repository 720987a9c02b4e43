"""Constants of nature, of the sky, of statistics and of processes, each once and with its source.

What belongs to one instrument, one body or one estimator stands there; what two modules share stands here.
"""

import math

__all__ = [
    "ARCSEC_PER_RAD",
    "AU_KM",
    "DAY_S",
    "EARTH_ID",
    "FASTEST_STAR_RAD_YR",
    "FWHM_PER_SIGMA",
    "HOUR_S",
    "J2000_JD",
    "J2000_JYEAR",
    "JULIAN_YEAR_S",
    "KM_S_PER_AU_YEAR",
    "LAST_BARYCENTER_ID",
    "MAD_TO_SIGMA",
    "MINUTE_S",
    "OBLIQUITY_J2000_RAD",
    "ONE_THREAD",
    "PIXEL_VARIANCE_PX2",
    "RAD_PER_DEG",
    "RAD_PER_MAS",
    "SOLAR_CONSTANT_W_M2",
    "SOLAR_SYSTEM_BARYCENTER_ID",
    "SPEED_OF_LIGHT_KM_S",
    "SUN_GM_KM3_S2",
    "SUN_ID",
    "SUN_RADIUS_KM",
]


# ---- Time. Days and years are of 86400 s of TDB, as `et` counts them.

MINUTE_S, HOUR_S, DAY_S = 60.0, 3_600.0, 86_400.0
JULIAN_YEAR_S = 365.25 * DAY_S  # IAU
J2000_JD, J2000_JYEAR = 2_451_545.0, 2000.0  # TDB; et = 0


# ---- Angles.

RAD_PER_DEG = math.pi / 180.0
ARCSEC_PER_RAD = 648_000.0 / math.pi
RAD_PER_MAS = math.pi / (
    180.0 * 3.6e6
)  # 1e-3 / ARCSEC_PER_RAD differs in the last bit, and stored catalogs notice


# ---- Light, the Sun and the sky.

SPEED_OF_LIGHT_KM_S = 299_792.458  # exact: SI
AU_KM = 149_597_870.7  # exact: IAU 2012 resolution B2
KM_S_PER_AU_YEAR = AU_KM / JULIAN_YEAR_S  # 4.7404705, which the Hipparcos volumes call A_V
SUN_RADIUS_KM = 695_700.0  # nominal: IAU 2015 resolution B3
SUN_GM_KM3_S2 = 1.3271244e11  # nominal: IAU 2015 resolution B3
SOLAR_CONSTANT_W_M2 = 1361.0  # at 1 au, nominal: IAU 2015 resolution B3
OBLIQUITY_J2000_RAD = math.radians(84_381.448 / HOUR_S)  # IAU 1976, as SPICE's ECLIPJ2000
# Barnard's star (Benedict et al. 1999, AJ 118, 1086); none moves faster
FASTEST_STAR_RAD_YR = 10_400.0 * RAD_PER_MAS


# ---- NAIF's numbers of bodies.

SUN_ID, EARTH_ID = 10, 399
SOLAR_SYSTEM_BARYCENTER_ID = 0
LAST_BARYCENTER_ID = 9  # 0..9 are barycenters, where nothing is to be seen


# ---- Statistics.

# 1 / Phi^-1(3/4): sigma of a Gaussian over the median of its absolute deviations. Its full value, 1.48260222, is larger
# by 1.5e-6 of itself; five digits keep the results of earlier versions to the bit, and no median is known to better.
MAD_TO_SIGMA = 1.4826
# 2 sqrt(2 ln 2), 2.35482005 in full: sets how fine profiles are sampled, which needs no more digits.
FWHM_PER_SIGMA = 2.3548
# Of a square pixel along each side, in px^2; of a value rounded to a whole number too, in that number's unit squared.
PIXEL_VARIANCE_PX2 = 1.0 / 12.0


# ---- Processes.

# One picture runs in one thread: its matrices are small, threads that wait for them cost half as much processor time again,
# and sums do not depend on the number of cores.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
