"""One image or two: companions that no catalog lists, and what they make of a star's center.

A star with an unlisted companion within its image comes out between the two, as wide as its prior lets it be, and as sure
as any. Where a star is wider, longer or less well fitted than those of its picture, two images of the expected PSF are
fitted beside the one, and both are weighed: the likelihoods, with what a PSF's model tolerates, and what it costs to have
chosen place and brightness of a companion of which there are few (the Laplace approximation of the evidence). Which of two
images is the catalog's star their brightness tells, as far as a zero point is known, and that faint stars are more than
bright ones. What cannot be told apart is in the covariance: that of the mixture of all answers.

Reference for the evidence: MacKay (2003), Information Theory, Inference, and Learning Algorithms, chapter 28.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.stars.boxes import Pixels, check_image, cut_at
from opnav_workbench.stars.flags import StarFlag
from opnav_workbench.stars.group_fit import PSF_TOLERANCE, FitSettings, FittedStars, best_starts, fit_groups
from opnav_workbench.stars.least_squares import default_box_px
from opnav_workbench.stars.psf_consensus import TEACHING_SNR, shape_from_stars, well_exposed
from opnav_workbench.stars.results import NoiseModel, ShapePrior, StarCenters
from opnav_workbench.stars.star_model import FLUX, LINE, PER_STAR, PIXEL, GaussianProfile

__all__ = ["with_companions"]

COMPANIONS_PX2 = (
    1e-3  # unlisted images as bright as a star, a px^2 and unit of ln(flux): doubles are many at a pixel
)
COUNTS_SLOPE = 0.75  # of ln(number) over ln(flux): stars double with each magnitude
MAG_SCATTER = 0.5  # of a star about its catalog brightness: color, variability
MIN_ZERO_POINT_STARS = 4  # a median of fewer follows a single wrong star
MIN_COMMON = 5  # well-exposed stars whose common PSF does not follow one of them
SUSPECT_SIGMAS = 2.0  # a shape that far off its prior, or as much cost in chi-squared, may be two images
LEAST_ODDS = 0.01  # below, the star stays as it was fitted
SPACING = 1.7  # of the images where a fit of two begins, in sigmas of the image
TRIED = 3  # of those beginnings, the most promising
REACH = (
    4.0  # of a companion, in sigmas of the PSF's core: beyond, it is masked as light that is not the star's
)
MIN_REACH_PX = 2.0
LEAST_PART = 0.05  # of the light: what is less is an error of the PSF
# One of the two images takes away half as much light as there is: such a fit goes on to ever more of both signs without end.
# Of 1,600 simulated stars, 660 of them pairs, none came out otherwise for it.
DARKEST_PART = -0.5
UNFIT = (
    StarFlag.SATURATED | StarFlag.EDGE | StarFlag.BAD_PIXELS | StarFlag.BLENDED | StarFlag.NOT_FINITE | StarFlag.LOW_SNR
    | StarFlag.COSMIC_RAY | StarFlag.FLANKS
)  # fmt: skip


def with_companions(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    centers: StarCenters,
    rows: IntArray,
    mag: FloatArray,
    prior: ShapePrior | Callable[[], ShapePrior],
    psf: ShapePrior,
    *,
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    zero_point_mag: float | None = None,
) -> StarCenters:
    """Return centers in which stars that may be two images say so: flag `PAIR`, the mixture's center and covariance.

    Parameters
    ----------
    image_dn, noise_dn, bad, saturated, noise_model
        As in `fit_stars`.
    centers : StarCenters
        Of `fit_stars`, n stars.
    rows : (k,) ndarray of int
        Stars that may change.
    mag : (n,) ndarray
        Of the catalog.
    prior
        The PSF as it is known without these stars; asked for where they are few.
    psf
        What the picture's stars agree on.
    zero_point_mag
        Of a star of one DN in this exposure, as the camera tells it; that of the picture's other stars counts more.
    """
    suspects = rows[_fit_for_it(centers)[rows]].tolist()
    if not suspects:
        return centers
    pixels = check_image(image_dn, noise_dn, bad, saturated)
    common = np.count_nonzero(well_exposed(centers, TEACHING_SNR)) >= MIN_COMMON
    changed: dict[str, FloatArray | IntArray] = {}
    if not common and not isinstance(prior, ShapePrior):
        prior = prior()
    for row in suspects:
        shape = (
            psf
            if common or not isinstance(prior, ShapePrior)
            else shape_from_stars(_without(centers, row), prior, min_snr=TEACHING_SNR)
        )
        if not _suspect(centers, row, shape):
            continue
        settings = FitSettings(default_box_px(shape.sigma_px), "level", noise_model, 0.0, _reach_px(shape))
        found = _weighed(pixels, centers.pixel_line[row], shape, settings)
        if found is None:
            continue
        zero_point = _zero_point(centers, mag, row, zero_point_mag)
        mixture = _mixture(centers, row, found, None if zero_point is None else zero_point - mag[row])
        if not changed:
            changed = {
                name: np.array(getattr(centers, name)) for name in ("pixel_line", "covariance_px2", "flags")
            }
        changed["pixel_line"][row], changed["covariance_px2"][row] = mixture
        changed["flags"][row] |= int(StarFlag.PAIR)
    return replace(centers, **changed) if changed else centers  # type: ignore[arg-type]


# ---- Which stars may be two images.


def _fit_for_it(centers: StarCenters) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray((centers.snr >= TEACHING_SNR) & ((centers.flags & int(UNFIT)) == 0))


def _without(centers: StarCenters, row: int) -> StarCenters:
    """Return centers of which one has no say in the PSF."""
    flags = np.array(centers.flags)
    flags[row] |= int(StarFlag.LOW_SNR)
    return replace(centers, flags=flags)


def _suspect(centers: StarCenters, row: int, shape: ShapePrior) -> bool:
    """Tell whether a star is wider, longer or less well fitted than its PSF and noise make it."""
    widest = shape.shape.sigma_major_px * np.exp(SUSPECT_SIGMAS * min(shape.sigma_log_scale, 0.1))
    if centers.shape[row, 0] > widest:
        return True
    if centers.images is None:
        return bool(
            centers.chi2_reduced[row] > 1.0 + SUSPECT_SIGMAS * np.sqrt(2.0 / centers.degrees_of_freedom[row])
        )
    data, model, sigma = (getattr(centers.images, name)[row] for name in ("data_dn", "model_dn", "sigma_dn"))
    line, pixel = np.indices(data.shape)
    x, y = centers.pixel_line[row] - centers.images.first[row]
    near = np.isfinite(data) & (np.hypot(pixel - x, line - y) <= _reach_px(shape))
    used = near & np.isfinite(sigma)
    if (near & ~used).any():  # light that was masked
        return True
    variance = sigma[used] ** 2 + _tolerated(model - centers.background_dn[row])[used]
    chi2 = float(np.sum((data - model)[used] ** 2 / variance))
    return bool(chi2 - np.count_nonzero(used) > SUSPECT_SIGMAS * np.sqrt(2.0 * np.count_nonzero(used)))


def _tolerated(light: FloatArray) -> FloatArray:
    """Variance of pixels by errors of the PSF's model: a part of their light, or of that beside them."""
    return np.asarray((PSF_TOLERANCE * maximum_filter(np.maximum(light, 0.0), size=3)) ** 2)


