"""Distortion as instrument kernels carry it, in the keywords that `Camera.from_ik` reads.

Source: nh_lorri_v201.ti (``OOC_*``, Owen and O'Connell) and orex_ocams_addendum_v10.ti (``OPENCV_OD_*``).
"""

from typing import Any

from opnav_workbench.spice.scenario_parts import Instrument, OwenTerms

__all__ = ["distortion_keywords"]


def distortion_keywords(camera: Instrument) -> dict[str, Any]:
    """Return the IK variables of a camera's distortion, without ``INS<id>_``; none where there is none."""
    model = camera.distortion
    if model is None:
        return {}
    pixels_per_mm = 1e3 / camera.pixel_size_um
    if isinstance(model, OwenTerms):
        return {
            "OOC_FOCAL_LENGTH": camera.focal_length_mm,
            "OOC_KMAT": (pixels_per_mm, 0.0, 0.0, pixels_per_mm),
            "OOC_EM": (model.e2_per_mm2, model.e5_per_mm, model.e6_per_mm),
            "OOC_CCD_CENTER": camera.center,
        }
    focal_px = pixels_per_mm * camera.focal_length_mm
    return {
        "OPENCV_OD_K": (model.k1, model.k2, model.k3, model.k4, model.k5, model.k6),
        "OPENCV_OD_P": (model.p1, model.p2),
        "OPENCV_OD_F": (focal_px, focal_px),
        "OPENCV_OD_C": tuple(c + 1.0 for c in camera.center),  # counted from 1
        "OPENCV_OD_A": 0.0,  # of the focal length, per degree Celsius
    }
