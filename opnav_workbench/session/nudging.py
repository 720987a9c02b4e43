"""Session step: the analyst moves the predicted field by hand, pixel by pixel, until it lies on the stars."""

from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import angle_between, rotation_from_vector, unit
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import BY_HAND, field_at, stars_around
from opnav_workbench.session.marking import all_stars
from opnav_workbench.session.state import Inputs, SessionState
from opnav_workbench.session.verdicts import unsearched, with_verdicts

__all__ = ["field_attitude", "nudge", "nudged_attitude", "outcome", "reach_px"]


def nudge(context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]) -> SessionState:
    """Move the field from where it is known best; what was found with the older pointing is dropped."""
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    shift = np.array([parameters["delta_pixel"], parameters["delta_line"]])
    twist = float(np.radians(parameters["delta_twist_deg"]))
    attitude = nudged_attitude(context.camera, field_attitude(inputs, state), shift, twist)
    found = field_at(context, inputs, attitude, BY_HAND, 0.0, sure=False)
    stars = stars_around(context, inputs, all_stars(inputs), attitude)
    expected = context.camera.on_detector(stars.places(context.camera, attitude))
    fresh = state.replace(
        a_priori=stars,
        centers=None,
        pointing=None,
        psf=None,
        star_field=found,
        found_status=unsearched(expected),
        star_methods=MappingProxyType({}),
    )
    return fresh.replace(status=with_verdicts(fresh, fresh.found_status)).noting("stars").noting("pointing")


def field_attitude(inputs: Inputs, state: SessionState) -> FloatArray:
    """Return where the field is known best: solved, else identified or moved by hand, else a priori."""
    if state.pointing is not None:
        return state.pointing.camera_from_j2000
    if state.star_field is not None:
        return state.star_field.camera_from_j2000
    return inputs.a_priori_camera_from_j2000


def nudged_attitude(
    camera: Camera, camera_from_j2000: FloatArray, shift_px: FloatArray, twist_rad: float
) -> FloatArray:
    """Return the attitude with which the field lies `shift_px` (pixel, line) farther and is turned.

    The twist turns the picture about its boresight, from +pixel toward +line.

    Raises
    ------
    SessionError
        The shift is larger than the detector.
    """
    rays = camera.unproject(camera.center_pixel_line + np.array([np.zeros(2), shift_px]))
    if np.abs(shift_px).max() > max(camera.n_pixel, camera.n_line) or not np.isfinite(rays).all():
        raise SessionError(
            f"a nudge by ({shift_px[0]:+.1f}, {shift_px[1]:+.1f}) px is more than {camera.name}'s field; move it in "
            "smaller steps, or mark two stars (two_star_pointing)."
        )
    across, turned = np.cross(*rays), np.cross(*camera.focal_from_camera[:2])
    angle = float(angle_between(*rays))
    move = rotation_from_vector(unit(across) * angle) if angle > 0.0 else np.eye(3)
    return np.asarray(move @ rotation_from_vector(turned * twist_rad) @ camera_from_j2000)


def reach_px(context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]) -> float:
    """Return how far from its a priori place a nudge would bring the field, at least."""
    shift = np.array([parameters["delta_pixel"], parameters["delta_line"]])
    here = field_at(context, inputs, field_attitude(inputs, state), BY_HAND, 0.0, sure=False)
    return float(np.hypot(*(here.shift_px + shift)))


def outcome(state: SessionState) -> str:
    """One line of what came out, for the journal."""
    found = state.star_field
    assert found is not None
    return f"field moved by hand: ({found.shift_px[0]:+.1f}, {found.shift_px[1]:+.1f}) px from its a priori place"
