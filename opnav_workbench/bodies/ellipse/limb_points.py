"""Sub-pixel limb points: where pieces of limb cross half of their brightness, in the picture and in its model alike.

Flow   outline -> pieces of equal angle, each with some rays -> light along the rays, averaged over the piece -> the
       crossing, less that of the model drawn in pixels and read in the same way -> pieces off the detector, unlit, behind
       other bodies, hit, bad, faint or unlike the rest left out, each with its reason
Frame  (pixel, line); depth along rays from the center, positive outward; shift along the limb's normal
Units  px, DN

The model's light is that of `fit_disk`: limb darkening, curvature, PSF and sampling shift both crossings alike and leave
their difference. What the fit does not know of the law and the PSF is carried along as changes of the crossings.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, map_coordinates

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.fit import DiskFit, Unknown
from opnav_workbench.bodies.disk.limb_cells import limb_pixels
from opnav_workbench.bodies.disk.limb_light import PLANES
from opnav_workbench.bodies.disk.measurement import MeasuredDisk
from opnav_workbench.bodies.neighbours import near_bodies
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.place import FAINT_SHARE, crossing_columns, crossing_depths
from opnav_workbench.bodies.results import NOT_CHOSEN, REJECTED, USED
from opnav_workbench.bodies.silhouette import TURN, Outline

__all__ = ["LimbPoints", "find_limb_points"]

PIECE_PX, RAY_PX = 2.0, 0.5  # as long as the PSF is wide: shorter pieces do not tell more
LEAST_PIECES, MOST_PIECES, MOST_RAYS = 12, 240, 12
STEP_PX, NEWTON_STEPS = 0.25, 5
LEVEL, SKY = (
    (-4.0, -1.5),
    (2.5, 5.0),
)  # widths of the PSF from a limb that tell its brightness and its background
LIT_SHARE = 0.2  # of the brightest piece: darker ones lie at the terminator, where relief makes the edge
FAINT_SIGMAS = 4.0
LEAST_HEIGHT = 0.06  # of the median: half of the darkest that surfaces have beside their brightest
LARGEST_SIGMA_PX = 0.5
SKY_SHARE = 0.5  # of the limb's brightness: what is brighter outside is no sky, however wide the halo of a fouled lens
GOOD_RAYS = 0.5
# What the fit leaves open of the light that is not the outline's.
CHANGES = {
    "law": Unknown.LAW,
    "law_2": Unknown.LAW_2,
    "blur": Unknown.BLUR,
    "wings": Unknown.WINGS,
    "halo": Unknown.HALO,
    "strain_zz": Unknown.STRAIN_ZZ,
    "strain_xz": Unknown.STRAIN_XZ,
    "strain_yz": Unknown.STRAIN_YZ,
}
OFF, SATURATED = "off the detector", "saturated"
MOST_CHANGED = 0.3  # from where the light was tabulated: beyond, a fit went astray
NO_LIMB, FAINTER = "nothing like a limb stands out there", "far fainter than the rest of the limb"


@dataclass(frozen=True, slots=True, eq=False)
class LimbPoints:
    """n pieces of limb, in order along it.

    Attributes
    ----------
    angle_rad, limb_px : (n,) arrays
        Of their middles about the center.
    normal : (n, 2) array
        Outward.
    shift_px, sigma_px : (n,) arrays
        Limb observed minus the model's, along the normal, and its noise; nan without one.
    height : (n,) array
        Brightness, data over model.
    design : (n, 5 + k) array
        Change of the shift with center (2), log size, strain (2), and with `CHANGES` as far as the fit leaves them open.
    status, reason : (n,) arrays of str
        As in `LimbEllipse`.
    saturated : (n,) array of bool
    """

    angle_rad: FloatArray
    limb_px: FloatArray
    normal: FloatArray
    shift_px: FloatArray
    sigma_px: FloatArray
    height: FloatArray
    design: FloatArray
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    saturated: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def usable(self) -> BoolArray:
        """Pieces that count."""
        return np.asarray(self.status == USED)

    @property
    def missing(self) -> BoolArray:
        """Pieces lit in the model and not in the picture."""
        return np.asarray((self.reason == NO_LIMB) | (self.reason == FAINTER))

    @property
    def seen(self) -> BoolArray:
        """Pieces of lit limb on the detector."""
        return np.asarray(self.status != NOT_CHOSEN)

    def with_outliers(self, used: BoolArray, residual_px: FloatArray) -> "LimbPoints":
        """Return the points with those usable ones rejected that a fit left out."""
        status, reason = self.status.copy(), self.reason.copy()
        for row in np.flatnonzero(self.usable & ~used):
            many = residual_px[row] / self.sigma_px[row]
            status[row] = REJECTED
            reason[row] = (
                f"it lies {residual_px[row]:+.2f} px from the limb of the others ({many:+.0f} sigma)"
            )
        return replace(self, status=status, reason=reason)


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Pieces and their rays: places (n pieces, k rays, m depths, 2), and which rays count."""

    angle: FloatArray
    depth: FloatArray
    places: FloatArray
    length_px: float
    width_px: float
    good: BoolArray

    def mean(self, plane: FloatArray) -> FloatArray:
        """Return a plane of the picture along the good rays (n, m), less its background outside of the limb."""
        where = [self.places[..., 1], self.places[..., 0]]
        light = map_coordinates(plane, where, order=1, mode="nearest")
        weight = self.good[..., None] / np.maximum(self.good.sum(axis=1), 1)[:, None, None]
        profile = (light * weight).sum(axis=1)
        return np.asarray(profile - self.level(profile, np.zeros(len(profile)), SKY)[:, None])

    def at(self, profile: FloatArray, depth: FloatArray) -> FloatArray:
        """Return profiles (n, m) at one depth each (n,)."""
        place = np.clip((depth - self.depth[0]) / STEP_PX, 0.0, len(self.depth) - 1.001)
        below, each = place.astype(np.int64), np.arange(len(place))
        part = place - below
        return np.asarray((1.0 - part) * profile[each, below] + part * profile[each, below + 1])

    def level(self, profile: FloatArray, limb: FloatArray, widths: tuple[float, float]) -> FloatArray:
        """Return the mean of profiles between two depths from where each one's limb is."""
        low, high = (
            np.clip(limb + w * self.width_px, self.depth[0], self.depth[-1] - STEP_PX) for w in widths
        )
        summed = np.cumsum(profile, axis=1) * STEP_PX
        return np.asarray(
            (self.at(summed, high) - self.at(summed, low)) / np.maximum(high - low, 0.5 * STEP_PX)
        )

    def steepness(self, profile: FloatArray, limb: FloatArray) -> FloatArray:
        """Return how fast brightness less half of the level falls (n,), per px outward."""
        apart = [self.at(profile, limb + e) - 0.5 * self.level(profile, limb + e, LEVEL) for e in (-0.5, 0.5)]
        return np.asarray(apart[0] - apart[1])

    def cross(self, profile: FloatArray, faint: float) -> FloatArray:
        """Return where profiles are half as bright as behind: found in steps, then made continuous."""
        found = crossing_depths(profile, self.depth, self.width_px, faint)
        limb = np.nan_to_num(found)
        for _ in range(NEWTON_STEPS):
            over = self.at(profile, limb) - 0.5 * self.level(profile, limb, LEVEL)
            limb = limb + np.clip(over / np.maximum(self.steepness(profile, limb), 1e-9), -STEP_PX, STEP_PX)
        return np.where(np.isfinite(found), limb, np.nan)


