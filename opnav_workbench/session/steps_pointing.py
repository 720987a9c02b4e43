"""Session step: the camera's attitude from the stars in use.  Pure: (context, inputs, state, parameters) -> state."""

from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray
from opnav_workbench.errors import SessionError
from opnav_workbench.pointing import solve_pointing
from opnav_workbench.pointing.models import MODELS
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import BY_HAND
from opnav_workbench.session.observing import a_priori_covariance, observed_again
from opnav_workbench.session.state import Inputs, SessionState, StarStatus
from opnav_workbench.session.verdicts import ACCEPTED, has_center, with_verdicts

__all__ = ["outcome", "repoint"]

# A field moved by hand may keep its a priori twist, unless it was turned by more than the camera's twist is off.
HAND_TWIST_SIGMAS = 3.0


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
    return observed_again(context, inputs, solved)


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
    if not _near_a_priori(context, state):
        return {"twist_sigma_rad": np.pi, "start": "svd"}
    twist = {"twist_sigma_rad": np.radians(context.camera.attitude_sigma.twist_deg)}
    return twist | ({"a_priori_covariance_rad2": a_priori_covariance(context)} if a_priori else {})


def _near_a_priori(context: Context, state: SessionState) -> bool:
    found = state.star_field
    if found is None or found.search == "a priori":
        return True
    most = HAND_TWIST_SIGMAS * np.radians(context.camera.attitude_sigma.twist_deg)
    return found.search == BY_HAND and abs(found.twist_rad) <= most


def outcome(state: SessionState) -> str:
    """One line of what came out, for the journal."""
    pointing = state.pointing
    if pointing is None:
        return "pointing not determined"
    return (
        f"pointing moved by {pointing.delta_pixel:+.2f} px, {pointing.delta_line:+.2f} lines; "
        f"rms {pointing.rms_px:.3f} px with {pointing.n_stars} stars"
    )
