"""Center of a body smaller than the PSF: modelled as a star, as in AAS 13-443, "Unresolved Object Centerfinding".

Flow   predicted place -> matched filter within the search radius -> least squares with the frame's PSF ->
       center of figure
Frame  (pixel, line), 0-based, integer = pixel center

A small disk at phase is brighter on its sunward side, so that its light lies off its center of figure; the
caller gives that offset and it is taken out, with its uncertainty.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodycenters.detection import detection_snr
from opnav_workbench.bodycenters.flags import BodyFlag
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.bodycenters.unresolved_judging import METHOD, NEIGHBOUR_PX, Judgement, not_detected
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.starcenters import (
    NoiseModel,
    ShapePrior,
    StarCenters,
    correlate,
    default_box_px,
    fit_gaussian,
    gaussian_template,
)

__all__ = ["find_unresolved"]

NEIGHBOUR_SIGMAS = 5.0  # a neighbour 1000 times brighter is still lost in the noise out there
NEIGHBOUR_BOX_PX = 10.0  # the fit's box reaches this far from the body, at most
BURIED = "nothing but saturated pixels stands out near its predicted place; take a shorter exposure"
# A disk convolved with the PSF has a wider Gaussian: a uniform disk of diameter D has sigma D / 4.
DISK_SIGMA = 0.25
FINAL_SEARCH_PX = 2.0  # about the matched filter's place
FINALS = ("least_squares", "matched_filter", "cross_correlation")


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
    final: Literal["least_squares", "matched_filter", "cross_correlation"] = "least_squares",
    predicted_flux_dn: float | None = None,
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
    final : {"least_squares", "matched_filter", "cross_correlation"}
        What gives the center, once the matched filter has found the body.
    predicted_flux_dn : float, optional
        A body that is much brighter or fainter than this is doubted: it may be a star.

    Returns
    -------
    BodyCenter
        Status ``ok``; ``uncertain`` (SNR below 5, or a flag against the fit); ``not_detected``,
        ``off_detector``, ``saturated`` or ``failed`` without a center.

    Raises
    ------
    CenterfindingError
        An unknown `final`.
    """
    if final not in FINALS:
        raise CenterfindingError(f"final must be one of {', '.join(FINALS)}, got {final!r}.")
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
    stars = _StarLike(image_dn, noise_dn, bad, saturated, widened)
    coarse = stars.correlated(predicted, max(search_radius_px, 1.0), "matched_filter")
    if not coarse.snr[0] >= detection_snr(search_radius_px, widened.sigma_px):
        if _saturated_nearby(saturated, predicted, search_radius_px):
            flags = int(BodyFlag.OVEREXPOSED)
            return BodyCenter.without_center(name, METHOD, "saturated", BURIED, flags=flags)
        return not_detected(name, float(coarse.snr[0]), search_radius_px, widened.sigma_px)
    if final == "least_squares":
        fit = stars.fitted(coarse.pixel_line[0], noise_model, psf_error)
    else:
        fit = stars.correlated(coarse.pixel_line[0], FINAL_SEARCH_PX, final)
    judgement = Judgement(
        name=name,
        prior=widened,
        offset_px=np.asarray(light_offset_px, dtype=np.float64),
        floor_px2=excess_sigma_px**2 * np.eye(2) + np.asarray(light_offset_covariance_px2),
        predicted_px=predicted,
        search_radius_px=search_radius_px,
        neighbours_px=neighbours,
        predicted_flux_dn=predicted_flux_dn,
    )
    return judgement.of(fit)


@dataclass(frozen=True, slots=True, eq=False)
class _StarLike:
    """A picture in which one star-like image is measured."""

    image_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    saturated: ArrayLike | None
    prior: ShapePrior

    def correlated(
        self, start: FloatArray, radius_px: float, method: Literal["matched_filter", "cross_correlation"]
    ) -> StarCenters:
        return correlate(
            self.image_dn,
            self.noise_dn,
            self.bad,
            start[None],
            gaussian_template(self.prior.sigma_px, default_box_px(self.prior.sigma_px)),
            search_radius_px=radius_px,
            method=method,
            saturated=self.saturated,
        )

    def fitted(self, start: FloatArray, noise_model: NoiseModel | None, psf_error: float) -> StarCenters:
        return fit_gaussian(
            self.image_dn,
            self.noise_dn,
            self.bad,
            start[None],
            self.prior,
            saturated=self.saturated,
            noise_model=noise_model,
            psf_error=psf_error,
            mask_hits=False,  # what is not like a star shall be doubted, not mended
        )


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
