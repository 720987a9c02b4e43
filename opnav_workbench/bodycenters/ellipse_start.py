"""Where a limb fit starts: the body's place by correlation, its limb along normals, Christian and Robinson's position."""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.flags import BodyFlag
from opnav_workbench.bodycenters.horizon import horizon_position
from opnav_workbench.bodycenters.horizon_search import LimbLags, limb_lags, limb_template, outline_motion
from opnav_workbench.bodycenters.limb_points_pieces import LimbPieces, limb_pieces, reach_px
from opnav_workbench.bodycenters.model_picture import model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.place_search import Place, search_place
from opnav_workbench.bodycenters.silhouette import Outline, Silhouette
from opnav_workbench.bodycenters.subarray import choose_subarray, search_radius
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, geometric_direction

__all__ = ["Start", "StartError", "find_start", "model_window", "saturated_share"]

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
MOSTLY = 0.3  # saturated share of the expected disk


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Place and range to start from.

    Attributes
    ----------
    center_px : (2,) array
    range_scale : float
    spread_px : float
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
) -> Start:
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
    guess = Start(expected.center_px, 1.0, 0.0)
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
    picture: BodyPicture, silhouette: Silhouette, start: Start, least: float, *, solve_range: bool
) -> Start:
    """Bring the outline to the limb in one or two steps, the second one nearer."""
    look = _Look(picture, silhouette, start)
    for share in (SEARCH_SHARE, SECOND_SHARE):
        diameter = picture.diameter_px(silhouette.name) / start.range_scale
        moved = look.moved(
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
) -> Start:
    """Find the body by correlation; of the a priori size and the circle's the one that fits better counts."""
    name = silhouette.name
    predicted = picture.diameter_px(name)
    found: list[tuple[Place, float]] = []
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
    return Start(place.center_px, scale, 0.0)


class _Look:
    """Looks for a body's limb with one rendering of it."""

    def __init__(self, picture: BodyPicture, silhouette: Silhouette, start: Start) -> None:
        self.picture, self.silhouette, self.reach = picture, silhouette, reach_px(picture)
        self.outline = silhouette.at(start.center_px, start.range_scale)
        window = model_window(picture, self.outline, self.reach)
        if min(window[2:]) < 1:
            raise StartError("off_detector", "its limb lies off the detector", int(BodyFlag.CUT_BY_EDGE))
        places, scales = {silhouette.name: start.center_px}, {silhouette.name: start.range_scale}
        model = model_picture(picture, window, places, range_scale=scales)
        self.pieces = limb_pieces(self.outline, picture.signal_dn.shape, self.reach)
        self.template = limb_template(self.pieces, model, window, self.reach)

    def moved(self, start: Start, search: float, least: float, *, solve_range: bool) -> Start:
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
        return Start(center, scale, _spread(lags, pieces, outline, motion, follow))


def _no_limb(some: BoolArray, of: BoolArray) -> StartError:
    return StartError(
        "not_detected",
        f"only {np.count_nonzero(some)} of {np.count_nonzero(of)} places along its limb show one",
        int(BodyFlag.POOR_FIT),
    )


def _spread(
    lags: LimbLags, pieces: LimbPieces, outline: Outline, motion: FloatArray, follow: BoolArray
) -> float:
    away = np.einsum("ij,ij->i", pieces.normal, pieces.point_px - outline.center_px)
    residual = lags.lag_px - pieces.normal @ motion[:2] + away * motion[2]
    return 1.4826 * float(np.median(np.abs(residual[follow])))


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
