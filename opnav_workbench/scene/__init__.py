"""What the camera should see: predicted stars and bodies, the observer they are seen from, and a rendered picture."""

from opnav_workbench.scene.body_geometry import BodyGeometry
from opnav_workbench.scene.geometry_report import CameraPointing, GeometryReport, geometry_report
from opnav_workbench.scene.observer import Observer, observer_from_header, observer_from_kernels
from opnav_workbench.scene.prediction import (
    BodyPrediction,
    StarPrediction,
    apparent_stars,
    camera_magnitudes,
    predict_body,
    predict_stars,
)
from opnav_workbench.scene.targets import body_target, star_target_at

__all__ = [
    "BodyGeometry",
    "BodyPrediction",
    "CameraPointing",
    "GeometryReport",
    "Observer",
    "StarPrediction",
    "apparent_stars",
    "body_target",
    "camera_magnitudes",
    "geometry_report",
    "observer_from_header",
    "observer_from_kernels",
    "predict_body",
    "predict_stars",
    "star_target_at",
]