def find_limb_points(disk: MeasuredDisk, outline: Outline, reach_px: float, *, saturated: bool) -> LimbPoints:
    """Find the limb about an outline.

    Parameters
    ----------
    disk
        Whose light the limb has.
    reach_px
        How far from the outline to look.
    saturated
        Take saturated pieces of limb as well.
    """
    picture, fit = disk.picture, disk.fit
    rays, lost = _rays(disk, outline, reach_px)
    light, changes = _model(picture, fit, outline, rays)
    data = rays.mean(np.where(np.isfinite(picture.signal_dn), picture.signal_dn, 0.0))
    noise = float(np.median(picture.noise_dn)) / np.sqrt(max(rays.length_px, 1.0))
    faint = max(FAINT_SHARE * float(light.max(initial=0.0)), FAINT_SIGMAS * noise)
    observed = rays.cross(data, faint)
    peak = rays.level(light, np.zeros(len(light)), LEVEL)
    height = rays.level(data, np.nan_to_num(observed), LEVEL) / np.maximum(peak, 1e-12)
    factor = np.clip(np.nan_to_num(height), 1e-3, None)[:, None]
    expected = rays.cross(factor * light, faint)
    moved = [rays.cross(factor * (light + change), faint) - expected for change in changes]
    radial = crossing_columns(rays.angle, outline)
    lean, normal = _normals(outline, rays.angle)
    design = np.concatenate([radial, np.nan_to_num(np.stack(moved, axis=-1))], axis=1) * lean[:, None]
    points = LimbPoints(
        angle_rad=rays.angle,
        limb_px=outline.radius(rays.angle),
        normal=normal,
        shift_px=(observed - expected) * lean,
        sigma_px=_noise(picture, rays, factor * light, expected) * lean,
        height=height,
        design=design,
        status=np.full(len(rays.angle), USED, dtype="<U10"),
        reason=np.full(len(rays.angle), "", dtype="<U96"),
        saturated=np.any(_touched(picture.saturated, rays, np.abs(rays.depth) < 2.0 * rays.width_px), axis=1),
    )
    outside = rays.level(data, np.nan_to_num(observed), SKY)
    if not saturated:
        lost[SATURATED] = points.saturated
    return _judged(points, peak, lost, outside)


