"""Center of a body smaller than the PSF: measured as a star, as in AAS 13-443, "Unresolved Object Centerfinding".

Flow   predicted place -> matched filter within the search radius -> least squares with the frame's PSF -> is it the body?
       -> center of light -> model rendered there and measured the same way -> light minus figure -> center of figure
Frame  (pixel, line), 0-based, integer = pixel center

A small disk at phase is brighter on its sunward side, so that its light lies off its center of figure. `find_unresolved`
needs no body model: its caller gives that offset, and it is taken out, with its uncertainty. `find_unresolved_body`
measures the body's rendered model just as the picture is measured, so that whatever the star fit makes of a small
crescent (its light is beside its center of figure, and it is no Gaussian) is taken out, for any size, phase and place
between the pixels.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ndtr

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.picture import BodyPicture, Circle, model_picture
from opnav_workbench.bodies.results import BodyCenter, BodyFlag, BodyResiduals
from opnav_workbench.bodies.subarray import choose_subarray, search_radius
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars import (
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
from opnav_workbench.targets import center_of_light_radii

__all__ = ["find_unresolved", "find_unresolved_body", "law_covariance"]


# ---- Whether a star's fit is that of the body which was looked for.

METHOD = "unresolved"
DETECTED_SNR = 3.0  # of the fit; the peak it starts from has stood out of its whole search area
CERTAIN_SNR = 5.0
FALSE_ALARM = 0.01  # one search area in a hundred may hold noise that looks like a body
NEIGHBOUR_PX = 4.0  # a star nearer than this pulls the center
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
MAX_FLUX_RATIO = 4.0  # 1.5 mag: phase laws, light curves and zero points together are not so far off
SATURATED = "its core is saturated; take a shorter exposure"
BODY_FLAGS = {
    StarFlag.EDGE: BodyFlag.CUT_BY_EDGE,
    StarFlag.SATURATED: BodyFlag.OVEREXPOSED,
    StarFlag.BAD_PIXELS: BodyFlag.BAD_PIXELS,
    StarFlag.AT_BOUND: BodyFlag.AT_LIMIT,
    StarFlag.COSMIC_RAY: BodyFlag.POOR_FIT,
    StarFlag.NOT_CONVERGED: BodyFlag.NOT_CONVERGED,
    StarFlag.NOT_FINITE: BodyFlag.EMPTY,
    StarFlag.HIT: BodyFlag.HIT,
}


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
        return float(area + rim + ndtr(-level) - FALSE_ALARM)

    return float(brentq(surplus, 1.0, 10.0))


def not_detected(name: str, snr: float, radius_px: float, sigma_px: float) -> BodyCenter:
    """Return the answer where nothing stands out."""
    seen = "no usable pixels"
    if np.isfinite(snr):
        seen = f"SNR {snr:.1f} at most, {detection_snr(radius_px, sigma_px):.1f} needed in so large an area"
    message = f"nothing found within {radius_px:.1f} px of its predicted place ({seen})"
    return BodyCenter.without_center(name, METHOD, "not_detected", message)


@dataclass(frozen=True, slots=True, eq=False)
class StarFitAssessment:
    """What a fit is judged by."""

    name: str
    prior: ShapePrior
    offset_px: FloatArray  # center of light minus center of figure
    floor_px2: FloatArray  # covariance beside that of the fit
    predicted_px: FloatArray
    search_radius_px: float
    neighbours_px: FloatArray
    predicted_flux_dn: float | None

    def of(self, fit: StarCenters) -> BodyCenter:
        """Return the body's center, or why the fit gives none."""
        flags, snr = int(fit.flags[0]), float(fit.snr[0])
        known = int(sum(body for star, body in BODY_FLAGS.items() if flags & star))
        if flags & StarFlag.SATURATED:
            return BodyCenter.without_center(self.name, METHOD, "saturated", SATURATED, flags=known)
        if flags & FIT_FAILED:
            message = describe_flags(flags & FIT_FAILED)
            return BodyCenter.without_center(self.name, METHOD, "failed", message, flags=known)
        center = fit.pixel_line[0] - self.offset_px
        if np.hypot(*(center - self.predicted_px)) > self.search_radius_px + 1.0 or snr < DETECTED_SNR:
            return not_detected(self.name, snr, self.search_radius_px, self.prior.sigma_px)
        unlike = self._unlike(fit)
        doubts = self._doubts(fit, center) + unlike
        return BodyCenter(
            name=self.name,
            method=METHOD,
            status="uncertain" if doubts else "ok",
            pixel_line=center,
            covariance_px2=fit.covariance_px2[0] + self.floor_px2,
            flux_dn=float(fit.flux_dn[0]),
            snr=snr,
            messages=tuple(doubts),
            flags=known | int(BodyFlag.POOR_FIT if unlike else BodyFlag.OK),
            noise_covariance_px2=fit.covariance_px2[0],
            chi2_reduced=float(fit.chi2_reduced[0]),
            background_dn=float(fit.background_dn[0]),
            pictures=_pictures(fit),
        )

    def _doubts(self, fit: StarCenters, center: FloatArray) -> list[str]:
        flags, snr = int(fit.flags[0]), float(fit.snr[0])
        doubts = []
        if snr < CERTAIN_SNR:
            doubts.append(f"SNR {snr:.1f} is below {CERTAIN_SNR:g}")
        if flags & SUSPICIOUS:
            doubts.append(describe_flags(flags & SUSPICIOUS))
        ratio = float(fit.flux_dn[0]) / self.predicted_flux_dn if self.predicted_flux_dn else 1.0
        if not 1.0 / MAX_FLUX_RATIO < ratio < MAX_FLUX_RATIO:
            doubts.append(f"it is {ratio:.2g} times as bright as predicted")
        distance = np.hypot(*(self.neighbours_px - center).T)
        near = distance[np.isfinite(distance) & (distance < NEIGHBOUR_PX)]
        if near.size:
            doubts.append(f"another object {near.min():.1f} px away may pull its center")
        return doubts

    def _unlike(self, fit: StarCenters) -> list[str]:
        """Say where an image is not that of a star; correlations, which fit no shape, cannot tell."""
        if fit.method != "least_squares":
            return []
        known_to = max(fit.psf_error, self.prior.correction_part)
        if _misfit(fit) > MAX_MISFIT_RATIO * known_to or _strange_shape(fit, self.prior):
            chi2 = float(fit.chi2_reduced[0])
            return [f"its image is not that of a star (reduced chi-squared {chi2:.1f})"]
        return []


