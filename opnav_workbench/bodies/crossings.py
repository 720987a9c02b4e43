"""Where rays from a place cross a body's limb: at half of the local brightness, whatever that is.

Flow   place -> rays -> picture, less what their ends show of the sky, and model along them -> where each falls to half ->
       center, size and axes that fit best
Frame  (pixel, line); distances along rays positive outward
Units  px, DN

Of the limb such a reading asks only where it is. What half of the brightness means for a limb that is darkened and blurred
is asked of the model, whose limb is crossed in the same way. Where the picture is saturated the light beside the limb says
where it is: `opnav_workbench.bodies.flanks`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates, median_filter

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.flanks import hidden_limbs, limb_flanks, outermost_fall
from opnav_workbench.bodies.picture import BodyPicture, RayFan, displaced_model
from opnav_workbench.bodies.scales import mixed_solution, scale_precisions
from opnav_workbench.bodies.silhouette import TURN, Outline
from opnav_workbench.constants import MAD_TO_SIGMA, PIXEL_VARIANCE_PX2
from opnav_workbench.render import FigureUncertainty, Lambert, LunarLambert, ScatteringLaw
from opnav_workbench.render.body import PlacedBody

__all__ = [
    "HALF_PX",
    "INTERPOLATED_VARIANCE",
    "RELIEF_RAD",
    "CrossingFit",
    "LimbCrossings",
    "Profiles",
    "cross_limb",
    "crossing_columns",
    "crossing_depths",
    "fit_crossings",
    "radiance_profiles",
]

RAYS = 180
RAY_STEP_PX = 0.25
FAINT_SHARE = 0.04  # of the body's bright part: a limb fainter than that is sky
LEVEL_FROM, LEVEL_TO = 1.5, 4.0  # widths of the PSF inside of the limb that tell the local brightness
FAINT_SIGMAS = 4.0
STEEPER = 0.02  # in the logarithm, over three widths of the PSF: at a limb than behind it
# What the ends of rays show, of most over a quarter of a turn, is sky, stray light or a coma; brighter than such a share of
# the body it is the body's own, or another one's.
END_PX, SKY_RAYS, SKY_SHARE = 4.0, RAYS // 4, 0.25
FLOOR_SHARE = 0.25  # of what is faint: the sky, where light is told in proportion
LIT_MODEL = 0.3  # of the model's brightest part: what shows how bright the body is
INTERPOLATED_VARIANCE = 1.0 / 6.0  # px^2, of a linear interpolation anywhere between two pixels
# Of what an interpolation rests on: usable pixels; of all places, those with enough of them; and where too few have.
WHOLE_SHARE, MOSTLY_WHOLE, LEAST_SHARE = 0.95, 0.5, 0.02
NARROWINGS, NEAREST_PX = 7, 0.3  # of the distance at which a crossing counts half
MORE_AGREE = 1.2  # crossings with another solution than the nearest to the model's figure: of patches there are as many
LEAST_SPREAD_PX = 0.1  # of crossings: half of the local brightness is not quite the limb
HALF_PX = 0.15  # nor where pattern or law are steep at the limb: what lies farther from an outline is of another figure
RELIEF_RAD = 0.2  # of topography along a limb
PATCH_PX = 0.5  # how far a saturated patch behind it may move a crossing
# Of the width of an edge: by what law and PSF, which no flank tells, move all saturated limbs of a body alike (rms of 39).
FLANK_WIDTHS = 0.45
MOST_CHANGED_PX = 2.0  # by a law: beyond, another edge was crossed


@dataclass(frozen=True, slots=True, eq=False)
class LimbCrossings:
    """Crossings of n rays.

    Attributes
    ----------
    angle_rad : (n,) array
    depth_px : (n,) array
        Distance from where a crossing was expected.
    expected, known : (n,) arrays of bool
        Rays that the picture shows and on which the model is lit up to its limb; those that have a crossing.
    changes : (n, k) array
        Of what was expected, by a sigma of each thing that is uncertain of the light.
    sigma_px : (n,) array
        Of each by itself, beyond what crossings scatter by.
    noise_px
        What noise moves one of them by.
    """

    angle_rad: FloatArray
    depth_px: FloatArray
    expected: BoolArray
    known: BoolArray
    changes: FloatArray
    sigma_px: FloatArray
    noise_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def beyond(self, other: "LimbCrossings") -> "LimbCrossings":
        """Return how far these lie outside of others of the same rays, where both have one."""
        return replace(self, depth_px=self.depth_px - other.depth_px, known=self.known & other.known)


def crossing_depths(profile: FloatArray, depth_px: FloatArray, width_px: float, faint: float) -> FloatArray:
    """Return where profiles (n, m) over depths (m,) first exceed, from outside, half of what lies behind; nan without.

    Stray light rises toward a bright body over many pixels: at a limb it rises, in proportion, as it does no more behind.
    """
    step = float(depth_px[1] - depth_px[0])
    m, width = profile.shape[1], width_px / step
    run = max(2, round(1.5 * width))
    near, far = round(LEVEL_FROM * width), round(LEVEL_TO * width)
    at, rows = np.arange(m), np.arange(len(profile))
    above = np.cumsum(profile > faint, axis=1)
    lasting = np.concatenate([above[:, :run], above[:, run:] - above[:, :-run]], axis=1) >= run
    level = np.log(np.maximum(profile, FLOOR_SHARE * faint))
    rise = level[:, np.maximum(at - near, 0)] - level[:, np.minimum(at + near, m - 1)]
    lasting &= rise > STEEPER + rise[:, np.maximum(at - 2 * near, 0)]
    last = m - 1 - lasting[:, ::-1].argmax(axis=1)
    sums = np.concatenate([np.zeros((len(profile), 1)), np.cumsum(profile, axis=1)], axis=1)
    high, low = np.clip(last - near, 1, m), np.clip(last - far, 0, m - 1)
    half = np.maximum(0.5 * (sums[rows, high] - sums[rows, low]) / np.maximum(high - low, 1), faint)
    over = (at < np.minimum(last + run, m)[:, None]) & (profile > half[:, None])
    crossing, _ = outermost_fall(profile, depth_px, over, half)
    found = over.any(axis=1) & lasting.any(axis=1) & (high > low)
    return np.where(found, crossing, np.nan)


Profiles = Callable[[Outline, FloatArray, FloatArray], FloatArray]


def cross_limb(picture: BodyPicture, outline: Outline, reach_px: float, profiles: Profiles) -> LimbCrossings:
    """Cross the limb along rays, as far as `reach_px` from the outline, and compare with the model's crossings.

    Parameters
    ----------
    profiles
        Returns the model's light (1 + k, n, m) at angles (n,) and depths (m,) of an outline, any unit: as it is, and
        changed by a sigma of each of k things that are uncertain.
    """
    angle = np.asarray((np.arange(RAYS) + 0.5) * (TURN / RAYS))
    limb = outline.radius(angle)
    # Cells end at the limb: which of them a body's light reaches is then no matter of rounding.
    inward = int(min(reach_px + 8.0, float(limb.min())) / RAY_STEP_PX)
    depth = np.arange(-inward + 0.5, (reach_px + 4.0) / RAY_STEP_PX) * RAY_STEP_PX
    wheel = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    places = outline.center_px + (limb[:, None] + depth)[..., None] * wheel[:, None]
    data, valid = _sampled(picture, places)
    data = np.where(valid, data, 0.0)
    each = profiles(outline, angle, depth)
    model = each[0]
    width = max(1.0, 1.2 * float(np.max(picture.psf.sigma_px)))
    lit = valid & (model > LIT_MODEL * model.max(initial=0.0))
    bright = float(np.median(data[lit])) if lit.any() else float(np.max(data))
    noise = picture.typical_noise_dn
    faint = max(FAINT_SHARE * bright, FAINT_SIGMAS * noise)
    sky = _sky_beside(data, valid, SKY_SHARE * bright)
    if sky.max() < faint:  # all of it is dark: no more than a PSF has in its wings
        sky = np.zeros(RAYS)
    observed = crossing_depths(data - sky[:, None], depth, width, faint)
    middle = float(np.median(model[lit])) if lit.any() else 1.0
    crossed = np.stack([crossing_depths(light, depth, width, FAINT_SHARE * middle) for light in each])
    sigma, alike = np.zeros(RAYS), np.zeros((0, RAYS))
    if picture.saturated.any():
        behind = np.abs(depth - np.nan_to_num(observed)[:, None] + 0.5 * LEVEL_TO * width)
        near = np.any((behind < 0.5 * LEVEL_TO * width) & _touches(picture.saturated, places), axis=1)
        observed, sigma, alike = _of_saturated(picture, noise, data, valid, depth, observed, near)
    expected = crossed[0]
    index = np.clip(np.searchsorted(depth, np.nan_to_num(observed)), 1, len(depth) - 2)
    rows = np.arange(RAYS)
    whole = valid[rows, index] & valid[rows, index + 1] & valid[rows, index - 1]
    at_limb = np.isfinite(expected) & (np.abs(expected) < 2.0 * width)
    known = np.isfinite(observed) & at_limb & whole & (observed < depth[-8])
    changes = np.nan_to_num(np.concatenate([crossed[1:] - expected, alike])).T
    changes = np.clip(changes, -MOST_CHANGED_PX, MOST_CHANGED_PX)
    away = observed - np.where(at_limb, expected, 0.0)
    return LimbCrossings(
        angle, away, at_limb & whole, known, changes, sigma, _noise_px(picture, noise, bright)
    )


def _sky_beside(data: FloatArray, valid: BoolArray, most_dn: float) -> FloatArray:
    """Return the light (n,) beside the limb, as the ends of rays (n, m) show it; more than the most is none of the sky."""
    end = np.s_[:, -round(END_PX / RAY_STEP_PX) :]
    level = data[end].mean(axis=1)
    seen = valid[end].all(axis=1) & (level < most_dn)
    if not seen.any():
        return np.zeros(len(data))
    level = np.where(seen, level, np.median(level[seen]))
    return np.asarray(median_filter(level, SKY_RAYS, mode="wrap"))


def _of_saturated(
    picture: BodyPicture,
    noise_dn: float,
    data: FloatArray,
    valid: BoolArray,
    depth: FloatArray,
    half_px: FloatArray,
    near: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return crossings of rays (n, m) that are at half (n,) of the brightness, or on a flank where the limb is saturated.

    `near` says where something saturated is close behind. Second their sigmas (n,), then what moves flanks alike (1, n).
    """
    width, level = float(np.sqrt(_edge_variance(picture))), picture.saturation_dn
    hidden = near & hidden_limbs(data, depth, level, half_px, width)
    flanks = limb_flanks(
        data[hidden], valid[hidden], depth, level, width, noise_dn, 1.0 / picture.shot_gain_e_per_dn
    )
    observed, sigma = half_px.copy(), np.where(near, PATCH_PX, 0.0)
    observed[hidden], sigma[hidden] = flanks.depth_px, flanks.sigma_px
    return observed, sigma, np.where(hidden, FLANK_WIDTHS * width, 0.0)[None]


