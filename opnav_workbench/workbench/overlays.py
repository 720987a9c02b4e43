"""What is drawn over the picture, as plain tables from a session: nothing here knows of bokeh or a page.

Flow   session state -> places in px (pixel, line) -> columns that `view_models` gives to the figure

Stars      predicted, used, rejected, missing; residual vectors, observed minus predicted
Bodies     limb where predicted and where observed, terminator, pole, name
Masks      runs of bad or saturated pixels along lines, as rectangles with edges at half pixels
Sky grid   lines of right ascension and declination with labels, both in degrees, minutes and seconds of arc
"""

from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, pixel_runs
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import apparent_direction, radec_from_unit, terminator_points, unit_from_radec
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.session import ImageSession, SessionState
from opnav_workbench.session.pointing import best_attitude
from opnav_workbench.targets import TargetState

__all__ = [
    "Columns",
    "SkyGrid",
    "body_marks",
    "expected_attitude",
    "expected_camera",
    "expected_directions",
    "expected_places",
    "look_alike",
    "mask_runs",
    "predicted_body",
    "sky_grid",
    "star_facts",
    "star_marks",
]


# ---- What of a session is seen.

# Of a session's state, what a picture does not show: a star is drawn by whether it is in use, not by who said so.
NOT_DRAWN = frozenset({"decisions", "notes", "user_notes"})


def look_alike(one: SessionState | None, other: SessionState) -> bool:
    """Whether a picture shows the same of two states of a session: most steps put in a few new parts."""
    if one is None:
        return False
    drawn = (field.name for field in fields(other) if field.name not in NOT_DRAWN | {"status"})
    same = all(getattr(one, name) is getattr(other, name) for name in drawn)
    return same and one.status == other.status


# ---- Stars over the picture: predicted, used, rejected, missing; and residual vectors.

Columns: TypeAlias = dict[str, Any]
LABELED_STARS = 40  # magnitudes of the brightest; with more of them nobody can read any
# Residual vectors are drawn so that the longest is this share of the picture's smaller side.
LONGEST_VECTOR = 0.06


@dataclass(frozen=True, slots=True)
class StarMarks:
    """Marks of stars; each entry holds columns of equal length."""

    predicted: Columns  # pixel, line: all on the detector
    labels: Columns  # pixel, line, text: the brightest
    missing: Columns  # pixel, line
    used: Columns  # pixel, line, id: fitted and in use
    rejected: Columns  # pixel, line, id: fitted, not in use
    vectors: Columns  # pixel, line, d_pixel, d_line: observed minus predicted, of those in use


def expected_attitude(session: ImageSession) -> FloatArray:
    """Return the attitude (3, 3) with which things are expected: solved, else that of the field found, else a priori."""
    return best_attitude(session.inputs, session.state, with_identified=True)


def expected_camera(session: ImageSession) -> Camera:
    """Return the camera as it stands at `expected_attitude`."""
    return session.context.camera.standing(expected_attitude(session))


def expected_places(session: ImageSession, directions: FloatArray) -> FloatArray:
    """Return where apparent J2000 directions (n, 3) are expected in the picture (n, 2), px; nan out of sight."""
    return expected_camera(session).project(directions @ expected_attitude(session).T)


def expected_directions(session: ImageSession, pixel_line: FloatArray) -> FloatArray:
    """Return the apparent J2000 directions (n, 3) that are expected at places (n, 2) of the picture."""
    return expected_camera(session).unproject(pixel_line) @ expected_attitude(session)


def star_marks(session: ImageSession) -> StarMarks:
    """Return the stars' marks where they are expected; none is missing before any was looked for."""
    stars, state = session.state.a_priori, session.state
    if stars is None:
        empty = _place_columns(np.empty((0, 2)))
        nothing = empty | {"id": []}
        none = empty | {"d_pixel": np.empty(0), "d_line": np.empty(0)}
        return StarMarks(empty, empty | {"text": []}, empty, nothing, nothing, none)
    camera = session.context.camera
    places = stars.places(camera, expected_attitude(session))
    on = camera.on_detector(places)
    status = np.array([s.status for s in state.status]) if state.status else np.full(len(stars), "")
    observed = np.full_like(places, np.nan) if state.centers is None else state.centers.pixel_line
    fitted = np.isfinite(observed).all(axis=1)
    used = fitted & (status == "used")
    rejected = fitted & np.isin(status, ("rejected", "saturated", "blended"))
    missing = on & (status == "not_detected") & (state.centers is not None)
    residual = observed[used] - places[used]
    return StarMarks(
        predicted=_place_columns(places[on]),
        labels=_magnitude_labels(places[on], stars.mag[on]),
        missing=_place_columns(places[missing]),
        used=_place_columns(observed[used]) | {"id": stars.id[used].tolist()},
        rejected=_place_columns(observed[rejected]) | {"id": stars.id[rejected].tolist()},
        vectors=_place_columns(places[used]) | {"d_pixel": residual[:, 0], "d_line": residual[:, 1]},
    )


