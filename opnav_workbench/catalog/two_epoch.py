"""Proper motion from the positions of a star at two epochs."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import tangent_basis, unit_from_radec

__all__ = ["sky_offset_rad", "two_epoch_motion_rad_yr"]


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
