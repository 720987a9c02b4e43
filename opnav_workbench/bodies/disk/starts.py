"""From where a disk is fitted: its place, a law of the other kind, where the sky about it ends.

Flow   place -> fit with coarse light -> another law -> from where the sky ends, if that is not where steps have led ->
       the likelier one -> fine light
"""

from dataclasses import replace

import numpy as np
from scipy.special import expit

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.columns import DiskShape
from opnav_workbench.bodies.disk.fit import MOST_FINE, WANDERED_SHARE, Fitter
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.disk.pixel_by_pixel import likelier
from opnav_workbench.bodies.disk.problem import DiskProblem
from opnav_workbench.bodies.disk.sky_edge import outline_by_sky
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.place import BodyPlace
from opnav_workbench.bodies.subarray import Cutout
from opnav_workbench.errors import CenterfindingError

__all__ = ["fit_disk", "is_wider"]

# Whole share and power that mixtures and Minnaert's laws begin with.
MIXED_LAW, MINNAERT_LAW = np.array([0.5, 0.0]), np.array([0.0, -0.35])
START_SIZES = (0.7, 1.4)  # over the model's
SKY_SIGMA_PX, SKY_SIZE_SIGMA = 0.5, 0.01  # of an outline by the sky about it
ELSEWHERE_SIGMAS = 1.0  # of that, or its limb: an outline by the sky lies elsewhere
UNEXPLAINED = 1.2  # chi-squared: of 80 surfaces, right centers had at most 1.16
WORSE = 1.1  # chi-squared of a likelier fit over that of the other one
WIDER = 2.0  # sigma of a fit that explains more, at most, over that of the other one
# In the logarithm of a likelihood: of fits from two places, of 150 trials, the wrong one was the likelier by up to 37.
SPURIOUS = 20.0


def fit_disk(
    picture: BodyPicture,
    name: str,
    place: BodyPlace,
    pixels: Cutout,
    start: DiskFit | None = None,
    *,
    follows_light: bool = False,
    held_log_size: float | None = None,
    elsewhere: bool = False,
) -> DiskFit:
    """Fit a disk, starting from a place that is good to about the width of the PSF, or from another fit from there.

    A fit that has not come to rest is no place to begin from: other light may have led it away.

    Parameters
    ----------
    follows_light
        As of `opnav_workbench.bodies.disk.fit.Fitter`.
    held_log_size
        Logarithm of the size over the model's, if that is not to be solved for. Where the center is with it, and how likely
        that is, coarse light tells.
    elsewhere
        Begin from where the sky about the disk ends as well, if that is not where the place leads.

    Raises
    ------
    CenterfindingError
        The body leaves what the camera model covers.
    """
    rested = start if start is not None and start.converged else None
    begun = place if rested is None else rested.place  # its pieces of limb are those of its size
    problem = DiskProblem(picture, name, pixels, begun, held_log_size)
    fitter = _settled(problem, rested, follows_light=follows_light)
    elsewhere_px2 = np.zeros((2, 2)) if rested is None else rested.elsewhere_px2
    if elsewhere and rested is None:
        fitter, elsewhere_px2 = _likelier_start(fitter)
    fit = fitter.run(MOST_FINE if held_log_size is None else 0)
    return replace(fit.less_sure(elsewhere_px2), elsewhere_px2=elsewhere_px2)


def is_wider(known_px2: FloatArray, other_px2: FloatArray) -> bool:
    """Tell whether pixels tell a fit less of the center than they tell another one, both by their covariance (2, 2)."""
    return bool(np.trace(known_px2) > WIDER**2 * np.trace(other_px2))


def _settled(problem: DiskProblem, start: DiskFit | None = None, *, follows_light: bool = False) -> Fitter:
    """Return a fit with coarse light from the place of a problem, or from another fit."""
    fitter = Fitter(problem, start or _placed_shape(problem), follows_light=follows_light)
    fitter.settle()
    if start is not None:
        return fitter
    if not fitter.is_nearly_even and (fitter.leans_most or _has_come_far(fitter)):
        fitter = _with_light_anew(fitter)
    return _with_other_law(fitter) if fitter.is_nearly_even else fitter


def _placed_shape(problem: DiskProblem) -> DiskShape:
    """Return the shape that a disk has at the place of a problem."""
    place = problem.place
    strain, law = np.append(place.strain, np.zeros(3)), np.array([problem.law_prior[0], 0.0])
    log_size = float(np.log(place.size_ratio))
    return DiskShape(place.center_px, log_size, strain, law, 0.0, np.zeros(problem.pieces))


