"""Session steps with bodies: expect, circle, find, choose limb scans, observables.

Pure functions: (context, inputs, state, parameters) -> state.  A body's center is found with the method asked for, or
with the one that suits its size and what is known of its surface.  Without the analyst's circle it is expected as far from
its prediction as the largest body found before: what ephemeris or attitude are off by is theirs in common.
"""

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import (
    BodyCenter,
    Circle,
    JointCenters,
    choose_method,
    find_cross_correlation,
    find_disk,
    find_ellipse,
    find_jointly,
    find_least_squares,
    find_limb_scan,
    find_unresolved,
    find_unresolved_body,
)
from opnav_workbench.bodies.lighting import fit_lighting
from opnav_workbench.bodies.picture import sized_target
from opnav_workbench.bodies.subarray import search_radius
from opnav_workbench.errors import CameraError, CenterfindingError, KernelError, MissionError, SessionError
from opnav_workbench.geometry import unit
from opnav_workbench.scene import AssistedBody, BodyPrediction, apparent_radius_px, predict_body
from opnav_workbench.session.body_models import (
    above_sky,
    body_model_if_known,
    body_picture,
    common_shift_px,
    has_albedo_map,
    has_scattering_law,
    scene_names,
)
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.pointing import (
    attitude_covariance,
    best_attitude,
    with_assisted,
    with_renewed_observables,
)
from opnav_workbench.session.state import (
    BODY_METHODS,
    MAX_POINT_DIAMETER_PX,
    BodyRequest,
    JointFound,
    ScanChoice,
    SessionState,
    skipped_topic,
)
from opnav_workbench.targets import TargetState

__all__ = [
    "add_target",
    "bodies_outcome",
    "body_outcome",
    "choose_scans",
    "clear_circle",
    "describe_body",
    "find_bodies",
    "find_body",
    "scans_outcome",
    "set_circle",
    "skip_target",
]


MIN_BODY_RADIUS_PX = 3.0  # room for an ephemeris error that nobody announced
MAX_BODY_RADIUS_PX = 30.0  # beyond this a search finds the brightest neighbour, not the body
SEARCH_SIGMAS = 4.0
LIMB_FROM_PX = 30.0  # the terminator of a body lit as an analyst guesses tells nothing, its limb does


