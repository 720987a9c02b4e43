"""What the camera should see: predicted stars and bodies, the observer they are seen from, and a rendered picture."""

from opnav_workbench.scene.observer import Observer, observer_from_header, observer_from_kernels
from opnav_workbench.scene.prediction import (
    BodyPrediction,
    StarPrediction,
    apparent_stars,
    predict_body,
    predict_stars,
)
from opnav_workbench.scene.targets import body_target, star_target_at

__all__ = [
    "BodyPrediction",
    "Observer",
    "StarPrediction",
    "apparent_stars",
    "body_target",
    "observer_from_header",
    "observer_from_kernels",
    "predict_body",
    "predict_stars",
    "star_target_at",
]
