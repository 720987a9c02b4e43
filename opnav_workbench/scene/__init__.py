"""What the camera should see: the observer, the targets, and the predicted places of stars and bodies.

Enter by `observer_from_kernels` (or `observer_from_header`), `body_target`, `predict_stars` and `predict_body`; by
`geometry_report` for all geometry of an epoch.

``states``
    The spacecraft as observer; bodies and stars as targets.
``prediction``
    Places of stars and bodies on the detector.
``assisted``
    Bodies that an analyst describes in the picture, where no ephemeris knows them.
``following``
    Bodies that move while the lines of a picture are exposed.
``body_geometry``
    One body at an epoch: where it is, how it is lit, how the camera sees it.
``epoch_report``
    Times, states, attitude and bodies of an epoch, as table, values and text.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand
from opnav_workbench.scene.following import (
    following,
    seen_at_its_lines,
    sweep_of,
    turned_meanwhile,
    with_aberration,
    with_course,
)

if TYPE_CHECKING:
    from opnav_workbench.scene.assisted import (
        AssistedBody,
        apparent_radius_px,
        assisted_target,
        phase_at_terminator,
        picture_axes,
    )
    from opnav_workbench.scene.body_geometry import BodyGeometry
    from opnav_workbench.scene.epoch_report import CameraPointing, GeometryReport, geometry_report
    from opnav_workbench.scene.prediction import (
        BodyPrediction,
        StarPrediction,
        apparent_stars,
        camera_magnitudes,
        predict_body,
        predict_stars,
    )
    from opnav_workbench.scene.states import (
        Observer,
        body_target,
        observer_from_header,
        observer_from_kernels,
        star_target_at,
    )
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "AssistedBody": "assisted",
            "apparent_radius_px": "assisted",
            "assisted_target": "assisted",
            "phase_at_terminator": "assisted",
            "picture_axes": "assisted",
            "BodyGeometry": "body_geometry",
            "CameraPointing": "epoch_report",
            "GeometryReport": "epoch_report",
            "geometry_report": "epoch_report",
            "BodyPrediction": "prediction",
            "StarPrediction": "prediction",
            "apparent_stars": "prediction",
            "camera_magnitudes": "prediction",
            "predict_body": "prediction",
            "predict_stars": "prediction",
            "Observer": "states",
            "body_target": "states",
            "observer_from_header": "states",
            "observer_from_kernels": "states",
            "star_target_at": "states",
        },
    )

__all__ = [
    "AssistedBody",
    "BodyGeometry",
    "BodyPrediction",
    "CameraPointing",
    "GeometryReport",
    "Observer",
    "StarPrediction",
    "apparent_radius_px",
    "apparent_stars",
    "assisted_target",
    "body_target",
    "camera_magnitudes",
    "following",
    "geometry_report",
    "observer_from_header",
    "observer_from_kernels",
    "phase_at_terminator",
    "picture_axes",
    "predict_body",
    "predict_stars",
    "seen_at_its_lines",
    "star_target_at",
    "sweep_of",
    "turned_meanwhile",
    "with_aberration",
    "with_course",
]
