"""How well a planned picture's stars will determine the camera's attitude.

The covariance is the one that `opnav_workbench.stars.pointing.solve_pointing` itself would state for stars that
stand exactly where they are predicted: the inverse of the information that their centers, with catalog errors, hold
on three angles, the a priori twist entering where the stars alone determine it less well.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import radec_from_unit, tangent_basis
from opnav_workbench.planning.stars import StarPlan
from opnav_workbench.stars.pointing import solve_pointing
from opnav_workbench.stars.pointing.attitude_fit import LinearizedProblem
from opnav_workbench.stars.pointing.residuals import BELIEVED, chi2_probability, excess_sigma

__all__ = ["PointingPlan", "plan_pointing"]

GUARD_DRAWS, GUARD_SEED = 250, 0  # its share of a sigma is then known to some 3 %


@dataclass(frozen=True, slots=True, eq=False)
class PointingPlan:
    """Expected attitude error.

    Attributes
    ----------
    covariance_rad2 : (3, 3) array
        Rotation vector about the camera frame's axes.
    sigma_px : (2,) array
        Of the boresight's place on the detector along pixel and line.
    sigma_arcsec : (2,) array
        Of its RA (times cos Dec) and Dec.
    twist_solved
        The stars alone determine the twist better than it is known beforehand.
    """

    covariance_rad2: FloatArray
    sigma_px: FloatArray
    sigma_arcsec: FloatArray
    twist_sigma_deg: float
    twist_solved: bool
    n_stars: int

    def __post_init__(self) -> None:
        freeze_arrays(self)


def plan_pointing(
    stars: StarPlan,
    camera: Camera,
    attitude: FloatArray,
    use: BoolArray | None = None,
    *,
    guarded: bool = True,
) -> PointingPlan | None:
    """Return the expected attitude error; None where no star determines it.

    Parameters
    ----------
    attitude : (3, 3) array
        camera_from_j2000.
    use : (n,) array of bool, optional
        Stars that count; by default the usable ones.
    guarded
        Add what guarding against wrong covariances costs; False: the bound alone, many times faster.
    """
    rows = stars.usable if use is None else use
    if not rows.any():
        return None
    sky = stars.directions[rows]
    center = stars.covariance_px2[rows] + stars.catalog_covariance_px2[rows]
    try:
        solution = solve_pointing(stars.pixel_line[rows], center, sky, camera, attitude)
    except PointingError:
        return None
    covariance = solution.formal_covariance_rad2
    if guarded and len(sky) > 1:
        covariance = covariance + _guard_covariance(center, sky, camera, attitude, solution.twist_solved)
    about = np.sqrt(np.diag(camera.focal_from_camera @ covariance @ camera.focal_from_camera.T))
    return PointingPlan(
        covariance_rad2=covariance,
        # A turn about the pixel axis moves the sky along lines, one about the line axis along pixels.
        sigma_px=about[1::-1] / camera.pixel_scale_rad,
        sigma_arcsec=_on_sky(camera, attitude, covariance) * ARCSEC_PER_RAD,
        twist_sigma_deg=float(np.degrees(about[2])),
        twist_solved=solution.twist_solved,
        n_stars=int(rows.sum()),
    )


def _guard_covariance(
    covariance_px2: FloatArray, sky: FloatArray, camera: Camera, attitude: FloatArray, twist_solved: bool
) -> FloatArray:
    """Return E[d d'] (3, 3), d between solutions with the excess that chance puts into the weights and without."""
    rng = np.random.default_rng(GUARD_SEED)
    jacobian, factor = camera.attitude_jacobian(sky @ attitude.T), np.linalg.cholesky(covariance_px2)
    twist = camera.boresight[None] / camera.a_priori_sigma_rad[2]
    known = twist[:0] if twist_solved else twist
    total = np.zeros((3, 3))
    for draw in rng.normal(size=(GUARD_DRAWS, len(sky), 2)):
        error = np.einsum("nij,nj->ni", factor, draw)
        linear = LinearizedProblem(error, jacobian, covariance_px2, known, np.zeros(len(known)))
        excess = excess_sigma(linear)
        if excess > 0.0 and chi2_probability(linear) < BELIEVED:
            off = _solve(linear, excess) - _solve(linear, 0.0)
            total += np.outer(off, off)
    return total / GUARD_DRAWS


def _solve(linear: LinearizedProblem, excess_px: float) -> FloatArray:
    matrix, residual = linear.rows(excess_px)
    scale = np.linalg.norm(matrix, axis=0)
    return np.asarray(np.linalg.lstsq(matrix / scale, residual, rcond=None)[0] / scale)


def _on_sky(camera: Camera, attitude: FloatArray, covariance_rad2: FloatArray) -> FloatArray:
    """Return the boresight's 1-sigma errors (2,) toward east and north, rad."""
    boresight = camera.boresight
    tangent = np.stack(tangent_basis(*radec_from_unit(attitude.T @ boresight)))
    # eps turns the camera, so that its boresight goes to (I - [eps]) b seen from the sky: b x eps.
    x, y, z = boresight
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    jacobian = tangent @ attitude.T @ cross
    return np.asarray(np.sqrt(np.diag(jacobian @ covariance_rad2 @ jacobian.T)))