def _noise_px(picture: BodyPicture, noise_dn: float, bright_dn: float) -> float:
    """Return what noise moves a crossing by, of a limb so bright: at half of it, over the slope of a blurred edge."""
    half = 0.5 * max(bright_dn, 0.0)
    noise = np.sqrt(noise_dn**2 + half / picture.shot_gain_e_per_dn)
    return float(np.sqrt(TURN * _edge_variance(picture)) * noise / max(bright_dn, noise))


def _edge_variance(picture: BodyPicture) -> float:
    """Return the variance, px^2, that PSF, pixels and interpolation spread an edge by."""
    return float(np.max(picture.psf.sigma_px)) ** 2 + PIXEL_VARIANCE_PX2 + INTERPOLATED_VARIANCE


def radiance_profiles(picture: BodyPicture, name: str, size_ratio: float) -> Profiles:
    """Return profiles of the body's radiance, spread along the rays as by the PSF: good to a tenth of a pixel.

    An unknown law, which is called Lambert's, is half of that and half of Lommel-Seeliger's, or either; a law that was given
    may be as far from its own toward that.
    """
    law: ScatteringLaw = picture.model(name).law
    between = LunarLambert(0.5)
    laws = (between, law) if isinstance(law, Lambert) else (law, between)

    def profiles(outline: Outline, angle: FloatArray, depth: FloatArray) -> FloatArray:
        seen = displaced_model(picture, name, outline.center_px, 1.0 / size_ratio)
        limb = outline.radius(angle)
        share = 1.0 + depth / limb[:, None]
        lowest, most = float(share.min()), float(share.max())
        fan = RayFan(picture, outline.center_px, angle, most * limb, lowest / most)
        line = np.broadcast_to(np.arange(len(angle))[:, None], share.shape)
        rays = fan.at(line.ravel(), share.ravel() / most)
        bodies = [PlacedBody(replace(seen, law=law), picture.camera.pixel_scale_rad) for law in laws]
        light = np.stack([body.radiance(rays).reshape(share.shape) for body in bodies])
        sigma = float(np.sqrt(_edge_variance(picture))) / RAY_STEP_PX
        return np.asarray(gaussian_filter1d(light, sigma, axis=2, mode="nearest"))

    return profiles


