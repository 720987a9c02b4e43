"""Proper motion and parallax where a catalog gives none: from two epochs, the mean of such stars, honest sigmas.

A star without a known motion is not a star at rest, so its position sigma has to grow with the years from the
catalog epoch; the same holds for parallax and the observer's distance from the Sun.

Mean motion of stars whose own is unknown
    The Sun moves through the stars around it, and the Galaxy turns. Over a field all stars share this motion, so
    that leaving it out would shift the pointing as a whole: by 0.2 arcsec in 20 years.

        mu = -s(m) [S - r (S . r)] + A [(y, x, 0)]_perp + B (-y, x, 0)

    with r = (x, y, z) the galactic direction, S the unit vector of the Sun's motion among the stars, s(m) its size
    over the typical distance of stars of magnitude m, and A, B the Oort constants divided by 4.74. Source: Mignard
    (2000), A&A 354, 522 (the equations). Numbers: fitted robustly, by magnitude, to the displacement of 446,000
    stars of magnitude 6 to 10 between Tycho-2 (J2000) and Gaia (J2016). Hipparcos motions alone would give 30 %
    more: its faint stars were chosen for being near.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.constants import RAD_PER_MAS
from opnav_workbench.geometry import tangent_basis, unit_from_radec

__all__ = [
    "UNKNOWN_MOTION_MAS_YR",
    "astrometry_columns",
    "mean_motion_rad_yr",
    "sky_offset_rad",
    "two_epoch_motion_rad_yr",
    "unknown_motion_mixture",
    "unknown_parallax_sigma_mas",
    "unstated_motion_sigma_mas_yr",
    "unstated_parallax_sigma_mas",
    "with_mean_motion",
]


# ---- What stands in for astrometry that a catalog does not give: values of zero with honest sigmas.


# One axis, 1 sigma, for a star of which no motion is known. Between Tycho-2 (J2000) and Gaia (J2016) 68 % of
# the 356,000 bundled stars without a motion (magnitude 7 to 10) moved by less than 12.4 mas/yr an axis. What a pointing
# rests on is the whole distribution, `unknown_motion_mixture`.
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


# The whole distribution: a mixture of three Gaussians about the mean motion, fitted to the displacements of 456,000 stars
# of magnitude 4 to 10.2 between Tycho-2 (J2000) and Gaia DR3 (J2016), in bins of magnitude and galactic latitude, the
# errors of Tycho-2 taken out. Sigma of an axis at magnitude 9.5 and latitude 0, its growth with |sin b| (e-folds), and
# the share of stars at |sin b| = 0 and its growth; all sigmas fall alike with the magnitude, to beyond that range.
MOTION_SIGMAS_AT_9_5_MAS_YR = np.array([3.35, 17.0, 98.0])
MOTION_EFOLDS = np.array([1.55, 1.02, 0.47])
MOTION_SHARES = np.array([[0.707, -0.18], [0.255, 0.14], [0.038, 0.04]])
MOTION_DEX_PER_MAG = -0.05
MOTION_MAG_RANGE = (4.0, 16.0)


def unknown_motion_mixture(
    ra_rad: ArrayLike, dec_rad: ArrayLike, mag: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return how the motions of stars scatter about the mean (see `mean_motion_rad_yr`): a mixture of three Gaussians.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) array_like
        J2000 (ICRS).
    mag : (n,) array_like
        Near V or G.

    Returns
    -------
    shares : (n, 3) array
        Of the stars that belong to each part.
    sigmas_rad_yr : (n, 3) array
        Of an axis.

    Examples
    --------
    Toward Wolf 359, far off the plane, one star of magnitude 11.8 in fifteen is fast:

    >>> shares, sigmas = unknown_motion_mixture([2.864], [0.122], [11.8])
    >>> shares.round(2).tolist(), (sigmas / RAD_PER_MAS).round(0).tolist()
    ([[0.56, 0.37, 0.07]], [[9.0, 30.0, 111.0]])
    """
    directions = unit_from_radec(np.asarray(ra_rad, float), np.asarray(dec_rad, float))
    height = np.abs(directions @ GALACTIC_FROM_J2000[2])[..., None]
    faint = np.clip(np.asarray(mag, float), *MOTION_MAG_RANGE)[..., None] - 9.5
    sigmas = (
        MOTION_SIGMAS_AT_9_5_MAS_YR * np.exp(MOTION_EFOLDS * height) * 10.0 ** (MOTION_DEX_PER_MAG * faint)
    )
    return MOTION_SHARES[:, 0] + MOTION_SHARES[:, 1] * height, np.asarray(sigmas * RAD_PER_MAS)


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