def _rays(disk: MeasuredDisk, outline: Outline, reach_px: float) -> tuple[_Rays, dict[str, BoolArray]]:
    """Return rays, and the pieces (n,) that are lost to what befell their pixels."""
    picture, fitted = disk.picture, disk.fit.reach_px
    radius = 0.5 * outline.diameter_px
    n = int(np.clip(round(TURN * radius / PIECE_PX), LEAST_PIECES, MOST_PIECES))
    length = TURN * radius / n
    k = int(np.clip(np.ceil(length / RAY_PX), 2, MOST_RAYS))
    angle = np.asarray((np.arange(n * k) + 0.5).reshape(n, k) * (TURN / (n * k)))
    width = max(1.0, 1.2 * float(np.max(picture.psf.sigma_px)))
    limb = outline.radius(angle)
    inward = min(reach_px + 5.0 * width, float(limb.min()), fitted[0])
    depth = np.arange(-inward, reach_px + SKY[1] * width, STEP_PX)
    wheel = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    places = outline.center_px + (limb[..., None] + depth)[..., None] * wheel[:, :, None]
    rays = _Rays(angle.mean(axis=1), depth, places, length, width, np.ones((n, k), dtype=bool))
    size = np.array([picture.camera.n_pixel, picture.camera.n_line]) - 1.0
    marked = {OFF: np.any((places < 0.0) | (places > size), axis=(2, 3))}
    marked |= {why: _touched(plane, rays) for why, plane in _faults(disk, outline).items()}
    good = ~np.any(list(marked.values()), axis=0)
    few = good.mean(axis=1) < GOOD_RAYS
    lost = {why: few & m.any(axis=1) for why, m in marked.items()}
    return replace(rays, good=good), lost


def _faults(disk: MeasuredDisk, outline: Outline) -> dict[str, BoolArray]:
    """Return the pixels (n_line, n_pixel) that do not count, by what is there."""
    picture = disk.picture
    bad = (picture.bad | ~np.isfinite(picture.signal_dn)) & ~picture.saturated
    others = ~(disk.pixels.use | bad | picture.saturated | disk.hits)
    names = " or ".join(near_bodies(picture, disk.name, outline.center_px)) or "another body"
    return {f"{names} stands there": others, "bad pixels": bad, "a cosmic ray or a star": disk.hits}


def _touched(plane: BoolArray, rays: _Rays, depths: BoolArray | None = None) -> BoolArray:
    """Return which rays (n, k) touch marked pixels."""
    places = rays.places if depths is None else rays.places[:, :, depths]
    if not plane.any():
        return np.zeros(places.shape[:2], dtype=bool)
    index = np.rint(places).astype(np.int64)
    pixel = np.clip(index[..., 0], 0, plane.shape[1] - 1)
    line = np.clip(index[..., 1], 0, plane.shape[0] - 1)
    return np.asarray(binary_dilation(plane)[line, pixel].any(axis=2))