def _has_come_far(fitter: Fitter) -> bool:
    """Tell whether a fit has left the place at which its light was first explained, by more than a limb is wide."""
    away = fitter.shape.center_px - fitter.problem.place.center_px
    return bool(np.hypot(*away) > fitter.problem.psf_px)


def _with_light_anew(fitter: Fitter) -> Fitter:
    """Return the likelier of a fit and of another that begins at its outline, with the light that is expected there.

    Albedo, slopes and law that were bent to explain a limb at the wrong place hold it there.
    """
    problem, shape = fitter.problem, fitter.shape
    begun = replace(
        _placed_shape(problem),
        center_px=shape.center_px,
        log_size=shape.log_size,
        strain=np.append(shape.strain[:2], np.zeros(3)),
    )
    other = Fitter(problem, begun, follows_light=fitter.follows_light)
    other.settle()
    return max(fitter, other, key=lambda each: each.log_likelihood)


def _with_other_law(fitter: Fitter) -> Fitter:
    """Return the likelier of a fit with coarse light and of another that begins with a law of the other kind.

    No step leads from mixtures to Minnaert's laws: between them the light at the limb is that of neither, and a faint albedo
    makes up for what either lacks.
    """
    problem, shape = fitter.problem, fitter.shape
    power = float(problem.own_law[1] + shape.law[1])
    law = MINNAERT_LAW if power > 0.5 * MINNAERT_LAW[1] else MIXED_LAW
    begun = replace(shape, law=law - problem.own_law)
    other = Fitter(problem, begun, follows_light=fitter.follows_light)
    if not other.is_likelier(fitter):
        return fitter
    other.settle()
    return max(fitter, other, key=lambda each: each.log_likelihood)


def _likelier_start(fitter: Fitter) -> tuple[Fitter, FloatArray]:
    """Return a fit with coarse light, or one from where the sky ends; and (2, 2) how far both are, as likely as that is.

    One from where the sky ends has to be the likelier also of pixels by themselves: patches are no Gaussian field, and cells
    of another outline are other cells. Where it is not, neither is known to be right, and half of the way is uncertain. A
    fit that has not come to rest is no place to stay at.
    """
    other = _from_the_sky(fitter)
    if other is None or not _explains(other, fitter):
        return fitter, np.zeros((2, 2))
    more, away = other.log_likelihood - fitter.log_likelihood, other.shape.center_px - fitter.shape.center_px
    share = float(expit(-abs(more) / SPURIOUS))
    if more > 0.0:
        if not fitter.converged or _is_likelier_by_pixels(other, fitter):
            fitter = other
        else:
            share = max(share, WANDERED_SHARE**2)
    return fitter, share * np.outer(away, away)


def _is_likelier_by_pixels(other: Fitter, fitter: Fitter) -> bool:
    begun, there = fitter.run(0), other.run(0)
    return likelier(fitter.problem.pixels, begun, there) is there


def _explains(other: Fitter, fitter: Fitter) -> bool:
    """Tell whether another fit explains about as much as one, and knows the center about as well."""
    if is_wider(other.known_px2, fitter.known_px2):
        return False
    return other.chi2_reduced() <= max(UNEXPLAINED, WORSE * fitter.chi2_reduced())


def _from_the_sky(fitter: Fitter) -> Fitter | None:
    """Return a fit with coarse light that begins where the sky about the disk ends; None where one has led there already.

    One that has taken the edge of a patch for the limb does not come to the limb by steps: it makes its axes longer and
    shorter for it, so that the sky is asked for an outline with those of the model.
    """
    problem, picture = fitter.problem, fitter.problem.picture
    doubted = not fitter.converged or fitter.chi2_reduced() > UNEXPLAINED
    # About an overexposed body is charge, and no sky; an even one has no patches.
    if picture.spilled is not None or (fitter.is_nearly_even and not doubted):
        return None
    plain = fitter.made.outline(replace(fitter.shape, strain=np.zeros(5)), rough=False)
    center, grown = outline_by_sky(problem.pixels, plain, fitter.made.light, fitter.brightness)
    away_px = max(float(np.hypot(*(center - plain.center_px))), abs(grown) * problem.radius_px)
    if not doubted and away_px < ELSEWHERE_SIGMAS * SKY_SIGMA_PX:
        return None
    size = float(np.clip(np.exp(fitter.shape.log_size + grown), *START_SIZES))
    place = replace(
        problem.place,
        center_px=center,
        size_ratio=size,
        center_sigma_px=max(problem.place.center_sigma_px, SKY_SIGMA_PX),
        seen_ratio=size,
        seen_sigma=SKY_SIZE_SIGMA,
        strain=np.zeros(2),
    )
    try:
        return _settled(DiskProblem(picture, problem.name, problem.pixels, place))
    except CenterfindingError:
        return None
