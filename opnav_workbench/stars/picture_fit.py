"""All stars of a picture fitted: neighbors together, hits masked and fitted again, results with their flags.

Flow   starts -> groups -> batches of groups (`fit_groups`, several threads) -> hits -> again -> `StarCenters`

Stars are linked in chains of neighbors that lie in each other's boxes; chains too long are cut at their widest gaps.
The batches are of fixed size, so results do not depend on the number of processors.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
import scipy

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.geometry.near_places import NearPlaces, pairs_within
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.stars.boxes import Boxes, Pixels, cut_at, cut_boxes
from opnav_workbench.stars.flags import StarFlag, combine_flags
from opnav_workbench.stars.group_fit import FitSettings, FittedStars, fit_groups
from opnav_workbench.stars.results import StarCenters, StarImages
from opnav_workbench.stars.star_model import FLUX, LINE, PER_STAR, PIXEL, StarProfile

if TYPE_CHECKING:
    from scipy.sparse import csgraph
else:  # for pictures whose stars overlap
    csgraph = module_on_demand("scipy.sparse.csgraph")

__all__ = ["fit_profile", "groups_of", "link_neighbors", "misfit_factor"]


# ---- Which stars must be fitted together: chains of neighbors that lie in each other's boxes.

MAX_GROUP_MEMBERS = 8  # of one group: larger chains are cut at their widest gaps
CUT_STEP = 0.97  # factor on the linking length of groups that are too large


def link_neighbors(
    places: FloatArray, joinable: BoolArray, radius_px: float, too_close_px: float
) -> IntArray:
    """Return a label (n,) for each place: equal for those that belong together.

    Parameters
    ----------
    places : (n, 2) array
    joinable : (n,) array of bool
        The others stay alone.
    radius_px
        Along each axis: neighbors in a box of twice this size are linked.
    too_close_px
        Of two places nearer than this, one source for the fit, the second stays alone.
    """
    joinable = joinable.copy()
    joinable[pairs_within(places, too_close_px)[:, 1]] = False
    labels = np.arange(len(places))
    pairs = pairs_within(places, radius_px, along_axes=True)
    pairs = pairs[joinable[pairs].all(axis=1)]
    distance = np.abs(np.diff(places[pairs], axis=1)[:, 0]).max(axis=1)
    while len(pairs):
        labels = _connected_labels(len(places), pairs)
        crowded = np.bincount(labels)[labels[pairs[:, 0]]] > MAX_GROUP_MEMBERS
        if not crowded.any():
            break
        longest = distance[crowded].max()
        keep = ~crowded | (distance < CUT_STEP * longest)
        pairs, distance = pairs[keep], distance[keep]
        labels = np.arange(len(places))
    return labels


def groups_of(labels: IntArray, chosen: BoolArray) -> list[IntArray]:
    """Return the chosen stars as arrays (g, k), one for each group size k: rows are groups, brothers by row."""
    stars = np.flatnonzero(chosen)
    stars = stars[np.argsort(labels[stars], kind="stable")]
    _, start, count = np.unique(labels[stars], return_index=True, return_counts=True)
    return [stars[start[count == k][:, None] + np.arange(k)] for k in np.unique(count)]


def _connected_labels(n: int, pairs: IntArray) -> IntArray:
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], np.int64)


# ---- All stars of a frame fitted: neighbors together, hits masked and fitted again, results with their flags.

MIN_SNR = 4.0  # below this a peak in a search area of 50 px is as likely noise
CORE_SIGMAS = 2.0  # masked pixels this close to the center touch the measurement itself
MISFIT_SIGMAS = 3.0  # a reduced chi-square this far above 1 is no chance (1 star in 700)
BLEND_SIGMAS = 4.0  # two images closer than this share their pixels
BLEND_PX = 2.0
TOO_CLOSE_SIGMAS = 0.5  # two stars closer than this are one to the fit
MIN_CORE_PART = 0.5  # of a star's core that must be usable for it to join a group
BATCH_PIXELS = 20_000  # of the boxes worked on at once: the arrays stay in the processor's cache
THREADS = min(4, os.cpu_count() or 1)
ROUNDS = 4  # a hit uncovers the next one rarely more than twice
# The fit takes the best of its neighborhood, so its flux, and with it the information it claims on the center,
# is too large by some sigma^2: simulations of 0.7 to 2 px at SNR 5 to 10 give 3.5 to 6 (flux alone, 3).
FAINT_EXCESS = 4.0


def fit_profile(
    pixels: Pixels,
    start: FloatArray,
    profile: StarProfile,
    settings: FitSettings,
    method: str,
    *,
    joint: bool,
    mask_hits: bool,
    inflate_misfit: bool,
) -> StarCenters:
    """Fit stars that start at (n, 2); see `fit_gaussian` and `fit_psf`."""
    job = _PictureFit(pixels, start, profile, settings, joint)
    job.run(mask_hits)
    return _star_centers(job, pixels, method, inflate_misfit)


class _PictureFit:
    """The rounds of one frame: what is still to be fitted, and what is known."""

    def __init__(
        self, pixels: Pixels, start: FloatArray, profile: StarProfile, settings: FitSettings, joint: bool
    ) -> None:
        n = len(start)
        self.pixels, self.start, self.profile, self.settings = pixels, start, profile, settings
        errors = profile.errors(np.zeros((1, 2)), np.zeros((1, 2)), settings.size)
        n_errors = 0 if errors is None else errors.shape[-1]
        self.rows = FittedStars.empty(n, len(profile.mean), settings.size, n_errors)
        self.hit = np.zeros(n, bool)  # stars with masked pixels in their box
        self.core_hit = np.zeros(n, bool)  # stars that were fitted to a hit
        self.labels = np.arange(n)
        if joint and n > 1:
            self.labels = link_neighbors(
                start, self._joinable(), settings.size // 2 + 1.0, TOO_CLOSE_SIGMAS * profile.core_px
            )

    def run(self, mask_hits: bool) -> None:
        """Fit, mask and fit again until nothing changes."""
        n = len(self.start)
        todo, settled = np.ones(n, bool), np.zeros(n, bool)
        for _ in range(ROUNDS):
            hits = self._fit(todo)
            touched = self._mask(hits) if mask_hits and len(hits) else np.zeros(n, bool)
            # Where nothing is, nothing shall disturb the neighbors; where a group fails, each for itself.
            crowd = todo & (np.bincount(self.labels, minlength=n)[self.labels] > 1)
            faint = crowd & self.rows.determined & ~(self.snr >= MIN_SNR) & ~self._leaders()
            failed = crowd & ~self.rows.determined
            todo = np.isin(self.labels, self.labels[faint | failed | touched])
            settled |= faint
            todo &= ~settled
            if not todo.any():
                return
            self._leave(faint | failed)

    @property
    def snr(self) -> FloatArray:
        flux_sigma = np.sqrt(np.where(self.rows.determined, self.rows.covariance[:, FLUX, FLUX], np.nan))
        return np.asarray(self.rows.parameters[:, FLUX] / flux_sigma)

    def _leaders(self) -> BoolArray:
        """True for the star of largest flux of each group: two images of one star shall not both be dropped."""
        order = np.lexsort([-self.rows.parameters[:, FLUX], self.labels])
        first = np.unique(self.labels[order], return_index=True)[1]
        leaders = np.zeros(len(order), bool)
        leaders[order[first]] = True
        return leaders

    def _joinable(self) -> BoolArray:
        """True where enough of a star's core is on usable pixels for the sake of its neighbors."""
        core = cut_boxes(self.pixels, self.start, 2 * int(np.ceil(self.profile.core_px)) + 1)
        return np.asarray(np.mean(np.isfinite(core.variance_dn2), axis=(1, 2)) >= MIN_CORE_PART)

    def _fit(self, todo: BoolArray) -> IntArray:
        """Fit the chosen stars; return hits (h, 3): label, line, pixel."""
        batches = list(_batches(groups_of(self.labels, todo), self.settings.size))

        def fit(members: IntArray) -> tuple[FittedStars, IntArray]:
            return fit_groups(self.pixels, self.start[members], self.profile, self.settings)

        if len(batches) > 1 and THREADS > 1:
            with ThreadPoolExecutor(THREADS) as pool:
                fitted = list(pool.map(fit, batches))
        else:
            fitted = [fit(members) for members in batches]
        hits = [np.zeros((0, 3), np.int64)]
        for members, (rows, found) in zip(batches, fitted, strict=True):
            self.rows.fill(members.ravel(), rows)
            found[:, 0] = self.labels[members[found[:, 0], 0]]
            hits.append(found)
        return np.concatenate(hits)

    def _leave(self, stars: BoolArray) -> None:
        """Let stars go their own ways."""
        self.labels = self.labels.copy()
        self.labels[stars] = len(stars) + np.flatnonzero(stars)
        self.labels = np.unique(self.labels, return_inverse=True)[1].reshape(-1)

    def _mask(self, hits: IntArray) -> BoolArray:
        """Take hits out of use, unless they are another listed star's; return the stars with one in their box."""
        places = NearPlaces(self.rows.parameters[:, PIXEL : LINE + 1])
        distance, nearest = places.nearest(hits[:, :0:-1].astype(float))
        own = (self.labels[nearest] == hits[:, 0]) | (distance > _blend_radius(self.profile))
        hits, distance, nearest = hits[own], distance[own], nearest[own]
        self.core_hit[nearest[distance <= _core_radius(np.array(self.profile.core_px))]] = True
        self.pixels = self.pixels.without(hits[:, 1], hits[:, 2])
        fresh = np.zeros(self.pixels.image_dn.shape, bool)
        fresh[hits[:, 1], hits[:, 2]] = True
        touched = _any_in_boxes(fresh, self.rows.first, self.settings.size)
        self.hit |= touched
        return touched


