"""Session steps that concern bodies: expect, find, observe.  Pure: (context, inputs, state, parameters) -> state."""

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.errors import SessionError
from opnav_workbench.session.body_finding import BODY_METHODS, find_center, find_together
from opnav_workbench.session.context import Context
from opnav_workbench.session.observing import observed, observed_again
from opnav_workbench.session.state import (
    BodyRequest,
    Inputs,
    JointFound,
    ScanChoice,
    SessionState,
    skipped_topic,
)

__all__ = [
    "add_target",
    "bodies_outcome",
    "body_outcome",
    "choose_scans",
    "find_bodies",
    "find_body",
    "observables",
    "scans_outcome",
    "skip_target",
]

JOINT_METHODS = ("least_squares",)


def add_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Expect a target in the picture; bodies already found are looked at again with its light and its shadow."""
    name = parameters["name"]
    return _with_neighbour(context, inputs, _expecting(state, name), name)


def _expecting(state: SessionState, *names: str) -> SessionState:
    """Expect targets; those that were left out before no longer are."""
    for name in names:
        state = state.noting(skipped_topic(name))
    skipped = tuple(other for other in state.skipped_targets if other not in names)
    targets = tuple(dict.fromkeys((*state.targets, *names)))
    return state.replace(targets=targets, skipped_targets=skipped)


def skip_target(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record a target that cannot be predicted, so that the result is not taken for complete."""
    name, reason = parameters["name"], parameters["reason"]
    skipped = tuple(dict.fromkeys((*state.skipped_targets, name)))
    said = reason if name in reason else f"{name}: {reason}"
    return state.replace(skipped_targets=skipped).noting(skipped_topic(name), said)


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
    state = _found(state, request, find_center(context, inputs, state, request))
    if not known:
        state = _with_neighbour(context, inputs, state, request.name)
    return observed_again(context, inputs, state)


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


def _found(state: SessionState, request: BodyRequest, center: BodyCenter) -> SessionState:
    """Put a center in the place of what the same request, or the same method, had given before."""
    gone = [
        center.name == b.name and (center.method == b.method or request.method == r.method)
        for b, r in zip(state.bodies, state.requests, strict=True)
    ]
    for body in (b for b, g in zip(state.bodies, gone, strict=True) if g):
        state = state.noting(_topic(body))
    kept = [
        pair for pair, g in zip(zip(state.bodies, state.requests, strict=True), gone, strict=True) if not g
    ]
    joint = tuple(j for j in state.joint if center.method != j.method or center.name not in j.names)
    state = state.replace(
        bodies=(*(b for b, _ in kept), center), requests=(*(r for _, r in kept), request), joint=joint
    )
    return _noted(state, center)


def _topic(center: BodyCenter) -> str:
    return f"{center.name} {center.method}"


def _noted(state: SessionState, center: BodyCenter) -> SessionState:
    said = tuple(f"{center.name}: {message}" for message in center.messages if center.status != "ok")
    return state.noting(_topic(center), *said)


def _with_neighbour(context: Context, inputs: Inputs, state: SessionState, name: str) -> SessionState:
    """Find again the bodies that were found before `name` was expected in the picture."""
    for body, request in zip(state.bodies, state.requests, strict=True):
        if body.name != name and name not in request.scene:
            state = _again(context, inputs, state, request)
    return state


def _again(context: Context, inputs: Inputs, state: SessionState, request: BodyRequest) -> SessionState:
    """Repeat a request; its center keeps its place among the others."""
    if request.together:
        return state  # bodies found jointly are found again jointly, when the analyst asks for it
    place = state.requests.index(request)
    center = find_center(context, inputs, state, request)
    state = state.noting(_topic(state.bodies[place]))
    bodies = (*state.bodies[:place], center, *state.bodies[place + 1 :])
    return _noted(state.replace(bodies=bodies), center)


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
    joint = find_together(context, inputs, state, requests)
    for request, center in zip(requests, joint.centers, strict=True):
        state = _found(state, request, center)
    state = state.replace(joint=(*state.joint, JointFound(names, method, joint.covariance_px2)))
    for name in new:
        state = _with_neighbour(context, inputs, state, name)
    return observed_again(context, inputs, state)


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
            state = _again(context, inputs, state, replace(request, scans=None))
    return observed_again(context, inputs, state)


def observables(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Turn every body's center into an observable with partials."""
    return observed(context, inputs, state)


def body_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `find_body`, for the journal."""
    return next(
        (_line(body) for body in reversed(state.bodies) if body.name == parameters["name"]),
        parameters["name"],
    )


def bodies_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `find_bodies`, for the journal."""
    found: JointFound | None = state.joint[-1] if state.joint else None
    names: Sequence[str] = () if found is None else found.names
    return "; ".join(_line(body) for body in state.bodies if body.name in names)


def _line(body: BodyCenter) -> str:
    if body.pixel_line is None:
        return f"{body.name}: {body.status} ({body.method})"
    return f"{body.name}: {body.status} at {body.pixel_line[0]:.2f}, {body.pixel_line[1]:.2f} ({body.method})"


def scans_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `choose_scans`, for the journal."""
    numbers = parameters["numbers"]
    chosen = "automatic scans" if numbers is None else f"{len(numbers)} scans chosen"
    lines = [_line(b) for b in state.bodies if b.name == parameters["name"] and b.method == "limb_scan"]
    return "; ".join([f"{parameters['name']}: {chosen}", *lines])
