"""Session steps that concern stars: predict, find, decide.  Pure: (context, inputs, state, parameters) -> state."""

from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction, predict_stars
from opnav_workbench.session.context import Context
from opnav_workbench.session.hidden import hidden_by
from opnav_workbench.session.identify import FieldMatch, brightest, identify_field
from opnav_workbench.session.judging import judge
from opnav_workbench.session.measuring import FINAL_METHODS, StarFit, fit_all, fit_some, scattered
from opnav_workbench.session.state import Inputs, SessionState, skipped_topic
from opnav_workbench.session.verdicts import ACCEPTED, REJECTED, decide, unsearched, with_verdicts

__all__ = [
    "FINAL_METHODS",
    "accept_stars",
    "find_stars",
    "predict",
    "predicted",
    "reject_stars",
    "with_placed",
]


def predict(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Predict stars with the a priori pointing; whatever was found before is dropped."""
    margin = context.settings.max_shift_px
    stars = predict_stars(
        inputs.stars, inputs.et, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000, margin
    )
    stars = brightest(stars, context.settings.max_stars)
    status = unsearched(stars.on_detector)
    topics = {skipped_topic(name) for name in state.skipped_targets}
    fresh = SessionState(
        a_priori=stars,
        found_status=status,
        decisions=state.decisions,
        targets=state.targets,
        placed=state.placed,
        circles=state.circles,
        scan_choices=state.scan_choices,
        user_notes=state.user_notes,
        skipped_targets=state.skipped_targets,
        notes=MappingProxyType({topic: said for topic, said in state.notes.items() if topic in topics}),
    )
    return fresh.replace(status=with_verdicts(fresh, status)).noting("predict", *_empty_field(stars))


def _empty_field(stars: StarPrediction) -> list[str]:
    if stars.on_detector.any():
        return []
    message = (
        "the catalog has no star on the predicted field; "
        "take a deeper catalog (--catalog) or check the pointing and the time."
    )
    return [message]


def find_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find the predicted stars in the picture and fit their centers."""
    predicted(state)
    how = StarFit(parameters["initial"], parameters["final"], 0.0)
    match = identify_field(context, inputs, state)
    how = StarFit(how.initial, how.final, parameters["search_radius_px"] or match.radius_px)
    state = state.noting("stars", *match.messages).replace(star_methods=MappingProxyType({}))
    if match.stars is not None:
        state = state.replace(a_priori=match.stars)
    if match.found is None and state.pointing is None:
        return _placed_only(context, state.replace(centers=None, star_field=None), match, how)
    match = with_placed(context, state, match)
    centers, psf = fit_all(context, match, state.psf or context.camera_psf, how)
    behind = hidden_by(context, inputs, state, match.expected_px)
    found = judge(context, predicted(state).mag, match, centers, psf, how, behind)
    state = state.replace(centers=centers, psf=psf, found_status=found, star_field=match.found)
    return state.replace(status=with_verdicts(state, found))


def _placed_only(context: Context, state: SessionState, match: FieldMatch, how: StarFit) -> SessionState:
    """Where the field is not identified, measure the stars that the analyst placed, if any."""
    match = with_placed(context, state, match)
    rows = np.flatnonzero(match.visible)
    if len(rows) == 0:
        return state
    psf = state.psf or context.camera_psf
    how = StarFit(how.initial, how.final, context.settings.search_radius_px)
    stars = predicted(state)
    centers = scattered(None, len(stars), rows, fit_some(context, match, rows, psf, 0.0, how))
    found = judge(context, stars.mag, match, centers, psf, how, [""] * len(stars))
    state = state.replace(centers=centers, psf=psf, found_status=found)
    return state.replace(status=with_verdicts(state, found))


def with_placed(context: Context, state: SessionState, match: FieldMatch) -> FieldMatch:
    """Expect the stars that the analyst placed where he placed them."""
    places = state.placed
    if not places or state.a_priori is None:
        return match
    expected = np.array(match.expected_px)
    for row, star in enumerate(state.a_priori.id.tolist()):
        if star in places:
            expected[row] = places[star]
    placed = np.isin(state.a_priori.id, list(places))
    visible = match.visible | (placed & context.camera.on_detector(expected))
    return replace(match, expected_px=expected, visible=visible)


def predicted(state: SessionState) -> StarPrediction:
    """Return the predicted stars.

    Raises
    ------
    SessionError
        There are none yet.
    """
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    return state.a_priori


def reject_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record the analyst's rejection of stars."""
    return decide(state, parameters["ids"], REJECTED, parameters["reason"])


def accept_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record the analyst's acceptance of stars, which outranks an automatic rejection."""
    return decide(state, parameters["ids"], ACCEPTED, parameters["reason"])
