"""Camera models: what a frame camera does to a direction, and what is known about the camera beforehand."""

from opnav_workbench.camera.distortion import (
    BrownDistortion,
    Distortion,
    NoDistortion,
    OwenDistortion,
    undistort,
)
from opnav_workbench.camera.model import Camera
from opnav_workbench.camera.polynomial import ForwardSipDistortion, LegendreDistortion, SipDistortion
from opnav_workbench.camera.priors import AttitudeSigma, ExposureLimits, PsfPrior
from opnav_workbench.camera.response import UNKNOWN_COLOR, CameraResponse

__all__ = [
    "UNKNOWN_COLOR",
    "AttitudeSigma",
    "BrownDistortion",
    "Camera",
    "CameraResponse",
    "Distortion",
    "ExposureLimits",
    "ForwardSipDistortion",
    "LegendreDistortion",
    "NoDistortion",
    "OwenDistortion",
    "PsfPrior",
    "SipDistortion",
    "undistort",
]
