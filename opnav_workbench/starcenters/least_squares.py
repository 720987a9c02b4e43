"""The workhorse: least squares of a pixel-integrated elliptical Gaussian, all stars at once.

Flow   image, noise, first centers (matched filter, cross-correlation, prediction) -> here -> pointing
Units  DN, px; flux is the star's total over the whole plane

Estimated are flux, center, log scale and ellipticity of the PSF (with a prior: in an undersampled image they cannot be had from
one star), and the background as a level or a plane. Pixels are weighted by the expected noise.

Reference: Jackman & Dumont (2013), AAS 13-443, "The Non-Linear Least Squares Estimator".
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.starcenters.boxes import Boxes, Pixels, check_image, check_points, cut_boxes
from opnav_workbench.starcenters.flags import StarFlag, combine_flags
from opnav_workbench.starcenters.levenberg import Evaluation, Solution, solve_batched
from opnav_workbench.starcenters.psf import box_integrals, ellipse_from_shape
from opnav_workbench.starcenters.results import NoiseModel, ShapePrior, StarCenters
from opnav_workbench.starcenters.search import brightest_pixel

__all__ = ["BACKGROUNDS", "default_box_px", "fit_gaussian", "misfit_factor"]

BACKGROUNDS = ("level", "plane")
METHOD = "least_squares"

FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL, SLOPE_PIXEL, SLOPE_LINE = range(9)

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
        With it, the shot noise of the fitted star is added to `noise_dn`, which then must not hold it already.
    psf_error : float
        Relative error of the Gaussian as a model of the PSF. The covariance allows for that fraction of the star in each
        pixel (see `estimate_psf_error`); the weights stay those of the noise, so that the centers do not depend on it.
    search_radius_px : float
        The brightest point of the search area starts the fit; the center stays within it, along each axis.
    inflate_misfit : bool
        Scale the covariance of center and shape by the reduced chi-square (less what `psf_error` explains) where that is
        significantly above 1 (see `misfit_factor`).

    Returns
    -------
    StarCenters
        Covariance is the inverse of the normal matrix, prior included, shape and background marginalized; flux sigma
        and signal-to-noise ratio tell of the noise alone.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, a box too small, an unknown background.

    Examples
    --------
    >>> from opnav_workbench.starcenters.psf import pixel_gaussian
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
    model = _StarModel.of(boxes, noise_model, parameters)
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


@dataclass(frozen=True, slots=True, eq=False)
class _StarModel:
    """Star plus background in every box; called by the solver with the boxes it still works on."""

    first: FloatArray  # (n, 2)
    data: FloatArray  # (n, m)
    variance: FloatArray  # (n, m) infinite where unusable
    basis: FloatArray  # (b, m) level, and slopes about the middle of the box
    size: int
    gain: float  # e/DN, infinite without shot noise

    @classmethod
    def of(cls, boxes: Boxes, noise: NoiseModel | None, parameters: int) -> "_StarModel":
        n, size = len(boxes.first), boxes.size
        line, pixel = np.indices((size, size), dtype=float).reshape(2, -1) - (size - 1) / 2
        basis = np.stack([np.ones(size * size), pixel, line])[: parameters - LEVEL]
        gain = np.inf if noise is None else noise.gain_e_per_dn
        data, variance = boxes.data_dn.reshape(n, -1), boxes.variance_dn2.reshape(n, -1)
        return cls(boxes.first.astype(float), data, variance, basis, size, gain)

    def __call__(self, index: IntArray, p: FloatArray) -> Evaluation:
        psf = box_integrals(p[:, PIXEL : LINE + 1], p[:, SCALE : E2 + 1], self.first[index], self.size)
        k, flux = len(p), p[:, FLUX, None]
        jacobian = np.empty((k, p.shape[1], self.size**2))
        jacobian[:, FLUX] = psf.value.reshape(k, -1)
        for column, derivative in (
            (PIXEL, psf.d_pixel), (LINE, psf.d_line), (SCALE, psf.d_log_scale), (E1, psf.d_e1), (E2, psf.d_e2),
        ):  # fmt: skip
            np.multiply(flux, derivative.reshape(k, -1), out=jacobian[:, column])
        jacobian[:, LEVEL:] = self.basis
        star = flux * jacobian[:, FLUX]
        residual = self.data[index] - star - p[:, LEVEL:] @ self.basis
        variance = self.variance[index]
        if np.isfinite(self.gain):
            variance = variance + np.maximum(star, 0.0) / self.gain
        return Evaluation(residual, 1.0 / variance, jacobian)

    def linear_start(self, center: FloatArray, prior: ShapePrior) -> FloatArray:
        """Return parameters with flux and background level solved linearly at `center` and the prior's shape."""
        n = len(center)
        shape = np.broadcast_to(prior.mean, (n, 3))
        psf = box_integrals(center, shape, self.first, self.size).value.reshape(n, -1)
        w = 1.0 / self.variance
        s, st, stt = np.sum(w, 1), np.sum(w * psf, 1), np.sum(w * psf**2, 1)
        sd, std = np.sum(w * self.data, 1), np.sum(w * psf * self.data, 1)
        det = s * stt - st**2
        solvable = det > 1e-12 * s * stt
        det = np.where(solvable, det, 1.0)
        p = np.zeros((n, LEVEL + len(self.basis)))
        p[:, FLUX] = np.where(solvable, (s * std - st * sd) / det, 0.0)
        p[:, LEVEL] = np.where(solvable, (stt * sd - st * std) / det, 0.0)
        p[:, PIXEL : LINE + 1] = center
        p[:, SCALE : E2 + 1] = shape
        return p

    def with_psf_error(self, p: FloatArray, covariance: FloatArray, error: float) -> tuple[FloatArray, FloatArray]:
        """Return the covariance with the error of the PSF model propagated through the fit, and the chi2 it adds.

        With C the inverse normal matrix the fit is linear in the data by C J' W; their error adds C J'W V WJ C.
        """
        state = self(np.arange(len(p)), p)
        psf_variance = (error * p[:, FLUX, None] * state.jacobian[:, FLUX]) ** 2
        gain = np.matmul(covariance, state.jacobian * state.weight[:, None, :])
        added = np.matmul(gain * psf_variance[:, None, :], np.swapaxes(gain, 1, 2))
        return covariance + added, np.sum(state.weight * psf_variance, axis=1)

    def background_at(self, center: FloatArray, p: FloatArray) -> FloatArray:
        """Return the background (DN) at `center`; (n,)."""
        offset = center - self.first - (self.size - 1) / 2
        basis = np.column_stack([np.ones(len(p)), offset])[:, : len(self.basis)]
        return np.sum(basis * p[:, LEVEL:], axis=1)


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
    solution: Solution, boxes: Boxes, model: _StarModel, prior: ShapePrior, psf_error: float, inflate: bool
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

    Covariances are scaled by it: where the noise does not explain the residuals, neither does it the error of the center.
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
    cosmic = (p[:, SCALE] < prior.log_scale + np.log(COSMIC_RAY_SCALE)) & (prior.sigma_px >= RESOLVED_SIGMA_PX)
    conditions = {
        StarFlag.NOT_CONVERGED: ~solution.converged,
        StarFlag.SATURATED: (boxes.saturated & core).any(axis=(1, 2)),
        StarFlag.EDGE: boxes.outside.any(axis=(1, 2)),
        StarFlag.BAD_PIXELS: (boxes.bad & core).any(axis=(1, 2)),
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
