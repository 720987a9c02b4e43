"""Truth beside solution, in sigmas."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.pointing import attitude_shift
from opnav_workbench.simulation import Truth

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """One solved quantity against its truth.

    Attributes
    ----------
    name, unit : str
    solved, truth, sigma : float
        nan where nothing was solved.
    error : float
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
    rows = _attitude(truth, result["pointing"], camera) if result.get("pointing") else []
    seen = [b for b in result.get("bodies", ()) if b["name"] in truth.bodies and b["observed"] is not None]
    times = Counter(body["name"] for body in seen)
    for body in seen:
        name = body["name"] if times[body["name"]] == 1 else f"{body['name']} ({body['method']})"
        rows += _center(body, name, truth.bodies[body["name"]])
    return tuple(rows)


def _attitude(truth: Truth, pointing: Mapping[str, Any], camera: Camera) -> list[Comparison]:
    solved = matrix_from_quaternion(np.asarray(pointing["quaternion_camera_from_j2000"], dtype=np.float64))
    focal, scale = camera.focal_from_camera, camera.pixel_scale_rad
    about_pixel, about_line, twist = np.sqrt(
        np.diag(focal @ np.asarray(pointing["covariance_rad2"]) @ focal.T)
    )
    # A turn about the pixel axis moves the sky along lines, one about the line axis along pixels.
    sigmas = (about_line / scale, about_pixel / scale, np.degrees(twist))
    moved = _shift(truth.predicted_camera_from_j2000, solved, camera)
    true = _shift(truth.predicted_camera_from_j2000, truth.camera_from_j2000, camera)
    rows = zip(("Δpixel", "Δline", "Δtwist"), ("px", "px", "deg"), moved, true, sigmas, strict=True)
    return [
        Comparison(name, unit, float(s), float(t), float(e), float(s - t)) for name, unit, s, t, e in rows
    ]


def _shift(first: FloatArray, second: FloatArray, camera: Camera) -> tuple[float, float, float]:
    shift = attitude_shift(camera, first, second)
    return shift.delta_pixel, shift.delta_line, float(np.degrees(shift.delta_twist_rad))


def _center(body: Mapping[str, Any], name: str, true_center: Any) -> list[Comparison]:
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
