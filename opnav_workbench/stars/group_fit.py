"""One batch of equally large groups of stars fitted: where each fit starts, its solution, the hits in it, star by star.

Start  The place in the search area where a star of the expected shape is most significant; for a group, where it fits
       best as a pattern.
Hits   Pixels that no star explains: cosmic rays, hot pixels, unlisted neighbors. A pixel's residual is compared with
       its own standard deviation: noise v (1 - h), with h the leverage of the pixel on its fit, and what an error of
       the PSF model would leave. A hit is far sharper than the PSF, so it stands out even where the fit followed it.

Reference: studentized residuals, Cook & Weisberg (1982), Residuals and Influence in Regression, chapter 2.
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import binary_dilation, maximum_filter

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.stars.boxes import Boxes, Pixels, box_corners, cut_at, cut_boxes
from opnav_workbench.stars.levenberg_marquardt import BatchSolution, ModelEvaluation, solve_batched
from opnav_workbench.stars.peaks import refine_peaks
from opnav_workbench.stars.results import NoiseModel
from opnav_workbench.stars.star_model import PER_STAR, StarModel, StarProfile

__all__ = ["FitSettings", "FittedStars", "best_starts", "fit_groups"]


# ---- First guess of a fit: where in their search area stars of the expected shape are most significant.

KERNEL_SIGMAS = 2.0
MIN_KERNEL_HALF_PX = 1
SHIFT_STEP_PX = 0.5
SHIFT_SIGMA_PX = 0.5  # starts of a group are about this good: decides only where the fit cannot


def most_significant(
    pixels: Pixels, start: FloatArray, profile: StarProfile, search_radius_px: float
) -> FloatArray:
    """Return the most significant point within `search_radius_px` of each start, along each axis; (n, 2).

    At every pixel of the search area flux and background level are solved linearly; the pixel where flux over
    its sigma is largest wins, and a paraboloid gives the fraction. Without a single positive flux the start
    itself is returned.
    """
    reach = int(np.ceil(search_radius_px))
    half = max(MIN_KERNEL_HALF_PX, int(np.ceil(KERNEL_SIGMAS * profile.reach_px)))
    if reach == 0 or len(start) == 0:
        return start
    boxes = cut_boxes(pixels, start, 2 * (reach + 1 + half) + 1)
    kernel = profile.value(np.zeros((1, 2)), np.full((1, 2), -half), 2 * half + 1)[0]
    snr = _significance(boxes.data_dn, boxes.weight, kernel)  # (n, 2 reach + 3, 2 reach + 3)
    side, origin = snr.shape[-1], boxes.first + half
    allowed = np.abs(np.arange(side) + (origin - start)[:, :, None]) <= search_radius_px
    allowed[:, :, [0, -1]] = False  # a paraboloid needs all neighbors
    flat = np.where(allowed[:, 1, :, None] & allowed[:, 0, None, :], snr, -np.inf).reshape(len(start), -1)
    best = flat.argmax(axis=1)
    row, column = np.divmod(best, side)
    fraction, _ = refine_peaks(snr, row, column)
    found = origin + np.stack([column, row], axis=1) + fraction
    found = np.clip(found, start - search_radius_px, start + search_radius_px)
    positive = flat[np.arange(len(start)), best] > 0.0
    return np.where(positive[:, None], found, start)


def best_shift(model: StarModel, start: FloatArray, guess: FloatArray, search_radius_px: float) -> FloatArray:
    """Return where groups of stars (g, k, 2) fit best, as patterns: all fluxes are solved at each trial shift.

    Tried are no shift, and those that put each star where it is found for itself (`guess`): for all but one of
    them that is often their brightest neighbor. Of places that fit equally well (one star alone in the picture)
    the nearest is taken.
    """
    k = start.shape[1]
    shifts = [np.zeros((len(start), 2)), *(guess[:, i] - start[:, i] for i in range(k))]
    tried = [_refined_shift(model, start, _refined_shift(model, start, shift)) for shift in shifts]
    cost = np.stack([_shift_cost(model, start, shift, search_radius_px) for shift in tried])
    best = np.stack(tried)[cost.argmin(axis=0), np.arange(len(start))]
    return start + np.where(np.isfinite(cost.min(axis=0))[:, None], best, 0.0)[:, None]


def _refined_shift(model: StarModel, start: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the shift (g, 2) at the top of a paraboloid through the fits half a pixel around."""
    steps = SHIFT_STEP_PX * np.array([-1.0, 0.0, 1.0])
    around = [[shift + np.array([x, y]) for x in steps] for y in steps]
    surface = np.stack([[_shift_cost(model, start, trial, np.inf) for trial in row] for row in around])
    middle = np.ones(len(start), np.int64)
    offset, _ = refine_peaks(-surface.transpose(2, 0, 1), middle, middle)
    return shift + SHIFT_STEP_PX * offset