def find_center(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> BodyCenter:
    """Find a body as the request says."""
    center = _center_as_lit(context, inputs, state, request)
    return _with_lighting(context, inputs, state, request, center) if state.assisted else center


def _center_as_lit(
    context: Context, inputs: Inputs, state: SessionState, request: BodyRequest, *, quick: bool = False
) -> BodyCenter:
    """Find a body in the light of its Sun; `quick`: once more, lit otherwise, for what that moves."""
    name = request.name
    prediction = predict_body(
        target_with_shape(context, inputs, name),
        inputs.observer,
        context.camera,
        best_attitude(inputs, state),
    )
    method = chosen_method(context, state, request, prediction)
    if method == "unresolved":
        return _unresolved(context, inputs, state, prediction, request)
    try:
        picture = body_picture(context, inputs, state, (name,), scene_names(inputs, state, request))
    except (MissionError, KernelError, CameraError) as error:
        return BodyCenter.without_center(name, method, "failed", f"it cannot be drawn: {error}")
    options = search_options(context, inputs, state, request, prediction)
    if method == "disk":
        center = find_disk(picture, name, quick=quick, **options)
        if request.method == "auto" and center.status == "failed":
            return _otherwise(center, find_least_squares(picture, name, **options))
        return center
    if method == "limb_scan":
        return find_limb_scan(picture, name, scans=scan_numbers(state, request), quick=quick, **options)
    if method == "ellipse":
        return find_ellipse(picture, name, quick=quick, **options)
    # A body with a map of its albedo has a truer model than the likelihood's.
    known = has_albedo_map(context, name)
    if method == "cross_correlation":
        return find_cross_correlation(picture, name, known_surface=known, **options)
    return find_least_squares(picture, name, solve_range=request.solve_range, known_surface=known, **options)


def _otherwise(first: BodyCenter, other: BodyCenter) -> BodyCenter:
    """Return the center that full-disk light gives where the limb gave none: a body too faint or too much hidden for it."""
    if other.pixel_line is None:
        return first
    why = "; ".join(first.messages)
    return replace(other, messages=(*other.messages, f"its limb gives no center: {why}"))


def find_joint_centers(
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
    circles = {r.name: circle for r in requests if (circle := start_circle(state, r)) is not None}
    known = [name for name in names if has_albedo_map(context, name)]
    return find_jointly(
        picture, names, circles=circles, solve_range=requests[0].solve_range, known_surfaces=known
    )


def target_with_shape(context: Context, inputs: Inputs, name: str) -> TargetState:
    """Return a target with the extent of its shape model, where it has one."""
    model = body_model_if_known(context, inputs, name)
    return inputs.targets[name] if model is None else sized_target(model)


def chosen_method(
    context: Context, state: SessionState, request: BodyRequest, prediction: BodyPrediction
) -> str:
    """Return the method that a request means."""
    if request.method != "auto":
        return request.method
    if scan_numbers(state, request) is not None:
        return "limb_scan"  # whose scans an analyst has chosen
    known = has_albedo_map(context, request.name)
    method = choose_method(prediction.diameter_px, known_surface=known)
    by_eye = request.name in state.assisted and prediction.diameter_px >= LIMB_FROM_PX
    return "ellipse" if method == "disk" and by_eye else method


def scan_numbers(state: SessionState, request: BodyRequest) -> tuple[int, ...] | None:
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
    """Return where an extended body is looked for: circle and search radius."""
    circle = start_circle(state, request)
    radius = request.search_radius_px
    if circle is None and radius is None and state.pointing is None:
        sigma = predicted_sigma_px(context, inputs, state, inputs.targets[request.name])
        least = search_radius(0.5 * prediction.diameter_px, None)
        radius = max(least, SEARCH_SIGMAS * sigma) if np.isfinite(sigma) else None
    return {"circle": circle, "search_radius_px": radius}


def start_circle(state: SessionState, request: BodyRequest) -> Circle | None:
    """Return the circle to start from: that of the request, else the analyst's, else none."""
    if request.circle is not None:
        pixel, line, radius = request.circle
        return Circle(np.array([pixel, line]), radius)
    described = state.assisted.get(request.name)
    if request.name not in state.circles and described is not None and described.radius_px is not None:
        return Circle(described.center_px, described.radius_px)
    return state.circles.get(request.name)


def _unresolved(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    prediction: BodyPrediction,
    request: BodyRequest,
) -> BodyCenter:
    target = inputs.targets[request.name]
    if prediction.diameter_px > MAX_POINT_DIAMETER_PX:
        return BodyCenter.without_center(
            target.name,
            "unresolved",
            "failed",
            f"it is {prediction.diameter_px:.1f} px wide, too large for the unresolved method "
            f"(at most {MAX_POINT_DIAMETER_PX:g} px)",
        )
    circle, radius = start_circle(state, request), request.search_radius_px
    if circle is None and radius is None:
        sigma = predicted_sigma_px(context, inputs, state, target)
        radius = float(np.clip(SEARCH_SIGMAS * sigma, MIN_BODY_RADIUS_PX, MAX_BODY_RADIUS_PX))
    prior = state.psf or context.camera_psf
    psf_error = 0.0 if state.centers is None else state.centers.psf_error
    neighbours = _neighbours(context, inputs, state, request)
    if body_model_if_known(context, inputs, request.name) is not None:
        return find_unresolved_body(
            body_picture(context, inputs, state, (request.name,), scene_names(inputs, state, request)),
            request.name,
            circle=circle,
            search_radius_px=radius,
            prior=prior,
            psf_error=psf_error,
            neighbours_px=neighbours,
            law_sigma=0.0 if has_scattering_law(context, request.name) else 1.0,
        )
    expected = prediction.pixel_line + common_shift_px(context, inputs, state, (request.name,))
    return find_unresolved(  # neither size nor brightness is known: a point, whatever its light
        context.signal_dn,
        context.noise_dn,
        context.bad,
        expected if circle is None else circle.center_px,
        prior,
        name=target.name,
        search_radius_px=search_radius(0.0, circle, radius),
        saturated=context.picture.saturated,
        noise_model=context.noise_model,
        psf_error=psf_error,
        excess_sigma_px=0.0 if state.pointing is None else state.pointing.excess_sigma_px,
        neighbours_px=neighbours,
    )


def predicted_sigma_px(context: Context, inputs: Inputs, state: SessionState, target: TargetState) -> float:
    """Largest one-sigma (px) of the predicted place, from attitude and, where given, ephemeris."""
    rotation = best_attitude(inputs, state)
    camera = context.camera.standing(rotation)
    vector = rotation @ np.asarray(target.position_km)
    by_attitude = camera.attitude_jacobian(rotation @ target.direction)
    covariance = by_attitude @ attitude_covariance(context, state) @ by_attitude.T
    if target.covariance_km2 is not None:
        by_position = camera.project_jacobian(vector[None])[0] @ rotation
        covariance = covariance + by_position @ target.covariance_km2 @ by_position.T
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else np.nan


def _neighbours(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> FloatArray:
    """Places of everything else that is bright nearby: other bodies and the catalog's stars."""
    rotation = best_attitude(inputs, state)
    others = [
        predict_body(inputs.targets[name], inputs.observer, context.camera, rotation).pixel_line
        for name in scene_names(inputs, state, request)
        if name != request.name
    ]
    stars = np.empty((0, 2))
    if state.a_priori is not None:
        stars = state.a_priori.places(context.camera, rotation)
    return np.concatenate([np.reshape(others, (-1, 2)), stars])


# ---- The steps: expect, find, observe.

JOINT_METHODS = ("least_squares",)


def add_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Expect a target in the picture; bodies already found are looked at again with its light and its shadow."""
    name = parameters["name"]
    state = _others_found_again(context, inputs, _expecting(state, name), name)
    return with_renewed_observables(context, inputs, state)


def describe_body(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Expect a body as the analyst describes it; it is found again where it had been, as others are."""
    name = parameters["name"]
    body = _described(context, name, parameters)
    state = state.replace(assisted=MappingProxyType({**state.assisted, name: body}))
    inputs = with_assisted(context, inputs, state)
    state = _expecting(state, name)
    for request in state.requests:
        if request.name == name:
            state = _found_again(context, inputs, state, request)
    return with_renewed_observables(context, inputs, _others_found_again(context, inputs, state, name))


def _described(context: Context, name: str, parameters: dict[str, Any]) -> AssistedBody:
    """Return the body; how it is lit, its own disk tells where the analyst does not."""
    given = {key: parameters.get(key) for key in ("radius_px", "range_km")}
    phase_deg, sun_deg = parameters["phase_deg"], parameters["sun_deg"]
    try:
        body = AssistedBody(
            parameters["center_px"],
            parameters["radii_km"],
            np.radians(phase_deg or 0.0),
            np.radians(sun_deg or 0.0),
            north_angle_rad=None if (north := parameters["north_deg"]) is None else np.radians(north),
            sub_observer_rad=np.radians(parameters["sub_observer_deg"]),
            lighting_sigma_rad=np.radians(parameters["lighting_sigma_deg"]),
            **given,
        )
        if phase_deg is not None and sun_deg is not None:
            return body
        signal, _ = above_sky(context)
        circle = Circle(body.center_px, apparent_radius_px(body, context.camera))
        lit = fit_lighting(signal, context.bad, circle)
    except CenterfindingError as error:
        raise SessionError(f"{name}: {error}") from error
    return replace(
        body,
        phase_rad=lit.phase_rad if phase_deg is None else body.phase_rad,
        sun_angle_rad=lit.sun_angle_rad if sun_deg is None else body.sun_angle_rad,
    )


def _with_lighting(
    context: Context, inputs: Inputs, state: SessionState, request: BodyRequest, center: BodyCenter
) -> BodyCenter:
    """Return a center whose covariance holds what it moves by where the Sun stands a sigma beside its description."""
    body, target = state.assisted.get(request.name), inputs.targets[request.name]
    if body is None or center.pixel_line is None or not body.lighting_sigma_rad:
        return center
    covariance, size_km2, size_px2 = np.asarray(center.covariance_px2), 0.0, 0.0
    for pair in _suns_beside(target, body.lighting_sigma_rad):
        lit = [replace(target, sun_position_km=sun_km) for sun_km in pair]
        others = [replace(inputs, targets=MappingProxyType({**inputs.targets, request.name: t})) for t in lit]
        found = [_center_as_lit(context, other, state, request, quick=True) for other in others]
        moved = [c for c in found if c.pixel_line is not None]
        if not moved:
            continue
        steps = [np.asarray(c.pixel_line) - center.pixel_line for c in moved]
        step = max(steps, key=lambda one: float(one @ one))
        covariance = covariance + np.outer(step, step)
        size_px2 += max((c.diameter_px - center.diameter_px) ** 2 for c in moved)
        size_km2 += max((c.range_km - center.range_km) ** 2 for c in moved)
    return replace(
        center,
        covariance_px2=covariance,
        diameter_sigma_px=float(np.hypot(center.diameter_sigma_px, np.sqrt(size_px2))),
        range_sigma_km=float(np.hypot(center.range_sigma_km, np.sqrt(size_km2))),
    )


def _suns_beside(target: TargetState, sigma_rad: float) -> list[list[FloatArray]]:
    """Return where the Sun may stand instead, on both sides: along the way to the line of sight, and across it."""
    sun_km = np.asarray(target.sun_position_km)
    to_sun, distance_km = unit(sun_km), float(np.linalg.norm(sun_km))
    least = np.eye(3)[
        np.argmin(np.abs(to_sun))
    ]  # any direction serves where the Sun stands behind the camera
    normal = np.cross(to_sun, target.direction)
    across = unit(normal if np.linalg.norm(normal) > 1e-6 else np.cross(to_sun, least))
    step = np.tan(sigma_rad)
    return [
        [distance_km * unit(to_sun + side * step * turn) for side in (-1.0, 1.0)]
        for turn in (across, np.cross(to_sun, across))
    ]


def _expecting(state: SessionState, *names: str) -> SessionState:
    """Expect targets; those that were left out before no longer are."""
    for name in names:
        state = state.with_notes(skipped_topic(name))
    skipped = tuple(other for other in state.skipped_targets if other not in names)
    targets = tuple(dict.fromkeys((*state.targets, *names)))
    return state.replace(targets=targets, skipped_targets=skipped)


def skip_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record a target that cannot be predicted, so that the result is not taken for complete."""
    name, reason = parameters["name"], parameters["reason"]
    skipped = tuple(dict.fromkeys((*state.skipped_targets, name)))
    message = reason if name in reason else f"{name}: {reason}"
    return state.replace(skipped_targets=skipped).with_notes(skipped_topic(name), message)


def find_body(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find one body's center with one method."""
    request = _request(parameters)
    if request.method not in BODY_METHODS:
        raise SessionError(
            f"unknown body method {request.method!r}; choose one of {', '.join(BODY_METHODS)}."
        )
    known = request.name in state.targets
    state = _expecting(state, request.name)
    state = _with_center(state, request, find_center(context, inputs, state, request))
    if not known:
        state = _others_found_again(context, inputs, state, request.name)
    return with_renewed_observables(context, inputs, state)


def _request(parameters: dict[str, Any]) -> BodyRequest:
    circle, scans = parameters.get("circle"), parameters.get("scans")
    return BodyRequest(
        name=parameters["name"],
        method=parameters["method"],
        search_radius_px=parameters["search_radius_px"],
        circle=None if circle is None else tuple(circle),
        scans=None if scans is None else tuple(scans),
        solve_range=bool(parameters.get("solve_range", False)),
        scene=tuple(parameters.get("scene", ())),
    )


def _with_center(state: SessionState, request: BodyRequest, center: BodyCenter) -> SessionState:
    """Put a center in the place of what the same request, or the same method, had given before."""
    gone = [
        center.name == b.name and (center.method == b.method or request.method == r.method)
        for b, r in zip(state.bodies, state.requests, strict=True)
    ]
    for body in (b for b, g in zip(state.bodies, gone, strict=True) if g):
        state = state.with_notes(_center_topic(body))
    kept = [
        pair for pair, g in zip(zip(state.bodies, state.requests, strict=True), gone, strict=True) if not g
    ]
    joint = tuple(j for j in state.joint if center.method != j.method or center.name not in j.names)
    state = state.replace(
        bodies=(*(b for b, _ in kept), center), requests=(*(r for _, r in kept), request), joint=joint
    )
    return _with_center_note(state, center)


def _center_topic(center: BodyCenter) -> str:
    return f"{center.name} {center.method}"


def _with_center_note(state: SessionState, center: BodyCenter) -> SessionState:
    messages = tuple(f"{center.name}: {message}" for message in center.messages if center.status != "ok")
    return state.with_notes(_center_topic(center), *messages)


def _others_found_again(context: Context, inputs: Inputs, state: SessionState, name: str) -> SessionState:
    """Find again the bodies that were found before `name` was expected in the picture."""
    for body, request in zip(state.bodies, state.requests, strict=True):
        if body.name != name and name not in request.scene:
            state = _found_again(context, inputs, state, request)
    return state


def _found_again(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> SessionState:
    """Repeat a request; its center keeps its place among the others."""
    if request.together:
        return state  # bodies found jointly are found again jointly, when the analyst asks for it
    place = state.requests.index(request)
    center = find_center(context, inputs, state, request)
    state = state.with_notes(_center_topic(state.bodies[place]))
    bodies = (*state.bodies[:place], center, *state.bodies[place + 1 :])
    return _with_center_note(state.replace(bodies=bodies), center)


def find_bodies(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find several bodies at once, with the correlation of their centers."""
    names, method = tuple(parameters["names"]), parameters["method"]
    if method not in JOINT_METHODS:
        raise SessionError(f"unknown joint method {method!r}; choose one of {', '.join(JOINT_METHODS)}.")
    scene = tuple(parameters.get("scene", ()))
    requests = [BodyRequest(name, method, together=names, scene=scene) for name in names]
    new = [name for name in names if name not in state.targets]
    state = _expecting(state, *names)
    joint = find_joint_centers(context, inputs, state, requests)
    for request, center in zip(requests, joint.centers, strict=True):
        state = _with_center(state, request, center)
    state = state.replace(joint=(*state.joint, JointFound(names, method, joint.covariance_px2)))
    for name in new:
        state = _others_found_again(context, inputs, state, name)
    return with_renewed_observables(context, inputs, state)


def choose_scans(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record which limb scans count; a limb-scan center that stands is made anew with them."""
    name, numbers = parameters["name"], parameters["numbers"]
    choices = {body: choice for body, choice in state.scan_choices.items() if body != name}
    if numbers is not None:
        choices[name] = ScanChoice(tuple(numbers), parameters["reason"])
    state = state.replace(scan_choices=MappingProxyType(choices))
    for body, request in zip(state.bodies, state.requests, strict=True):
        if body.name == name and body.method == "limb_scan":
            state = _found_again(context, inputs, state, replace(request, scans=None))
    return with_renewed_observables(context, inputs, state)


def body_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `find_body`, for the journal."""
    return next(
        (_center_line(body) for body in reversed(state.bodies) if body.name == parameters["name"]),
        parameters["name"],
    )


def bodies_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `find_bodies`, for the journal."""
    found: JointFound | None = state.joint[-1] if state.joint else None
    names: Sequence[str] = () if found is None else found.names
    return "; ".join(_center_line(body) for body in state.bodies if body.name in names)


def _center_line(body: BodyCenter) -> str:
    if body.pixel_line is None:
        return f"{body.name}: {body.status} ({body.method})"
    return f"{body.name}: {body.status} at {body.pixel_line[0]:.2f}, {body.pixel_line[1]:.2f} ({body.method})"


def scans_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `choose_scans`, for the journal."""
    numbers = parameters["numbers"]
    chosen = "automatic scans" if numbers is None else f"{len(numbers)} scans chosen"
    lines = [
        _center_line(b) for b in state.bodies if b.name == parameters["name"] and b.method == "limb_scan"
    ]
    return "; ".join([f"{parameters['name']}: {chosen}", *lines])


def set_circle(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record where the analyst sees a body, and how large."""
    circle = Circle(parameters["center_px"], parameters["radius_px"])
    return state.replace(circles=MappingProxyType({**state.circles, parameters["name"]: circle}))


def clear_circle(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Forget the analyst's circle of a body: the predicted one counts again."""
    kept = {name: circle for name, circle in state.circles.items() if name != parameters["name"]}
    return state.replace(circles=MappingProxyType(kept))