def _batches(groups: list[IntArray], size: int) -> Iterator[IntArray]:
    for members in groups:
        step = max(1, BATCH_PIXELS // (size**2 * members.shape[1]))
        for start in range(0, len(members), step):
            yield members[start : start + step]


def _any_in_boxes(mask: BoolArray, first: IntArray, size: int) -> BoolArray:
    """True for boxes that hold a pixel of the mask, by sums over rectangles; (n,)."""
    total = np.pad(np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    limit = np.array(mask.shape[::-1])
    (x0, y0), (x1, y1) = (np.clip(corner, 0, limit).T for corner in (first, first + size))
    return np.asarray(total[y1, x1] - total[y0, x1] - total[y1, x0] + total[y0, x0] > 0)


def _star_centers(job: _PictureFit, pixels: Pixels, method: str, inflate: bool) -> StarCenters:
    rows, profile = job.rows, job.profile
    boxes = cut_at(pixels, rows.first, job.settings.size)
    finite, freedom = rows.determined, rows.freedom
    blank = np.where(finite, 1.0, np.nan)
    shape = rows.parameters[:, PER_STAR:]
    chi2_reduced = rows.chi2 / np.maximum(freedom, 1.0) * blank
    covariance = rows.covariance.copy()
    covariance[:, PIXEL : LINE + 1, PIXEL : LINE + 1] *= faint_factor(job.snr)[:, None, None]
    covariance[:, PIXEL : LINE + 1, PIXEL : LINE + 1] += _spread_of_phases(job)
    covariance += rows.psf_covariance
    if inflate:
        explained = 1.0 + rows.psf_chi2 / np.maximum(freedom, 1.0)
        covariance *= misfit_factor(chi2_reduced / explained, freedom)[:, None, None]
    shape_covariance = np.zeros((len(shape), 3, 3))
    shape_covariance[:, : shape.shape[1], : shape.shape[1]] = covariance[:, PER_STAR:, PER_STAR:]
    usable = np.isfinite(boxes.variance_dn2)
    return StarCenters(
        pixel_line=rows.parameters[:, PIXEL : LINE + 1] * blank[:, None],
        covariance_px2=covariance[:, PIXEL : LINE + 1, PIXEL : LINE + 1] * blank[:, None, None],
        flux_dn=rows.parameters[:, FLUX] * blank,
        flux_sigma_dn=np.sqrt(rows.covariance[:, FLUX, FLUX]) * blank,
        background_dn=rows.background_dn * blank,
        shape=profile.ellipse(shape) * blank[:, None],
        shape_covariance=shape_covariance * blank[:, None, None],
        chi2_reduced=chi2_reduced,
        snr=job.snr * blank,
        degrees_of_freedom=freedom,
        flags=_flags(job, boxes),
        method=method,
        common_px=rows.common_px if rows.common_px.shape[2] else None,
        psf_error=job.settings.psf_error,
        images=StarImages(
            first=rows.first,
            data_dn=np.where(usable, boxes.data_dn, np.nan),
            model_dn=rows.model_dn,
            sigma_dn=rows.sigma_dn,
        ),
    )


# ---- Undersampled stars may lie on either side of their pixel.

MIRRORED_SIGMA_PX = 0.45  # of the PSF's core: below, what tells the side is in pixels of little but noise
MIRRORED_SNR = 40.0  # below; from there on even the dim side of a pixel's neighbors is seen
MIRRORED_STEPS = np.arange(-6, 7) / 8.0  # px from the fitted center, along each axis
ELSEWHERE_SIGMAS = 3.0  # of the fit's own covariance


def _spread_of_phases(job: _PictureFit) -> FloatArray:
    """Covariance (n, 2, 2) that other places in and beside its pixel add to an undersampled faint star's.

    A fit ends in one minimum and knows its bend alone. Each place is as likely as what the best flux and level leave there.
    """
    rows, added = job.rows, np.zeros((len(job.start), 2, 2))
    if job.profile.core_px >= MIRRORED_SIGMA_PX:
        return added
    alone = np.bincount(job.labels, minlength=len(job.start))[job.labels] == 1
    with np.errstate(invalid="ignore"):
        faint = np.flatnonzero(rows.determined & alone & (job.snr < MIRRORED_SNR) & (job.snr >= MIN_SNR))
    if len(faint) == 0:
        return added
    own = rows.covariance[faint, PIXEL : LINE + 1, PIXEL : LINE + 1]
    step = np.stack(np.meshgrid(MIRRORED_STEPS, MIRRORED_STEPS), axis=-1).reshape(-1, 2)
    excess = _chi2_at(job, faint, step) - rows.chi2[faint, None]
    elsewhere = np.einsum("sa,nab,sb->ns", step, np.linalg.inv(own), step) > ELSEWHERE_SIGMAS**2
    cell = (MIRRORED_STEPS[1] - MIRRORED_STEPS[0]) ** 2
    odds = np.where(elsewhere, np.exp(-0.5 * np.maximum(excess, 0.0)), 0.0) * cell
    here = 2.0 * np.pi * np.sqrt(np.linalg.det(own))
    share = odds / (here + odds.sum(axis=1))[:, None]
    added[faint] = np.einsum("ns,sa,sb->nab", share, step, step)
    return added


def _chi2_at(job: _PictureFit, stars: IntArray, step: FloatArray) -> FloatArray:
    """Chi-square (k, s) of stars moved by steps (s, 2), flux and level as fit best there."""
    rows, size = job.rows, job.settings.size
    k, s = len(stars), len(step)
    center = rows.parameters[stars, None, PIXEL : LINE + 1] + step
    first = np.repeat(rows.first[stars], s, axis=0).astype(float)
    light = job.profile.value(center.reshape(-1, 2), first, size).reshape(k, s, -1)
    sigma = rows.sigma_dn[stars].reshape(k, -1)
    weight = np.where(np.isfinite(sigma), 1.0 / np.where(np.isfinite(sigma), sigma, 1.0) ** 2, 0.0)
    data = np.where(weight > 0.0, cut_at(job.pixels, rows.first[stars], size).data_dn.reshape(k, -1), 0.0)
    data = data - rows.background_dn[stars, None]
    one = weight.sum(axis=1)[:, None]
    mean_light, mean_data = (
        (light @ weight[:, :, None])[:, :, 0] / one,
        np.sum(weight * data, axis=1)[:, None] / one,
    )
    both = (light @ (weight * data)[:, :, None])[:, :, 0] - one * mean_light * mean_data
    square = (light**2 @ weight[:, :, None])[:, :, 0] - one * mean_light**2
    left = np.sum(weight * data**2, axis=1)[:, None] - one * mean_data**2
    return np.asarray(left - np.maximum(both, 0.0) ** 2 / np.maximum(square, np.finfo(float).tiny))


def misfit_factor(chi2_reduced: FloatArray, degrees_of_freedom: FloatArray) -> FloatArray:
    """Return the reduced chi-square where it is significantly above 1, else 1; (n,).

    Covariances are scaled by it: where the noise does not explain the residuals, neither does it the error of
    the center.
    """
    limit = 1.0 + MISFIT_SIGMAS * np.sqrt(2.0 / np.maximum(degrees_of_freedom, 1.0))
    return np.where(chi2_reduced > limit, chi2_reduced, 1.0)


def faint_factor(snr: FloatArray) -> FloatArray:
    """Return by what the center's covariance of faint stars exceeds the inverse of the information; (n,)."""
    known = np.where(np.isfinite(snr), np.maximum(snr, 0.0), 0.0)
    square = np.maximum(known**2, 2.0 * FAINT_EXCESS)
    return np.asarray(square / (square - FAINT_EXCESS))


def _blend_radius(profile: StarProfile) -> float:
    return max(BLEND_SIGMAS * profile.core_px, BLEND_PX)


def _core_radius(core_px: FloatArray) -> FloatArray:
    return np.maximum(CORE_SIGMAS * core_px, 1.0)


def _flags(job: _PictureFit, boxes: Boxes) -> IntArray:
    rows, profile = job.rows, job.profile
    center, shape = rows.parameters[:, PIXEL : LINE + 1], rows.parameters[:, PER_STAR:]
    dx, dy = boxes.offsets(center)
    radius = _core_radius(profile.core(shape))
    core = np.hypot(dx[:, None, :], dy[:, :, None]) <= radius[:, None, None]
    low = ~(job.snr >= MIN_SNR)
    blended = np.zeros(len(center), bool)
    blended[pairs_within(center, _blend_radius(profile)).ravel()] = True
    conditions = {
        StarFlag.NOT_CONVERGED: ~rows.converged,
        StarFlag.SATURATED: np.any(boxes.saturated & core, axis=(1, 2)),
        StarFlag.EDGE: np.any(boxes.outside, axis=(1, 2)),
        StarFlag.BAD_PIXELS: np.any(boxes.bad & core, axis=(1, 2)),
        StarFlag.LOW_SNR: low,
        StarFlag.AT_BOUND: rows.at_bound,
        StarFlag.BLENDED: blended,
        StarFlag.COSMIC_RAY: profile.too_sharp(shape) | (job.core_hit & low),
        StarFlag.NOT_FINITE: ~rows.determined,
        StarFlag.HIT: job.hit,
    }
    return combine_flags(conditions, len(center))
