"""One batch of equally large groups of stars fitted: boxes cut, started, solved, and taken apart star by star."""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.starcenters.boxes import Boxes, Pixels, box_corners, cut_at
from opnav_workbench.starcenters.hits import find_hits
from opnav_workbench.starcenters.levenberg import Solution, solve_batched
from opnav_workbench.starcenters.profiles import Profile
from opnav_workbench.starcenters.results import NoiseModel
from opnav_workbench.starcenters.search import best_shift, most_significant
from opnav_workbench.starcenters.star_model import PER_STAR, StarModel

__all__ = ["FitSettings", "StarRows", "fit_groups"]

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
class StarRows:
    """What a fit says of each of n stars; members of a group have chi-square and freedom of the group."""

    parameters: FloatArray  # (n, 3 + n_shape) flux, pixel, line, shape
    covariance: FloatArray  # (n, 3 + n_shape, 3 + n_shape) from the noise alone
    psf_covariance: FloatArray  # what the error of the PSF model adds to it
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
    def empty(cls, n: int, n_shape: int, size: int) -> "StarRows":
        """Return rows to be filled."""
        q = PER_STAR + n_shape
        return cls(
            parameters=np.zeros((n, q)),
            covariance=np.zeros((n, q, q)),
            psf_covariance=np.zeros((n, q, q)),
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

    def fill(self, index: IntArray, rows: "StarRows") -> None:
        """Put the rows of the stars `index` into their places."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(rows, field.name)


def fit_groups(
    pixels: Pixels, start: FloatArray, profile: Profile, settings: FitSettings
) -> tuple[StarRows, IntArray]:
    """Fit groups of stars that start at (g, k, 2), each group with one background and one shape.

    Returns
    -------
    rows : StarRows
        Of the g * k stars, group by group.
    hits : (h, 3) array of int
        Pixels that no star explains: group, line, pixel.
    """
    guess = _guess(pixels, start, profile, settings)
    k = start.shape[1]
    corners = box_corners(pixels, guess.reshape(-1, 2), settings.size).reshape(-1, k, 2)
    boxes = _boxes(pixels, corners, settings.size)
    model = StarModel.of(boxes, settings.noise_model, profile, settings.background, k)
    p0 = model.linear_start(guess)
    lower, upper = _bounds(model, p0, guess, start, settings.search_radius_px)
    mean, information = np.zeros_like(p0), np.zeros_like(p0)
    mean[:, model.shape_columns] = profile.mean
    information[:, model.shape_columns] = profile.information
    solution = solve_batched(model, p0, lower, upper, mean, information)
    freedom = _freedom(solution, model, information)
    # A group that is not determined has no covariance; zeros keep the algebra below finite.
    covariance = np.where((freedom > 0.0)[:, None, None], solution.covariance, 0.0)
    light = model.light(solution.parameters, solution.final)
    hits = find_hits(solution.final, covariance, light, settings.psf_error, model.size)
    where = np.argwhere(hits & (freedom > 0.0)[:, None, None])
    where[:, 1:] += boxes.first[where[:, 0], ::-1]
    return _rows(solution, covariance, freedom, model, corners, settings), where


def _guess(pixels: Pixels, start: FloatArray, profile: Profile, settings: FitSettings) -> FloatArray:
    """Where the fit begins (g, k, 2): a star alone where it is most significant, a group where all of it fits."""
    g, k = start.shape[:2]
    places, reach = start.reshape(-1, 2), settings.search_radius_px
    alone = most_significant(pixels, places, profile, reach).reshape(g, k, 2)
    if k == 1:
        return alone
    size = settings.size + 2 * int(np.ceil(reach))
    boxes = _boxes(pixels, box_corners(pixels, places, size).reshape(g, k, 2), size)
    return best_shift(StarModel.of(boxes, None, profile, "level", k), start, alone, reach)


def _boxes(pixels: Pixels, corners: IntArray, size: int) -> Boxes:
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


def _bounds(
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


def _freedom(solution: Solution, model: StarModel, information: FloatArray) -> FloatArray:
    """Pixels less parameters taken from them, 0 where there are too few; (g,)."""
    used = np.isfinite(model.variance).sum(axis=1)
    # What the prior determines is not taken from the data: the effective number of parameters.
    held = np.sum(information * np.diagonal(solution.covariance, axis1=1, axis2=2), axis=1)
    freedom = used - information.shape[1] + held
    return np.where(solution.determined & (freedom >= MIN_FREEDOM), freedom, 0.0)


def _rows(
    solution: Solution, covariance: FloatArray, freedom: FloatArray, model: StarModel, corners: IntArray,
    settings: FitSettings,
) -> StarRows:  # fmt: skip
    """Take the groups apart: the columns, the marginal covariance and the own box of each star."""
    p, k, final = solution.parameters, model.members, solution.final
    shape = np.arange(model.shape_columns.start, model.shape_columns.stop)
    own = np.hstack([PER_STAR * np.arange(k)[:, None] + np.arange(PER_STAR), np.tile(shape, (k, 1))])
    blocks = np.index_exp[:, own[:, :, None], own[:, None, :]]
    added, excess = _psf_error(solution, covariance, model, settings.psf_error)
    sigma = np.where(
        final.weight > 0.0, 1.0 / np.sqrt(np.where(final.weight > 0.0, final.weight, 1.0)), np.inf
    )
    windows = corners - corners.min(axis=1, keepdims=True)
    center = p[:, model.center_columns]

    def flat(values: FloatArray) -> FloatArray:
        return values.reshape(-1, *values.shape[2:])

    def repeat(values: FloatArray) -> FloatArray:
        return np.repeat(values, k, axis=0)

    return StarRows(
        parameters=flat(p[:, own]),
        covariance=flat(covariance[blocks]),
        psf_covariance=flat(added[blocks]),
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
    solution: Solution, covariance: FloatArray, model: StarModel, error: float
) -> tuple[FloatArray, FloatArray]:
    """Covariance that an error of the PSF model, a fraction of each star's light in a pixel, adds; and its chi2.

    With C the inverse normal matrix, parameters follow the data by C J'W, so a variance V adds C J'W V WJ C.
    """
    final = solution.final
    if error == 0.0:
        return np.zeros_like(covariance), np.zeros(len(covariance))
    variance = (error * model.light(solution.parameters, final)) ** 2
    gain = np.matmul(covariance, final.jacobian * final.weight[:, None, :])
    added = np.matmul(gain * variance[:, None, :], np.swapaxes(gain, 1, 2))
    return added, np.sum(final.weight * variance, axis=1)


def _windows(values: FloatArray, corner: IntArray, side: int, size: int) -> FloatArray:
    """Cut each star's own box (g k, size, size) out of what fills the box of its group (g, side^2)."""
    g, k = corner.shape[:2]
    boxes = values.reshape(g, side, side)
    if k == 1:
        return boxes
    line, pixel = (corner[:, :, axis, None] + np.arange(size) for axis in (1, 0))
    group = np.arange(g)[:, None, None, None]
    return np.asarray(boxes[group, line[..., :, None], pixel[..., None, :]].reshape(-1, size, size))
