"""Center of a body from its limb: sub-pixel limb points, and the conic of its ellipsoid (or its silhouette) through them.

Flow   place (`opnav_workbench.bodies.place`) -> rendered limb fitted piece by piece -> position by weighted least squares
       -> rendered anew there, until it stands still
Frame  (pixel, line), 0-based, integer = pixel center
Units  px, km, DN

The body is rendered where it is thought to be, with its law, the PSF, distortion and stellar aberration; what is measured is
how far the limb of the picture lies beside the rendered one. At the solution that is zero on average, so that no
approximation of the edge or of the camera is left in the center, which is the projected center of figure.

Source  Owen (2011), AAS 11-215 (limbs)
"""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.measurement import placed_body
from opnav_workbench.bodies.ellipse.limb_points import (
    LimbPieces,
    fit_edges,
    limb_pieces,
    limb_reach_px,
    missing_share,
    select_limb,
)
from opnav_workbench.bodies.ellipse.point_fits import limb_motion
from opnav_workbench.bodies.ellipse.report import METHOD, LimbStage, limb_center
from opnav_workbench.bodies.picture import BodyPicture, Circle, model_picture
from opnav_workbench.bodies.place import LimbCrossings, cross_limb, radiance_profiles
from opnav_workbench.bodies.results import BodyCenter, BodyFlag
from opnav_workbench.bodies.silhouette import TURN, Outline, Silhouette
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.targets import TargetState
from opnav_workbench.threads import one_thread

__all__ = ["find_ellipse"]

MOST_STAGES = 10
TURNED = 0.5  # a step back by this share of the last one is halved from then on
STILL_PX, STILL_SIGMAS = 0.01, 0.05  # motion of center and limb after which the solution stands
# A picture that tells the size of a body less well than this leaves it to the ephemeris, which knows the range better;
# unless the target's covariance says how well it does.
RANGE_SIGMA = 0.002
LARGEST_STEP = 0.1  # of the radius, per stage
ROUGH_PX = 0.75  # a limb this far from its model is followed from where it is
SEARCH_SHARE, LEAST_SEARCH_PX = 0.35, 4.0  # of the radius
MOSTLY_SATURATED = 0.3  # of the lit limb
LEAST_DIAMETER_PX = 3.0
MOSTLY_MISSING = 0.5  # of the limb: something else was found


