"""The PSF of a picture from its well-exposed stars, and the fit that uses it: fit, consensus, fit again.

A star alone does not tell its shape where the image is undersampled, but all stars of a picture share optics and
smear. From each star's fit the prior is taken out, the stars' own measurements are combined robustly with their
scatter, and the result is the tighter prior of a second fit. The stars also tell how well a Gaussian describes the PSF.
Where it does not, or where the picture is so undersampled that no star could tell, they tell what is missing
(`effective_psf`), and a third fit has it.

Reference: the scatter between stars follows DerSimonian & Laird (1986), doi:10.1016/0197-2456(86)90046-2, with medians.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.psf import EffectivePsf, PsfEvidence, shape_from_ellipse
from opnav_workbench.stars.boxes import Pixels, check_image
from opnav_workbench.stars.effective_psf import (
    ExpectedPlaces,
    learn_correction,
    prior_correction,
    unknown_correction,
)
from opnav_workbench.stars.flags import StarFlag
from opnav_workbench.stars.group_fit import FitSettings
from opnav_workbench.stars.least_squares import (
    SEARCH_RADIUS_PX,
    checked_settings,
    default_box_px,
    fit_gaussian,
)
from opnav_workbench.stars.picture_fit import misfit_factor
from opnav_workbench.stars.results import NoiseModel, ShapePrior, StarCenters
from opnav_workbench.threads import one_thread

__all__ = ["estimate_psf_error", "evidence_of_stars", "fit_stars", "shape_from_stars", "strange_images"]

WELL_EXPOSED_SNR = 30.0  # from here a star's shape is known to a few percent
MIN_SIGMA_LOG_SCALE = 0.03  # width and ellipticity differ between stars by at least this: field, color, smear
MIN_SIGMA_ELLIPTICITY = 0.03
OUTLIER_SIGMAS = 4.0
MAX_PSF_ERROR = 0.3

SHAPE_SPOILED = (
    StarFlag.NOT_CONVERGED | StarFlag.SATURATED | StarFlag.EDGE | StarFlag.BAD_PIXELS | StarFlag.LOW_SNR
    | StarFlag.BLENDED | StarFlag.COSMIC_RAY | StarFlag.NOT_FINITE
)  # fmt: skip


def shape_from_stars(
    centers: StarCenters, prior: ShapePrior, *, min_snr: float = WELL_EXPOSED_SNR
) -> ShapePrior:
    """Combine the shapes of a frame's well-exposed stars into a tighter prior for all its stars.

    Parameters
    ----------
    centers
        From `fit_gaussian` with `prior`.
    prior
        The prior of that fit; returned unchanged where no star is good enough.
    min_snr
        Stars below, and flagged ones, have no say.

    Returns
    -------
    ShapePrior
        Its sigmas hold the scatter from star to star and the uncertainty of the mean; never wider than
        `prior`.
    """
    good = well_exposed(centers, min_snr)
    if not good.any():
        return prior
    fitted = shape_from_ellipse(centers.shape[good])
    variance = np.diagonal(centers.shape_covariance[good], axis1=1, axis2=2)
    prior_variance = 1.0 / prior.information
    combined = [
        _combine_parameter(fitted[:, k], variance[:, k], float(prior.mean[k]), float(prior_variance[k]))
        for k in range(3)
    ]
    (scale, sigma_scale), (e1, sigma_e1), (e2, sigma_e2) = combined
    return ShapePrior(
        log_scale=scale,
        sigma_log_scale=min(max(sigma_scale, MIN_SIGMA_LOG_SCALE), prior.sigma_log_scale),
        ellipticity=np.array([e1, e2]),
        sigma_ellipticity=min(max(sigma_e1, sigma_e2, MIN_SIGMA_ELLIPTICITY), prior.sigma_ellipticity),
    )


def estimate_psf_error(centers: StarCenters, *, min_snr: float = WELL_EXPOSED_SNR) -> float:
    """Return the relative error of the Gaussian PSF model that the misfit of well-exposed stars tells of.

    The excess of chi-square over its degrees of freedom is f^2 sum(star^2 / variance), and the sum is close
    to the square of the star's signal-to-noise ratio. 0 where the fits agree with the noise.
    """
    good = well_exposed(centers, min_snr)
    if not good.any():
        return 0.0
    chi2, freedom = centers.chi2_reduced[good], centers.degrees_of_freedom[good]
    if np.median(misfit_factor(chi2, freedom)) <= 1.0:
        return 0.0
    error = np.sqrt(np.maximum(chi2 - 1.0, 0.0) * freedom) / centers.snr[good]
    return float(min(np.median(error), MAX_PSF_ERROR))


def well_exposed(centers: StarCenters, min_snr: float = WELL_EXPOSED_SNR) -> BoolArray:
    """True for stars that may speak for the PSF of their frame; (n,)."""
    clean = (centers.flags & int(SHAPE_SPOILED)) == 0
    with np.errstate(invalid="ignore"):
        return np.asarray(clean & (centers.snr >= min_snr))


@one_thread()
def fit_stars(
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
    search_radius_px: float = SEARCH_RADIUS_PX,
    joint: bool = True,
    mask_hits: bool = True,
    places: ExpectedPlaces | None = None,
    kept: EffectivePsf | None = None,
) -> tuple[StarCenters, ShapePrior]:
    """Fit all stars of a frame with `prior`, then with the PSF that its well-exposed stars agree on.

    Parameters
    ----------
    image_dn, noise_dn, bad, start_pixel_line, prior, box_px, background, saturated, noise_model,
    search_radius_px, joint, mask_hits
        As in `fit_gaussian`; a correction to the prior is learned anew.
    places
        Where the catalog has the stars: it helps to learn the PSF of an undersampled frame.
    kept
        The effective PSF that other pictures of the camera taught; the stars of this one add to it. Where it does not
        describe them, it is not used.

    Returns
    -------
    centers : StarCenters
        Of the last fit; `psf_error` is what the one before measured.
    consensus : ShapePrior
        The PSF of this frame.

    Raises
    ------
    CenterfindingError
        As in `fit_gaussian`.
    """

    def fit(shape: ShapePrior, psf_error: float) -> StarCenters:
        return fit_gaussian(
            image_dn, noise_dn, bad, start_pixel_line, shape, box_px=box_px, background=background,
            saturated=saturated, noise_model=noise_model, psf_error=psf_error,
            search_radius_px=search_radius_px, joint=joint, mask_hits=mask_hits,
        )  # fmt: skip

    size = default_box_px(prior.sigma_px) if box_px is None else box_px
    frame = _Frame(
        fit,
        check_image(image_dn, noise_dn, bad, saturated),
        checked_settings(size, background, noise_model, 0.0, search_radius_px),
        places,
    )
    if kept is None:
        return frame.alone(prior)
    together = frame.with_others(kept)
    told = _teachers(together[0])
    if len(told) > 0 and not _misfit(together[0], told):
        return together
    alone = frame.alone(prior)
    spoiled = _spoils(together[0], _teachers(alone[0]))
    return alone if spoiled or _describes_better(alone[0], together[0]) else together


@dataclass(frozen=True, slots=True)
class _Frame:
    """One frame's stars, and the two ways to their PSF."""

    fit: Callable[[ShapePrior, float], StarCenters]
    pixels: Pixels
    settings: FitSettings
    places: ExpectedPlaces | None

    def alone(self, prior: ShapePrior) -> tuple[StarCenters, ShapePrior]:
        """Fit with what these stars say themselves: a Gaussian, and what it leaves where that may matter."""
        prior = replace(prior, correction=None)
        first = self.fit(prior, 0.0)
        consensus = shape_from_stars(first, prior)
        centers = self.fit(consensus, estimate_psf_error(first))
        teachers = _teachers(centers)
        if not _gaussian_may_fail(centers, consensus, teachers):
            return self._unknown(consensus, teachers, centers)
        taught = self._taught(_common_shape(consensus), teachers, centers, None)
        if _spoils(taught[0], teachers) or _describes_better(centers, taught[0]):
            return self._unknown(consensus, teachers, centers)
        return taught

    def _unknown(
        self, shape: ShapePrior, teachers: IntArray, centers: StarCenters
    ) -> tuple[StarCenters, ShapePrior]:
        """Keep the Gaussian, and let the sigmas of undersampled stars have what nobody knows of the light in a pixel.

        What few stars say of it is too little to move centers by: a Gaussian's would err by a third more. How much it may be
        they tell nevertheless.
        """
        if shape.sigma_px >= UNDERSAMPLED_SIGMA_PX:
            return centers, shape
        size = self.settings.size
        correction = unknown_correction(shape, size)
        if len(teachers) > 0:
            learned = learn_correction(
                self.pixels, centers, teachers, shape, self.settings, self.places, None
            )
            correction = learned.as_error()
        unknown = replace(shape, correction=correction)
        return self.fit(unknown, centers.psf_error), unknown

    def with_others(self, kept: EffectivePsf) -> tuple[StarCenters, ShapePrior]:
        """Fit with what other pictures' stars say, and these add to it."""
        evidence = kept.for_a_picture()
        shape = _shared_shape(kept.log_scale, kept.ellipticity, evidence)
        centers = self.fit(shape, 0.0)
        teachers = _teachers(centers)
        if len(teachers) >= MIN_TEACHERS:
            return self._taught(shape, teachers, centers, evidence)
        return self._with_error(shape, centers), shape

    def _taught(
        self, shape: ShapePrior, teachers: IntArray, before: StarCenters, kept: PsfEvidence | None
    ) -> tuple[StarCenters, ShapePrior]:
        correction = learn_correction(self.pixels, before, teachers, shape, self.settings, self.places, kept)
        learned = replace(shape, correction=correction)
        if correction.shape_scatter is not None:
            scatter = correction.shape_scatter
            learned = replace(learned, sigma_log_scale=scatter, sigma_ellipticity=scatter)
        return self._with_error(learned, self.fit(learned, 0.0)), learned

    def _with_error(self, psf: ShapePrior, centers: StarCenters) -> StarCenters:
        psf_error = estimate_psf_error(centers)
        return self.fit(psf, psf_error) if psf_error > 0.0 else centers


