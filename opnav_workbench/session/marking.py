"""Session step: the analyst marks two stars, named or not, and the field follows from them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import apparent_stars, camera_magnitudes
from opnav_workbench.session.context import Context, zero_point_mag
from opnav_workbench.session.identify import MIN_CONFIDENCE, found_field, star_detections, stars_around
from opnav_workbench.session.state import Inputs, SessionState
from opnav_workbench.session.verdicts import unsearched, with_verdicts
from opnav_workbench.starcenters import Identification, identify_marked

__all__ = ["all_stars", "outcome", "two_star_pointing", "unknown_stars"]


def two_star_pointing(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Solve shift and twist of the field from two marked stars; `find_stars` then goes on from there."""
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    catalog = all_stars(inputs)
    answer = _answer(context, inputs, catalog, parameters)
    if parameters["ids"] is None and answer.confidence < MIN_CONFIDENCE:
        raise SessionError(
            f"the two marked stars cannot be told from others of the same separation ({answer.message}); "
            "name them (ids=[...]), or mark two others, bright and far apart."
        )
    found = found_field(inputs, answer, "marked")
    stars = stars_around(context, inputs, catalog, found.camera_from_j2000)
    fresh = state.replace(
        a_priori=stars,
        centers=None,
        pointing=None,
        psf=None,
        star_field=found,
        found_status=unsearched(
            context.camera.on_detector(stars.places(context.camera, found.camera_from_j2000))
        ),
    )
    said = () if found.sure else (f"the field rests on two marked stars: {answer.message}",)
    return fresh.replace(status=with_verdicts(fresh, fresh.found_status)).noting("stars", *said)


def _answer(
    context: Context, inputs: Inputs, catalog: StarTable, parameters: dict[str, Any]
) -> Identification:
    directions = apparent_stars(catalog, inputs.et, inputs.observer)
    mag, _ = camera_magnitudes(catalog, context.camera)
    ids = parameters["ids"]
    if ids is None:
        named = None
    elif missing := unknown_stars(inputs, ids):
        raise SessionError(f"no star {', '.join(missing)} in the catalog around this field.")
    else:
        rows = [int(np.flatnonzero(catalog.id == star)[0]) for star in ids]
        named = (rows[0], rows[1])
    return identify_marked(
        directions @ inputs.a_priori_camera_from_j2000.T,
        mag,
        star_detections(context),
        context.camera,
        parameters["places"],
        named,
        max_shift_px=max(
            shift for shift, _ in [(context.settings.max_shift_px, 0.0), *context.settings.wide_searches]
        ),
        zero_point_mag=zero_point_mag(context),
    )


def all_stars(inputs: Inputs) -> StarTable:
    """Return every catalog row at hand, those near the a priori field first."""
    return StarTable.concatenate([inputs.stars, _further(inputs)])


def _further(inputs: Inputs) -> StarTable:
    """Stars of the wide search that are not among the near ones."""
    if inputs.wide_stars is None:
        return StarTable.empty()
    return inputs.wide_stars.take(~np.isin(inputs.wide_stars.id, inputs.stars.id))


def unknown_stars(inputs: Inputs, ids: Sequence[str]) -> list[str]:
    """Return those of `ids` that no catalog row at hand has."""
    known = set(inputs.stars.id.tolist()) | set(_further(inputs).id.tolist())
    return [star for star in ids if star not in known]


def outcome(state: SessionState) -> str:
    """One line of what came out, for the journal."""
    found = state.star_field
    assert found is not None
    shift = f"({found.shift_px[0]:+.1f}, {found.shift_px[1]:+.1f}) px"
    return f"field moved by {shift}, turned by {np.degrees(found.twist_rad):+.2f} deg; confidence {found.confidence:.3f}"
