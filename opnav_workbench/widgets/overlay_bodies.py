"""Bodies over the picture: limb where predicted and where observed, terminator, pole, name."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.geometry import apparent_direction, terminator_points
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.session import ImageSession

__all__ = ["BodyMarks", "body_marks"]

POLE_BEYOND = 1.25  # the pole's line runs from the center to this many polar radii
MIN_DRAWN_PX = 3.0  # a smaller limb is a dot; its cross tells more


@dataclass(frozen=True, slots=True)
class BodyMarks:
    """Marks of one target; lines are (n, 2) arrays of (pixel, line), empty where there is nothing to draw.

    Attributes
    ----------
    name : str
    center_px : (2,) array
        Observed center where there is one, else predicted.
    radius_px : float
        Half the predicted diameter; 0 for a star.
    observed : bool
    predicted_limb_px, limb_px, terminator_px, pole_px : (n, 2) arrays
        The last three about `center_px`.
    """

    name: str
    center_px: FloatArray
    radius_px: float
    observed: bool
    predicted_limb_px: FloatArray
    limb_px: FloatArray
    terminator_px: FloatArray
    pole_px: FloatArray

    def as_page_values(self) -> dict[str, Any]:
        """Return what the readout needs."""
        return {
            "name": self.name,
            "pixel": float(self.center_px[0]),
            "line": float(self.center_px[1]),
            "radius_px": self.radius_px,
        }


def body_marks(session: ImageSession) -> list[BodyMarks]:
    """Return the marks of every target in sight of the camera, the largest first."""
    measured = {b.name: b.pixel_line for b in session.state.bodies if b.pixel_line is not None}
    marks = []
    for name, target in session.inputs.targets.items():
        seen = predict_body(
            target, session.inputs.observer, session.context.camera, session.camera_from_j2000
        )
        if np.isfinite(seen.pixel_line).all():
            marks.append(_marks(session, target, seen, measured.get(name)))
    return sorted(marks, key=lambda mark: -mark.radius_px)


def _marks(
    session: ImageSession, target: TargetState, seen: BodyPrediction, observed: FloatArray | None
) -> BodyMarks:
    moved = np.zeros(2) if observed is None else observed - seen.pixel_line
    radius = 0.5 * seen.diameter_px if np.isfinite(seen.diameter_px) else 0.0
    drawn = seen.limb_px if 2.0 * radius >= MIN_DRAWN_PX else np.empty((0, 2))
    closed = np.vstack([drawn, drawn[:1]])
    lines = [closed, *(_lines(session, target) if len(drawn) else (np.empty((0, 2)), np.empty((0, 2))))]
    return BodyMarks(
        target.name,
        seen.pixel_line + moved,
        float(radius),
        observed is not None,
        closed,
        *(line + moved for line in (lines if observed is not None else [np.empty((0, 2)), *lines[1:]])),
    )


def _lines(session: ImageSession, target: TargetState) -> tuple[FloatArray, FloatArray]:
    """Terminator and pole, px, about the predicted center."""
    assert target.radii_km is not None
    j2000_from_body = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000.T
    terminator = np.empty((0, 3))
    if target.sun_position_km is not None:
        terminator = terminator_points(
            target.position_km, target.radii_km, j2000_from_body, target.sun_position_km
        )
    pole = np.empty((0, 3))
    if target.body_from_j2000 is not None:
        along = POLE_BEYOND * target.radii_km[2] * j2000_from_body[:, 2]
        pole = np.stack([target.position_km, target.position_km + along])
        pole /= np.linalg.norm(pole, axis=1, keepdims=True)
    return _projected(session, terminator), _projected(session, pole)


def _projected(session: ImageSession, directions: FloatArray) -> FloatArray:
    if len(directions) == 0:
        return np.empty((0, 2))
    apparent = apparent_direction(directions, session.inputs.observer.velocity_km_s)
    return session.context.camera.project(apparent @ session.camera_from_j2000.T)
