"""Session steps after the stars: repoint, find bodies, observables.  Pure: (context, inputs, state, parameters) -> state."""

from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies import TargetState, center_of_light_radii
from opnav_workbench.bodycenters import BodyCenter, find_unresolved
from opnav_workbench.errors import SessionError
from opnav_workbench.observables import Observable, attitude_partials, observe
from opnav_workbench.pointing import solve_pointing
from opnav_workbench.pointing.models import MODELS
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.session.context import Context
from opnav_workbench.session.state import Inputs, SessionState, StarStatus, skipped_topic
from opnav_workbench.session.verdicts import ACCEPTED, has_center, with_verdicts

__all__ = ["BODY_METHODS", "add_target", "attitude", "find_body", "observables", "repoint", "skip_target"]

BODY_METHODS = ("unresolved",)
MIN_BODY_RADIUS_PX = 3.0  # room for an ephemeris error that nobody announced
MAX_BODY_RADIUS_PX = 30.0  # beyond this a search finds the brightest neighbour, not the body
SEARCH_SIGMAS = 4.0
# The unresolved method models a point; a wider disk is a different picture.
MAX_UNRESOLVED_DIAMETER_PX = 3.0


def repoint(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Solve the camera attitude from the stars that are in use."""
    model = parameters["model"]
    if model not in MODELS:
        raise SessionError(f"unknown pointing model {model!r}; choose one of {', '.join(MODELS)}.")
    if state.a_priori is None or state.centers is None:
        why = " ".join(state.notes.get("stars", ()))
        raise SessionError(why or "no star centers yet: call find_stars() first.")
    candidates = with_verdicts(state, state.found_status)
    usable = np.array([s.status == "used" for s in candidates], dtype=bool) & has_center(state)
    solved = state.replace(status=candidates)
    if usable.any():
        solved = _solved(context, inputs, solved, usable, parameters)
    else:
        none = f"no usable star among {len(candidates)} candidates; the a priori pointing stands."
        solved = solved.replace(pointing=None).noting("pointing", none)
    # Predictions and O-C rest on the pointing: those already computed follow it.
    return observables(context, inputs, solved, {}) if state.observables else solved


def _solved(
    context: Context, inputs: Inputs, state: SessionState, usable: BoolArray, parameters: dict[str, Any]
) -> SessionState:
    assert state.a_priori is not None
    assert state.centers is not None
    verdicts = [state.decisions.get(star, ("", ""))[0] for star in state.a_priori.id.tolist()]
    solution = solve_pointing(
        state.centers.pixel_line,
        state.centers.covariance_px2,
        state.a_priori.directions,
        context.camera,
        inputs.a_priori_camera_from_j2000,
        catalog_covariance_px2=state.a_priori.covariance_px2,
        model=parameters["model"],
        usable=usable,
        trusted=[verdict == ACCEPTED for verdict in verdicts],
        **_start(context, state, bool(parameters.get("a_priori"))),
    )
    status = tuple(
        StarStatus("rejected", reason) if offered and not used else status
        for status, offered, used, reason in zip(
            state.status, usable, solution.used, solution.reasons, strict=True
        )
    )
    return state.replace(pointing=solution, status=status).noting("pointing", *solution.messages)


def _start(context: Context, state: SessionState, a_priori: bool) -> dict[str, Any]:
    """How far the a priori attitude is to be trusted: not at all where the field was found far from it."""
    if state.star_field is None or state.star_field.search == "a priori":
        twist = {"twist_sigma_rad": np.radians(context.camera.attitude_sigma.twist_deg)}
        return twist | ({"a_priori_covariance_rad2": _a_priori_covariance(context)} if a_priori else {})
    return {"twist_sigma_rad": np.pi, "start": "svd"}


def attitude(inputs: Inputs, state: SessionState) -> FloatArray:
    """Best known ``camera_from_j2000``: solved, else a priori."""
    if state.pointing is not None:
        return state.pointing.camera_from_j2000
    return inputs.a_priori_camera_from_j2000


def attitude_covariance(context: Context, state: SessionState) -> FloatArray:
    """Covariance (3, 3) rad^2 that goes with `attitude`; the camera's a priori one before the stars are solved."""
    return _a_priori_covariance(context) if state.pointing is None else state.pointing.covariance_rad2


def _a_priori_covariance(context: Context) -> FloatArray:
    sigma = context.camera.attitude_sigma
    cross = sigma.cross_px * context.camera.pixel_scale_rad
    focal = np.diag([cross, cross, np.radians(sigma.twist_deg)]) ** 2
    axes = context.camera.focal_from_camera
    return np.asarray(axes.T @ focal @ axes)


def add_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Expect a target in the picture; one that was left out before no longer is."""
    name = parameters["name"]
    targets = tuple(dict.fromkeys((*state.targets, name)))
    skipped = tuple(other for other in state.skipped_targets if other != name)
    return state.replace(targets=targets, skipped_targets=skipped).noting(skipped_topic(name))


def find_body(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find one body's center with one method."""
    name, method = parameters["name"], parameters["method"]
    if method not in BODY_METHODS:
        raise SessionError(f"unknown body method {method!r}; choose one of {', '.join(BODY_METHODS)}.")
    target = inputs.targets[name]
    prediction = predict_body(target, inputs.observer, context.camera, attitude(inputs, state))
    center = _unresolved(context, inputs, state, target, prediction, parameters["search_radius_px"])
    state = add_target(context, inputs, state, {"name": name})
    kept = tuple(b for b in state.bodies if (b.name, b.method) != (name, method))
    said = tuple(f"{name}: {message}" for message in center.messages if center.status != "ok")
    return state.replace(bodies=(*kept, center)).noting(f"{name} {method}", *said)


def _unresolved(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    target: TargetState,
    prediction: BodyPrediction,
    radius_px: float | None,
) -> BodyCenter:
    if prediction.diameter_px > MAX_UNRESOLVED_DIAMETER_PX:
        return BodyCenter.without_center(
            target.name,
            "unresolved",
            "failed",
            f"it is {prediction.diameter_px:.1f} px wide, too large for the unresolved method "
            f"(at most {MAX_UNRESOLVED_DIAMETER_PX:g} px)",
        )
    sigma = _predicted_sigma(context, inputs, state, target)
    radius = radius_px or float(np.clip(SEARCH_SIGMAS * sigma, MIN_BODY_RADIUS_PX, MAX_BODY_RADIUS_PX))
    offset, offset_covariance = _light_offset(context, inputs, state, target, prediction)
    return find_unresolved(
        context.signal_dn,
        context.noise_dn,
        context.bad,
        prediction.pixel_line,
        state.psf or context.camera_psf,
        name=target.name,
        search_radius_px=radius,
        saturated=context.frame.saturated,
        noise_model=context.noise_model,
        psf_error=0.0 if state.centers is None else state.centers.psf_error,
        excess_sigma_px=0.0 if state.pointing is None else state.pointing.excess_sigma_px,
        diameter_px=prediction.diameter_px if np.isfinite(prediction.diameter_px) else 0.0,
        light_offset_px=offset,
        light_offset_covariance_px2=offset_covariance,
        neighbours_px=_neighbours(context, inputs, state, target.name),
    )


def _light_offset(
    context: Context, inputs: Inputs, state: SessionState, target: TargetState, prediction: BodyPrediction
) -> tuple[FloatArray, FloatArray]:
    """Center of light minus center of figure (px) of a small disk at phase, and its covariance."""
    if target.sun_position_km is None or not prediction.diameter_px > 0.0:
        return np.zeros(2), np.zeros((2, 2))
    shift, sigma = center_of_light_radii(prediction.phase_rad)
    rotation = attitude(inputs, state)
    toward_sun = rotation @ np.asarray(target.sun_position_km)
    in_camera = rotation @ prediction.direction
    on_detector = context.camera.project_jacobian(in_camera[None])[0] @ toward_sun
    length = float(np.hypot(*on_detector))
    if length == 0.0:
        return np.zeros(2), np.zeros((2, 2))
    sunward = on_detector / length
    radius_px = 0.5 * prediction.diameter_px
    return shift * radius_px * sunward, (sigma * radius_px) ** 2 * np.outer(sunward, sunward)


def _predicted_sigma(context: Context, inputs: Inputs, state: SessionState, target: TargetState) -> float:
    """Largest one-sigma (px) of the predicted place, from attitude and, where given, ephemeris."""
    camera = context.camera
    rotation = attitude(inputs, state)
    vector = rotation @ np.asarray(target.position_km)
    by_attitude = attitude_partials(target.direction, camera, rotation)
    covariance = by_attitude @ attitude_covariance(context, state) @ by_attitude.T
    if target.covariance_km2 is not None:
        by_position = camera.project_jacobian(vector[None])[0] @ rotation
        covariance = covariance + by_position @ target.covariance_km2 @ by_position.T
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else np.nan


def _neighbours(context: Context, inputs: Inputs, state: SessionState, name: str) -> FloatArray:
    """Places of everything else that is bright nearby: other bodies and the catalog's stars."""
    rotation = attitude(inputs, state)
    others = [
        predict_body(inputs.targets[key], inputs.observer, context.camera, rotation).pixel_line
        for key in state.targets
        if key != name
    ]
    stars = np.empty((0, 2))
    if state.a_priori is not None:
        stars = state.a_priori.places(context.camera, rotation)
    return np.concatenate([np.reshape(others, (-1, 2)), stars])


def skip_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record a target that cannot be predicted, so that the result is not taken for complete."""
    name, reason = parameters["name"], parameters["reason"]
    skipped = tuple(dict.fromkeys((*state.skipped_targets, name)))
    said = reason if name in reason else f"{name}: {reason}"
    return state.replace(skipped_targets=skipped).noting(skipped_topic(name), said)


def observables(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Turn every body's center into an observable with partials."""
    return state.replace(observables=tuple(_observable(context, inputs, state, b) for b in state.bodies))


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
    )