# ---- One image against two.


def _reach_px(shape: ShapePrior) -> float:
    return max(REACH * shape.sigma_px, MIN_REACH_PX)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two images that explain a star's light better than one does."""

    log_odds: float  # of two against one
    places: FloatArray  # (2, 2)
    covariance_px2: FloatArray  # (2, 2, 2)
    flux_dn: FloatArray  # (2,)


def _weighed(pixels: Pixels, center: FloatArray, shape: ShapePrior, settings: FitSettings) -> _Pair | None:
    """Return the best pair of images about a center, None where one image is as good, or neither."""
    profile = GaussianProfile(shape)
    width = float(np.hypot(shape.sigma_px, np.sqrt(1.0 / 12.0)))
    reach = settings.search_radius_px
    angle = np.arange(8) * 0.25 * np.pi
    way = SPACING * width * np.column_stack([np.cos(angle), np.sin(angle)])
    beside, between = np.stack([0.0 * way, way], axis=1), np.stack([0.5 * way, -0.5 * way], axis=1)[:4]
    starts = center + np.concatenate([between, beside, 1.5 * beside])
    starts = best_starts(pixels, starts, profile, settings, TRIED)
    one, _ = fit_groups(pixels, center[None, None], profile, settings)
    two, hits = fit_groups(pixels, starts, profile, settings, searched=False, darkest=DARKEST_PART)
    best = _best(two, hits, center, reach)
    if best is None or not one.determined[0]:
        return None
    members = np.array([2 * best, 2 * best + 1])
    cost = _costs(pixels, one, two, members, shape, settings)
    covariance = two.covariance[members]
    pair = _Pair(
        0.5 * (cost[0] - cost[1]) + _room(two, members),
        two.parameters[members, PIXEL : LINE + 1],
        covariance[:, PIXEL : LINE + 1, PIXEL : LINE + 1],
        two.parameters[members, FLUX],
    )
    return pair if pair.log_odds > np.log(LEAST_ODDS) else None


