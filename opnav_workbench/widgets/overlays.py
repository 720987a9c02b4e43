"""What is drawn over the picture, as plain tables from a session: nothing here knows of bokeh or a page.

Flow   session state -> places in px (pixel, line) -> columns that `overlay_models` gives to the figure
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.session import ImageSession

__all__ = ["LABELED_STARS", "Columns", "StarMarks", "star_marks", "vector_columns"]

Columns: TypeAlias = dict[str, Any]
LABELED_STARS = 40  # magnitudes of the brightest; with more of them nobody can read any
# Residual vectors are drawn so that the longest is this share of the picture's smaller side.
LONGEST_VECTOR = 0.06


@dataclass(frozen=True, slots=True)
class StarMarks:
    """Marks of stars; each entry holds columns of equal length."""

    predicted: Columns  # pixel, line, id, mag: all on the detector
    labels: Columns  # pixel, line, text: the brightest
    missing: Columns  # pixel, line, id
    used: Columns  # pixel, line, id: fitted and in use
    rejected: Columns  # pixel, line, id: fitted, not in use
    vectors: Columns  # pixel, line, d_pixel, d_line: observed minus predicted, of those in use


def star_marks(session: ImageSession) -> StarMarks:
    """Return the stars' marks with the best known pointing."""
    stars, state = session.state.a_priori, session.state
    if stars is None:
        empty = _columns(np.empty((0, 2)))
        nothing = empty | {"id": []}
        none = empty | {"d_pixel": np.empty(0), "d_line": np.empty(0)}
        return StarMarks(nothing | {"mag": []}, empty | {"text": []}, nothing, nothing, nothing, none)
    camera = session.context.camera
    places = stars.places(camera, session.camera_from_j2000)
    on = camera.on_detector(places)
    status = np.array([s.status for s in state.status]) if state.status else np.full(len(stars), "")
    observed = np.full_like(places, np.nan) if state.centers is None else state.centers.pixel_line
    fitted = np.isfinite(observed).all(axis=1)
    used = fitted & (status == "used")
    rejected = fitted & np.isin(status, ("rejected", "saturated", "blended"))
    missing = on & (status == "not_detected")
    residual = observed[used] - places[used]
    return StarMarks(
        predicted=_columns(places[on]) | {"id": stars.id[on].tolist(), "mag": stars.mag[on].tolist()},
        labels=_labels(places[on], stars.mag[on]),
        missing=_columns(places[missing]) | {"id": stars.id[missing].tolist()},
        used=_columns(observed[used]) | {"id": stars.id[used].tolist()},
        rejected=_columns(observed[rejected]) | {"id": stars.id[rejected].tolist()},
        vectors=_columns(places[used]) | {"d_pixel": residual[:, 0], "d_line": residual[:, 1]},
    )


def _columns(places: FloatArray) -> Columns:
    return {"pixel": np.ascontiguousarray(places[:, 0]), "line": np.ascontiguousarray(places[:, 1])}


def _labels(places: FloatArray, mag: FloatArray) -> Columns:
    brightest = np.argsort(mag)[:LABELED_STARS]
    return _columns(places[brightest]) | {"text": [f"{m:.1f}" for m in mag[brightest]]}


def vector_columns(vectors: Columns, scale: float) -> Columns:
    """Return start and end of residual vectors drawn `scale` times as long as they are.

    Examples
    --------
    >>> ends = vector_columns({"pixel": np.r_[5.0], "line": np.r_[2.0], "d_pixel": np.r_[0.1], "d_line": np.r_[0.0]}, 50)
    >>> float(ends["end_pixel"][0]), float(ends["end_line"][0])
    (10.0, 2.0)
    """
    ends = {"end_pixel": vectors["pixel"] + scale * vectors["d_pixel"]}
    return {
        "pixel": vectors["pixel"],
        "line": vectors["line"],
        **ends,
        "end_line": vectors["line"] + scale * vectors["d_line"],
    }
