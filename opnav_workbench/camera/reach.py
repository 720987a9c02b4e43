"""How far from the boresight a distortion model holds.

A distortion polynomial folds back far from the detector; directions out there must not appear on it.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import Distortion

__all__ = ["reach_mm"]

MIN_STRETCH = 0.1  # d(distorted)/d(ideal) below this is no camera's any more, and soon folds
RAYS = 16
RADII = 200
MIN_TANGENT, MAX_TANGENT = 1e-3, 20.0  # of the angle from the boresight: up to 87 deg, in steps of 5 %


def reach_mm(distortion: Distortion, focal_length_mm: float) -> float:
    """Return the ideal radius, mm, up to which `distortion` maps one to one along every ray.

    Infinite where it does so up to 87 deg from the boresight.
    """
    radii = focal_length_mm * np.geomspace(MIN_TANGENT, MAX_TANGENT, RADII)
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    points = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    with np.errstate(all="ignore"):
        folded = ~(_least_stretch(distortion.jacobian(points)) > MIN_STRETCH).all(axis=1)
    return float(radii[max(int(folded.argmax()) - 1, 0)]) if folded.any() else np.inf


def _least_stretch(jacobian: FloatArray) -> FloatArray:
    """Smaller eigenvalue of the symmetric part of matrices (..., 2, 2)."""
    half_trace = 0.5 * (jacobian[..., 0, 0] + jacobian[..., 1, 1])
    half_difference = 0.5 * (jacobian[..., 0, 0] - jacobian[..., 1, 1])
    shear = 0.5 * (jacobian[..., 0, 1] + jacobian[..., 1, 0])
    return np.asarray(half_trace - np.hypot(half_difference, shear))