def _best(two: FittedStars, hits: IntArray, center: FloatArray, reach: float) -> int | None:
    """Return the group of two that fits best, of those that are two images near the star and leave no hit."""
    flux = two.parameters[:, FLUX].reshape(-1, 2)
    place = two.parameters[:, PIXEL : LINE + 1].reshape(-1, 2, 2)
    near = np.hypot(*(place - center).transpose(2, 0, 1)).max(axis=1) <= reach
    whole = (two.determined & two.converged).reshape(-1, 2).all(axis=1)
    good = near & whole & (flux.min(axis=1) > LEAST_PART * flux.sum(axis=1))
    good &= ~np.isin(np.arange(len(good)), hits[:, 0])
    if not good.any():
        return None
    return int(np.argmin(np.where(good, two.chi2[::2], np.inf)))


def _costs(
    pixels: Pixels,
    one: FittedStars,
    two: FittedStars,
    members: IntArray,
    shape: ShapePrior,
    settings: FitSettings,
) -> tuple[float, float]:
    """Return chi-squared and prior's cost of one and of two images over the same pixels, errors of a PSF's model allowed."""
    size = settings.size
    data = cut_at(pixels, one.first, size)
    first = members[0]
    shift = (two.first[first] - one.first[0]).tolist()
    model = two.model_dn[first], two.sigma_dn[first]
    pieces = [_shifted(values, shift, size, fill) for values, fill in zip(model, (0.0, np.inf), strict=True)]
    variance = pieces[1] ** 2 + _tolerated(pieces[0] - two.background_dn[first])
    used = np.isfinite(one.sigma_dn[0]) & np.isfinite(variance) & np.isfinite(data.variance_dn2[0])
    costs = []
    for fitted, of_model in ((one.parameters[0], one.model_dn[0]), (two.parameters[first], pieces[0])):
        off = fitted[PER_STAR:] - shape.mean
        residual = (data.data_dn[0] - of_model)[used]
        costs.append(float(np.sum(residual**2 / variance[used]) + np.sum(shape.information * off**2)))
    return costs[0], costs[1]


def _shifted(values: FloatArray, shift: list[int], size: int, fill: float) -> FloatArray:
    """Return a box of values as seen from a box whose first pixel lies `shift` (pixel, line) before its own."""
    out = np.full((size, size), fill)
    x, y = shift
    a, b = slice(max(y, 0), min(size + y, size)), slice(max(x, 0), min(size + x, size))
    out[a, b] = values[a.start - y : a.stop - y, b.start - x : b.stop - x]
    return out


def _room(two: FittedStars, members: IntArray) -> float:
    """Return the logarithm of how many companions there are beforehand where the fitted one may be."""
    second = members[np.argmin(two.parameters[members, FLUX])]
    covariance = two.covariance[second][:PER_STAR, :PER_STAR].copy()
    flux = two.parameters[second, FLUX]
    covariance[FLUX] /= flux
    covariance[:, FLUX] /= flux
    determinant = max(float(np.linalg.det(covariance)), np.finfo(float).tiny)
    return float(np.log(COMPANIONS_PX2) + 0.5 * np.log((2.0 * np.pi) ** PER_STAR * determinant))


# ---- Which of two images the catalog's star is, and what is left of its center.


def _zero_point(centers: StarCenters, mag: FloatArray, row: int, camera: float | None) -> float | None:
    """Return the magnitude of one DN: that of the other stars' median, or the camera's; None where nothing tells."""
    good = well_exposed(centers, TEACHING_SNR)
    good[row] = False
    if np.count_nonzero(good) >= MIN_ZERO_POINT_STARS:
        return float(np.median(mag[good] + 2.5 * np.log10(centers.flux_dn[good])))
    return camera


def _mixture(
    centers: StarCenters, row: int, pair: _Pair, expected: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a center that is that of one image, or of either of two.

    `expected` is 2.5 log10 of the flux in DN that the catalog's magnitude makes; None where that is not known.
    """
    log_flux = np.log(pair.flux_dn)
    # The other image is the unlisted one: of faint ones there are more.
    which = -COUNTS_SLOPE * log_flux[::-1]
    if expected is not None:
        which = which - 0.5 * ((2.5 * np.log10(pair.flux_dn) - expected) / MAG_SCATTER) ** 2
    which = np.exp(which - np.logaddexp(*which))
    both = 1.0 / (1.0 + np.exp(-np.clip(pair.log_odds, -50.0, 50.0)))
    weight = np.array([1.0 - both, *(both * which)])
    place = np.vstack([centers.pixel_line[row], pair.places])
    covariance = np.concatenate([centers.covariance_px2[row][None], pair.covariance_px2])
    mean = weight @ place
    off = place - mean
    return mean, np.einsum("k,kij->ij", weight, covariance + off[:, :, None] * off[:, None, :])