def evidence_of_stars(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    start_pixel_line: ArrayLike,
    log_scale: float,
    ellipticity: FloatArray,
    *,
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    places: ExpectedPlaces | None = None,
    kept: PsfEvidence | None = None,
) -> tuple[PsfEvidence, int] | None:
    """Return what the stars of a frame say of the PSF beyond a given Gaussian, and how many they are.

    Parameters
    ----------
    image_dn, noise_dn, bad, start_pixel_line, saturated, noise_model, places
        As in `fit_stars`.
    log_scale, ellipticity
        Of the Gaussian: ln(sigma/px), and (e1, e2).
    kept
        What is known of the correction: the frame's stars are fitted with it. It is not part of what is returned.

    Returns
    -------
    (PsfEvidence, int) or None
        None where there are too few good stars.
    """
    shape = _shared_shape(log_scale, ellipticity, kept)
    centers = fit_gaussian(
        image_dn, noise_dn, bad, start_pixel_line, shape, saturated=saturated, noise_model=noise_model
    )
    teachers = _teachers(centers)
    if len(teachers) < MIN_TEACHERS:
        return None
    settings = checked_settings(default_box_px(shape.sigma_px), "level", noise_model, 0.0, SEARCH_RADIUS_PX)
    pixels = check_image(image_dn, noise_dn, bad, saturated)
    correction = learn_correction(pixels, centers, teachers, shape, settings, places, kept)
    assert correction.evidence is not None
    return correction.evidence, len(teachers)


