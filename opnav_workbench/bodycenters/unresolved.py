"""Center of a body smaller than the PSF: modelled as a star, as in AAS 13-443, "Unresolved Object Centerfinding".

Flow   predicted place -> matched filter within the search radius -> least squares with the frame's PSF ->
       center of figure
Frame  (pixel, line), 0-based, integer = pixel center

A small disk at phase is brighter on its sunward side, so that its light lies off its center of figure; the
caller gives that offset and it is taken out, with its uncertainty.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import norm

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.starcenters import (
    NoiseModel,
    PsfShape,
    ShapePrior,
    StarCenters,
    StarFlag,
    correlate,
    default_box_px,
    describe_flags,
    fit_gaussian,
    gaussian_template,
)

__all__ = ["find_unresolved"]

METHOD = "unresolved"
DETECTED_SNR = 3.0  # of the fit; the peak it starts from has stood out of its whole search area
FALSE_ALARM = 0.01  # one search area in a hundred may hold noise that looks like a body
CERTAIN_SNR = 5.0
NEIGHBOUR_PX = 4.0  # a star nearer than this pulls the center
NEIGHBOUR_SIGMAS = 5.0  # a neighbour 1000 times brighter is still lost in the noise out there
NEIGHBOUR_BOX_PX = 10.0  # the fit's box reaches this far from the body, at most
FIT_FAILED = StarFlag.NOT_CONVERGED | StarFlag.NOT_FINITE
SUSPICIOUS = StarFlag.AT_BOUND | StarFlag.EDGE | StarFlag.COSMIC_RAY | StarFlag.BLENDED
# A fit that leaves this many times the variance of the noise is not one of a star's image: a noise map that is
# off by half gives 2.3, cosmic rays and disks much more.
MAX_CHI2_REDUCED = 3.0
# Where the frame's own stars already show a PSF that is no Gaussian (undersampled, smeared), a body may miss it by so many
# times as much: it differs from the stars in colour, and has faint neighbours of its own (Proxima Centauri: 2.4 to 3.1).
MAX_MISFIT_RATIO = 4.0
# Neither is an image whose width or ellipticity leaves the frame's PSF by so many sigmas, and by so much.
SHAPE_SIGMAS = 4.0
SHAPE_DEVIATION = 0.3
SATURATED = "its core is saturated; take a shorter exposure"
BURIED = "nothing but saturated pixels stands out near its predicted place; take a shorter exposure"
# A disk convolved with the PSF has a wider Gaussian: a uniform disk of diameter D has sigma D / 4.
DISK_SIGMA = 0.25


def find_unresolved(
    image_dn: FloatArray,
    noise_dn: FloatArray,
    bad: ArrayLike,
    prediction_px: ArrayLike,
    prior: ShapePrior,
    *,
    name: str,
    search_radius_px: float,
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    psf_error: float = 0.0,
    excess_sigma_px: float = 0.0,
    diameter_px: float = 0.0,
    light_offset_px: ArrayLike = (0.0, 0.0),
    light_offset_covariance_px2: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    neighbours_px: ArrayLike = (),
) -> BodyCenter:
    """Find an unresolved body near its predicted place.

    Parameters
    ----------
    image_dn, noise_dn, bad : (n_line, n_pixel) arrays
        Picture, its expected noise without the body's own shot noise, and the pixels to leave out.
    prediction_px : (2,) array_like
        Predicted center of figure (pixel, line); nan for a body behind the camera.
    prior : ShapePrior
        The frame's PSF.
    name : str
    search_radius_px : float
        How far the body may be from its prediction.
    saturated : (n_line, n_pixel) array_like of bool, optional
    noise_model : NoiseModel, optional
        Adds the body's own shot noise to the weights.
    psf_error : float
        Relative error of the PSF model as the frame's stars tell it (`StarCenters.psf_error`).
    excess_sigma_px : float
        Centering error of the frame's stars beyond their covariances (`PointingSolution.excess_sigma_px`);
        the body suffers it too.
    diameter_px : float
        Predicted diameter, which widens the PSF.
    light_offset_px, light_offset_covariance_px2 : (2,), (2, 2) array_like
        Center of light minus center of figure.
    neighbours_px : (k, 2) array_like
        Places of other stars and bodies.

    Returns
    -------
    BodyCenter
        Status ``ok``; ``uncertain`` (SNR below 5, or a flag against the fit); ``not_detected``,
        ``off_detector``, ``saturated`` or ``failed`` without a center.
    """
    predicted = np.asarray(prediction_px, dtype=np.float64)
    n_line, n_pixel = np.shape(image_dn)
    if not _inside(predicted, n_pixel, n_line):
        return BodyCenter.without_center(
            name, METHOD, "off_detector", _off_detector(predicted, n_pixel, n_line)
        )
    widened = _widened(prior, diameter_px)
    neighbours = np.reshape(neighbours_px, (-1, 2))
    bad = np.asarray(bad, dtype=bool) | _nearer_to_neighbours(
        predicted, neighbours, widened, (n_line, n_pixel)
    )
    coarse = correlate(
        image_dn,
        noise_dn,
        bad,
        predicted[None],
        gaussian_template(widened.sigma_px, default_box_px(widened.sigma_px)),
        search_radius_px=max(search_radius_px, 1.0),
        saturated=saturated,
    )
    if not coarse.snr[0] >= detection_snr(search_radius_px, widened.sigma_px):
        if _saturated_nearby(saturated, predicted, search_radius_px):
            return BodyCenter.without_center(name, METHOD, "saturated", BURIED)
        return _not_detected(name, float(coarse.snr[0]), search_radius_px, widened.sigma_px)
    fit = fit_gaussian(
        image_dn,
        noise_dn,
        bad,
        coarse.pixel_line,
        widened,
        saturated=saturated,
        noise_model=noise_model,
        psf_error=psf_error,
        mask_hits=False,  # what is not like a star shall be doubted, not mended
    )
    offset = np.asarray(light_offset_px, dtype=np.float64)
    floor = excess_sigma_px**2 * np.eye(2) + np.asarray(light_offset_covariance_px2)
    return _judged(name, fit, widened, offset, floor, predicted, search_radius_px, neighbours)


def detection_snr(search_radius_px: float, sigma_px: float) -> float:
    """Return the SNR that noise alone exceeds, somewhere in a circular search area, with `FALSE_ALARM`.

    The expected Euler characteristic of a Gaussian random field above a level; white noise filtered with a
    Gaussian of `sigma_px` has gradients of variance 1 / (2 sigma^2).

    Reference: Adler (1981), The Geometry of Random Fields; Worsley (1996), doi:10.2307/1427576.

    Examples
    --------
    >>> [round(detection_snr(radius, 0.7), 1) for radius in (3.0, 30.0)]
    [3.7, 4.8]
    """
    radius = search_radius_px / (np.sqrt(2.0) * sigma_px)

    def surplus(level: float) -> float:
        density = np.exp(-0.5 * level**2)
        area = np.pi * radius**2 * level * density / (2.0 * np.pi) ** 1.5
        rim = np.pi * radius * density / (2.0 * np.pi)
        return float(area + rim + norm.sf(level) - FALSE_ALARM)

    return float(brentq(surplus, 1.0, 10.0))


def _inside(place: FloatArray, n_pixel: int, n_line: int) -> bool:
    return bool(-0.5 <= place[0] < n_pixel - 0.5 and -0.5 <= place[1] < n_line - 0.5)


def _nearer_to_neighbours(
    predicted: FloatArray, neighbours: FloatArray, prior: ShapePrior, shape: tuple[int, int]
) -> BoolArray:
    """Pixels that a neighbour's light reaches and that are nearer to it than to the body."""
    reach = NEIGHBOUR_SIGMAS * prior.sigma_px + 1.0
    limit = reach + NEIGHBOUR_BOX_PX
    line, pixel = np.indices(shape, sparse=True)
    own = np.hypot(pixel - predicted[0], line - predicted[1])
    masked = np.zeros(shape, dtype=bool)
    distance = np.hypot(*(neighbours - predicted).T)
    for place in neighbours[np.isfinite(distance) & (distance > NEIGHBOUR_PX) & (distance < 2.0 * limit)]:
        other = np.hypot(pixel - place[0], line - place[1])
        masked |= (other < reach) & (other < own)
    return masked


