"""Session steps with landmarks: find, accept, reject; what a new pointing makes of them; their observables.

Pure functions: (context, inputs, state, parameters) -> state.  What was measured stands; statuses and pose are judged anew
with every decision and every attitude.  The attitude takes part in the pose with the covariance of the stars' solution, or
of the camera's a priori one.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.errors import CameraError, KernelError, MissionError, SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.landmarks import (
    LandmarkPatch,
    LandmarkSolution,
    Maplets,
    PoseKnowledge,
    find_landmarks,
    find_lost_landmarks,
    judge_landmarks,
    landmark_patches,
    posed,
    predicted_again,
)
from opnav_workbench.observables import Observable, observe
from opnav_workbench.scene import following
from opnav_workbench.session.body_models import body_picture, scene_names
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.pointing import attitude_covariance, best_attitude, pointing_doubt
from opnav_workbench.session.state import ACCEPTED, REJECTED, BodyRequest, SessionState, landmark_name
from opnav_workbench.targets import TargetState

__all__ = [
    "METHOD",
    "accept_landmarks",
    "body_landmark_patches",
    "find_body_landmarks",
    "judged",
    "landmark_observables",
    "landmarks_outcome",
    "maplets_file",
    "reject_landmarks",
]

METHOD = "landmark"  # what observables call it


@lru_cache(maxsize=4)
def _read(path: str, sha256: str) -> Maplets:
    """Return maplets of a file, read once; its digest says whether it is the file of the step."""
    if sha256_of(path) != sha256:
        raise SessionError(
            f"maplets {path} are not those of the recorded step any more; give the file back, or find the landmarks anew."
        )
    return Maplets.read(path)


def maplets_file(context: Context, name: str, given: str | Path | None) -> tuple[Path, str]:
    """Return the maplets to use for a body, those given or the mission's, and their SHA-256.

    Raises
    ------
    SessionError
        There are none, or they are another body's.
    """
    surface = context.mission.target_surfaces.get(name)
    found = Path(given) if given is not None else None if surface is None else surface.maplets
    if found is None:
        raise SessionError(
            f"no maplets of {name} are known: give a file, name it in the mission file (target_surfaces: {name}: maplets), "
            "or make one with opnav landmarks make."
        )
    if not found.is_file():
        raise SessionError(
            f"maplets of {name}: there is no file {found}; make one with opnav landmarks make."
        )
    path, digest = found.resolve(), sha256_of(found)
    body = _read(str(path), digest).body
    if body.casefold() != name.casefold():
        raise SessionError(f"{found} holds maplets of {body}, not of {name}; give those of {name}.")
    return path, digest


def find_body_landmarks(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find the landmarks of one body."""
    name = parameters["name"]
    picture, maplets = _drawn_from(context, inputs, state, parameters)
    sigma_km = parameters.get("position_sigma_km")
    known = _known(context, state, inputs.targets[name], sigma_km)
    attitude = known.attitude_covariance_rad2
    if parameters.get("lost"):
        found = find_lost_landmarks(picture, maplets, attitude_covariance_rad2=attitude)
    else:
        found = find_landmarks(
            picture,
            maplets,
            attitude_covariance_rad2=attitude,
            position_covariance_km2=known.position_covariance_km2,
            search_radius_px=parameters.get("search_radius_px"),
        )
    found = replace(found, centers=replace(found.centers, position_sigma_km=sigma_km))
    others = tuple(one for one in state.landmarks if one.centers.body != name)
    state = state.replace(landmarks=(*others, found))
    return judged(context, inputs, state)


def _drawn_from(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> tuple[BodyPicture, Maplets]:
    """Return picture and maplets that landmarks are drawn from.

    Raises
    ------
    SessionError
        The body cannot be drawn, or the maplets are not those of the step any more.
    """
    name = parameters["name"]
    maplets = _read(parameters["maplets"], parameters["sha256"])
    request = BodyRequest(name, METHOD, scene=tuple(parameters.get("scene", ())))
    try:
        picture = body_picture(context, inputs, state, (name,), scene_names(inputs, state, request))
    except (MissionError, KernelError, CameraError) as error:
        raise SessionError(f"landmarks of {name}: it cannot be drawn: {error}") from error
    return picture, maplets if maplets.body == name else replace(maplets, body=name)


def body_landmark_patches(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any], ids: Sequence[str]
) -> tuple[LandmarkPatch, ...]:
    """Return what a person looks at of some landmarks; `parameters` are those of the step that found them."""
    solution = _solution(state, parameters["name"], ids)
    return landmark_patches(*_drawn_from(context, inputs, state, parameters), solution, ids)


def _known(
    context: Context, state: SessionState, target: TargetState, position_sigma_km: float | None
) -> PoseKnowledge:
    told = target.covariance_km2 if position_sigma_km is None else position_sigma_km**2 * np.eye(3)
    return PoseKnowledge(told, attitude_covariance(context, state))


