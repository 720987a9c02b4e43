"""Session steps of the analyst at a star: fit it again in another way, or place a star that was not found.

Pure: (context, inputs, state, parameters) -> state.
"""

from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import IntArray
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction, predict_stars
from opnav_workbench.session.context import Context
from opnav_workbench.session.hidden import hidden_by
from opnav_workbench.session.identify import FieldMatch
from opnav_workbench.session.judging import judge
from opnav_workbench.session.marking import all_stars
from opnav_workbench.session.measuring import StarFit, fit_all, fit_some, scattered
from opnav_workbench.session.nudging import field_attitude
from opnav_workbench.session.state import MEASURED_STATUSES, Inputs, SessionState
from opnav_workbench.session.steps_stars import predicted, with_placed
from opnav_workbench.session.verdicts import ACCEPTED, check_known, decide, unsearched, with_verdicts

__all__ = ["place_outcome", "place_star", "refit_outcome", "refit_stars"]

PLACED_RADIUS_PX = 3.0  # a hand marks a star to a pixel or two
PLACED = "placed by the analyst"


def refit_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Fit some stars again, or all, around the places where they are expected now; the field stays as it is."""
    stars = predicted(state)
    if state.centers is None or state.psf is None:
        raise SessionError("no star centers yet: call find_stars() first.")
    rows = _rows(stars, parameters["ids"])
    match = _match(context, inputs, state)
    how = StarFit(
        parameters["initial"],
        parameters["final"],
        parameters["search_radius_px"] or match.radius_px,
        None if parameters["template"] is None else int(_rows(stars, [parameters["template"]])[0]),
    )
    if parameters["ids"] is None:
        centers, psf = fit_all(context, match, state.psf, how)
        behind = hidden_by(context, inputs, state, match.expected_px)
        found = judge(context, stars.mag, match, centers, psf, how, behind)
        state = state.replace(centers=centers, psf=psf, found_status=found, star_methods=MappingProxyType({}))
        return state.replace(status=with_verdicts(state, found))
    return _refitted(context, inputs, state, match, rows, how)


def _refitted(
    context: Context, inputs: Inputs, state: SessionState, match: FieldMatch, rows: IntArray, how: StarFit
) -> SessionState:
    """Fit the stars `rows`, and judge them alone; the others keep center and status."""
    stars = predicted(state)
    psf = state.psf or context.camera_psf
    base = state.centers
    fresh = fit_some(context, match, rows, psf, 0.0 if base is None else base.psf_error, how)
    centers = scattered(base, len(stars), rows, fresh)
    judged = judge(
        context, stars.mag, match, centers, psf, how, hidden_by(context, inputs, state, match.expected_px)
    )
    found, status = list(state.found_status), list(state.status)
    for row in rows:
        found[row] = status[row] = judged[row]
    methods = dict(state.star_methods) | {str(stars.id[row]): fresh.method for row in rows}
    methods = {star: method for star, method in methods.items() if method != centers.method}
    state = state.replace(
        centers=centers,
        psf=psf,
        found_status=tuple(found),
        star_methods=MappingProxyType(methods),
    )
    return state.replace(status=with_verdicts(state, status))


def place_star(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Fit a catalog star where the analyst sees it, and accept it."""
    star, place = parameters["id"], (float(parameters["place"][0]), float(parameters["place"][1]))
    if not context.camera.on_detector(np.array(place)):
        raise SessionError(
            f"{star}: pixel {place[0]:.1f}, line {place[1]:.1f} is off the detector; mark a place on it."
        )
    state = _with_star(context, inputs, state, star)
    state = state.replace(placed=MappingProxyType({**state.placed, star: place}))
    match = _match(context, inputs, state)
    rows = _rows(predicted(state), [star])
    how = StarFit("matched_filter", "least_squares", PLACED_RADIUS_PX)
    state = _refitted(context, inputs, state, match, rows, how)
    if state.status[int(rows[0])].status not in MEASURED_STATUSES:
        return state  # nothing is there to be accepted; its status says so
    return decide(state, [star], ACCEPTED, PLACED)


def _with_star(context: Context, inputs: Inputs, state: SessionState, star: str) -> SessionState:
    """Predict a star that is not among the predicted ones: a faint one, or one off the field."""
    stars = predicted(state)
    if star in stars.id.tolist():
        return state
    catalog = all_stars(inputs)
    row = np.flatnonzero(catalog.id == star)
    if len(row) == 0:
        check_known(stars, [star])
    one = predict_stars(
        catalog.take(row[:1]), inputs.et, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000, np.inf
    )  # fmt: skip
    if len(one) == 0:
        raise SessionError(f"star {star} is out of the camera's sight; choose one near the field.")
    status = unsearched(one.on_detector)
    return state.replace(
        a_priori=_joined(stars, one),
        found_status=(*state.found_status, *status),
        status=(*state.status, *status),
    )


def _joined(first: StarPrediction, second: StarPrediction) -> StarPrediction:
    columns = (field.name for field in fields(StarPrediction))
    return StarPrediction(*(np.concatenate([getattr(first, c), getattr(second, c)]) for c in columns))


def _match(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    """Expect the stars where the field is known to be, without identifying it again."""
    settings = context.settings
    radius = settings.search_radius_px if state.pointing is None else settings.refined_radius_px
    expected = predicted(state).places(context.camera, field_attitude(inputs, state))
    match = FieldMatch(state.star_field, None, expected, context.camera.on_detector(expected), radius)
    return with_placed(context, state, match)


def _rows(stars: StarPrediction, ids: list[str] | None) -> IntArray:
    known = stars.id.tolist()
    if ids is None:
        return np.arange(len(known))
    check_known(stars, ids)
    return np.array([known.index(star) for star in dict.fromkeys(ids)], dtype=np.int64)


def refit_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `refit_stars`, for the journal."""
    which = "all stars" if parameters["ids"] is None else f"{len(parameters['ids'])} stars"
    return f"{which} fitted again with {parameters['final']}; {int(state.mask('used').sum())} in use"


def place_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `place_star`, for the journal."""
    row = predicted(state).id.tolist().index(parameters["id"])
    return f"{parameters['id']}: {state.status[row].status}"