def _off_detector(predicted: FloatArray, n_pixel: int, n_line: int) -> str:
    if not np.isfinite(predicted).all():
        return "it is not in front of the camera"
    if np.abs(predicted).max() > 10 * max(n_pixel, n_line):
        return "it is far outside the field"
    return f"predicted at pixel {predicted[0]:.1f}, line {predicted[1]:.1f}, outside the {n_pixel} x {n_line} detector"


def _widened(prior: ShapePrior, diameter_px: float) -> ShapePrior:
    sigma = np.hypot(prior.sigma_px, DISK_SIGMA * diameter_px)
    return ShapePrior(float(np.log(sigma)), prior.sigma_log_scale, prior.ellipticity, prior.sigma_ellipticity)


def _saturated_nearby(saturated: ArrayLike | None, predicted: FloatArray, radius_px: float) -> bool:
    """True where a saturated pixel lies within the search area: the body may be under it."""
    if saturated is None:
        return False
    line, pixel = np.nonzero(np.asarray(saturated, dtype=bool))
    return bool(np.any(np.hypot(pixel - predicted[0], line - predicted[1]) <= radius_px + 1.0))


def _not_detected(name: str, snr: float, radius_px: float, sigma_px: float) -> BodyCenter:
    seen = "no usable pixels"
    if np.isfinite(snr):
        seen = f"SNR {snr:.1f} at most, {detection_snr(radius_px, sigma_px):.1f} needed in so large an area"
    return BodyCenter.without_center(
        name,
        METHOD,
        "not_detected",
        f"nothing found within {radius_px:.1f} px of its predicted place ({seen})",
    )