def astrometry_columns(
    mag: FloatArray,
    place_sigma_mas: FloatArray,
    motion_mas_yr: FloatArray,
    motion_sigma_mas_yr: FloatArray,
    motion_known: BoolArray,
    parallax_mas: FloatArray | None = None,
    parallax_sigma_mas: FloatArray | float = np.nan,
) -> dict[str, Any]:
    """Return the columns of a `StarTable` that tell motion, parallax and sigmas: the unknown as 0 with its prior.

    Parameters
    ----------
    mag : (n,) array
    place_sigma_mas : (n, 2) array
    motion_mas_yr, motion_sigma_mas_yr : (n, 2) array
        RA cos(dec) and dec.
    motion_known : (n,) array of bool
    parallax_mas, parallax_sigma_mas : (n,) array, optional
        Unknown where one of them is not finite.
    """
    parallax = np.full(mag.shape, np.nan) if parallax_mas is None else parallax_mas
    near = np.isfinite(parallax) & np.isfinite(parallax_sigma_mas)
    parallax_sigma = np.where(near, parallax_sigma_mas, unknown_parallax_sigma_mas(mag))
    moving = motion_known[:, None]
    motion_rad_yr = np.where(moving, motion_mas_yr, 0.0) * RAD_PER_MAS
    motion_sigma = np.where(moving, motion_sigma_mas_yr, UNKNOWN_MOTION_MAS_YR)
    return {
        "pmra_rad_yr": motion_rad_yr[:, 0],
        "pmdec_rad_yr": motion_rad_yr[:, 1],
        "parallax_rad": np.where(near, parallax, 0.0) * RAD_PER_MAS,
        "sigma": np.concatenate([place_sigma_mas, parallax_sigma[:, None], motion_sigma], axis=1)
        * RAD_PER_MAS,
        "motion_known": motion_known,
    }


# ---- Mean motion of stars whose own motion is unknown: the Sun's reflex and the rotation of the Galaxy.

# Size of the solar reflex at magnitude 8, mas/yr, its trend, and where the trend is held.
REFLEX_AT_8_MAS_YR = 10.6
REFLEX_DEX_PER_MAG = -0.075
REFLEX_MAG_RANGE = (4.0, 16.0)
SOLAR_MOTION = np.array([0.482, 0.802, 0.352])  # toward galactic center, rotation, north pole
OORT_A_MAS_YR, OORT_B_MAS_YR = 3.2, -2.7


# astropy's Galactic frame (IAU 1958 by way of FK5), digit for digit: to load it for nine numbers takes 0.06 s
GALACTIC_FROM_J2000 = np.array(
    [
        [-0.05487565771259163, -0.8734370519556159, -0.48383507361671546],
        [0.4941094371927268, -0.4448297212232952, 0.7469821839866676],
        [-0.8676661375596576, -0.19807633727300053, 0.4559838136873016],
    ],
    order="F",
)


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


# ---- Proper motion from the positions of a star at two epochs.


def sky_offset_rad(ra_rad: ArrayLike, dec_rad: ArrayLike, directions: FloatArray) -> FloatArray:
    """Return where directions lie from places on the sky, in the tangent plane there.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) array_like
        Places, J2000.
    directions : (n, 3) array
        Of any length, J2000.

    Returns
    -------
    (n, 2) array
        Toward east and north, rad; along a great circle a straight line in space keeps its direction.
    """
    here, axes = unit_from_radec(ra_rad, dec_rad), np.stack(tangent_basis(ra_rad, dec_rad), axis=-2)
    there = directions / np.sum(directions * here, axis=-1, keepdims=True)
    return np.asarray(np.einsum("nij,nj->ni", axes, there - here))


def two_epoch_motion_rad_yr(
    ra_rad: ArrayLike, dec_rad: ArrayLike, then_ra_rad: ArrayLike, then_dec_rad: ArrayLike, years: ArrayLike
) -> FloatArray:
    """Return the motion (n, 2) in RA (cos dec included) and Dec that carries stars from an earlier place to a later one.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) array_like
        Place for which the motion holds, J2000.
    then_ra_rad, then_dec_rad : (n,) array_like
        Place `years` before it; negative years: after it.
    years : (n,) array_like

    Examples
    --------
    >>> motion = two_epoch_motion_rad_yr([0.0], [0.0], [-1e-6], [2e-6], 10.0)
    >>> (1e7 * motion).round(6).tolist()
    [[1.0, -2.0]]
    """
    back = sky_offset_rad(ra_rad, dec_rad, unit_from_radec(then_ra_rad, then_dec_rad))
    return np.asarray(-back / np.broadcast_to(np.asarray(years, dtype=np.float64), back.shape[:1])[:, None])