@one_thread()
def find_ellipse(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = True,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure from its lit limb.

    Parameters
    ----------
    name
        A sphere, a triaxial ellipsoid or a shape model of `picture.models`.
    circle
        An analyst's; None: predicted place and size.
    solve_range
        Solve for the range (the size in the picture) as well; given up where it is known better beforehand (from the
        target's covariance; 0.2 % where it has none).
    search_radius_px
        How far from the expected place to look.

    Returns
    -------
    BodyCenter
        Method ``ellipse``; `detail` is a `LimbEllipse`. Status ``ok``; ``uncertain`` (see `flags` and `messages`);
        ``not_detected``, ``off_detector``, ``saturated`` or ``failed`` without a center.

    Raises
    ------
    CenterfindingError
        No such body in the picture.

    Notes
    -----
    The covariance holds the noise of the pixels and, where the limb leaves its model by more than that, the roughness of the
    limb with its correlation along it.

    Examples
    --------
    A sphere of 60 px without noise, expected 3 px beside its place.

    >>> from opnav_workbench.targets import TargetState
    >>> from opnav_workbench.bodies import displaced_model, model_picture
    >>> from opnav_workbench.camera import Camera
    >>> from opnav_workbench.psf import GaussianPsf
    >>> from opnav_workbench.render import BodyModel
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> charon = TargetState("CHARON", [0, 0, 2.02e6], radii_km=[606.0] * 3, sun_position_km=[4e9, 1e9, 0])
    >>> empty = BodyPicture(np.zeros((1024, 1024)), 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                     (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> light = model_picture(empty, (0, 0, 1024, 1024), {"CHARON": [514.2, 510.3]})
    >>> seen = BodyPicture(1e4 / light.max() * light, 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                    (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> center = find_ellipse(seen, "CHARON")
    >>> center.status, center.pixel_line.round(2).tolist(), round(center.diameter_px)
    ('ok', [514.2, 510.3], 60)
    """
    if (small := _too_small(picture, name)) is not None:
        return small
    placed = placed_body(picture, name, METHOD, circle, search_radius_px)
    if isinstance(placed, BodyCenter):
        return placed
    picture, place = placed
    try:
        silhouette = Silhouette(picture, name)
        scale = 1.0 / place.size_ratio if solve_range else 1.0
        return _refined(picture, silhouette, place.center_px, scale, circle, solve_range=solve_range)
    except CenterfindingError as error:
        return _without(name, "failed", str(error))


def _without(name: str, status: str, message: str, flags: int = 0) -> BodyCenter:
    return BodyCenter.without_center(name, METHOD, status, message, flags=flags)


def _saturated(name: str) -> BodyCenter:
    why = (
        "its disk is saturated up to the limb, whose place the brightness would tell; take a shorter exposure"
    )
    return _without(name, "saturated", why, int(BodyFlag.OVEREXPOSED))


def _too_small(picture: BodyPicture, name: str) -> BodyCenter | None:
    diameter = picture.diameter_px(name)
    if not 0.0 < diameter < LEAST_DIAMETER_PX:
        return None
    return _without(
        name,
        "failed",
        f"it is {diameter:.1f} px wide, too small for a limb (at least {LEAST_DIAMETER_PX:g} px); use 'unresolved' or "
        "'least_squares'",
    )


def _refined(
    picture: BodyPicture,
    silhouette: Silhouette,
    center: FloatArray,
    scale: float,
    circle: Circle | None,
    *,
    solve_range: bool,
) -> BodyCenter:
    stage, steps, converged = _settled(picture, silhouette, center, scale, solve_range=solve_range)
    solved = solve_range
    if solve_range and not _tells_range(stage, picture.model(silhouette.name).target):
        solved = False
        center = stage.outline.center_px if converged else center
        stage, steps, converged = _settled(picture, silhouette, center, 1.0, solve_range=False)
    if stage.motion is None or missing_share(stage.selection) > MOSTLY_MISSING:
        return _no_limb(silhouette.name, stage)
    return limb_center(
        picture, silhouette.name, stage, circle, steps, converged=converged, asked_range=solve_range,
        solved_range=solved,
    )  # fmt: skip


def _tells_range(stage: LimbStage, target: TargetState) -> bool:
    """Whether the picture tells the range better than it is known beforehand."""
    known = RANGE_SIGMA
    if target.covariance_km2 is not None:
        known = float(np.sqrt(target.direction @ target.covariance_km2 @ target.direction)) / target.range_km
    return stage.motion is not None and float(np.sqrt(stage.motion.covariance[2, 2])) <= known


def _no_limb(name: str, stage: LimbStage) -> BodyCenter:
    selection = stage.selection
    lit = selection.status != "not_chosen"
    if selection.saturated.sum() > MOSTLY_SATURATED * lit.sum():
        return _saturated(name)
    if not lit.any():
        return _without(name, "off_detector", "no lit limb lies on the detector", int(BodyFlag.CUT_BY_EDGE))
    reasons, counts = np.unique(selection.reason[lit], return_counts=True)
    return _without(
        name,
        "not_detected",
        f"of {np.count_nonzero(lit)} pieces of lit limb too few show it; mostly: {reasons[counts.argmax()]}",
        int(BodyFlag.EMPTY),
    )


def _settled(
    picture: BodyPicture, silhouette: Silhouette, center: FloatArray, scale: float, *, solve_range: bool
) -> tuple[LimbStage, tuple[tuple[float, float], ...], bool]:
    """Repeat stages until the body stands still, or is lost: then the last one that saw its limb stands, not converged."""
    outline = silhouette.at(center, scale)
    found = _crossings(picture, silhouette.name, outline, scale)
    follow = _is_rough(found)
    steps: list[tuple[float, float]] = []
    share, last, seen = 1.0, np.zeros(3), None
    while True:
        stage = _stage(
            picture, silhouette, outline, scale, found if follow else None, solve_range=solve_range
        )
        if stage.motion is None:
            return seen or stage, tuple(steps), False
        seen = stage
        radii = np.array([1.0, 1.0, 0.5 * outline.diameter_px])
        step = np.clip(stage.motion.motion * radii, -LARGEST_STEP * radii[2], LARGEST_STEP * radii[2])
        sigma = np.sqrt(np.diag(stage.motion.covariance)) * radii
        still = bool(np.all(np.abs(step) < np.maximum(STILL_PX, STILL_SIGMAS * sigma)))
        if still or len(steps) == MOST_STAGES:
            return stage, tuple(steps), still
        if step @ last < -TURNED * (last @ last):  # to and fro: pieces of limb that come and go
            share *= 0.5
        last, move = step, share * step / radii
        steps.append((float(move[0]), float(move[1])))
        center, scale = center + move[:2], scale * float(np.exp(move[2]))
        outline = silhouette.at(center, scale)
        if follow:
            found = _crossings(picture, silhouette.name, outline, scale)


def _stage(
    picture: BodyPicture,
    silhouette: Silhouette,
    outline: Outline,
    scale: float,
    found: LimbCrossings | None,
    *,
    solve_range: bool,
) -> LimbStage:
    """Measure how far the limb lies beside an outline; `found`: where it is crossed, if it is looked for there."""
    reach = limb_reach_px(picture)
    pieces = limb_pieces(outline, picture.signal_dn.shape, reach)
    offset = np.zeros(len(pieces))
    if found is not None:
        offset = _crossed(found, outline, pieces)
        pieces = limb_pieces(outline, picture.signal_dn.shape, reach, offset)
    window = _window(picture, outline, reach + float(np.abs(offset).max()))
    if min(window[2:]) < 1:
        raise CenterfindingError("its limb lies off the detector")
    model = model_picture(
        picture, window, {silhouette.name: outline.center_px}, range_scale={silhouette.name: scale}
    )
    edges = fit_edges(picture, pieces, model, window, outline.center_px, offset)
    selection = select_limb(picture, silhouette, pieces, edges, reach)
    motion = limb_motion(
        edges.shift_px, edges.sigma_px, edges.response, selection.usable, solve_range=solve_range
    )
    if motion is not None:
        selection = selection.with_outliers(motion.used, motion.residual_px, edges.sigma_px)
    return LimbStage(outline, scale, window, model, pieces, edges, selection, motion)


def _window(picture: BodyPicture, outline: Outline, margin: float) -> tuple[int, int, int, int]:
    """Return the window of the detector that holds an outline and `margin` px around it."""
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low, high = outline.center_px - outline.reach_px[:2], outline.center_px + outline.reach_px[2:]
    first = np.clip(np.floor(low - margin) - 1, 0, size).astype(int)
    last = np.clip(np.ceil(high + margin) + 1, -1, size - 1).astype(int)
    n_pixel, n_line = (int(n) for n in np.maximum(last - first + 1, 0))
    return int(first[0]), int(first[1]), n_pixel, n_line


def _crossings(picture: BodyPicture, name: str, outline: Outline, scale: float) -> LimbCrossings:
    search = max(LEAST_SEARCH_PX, SEARCH_SHARE * 0.5 * outline.diameter_px)
    return cross_limb(picture, outline, search, radiance_profiles(picture, name, 1.0 / scale))


def _is_rough(found: LimbCrossings) -> bool:
    """Tell whether a limb lies so far from an outline that it has to be followed."""
    away = np.abs(found.depth_px[found.known])
    return len(away) > 0 and MAD_TO_SIGMA * float(np.median(away)) > ROUGH_PX


def _crossed(found: LimbCrossings, outline: Outline, pieces: LimbPieces) -> FloatArray:
    """Return where along its normal the limb of each piece (n,) is crossed; 0 where it is not."""
    ray = np.mod(pieces.angle_rad, TURN) * (len(found.angle_rad) / TURN)
    nearest = ray.astype(np.int64) % len(found.angle_rad)
    away = pieces.point_px - outline.center_px
    lean = np.einsum("ij,ij->i", pieces.normal, away) / np.hypot(*away.T)
    return np.where(found.known[nearest], found.depth_px[nearest] * lean, 0.0)
