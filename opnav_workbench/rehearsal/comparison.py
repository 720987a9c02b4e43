"""Solved quantities held against the truth, in sigmas: attitude and centers of a result, centers on the sky.

`compare` takes a ``result.json``; `center_errors` takes the centers of several methods, as the paper's Table 3 has
them.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.camera import Camera
from opnav_workbench.camera.model import sky_jacobian
from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.simulation import Truth
from opnav_workbench.stars.pointing import attitude_shift

__all__ = ["Comparison", "boresight_shift", "center_errors", "compare", "sky_per_pixel"]


# ---- Truth beside solution, in sigmas.


@dataclass(frozen=True, slots=True)
class Comparison:
    """One solved quantity against its truth.

    Attributes
    ----------
    solved, truth, sigma
        nan where nothing was solved.
    error
        Solved minus true, in `unit`.
    """

    name: str
    unit: str
    solved: float
    truth: float
    sigma: float
    error: float

    @property
    def sigmas(self) -> float:
        """Error over its own predicted sigma."""
        return self.error / self.sigma


def compare(truth: Truth, result: Mapping[str, Any], camera: Camera) -> tuple[Comparison, ...]:
    """Compare a ``result.json`` with the truth: three angles of the attitude, two coordinates a body and method.

    The attitude is compared as the shift of the boresight's sky on the detector and the change of twist, both against
    the predicted attitude.
    """
    rows = _attitude_rows(truth, result["pointing"], camera) if result.get("pointing") else []
    seen = [b for b in result.get("bodies", ()) if b["name"] in truth.bodies and b["observed"] is not None]
    times = Counter(body["name"] for body in seen)
    for body in seen:
        name = body["name"] if times[body["name"]] == 1 else f"{body['name']} ({body['method']})"
        rows += _center_rows(body, name, truth.bodies[body["name"]])
    return tuple(rows)


def _attitude_rows(truth: Truth, pointing: Mapping[str, Any], camera: Camera) -> list[Comparison]:
    solved = matrix_from_quaternion(np.asarray(pointing["quaternion_camera_from_j2000"], dtype=np.float64))
    focal, scale = camera.focal_from_camera, camera.pixel_scale_rad
    about_pixel, about_line, twist = np.sqrt(
        np.diag(focal @ np.asarray(pointing["covariance_rad2"]) @ focal.T)
    )
    # A turn about the pixel axis moves the sky along lines, one about the line axis along pixels.
    sigmas = (about_line / scale, about_pixel / scale, np.degrees(twist))
    moved = boresight_shift(truth.predicted_camera_from_j2000, solved, camera)
    true = boresight_shift(truth.predicted_camera_from_j2000, truth.camera_from_j2000, camera)
    rows = zip(("Δpixel", "Δline", "Δtwist"), ("px", "px", "deg"), moved, true, sigmas, strict=True)
    return [
        Comparison(name, unit, float(s), float(t), float(e), float(s - t)) for name, unit, s, t, e in rows
    ]


def boresight_shift(first: FloatArray, second: FloatArray, camera: Camera) -> tuple[float, float, float]:
    """Return how far one attitude's sky stands from another's on the detector: px, px, and twist in deg."""
    shift = attitude_shift(camera, first, second)
    return shift.delta_pixel, shift.delta_line, float(np.degrees(shift.delta_twist_rad))


def _center_rows(body: Mapping[str, Any], name: str, true_center: Any) -> list[Comparison]:
    covariance = np.asarray(body["covariance_px2"], dtype=np.float64)
    return [
        Comparison(
            f"{name} {axis}",
            "px",
            float(body["observed"][i]),
            float(true_center[i]),
            float(np.sqrt(covariance[i, i])),
            float(body["observed"][i] - true_center[i]),
        )
        for i, axis in enumerate(("pixel", "line"))
    ]


# ---- Errors of measured centers on the sky, as the paper's Table 3 has them.


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
    centers
        By the name of the row.
    true_px : (2,) array_like
        True (pixel, line), or another reference.
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