def _pictures(fit: StarCenters) -> BodyResiduals | None:
    images = fit.images
    if images is None:
        return None
    data, model = images.data_dn[0], images.model_dn[0]
    mask = np.isfinite(images.sigma_dn[0]) & np.isfinite(data)
    pixel, line = (int(n) for n in images.first[0])
    known = np.where(np.isfinite(data), data, 0.0)
    window = (pixel, line, images.size, images.size)
    return BodyResiduals(window, known, model, np.where(mask, known - model, 0.0), mask)


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


# ---- Center of a body smaller than the PSF.

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
    prior
        The frame's PSF.
    search_radius_px
        How far the body may be from its prediction.
    saturated : (n_line, n_pixel) array_like of bool, optional
    noise_model
        Adds the body's own shot noise to the weights.
    psf_error
        Relative error of the PSF model as the frame's stars tell it (`StarCenters.psf_error`).
    excess_sigma_px
        Centering error of the frame's stars beyond their covariances (`PointingSolution.excess_sigma_px`);
        the body suffers it too.
    diameter_px
        Predicted diameter, which widens the PSF.
    light_offset_px, light_offset_covariance_px2 : (2,), (2, 2) array_like
        Center of light minus center of figure.
    neighbours_px : (k, 2) array_like
        Places of other stars and bodies.
    final
        What gives the center, once the matched filter has found the body.
    predicted_flux_dn
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
    judgement = StarFitAssessment(
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
    return replace(prior, log_scale=float(np.log(sigma)))


def _saturated_nearby(saturated: ArrayLike | None, predicted: FloatArray, radius_px: float) -> bool:
    """True where a saturated pixel lies within the search area: the body may be under it."""
    if saturated is None:
        return False
    line, pixel = np.nonzero(np.asarray(saturated, dtype=bool))
    return bool(np.any(np.hypot(pixel - predicted[0], line - predicted[1]) <= radius_px + 1.0))


# ---- Center of figure of a small body at phase.

MAX_ROUNDS = 5  # the correction depends on the place by less than half of itself
STILL_PX = 5e-4
MARGIN_PX = 3.0
PSF_KNOWN_TO = 0.03  # of a PSF that the picture is given with
CLEAR_SNR = 30.0  # to which the model of a fainter body is raised, so that its fit is sure to find it
Final = Literal["least_squares", "matched_filter", "cross_correlation"]


def find_unresolved_body(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    search_radius_px: float | None = None,
    prior: ShapePrior | None = None,
    psf_error: float = 0.0,
    neighbours_px: ArrayLike = (),
    final: Final = "least_squares",
    law_sigma: float = 0.0,
) -> BodyCenter:
    """Find the center of figure of a body too small to show a disk.

    Parameters
    ----------
    circle
        Where an analyst sees it.
    search_radius_px
        How far from there it may be; by default that of the full-disk methods.
    prior
        The frame's PSF; by default that of the picture.
    psf_error, neighbours_px, final
        As in `find_unresolved`; other bodies of the scene are neighbours anyway.
    law_sigma
        How well the surface's scattering law is known: 0, as the model has it; 1, no better than that it lies between
        Lambert's and Lommel and Seeliger's. Its effect on the light's place enters the covariance.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, or `final` is unknown.
    """
    expected = picture.center_px(name) if circle is None else circle.center_px
    diameter = picture.diameter_px(name)
    others = [picture.center_px(m.target.name) for m in picture.models if m.target.name != name]
    request = _StarLikeRequest(
        picture=picture,
        name=name,
        prior=prior or psf_prior(picture),
        psf_error=psf_error,
        search_px=search_radius(0.5 * diameter, circle, search_radius_px),
        diameter_px=diameter,
        neighbours_px=np.concatenate([np.reshape(others, (-1, 2)), np.reshape(neighbours_px, (-1, 2))]),
        final=final,
        surface_px2=law_covariance(picture, name, law_sigma) + figure_covariance(picture, name),
    )
    found = request.measured(picture.signal_dn, expected, np.zeros(2))
    if picture.model(name).is_point or found.status in ("off_detector", "saturated", "failed"):
        return found
    for _ in range(MAX_ROUNDS):
        if found.pixel_line is None:
            break
        before, found = found.pixel_line, _corrected(request, found, expected)
        if found.pixel_line is not None and np.abs(found.pixel_line - before).max() < STILL_PX:
            break
    return found


def psf_prior(picture: BodyPicture) -> ShapePrior:
    """Return the picture's PSF as the star fit wants it."""
    sigma = float(np.sqrt(np.mean(np.square(picture.psf.sigma_px))))
    return ShapePrior.round_psf(sigma, PSF_KNOWN_TO, PSF_KNOWN_TO)


def law_covariance(picture: BodyPicture, name: str, law_sigma: float) -> FloatArray:
    """Return what the choice of a scattering law does to the place of a sphere's light (2, 2), px^2, along the Sun."""
    sun, phase = picture.model(name).target.sun_position_km, picture.phase_rad(name)
    if law_sigma == 0.0 or sun is None or not picture.diameter_px(name) > 0.0:
        return np.zeros((2, 2))
    _, sigma = center_of_light_radii(phase)
    along = _sunward(picture, name, sun)
    return np.asarray((law_sigma * sigma * 0.5 * picture.diameter_px(name)) ** 2 * np.outer(along, along))


# Place of a full disk's light, in radii, for hemispheres that differ by 1 sigma (`FigureUncertainty.albedo_sigma`).
ALBEDO_LEVER = 0.13


def figure_covariance(picture: BodyPicture, name: str) -> FloatArray:
    """Return what size and brightness of a body's hemispheres do to the place of its light (2, 2), px^2."""
    sun, radius = picture.model(name).target.sun_position_km, 0.5 * picture.diameter_px(name)
    if not radius > 0.0:
        return np.zeros((2, 2))
    figure = picture.model(name).seen_figure
    out = (ALBEDO_LEVER * figure.albedo_sigma * radius) ** 2 * np.eye(2)
    if sun is not None:
        offset, _ = center_of_light_radii(picture.phase_rad(name))
        along = _sunward(picture, name, sun)
        out += (figure.size_sigma * offset * radius) ** 2 * np.outer(along, along)
    return np.asarray(out)


def _sunward(picture: BodyPicture, name: str, sun_km: FloatArray) -> FloatArray:
    """Return the direction (2,) in the picture in which a body's Sun stands; 0 behind or before it."""
    in_camera = picture.camera_from_j2000 @ picture.prediction(name).direction
    sunward = picture.camera.project_jacobian(in_camera[None])[0] @ (picture.camera_from_j2000 @ sun_km)
    length = float(np.hypot(*sunward))
    return np.asarray(sunward / length if length > 0.0 else np.zeros(2))


@dataclass(frozen=True, slots=True, eq=False)
class _StarLikeRequest:
    picture: BodyPicture
    name: str
    prior: ShapePrior
    psf_error: float
    search_px: float
    diameter_px: float
    neighbours_px: FloatArray
    final: Final
    surface_px2: FloatArray

    def measured(self, image_dn: FloatArray, expected: FloatArray, offset: FloatArray) -> BodyCenter:
        """Measure the body in an image of the picture's size."""
        picture = self.picture
        flux_e = picture.model(self.name).flux_e
        return find_unresolved(
            np.where(np.isfinite(image_dn), image_dn, 0.0),
            picture.noise_dn,
            picture.bad | ~np.isfinite(image_dn),
            expected,
            self.prior,
            name=self.name,
            search_radius_px=self.search_px,
            saturated=picture.saturated,
            noise_model=picture.noise_model,
            psf_error=self.psf_error,
            excess_sigma_px=picture.excess_sigma_px,
            diameter_px=self.diameter_px,
            light_offset_px=offset,
            light_offset_covariance_px2=self.surface_px2,
            neighbours_px=self.neighbours_px,
            final=self.final,
            predicted_flux_dn=None if flux_e is None else flux_e / picture.gain_e_per_dn,
        )


def _corrected(request: _StarLikeRequest, found: BodyCenter, expected: FloatArray) -> BodyCenter:
    """Measure the body again, with what its rendered light at the place found shows."""
    assert found.pixel_line is not None
    picture, center = request.picture, found.pixel_line
    margin = default_box_px(request.prior.sigma_px) + MARGIN_PX
    radius = max(0.5 * request.diameter_px, 0.5)
    part = choose_subarray(picture, request.name, Circle(center, radius), margin)
    light = model_picture(picture, part.window, {request.name: center}, only=(request.name,))
    if part.empty or not light.sum() > 0.0:
        return found
    raised = max(1.0, CLEAR_SNR / found.snr)
    first = np.array(part.window[:2], dtype=np.float64)
    model = find_unresolved(
        light * (raised * found.flux_dn / light.sum()),
        picture.noise_dn[part.slices],
        picture.bad[part.slices],
        center - first,
        request.prior,
        name=request.name,
        search_radius_px=radius + MARGIN_PX,
        saturated=picture.saturated[part.slices],
        noise_model=picture.noise_model,
        diameter_px=request.diameter_px,
        final=request.final,
    )
    if model.pixel_line is None:
        return found
    image = picture.signal_dn
    if request.final == "least_squares" and model.pictures is not None:
        image = _without(image, model.pictures, part.window, raised)
    return request.measured(image, expected, model.pixel_line + first - center)


def _without(
    image: FloatArray, own: BodyResiduals, window: tuple[int, int, int, int], raised: float
) -> FloatArray:
    """Return the image less what the body's light has beyond the Gaussian that is fitted to it."""
    pixel, line = own.window[0] + window[0], own.window[1] + window[1]
    n_line, n_pixel = own.difference_dn.shape
    top, left = max(0, -line), max(0, -pixel)
    into = np.array(image)
    place = into[max(line, 0) : line + n_line, max(pixel, 0) : pixel + n_pixel]
    place -= own.difference_dn[top : top + place.shape[0], left : left + place.shape[1]] / raised
    return into
