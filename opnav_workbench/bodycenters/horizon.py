"""Position of an ellipsoid from directions to its limb: Christian and Robinson's horizon fit.

Flow   limb directions -> space scaled so that the body is a unit sphere -> plane through its limb -> position
Frame  any one frame for directions, orientation and position; aberration is taken out of the directions before
Units  km; directions are vectors of any length

In the scaled space the limb is a circular cone: every limb direction u has u . n = 1 for one vector n along its axis, which
is linear in n. The position is that axis, at the distance at which a unit sphere has such a cone. It needs no first guess,
and is exact for points without noise.

Sources  Christian & Robinson (2016), doi:10.2514/1.G000708; Christian (2021), doi:10.1109/ACCESS.2021.3051914.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import unit

__all__ = ["horizon_position"]

LEAST_POINTS = 3  # unknowns


def horizon_position(
    directions: ArrayLike,
    radii_km: ArrayLike,
    frame_from_body: ArrayLike,
    sigma_rad: ArrayLike = 1.0,
) -> FloatArray:
    """Return the position (3,) km of an ellipsoid's center from directions to its limb.

    Parameters
    ----------
    directions : (n, 3) array_like
        Toward points of the limb, without stellar aberration.
    radii_km : (3,) array_like
        Semi-axes along body x, y, z.
    frame_from_body : (3, 3) array_like
        ``v_frame = frame_from_body @ v_body``.
    sigma_rad : (n,) array_like
        Errors of the directions across the limb; only their ratios count.

    Raises
    ------
    CenterfindingError
        Too few points, or an arc that is too short or too noisy to close the cone of limb directions.

    Notes
    -----
    The weights are those of total least squares to first order: the error of ``u . n`` is that of the direction times the
    length of the scaled ray.

    Examples
    --------
    >>> from opnav_workbench.geometry import limb_points
    >>> limb = limb_points([100.0, -50.0, 5000.0], [300.0, 250.0, 200.0], np.eye(3), n=12)
    >>> horizon_position(limb, [300.0, 250.0, 200.0], np.eye(3)).round(6)
    array([ 100.,  -50., 5000.])
    """
    rays, turn = unit(np.asarray(directions, dtype=np.float64)), np.asarray(frame_from_body, dtype=np.float64)
    radii = np.asarray(radii_km, dtype=np.float64)
    if len(rays) < LEAST_POINTS:
        raise CenterfindingError(f"a horizon fit needs {LEAST_POINTS} limb points, got {len(rays)}.")
    scaled = rays @ (turn / radii)
    length = np.linalg.norm(scaled, axis=1)
    sphere = scaled / length[:, None]
    # Dividing by a length of order 1 / radius turns an angle into one of the scaled space.
    weight = length / length.mean() / np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), length.shape)
    axis, _, rank, _ = np.linalg.lstsq(sphere * weight[:, None], weight, rcond=None)
    excess = float(axis @ axis) - 1.0  # 1 / (distance^2 - 1), the distance in scaled radii
    if rank < LEAST_POINTS or not excess > 0.0:
        raise CenterfindingError(
            f"{len(rays)} limb points do not close a cone of limb directions (rank {rank}, |n|^2 - 1 = {excess:.3g}); "
            "a longer arc of limb is needed."
        )
    return np.asarray((turn * radii) @ axis / np.sqrt(excess))