def star_facts(session: ImageSession) -> Columns:
    """Return what is told of a star under the cursor: id, magnitude, SNR, O-C (px) from where it is expected.

    SNR and O-C are nan where no center was fitted.
    """
    stars, centers = session.state.a_priori, session.state.centers
    if stars is None:
        none = np.empty(0)
        facts = dict.fromkeys(("mag", "snr", "d_pixel", "d_line"), none)
        return _place_columns(np.empty((0, 2))) | {"id": []} | facts
    expected = stars.places(session.context.camera, expected_attitude(session))
    on = np.flatnonzero(session.context.camera.on_detector(expected))
    seen, snr = np.full_like(expected, np.nan), np.full(len(stars), np.nan)
    if centers is not None:
        seen, snr = centers.pixel_line, np.asarray(centers.snr, float)
    off = (seen - expected)[on]
    return _place_columns(np.where(np.isfinite(seen), seen, expected)[on]) | {
        "id": stars.id[on].tolist(),
        "mag": stars.mag[on],
        "snr": snr[on],
        "d_pixel": np.ascontiguousarray(off[:, 0]),
        "d_line": np.ascontiguousarray(off[:, 1]),
    }


def _place_columns(places: FloatArray) -> Columns:
    return {"pixel": np.ascontiguousarray(places[:, 0]), "line": np.ascontiguousarray(places[:, 1])}


def _magnitude_labels(places: FloatArray, mag: FloatArray) -> Columns:
    brightest = np.argsort(mag)[:LABELED_STARS]
    return _place_columns(places[brightest]) | {"text": [f"{m:.1f}" for m in mag[brightest]]}


# ---- Masks as runs of pixels, so that a few bad columns do not cost a picture.

MOST_RUNS = 20_000  # more are drawn coarser, in blocks of pixels; nobody sees single ones then


def mask_runs(mask: BoolArray) -> Columns:
    """Return runs of marked pixels along lines, as rectangles: left, right, top, bottom, in px with edges at halves.

    Examples
    --------
    >>> mask_runs(np.array([[False, True, True, False], [True, False, False, True]]))["left"]
    array([ 0.5, -0.5,  2.5])
    """
    block = 1
    while True:
        coarse = _coarse(mask, block)
        line, first, past = pixel_runs(coarse)
        if len(line) <= MOST_RUNS:
            break
        block *= 2
    n_line, n_pixel = mask.shape
    return {
        "left": block * first - 0.5,
        "right": np.minimum(block * past, n_pixel) - 0.5,
        "top": block * line - 0.5,
        "bottom": np.minimum(block * (line + 1), n_line) - 0.5,
    }