# ---- Who teaches the PSF beyond a Gaussian, and whether there is anything to learn.

TEACHING_SNR = 15.0
STRANGE_MISFIT = 3.0  # times what is usual: no star of the same PSF
STRANGE_SHARE = 0.4  # of the light, left over by a fit: less may be a neighbor's wing
MIN_ALIKE = 2  # stars without a hit that tell what is usual
MIN_TEACHERS, MAX_TEACHERS = 3, 120  # fewer tell nothing; of more the brightest say it all
MIN_BLIND_TEACHERS = 8  # where no misfit is seen: fewer would learn noise, at a third more of their own error
UNDERSAMPLED_SIGMA_PX = 0.6  # below, a star alone does not show that it is no Gaussian
COMMON_SHAPE_SIGMA = (
    0.01  # of its log scale and ellipticity from star to star until they tell: most of what shows is phase
)
MISFIT_IN_SIGMAS = 5.0  # of the pooled chi-squared of all teachers


def _teachers(centers: StarCenters) -> IntArray:
    """Return the rows of the brightest well-exposed stars, without those that fit far worse than the others."""
    rows = np.flatnonzero(well_exposed(centers, TEACHING_SNR) & ~strange_images(centers))
    whole = rows[(centers.flags[rows] & int(StarFlag.HIT)) == 0]
    if len(whole) >= MIN_ALIKE and len(rows) < MIN_BLIND_TEACHERS:
        rows = whole  # among few, a track taken for a star would be heard
    brightest = rows[np.argsort(-centers.snr[rows], kind="stable")[:MAX_TEACHERS]]
    return np.sort(brightest)


