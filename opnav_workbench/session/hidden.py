"""Which stars stand behind a body of the scene."""

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.scene import predict_body
from opnav_workbench.session.body_pictures import best_center
from opnav_workbench.session.context import Context
from opnav_workbench.session.observing import attitude
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["hidden_by"]


def hidden_by(
    context: Context, inputs: Inputs, state: SessionState, places_px: FloatArray
) -> tuple[str, ...]:
    """Return for each place (n, 2), px, the name of the body before it; empty where there is none.

    Bodies stand where they were found, else where they are predicted; before the pointing is solved nobody knows.
    """
    names = [""] * len(places_px)
    if state.pointing is None:
        return tuple(names)
    for name in state.targets:
        body = predict_body(inputs.targets[name], inputs.observer, context.camera, attitude(inputs, state))
        if len(body.limb_px) == 0 or not np.isfinite(body.limb_px).all():
            continue
        found = best_center(state, name)
        moved = np.zeros(2)
        if found is not None and found.pixel_line is not None:
            moved = found.pixel_line - body.pixel_line
        for row in np.flatnonzero(_inside(places_px, body.limb_px + moved)):
            names[row] = name
    return tuple(names)


def _inside(points: FloatArray, outline: FloatArray) -> BoolArray:
    """Tell which points (n, 2) lie within a convex outline (k, 2)."""
    edge = np.roll(outline, -1, axis=0) - outline
    offset = points[:, None] - outline
    side = edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0]
    with np.errstate(invalid="ignore"):
        return np.asarray((side > 0.0).all(axis=1) | (side < 0.0).all(axis=1))
