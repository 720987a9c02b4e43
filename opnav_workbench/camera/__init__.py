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

__all__ = [
    "AttitudeSigma",
    "BrownDistortion",
    "Camera",
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
