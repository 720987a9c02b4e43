"""The table of steps: all `ImageSession` methods that change the state, as pure functions, and their journal lines."""

from collections.abc import Callable
from typing import Any

from opnav_workbench.session import (
    marking,
    nudging,
    steps_bodies,
    steps_decisions,
    steps_pointing,
    steps_refit,
    steps_stars,
)
from opnav_workbench.session.context import Context
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["STEPS", "Step", "outcome_of"]

Step = Callable[[Context, Inputs, SessionState, dict[str, Any]], SessionState]

STEPS: dict[str, Step] = {
    "predict": steps_stars.predict,
    "two_star_pointing": marking.two_star_pointing,
    "nudge": nudging.nudge,
    "find_stars": steps_stars.find_stars,
    "refit_stars": steps_refit.refit_stars,
    "place_star": steps_refit.place_star,
    "reject_stars": steps_stars.reject_stars,
    "accept_stars": steps_stars.accept_stars,
    "repoint": steps_pointing.repoint,
    "add_target": steps_bodies.add_target,
    "skip_target": steps_bodies.skip_target,
    "set_circle": steps_decisions.set_circle,
    "clear_circle": steps_decisions.clear_circle,
    "choose_scans": steps_bodies.choose_scans,
    "find_body": steps_bodies.find_body,
    "find_bodies": steps_bodies.find_bodies,
    "observables": steps_bodies.observables,
    "note": steps_decisions.note,
}

Outcome = Callable[[SessionState, dict[str, Any]], str]

OUTCOMES: dict[str, Outcome] = {
    "predict": lambda s, _: f"{0 if s.a_priori is None else len(s.a_priori)} stars on or near the detector",
    "two_star_pointing": lambda s, _: marking.outcome(s),
    "nudge": lambda s, _: nudging.outcome(s),
    "find_stars": lambda s, _: f"{int(s.mask('used').sum())} stars found",
    "refit_stars": steps_refit.refit_outcome,
    "place_star": steps_refit.place_outcome,
    "reject_stars": lambda _, p: f"{len(p['ids'])} rejected",
    "accept_stars": lambda _, p: f"{len(p['ids'])} accepted",
    "repoint": lambda s, _: steps_pointing.outcome(s),
    "add_target": lambda _, p: f"{p['name']} expected",
    "skip_target": lambda _, p: f"{p['name']} left out",
    "set_circle": lambda _, p: f"{p['name']}: circle of radius {p['radius_px']:.1f} px",
    "clear_circle": lambda _, p: f"{p['name']}: no circle",
    "choose_scans": steps_bodies.scans_outcome,
    "find_body": steps_bodies.body_outcome,
    "find_bodies": steps_bodies.bodies_outcome,
    "observables": lambda s, _: f"{len(s.observables)} observables",
    "note": lambda s, _: f"note {len(s.user_notes)}",
}


def outcome_of(step: str, state: SessionState, parameters: dict[str, Any]) -> str:
    """Return one line of what came out of a step, for the journal."""
    return OUTCOMES[step](state, parameters)
