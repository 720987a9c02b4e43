"""What is to be thought of each star's center: its status, and why."""

from collections.abc import Callable, Sequence

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import FieldMatch
from opnav_workbench.session.measuring import FITTED, StarFit
from opnav_workbench.session.state import StarStatus
from opnav_workbench.starcenters import ShapePrior, StarCenters, StarFlag

__all__ = ["judge"]

UNSEPARATED_SIGMAS = (
    1.5  # a joint fit tells stars apart that are farther from each other than this, in sigmas of the PSF
)
MIN_STARS_FOR_ZERO_POINT = 4  # a median of fewer follows a single wrong star
Verdict = tuple[BoolArray, str, Callable[[int], str]]  # whom it concerns, status, and why
NOT_CONVERGED = StarFlag.NOT_CONVERGED | StarFlag.NOT_FINITE


def judge(
    context: Context,
    mag: FloatArray,
    match: FieldMatch,
    centers: StarCenters,
    psf: ShapePrior,
    how: StarFit,
    behind: Sequence[str],
) -> tuple[StarStatus, ...]:
    """Give every star its status, the first that applies.

    Parameters
    ----------
    mag : (n,) array
        Predicted magnitudes.
    match : FieldMatch
        Where the stars were expected.
    centers : StarCenters
        (n,) measured with `psf` in the way of `how`.
    behind : (n,) sequence of str
        Body that stands before each star; empty for none.
    """
    settings, radius_px = context.settings, how.radius_px
    blend_px = UNSEPARATED_SIGMAS * psf.sigma_px if how.final in FITTED else settings.blend_radius_px
    blended = _blended(match.expected_px, mag, blend_px, settings.blend_magnitude)
    moved = np.hypot(*(centers.pixel_line - match.expected_px).T)
    magnitude_error = _magnitude_error(context, mag, centers, match)
    snr, flags = centers.snr, centers.flags
    with np.errstate(invalid="ignore"):
        faint = ~(np.isfinite(snr) & (snr >= settings.min_snr))
        far = moved > radius_px + 1.0
    unlike = np.abs(magnitude_error) > settings.max_magnitude_error
    verdicts: tuple[Verdict, ...] = (
        (~match.visible, "off_detector", lambda _: "outside the detector with the pointing found"),
        (_on_bodies(context, match), "not_detected", lambda _: "behind a body, or lost in its light"),
        (_has(flags, StarFlag.SATURATED), "saturated", lambda _: "its core is saturated"),
        (faint & _named(behind), "not_detected", lambda i: f"behind {behind[i]}"),
        (faint, "not_detected", lambda i: f"SNR {snr[i]:.1f} is below {settings.min_snr:g}"),
        (far, "not_detected", lambda _: f"nothing within {radius_px:.1f} px of its expected place"),
        (_has(flags, NOT_CONVERGED), "rejected", lambda _: "the fit did not converge"),
        (_has(flags, StarFlag.COSMIC_RAY), "rejected", lambda _: "sharper than a star can be: a cosmic ray"),
        (blended, "blended", lambda _: f"another star within {blend_px:.1f} px"),
        (unlike, "rejected", lambda i: f"{magnitude_error[i]:+.1f} mag off its catalog brightness"),
    )
    return tuple(_first_verdict(verdicts, i) for i in range(len(mag)))


def _first_verdict(verdicts: Sequence[Verdict], i: int) -> StarStatus:
    for holds, status, reason in verdicts:
        if holds[i]:
            return StarStatus(status, reason(i))
    return StarStatus("used")


def _named(behind: Sequence[str]) -> BoolArray:
    return np.array([bool(name) for name in behind], dtype=bool)


def _has(flags: IntArray, wanted: StarFlag) -> BoolArray:
    return np.asarray((flags & int(wanted)) != 0)


def _on_bodies(context: Context, match: FieldMatch) -> BoolArray:
    """Tell which stars are expected where a body's light covers the picture."""
    n_line, n_pixel = context.extended.shape
    seen = match.visible & np.isfinite(match.expected_px).all(axis=1)
    pixel, line = np.rint(np.where(seen[:, None], match.expected_px, 0.0)).astype(int).T
    covered = context.extended[np.clip(line, 0, n_line - 1), np.clip(pixel, 0, n_pixel - 1)]
    return np.asarray(seen & covered)


def _blended(pixel_line: FloatArray, mag: FloatArray, radius_px: float, fainter_by: float) -> BoolArray:
    distance = np.hypot(*(pixel_line[:, None] - pixel_line[None]).transpose(2, 0, 1))
    near = (distance < radius_px) & ~np.eye(len(mag), dtype=bool)
    matters: BoolArray = (near & (mag[None, :] < mag[:, None] + fainter_by)).any(axis=1)
    return matters


def _magnitude_error(
    context: Context, mag: FloatArray, centers: StarCenters, match: FieldMatch
) -> FloatArray:
    """Magnitude from the fitted flux minus the catalog's, about the frame's median (or the camera's zero point)."""
    with np.errstate(invalid="ignore"):
        good = match.visible & (centers.snr > context.settings.min_snr) & (centers.flux_dn > 0.0)
        rate = np.where(centers.flux_dn > 0.0, centers.flux_dn, np.nan) / context.frame.exposure_s
    error = -2.5 * np.log10(rate) - mag
    if good.sum() >= MIN_STARS_FOR_ZERO_POINT:
        error = error - np.median(error[good])
    elif context.camera.zero_point_mag is not None:
        error = error + context.camera.zero_point_mag
    else:
        error = np.zeros_like(error)
    return np.where(np.isfinite(error), error, np.inf)
