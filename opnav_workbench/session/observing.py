"""From centers to observables, and the attitude that both rest on.  Pure functions of context, inputs and state."""

from collections.abc import Mapping

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter, JointCenters
from opnav_workbench.observables import Observable, center_cross, observe
from opnav_workbench.scene import predict_body
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import BY_HAND
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["a_priori_covariance", "attitude", "attitude_covariance", "observed", "observed_again"]


def attitude(inputs: Inputs, state: SessionState) -> FloatArray:
    """Best known ``camera_from_j2000``: solved, else where the analyst put the field, else a priori."""
    if state.pointing is not None:
        return state.pointing.camera_from_j2000
    if state.star_field is not None and state.star_field.search in (BY_HAND, "marked"):
        return state.star_field.camera_from_j2000
    return inputs.a_priori_camera_from_j2000


def attitude_covariance(context: Context, state: SessionState) -> FloatArray:
    """Covariance (3, 3) rad^2 that goes with `attitude`; the camera's a priori one before the stars are solved."""
    return a_priori_covariance(context) if state.pointing is None else state.pointing.covariance_rad2


def a_priori_covariance(context: Context) -> FloatArray:
    """Covariance (3, 3) rad^2 of the a priori attitude, as the camera file has it."""
    sigma = context.camera.attitude_sigma
    cross = sigma.cross_px * context.camera.pixel_scale_rad
    focal = np.diag([cross, cross, np.radians(sigma.twist_deg)]) ** 2
    axes = context.camera.focal_from_camera
    return np.asarray(axes.T @ focal @ axes)


def observed(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Turn every body's center into an observable with partials."""
    return state.replace(observables=tuple(_observable(context, inputs, state, b) for b in state.bodies))


def observed_again(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Let observables that were computed before follow a new pointing or a new center."""
    return observed(context, inputs, state) if state.observables else state


def _observable(context: Context, inputs: Inputs, state: SessionState, center: BodyCenter) -> Observable:
    target = inputs.targets[center.name]
    a_priori = predict_body(target, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000)
    solved = predict_body(target, inputs.observer, context.camera, attitude(inputs, state))
    return observe(
        target,
        center,
        context.camera,
        attitude(inputs, state),
        attitude_covariance(context, state),
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        a_priori_px=a_priori.pixel_line,
        diameter_px=solved.diameter_px,
        image=context.frame.path.name,
        et=inputs.et,
        utc=inputs.utc,
        reference_body=context.mission.reference_body,
        observer=context.mission.spacecraft_name,
        center_cross_px2=_center_cross(state, center),
    )


def _center_cross(state: SessionState, center: BodyCenter) -> Mapping[str, FloatArray]:
    """Return the covariances of a center with those that were found jointly with it."""
    if center.pixel_line is None:
        return {}
    for found in state.joint:
        if found.method == center.method and center.name in found.names:
            by_name = {body.name: body for body in state.bodies if body.method == found.method}
            if all(name in by_name for name in found.names):
                centers = tuple(by_name[name] for name in found.names)
                return center_cross(JointCenters(centers, found.covariance_px2), center.name)
    return {}