def _coarse(mask: BoolArray, block: int) -> BoolArray:
    if block == 1:
        return mask
    padded = np.pad(mask, [(0, -size % block) for size in mask.shape])
    shape = (padded.shape[0] // block, block, padded.shape[1] // block, block)
    return np.asarray(padded.reshape(shape).any(axis=(1, 3)))


# ---- Bodies over the picture: limb where predicted and where observed, terminator, pole, name.

POLE_BEYOND = 1.25  # the pole's line runs from the center to this many polar radii
MIN_DRAWN_PX = 3.0  # a smaller limb is a dot; its cross tells more


@dataclass(frozen=True, slots=True)
class BodyMarks:
    """Marks of one target; lines are (n, 2) arrays of (pixel, line), empty where there is nothing to draw.

    Attributes
    ----------
    center_px : (2,) array
        Observed center where there is one, else predicted.
    radius_px
        Half the predicted diameter; 0 for a star.
    predicted_limb_px, limb_px, terminator_px, pole_px : (n, 2) arrays
        The last three about `center_px`.
    """

    name: str
    center_px: FloatArray
    radius_px: float
    observed: bool
    predicted_limb_px: FloatArray
    limb_px: FloatArray
    terminator_px: FloatArray
    pole_px: FloatArray

    def as_page_values(self) -> dict[str, Any]:
        """Return what the readout needs."""
        return {
            "name": self.name,
            "pixel": float(self.center_px[0]),
            "line": float(self.center_px[1]),
            "radius_px": self.radius_px,
        }


def predicted_body(session: ImageSession, target: TargetState) -> BodyPrediction:
    """Return where a target is predicted with the best known pointing."""
    return predict_body(target, session.inputs.observer, session.context.camera, session.camera_from_j2000)


def body_marks(session: ImageSession) -> list[BodyMarks]:
    """Return the marks of every target in sight of the camera where it is expected, the largest first."""
    measured = {b.name: b.pixel_line for b in session.state.bodies if b.pixel_line is not None}
    expected, marks = expected_attitude(session), []
    # What an analyst described stands where he put it: with the attitude that his words were taken with.
    put_with = best_attitude(session.inputs, session.state) if session.state.assisted else expected
    for name, target in session.inputs.targets.items():
        attitude = put_with if name in session.state.assisted else expected
        seen = predict_body(target, session.inputs.observer, session.context.camera, attitude)
        if np.isfinite(seen.pixel_line).all():
            marks.append(_marks_of_body(session, target, seen, measured.get(name), attitude))
    return sorted(marks, key=lambda mark: -mark.radius_px)


def _marks_of_body(
    session: ImageSession,
    target: TargetState,
    seen: BodyPrediction,
    observed: FloatArray | None,
    attitude: FloatArray,
) -> BodyMarks:
    moved = np.zeros(2) if observed is None else observed - seen.pixel_line
    radius = 0.5 * seen.diameter_px if np.isfinite(seen.diameter_px) else 0.0
    drawn = seen.limb_px if 2.0 * radius >= MIN_DRAWN_PX else np.empty((0, 2))
    closed = np.vstack([drawn, drawn[:1]])  # of a dot: nothing
    nothing = np.empty((0, 2))
    lines = [
        closed,
        *(_terminator_and_pole(session, target, attitude) if len(drawn) else (nothing, nothing)),
    ]
    return BodyMarks(
        target.name,
        seen.pixel_line + moved,
        float(radius),
        observed is not None,
        closed,
        *(line + moved for line in (lines if observed is not None else [nothing, *lines[1:]])),
    )


def _terminator_and_pole(
    session: ImageSession, target: TargetState, attitude: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Terminator and pole, px, about the predicted center."""
    assert target.radii_km is not None
    j2000_from_body = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000.T
    terminator = np.empty((0, 3))
    if target.sun_position_km is not None:
        terminator = terminator_points(
            target.position_km, target.radii_km, j2000_from_body, target.sun_position_km
        )
    pole = np.empty((0, 3))
    if target.body_from_j2000 is not None:
        along = POLE_BEYOND * target.radii_km[2] * j2000_from_body[:, 2]
        pole = np.stack([target.position_km, target.position_km + along])
        pole /= np.linalg.norm(pole, axis=1, keepdims=True)
    return _projected(session, terminator, attitude), _projected(session, pole, attitude)


def _projected(session: ImageSession, directions: FloatArray, attitude: FloatArray) -> FloatArray:
    if len(directions) == 0:
        return np.empty((0, 2))
    apparent = apparent_direction(directions, session.inputs.observer.velocity_km_s)
    return session.context.camera.standing(attitude).project(apparent @ attitude.T)


# ---- Lines of right ascension and declination over the picture, with labels.

# Steps that people read, deg: whole degrees, minutes and seconds of arc.
STEPS_DEG = np.array(
    [
        30,
        20,
        10,
        5,
        2,
        1,
        0.5,
        1 / 3,
        1 / 6,
        1 / 12,
        1 / 30,
        1 / 60,
        1 / 120,
        1 / 180,
        1 / 360,
        1 / 720,
        1 / 3600,
    ]
)
LINES_WANTED = 4.0  # across the picture's longer side, at least
POINTS_PER_LINE = 64  # points along a line
LABEL_ROOM = (0.06, 0.86)  # shares of the picture where a label begins, so that none is cut by the edge
NEAR_POLE_DEG = 85.0  # beyond it lines of RA crowd together


@dataclass(frozen=True, slots=True)
class SkyGrid:
    """Grid lines, each (n, 2) px; labels, and where each stands (pixel, line)."""

    lines_px: list[FloatArray]
    labels: list[str]
    places_px: list[FloatArray]


def sky_grid(camera: Camera, camera_from_j2000: FloatArray) -> SkyGrid:
    """Return the grid of a picture at an attitude."""
    ra, dec = _outline_deg(camera, camera_from_j2000)
    center = 0.5 * (dec.min() + dec.max())
    extent = dec.max() - dec.min()
    step = _grid_step(max(extent, 1e-6))
    grid = SkyGrid([], [], [])
    for value in _multiples(dec.min(), dec.max(), step):
        around = np.linspace(ra.min(), ra.max(), POINTS_PER_LINE)
        _add_grid_line(
            grid, camera, camera_from_j2000, around, np.full(POINTS_PER_LINE, value), _dec_text(value, step)
        )
    if abs(center) < NEAR_POLE_DEG:
        step_ra = _grid_step(extent / np.cos(np.radians(center)))
        for value in _multiples(ra.min(), ra.max(), step_ra):
            along = np.linspace(dec.min(), dec.max(), POINTS_PER_LINE)
            _add_grid_line(
                grid,
                camera,
                camera_from_j2000,
                np.full(POINTS_PER_LINE, value),
                along,
                _ra_text(value % 360.0, step_ra),
            )
    return grid


def _outline_deg(camera: Camera, camera_from_j2000: FloatArray) -> tuple[FloatArray, FloatArray]:
    """RA and Dec over all of the detector that sees the sky, deg; RA continuous across 0."""
    axes = [np.linspace(-0.5, n - 0.5, 17) for n in (camera.n_pixel, camera.n_line)]
    seen = camera.unproject(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2))
    ra, dec = radec_from_unit(seen[np.isfinite(seen).all(axis=1)] @ camera_from_j2000)
    middle = ra[len(ra) // 2]
    return np.degrees(middle + (ra - middle + np.pi) % (2.0 * np.pi) - np.pi), np.degrees(dec)


def _grid_step(extent_deg: float) -> float:
    fine = STEPS_DEG[extent_deg / LINES_WANTED * 1.0001 >= STEPS_DEG]
    return float(fine[0] if len(fine) else STEPS_DEG[-1])


def _multiples(low: float, high: float, step: float) -> FloatArray:
    return step * np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)


def _add_grid_line(
    grid: SkyGrid, camera: Camera, attitude: FloatArray, ra_deg: FloatArray, dec_deg: FloatArray, text: str
) -> None:
    places = camera.project(unit_from_radec(np.radians(ra_deg), np.radians(dec_deg)) @ attitude.T)
    on = camera.on_detector(places)
    if on.sum() < 2:
        return
    grid.lines_px.append(
        np.where(on[:, None] | np.roll(on, 1)[:, None] | np.roll(on, -1)[:, None], places, np.nan)
    )
    size = np.array([camera.n_pixel, camera.n_line])
    room = np.flatnonzero(((places > LABEL_ROOM[0] * size) & (places < LABEL_ROOM[1] * size)).all(axis=1))
    if len(room):
        grid.labels.append(text)
        grid.places_px.append(places[room[len(room) // 12]])


def _dec_text(value: float, step: float) -> str:
    sign = "−" if value < -1e-9 else "+"
    return sign + _sexagesimal(abs(value), step, "°", "′", "″")


def _ra_text(value: float, step: float) -> str:
    return _sexagesimal(value, step, "°", "′", "″")


def _sexagesimal(value: float, step: float, unit: str, minute: str, second: str) -> str:
    seconds = round(value * 3600.0)
    whole, minutes, rest = seconds // 3600, seconds // 60 % 60, seconds % 60
    if step >= 1.0:
        return f"{whole}{unit}"
    if step >= 1.0 / 60.0:
        return f"{whole}{unit}{minutes:02d}{minute}"
    return f"{whole}{unit}{minutes:02d}{minute}{rest:02d}{second}"