def _judged(
    name: str,
    fit: StarCenters,
    prior: ShapePrior,
    offset: FloatArray,
    floor: FloatArray,
    predicted: FloatArray,
    radius_px: float,
    neighbours: FloatArray,
) -> BodyCenter:
    flags, snr = int(fit.flags[0]), float(fit.snr[0])
    if flags & StarFlag.SATURATED:
        return BodyCenter.without_center(name, METHOD, "saturated", SATURATED)
    if flags & FIT_FAILED:
        return BodyCenter.without_center(name, METHOD, "failed", describe_flags(flags & FIT_FAILED))
    center = fit.pixel_line[0] - offset
    if np.hypot(*(center - predicted)) > radius_px + 1.0 or snr < DETECTED_SNR:
        return _not_detected(name, snr, radius_px, prior.sigma_px)
    doubts = _doubts(fit, prior, center, neighbours)
    return BodyCenter(
        name=name,
        method=METHOD,
        status="uncertain" if doubts else "ok",
        pixel_line=center,
        covariance_px2=fit.covariance_px2[0] + floor,
        flux_dn=float(fit.flux_dn[0]),
        snr=snr,
        messages=tuple(doubts),
    )


def _doubts(fit: StarCenters, prior: ShapePrior, center: FloatArray, neighbours: FloatArray) -> list[str]:
    flags, snr, chi2 = int(fit.flags[0]), float(fit.snr[0]), float(fit.chi2_reduced[0])
    doubts = []
    if snr < CERTAIN_SNR:
        doubts.append(f"SNR {snr:.1f} is below {CERTAIN_SNR:g}")
    if flags & SUSPICIOUS:
        doubts.append(describe_flags(flags & SUSPICIOUS))
    if _misfit(fit) > MAX_MISFIT_RATIO * fit.psf_error or _strange_shape(fit, prior):
        doubts.append(f"its image is not that of a star (reduced chi-squared {chi2:.1f})")
    distance = np.hypot(*(neighbours - center).T)
    near = distance[np.isfinite(distance) & (distance < NEIGHBOUR_PX)]
    if near.size:
        doubts.append(f"another object {near.min():.1f} px away may pull its center")
    return doubts


def _misfit(fit: StarCenters) -> float:
    """Part of the body's light that the PSF leaves unexplained, beyond the noise (compare `estimate_psf_error`)."""
    excess = max(float(fit.chi2_reduced[0]) - MAX_CHI2_REDUCED, 0.0) * float(fit.degrees_of_freedom[0])
    return float(np.sqrt(excess) / fit.snr[0])


def _strange_shape(fit: StarCenters, prior: ShapePrior) -> bool:
    major, minor, angle = fit.shape[0]
    deviation = np.abs(PsfShape(major, minor, angle).parameters - prior.mean)
    return bool(
        np.any((deviation * np.sqrt(prior.information) > SHAPE_SIGMAS) & (deviation > SHAPE_DEVIATION))
    )
