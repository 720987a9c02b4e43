"""The camera's attitude of a session: the best one known, its covariance, its doubts, the step that solves it from stars.

Observables rest on the attitude, so they are computed here and follow every new solution.  Steps are pure functions:
(context, inputs, state, parameters) -> state.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies import BodyCenter, JointCenters
from opnav_workbench.constants import ARCSEC_PER_RAD, AU_KM, SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import SessionError
from opnav_workbench.observables import Observable, center_cross, observe
from opnav_workbench.scene import assisted_target, following, predict_body
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.orientation import far_words, turned_words
from opnav_workbench.session.state import (
    ACCEPTED,
    BY_HAND,
    LOST,
    MARKED,
    ORIENTATION_TOPIC,
    SessionState,
    StarStatus,
    has_center,
    with_decisions,
)
from opnav_workbench.stars.pointing import (
    AttitudeMotion,
    MotionTails,
    PointingSolution,
    SolvedAttitude,
    carry_attitude,
    solve_pointing,
)
from opnav_workbench.stars.pointing.attitude_steps import POINTING_MODELS
from opnav_workbench.stars.pointing.carried import (
    CARRIED,
    CarriedAttitude,
    carried_pointing,
    carried_words,
    moved_from,
)

__all__ = [
    "attitude_covariance",
    "best_attitude",
    "carry_pointing",
    "current_observables",
    "field_is_sure",
    "is_without_sky",
    "observables",
    "pointing_doubt",
    "repoint",
    "solved_attitude",
    "with_assisted",
    "with_observables",
    "with_renewed_observables",
]


def best_attitude(inputs: Inputs, state: SessionState, *, with_identified: bool = False) -> FloatArray:
    """Return the best known ``camera_from_j2000``: solved, else that of the field, else a priori.

    Parameters
    ----------
    with_identified
        Whether a field that was identified automatically, to a pixel, counts too. Where stars are expected (boxes, fits,
        nudges) it does; bodies and observables rest on what was solved, or put there by the analyst.
    """
    if state.pointing is not None:
        return state.pointing.camera_from_j2000
    if state.star_field is not None and (with_identified or state.star_field.search in (BY_HAND, MARKED)):
        return state.star_field.camera_from_j2000
    return inputs.a_priori_camera_from_j2000


def with_assisted(context: Context, inputs: Inputs, state: SessionState) -> Inputs:
    """Return inputs with the bodies that an analyst described, each where he put it with the best known attitude."""
    if not state.assisted:
        return inputs
    velocity, attitude = inputs.observer.velocity_km_s, best_attitude(inputs, state)
    sun_km = float(np.linalg.norm(inputs.observer.position_km)) or AU_KM  # the spacecraft is near the body
    described = {
        name: assisted_target(name, body, context.camera, attitude, velocity, sun_km)
        for name, body in state.assisted.items()
    }
    return replace(inputs, targets=MappingProxyType({**inputs.targets, **described}))


def is_without_sky(inputs: Inputs, state: SessionState) -> bool:
    """Whether no attitude is known at all, so that nothing can be said of directions."""
    return (
        inputs.without_sky
        and state.pointing is None
        and best_attitude(inputs, state) is inputs.a_priori_camera_from_j2000
    )


def attitude_covariance(context: Context, state: SessionState) -> FloatArray:
    """Covariance (3, 3) rad^2 that goes with `best_attitude`; the camera's a priori one before the stars are solved."""
    if state.pointing is None:
        return context.camera.a_priori_covariance_rad2
    return state.pointing.covariance_rad2


def pointing_doubt(state: SessionState) -> str:
    """Return why no target may rest on the pointing, in words; empty where it may.

    A twist that the stars do not determine is no such doubt: it keeps its a priori sigma, which is in the covariance.
    """
    if state.pointing is None:
        return "the pointing is not solved from stars"
    if not field_is_sure(state):
        return "the star field is not identified for sure"
    if ORIENTATION_TOPIC in state.notes:
        return "the picture is turned against its a priori attitude"
    return "the header contradicts itself or the kernels" if state.contradictions else ""


