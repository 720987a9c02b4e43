"""One body's center with one method, or with the one that suits it: from a session's state to a `BodyCenter`."""

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.bodycenters import (
    BodyCenter,
    Circle,
    JointCenters,
    choose_method,
    find_cross_correlation,
    find_ellipse,
    find_jointly,
    find_least_squares,
    find_limb_scan,
    find_unresolved,
    find_unresolved_body,
)
from opnav_workbench.bodycenters.picture import sized_target
from opnav_workbench.bodycenters.subarray import search_radius
from opnav_workbench.errors import CameraError, KernelError, MissionError, SessionError
from opnav_workbench.observables import attitude_partials
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.session.body_pictures import best_center, body_picture, scene_names
from opnav_workbench.session.context import Context
from opnav_workbench.session.observing import attitude, attitude_covariance
from opnav_workbench.session.state import BodyRequest, Inputs, SessionState
from opnav_workbench.session.surfaces import drawn, knows_law, knows_surface

__all__ = ["BODY_METHODS", "BodyMethod", "find_center", "find_together", "predicted_sigma_px"]


BodyMethod = Literal["auto", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"]
BODY_METHODS: tuple[BodyMethod, ...] = get_args(BodyMethod)
MIN_BODY_RADIUS_PX = 3.0  # room for an ephemeris error that nobody announced
MAX_BODY_RADIUS_PX = 30.0  # beyond this a search finds the brightest neighbour, not the body
SEARCH_SIGMAS = 4.0
# A shift of other bodies by less than this is within what a body is searched in anyway, in radii and px.
COMPANY_SHIFT, MIN_COMPANY_SHIFT_PX = 0.5, 6.0
# The unresolved method models a point; a wider disk is a different picture.
MAX_UNRESOLVED_DIAMETER_PX = 3.0


def find_center(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> BodyCenter:
    """Find a body as the request says."""
    name = request.name
    prediction = predict_body(
        shown_target(context, inputs, name), inputs.observer, context.camera, attitude(inputs, state)
    )
    method = chosen_method(context, request, prediction)
    if method == "unresolved":
        return _unresolved(context, inputs, state, prediction, request)
    try:
        picture = body_picture(context, inputs, state, (name,), scene_names(inputs, state, request))
    except (MissionError, KernelError, CameraError) as error:
        return BodyCenter.without_center(name, method, "failed", f"it cannot be drawn: {error}")
    options = search_options(context, inputs, state, request, prediction)
    if method == "limb_scan":
        return find_limb_scan(picture, name, scans=scans_of(state, request), **options)
    if method == "ellipse":
        return find_ellipse(picture, name, **options)
    if method == "cross_correlation":
        return find_cross_correlation(picture, name, **options)
    return find_least_squares(picture, name, solve_range=request.solve_range, **options)


def find_together(
    context: Context, inputs: Inputs, state: SessionState, requests: Sequence[BodyRequest]
) -> JointCenters:
    """Find several bodies jointly by least squares.

    Raises
    ------
    SessionError
        One of them cannot be drawn.
    """
    names = [request.name for request in requests]
    try:
        picture = body_picture(context, inputs, state, names, scene_names(inputs, state, requests[0]))
    except (MissionError, KernelError, CameraError) as error:
        raise SessionError(f"{', '.join(names)}: not all of them can be drawn: {error}") from error
    circles = {r.name: circle for r in requests if (circle := circle_of(state, r)) is not None}
    return find_jointly(picture, names, circles=circles, solve_range=requests[0].solve_range)


def shown_target(context: Context, inputs: Inputs, name: str) -> TargetState:
    """Return a target with the extent of its shape model, where it has one."""
    model = drawn(context, inputs, name)
    return inputs.targets[name] if model is None else sized_target(model)


def chosen_method(context: Context, request: BodyRequest, prediction: BodyPrediction) -> str:
    """Return the method that a request means."""
    if request.method != "auto":
        return request.method
    known = knows_surface(context, request.name)
    return choose_method(prediction.diameter_px, prediction.phase_rad, known_surface=known)


def scans_of(state: SessionState, request: BodyRequest) -> tuple[int, ...] | None:
    """Return the limb scans to use: those of the request, else the analyst's choice, else None (automatic)."""
    if request.scans is not None:
        return request.scans
    choice = state.scan_choices.get(request.name)
    return None if choice is None else choice.numbers


def search_options(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    request: BodyRequest,
    prediction: BodyPrediction,
) -> dict[str, Any]:
    """Return where an extended body is looked for: circle and search radius.

    Without the analyst's circle, it is expected as far from its prediction as the largest body found before: what
    ephemeris or attitude are off by is theirs in common.
    """
    circle = circle_of(state, request)
    radius = request.search_radius_px
    if circle is None and radius is None:
        circle = _company_circle(inputs, context, state, request, prediction)
    if circle is None and radius is None and state.pointing is None:
        sigma = predicted_sigma_px(context, inputs, state, inputs.targets[request.name])
        least = search_radius(0.5 * prediction.diameter_px, None)
        radius = max(least, SEARCH_SIGMAS * sigma) if np.isfinite(sigma) else None
    return {"circle": circle, "search_radius_px": radius}


def _company_circle(
    inputs: Inputs,
    context: Context,
    state: SessionState,
    request: BodyRequest,
    prediction: BodyPrediction,
) -> Circle | None:
    """Return where the shift of the largest body found before puts this one; None where it is small or unknown."""
    shifts = []
    for name in {body.name for body in state.bodies} - {request.name}:
        center = best_center(state, name)
        if center is None or center.pixel_line is None or inputs.targets[name].is_star:
            continue
        other = predict_body(inputs.targets[name], inputs.observer, context.camera, attitude(inputs, state))
        shifts.append((other.diameter_px, name, center.pixel_line - other.pixel_line))
    if not shifts or not prediction.diameter_px > 0.0 or not np.isfinite(prediction.pixel_line).all():
        return None
    shift = max(shifts, key=lambda entry: (np.nan_to_num(entry[0]), entry[1]))[2]
    radius = 0.5 * prediction.diameter_px
    if np.hypot(*shift) < max(COMPANY_SHIFT * radius, MIN_COMPANY_SHIFT_PX):
        return None
    return Circle(prediction.pixel_line + shift, radius)


def circle_of(state: SessionState, request: BodyRequest) -> Circle | None:
    """Return the circle to start from: that of the request, else the analyst's, else none."""
    if request.circle is not None:
        pixel, line, radius = request.circle
        return Circle(np.array([pixel, line]), radius)
    return state.circles.get(request.name)


def _unresolved(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    prediction: BodyPrediction,
    request: BodyRequest,
) -> BodyCenter:
    target = inputs.targets[request.name]
    if prediction.diameter_px > MAX_UNRESOLVED_DIAMETER_PX:
        return BodyCenter.without_center(
            target.name,
            "unresolved",
            "failed",
            f"it is {prediction.diameter_px:.1f} px wide, too large for the unresolved method "
            f"(at most {MAX_UNRESOLVED_DIAMETER_PX:g} px)",
        )
    circle, radius = circle_of(state, request), request.search_radius_px
    if circle is None and radius is None:
        sigma = predicted_sigma_px(context, inputs, state, target)
        radius = float(np.clip(SEARCH_SIGMAS * sigma, MIN_BODY_RADIUS_PX, MAX_BODY_RADIUS_PX))
    prior = state.psf or context.camera_psf
    psf_error = 0.0 if state.centers is None else state.centers.psf_error
    neighbours = _neighbours(context, inputs, state, request)
    if drawn(context, inputs, request.name) is not None:
        return find_unresolved_body(
            body_picture(context, inputs, state, (request.name,), scene_names(inputs, state, request)),
            request.name,
            circle=circle,
            search_radius_px=radius,
            prior=prior,
            psf_error=psf_error,
            neighbours_px=neighbours,
            law_sigma=0.0 if knows_law(context, request.name) else 1.0,
        )
    return find_unresolved(  # neither size nor brightness is known: a point, whatever its light
        context.signal_dn,
        context.noise_dn,
        context.bad,
        prediction.pixel_line if circle is None else circle.center_px,
        prior,
        name=target.name,
        search_radius_px=search_radius(0.0, circle, radius),
        saturated=context.frame.saturated,
        noise_model=context.noise_model,
        psf_error=psf_error,
        excess_sigma_px=0.0 if state.pointing is None else state.pointing.excess_sigma_px,
        neighbours_px=neighbours,
    )


def predicted_sigma_px(context: Context, inputs: Inputs, state: SessionState, target: TargetState) -> float:
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


def _neighbours(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> FloatArray:
    """Places of everything else that is bright nearby: other bodies and the catalog's stars."""
    rotation = attitude(inputs, state)
    others = [
        predict_body(inputs.targets[name], inputs.observer, context.camera, rotation).pixel_line
        for name in scene_names(inputs, state, request)
        if name != request.name
    ]
    stars = np.empty((0, 2))
    if state.a_priori is not None:
        stars = state.a_priori.places(context.camera, rotation)
    return np.concatenate([np.reshape(others, (-1, 2)), stars])