def _sampled(picture: BodyPicture, places: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the picture at places (n, m, 2), and which of them show it.

    Where most of them touch a missing pixel, as with every other line lost, those that are left have to do for both.
    """
    usable = picture.shown()
    where = [places[..., 1], places[..., 0]]
    data = map_coordinates(np.where(usable, picture.signal_dn, 0.0), where, order=1, mode="nearest")
    n_line, n_pixel = usable.shape
    inside = (
        (places[..., 0] >= 0)
        & (places[..., 0] <= n_pixel - 1)
        & (places[..., 1] >= 0)
        & (places[..., 1] <= n_line - 1)
    )
    if not usable.all():
        share = map_coordinates(usable.astype(np.float64), where, order=1, mode="nearest")
        whole = share > WHOLE_SHARE
        if np.mean(whole) < MOSTLY_WHOLE:
            whole, data = share > LEAST_SHARE, data / np.maximum(share, LEAST_SHARE)
        inside &= whole
    return data, inside


def _touches(plane: BoolArray, places: FloatArray) -> BoolArray:
    """Return whether places (n, m, 2) lie on marked pixels."""
    index = np.rint(places).astype(np.int64)
    pixel, line = (np.clip(index[..., k], 0, plane.shape[1 - k] - 1) for k in (0, 1))
    return np.asarray(plane[line, pixel])


@dataclass(frozen=True, slots=True, eq=False)
class CrossingFit:
    """What most crossings agree with.

    Attributes
    ----------
    step_px : (2,) array
        Of the center from that of the outline.
    log_size
        Change of the outline's size.
    strain : (2,) array
        Change of its radius as cos 2a and sin 2a.
    covariance : (5, 5) array
        Of all five, from the scatter of the crossings and its correlation along the limb.
    residual_px : (n,) array
        nan where there is no crossing.
    relief_px
        How far most of the limb is from any such outline, beyond what half of the brightness may be: 1 sigma.
    relief_px2 : (2, 2) array
        Covariance of the center by that: a figure that is not the model's has its middle elsewhere, and its light as well.
    free_log_size, free_size_sigma
        Change of the size and its uncertainty, as if nothing were known of the figure but its widest bounds.
    patterned
        Whether crossings are told from those of a fitted albedo, and not of an even body.
    """

    step_px: FloatArray
    log_size: float
    strain: FloatArray
    covariance: FloatArray
    residual_px: FloatArray
    relief_px: float
    relief_px2: FloatArray
    free_log_size: float
    free_size_sigma: float
    patterned: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)


def fit_crossings(
    crossings: LimbCrossings,
    outline: Outline,
    figure: FigureUncertainty,
    relief_px: float,
    mean: FloatArray,
    near_px: float,
    *,
    far: bool = False,
) -> CrossingFit:
    """Fit center, size and strain to crossings, with weights that narrow from `near_px` on.

    Parameters
    ----------
    figure
        How far size and axes may be from the model's.
    relief_px
        Scatter of the limb about its outline.
    mean : (3,) array
        Where the model has log size and strain, as changes of the outline.
    far
        Begin as well with weights as wide as most crossings are from the model's figure, if clearly more agree then.
    """
    known, uncertain = crossings.known, np.ones(crossings.changes.shape[1])
    moving = crossing_columns(crossings.angle_rad, outline)
    columns = np.concatenate([moving, crossings.changes], axis=1)[known]
    precision = np.concatenate([[1e-9, 1e-9, 0.0, 0.0, 0.0], uncertain])
    expected = np.concatenate([[0.0, 0.0], mean, 0.0 * uncertain])
    equations = _CrossingEquations(columns, crossings.depth_px[known], expected, precision)
    scales, widest = _figure_scales(figure, len(precision))
    nearest, typical = max(NEAREST_PX, relief_px), float(np.median(np.abs(equations.left(expected))))
    solution = equations.narrowed(near_px, nearest, widest)
    if far and typical > near_px:
        wide = equations.narrowed(typical, nearest, widest)
        agree, agree_wide = (float(equations.weights(each, nearest).sum()) for each in (solution, wide))
        solution = wide if agree_wide > MORE_AGREE * agree else solution
    residual = np.full(len(known), np.nan)
    residual[known] = equations.left(solution)
    # Relief is no noise: neighbours along a limb share it, and the figure is changed only where many agree on it.
    spread, alike = _scatter(residual)
    common = (1.0 + alike) / (1.0 - alike)
    variance = common * spread**2 + 2.0 * RELIEF_RAD * RAYS / TURN * relief_px**2
    own = crossings.sigma_px[known] ** 2
    each = variance + own
    free = float(equations.solved(solution, nearest, each, widest)[2])
    solution = equations.solved(solution, nearest, each, scales)
    residual[known] = equations.left(solution)
    # Every crossing counts for the covariance, those far off as if they lay where their weights leave them.
    kept = columns @ (solution - expected) + equations.weights(solution, nearest) * residual[known]
    normal = columns.T @ (columns / each[:, None]) + np.diag(precision)
    mixed, alone = (
        mixed_solution(normal, columns.T @ (kept / each), one).covariance for one in (scales, widest)
    )
    size_sigma = float(np.sqrt(alone[2, 2]))
    beyond_px2 = max(alike * spread**2 - HALF_PX**2 - crossings.noise_px**2 - float(np.median(own)), 0.0)
    relief = float(np.sqrt(beyond_px2)), mixed[:2, :2] * (common * beyond_px2 / variance)
    center = solution[:2], float(solution[2]), solution[3:5], mixed[:5, :5]
    return CrossingFit(*center, residual, *relief, free, size_sigma)


class _CrossingEquations(NamedTuple):
    """What m crossings say of p unknowns: columns (m, p), offsets (m,); mean and precision (p,) of what is known of them."""

    columns: FloatArray
    offset: FloatArray
    expected: FloatArray
    precision: FloatArray

    def left(self, solution: FloatArray) -> FloatArray:
        """Return what a solution leaves of the offsets."""
        return np.asarray(self.offset - self.columns @ solution)

    def weights(self, solution: FloatArray, near: float) -> FloatArray:
        """Return how much each counts: half or less, beyond `near` times 0.64 of a solution."""
        return np.asarray((1.0 + (self.left(solution) / near) ** 2) ** -2.0)

    def solved(
        self, solution: FloatArray, near: float, variance: FloatArray | float, scales: FloatArray
    ) -> FloatArray:
        """Return the solution with the weights by another one."""
        weight = self.weights(solution, near) / variance
        normal = self.columns.T @ (self.columns * weight[:, None]) + np.diag(self.precision)
        right = self.columns.T @ (weight * self.left(self.expected))
        return np.asarray(self.expected + mixed_solution(normal, right, scales).theta)

    def narrowed(self, near: float, nearest: float, scales: FloatArray) -> FloatArray:
        """Return the solution with weights that narrow from the model's figure on."""
        there = self.expected
        for _ in range(NARROWINGS):
            there = self.solved(there, near, near**2, scales)
            near = max(0.5 * near, nearest)
        return there


def _figure_scales(figure: FigureUncertainty, unknowns: int) -> tuple[FloatArray, FloatArray]:
    """Return the precisions of size and axes by their scales, and by the widest that they may have.

    A limb that is not the model's must not be lost, whatever was stated of it.
    """
    unstated = FigureUncertainty()
    bounds = max(figure.size_sigma, unstated.size_sigma), max(figure.axes_sigma, unstated.axes_sigma)
    return (
        scale_precisions(unknowns, ([2], figure.size_scales), ([3, 4], figure.axes_scales)),
        scale_precisions(unknowns, ([2], [bounds[0]]), ([3, 4], [bounds[1]])),
    )


def crossing_columns(angle: FloatArray, outline: Outline) -> FloatArray:
    """Return the change (n, 5) of radii at angles with center (px), log size and strain."""
    limb = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=TURN) / limb
    u = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-u[:, 1], u[:, 0]], axis=-1)
    grown = limb * np.stack([np.ones_like(limb), *Outline.waves(angle, slope)])
    return np.concatenate([u - slope[:, None] * across, grown.T], axis=1)


def _scatter(residual: FloatArray) -> tuple[float, float]:
    """Return the spread of crossings (n,), nan where there is none, and how much neighbours are alike."""
    known = residual[np.isfinite(residual)]
    if not len(known):
        return np.inf, 0.0
    spread = max(MAD_TO_SIGMA * float(np.median(np.abs(known))), LEAST_SPREAD_PX)
    even = np.clip(np.nan_to_num(residual) / spread, -3.0, 3.0)
    both = np.isfinite(residual) & np.isfinite(np.roll(residual, 1))
    alike = float(np.sum(even[both] * np.roll(even, 1)[both]) / max(float(np.sum(even[both] ** 2)), 1e-9))
    return spread, float(np.clip(alike, 0.0, 0.95))
