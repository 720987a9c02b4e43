"""Session steps with stars: predict, find, fit again, place, accept, reject.

Pure functions: (context, inputs, state, parameters) -> state.  Stars behind a body of the scene are told from those that
are too faint once the pointing is solved.
"""

from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction, predict_body, predict_stars
from opnav_workbench.session.body_models import best_center
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.pointing import attitude, field_attitude
from opnav_workbench.session.star_field import brightest, catalog_stars, identify_field
from opnav_workbench.session.star_measurement import (
    StarFitOptions,
    centers_with_rows,
    fit_all,
    fit_some,
    star_statuses,
)
from opnav_workbench.session.state import (
    ACCEPTED,
    MEASURED_STATUSES,
    REJECTED,
    FieldMatch,
    SessionState,
    check_star_ids,
    decide_stars,
    skipped_topic,
    unsearched_statuses,
    with_decisions,
)

__all__ = [
    "accept_stars",
    "find_stars",
    "place_outcome",
    "place_star",
    "predict",
    "predicted",
    "refit_outcome",
    "refit_stars",
    "reject_stars",
]


# ---- Which stars stand behind a body of the scene.


def occulted_by(
    context: Context, inputs: Inputs, state: SessionState, places_px: FloatArray
) -> tuple[str, ...]:
    """Return for each place (n, 2), px, the name of the body before it; empty where there is none.

    Bodies stand where they were found, else where they are predicted; before the pointing is solved nobody knows.
    """
    names = [""] * len(places_px)
    if state.pointing is None:
        return tuple(names)
    for name in state.targets:
        body = predict_body(inputs.targets[name], inputs.observer, context.camera, attitude(inputs, state))
        if len(body.limb_px) == 0 or not np.isfinite(body.limb_px).all():
            continue
        found = best_center(state, name)
        moved = np.zeros(2)
        if found is not None and found.pixel_line is not None:
            moved = found.pixel_line - body.pixel_line
        for row in np.flatnonzero(_inside_outline(places_px, body.limb_px + moved)):
            names[row] = name
    return tuple(names)


def _inside_outline(points: FloatArray, outline: FloatArray) -> BoolArray:
    """Tell which points (n, 2) lie within a convex outline (k, 2)."""
    edge = np.roll(outline, -1, axis=0) - outline
    offset = points[:, None] - outline
    side = edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0]
    with np.errstate(invalid="ignore"):
        return np.asarray((side > 0.0).all(axis=1) | (side < 0.0).all(axis=1))


# ---- Session steps that concern stars: predict, find, decide. Pure: (context, inputs, state, parameters) -> ...