def judged(context: Context, inputs: Inputs, state: SessionState) -> SessionState:
    """Judge all landmarks with the best attitude and the analyst's decisions."""
    solutions = []
    for solution in state.landmarks:
        body = solution.centers.body
        target, start_km = inputs.targets[body], solution.centers.start_km
        if start_km is not None:  # nobody knew where it is
            target = replace(target, covariance_km2=None).standing_at(start_km)
        attitude, velocity = best_attitude(inputs, state), inputs.observer.velocity_km_s
        view = (target, following(context.camera, target, velocity, attitude), attitude, velocity)
        landmarks = posed(solution.centers, *view)
        decisions = {
            identity: state.landmark_decisions[landmark_name(body, identity)]
            for identity in solution.centers.id.tolist()
            if landmark_name(body, identity) in state.landmark_decisions
        }
        centers = predicted_again(solution.centers, landmarks)
        known = _known(context, state, target, centers.position_sigma_km)
        judged = judge_landmarks(centers, landmarks, known, decisions)
        solutions.append(judged)
        state = state.with_notes(f"landmarks of {body}", *_notes(judged, state))
    return state.replace(landmarks=tuple(solutions))


def _notes(judged: LandmarkSolution, state: SessionState) -> tuple[str, ...]:
    """What a picture's messages say of a body's landmarks: why they give no pose, or that only they give one."""
    body = judged.centers.body
    if not len(judged.centers):
        unseen = "; ".join(f"{count} {why}" for why, count in judged.centers.not_searched.items())
        return (f"no landmark of {body} is looked for" + (f": {unseen}" if unseen else ""),)
    if judged.pose is None:
        return judged.messages
    if state.pointing is not None:
        return ()
    count, body = judged.pose.n_landmarks, judged.centers.body
    return (
        f"no stars tell the pointing; {count} landmarks of {body} do, with the place (pose of its landmarks)",
    )


def accept_landmarks(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Accept landmarks that were measured, whatever the others say."""
    return _decided(context, inputs, state, parameters, ACCEPTED)


def reject_landmarks(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Reject landmarks."""
    return _decided(context, inputs, state, parameters, REJECTED)


def _decided(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any], verdict: str
) -> SessionState:
    name, ids, reason = parameters["name"], parameters["ids"], parameters["reason"]
    _solution(state, name, ids)
    decisions = {landmark_name(name, identity): (verdict, reason) for identity in ids}
    state = state.replace(landmark_decisions=MappingProxyType({**state.landmark_decisions, **decisions}))
    return judged(context, inputs, state)


def _solution(state: SessionState, name: str, ids: Sequence[str]) -> LandmarkSolution:
    """Return what was found of a body's landmarks.

    Raises
    ------
    SessionError
        Nothing was looked for yet, or an id is none of them.
    """
    found = next((one for one in state.landmarks if one.centers.body == name), None)
    if found is None:
        raise SessionError(f"no landmarks of {name} were looked for yet: call find_landmarks() first.")
    unknown = sorted(set(ids) - set(found.centers.id.tolist()))
    if unknown:
        some = ", ".join(found.centers.id[:3].tolist())
        raise SessionError(
            f"{name} has no landmark {', '.join(unknown)} in this picture; there are such as {some}."
        )
    return found


def landmarks_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out, for the journal."""
    found = next((one for one in state.landmarks if one.centers.body == parameters["name"]), None)
    return parameters["name"] if found is None else _line(found)


def _line(found: LandmarkSolution) -> str:
    text = f"{found.centers.body}: {int(found.accepted.sum())} of {len(found.centers)} landmarks accepted"
    if found.pose is None:
        return f"{text}, no pose"
    moved = np.linalg.norm(found.pose.position_shift_km)
    return f"{text}; rms {found.pose.rms_px:.3f} px, the camera {moved:.4g} km from where it was believed"


def landmark_observables(context: Context, inputs: Inputs, state: SessionState) -> tuple[Observable, ...]:
    """Return every accepted landmark as the observable of a point: one line of the exports each."""
    out: list[Observable] = []
    doubt = pointing_doubt(state)
    for solution in state.landmarks:
        body = inputs.targets[solution.centers.body]
        covariance = solution.covariance_px2 + solution.centers.common_covariance_px2
        out += [
            _observable(context, inputs, state, solution, body, int(row), covariance[row], doubt)
            for row in np.flatnonzero(solution.accepted)
        ]
    return tuple(out)


def _observable(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    solution: LandmarkSolution,
    body: TargetState,
    row: int,
    covariance: np.ndarray,
    doubt: str,
) -> Observable:
    centers = solution.centers
    assert body.body_from_j2000 is not None
    name = landmark_name(body.name, str(centers.id[row]))
    place = body.position_km + centers.place_km[row] @ body.body_from_j2000
    point = TargetState(name, place, velocity_km_s=body.velocity_km_s)
    camera = following(context.camera, body, inputs.observer.velocity_km_s, best_attitude(inputs, state))
    before = inputs.a_priori_camera_from_j2000
    a_priori = posed(centers, body, camera.standing(before), before, inputs.observer.velocity_km_s)
    x, y, z = centers.place_km[row]
    said = f"on {body.name} at {x:.6f}, {y:.6f}, {z:.6f} km, body-fixed"
    return observe(
        point,
        BodyCenter(name, METHOD, "ok", centers.observed_px[row], covariance, messages=(said,)),
        camera,
        best_attitude(inputs, state),
        attitude_covariance(context, state),
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        a_priori_px=a_priori.observed_px[row] - a_priori.residual_px()[row],
        diameter_px=0.0,
        image=context.picture.name,
        et=inputs.et,
        utc=inputs.utc,
        reference_body=context.mission.reference_body,
        observer=context.mission.spacecraft_name,
        pointing_doubt=doubt,
    )
