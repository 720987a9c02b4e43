"""A star's direction at an epoch and from a place in the solar system: linear space motion and parallax.

With r0, p, q the unit vectors toward the catalogue position, east and north, and t in Julian years since the
catalogue epoch, the star stands, in units of its distance at that epoch, at

    b = r0 + (p mu_ra* + q mu_dec + r0 mu_r) t - parallax x / AU,    mu_r = rv parallax / (AU/yr),

and is seen along unit(b); x is the observer's barycentric position. The Roemer delay x.r0 / c is part of t:
an observer nearer to the star sees it as the barycenter will see it later. Proper motion in RA includes
cos Dec. Time runs in `et` or Julian years with J2000.0 = et 0; TDB and TCB, 16 ppb apart, are not told apart.

Source: ESA (1997), The Hipparcos and Tycho Catalogues, vol. 1, sections 1.2.8 and 1.5.5; Lindegren et al.
(2012), A&A 538, A78, eq. 4, doi:10.1051/0004-6361/201117905. As in those catalogues, the change of the light
time that comes with the star's own motion is part of the observed proper motion and radial velocity; its
second order, 0.1 mas after 20 years for the fastest stars on the sky, is left out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.constants import AU_KM, J2000_JYEAR, JULIAN_YEAR_S, KM_S_PER_AU_YEAR, SPEED_OF_LIGHT_KM_S
from opnav_workbench.geometry.rotations import radec_from_unit, tangent_basis, unit, unit_from_radec

__all__ = [
    "et_from_jyear",
    "jyear_from_et",
    "propagate",
    "propagate_covariance",
]


def jyear_from_et(et_s: ArrayLike) -> FloatArray:
    """Return the Julian epoch (like 2016.0) of an `et`.

    Examples
    --------
    >>> float(jyear_from_et(et_from_jyear(2015.5)))
    2015.5
    """
    return np.asarray(J2000_JYEAR + np.asarray(et_s, float) / JULIAN_YEAR_S)


def et_from_jyear(jyear: ArrayLike) -> FloatArray:
    """Return the `et`, seconds past J2000, of a Julian epoch (like 2016.0)."""
    return np.asarray((np.asarray(jyear, float) - J2000_JYEAR) * JULIAN_YEAR_S)


def propagate(
    ra_rad: ArrayLike,
    dec_rad: ArrayLike,
    pmra_rad_yr: ArrayLike,
    pmdec_rad_yr: ArrayLike,
    parallax_rad: ArrayLike,
    rv_km_s: ArrayLike,
    epoch_jyear: ArrayLike,
    et_s: ArrayLike,
    observer_position_km: ArrayLike | None = None,
) -> FloatArray:
    """Return geometric star directions as seen at `et_s` by an observer: space motion and parallax.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) array_like
        Catalogue positions at `epoch_jyear`, J2000 (ICRS).
    pmra_rad_yr, pmdec_rad_yr : (n,) array_like
        Proper motions; in RA with the factor cos Dec.
    parallax_rad, rv_km_s : (n,) array_like
        Parallax and radial velocity (positive: receding); nan counts as 0.
    epoch_jyear : (n,) array_like
        Julian epoch of the catalogue positions.
    et_s : float or (n,) array_like
        Time of observation, TDB seconds past J2000.
    observer_position_km : (3,) or (n, 3) array_like, optional
        Observer with respect to the solar-system barycenter, J2000. None: the barycenter itself.

    Returns
    -------
    (n, 3) ndarray
        Unit vectors, J2000, without stellar aberration; (3,) where every input is a scalar.

    References
    ----------
    The equations of this module's head.

    Examples
    --------
    Proxima Centauri from 40 au abeam has moved by 40 times its parallax of 0.768 arcsec.

    >>> arcsec = np.pi / 180 / 3600
    >>> seen = propagate(0.0, 0.0, 0.0, 0.0, 0.768 * arcsec, 0.0, 2016.0, et_from_jyear(2016.0),
    ...                  [0.0, 40 * AU_KM, 0.0])
    >>> print(f"{np.arctan2(seen[1], seen[0]) / arcsec:.3f}")
    -30.720
    """
    star = (ra_rad, dec_rad, pmra_rad_yr, pmdec_rad_yr, parallax_rad, rv_km_s)
    return unit(_sight_line(star, epoch_jyear, et_s, observer_position_km).position)


def propagate_covariance(
    covariance: ArrayLike,
    epoch_jyear: ArrayLike,
    et_s: ArrayLike,
    ra_rad: ArrayLike,
    dec_rad: ArrayLike,
    observer_position_km: ArrayLike | None = None,
    *,
    pmra_rad_yr: ArrayLike = 0.0,
    pmdec_rad_yr: ArrayLike = 0.0,
    parallax_rad: ArrayLike = 0.0,
    rv_km_s: ArrayLike = 0.0,
) -> FloatArray:
    """Return the covariance of the directions of `propagate` along east and north where each star is seen.

    Parameters
    ----------
    covariance : (n, 5, 5) array_like
        Of (RA cos Dec, Dec, parallax, pmRA cos Dec, pmDec) at the catalogue epoch, rad and rad/yr.
    epoch_jyear, et_s, ra_rad, dec_rad, observer_position_km
        As in `propagate`; RA and Dec are the catalogue's.
    pmra_rad_yr, pmdec_rad_yr, parallax_rad, rv_km_s : (n,) array_like, optional
        As in `propagate`. They move the point where the Jacobian is taken; left out, it is taken at the
        catalogue direction, which is as good where a star moves far less than it is away from a pole.

    Returns
    -------
    (n, 2, 2) ndarray
        rad^2, east then north at the propagated direction. The error of the radial velocity is left out.

    References
    ----------
    ESA (1997), vol. 1, section 1.5.5. As there, the tangent axes go along with an error in position without
    turning, so that nothing diverges at the poles.

    Examples
    --------
    20 mas/yr of unknown motion over ten years.

    >>> covariance = np.diag([0.0, 0.0, 0.0, 20.0, 20.0]) ** 2
    >>> propagate_covariance(covariance, 2000.0, et_from_jyear(2010.0), 1.0, 0.5).round(6)
    array([[40000.,     0.],
           [    0., 40000.]])
    """
    star = (ra_rad, dec_rad, pmra_rad_yr, pmdec_rad_yr, parallax_rad, rv_km_s)
    sight = _sight_line(star, epoch_jyear, et_s, observer_position_km)
    # East and north stand across the line of sight, so they also project out the change of length.
    across = np.stack(tangent_basis(*radec_from_unit(sight.position)), axis=-2)
    length = np.linalg.norm(sight.position, axis=-1)[..., None, None]
    jacobian = across @ sight.partials / length
    return symmetric(jacobian @ np.asarray(covariance, float) @ np.swapaxes(jacobian, -1, -2))


class _SightLine(NamedTuple):
    position: FloatArray  # (..., 3) b, in units of the distance at the catalogue epoch
    partials: FloatArray  # (..., 3, 5) of b with respect to RA cos Dec, Dec, parallax, pmRA cos Dec, pmDec


def _sight_line(
    star: tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike],
    epoch_jyear: ArrayLike,
    et_s: ArrayLike,
    observer_position_km: ArrayLike | None,
) -> _SightLine:
    """Return b and its partials; `star` holds RA, Dec, both proper motions, parallax, radial velocity."""
    ra, dec, pmra, pmdec, parallax, rv = (np.asarray(values, float)[..., None] for values in star)
    parallax, rv = (np.where(np.isnan(values), 0.0, values) for values in (parallax, rv))
    start, (east, north) = unit_from_radec(ra[..., 0], dec[..., 0]), tangent_basis(ra[..., 0], dec[..., 0])
    observer = np.zeros(3) if observer_position_km is None else np.asarray(observer_position_km, float)
    roemer_s = np.sum(start * observer, axis=-1) / SPEED_OF_LIGHT_KM_S
    t = (jyear_from_et(np.asarray(et_s, float) + roemer_s) - np.asarray(epoch_jyear, float))[..., None]
    rv_au_yr = rv / KM_S_PER_AU_YEAR
    growth = 1.0 + rv_au_yr * parallax * t
    position = growth * start + (pmra * east + pmdec * north) * t - parallax * observer / AU_KM
    # Where the catalogue position errs by (a, d), r0 moves by p a + q d, and p and q lean by -r0 a and -r0 d.
    # The change of the Roemer delay, under 1e-6 of a position error, is left out.
    partials = np.broadcast_arrays(
        growth * east - pmra * t * start,
        growth * north - pmdec * t * start,
        rv_au_yr * t * start - observer / AU_KM,
        t * east,
        t * north,
    )
    return _SightLine(position, np.stack(partials, axis=-1))
