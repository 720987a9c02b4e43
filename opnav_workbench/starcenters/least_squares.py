"""The workhorse: least squares of a pixel-integrated elliptical Gaussian, all stars at once.

Flow   image, noise, first centers (matched filter, cross-correlation, prediction) -> here -> pointing
Units  DN, px; flux is the star's total over the whole plane

Estimated are flux, center, log scale and ellipticity of the PSF (with a prior: in an undersampled image they
cannot be had from one star), and the background as a level or a plane. Pixels are weighted by the expected
noise.

Reference: Jackman & Dumont (2013), AAS 13-443, "The Non-Linear Least Squares Estimator".
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import ellipse_from_shape
from opnav_workbench.starcenters.boxes import Boxes, check_image, check_points, cut_boxes
from opnav_workbench.starcenters.flags import StarFlag, combine_flags
from opnav_workbench.starcenters.levenberg import Solution, solve_batched
from opnav_workbench.starcenters.results import NoiseModel, ShapePrior, StarCenters
from opnav_workbench.starcenters.search import brightest_pixel
from opnav_workbench.starcenters.star_model import (
    E1,
    E2,
    FLUX,
    LEVEL,
    LINE,
    PIXEL,
    SCALE,
    SLOPE_LINE,
    StarModel,
)

__all__ = ["BACKGROUNDS", "default_box_px", "fit_gaussian", "misfit_factor"]

BACKGROUNDS = ("level", "plane")
METHOD = "least_squares"

SEARCH_RADIUS_PX = 3.0  # matched filters and pointing solutions come closer than this
MAX_ELLIPTICITY = 0.65  # of e1 and e2 each: |e| < 0.92, an axis ratio of 5; no star image is longer
MIN_SCALE_PX = 0.12  # below this a star is one pixel whatever its sigma
SCALE_RANGE_SIGMAS = 5.0  # how far from its prior the log scale may go
MIN_SNR = 4.0  # below this a peak in a search area of 50 px is as likely noise
CORE_SIGMAS = 2.0  # masked pixels this close to the center touch the measurement itself
MIN_FREEDOM = 1.0  # one pixel more than what is estimated from them
MISFIT_SIGMAS = 3.0  # a reduced chi-square this far above 1 is no chance (1 star in 700)
BLEND_SIGMAS = 4.0  # two images closer than this share their pixels
BLEND_PX = 2.0
# A fitted scale this fraction of the PSF's is a cosmic ray, where the PSF is wide enough to tell.
COSMIC_RAY_SCALE = 0.5
RESOLVED_SIGMA_PX = 0.6


def default_box_px(sigma_px: float) -> int:
    """Return the odd box size that holds a star of `sigma_px` to 4 sigma and a rim of background.

    Examples
    --------
    >>> default_box_px(0.35), default_box_px(1.5)
    (7, 15)
    """
    return 2 * int(np.ceil(4.0 * sigma_px + 1.0)) + 1


def fit_gaussian(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    start_pixel_line: ArrayLike,
    prior: ShapePrior,
    *,
    box_px: int | None = None,
    background: Literal["level", "plane"] = "level",
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    psf_error: float = 0.0,
    search_radius_px: float = SEARCH_RADIUS_PX,
    inflate_misfit: bool = True,
) -> StarCenters:
    """Fit a pixel-integrated elliptical Gaussian to every star, in one batched Levenberg-Marquardt.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image; its background may be in it or not.
    noise_dn : (n_line, n_pixel) array_like or float
        Expected 1-sigma noise of the pixels.
    bad, saturated : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    start_pixel_line : (n, 2) array_like
        First guess (pixel, line), good to `search_radius_px` along each axis.
    prior : ShapePrior
        What is known of the PSF.
    box_px : int, optional
        Side of the box around each star, odd; by default 4 sigma and a rim.
    background : {"level", "plane"}
        What is estimated beside the star.
    noise_model : NoiseModel, optional
        With it, the shot noise of the fitted star is added to `noise_dn`, which then must not hold it
        already.
    psf_error : float
        Relative error of the Gaussian as a model of the PSF. The covariance allows for that fraction of the
        star in each pixel (see `estimate_psf_error`); the weights stay those of the noise, so that the
        centers do not depend on it.
    search_radius_px : float
        The brightest point of the search area starts the fit; the center stays within it, along each axis.
    inflate_misfit : bool
        Scale the covariance of center and shape by the reduced chi-square (less what `psf_error` explains)
        where that is significantly above 1 (see `misfit_factor`).

    Returns
    -------
    StarCenters
        Covariance is the inverse of the normal matrix, prior included, shape and background marginalized;
        flux sigma and signal-to-noise ratio tell of the noise alone.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, a box too small, an unknown background.

    Examples
    --------
    >>> from opnav_workbench.psf import pixel_gaussian
    >>> line, pixel = np.indices((12, 12)).reshape(2, 1, -1)
    >>> prior = ShapePrior.round_psf(0.8)
    >>> star = pixel_gaussian(np.array([[5.3, 6.1]]), prior.mean[None], pixel, line).value
    >>> fit = fit_gaussian(1000.0 * star.reshape(12, 12), 1.0, None, [[5.0, 6.0]], prior)
    >>> fit.pixel_line.round(3).tolist()
    [[5.3, 6.1]]
    """
    pixels = check_image(image_dn, noise_dn, bad, saturated)
    start = check_points(start_pixel_line)
    size = default_box_px(prior.sigma_px) if box_px is None else box_px
    _check_options(size, background, psf_error, search_radius_px)
    parameters = LEVEL + 1 if background == "level" else SLOPE_LINE + 1

    first_guess = brightest_pixel(pixels, start, prior, search_radius_px)
    boxes = cut_boxes(pixels, first_guess, size)
    model = StarModel.of(boxes, noise_model, parameters)
    guess = model.linear_start(first_guess, prior)
    lower, upper = _bounds(guess, start, prior, search_radius_px)
    mean, information = np.zeros_like(guess), np.zeros_like(guess)
    mean[:, SCALE : E2 + 1], information[:, SCALE : E2 + 1] = prior.mean, prior.information
    solution = solve_batched(model, guess, lower, upper, mean, information)
    return _results(solution, boxes, model, prior, psf_error, inflate_misfit)


def _check_options(size: int, background: str, psf_error: float, search_radius_px: float) -> None:
    if background not in BACKGROUNDS:
        raise CenterfindingError(f"background must be one of {', '.join(BACKGROUNDS)}, got {background!r}.")
    if size < 3 or size % 2 == 0:
        raise CenterfindingError(f"box_px must be odd and at least 3, got {size}.")
    if not (0.0 <= psf_error < 1.0 and 0.0 <= search_radius_px < np.inf):
        raise CenterfindingError(
            f"psf_error must be in [0, 1) and search_radius_px >= 0, got {psf_error} and {search_radius_px}."
        )


def _bounds(
    guess: FloatArray, start: FloatArray, prior: ShapePrior, search_radius_px: float
) -> tuple[FloatArray, FloatArray]:
    lower, upper = np.full_like(guess, -np.inf), np.full_like(guess, np.inf)
    lower[:, PIXEL : LINE + 1] = start - max(search_radius_px, 0.5)
    upper[:, PIXEL : LINE + 1] = start + max(search_radius_px, 0.5)
    reach = SCALE_RANGE_SIGMAS * prior.sigma_log_scale
    lower[:, SCALE] = max(prior.log_scale - reach, min(np.log(MIN_SCALE_PX), prior.log_scale))
    upper[:, SCALE] = prior.log_scale + min(reach, 2.0)
    limit = max(MAX_ELLIPTICITY, float(np.abs(prior.ellipticity).max()))
    lower[:, E1 : E2 + 1], upper[:, E1 : E2 + 1] = -limit, limit
    return lower, upper


def _results(
    solution: Solution, boxes: Boxes, model: StarModel, prior: ShapePrior, psf_error: float, inflate: bool
) -> StarCenters:
    p, covariance = solution.parameters, solution.covariance
    used = np.isfinite(model.variance).sum(axis=1)
    # What the prior determines is not taken from the data: the effective number of parameters.
    variance = np.diagonal(covariance, axis1=1, axis2=2)[:, SCALE : E2 + 1]
    freedom = used - p.shape[1] + np.sum(prior.information * variance, axis=1)
    finite = solution.determined & (freedom >= MIN_FREEDOM)
    freedom = np.where(finite, freedom, 0.0)
    blank = np.where(finite, 1.0, np.nan)
    chi2_reduced = solution.chi2 / np.maximum(freedom, 1.0) * blank
    flux_sigma = np.sqrt(covariance[:, FLUX, FLUX]) * blank
    snr = p[:, FLUX] / flux_sigma
    explained = np.ones(len(p))
    if psf_error > 0.0:
        covariance, excess = model.with_psf_error(p, covariance, psf_error)
        explained = 1.0 + excess / np.maximum(freedom, 1.0)
    if inflate:
        covariance = covariance * misfit_factor(chi2_reduced / explained, freedom)[:, None, None]
    center = p[:, PIXEL : LINE + 1]
    return StarCenters(
        pixel_line=center * blank[:, None],
        covariance_px2=covariance[:, PIXEL : LINE + 1, PIXEL : LINE + 1] * blank[:, None, None],
        flux_dn=p[:, FLUX] * blank,
        flux_sigma_dn=flux_sigma,
        background_dn=model.background_at(center, p) * blank,
        shape=ellipse_from_shape(p[:, SCALE], p[:, E1], p[:, E2]) * blank[:, None],
        shape_covariance=covariance[:, SCALE : E2 + 1, SCALE : E2 + 1] * blank[:, None, None],
        chi2_reduced=chi2_reduced,
        snr=snr,
        degrees_of_freedom=freedom,
        flags=_flags(solution, boxes, prior, finite, snr),
        method=METHOD,
        psf_error=psf_error,
    )


def misfit_factor(chi2_reduced: FloatArray, degrees_of_freedom: FloatArray) -> FloatArray:
    """Return the reduced chi-square where it is significantly above 1, else 1; (n,).

    Covariances are scaled by it: where the noise does not explain the residuals, neither does it the error of
    the center.
    """
    limit = 1.0 + MISFIT_SIGMAS * np.sqrt(2.0 / np.maximum(degrees_of_freedom, 1.0))
    return np.where(chi2_reduced > limit, chi2_reduced, 1.0)


def _flags(
    solution: Solution, boxes: Boxes, prior: ShapePrior, finite: BoolArray, snr: FloatArray
) -> IntArray:
    p = solution.parameters
    center = p[:, PIXEL : LINE + 1]
    dx, dy = boxes.offsets(center)
    radius = np.maximum(CORE_SIGMAS * np.exp(p[:, SCALE]), 1.0)
    core = np.hypot(dx[:, None, :], dy[:, :, None]) <= radius[:, None, None]
    low = ~(snr >= MIN_SNR)
    cosmic = (p[:, SCALE] < prior.log_scale + np.log(COSMIC_RAY_SCALE)) & (
        prior.sigma_px >= RESOLVED_SIGMA_PX
    )
    conditions = {
        StarFlag.NOT_CONVERGED: ~solution.converged,
        StarFlag.SATURATED: np.any(boxes.saturated & core, axis=(1, 2)),
        StarFlag.EDGE: np.any(boxes.outside, axis=(1, 2)),
        StarFlag.BAD_PIXELS: np.any(boxes.bad & core, axis=(1, 2)),
        StarFlag.LOW_SNR: low,
        StarFlag.AT_BOUND: solution.at_bound[:, PIXEL : LINE + 1].any(axis=1),
        StarFlag.BLENDED: _blended(center, prior),
        StarFlag.COSMIC_RAY: cosmic,
        StarFlag.NOT_FINITE: ~finite,
    }
    return combine_flags(conditions, len(p))


def _blended(center: FloatArray, prior: ShapePrior) -> BoolArray:
    """True where another fitted star shares the pixels."""
    radius = max(BLEND_SIGMAS * prior.sigma_px, BLEND_PX)
    blended = np.zeros(len(center), bool)
    pairs = cKDTree(center).query_pairs(radius, output_type="ndarray")
    blended[pairs.ravel()] = True
    return blended