def _shift_cost(
    model: StarModel, start: FloatArray, shift: FloatArray, search_radius_px: float
) -> FloatArray:
    """Chi-square of groups at a shift (g, 2), and what the shift itself costs; (g,)."""
    state = model(np.arange(len(start)), model.linear_start(start + shift[:, None]))
    chi2 = np.sum(state.residual**2 / model.variance, axis=1) + np.sum((shift / SHIFT_SIGMA_PX) ** 2, axis=1)
    return np.where(np.all(np.abs(shift) <= search_radius_px, axis=1), chi2, np.inf)


def _significance(data: FloatArray, weight: FloatArray, kernel: FloatArray) -> FloatArray:
    """Flux over its sigma of a star at each pixel, its background level free; 0 where it cannot be had."""

    def correlate(values: FloatArray, taps: FloatArray) -> FloatArray:
        windows = sliding_window_view(values, taps.shape, axis=(1, 2))
        return np.asarray(np.einsum("nyxij,ij->nyx", windows, taps, optimize=True))

    ones = np.ones_like(kernel)
    s, st, stt = correlate(weight, ones), correlate(weight, kernel), correlate(weight, kernel**2)
    sd, std = correlate(weight * data, ones), correlate(weight * data, kernel)
    det = s * stt - st**2
    solvable = det > 1e-9 * s * stt
    scale = np.sqrt(np.where(solvable, s * det, 1.0))
    return np.where(solvable, (s * std - st * sd) / scale, 0.0)


# ---- Pixels that no star explains: cosmic rays, hot pixels, unlisted neighbors within a fitted box.

HIT_SIGMAS = 5.0  # noise does this once in 3 million pixels, some 20 000 stars
SKIRT_SIGMAS = 3.0  # pixels beside a hit that it also touched
MIN_PIXEL_FREEDOM = 0.02  # 1 - leverage: a pixel that alone decides its own fit cannot be judged
PSF_TOLERANCE = 0.1  # of the star's light in a pixel or beside it: no real PSF is known better at every phase
WING_TOLERANCE = 0.01  # of a star's flux in any pixel of the box: wings, ghosts, spikes that the model lacks
EIGHT_NEIGHBORS = np.ones((1, 3, 3), bool)


def find_hits(
    final: ModelEvaluation, covariance: FloatArray, light: FloatArray, psf_error: float, size: int
) -> BoolArray:
    """Return True for pixels with light that is not the stars'; (g, size, size).

    Parameters
    ----------
    final
        The fit at its end, g boxes of m = size^2 pixels.
    covariance : (g, q, q) array
        Of the fitted parameters, from the noise alone.
    light : (g, m) array
        Of the fitted stars.
    psf_error
        Relative error of the PSF model, where it is known to be larger than `PSF_TOLERANCE`.
    """
    used = final.weight > 0.0
    gain = np.matmul(covariance, final.jacobian)  # (g, q, m)
    free = 1.0 - final.weight * np.sum(gain * final.jacobian, axis=1)
    judged = used & (free > MIN_PIXEL_FREEDOM)
    noise = np.where(judged, free / np.where(used, final.weight, 1.0), 1.0)
    significance = np.where(judged, final.residual / np.sqrt(noise), 0.0)
    suspect = np.flatnonzero((significance > HIT_SIGMAS).any(axis=1))
    tolerated = _tolerated_variance(final, gain, light, psf_error, size, suspect)
    significance[suspect] /= np.sqrt(1.0 + tolerated / noise[suspect])
    boxes = significance.reshape(-1, size, size)
    peak = boxes > HIT_SIGMAS
    if not peak.any():
        return peak
    return np.asarray(peak | (binary_dilation(peak, EIGHT_NEIGHBORS) & (boxes > SKIRT_SIGMAS)))


