"""Normal equations of pictures: columns (p, n_line, n_pixel), weights and data (n_line, n_pixel)."""

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric

__all__ = ["inverse", "normal_matrix", "projected", "solved_for"]

RIDGE = 1e-10  # of a unit diagonal: keeps a parameter that nothing depends on from becoming infinite


def normal_matrix(columns: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the information matrix (p, p)."""
    flat = columns.reshape(len(columns), -1)
    return symmetric((flat * weight.ravel()) @ flat.T)


def projected(columns: FloatArray, weight: FloatArray, data: FloatArray) -> FloatArray:
    """Return the right-hand side (p,)."""
    return np.asarray(columns.reshape(len(columns), -1) @ (weight * data).ravel())


def solved_for(information: FloatArray, right: FloatArray) -> FloatArray:
    """Return the parameters (p,)."""
    scale, scaled = _scaled(information)
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


def inverse(information: FloatArray) -> FloatArray:
    """Return the covariance (p, p)."""
    scale, scaled = _scaled(information)
    return symmetric(scale[:, None] * np.linalg.inv(scaled) * scale)


def _scaled(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scales (p,) and the matrix scaled to a unit diagonal; a parameter that nothing depends on stays 0."""
    diagonal = np.diag(information)
    known = diagonal > 0.0
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    ridge = np.where(known, RIDGE, 1.0)
    return scale, information * scale[:, None] * scale + np.diag(ridge)