def _model(
    picture: BodyPicture, fit: DiskFit, outline: Outline, rays: _Rays
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the model's light along the rays (n, m), DN, and its changes by a sigma of what the fit leaves open."""
    near = limb_pixels(outline, picture.signal_dn.shape, fit.reach_px[0] + 3.0, fit.reach_px[1] + 3.0)
    tables = fit.made.light.at(near.angle_rad, near.depth_px, len(PLANES))
    rows = tables[[PLANES.index(name) for name in CHANGES]]
    unknowns = list(CHANGES.values())
    share = np.clip(fit.solution.theta[unknowns] - fit.tabulated[unknowns], -MOST_CHANGED, MOST_CHANGED)
    root = np.linalg.cholesky(fit.solution.covariance[np.ix_(unknowns, unknowns)])
    light = np.maximum(tables[0] + share @ rows, 0.0)

    def along(values: FloatArray) -> FloatArray:
        plane = np.zeros(picture.signal_dn.shape)
        plane[near.line, near.pixel] = fit.brightness_dn * values
        return rays.mean(plane)

    return along(light), [along(change) for change in root.T @ rows]


def _normals(outline: Outline, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the cosine between ray and normal (n,), and the normal (n, 2)."""
    limb = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=TURN)
    u = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-u[:, 1], u[:, 0]], axis=-1)
    stretch = np.hypot(limb, slope)
    return limb / stretch, (limb[:, None] * u - slope[:, None] * across) / stretch[:, None]


def _noise(picture: BodyPicture, rays: _Rays, light: FloatArray, limb: FloatArray) -> FloatArray:
    """Return the noise (n,) of crossings: that of the brightness there and of half the levels over the slope.

    Of a linear interpolation the mean square weight is 2/3 across the limb; along it, over a length L, (1 - 0.46 / L) / L.
    """
    limb = np.nan_to_num(limb)
    slope = rays.steepness(light, limb)
    length, zone = max(rays.length_px, 1.0), (LEVEL[1] - LEVEL[0]) * rays.width_px
    share = 2.0 / 3.0 * (1.0 - 0.46 / length) / length + 0.5 / (zone * length)
    gain = np.inf if picture.noise_model is None else picture.gain_e_per_dn
    middle = rays.places[:, rays.places.shape[1] // 2, int(-rays.depth[0] / STEP_PX)]
    pixel, line = np.rint(np.clip(middle, 0.0, np.array(picture.noise_dn.shape)[::-1] - 1.0)).astype(int).T
    variance = picture.noise_dn[line, pixel] ** 2 + np.maximum(rays.at(light, limb), 0.0) / gain
    share = share / np.maximum(rays.good.mean(axis=1), 0.1)
    return np.where(slope > 0.0, np.sqrt(share * variance) / np.maximum(slope, 1e-12), np.nan)


def _judged(
    points: LimbPoints, peak: FloatArray, lost: dict[str, BoolArray], outside: FloatArray
) -> LimbPoints:
    """Tell which pieces count, and why the others do not."""
    status, reason = points.status.copy(), points.reason.copy()

    def mark(which: BoolArray, selection: str, why: str) -> None:
        now = which & (status == USED)
        status[now], reason[now] = selection, why

    mark(lost.pop(OFF), NOT_CHOSEN, OFF)
    mark(~(peak > LIT_SHARE * peak.max()), NOT_CHOSEN, "no light there: beyond the terminator")
    for why, which in lost.items():
        mark(which, REJECTED, why)
    mark(~np.isfinite(points.shift_px), REJECTED, NO_LIMB)
    mark(~(points.sigma_px <= LARGEST_SIGMA_PX), REJECTED, "too faint to place the limb")
    with np.errstate(invalid="ignore"):
        left = status == USED
        typical = float(np.median(points.height[left])) if left.any() else 0.0
        mark(points.height < LEAST_HEIGHT * typical, REJECTED, FAINTER)
        bright = outside > SKY_SHARE * points.height * peak
    mark(bright, REJECTED, "bright outside: not the limb, or something beside it")
    return replace(points, status=status, reason=reason)