def _tolerated_variance(
    final: ModelEvaluation, gain: FloatArray, light: FloatArray, psf_error: float, size: int, rows: IntArray
) -> FloatArray:
    """Variance (k, m) of the residuals of some boxes from errors of the PSF model.

    With K = J C J'W the fit's part of the data, an error of variance D of the pixels leaves the residuals
    (1 - K) D (1 - K)'.
    """
    boxes = light[rows].reshape(-1, size, size)
    beside = maximum_filter(boxes, size=(1, 3, 3)).reshape(len(rows), size**2)
    error = max(PSF_TOLERANCE, 2.0 * psf_error) * beside
    error += WING_TOLERANCE * np.maximum(boxes.sum(axis=(1, 2)), 0.0)[:, None]
    variance = np.where(final.weight[rows] > 0.0, error**2, 0.0)
    followed = np.matmul(np.swapaxes(final.jacobian[rows], 1, 2), gain[rows]) * final.weight[rows, None]
    own = np.einsum("kmm->km", followed)
    return np.asarray(np.matmul(followed**2, variance[:, :, None])[:, :, 0] + (1.0 - 2.0 * own) * variance)


# ---- One batch of equally large groups of stars fitted.

MIN_FREEDOM = 1.0  # one pixel more than what is estimated from them
REACH_PART = 0.5  # of the distance to its neighbor that a star of a group may move from where it is sought
MIN_REACH_PX = 0.75
MIN_SEARCH_PX = 0.5


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How stars are fitted; see `fit_gaussian`."""

    size: int
    background: Literal["level", "plane"]
    noise_model: NoiseModel | None
    psf_error: float
    search_radius_px: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedStars:
    """What a fit says of each of n stars; members of a group have chi-square and freedom of the group."""

    parameters: FloatArray  # (n, 3 + n_shape) flux, pixel, line, shape
    covariance: FloatArray  # (n, 3 + n_shape, 3 + n_shape) from the noise alone
    psf_covariance: FloatArray  # what the error of the PSF model adds to it
    common_px: (
        FloatArray  # (n, 2, r) what one-sigma errors of a PSF that was learned make of all centers at once
    )
    background_dn: FloatArray  # (n,) at the star
    chi2: FloatArray  # (n,)
    psf_chi2: FloatArray  # (n,) what the error of the PSF model adds to it
    freedom: FloatArray  # (n,) degrees of freedom, 0 where the fit is not determined
    converged: BoolArray  # (n,)
    at_bound: BoolArray  # (n,)
    determined: BoolArray  # (n,)
    first: IntArray  # (n, 2) of the star's box
    model_dn: FloatArray  # (n, size, size) stars and background
    sigma_dn: FloatArray  # (n, size, size) noise of the pixels, infinite where unused

    @classmethod
    def empty(cls, n: int, n_shape: int, size: int, n_errors: int = 0) -> "FittedStars":
        """Return rows to be filled."""
        q = PER_STAR + n_shape
        return cls(
            parameters=np.zeros((n, q)),
            covariance=np.zeros((n, q, q)),
            psf_covariance=np.zeros((n, q, q)),
            common_px=np.zeros((n, 2, n_errors)),
            background_dn=np.zeros(n),
            chi2=np.zeros(n),
            psf_chi2=np.zeros(n),
            freedom=np.zeros(n),
            converged=np.zeros(n, bool),
            at_bound=np.zeros(n, bool),
            determined=np.zeros(n, bool),
            first=np.zeros((n, 2), np.int64),
            model_dn=np.zeros((n, size, size)),
            sigma_dn=np.zeros((n, size, size)),
        )

    def fill(self, index: IntArray, rows: "FittedStars") -> None:
        """Put the rows of the stars `index` into their places."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(rows, field.name)


