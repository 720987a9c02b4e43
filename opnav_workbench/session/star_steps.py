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
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import IN_PICTURE_ALONE, Inputs
from opnav_workbench.session.pointing import best_attitude
from opnav_workbench.session.star_field import brightest, catalog_stars, deeper_words, identify_field
from opnav_workbench.session.star_measurement import (
    StarFitOptions,
    centers_with_rows,
    fit_all,
    fit_some,
    star_statuses,
    told_apart,
)
from opnav_workbench.session.state import (
    ACCEPTED,
    HEADER_TOPIC,
    MEASURED_STATUSES,
    REJECTED,
    FieldMatch,
    SessionState,
    best_center,
    check_star_ids,
    decide_stars,
    predicted_stars,
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
    "predict_outcome",
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
        body = predict_body(
            inputs.targets[name], inputs.observer, context.camera, best_attitude(inputs, state)
        )
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


# ---- Predict, find, decide.


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
    topics = {HEADER_TOPIC, *(skipped_topic(name) for name in state.skipped_targets)}
    fresh = SessionState(
        a_priori=stars,
        found_status=status,
        decisions=state.decisions,
        targets=state.targets,
        placed=state.placed,
        circles=state.circles,
        assisted=state.assisted,
        scan_choices=state.scan_choices,
        user_notes=state.user_notes,
        skipped_targets=state.skipped_targets,
        notes=MappingProxyType({topic: notes for topic, notes in state.notes.items() if topic in topics}),
    )
    return fresh.replace(status=with_decisions(fresh, status)).with_notes(
        "predict",
        *_no_attitude(inputs),
        *([] if inputs.without_sky else _empty_field(context, inputs, stars)),
    )


def _no_attitude(inputs: Inputs) -> list[str]:
    if inputs.without_sky:
        return [f"the attitude is unknown: no star is predicted, {IN_PICTURE_ALONE}"]
    return [inputs.lost.message] if inputs.lost is not None and inputs.told_by_stars else []


def _empty_field(context: Context, inputs: Inputs, stars: StarPrediction) -> list[str]:
    if stars.on_detector.any():
        return []
    remedy = f"{deeper_words(context, inputs)} or check the pointing and the time"
    return [f"the catalog has no star on the predicted field; {remedy}."]


def find_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find the predicted stars in the picture and fit their centers."""
    predicted_stars(state)
    options = StarFitOptions(parameters["initial"], parameters["final"], 0.0)
    match = identify_field(context, inputs, state)
    options = replace(options, radius_px=parameters["search_radius_px"] or match.radius_px)
    state = state.with_notes("stars", *match.messages).replace(star_methods=MappingProxyType({}))
    if match.stars is not None:
        state = state.replace(a_priori=match.stars)
    match = with_placed_stars(context, state, match)
    if match.found is not None or state.pointing is not None:
        return _with_all_fitted(context, inputs, state.replace(star_field=match.found), match, options)
    # Where the field is not identified, the stars that the analyst placed are measured, if any.
    state, rows = state.replace(centers=None, star_field=None), np.flatnonzero(match.visible)
    if len(rows) == 0:
        return state
    options = replace(options, radius_px=context.settings.search_radius_px)
    state = _with_some_fitted(context, state, match, rows, options)
    return _with_statuses(context, inputs, state, match, options)


def _with_all_fitted(
    context: Context, inputs: Inputs, state: SessionState, match: FieldMatch, options: StarFitOptions
) -> SessionState:
    """Fit all stars of a match, and give each its status."""
    stars = predicted_stars(state)
    sigma = np.sqrt(0.5 * np.trace(stars.covariance_px2, axis1=1, axis2=2))
    sigma = np.where(np.isin(stars.id, list(state.placed)) | ~match.visible, np.inf, sigma)
    centers, psf = fit_all(context, match, state.psf or context.camera_psf, options, sigma)
    centers = told_apart(context, stars.mag, centers, np.arange(len(centers)), psf)
    state = state.replace(centers=centers, psf=psf, star_methods=MappingProxyType({}))
    return _with_statuses(context, inputs, state, match, options)


def _with_some_fitted(
    context: Context, state: SessionState, match: FieldMatch, rows: IntArray, options: StarFitOptions
) -> SessionState:
    """Fit the stars `rows` with the PSF of the others; these keep their centers."""
    stars, base, psf = predicted_stars(state), state.centers, state.psf or context.camera_psf
    fresh = fit_some(context, match, rows, psf, 0.0 if base is None else base.psf_error, options)
    centers = told_apart(context, stars.mag, centers_with_rows(base, len(stars), rows, fresh), rows, psf)
    methods = dict(state.star_methods) | {str(stars.id[row]): fresh.method for row in rows}
    methods = {star: method for star, method in methods.items() if method != centers.method}
    return state.replace(centers=centers, psf=psf, star_methods=MappingProxyType(methods))


def _with_statuses(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    match: FieldMatch,
    options: StarFitOptions,
    rows: IntArray | None = None,
) -> SessionState:
    """Give all stars, or those in `rows`, the status that their centers earn; then the analyst's decisions count."""
    stars = predicted_stars(state)
    assert state.centers is not None
    assert state.psf is not None
    occulting = occulted_by(context, inputs, state, match.expected_px)
    earned = star_statuses(context, stars.mag, match, state.centers, state.psf, options, occulting)
    found, status = list(earned), list(earned)
    if rows is not None:
        found, status = list(state.found_status), list(state.status)
        for row in rows:
            found[row] = status[row] = earned[row]
    state = state.replace(found_status=tuple(found))
    return state.replace(status=with_decisions(state, status))


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


# ---- The analyst at a star: fit it again in another way, or place a star that was not found.

PLACED_RADIUS_PX = 3.0  # a hand marks a star to a pixel or two
PLACED = "placed by the analyst"


def refit_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Fit some stars again, or all, around the places where they are expected now; the field stays as it is."""
    stars = predicted_stars(state)
    if state.centers is None or state.psf is None:
        raise SessionError("no star centers yet: call find_stars() first.")
    rows = _star_rows(stars, parameters["ids"])
    match = _stars_at_field(context, inputs, state)
    template = parameters["template"]
    options = StarFitOptions(
        parameters["initial"],
        parameters["final"],
        parameters["search_radius_px"] or match.radius_px,
        None if template is None else int(_star_rows(stars, [template])[0]),
    )
    if parameters["ids"] is None:
        return _with_all_fitted(context, inputs, state, match, options)
    state = _with_some_fitted(context, state, match, rows, options)
    return _with_statuses(context, inputs, state, match, options, rows)


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
    rows = _star_rows(predicted_stars(state), [star])
    options = StarFitOptions("matched_filter", "least_squares", PLACED_RADIUS_PX)
    state = _with_some_fitted(context, state, match, rows, options)
    state = _with_statuses(context, inputs, state, match, options, rows)
    if state.status[int(rows[0])].status not in MEASURED_STATUSES:
        return state  # nothing is there to be accepted; its status says so
    return decide_stars(state, [star], ACCEPTED, PLACED)


def _with_predicted_star(context: Context, inputs: Inputs, state: SessionState, star: str) -> SessionState:
    """Predict a star that is not among the predicted ones: a faint one, or one off the field."""
    stars = predicted_stars(state)
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
    expected = predicted_stars(state).places(
        context.camera, best_attitude(inputs, state, with_identified=True)
    )
    match = FieldMatch(state.star_field, None, expected, context.camera.on_detector(expected), radius)
    return with_placed_stars(context, state, match)


def _star_rows(stars: StarPrediction, ids: list[str] | None) -> IntArray:
    known = stars.id.tolist()
    if ids is None:
        return np.arange(len(known))
    check_star_ids(stars, ids)
    return np.array([known.index(star) for star in dict.fromkeys(ids)], dtype=np.int64)


def predict_outcome(state: SessionState, _: dict[str, Any]) -> str:
    """One line of what came out of `predict`, for the journal."""
    return f"{len(predicted_stars(state))} stars on or near the detector"


def refit_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `refit_stars`, for the journal."""
    which = "all stars" if parameters["ids"] is None else f"{len(parameters['ids'])} stars"
    return f"{which} fitted again with {parameters['final']}; {int(state.mask('used').sum())} in use"


def place_outcome(state: SessionState, parameters: dict[str, Any]) -> str:
    """One line of what came out of `place_star`, for the journal."""
    row = predicted_stars(state).id.tolist().index(parameters["id"])
    return f"{parameters['id']}: {state.status[row].status}"