def predict(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Predict stars with the a priori pointing; whatever was found before is dropped."""
    margin = context.settings.max_shift_px
    stars = predict_stars(
        inputs.stars, inputs.et, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000, margin
    )
    stars = brightest(stars, context.settings.max_stars)
    status = unsearched_statuses(stars.on_detector)
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
    return fresh.replace(status=with_decisions(fresh, status)).noting("predict", *_empty_field(stars))


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
    how = StarFitOptions(parameters["initial"], parameters["final"], 0.0)
    match = identify_field(context, inputs, state)
    how = StarFitOptions(how.initial, how.final, parameters["search_radius_px"] or match.radius_px)
    state = state.noting("stars", *match.messages).replace(star_methods=MappingProxyType({}))
    if match.stars is not None:
        state = state.replace(a_priori=match.stars)
    if match.found is None and state.pointing is None:
        return _placed_stars_only(context, state.replace(centers=None, star_field=None), match, how)
    match = with_placed_stars(context, state, match)
    centers, psf = fit_all(context, match, state.psf or context.camera_psf, how)
    behind = occulted_by(context, inputs, state, match.expected_px)
    found = star_statuses(context, predicted(state).mag, match, centers, psf, how, behind)
    state = state.replace(centers=centers, psf=psf, found_status=found, star_field=match.found)
    return state.replace(status=with_decisions(state, found))


def _placed_stars_only(
    context: Context, state: SessionState, match: FieldMatch, how: StarFitOptions
) -> SessionState:
    """Where the field is not identified, measure the stars that the analyst placed, if any."""
    match = with_placed_stars(context, state, match)
    rows = np.flatnonzero(match.visible)
    if len(rows) == 0:
        return state
    psf = state.psf or context.camera_psf
    how = StarFitOptions(how.initial, how.final, context.settings.search_radius_px)
    stars = predicted(state)
    centers = centers_with_rows(None, len(stars), rows, fit_some(context, match, rows, psf, 0.0, how))
    found = star_statuses(context, stars.mag, match, centers, psf, how, [""] * len(stars))
    state = state.replace(centers=centers, psf=psf, found_status=found)
    return state.replace(status=with_decisions(state, found))


def with_placed_stars(context: Context, state: SessionState, match: FieldMatch) -> FieldMatch:
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
    return decide_stars(state, parameters["ids"], REJECTED, parameters["reason"])


def accept_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record the analyst's acceptance of stars, which outranks an automatic rejection."""
    return decide_stars(state, parameters["ids"], ACCEPTED, parameters["reason"])


# ---- Session steps of the analyst at a star: fit it again in another way, or place a star that was not found.

PLACED_RADIUS_PX = 3.0  # a hand marks a star to a pixel or two
PLACED = "placed by the analyst"


def refit_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Fit some stars again, or all, around the places where they are expected now; the field stays as it is."""
    stars = predicted(state)
    if state.centers is None or state.psf is None:
        raise SessionError("no star centers yet: call find_stars() first.")
    rows = _star_rows(stars, parameters["ids"])
    match = _stars_at_field(context, inputs, state)
    how = StarFitOptions(
        parameters["initial"],
        parameters["final"],
        parameters["search_radius_px"] or match.radius_px,
        None if parameters["template"] is None else int(_star_rows(stars, [parameters["template"]])[0]),
    )
    if parameters["ids"] is None:
        centers, psf = fit_all(context, match, state.psf, how)
        behind = occulted_by(context, inputs, state, match.expected_px)
        found = star_statuses(context, stars.mag, match, centers, psf, how, behind)
        state = state.replace(centers=centers, psf=psf, found_status=found, star_methods=MappingProxyType({}))
        return state.replace(status=with_decisions(state, found))
    return _refitted(context, inputs, state, match, rows, how)


def _refitted(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    match: FieldMatch,
    rows: IntArray,
    how: StarFitOptions,
) -> SessionState:
    """Fit the stars `rows`, and judge them alone; the others keep center and status."""
    stars = predicted(state)
    psf = state.psf or context.camera_psf
    base = state.centers
    fresh = fit_some(context, match, rows, psf, 0.0 if base is None else base.psf_error, how)
    centers = centers_with_rows(base, len(stars), rows, fresh)
    judged = star_statuses(
        context, stars.mag, match, centers, psf, how, occulted_by(context, inputs, state, match.expected_px)
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
    return state.replace(status=with_decisions(state, status))


def place_star(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Fit a catalog star where the analyst sees it, and accept it."""
    star, place = parameters["id"], (float(parameters["place"][0]), float(parameters["place"][1]))
    if not context.camera.on_detector(np.array(place)):
        raise SessionError(
            f"{star}: pixel {place[0]:.1f}, line {place[1]:.1f} is off the detector; mark a place on it."
        )
    state = _with_predicted_star(context, inputs, state, star)
    state = state.replace(placed=MappingProxyType({**state.placed, star: place}))
    match = _stars_at_field(context, inputs, state)
    rows = _star_rows(predicted(state), [star])
    how = StarFitOptions("matched_filter", "least_squares", PLACED_RADIUS_PX)
    state = _refitted(context, inputs, state, match, rows, how)
    if state.status[int(rows[0])].status not in MEASURED_STATUSES:
        return state  # nothing is there to be accepted; its status says so
    return decide_stars(state, [star], ACCEPTED, PLACED)


def _with_predicted_star(context: Context, inputs: Inputs, state: SessionState, star: str) -> SessionState:
    """Predict a star that is not among the predicted ones: a faint one, or one off the field."""
    stars = predicted(state)
    if star in stars.id.tolist():
        return state
    catalog = catalog_stars(inputs)
    row = np.flatnonzero(catalog.id == star)
    if len(row) == 0:
        check_star_ids(stars, [star])
    one = predict_stars(
        catalog.take(row[:1]), inputs.et, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000, np.inf
    )  # fmt: skip
    if len(one) == 0:
        raise SessionError(f"star {star} is out of the camera's sight; choose one near the field.")
    status = unsearched_statuses(one.on_detector)
    return state.replace(
        a_priori=_joined_predictions(stars, one),
        found_status=(*state.found_status, *status),
        status=(*state.status, *status),
    )


def _joined_predictions(first: StarPrediction, second: StarPrediction) -> StarPrediction:
    columns = (field.name for field in fields(StarPrediction))
    return StarPrediction(*(np.concatenate([getattr(first, c), getattr(second, c)]) for c in columns))


def _stars_at_field(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    """Expect the stars where the field is known to be, without identifying it again."""
    settings = context.settings
    radius = settings.search_radius_px if state.pointing is None else settings.refined_radius_px
    expected = predicted(state).places(context.camera, field_attitude(inputs, state))
    match = FieldMatch(state.star_field, None, expected, context.camera.on_detector(expected), radius)
    return with_placed_stars(context, state, match)


def _star_rows(stars: StarPrediction, ids: list[str] | None) -> IntArray:
    known = stars.id.tolist()
    if ids is None:
        return np.arange(len(known))
    check_star_ids(stars, ids)
    return np.array([known.index(star) for star in dict.fromkeys(ids)], dtype=np.int64)


def refit_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `refit_stars`, for the journal."""
    which = "all stars" if parameters["ids"] is None else f"{len(parameters['ids'])} stars"
    return f"{which} fitted again with {parameters['final']}; {int(state.mask('used').sum())} in use"


def place_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `place_star`, for the journal."""
    row = predicted(state).id.tolist().index(parameters["id"])
    return f"{parameters['id']}: {state.status[row].status}"
