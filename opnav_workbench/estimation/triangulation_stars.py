"""Places of catalog stars in space, with what the catalog does not know of them.

    s = (AU / parallax) (r0 + (p mu_ra* + q mu_dec + r0 mu_r) t)

as in `opnav_workbench.geometry.spacemotion`. Across the line of sight a near star is known to a thousandth of an
astronomical unit, along it to some ten of them; that matters little, for a spacecraft in the solar system looks almost along
it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import (
    AU_KM,
    KM_S_PER_AU_YEAR,
    SPEED_OF_LIGHT_KM_S,
    jyear_from_et,
    propagate,
    propagate_covariance,
    radec_from_unit,
    tangent_basis,
    unit_from_radec,
)

__all__ = ["StarPositions", "star_positions"]


@dataclass(frozen=True, slots=True, eq=False)
class StarPositions:
    """Stars in space; arrays are read-only.

    Attributes
    ----------
    position_km : (m, 3) array
        From the solar-system barycenter, J2000.
    covariance_km2 : (m, 3, 3) array
        From the catalog's errors of place, motion and parallax.
    """

    position_km: FloatArray
    covariance_km2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def star_positions(
    stars: StarTable, et: ArrayLike, observer_position_km: ArrayLike | None = None
) -> StarPositions:
    """Return where catalog stars stand in space, with covariance.

    Parameters
    ----------
    stars : StarTable
        m stars with parallaxes.
    et : float or (m,) array_like
        When they are seen, TDB seconds past J2000.
    observer_position_km : (3,) array_like, optional
        Roughly from where: a nearer observer sees a star later in its life. Left out, from the barycenter; 47 au, or six
        hours of proper motion, are 3 milliarcseconds for the fastest stars.

    Raises
    ------
    EstimationError
        A star whose parallax is not known to be positive.

    Examples
    --------
    >>> from opnav_workbench.catalog import read_star_list
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> stars = read_star_list(kernels_meta_dir() / "new_horizons" / "stars.yaml")
    >>> places = star_positions(stars, 640822038.0)  # Proxima Centauri and Wolf 359 in April 2020
    >>> print((np.linalg.norm(places.position_km, axis=1) / 3.0856775815e13).round(4))
    [1.3019 2.4087]
    """
    known = stars.parallax_rad > 0.0
    if not known.all():
        raise EstimationError(
            f"star {stars.id[~known][0]} has no parallax, so no place in space; take stars with a parallax."
        )
    observer = np.zeros(3) if observer_position_km is None else np.asarray(observer_position_km, float)
    toward = unit_from_radec(stars.ra_rad, stars.dec_rad)
    seen_et = np.asarray(et, float) + toward @ observer / SPEED_OF_LIGHT_KM_S
    direction = propagate(
        stars.ra_rad,
        stars.dec_rad,
        stars.pmra_rad_yr,
        stars.pmdec_rad_yr,
        stars.parallax_rad,
        stars.rv_km_s,
        stars.epoch_jyear,
        seen_et,
    )
    distance = _distance_km(stars, seen_et)[:, None]
    tangent = np.stack(tangent_basis(*radec_from_unit(direction)), axis=1)
    across = np.swapaxes(tangent, 1, 2) @ _sky_covariance(stars, seen_et) @ tangent
    along = (stars.sigma[:, 2] / stars.parallax_rad)[:, None] * direction
    spread = across + along[:, :, None] * along[:, None]
    return StarPositions(direction * distance, symmetric(spread * distance[:, None] ** 2))


def _distance_km(stars: StarTable, et: FloatArray) -> FloatArray:
    """Return the distances (m,), grown since the catalog epoch by radial velocity and proper motion."""
    years = jyear_from_et(et) - stars.epoch_jyear
    outward = np.nan_to_num(stars.rv_km_s) / KM_S_PER_AU_YEAR * stars.parallax_rad
    across = np.hypot(stars.pmra_rad_yr, stars.pmdec_rad_yr)
    return np.asarray(AU_KM / stars.parallax_rad * np.hypot(1.0 + outward * years, across * years))


def _sky_covariance(stars: StarTable, et: FloatArray) -> FloatArray:
    """Return the covariance (m, 2, 2) of the barycentric directions toward east and north."""
    return propagate_covariance(
        stars.covariance,
        stars.epoch_jyear,
        et,
        stars.ra_rad,
        stars.dec_rad,
        pmra_rad_yr=stars.pmra_rad_yr,
        pmdec_rad_yr=stars.pmdec_rad_yr,
        parallax_rad=stars.parallax_rad,
        rv_km_s=stars.rv_km_s,
    )