def fit_groups(
    pixels: Pixels,
    start: FloatArray,
    profile: StarProfile,
    settings: FitSettings,
    *,
    searched: bool = True,
    darkest: float = -np.inf,
) -> tuple[FittedStars, IntArray]:
    """Fit groups of stars that start at (g, k, 2), each group with one background and one shape.

    Parameters
    ----------
    searched
        Begin where stars are most significant around, and not right there.
    darkest
        Part of a group's light below which none of its stars may come: its fit ends there, not converged.

    Returns
    -------
    rows : FittedStars
        Of the g * k stars, group by group.
    hits : (h, 3) array of int
        Pixels that no star explains: group, line, pixel.
    """
    guess = _fit_starts(pixels, start, profile, settings) if searched else start
    k = start.shape[1]
    corners = box_corners(pixels, guess.reshape(-1, 2), settings.size).reshape(-1, k, 2)
    boxes = _group_boxes(pixels, corners, settings.size)
    model = StarModel.of(boxes, settings.noise_model, profile, settings.background, k)
    model = replace(model, light_solved=darkest > -np.inf)
    p0 = model.linear_start(guess)
    lower, upper = _parameter_bounds(model, p0, guess, start, settings.search_radius_px)
    mean, information = np.zeros_like(p0), np.zeros_like(p0)
    mean[:, model.shape_columns] = profile.mean
    information[:, model.shape_columns] = profile.information

    def hopeless(p: FloatArray) -> BoolArray:
        flux = p[:, model.flux_columns]
        return np.asarray(flux.min(axis=1) < darkest * flux.sum(axis=1))

    solution = solve_batched(
        model, p0, lower, upper, mean, information, hopeless=hopeless if darkest > -np.inf else None
    )
    freedom = _freedom(solution, model, information)
    # A group that is not determined has no covariance; zeros keep the algebra below finite.
    covariance = np.where((freedom > 0.0)[:, None, None], solution.covariance, 0.0)
    light = model.light(solution.parameters, solution.final)
    hits = find_hits(solution.final, covariance, light, settings.psf_error, model.size)
    where = np.argwhere(hits & (freedom > 0.0)[:, None, None])
    where[:, 1:] += boxes.first[where[:, 0], ::-1]
    return _star_by_star(solution, covariance, freedom, model, corners, settings), where


def _fit_starts(pixels: Pixels, start: FloatArray, profile: StarProfile, settings: FitSettings) -> FloatArray:
    """Where the fit begins (g, k, 2): a star alone where it is most significant, a group where all of it fits."""
    g, k = start.shape[:2]
    places, reach = start.reshape(-1, 2), settings.search_radius_px
    alone = most_significant(pixels, places, profile, reach).reshape(g, k, 2)
    if k == 1:
        return alone
    size = settings.size + 2 * int(np.ceil(reach))
    boxes = _group_boxes(pixels, box_corners(pixels, places, size).reshape(g, k, 2), size)
    return best_shift(StarModel.of(boxes, None, profile, "level", k), start, alone, reach)


def best_starts(
    pixels: Pixels, starts: FloatArray, profile: StarProfile, settings: FitSettings, most: int
) -> FloatArray:
    """Return those of groups of stars (g, k, 2) that explain most where they are, fluxes and level free; (most, k, 2)."""
    corners = box_corners(pixels, starts.reshape(-1, 2), settings.size).reshape(*starts.shape)
    model = StarModel.of(
        _group_boxes(pixels, corners, settings.size), None, profile, "level", starts.shape[1]
    )
    cost = _shift_cost(model, starts, np.zeros((len(starts), 2)), np.inf)
    return starts[np.argsort(cost, kind="stable")[:most]]


def _group_boxes(pixels: Pixels, corners: IntArray, size: int) -> Boxes:
    """Boxes that hold all boxes of their group; what lies in none of these has no weight."""
    k = corners.shape[1]
    first = corners.min(axis=1)
    if k == 1:
        return cut_at(pixels, first, size)
    inner = corners - first[:, None]
    side = int(inner.max(initial=0)) + size
    boxes = cut_at(pixels, first, side)
    step = np.arange(side) - inner[..., None]  # (g, k, axis, side)
    within = (step >= 0) & (step < size)
    covered = np.any(within[:, :, 1, :, None] & within[:, :, 0, None, :], axis=1)
    return Boxes(
        first, boxes.data_dn, np.where(covered, boxes.variance_dn2, np.inf),
        boxes.bad, boxes.saturated, boxes.outside,
    )  # fmt: skip


def _parameter_bounds(
    model: StarModel, p0: FloatArray, guess: FloatArray, start: FloatArray, search_radius_px: float
) -> tuple[FloatArray, FloatArray]:
    """A star alone may go as far as it is searched; members of a group stay apart."""
    g, k = guess.shape[:2]
    lower, upper = np.full_like(p0, -np.inf), np.full_like(p0, np.inf)
    search = max(search_radius_px, MIN_SEARCH_PX)
    low, high = start - search, start + search
    if k > 1:
        distance = np.hypot(*(guess[:, :, None] - guess[:, None]).transpose(3, 0, 1, 2))
        distance[:, np.arange(k), np.arange(k)] = np.inf
        reach = np.maximum(REACH_PART * distance.min(axis=2), MIN_REACH_PX)[..., None]
        low, high = np.maximum(low, guess - reach), np.minimum(high, guess + reach)
    columns = model.center_columns.ravel()
    lower[:, columns], upper[:, columns] = low.reshape(g, -1), high.reshape(g, -1)
    lower[:, model.shape_columns], upper[:, model.shape_columns] = model.profile.bounds
    return lower, upper


