"""A position from directions in closed form: linear optimal sine triangulation (LOST), the start of the iteration.

    sum_i w_i (1 - u_i u_i') (s_i - x) = 0,   w_i = 1 / (sigma_i distance_i)^2

The distance, on which the weight depends, comes from the law of sines in the triangle of the spacecraft and two stars:
distance_i = |u_j x (s_i - s_j)| / |u_i x u_j|. With weights that are all one this is the midpoint between the lines of
sight.

Source: Henry & Christian (2023), JGCD 46, 21, doi:10.2514/1.G006989, equation 20 and section 5.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.triangulation_input import Sightings
from opnav_workbench.geometry import ARCSEC_PER_RAD

__all__ = ["dilution_matrix", "start_position"]

# Directions closer to parallel than this many of their sigmas do not cross anywhere in particular.
PARALLEL_SIGMAS = 5.0


def start_position(given: Sightings) -> FloatArray:
    """Return the position (3,), km.

    Raises
    ------
    EstimationError
        All lines of sight are parallel within their errors.
    """
    u, s = given.directions, given.targets_km
    companion, sine = _companions(given)
    distance = np.linalg.norm(np.cross(u[companion], s - s[companion]), axis=1) / sine
    weight = given.sigma_rad * np.maximum(distance, np.finfo(float).tiny)
    normal = dilution_matrix(u, weight)
    center = s.mean(axis=0)  # far from the barycenter the differences keep their digits
    projected = _across(u) @ (s - center)[:, :, None]
    right = np.sum(projected[:, :, 0] / weight[:, None] ** 2, axis=0)
    return np.asarray(center + np.linalg.solve(normal, right))


def dilution_matrix(directions: FloatArray, distance_km: FloatArray) -> FloatArray:
    """Return the information (..., 3, 3) on a position in directions (..., n, 3) that are known to 1 rad."""
    return np.asarray(np.sum(_across(directions) / np.asarray(distance_km)[..., None, None] ** 2, axis=-3))


def _across(directions: FloatArray) -> FloatArray:
    """Return the projections (..., 3, 3) onto the planes across directions (..., 3)."""
    return np.asarray(np.eye(3) - directions[..., :, None] * directions[..., None, :])


def _companions(given: Sightings) -> tuple[IntArray, FloatArray]:
    """Return for each direction the one that makes the largest angle with it, and the sine of that angle."""
    u = given.directions
    sines = np.linalg.norm(np.cross(u[:, None], u[None]), axis=2)
    widest = float(sines.max())
    least = PARALLEL_SIGMAS * float(given.sigma_rad.max())
    if not widest > least:
        raise EstimationError(
            f"the directions are parallel within {widest * ARCSEC_PER_RAD:.3g} arcsec, that is "
            f"{widest / least * PARALLEL_SIGMAS:.1f} sigmas; lines of sight must cross: take stars far apart on the sky, "
            "and not opposite."
        )
    companion = np.argmax(sines, axis=1)
    return companion, sines[np.arange(len(u)), companion]
