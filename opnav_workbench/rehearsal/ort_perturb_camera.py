"""The true camera of a rehearsal: a focal length and a distortion that the calibration does not have."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.camera.distortion import DirectDistortion, Distortion

__all__ = ["AddedRadial", "faulty"]


@dataclass(frozen=True, slots=True)
class AddedRadial(DirectDistortion):
    """A distortion with a further cubic radial term: the distorted point moves on by ``k r^2 (x, y)`` of the ideal one.

    Attributes
    ----------
    base : Distortion
    k_per_mm2 : float
    """

    base: Distortion
    k_per_mm2: float

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        r2 = np.sum(xy * xy, axis=-1, keepdims=True)
        return np.asarray(self.base.distort(xy) + self.k_per_mm2 * r2 * xy)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        r2 = np.sum(xy * xy, axis=-1)[..., None, None]
        outer = xy[..., :, None] * xy[..., None, :]
        return np.asarray(self.base.jacobian(xy) + self.k_per_mm2 * (r2 * np.eye(2) + 2.0 * outer))


def faulty(camera: Camera, focal_length: float, corner_px: float) -> Camera:
    """Return the camera as it truly is.

    Parameters
    ----------
    camera : Camera
        As calibrated.
    focal_length : float
        True focal length over the calibrated one, minus 1.
    corner_px : float
        How far the further distortion moves a point at the detector's corner outward.
    """
    if focal_length == 0.0 and corner_px == 0.0:
        return camera
    half_px = 0.5 * np.array([camera.n_pixel, camera.n_line])
    corner_mm = np.linalg.solve(camera.pixel_from_mm, half_px)
    radius_mm, radius_px = float(np.linalg.norm(corner_mm)), float(np.linalg.norm(half_px))
    k = corner_px / radius_px / radius_mm**2
    longer = camera.focal_length_mm * (1.0 + focal_length)
    distortion = camera.distortion if k == 0.0 else AddedRadial(camera.distortion, k)
    return replace(camera, focal_length_mm=longer, distortion=distortion)