def _freedom(solution: BatchSolution, model: StarModel, information: FloatArray) -> FloatArray:
    """Pixels less parameters taken from them, 0 where there are too few; (g,)."""
    used = np.isfinite(model.variance).sum(axis=1)
    # What the prior determines is not taken from the data: the effective number of parameters.
    held = np.sum(information * np.diagonal(solution.covariance, axis1=1, axis2=2), axis=1)
    freedom = used - information.shape[1] + held
    return np.where(solution.determined & (freedom >= MIN_FREEDOM), freedom, 0.0)


def _star_by_star(
    solution: BatchSolution, covariance: FloatArray, freedom: FloatArray, model: StarModel, corners: IntArray,
    settings: FitSettings,
) -> FittedStars:  # fmt: skip
    """Take the groups apart: the columns, the marginal covariance and the own box of each star."""
    p, k, final = solution.parameters, model.members, solution.final
    shape = np.arange(model.shape_columns.start, model.shape_columns.stop)
    own = np.hstack([PER_STAR * np.arange(k)[:, None] + np.arange(PER_STAR), np.tile(shape, (k, 1))])
    blocks = np.index_exp[:, own[:, :, None], own[:, None, :]]
    added, excess, common = _psf_error(solution, covariance, model, settings.psf_error)
    sigma = np.where(
        final.weight > 0.0, 1.0 / np.sqrt(np.where(final.weight > 0.0, final.weight, 1.0)), np.inf
    )
    windows = corners - corners.min(axis=1, keepdims=True)
    center = p[:, model.center_columns]

    def flat(values: FloatArray) -> FloatArray:
        return values.reshape(values.shape[0] * values.shape[1], *values.shape[2:])

    def repeat(values: FloatArray) -> FloatArray:
        return np.repeat(values, k, axis=0)

    return FittedStars(
        parameters=flat(p[:, own]),
        covariance=flat(covariance[blocks]),
        psf_covariance=flat(added[blocks]),
        common_px=flat(common[:, model.center_columns]),
        background_dn=flat(model.background_at(center, p)),
        chi2=repeat(solution.chi2),
        psf_chi2=repeat(excess),
        freedom=repeat(freedom),
        converged=np.repeat(solution.converged, k),
        at_bound=solution.at_bound[:, model.center_columns].any(axis=2).ravel(),
        determined=np.repeat(freedom > 0.0, k),
        first=corners.reshape(-1, 2),
        model_dn=_windows(model.data - final.residual, windows, model.size, settings.size),
        sigma_dn=_windows(sigma, windows, model.size, settings.size),
    )


def _psf_error(
    solution: BatchSolution, covariance: FloatArray, model: StarModel, error: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance that errors of the PSF model add, and their chi2: a fraction of each star's light, and what was learned.

    The last item is what each one-sigma error of the latter makes of the parameters, (g, q, r).

    With C the inverse normal matrix, parameters follow the data by C J'W, so a covariance V adds C J'W V WJ C.
    """
    final = solution.final
    learned = model.psf_errors(solution.parameters)
    added, chi2 = np.zeros_like(covariance), np.zeros(len(covariance))
    moved = np.zeros((*covariance.shape[:2], 0))
    if error == 0.0 and learned is None:
        return added, chi2, moved
    gain = np.matmul(covariance, final.jacobian * final.weight[:, None, :])
    if error > 0.0:
        variance = (error * model.light(solution.parameters, final)) ** 2
        added = np.matmul(gain * variance[:, None, :], np.swapaxes(gain, 1, 2))
        chi2 = np.sum(final.weight * variance, axis=1)
    if learned is not None:
        moved = np.matmul(gain, learned)
        added = added + np.matmul(moved, np.swapaxes(moved, 1, 2))
        chi2 = chi2 + np.einsum("gm,gmr->g", final.weight, learned**2)
    return added, chi2, moved


def _windows(values: FloatArray, corner: IntArray, side: int, size: int) -> FloatArray:
    """Cut each star's own box (g k, size, size) out of what fills the box of its group (g, side^2)."""
    g, k = corner.shape[:2]
    boxes = values.reshape(g, side, side)
    if k == 1:
        return boxes
    line, pixel = (corner[:, :, axis, None] + np.arange(size) for axis in (1, 0))
    group = np.arange(g)[:, None, None, None]
    return np.asarray(boxes[group, line[..., :, None], pixel[..., None, :]].reshape(-1, size, size))