def strange_images(centers: StarCenters) -> BoolArray:
    """Tell which fits (n,) leave far more of the light over than those of the picture's other stars.

    A PSF that is no Gaussian leaves about the same part of its light over in all stars; a hit beside one star, or taken
    for it, does not.
    """
    good = well_exposed(centers, TEACHING_SNR)
    whole = good & ((centers.flags & int(StarFlag.HIT)) == 0)
    if np.count_nonzero(whole) < MIN_ALIKE:
        return np.zeros(len(centers), bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.sqrt(np.maximum(centers.chi2_reduced - 1.0, 0.0) * centers.degrees_of_freedom) / centers.snr
        return np.asarray(left > np.maximum(STRANGE_MISFIT * np.quantile(left[whole], 0.25), STRANGE_SHARE))


def _common_shape(psf: ShapePrior) -> ShapePrior:
    """Return the PSF with the scatter of shapes that remains once the stars of an undersampled frame share one PSF."""
    if psf.sigma_px >= UNDERSAMPLED_SIGMA_PX:
        return psf
    return replace(psf, sigma_log_scale=COMMON_SHAPE_SIGMA, sigma_ellipticity=COMMON_SHAPE_SIGMA)


def _shared_shape(log_scale: float, ellipticity: FloatArray, evidence: PsfEvidence | None) -> ShapePrior:
    shape = ShapePrior(log_scale, COMMON_SHAPE_SIGMA, ellipticity, COMMON_SHAPE_SIGMA)
    if evidence is None:
        return shape
    return replace(shape, correction=prior_correction(shape, default_box_px(shape.sigma_px), evidence))


def _gaussian_may_fail(centers: StarCenters, psf: ShapePrior, teachers: IntArray) -> bool:
    """Tell whether a Gaussian may not describe the stars: it visibly does not, or nobody could see it."""
    if len(teachers) < MIN_TEACHERS:
        return False
    blind = psf.sigma_px < UNDERSAMPLED_SIGMA_PX and len(teachers) >= MIN_BLIND_TEACHERS
    return blind or _misfit(centers, teachers)


def _spoils(centers: StarCenters, teachers: IntArray) -> bool:
    """Tell whether most of some stars can no longer be fitted: of a wrong PSF hardly a fit comes to an end."""
    return len(teachers) > 2 * len(_teachers(centers))


def _describes_better(one: StarCenters, other: StarCenters) -> bool:
    """Tell whether one PSF leaves less of the well-exposed stars' light over than the other, by more than chance."""
    good = well_exposed(one, TEACHING_SNR) & well_exposed(other, TEACHING_SNR)
    if not good.any():
        return False
    gain = (other.chi2_reduced - one.chi2_reduced)[good] * np.sqrt(one.degrees_of_freedom[good] / 2.0)
    return bool(float(np.median(gain)) * np.sqrt(np.count_nonzero(good)) > MISFIT_IN_SIGMAS)


def _misfit(centers: StarCenters, teachers: IntArray) -> bool:
    """Tell whether the PSF of a fit visibly does not describe well-exposed stars."""
    if len(teachers) == 0:
        return False
    chi2, freedom = centers.chi2_reduced[teachers], centers.degrees_of_freedom[teachers]
    excess = float(np.median((chi2 - 1.0) * np.sqrt(freedom / 2.0))) * np.sqrt(len(teachers))
    return bool(excess > MISFIT_IN_SIGMAS)


def _combine_parameter(
    fitted: FloatArray, variance: FloatArray, mean: float, prior_variance: float
) -> tuple[float, float]:
    """Combine one shape parameter over the stars with its prior; return value and sigma for a single star."""
    # A fit's posterior is its own measurement times the prior; divide the prior out again.
    information = np.maximum(1.0 / variance - 1.0 / prior_variance, 1e-6 / prior_variance)
    own = (fitted / variance - mean / prior_variance) / information
    median = np.median(own)
    spread = (MAD_TO_SIGMA * np.median(np.abs(own - median))) ** 2
    scatter = max(spread - float(np.median(1.0 / information)), 0.0)
    weight = 1.0 / (1.0 / information + scatter)
    weight = np.where((own - median) ** 2 * weight <= OUTLIER_SIGMAS**2, weight, 0.0)
    total = weight.sum() + 1.0 / prior_variance
    value = (np.sum(weight * own) + mean / prior_variance) / total
    return float(value), float(np.sqrt(scatter + 1.0 / total))
