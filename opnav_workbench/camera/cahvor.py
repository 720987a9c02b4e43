"""Cameras from the vectors of the CAHV, CAHVOR and CAHVORE models of rovers' cameras.

With P a direction, A the axis and H, V the image vectors, pixel = P.H / P.A and line = P.V / P.A; O and R bend the direction
first (`opnav_workbench.camera.lens_models.CahvorDistortion`). The place C and the pupil's way E only shift what is near.

Source: Yakimovsky & Cunningham (1978), doi 10.1016/0146-664X(78)90112-0; Gennery (2006), doi 10.1007/s11263-006-5168-1.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import NoDistortion
from opnav_workbench.camera.lens_models import CahvorDistortion
from opnav_workbench.errors import CameraError

__all__ = ["camera_fields_from_cahvor"]

UNIT_TOLERANCE = 1e-3  # of A's and O's lengths, as published with few digits


def camera_fields_from_cahvor(
    a: ArrayLike,
    h: ArrayLike,
    v: ArrayLike,
    o: ArrayLike | None,
    r: Sequence[float],
    linearity: float,
    focal_length_mm: float,
) -> dict[str, Any]:
    """Return the fields of `Camera` that the vectors give; see `Camera.from_cahvor`."""
    axis, along_h, along_v = (_vector(name, value) for name, value in (("A", a), ("H", h), ("V", v)))
    if abs(float(np.linalg.norm(axis)) - 1.0) > UNIT_TOLERANCE:
        raise CameraError(f"CAHV: A has length {np.linalg.norm(axis):.4g}; it should be a unit vector.")
    axis = axis / np.linalg.norm(axis)
    center = np.array([along_h @ axis, along_v @ axis])
    across_h, across_v = along_h - center[0] * axis, along_v - center[1] * axis
    scale = float(np.linalg.norm(across_h))
    if not scale > 0.0:
        raise CameraError("CAHV: H has no part across A.")
    pixel = across_h / scale
    shear = float(across_v @ pixel)
    rest = across_v - shear * pixel
    if not float(np.linalg.norm(rest)) > 0.0:
        raise CameraError("CAHV: V has no part across A and H.")
    line = rest / np.linalg.norm(rest)
    focal_axes = np.stack([pixel, line, axis])
    lens = NoDistortion() if o is None else _lens(focal_axes @ _vector("O", o), r, linearity, focal_length_mm)
    return {
        "center_pixel_line": center,
        "pixel_from_mm": np.array([[scale, 0.0], [shear, float(rest @ line)]]) / focal_length_mm,
        "focal_from_camera": focal_axes,
        "focal_length_mm": focal_length_mm,
        "distortion": lens,
    }


def _lens(axis: FloatArray, r: Sequence[float], linearity: float, focal_mm: float) -> CahvorDistortion:
    if len(r) != 3:
        raise CameraError(f"CAHVOR: R has {len(r)} numbers; give r0, r1 and r2.")
    return CahvorDistortion(focal_mm, axis, float(r[0]), float(r[1]), float(r[2]), linearity)


def _vector(name: str, value: ArrayLike) -> Any:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise CameraError(f"CAHV: {name} is {vector.tolist()}; give three finite numbers.")
    return vector
