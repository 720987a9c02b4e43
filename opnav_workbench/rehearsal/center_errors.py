"""Errors of measured centers on the sky, as the paper's Table 3 has them."""

from collections.abc import Mapping

import numpy as np
from astropy import units as u
from astropy.table import QTable
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.camera import Camera
from opnav_workbench.camera.sky import sky_jacobian
from opnav_workbench.geometry import ARCSEC_PER_RAD

__all__ = ["center_errors", "sky_per_pixel"]


def sky_per_pixel(camera: Camera, camera_from_j2000: ArrayLike, pixel_line: ArrayLike) -> FloatArray:
    """Return d(RA cos Dec, Dec)/d(pixel, line) at a place (2,), a (2, 2) array in arcsec/px.

    Examples
    --------
    >>> from opnav_workbench.mission import load_mission
    >>> camera = load_mission("new_horizons").camera_named("lorri_1x1")
    >>> slope = sky_per_pixel(camera, np.eye(3), [511.5, 511.5])
    >>> print(round(float(np.sqrt(abs(np.linalg.det(slope)))), 3))
    1.024
    """
    return sky_jacobian(camera, camera_from_j2000, pixel_line) * ARCSEC_PER_RAD


def center_errors(
    centers: Mapping[str, BodyCenter], true_px: ArrayLike, camera: Camera, camera_from_j2000: ArrayLike
) -> QTable:
    """Return a row per center: its error against a true place, and the sigma that it states of itself.

    Parameters
    ----------
    centers : mapping of str to BodyCenter
        By the name of the row.
    true_px : (2,) array_like
        True (pixel, line), or another reference.
    camera : Camera
    camera_from_j2000 : (3, 3) array_like
        Its error is left out: it is the same for all centers of a picture.

    Returns
    -------
    astropy.table.QTable
        method, and of ``RA cos Dec`` and ``Dec`` each ``error`` and ``sigma`` (arcsec) and ``error / sigma``; status.
        nan where there is no center.
    """
    slope, reference = sky_per_pixel(camera, camera_from_j2000, true_px), np.asarray(true_px, float)
    nothing = np.full(2, np.nan)
    places = [nothing if c.pixel_line is None else c.pixel_line for c in centers.values()]
    error = (np.array(places) - reference) @ slope.T
    covariances = np.array([slope @ c.covariance_px2 @ slope.T for c in centers.values()])
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    table = QTable({"method": list(centers)})
    for axis, name in enumerate(("RA cos Dec", "Dec")):
        table[f"{name} error"] = error[:, axis] * u.arcsec
        table[f"{name} sigma"] = sigma[:, axis] * u.arcsec
        table[f"{name} error / sigma"] = error[:, axis] / sigma[:, axis]
    for column in table.colnames[1:]:
        table[column].info.format = ".1f" if "/" in column else ".3f"
    table["status"] = [c.status for c in centers.values()]
    return table