def field_is_sure(state: SessionState) -> bool:
    """Tell whether the star field is what it was taken for: by its evidence, or as the analyst accepted all stars in use."""
    if state.star_field is None or state.star_field.sure:
        return True
    used = [] if state.a_priori is None else state.a_priori.id[state.mask("used")].tolist()
    return bool(used) and all(state.decisions.get(star, ("", ""))[0] == ACCEPTED for star in used)


def current_observables(context: Context, inputs: Inputs, state: SessionState) -> tuple[Observable, ...]:
    """Return every body's center as an observable with partials, whether they were asked for or not."""
    inputs = with_assisted(context, inputs, state)
    return tuple(_observable(context, inputs, state, body) for body in state.bodies)


def with_observables(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Turn every body's center into an observable with partials."""
    return state.replace(observables=current_observables(context, inputs, state))


def observables(
    context: Context, inputs: Inputs, state: SessionState, _parameters: dict[str, Any]
) -> SessionState:
    """Turn every body's center into an observable with partials."""
    return with_observables(context, inputs, state)


def with_renewed_observables(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Let observables that were computed before follow a new pointing or a new center."""
    return with_observables(context, inputs, state) if state.observables else state


def _observable(context: Context, inputs: Inputs, state: SessionState, center: BodyCenter) -> Observable:
    without_sky = is_without_sky(inputs, state)
    seen = _on_sky(context, inputs, state, center, "" if without_sky else pointing_doubt(state))
    if center.name in state.assisted:
        seen = replace(seen, **NO_RESIDUALS)
    return replace(seen, **NO_DIRECTIONS, total_covariance_px2=center.covariance_px2) if without_sky else seen


def _on_sky(
    context: Context, inputs: Inputs, state: SessionState, center: BodyCenter, doubt: str
) -> Observable:
    target = inputs.targets[center.name]
    a_priori = predict_body(target, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000)
    solved = predict_body(target, inputs.observer, context.camera, best_attitude(inputs, state))
    return observe(
        target,
        center,
        following(context.camera, target, inputs.observer.velocity_km_s, best_attitude(inputs, state)),
        best_attitude(inputs, state),
        attitude_covariance(context, state),
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        a_priori_px=a_priori.pixel_line,
        diameter_px=solved.diameter_px,
        image=context.picture.name,
        et=inputs.et,
        utc=inputs.utc,
        reference_body=context.mission.reference_body,
        observer=context.mission.spacecraft_name,
        center_cross_px2=_center_cross(state, center),
        pointing_doubt=doubt,
    )


# What of an observable needs an ephemeris, and what an attitude.
NO_RESIDUALS: Mapping[str, Any] = dict.fromkeys(
    (
        "residual_px",
        "residual_arcsec",
        "residual_covariance_arcsec2",
        "partials_px_per_km",
        "target_partials_px_per_km",
        "target_partials_px_per_km_s",
        "diameter_partials_px_per_km",
        "range_partials",
    )
)
NO_DIRECTIONS: Mapping[str, Any] = dict(NO_RESIDUALS) | {
    "ra_deg": np.nan,
    "dec_deg": np.nan,
    "apparent_ra_deg": np.nan,
    "apparent_dec_deg": np.nan,
    "sky_partials_px_per_rad": None,
    "attitude_covariance_rad2": None,
    "partials_px_per_rad": None,
}


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


# ---- The step.

# A field moved by hand may keep its a priori twist, unless it was turned by more than the camera's twist is off.
HAND_TWIST_SIGMAS = 3.0


def repoint(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Solve the camera attitude from the stars that are in use."""
    model = parameters["model"]
    if model not in POINTING_MODELS:
        raise SessionError(f"unknown pointing model {model!r}; choose one of {', '.join(POINTING_MODELS)}.")
    if state.a_priori is None or state.centers is None:
        why = " ".join(state.notes.get("stars", ()))
        raise SessionError(why or "no star centers yet: call find_stars() first.")
    candidates = with_decisions(state, state.found_status)
    usable = np.array([s.status == "used" for s in candidates], dtype=bool) & has_center(state)
    solved = state.replace(status=candidates)
    if usable.any():
        start = _start(context, inputs, state, bool(parameters.get("a_priori")))
        solved = _solved(context, inputs, solved, usable, model, start)
    else:
        none = f"no usable star among {len(candidates)} candidates; the a priori pointing stands."
        solved = solved.replace(pointing=None).with_notes("pointing", none).with_notes(ORIENTATION_TOPIC)
    # Predictions and O-C rest on the pointing: those already computed follow it.
    return with_renewed_observables(context, inputs, solved)


def _solved(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    usable: BoolArray,
    model: Any,
    start: dict[str, Any],
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
        common_px=state.centers.common_px,
        model=model,
        usable=usable,
        trusted=[verdict == ACCEPTED for verdict in verdicts],
        motion_tails=MotionTails(
            state.a_priori.motion_px2, state.a_priori.motion_shares, state.a_priori.motion_variances
        ),
        **start,
    )
    status = tuple(
        StarStatus("rejected", reason) if offered and not used else status
        for status, offered, used, reason in zip(
            state.status, usable, solution.used, solution.reasons, strict=True
        )
    )
    widened = _widened(context, inputs, solution)
    solved = state.replace(pointing=widened, status=status).with_notes("pointing", *widened.messages)
    return _against_a_priori(context, inputs, solved)


def _against_a_priori(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Say where the a priori attitude and the stars cannot both be right: whether the picture is turned, or only far."""
    assert state.pointing is not None
    if not inputs.has_a_priori_attitude:  # or it is of these very stars
        return state
    camera, pointing, source = context.camera, state.pointing, inputs.attitude_source
    turned = turned_words(camera, pointing, source)
    state = state.with_notes(ORIENTATION_TOPIC, *filter(None, [turned]))
    said = state.star_field is not None and state.star_field.search == LOST
    far = "" if turned or said else far_words(camera, inputs.a_priori_camera_from_j2000, pointing, source)
    return state.with_notes("pointing", *pointing.messages, *filter(None, [far]))


def _widened(context: Context, inputs: Inputs, solution: PointingSolution) -> PointingSolution:
    """Return a pointing whose covariance holds the aberration that nobody knows: it turns all stars alike."""
    sigma = inputs.observer.velocity_sigma_km_s / SPEED_OF_LIGHT_KM_S
    if sigma == 0.0:
        return solution
    across = np.eye(3) - np.outer(context.camera.boresight, context.camera.boresight)
    covariance = solution.covariance_rad2 + sigma**2 * across
    said = (
        f"the spacecraft's velocity is not known: no aberration is removed, and {sigma * ARCSEC_PER_RAD:.1f} arcsec of it "
        "are in the pointing's covariance; kernels tell it (--kernels)"
    )
    return replace(solution, covariance_rad2=covariance, messages=(*solution.messages, said))


def _start(context: Context, inputs: Inputs, state: SessionState, a_priori: bool) -> dict[str, Any]:
    """How far the a priori attitude is to be trusted: not at all where the field was found far from it."""
    if not inputs.has_a_priori_attitude or not _near_a_priori(context, state):
        return {"twist_sigma_rad": np.pi, "start": "svd"}
    camera = context.camera
    twist = {"twist_sigma_rad": camera.a_priori_sigma_rad[2]}
    return twist | ({"a_priori_covariance_rad2": camera.a_priori_covariance_rad2} if a_priori else {})


def _near_a_priori(context: Context, state: SessionState) -> bool:
    found = state.star_field
    if found is None or found.search == "a priori":
        return True
    most = HAND_TWIST_SIGMAS * context.camera.a_priori_sigma_rad[2]
    return found.search == BY_HAND and abs(found.twist_rad) <= most


# ---- The attitude carried from pictures with stars.


def solved_attitude(context: Context, inputs: Inputs, state: SessionState) -> SolvedAttitude:
    """Return what other pictures may carry to themselves.

    Raises
    ------
    SessionError
        The pointing is not solved for sure, or nothing was known before that another picture could have in common.
    """
    if state.pointing is not None and state.pointing.model == CARRIED:
        raise SessionError(
            f"{context.picture.name} has no pointing to carry: its own is carried from others."
        )
    if state.pointing is None or pointing_doubt(state):
        raise SessionError(f"{context.picture.name} has no pointing to carry: {pointing_doubt(state)}.")
    if not inputs.has_a_priori_attitude:
        raise SessionError(
            f"{context.picture.name} has no pointing to carry: only its stars tell its attitude; give kernels or a header "
            "with attitudes."
        )
    return SolvedAttitude(
        image=context.picture.name,
        et=inputs.et,
        camera_from_j2000=state.pointing.camera_from_j2000,
        a_priori_camera_from_j2000=inputs.a_priori_camera_from_j2000,
        covariance_rad2=state.pointing.covariance_rad2,
    )


def carry_pointing(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Take the pointing from the stars of other pictures; stars of its own, in a field that is sure, count with it."""
    if not inputs.has_a_priori_attitude:
        raise SessionError(
            "no pointing can be carried here: neither kernels nor header tell how the camera moved since the other pictures."
        )
    neighbors = [
        SolvedAttitude(
            str(n["image"]),
            float(n["et"]),
            *(
                np.asarray(n[name], float)
                for name in ("camera_from_j2000", "a_priori_camera_from_j2000", "covariance_rad2")
            ),
        )
        for n in parameters["neighbors"]
    ]
    carried = carry_attitude(
        inputs.a_priori_camera_from_j2000, inputs.et, neighbors, AttitudeMotion(**parameters["motion"])
    )
    used = state.mask("used") if state.centers is not None else np.zeros(0, bool)
    if state.pointing is not None and used.any() and field_is_sure(state):
        solved = _with_own_stars(context, inputs, state, used, carried)
    else:
        stars = 0 if state.a_priori is None else len(state.a_priori)
        pointing = carried_pointing(carried, context.camera, inputs.a_priori_camera_from_j2000, stars)
        statuses = tuple(
            StarStatus("rejected", "not identified for sure") if status.status == "used" else status
            for status in state.status
        )
        solved = state.replace(pointing=pointing, star_field=None, status=statuses)
        solved = solved.with_notes("pointing", *pointing.messages).with_notes("stars")
    return with_renewed_observables(context, inputs, solved)


def _with_own_stars(
    context: Context, inputs: Inputs, state: SessionState, used: BoolArray, carried: CarriedAttitude
) -> SessionState:
    assert state.pointing is not None
    moved = replace(inputs, a_priori_camera_from_j2000=carried.camera_from_j2000)
    start = {"a_priori_covariance_rad2": carried.covariance_rad2}
    model = state.pointing.model
    usable = used & has_center(state)
    solved = _solved(context, moved, state, usable, "euler" if model == CARRIED else model, start)
    assert solved.pointing is not None
    words = carried_words(carried, context.camera)
    pointing = moved_from(solved.pointing, context.camera, inputs.a_priori_camera_from_j2000, words)
    return solved.replace(pointing=pointing).with_notes("pointing", *pointing.messages)


def carried_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out, for the journal."""
    assert state.pointing is not None
    return (
        f"pointing of {len(parameters['neighbors'])} other pictures, moved by {state.pointing.delta_pixel:+.2f} px, "
        f"{state.pointing.delta_line:+.2f} lines; {state.pointing.n_stars} stars of its own"
    )


def repoint_outcome(state: SessionState, _: dict[str, Any]) -> str:
    """One line of what came out, for the journal."""
    pointing = state.pointing
    if pointing is None:
        return "pointing not determined"
    return (
        f"pointing moved by {pointing.delta_pixel:+.2f} px, {pointing.delta_line:+.2f} lines; "
        f"rms {pointing.rms_px:.3f} px with {pointing.n_stars} stars"
    )
