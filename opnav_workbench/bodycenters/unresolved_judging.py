"""Whether a star's fit is that of the body which was looked for."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.detection import detection_snr
from opnav_workbench.bodycenters.flags import BodyFlag
from opnav_workbench.bodycenters.results import BodyCenter, BodyPictures
from opnav_workbench.starcenters import (
    PsfShape,
    ShapePrior,
    StarCenters,
    StarFlag,
    describe_flags,
)

__all__ = ["METHOD", "NEIGHBOUR_PX", "Judgement", "not_detected"]

METHOD = "unresolved"
DETECTED_SNR = 3.0  # of the fit; the peak it starts from has stood out of its whole search area
CERTAIN_SNR = 5.0
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


def not_detected(name: str, snr: float, radius_px: float, sigma_px: float) -> BodyCenter:
    """Return the answer where nothing stands out."""
    seen = "no usable pixels"
    if np.isfinite(snr):
        seen = f"SNR {snr:.1f} at most, {detection_snr(radius_px, sigma_px):.1f} needed in so large an area"
    message = f"nothing found within {radius_px:.1f} px of its predicted place ({seen})"
    return BodyCenter.without_center(name, METHOD, "not_detected", message)


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
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
        if _misfit(fit) > MAX_MISFIT_RATIO * fit.psf_error or _strange_shape(fit, self.prior):
            chi2 = float(fit.chi2_reduced[0])
            return [f"its image is not that of a star (reduced chi-squared {chi2:.1f})"]
        return []


def _pictures(fit: StarCenters) -> BodyPictures | None:
    images = fit.images
    if images is None:
        return None
    data, model = images.data_dn[0], images.model_dn[0]
    mask = np.isfinite(images.sigma_dn[0]) & np.isfinite(data)
    pixel, line = (int(n) for n in images.first[0])
    known = np.where(np.isfinite(data), data, 0.0)
    window = (pixel, line, images.size, images.size)
    return BodyPictures(window, known, model, np.where(mask, known - model, 0.0), mask)


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
