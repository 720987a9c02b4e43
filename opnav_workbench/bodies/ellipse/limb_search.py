"""Where a limb fit starts: the limb found along the outline's normals, and the outline moved there.

Flow   expected place (or, where no limb is seen from there, that of the correlation) -> outline -> brightness along its
       normals -> lag with the most of the model's rise in it -> motion of the outline -> horizon fit (ellipsoids)
Frame  (pixel, line); lags are positive outward
Units  px, DN

A limb point is where the picture rises from the dark of the sky as the rendered limb does. What a crater, a star or a cosmic
ray offers instead is left to the fit of the outline, whose weights fall off with the residual (Cauchy) as the width
that counts as near is narrowed.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.ellipse.limb_points import LimbPieces, limb_pieces, limb_reach_px
from opnav_workbench.bodies.ellipse.point_fits import horizon_position
from opnav_workbench.bodies.picture import BodyPicture, Circle, model_picture
from opnav_workbench.bodies.place_search import CorrelationPeak, search_place
from opnav_workbench.bodies.results import BodyFlag
from opnav_workbench.bodies.silhouette import Outline, Silhouette
from opnav_workbench.bodies.subarray import choose_subarray, search_radius
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, geometric_direction

__all__ = [
    "FitStart",
    "StartError",
    "find_start",
    "limb_lags",
    "limb_template",
    "model_window",
    "saturated_share",
]


# ---- Where the limb is, roughly.

STEP_PX = 0.5
MIN_RISE = 0.05  # of the model's highest rise: less is unlit limb
SIGNIFICANT_SIGMAS = 5.0
SKY_SHARE = 0.4  # of the rise: brighter is no sky, nor the halo of a fouled lens
NARROWINGS = 7  # times that the width which counts as near is halved
NEAREST_PX = 0.5
FEWEST_LAGS = 5


@dataclass(frozen=True, slots=True, eq=False)
class LimbTemplate:
    """The rendered brightness across each piece of limb: (n, k) at `STEP_PX` from inside to outside."""

    model_dn: FloatArray
    lit: BoolArray  # (n,)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def at(self, own_angle_rad: FloatArray, angle_rad: FloatArray) -> "LimbTemplate":
        """Return the template for pieces at other angles (m,): of each the nearest of its own."""
        apart = np.abs(np.angle(np.exp(1j * (angle_rad[:, None] - own_angle_rad[None, :]))))
        nearest = np.argmin(apart, axis=1)
        return LimbTemplate(self.model_dn[nearest], self.lit[nearest])


@dataclass(frozen=True, slots=True, eq=False)
class LimbLags:
    """Where each of n normals crosses the limb; nan where nothing like it was found."""

    lag_px: FloatArray
    rise: FloatArray  # data over model

    def __post_init__(self) -> None:
        freeze_arrays(self)


def limb_template(
    pieces: LimbPieces, model_dn: FloatArray, window: tuple[int, int, int, int], reach: float
) -> LimbTemplate:
    """Sample a rendered body across its limb."""
    k = int(np.ceil(reach / STEP_PX))
    profile = _sampled(model_dn, pieces, STEP_PX * np.arange(-k, k + 1, dtype=np.float64), window)
    rise = np.nan_to_num(np.ptp(profile, axis=1))  # nan: off the detector
    return LimbTemplate(profile, rise > MIN_RISE * max(float(rise.max()), np.finfo(float).tiny))


def limb_lags(picture: BodyPicture, pieces: LimbPieces, template: LimbTemplate, search_px: float) -> LimbLags:
    """Look for the limb within `search_px` of where the pieces expect it.

    Parameters
    ----------
    template
        Of the same pieces; its lit ones are looked for.
    """
    k = template.model_dn.shape[1] // 2
    m = int(np.ceil(search_px / STEP_PX))
    rows = np.flatnonzero(template.lit)
    lag, rise = np.full(len(pieces), np.nan), np.full(len(pieces), np.nan)
    if len(rows) == 0:
        return LimbLags(lag, rise)
    unusable = picture.bad | ~np.isfinite(picture.signal_dn)
    at = STEP_PX * np.arange(-m - k, m + k + 1, dtype=np.float64)
    size = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    signal = _sampled(np.where(unusable, 0.0, picture.signal_dn), pieces, at, size, rows)
    if unusable.any():
        signal[_sampled(unusable.astype(float), pieces, at, size, rows) > 0.0] = np.nan
    noise = _sampled(np.asarray(picture.noise_dn), pieces, np.zeros(1), size, rows)[:, 0]
    windows = np.lib.stride_tricks.sliding_window_view(signal, 2 * k + 1, axis=1)
    explained, height, outside = _regression(windows, template.model_dn[rows])
    rise_dn = np.ptp(template.model_dn[rows], axis=1)[:, None] * height
    seen = (height > 0.0) & (explained > SIGNIFICANT_SIGMAS**2 * (STEP_PX**-1.0) * noise[:, None] ** 2)
    seen &= outside < SKY_SHARE * rise_dn + SIGNIFICANT_SIGMAS * noise[:, None]
    score = np.where(seen, explained, -np.inf)
    best = np.argmax(score, axis=1)
    found = np.isfinite(score[np.arange(len(rows)), best])
    chosen = rows[found]
    lag[chosen] = (best[found] - m) * STEP_PX + _between(score, best)[found] * STEP_PX
    rise[chosen] = height[np.arange(len(rows)), best][found]
    return LimbLags(lag, rise)


def _sampled(
    values: FloatArray,
    pieces: LimbPieces,
    at_px: FloatArray,
    window: tuple[int, int, int, int],
    rows: IntArray | None = None,
) -> FloatArray:
    """Return values (n, k) along the normals; nan off the window."""
    point, normal = pieces.point_px, pieces.normal
    if rows is not None:
        point, normal = point[rows], normal[rows]
    places = point[:, None, :] + at_px[None, :, None] * normal[:, None, :] - np.array(window[:2])
    return np.asarray(
        map_coordinates(values, [places[..., 1], places[..., 0]], order=1, mode="constant", cval=np.nan)
    )


def _regression(windows: FloatArray, model: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the model explains, its height, and the data's level outside, each (n, lags)."""
    centered = model - np.nanmean(model, axis=1, keepdims=True)
    centered = np.nan_to_num(centered)
    square = np.einsum("nk,nk->n", centered, centered)[:, None]
    with np.errstate(invalid="ignore"):
        product = np.einsum("nlk,nk->nl", windows, centered)
        height = product / square
        outer = windows[..., -(model.shape[1] // 4 + 1) :].mean(axis=-1)
    lost = ~np.isfinite(product)
    return (
        np.where(lost, -np.inf, product * np.where(lost, 0.0, height)),
        np.where(lost, 0.0, height),
        np.where(lost, np.inf, outer),
    )


def _between(score: FloatArray, best: IntArray) -> FloatArray:
    """Return the vertex of the parabola through each best score and its neighbours, in steps, within +-0.5."""
    rows, last = np.arange(len(score)), score.shape[1] - 1
    left, right = (
        score[rows, np.maximum(best - 1, 0)],
        score[rows, np.minimum(best + 1, last)],
    )
    middle = score[rows, best]
    with np.errstate(invalid="ignore"):
        bend = left - 2.0 * middle + right
        vertex = 0.5 * (left - right) / bend
    return np.where(np.isfinite(vertex) & (bend < 0.0), np.clip(vertex, -0.5, 0.5), 0.0)


def limb_response(pieces: LimbPieces, center_px: FloatArray) -> FloatArray:
    """Return the shift of n limb points with the center's pixel and line and with the logarithm of the range, (n, 3)."""
    away = np.einsum("ij,ij->i", pieces.normal, pieces.point_px - center_px)
    return np.column_stack([pieces.normal, -away])


def outline_motion(
    lags: LimbLags, pieces: LimbPieces, outline: Outline, search_px: float, *, solve_range: bool
) -> tuple[FloatArray, BoolArray]:
    """Return the motion (3,) of center (px) and log range that brings the outline to the lags, and which follow it.

    The motion is nan where too few lags were found.
    """
    found = np.isfinite(lags.lag_px)
    design = limb_response(pieces, outline.center_px)[found]
    lag = lags.lag_px[found]
    columns = 3 if solve_range else 2
    motion = np.zeros(3)
    if len(lag) < FEWEST_LAGS:
        return np.full(3, np.nan), np.zeros(len(pieces), dtype=bool)
    width = search_px
    for _ in range(NARROWINGS):
        for _ in range(2):
            residual = lag - design @ motion
            weight = 1.0 / (1.0 + (residual / width) ** 2)
            root = np.sqrt(weight)[:, None]
            motion[:columns] = np.linalg.lstsq(root * design[:, :columns], root[:, 0] * lag, rcond=None)[0]
        width = max(0.5 * width, NEAREST_PX)
    follow = np.zeros(len(pieces), dtype=bool)
    follow[found] = np.abs(lag - design @ motion) <= max(4.0 * NEAREST_PX, 0.03 * outline.diameter_px)
    return motion, follow


# ---- Where a limb fit starts.

DETECTED_SNR = 5.0
LEAST_FOUND = 0.3  # of the lit limb: with less of it in sight something else was found
LEAST_FOLLOWING = 0.4  # of the limb that was found
SURE_FOLLOWING = 0.75  # with so much of it the body need not be searched for by correlation
SEARCH_SHARE = 0.35  # of the radius, to both sides: a radius that is off by 30 % is still found
SECOND_SHARE = 0.08
LEAST_SEARCH_PX = 4.0
SMALL_DIAMETER_PX = 12.0  # the limb of smaller bodies lies where the correlation says
OTHER_SIZE = 1.15  # a circle this much larger or smaller than predicted is tried as well
SETTLED_PX = 2.0
MOSTLY_SATURATED = 0.3  # saturated share of the expected disk


@dataclass(frozen=True, slots=True, eq=False)
class FitStart:
    """Place and range to start from.

    Attributes
    ----------
    center_px : (2,) array
    spread_px
        How far the limb lies from the outline there (median of absolute lags, as a standard deviation).
    """

    center_px: FloatArray
    range_scale: float
    spread_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


class StartError(Exception):
    """No start: a status of `BodyCenter`, why, and the flags that go with it."""

    def __init__(self, status: str, message: str, flags: int = 0) -> None:
        super().__init__(message)
        self.status, self.message, self.flags = status, message, flags


def find_start(
    picture: BodyPicture,
    silhouette: Silhouette,
    circle: Circle | None,
    search_radius_px: float | None,
    *,
    solve_range: bool,
) -> FitStart:
    """Find a body's limb, roughly.

    Raises
    ------
    StartError
        The body cannot be seen there.
    """
    expected = choose_subarray(picture, silhouette.name, circle)
    if expected.empty:
        raise StartError("off_detector", _off_detector(expected.center_px, picture))
    # A saturated disk has a limb as well: its place does not depend on the values.
    seen = replace(picture, saturated=np.zeros_like(picture.saturated))
    guess = FitStart(expected.center_px, 1.0, 0.0)
    large = picture.diameter_px(silhouette.name) >= SMALL_DIAMETER_PX
    if large and _size_ratio(picture, silhouette.name, circle) == 1.0:
        try:  # most predictions are good enough to see the limb from there
            return _followed(seen, silhouette, guess, SURE_FOLLOWING, solve_range=solve_range)
        except StartError:
            pass
    guess = _placed(seen, silhouette, guess.center_px, circle, search_radius_px)
    if not large:
        return guess
    return _followed(seen, silhouette, guess, LEAST_FOLLOWING, solve_range=solve_range)


def _followed(
    picture: BodyPicture, silhouette: Silhouette, start: FitStart, least: float, *, solve_range: bool
) -> FitStart:
    """Bring the outline to the limb in one or two steps, the second one nearer."""
    search = _LimbSearch(picture, silhouette, start)
    for share in (SEARCH_SHARE, SECOND_SHARE):
        diameter = picture.diameter_px(silhouette.name) / start.range_scale
        moved = search.moved(
            start, max(LEAST_SEARCH_PX, share * 0.5 * diameter), least, solve_range=solve_range
        )
        resized = abs(moved.range_scale / start.range_scale - 1.0) * diameter
        settled = max(float(np.hypot(*(moved.center_px - start.center_px))), resized) < SETTLED_PX
        start = moved
        if settled:
            break
    return start


def _off_detector(center: FloatArray, picture: BodyPicture) -> str:
    if not np.isfinite(center).all():
        return "it is not in front of the camera"
    return (
        f"expected at pixel {center[0]:.0f}, line {center[1]:.0f}, outside the "
        f"{picture.camera.n_pixel} x {picture.camera.n_line} detector"
    )


def _size_ratio(picture: BodyPicture, name: str, circle: Circle | None) -> float:
    """Return the predicted diameter over that of an analyst's circle; 1 where they are alike."""
    predicted = picture.diameter_px(name)
    if circle is None or not predicted > 0.0:
        return 1.0
    ratio = predicted / circle.diameter_px
    return ratio if max(ratio, 1.0 / ratio) > OTHER_SIZE else 1.0


def _placed(
    picture: BodyPicture,
    silhouette: Silhouette,
    center: FloatArray,
    circle: Circle | None,
    search_radius_px: float | None,
) -> FitStart:
    """Find the body by correlation; of the a priori size and the circle's the one that fits better counts."""
    name = silhouette.name
    predicted = picture.diameter_px(name)
    found: list[tuple[CorrelationPeak, float]] = []
    for scale in dict.fromkeys((1.0, _size_ratio(picture, name, circle))):
        radius = 0.5 * predicted / scale
        searched = search_radius(radius, circle, search_radius_px)
        place = search_place(picture, name, center, radius, searched, range_scale=scale)
        found.append((place, scale))
    place, scale = max(found, key=lambda pair: pair[0].snr * pair[0].explained)
    if not place.usable > 0.0:
        raise StartError("failed", "no usable pixels about its expected place", int(BodyFlag.EMPTY))
    if not (place.snr >= DETECTED_SNR and np.isfinite(place.center_px).all()):
        raise StartError(
            "not_detected",
            f"nothing like it found within {searched:.0f} px of its expected place (SNR {place.snr:.1f}, "
            f"{DETECTED_SNR:g} needed)",
        )
    return FitStart(place.center_px, scale, 0.0)


class _LimbSearch:
    """Looks for a body's limb with one rendering of it."""

    def __init__(self, picture: BodyPicture, silhouette: Silhouette, start: FitStart) -> None:
        self.picture, self.silhouette, self.reach = picture, silhouette, limb_reach_px(picture)
        self.outline = silhouette.at(start.center_px, start.range_scale)
        window = model_window(picture, self.outline, self.reach)
        if min(window[2:]) < 1:
            raise StartError("off_detector", "its limb lies off the detector", int(BodyFlag.CUT_BY_EDGE))
        places, scales = {silhouette.name: start.center_px}, {silhouette.name: start.range_scale}
        model = model_picture(picture, window, places, range_scale=scales)
        self.pieces = limb_pieces(self.outline, picture.signal_dn.shape, self.reach)
        self.template = limb_template(self.pieces, model, window, self.reach)

    def moved(self, start: FitStart, search: float, least: float, *, solve_range: bool) -> FitStart:
        """Return where the limb is, from `start`; at least a share `least` of what is found must follow it."""
        outline = self.silhouette.at(start.center_px, start.range_scale)
        pieces = limb_pieces(outline, self.picture.signal_dn.shape, self.reach)
        template = self.template.at(self.pieces.angle_rad, pieces.angle_rad)
        lags = limb_lags(self.picture, pieces, template, search)
        lit = template.lit & np.isfinite(template.model_dn).all(axis=1)
        found = lit & np.isfinite(lags.lag_px)
        if np.count_nonzero(found) < max(LEAST_FOUND * np.count_nonzero(lit), 1):
            raise _no_limb(found, lit)
        motion, follow = outline_motion(lags, pieces, outline, search, solve_range=solve_range)
        if not np.isfinite(motion).all() or np.count_nonzero(follow) < least * np.count_nonzero(found):
            raise _no_limb(follow, found)
        center, scale = start.center_px + motion[:2], start.range_scale * float(np.exp(motion[2]))
        if solve_range and self.silhouette.shape is None:
            center, scale = _horizon(self.picture, self.silhouette, pieces, lags, follow, (center, scale))
        return FitStart(center, scale, _lag_scatter_px(lags, pieces, outline, motion, follow))


def _no_limb(some: BoolArray, of: BoolArray) -> StartError:
    return StartError(
        "not_detected",
        f"only {np.count_nonzero(some)} of {np.count_nonzero(of)} places along its limb show one",
        int(BodyFlag.POOR_FIT),
    )


def _lag_scatter_px(
    lags: LimbLags, pieces: LimbPieces, outline: Outline, motion: FloatArray, follow: BoolArray
) -> float:
    away = np.einsum("ij,ij->i", pieces.normal, pieces.point_px - outline.center_px)
    residual = lags.lag_px - pieces.normal @ motion[:2] + away * motion[2]
    return MAD_TO_SIGMA * float(np.median(np.abs(residual[follow])))


def _horizon(
    picture: BodyPicture,
    silhouette: Silhouette,
    pieces: LimbPieces,
    lags: LimbLags,
    follow: BoolArray,
    fallback: tuple[FloatArray, float],
) -> tuple[FloatArray, float]:
    """Return place and range scale of the horizon fit through limb points; `fallback` where they do not close a cone."""
    target = picture.model(silhouette.name).target
    points = (pieces.point_px + lags.lag_px[:, None] * pieces.normal)[follow]
    apparent = picture.camera.unproject(points) @ picture.camera_from_j2000
    rays = geometric_direction(apparent, picture.observer_velocity_km_s)
    turn = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
    assert target.radii_km is not None
    try:
        position = horizon_position(rays, target.radii_km, turn.T)
    except CenterfindingError:
        return fallback
    seen = apparent_direction(position, picture.observer_velocity_km_s)
    center = picture.camera.project((picture.camera_from_j2000 @ seen)[None])[0]
    scale = float(np.linalg.norm(position)) / target.range_km
    near = np.hypot(*(center - fallback[0])) <= LEAST_SEARCH_PX + 0.02 * len(pieces)
    return (center, scale) if near and abs(np.log(scale / fallback[1])) < 0.05 else fallback


def model_window(picture: BodyPicture, outline: Outline, margin: float) -> tuple[int, int, int, int]:
    """Return the window of the detector that holds an outline and `margin` px around it."""
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low, high = outline.center_px - outline.reach_px[:2], outline.center_px + outline.reach_px[2:]
    first = np.clip(np.floor(low - margin) - 1, 0, size).astype(int)
    last = np.clip(np.ceil(high + margin) + 1, -1, size - 1).astype(int)
    n_pixel, n_line = (int(n) for n in np.maximum(last - first + 1, 0))
    return int(first[0]), int(first[1]), n_pixel, n_line


def saturated_share(picture: BodyPicture, name: str, circle: Circle | None) -> float:
    """Return the share of saturated pixels in the circle where a body is expected."""
    expected = choose_subarray(picture, name, circle)
    if expected.empty:
        return 0.0
    pixel, line, n_pixel, n_line = expected.window
    down, along = np.mgrid[line : line + n_line, pixel : pixel + n_pixel]
    inside = np.hypot(along - expected.center_px[0], down - expected.center_px[1]) <= max(
        expected.radius_px, 1.0
    )
    return float(picture.saturated[expected.slices][inside].mean()) if inside.any() else 0.0
