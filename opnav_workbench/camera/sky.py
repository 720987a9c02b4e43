"""From a place on the detector to the sky around it."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.model import Camera
from opnav_workbench.geometry import radec_from_unit, tangent_basis

__all__ = ["sky_jacobian"]


def sky_jacobian(camera: Camera, camera_from_j2000: ArrayLike, pixel_line: ArrayLike) -> FloatArray:
    """Return d(RA cos Dec, Dec)/d(pixel, line) at a place (2,), a (2, 2) array in rad/px.

    Examples
    --------
    >>> from opnav_workbench.camera import Camera
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    >>> slope = sky_jacobian(camera, np.eye(3), [511.5, 511.5])
    >>> print(round(float(np.sqrt(abs(np.linalg.det(slope)))) * 1e6, 2))
    4.96
    """
    rotation, place = np.asarray(camera_from_j2000, float), np.asarray(pixel_line, float)
    direction = rotation.T @ camera.unproject(place)
    east_north = np.stack(tangent_basis(*radec_from_unit(direction)))
    return np.asarray(east_north @ rotation.T @ camera.unproject_jacobian(place))
