"""Session steps that concern stars: predict, find, decide.  Pure: (context, inputs, state, parameters) -> state."""

from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction, predict_stars
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import FieldMatch, brightest, identify_field
from opnav_workbench.session.state import Inputs, SessionState, StarStatus, skipped_topic
from opnav_workbench.session.verdicts import ACCEPTED, REJECTED, decide, unsearched, with_verdicts
from opnav_workbench.starcenters import (
    ShapePrior,
    StarCenters,
    StarFlag,
    Template,
    correlate,
    default_box_px,
    extract_template,
    fit_psf,
    fit_stars,
    gaussian_template,
)

__all__ = ["accept_stars", "find_stars", "predict", "reject_stars"]

Initial = Literal["matched_filter", "cross_correlation"]
INITIAL_METHODS: tuple[Initial, ...] = get_args(Initial)
FITTED = ("least_squares", "psf_fit")  # neighbors are fitted together
FINAL_METHODS = (*FITTED, *INITIAL_METHODS)
UNSEPARATED_SIGMAS = (
    1.5  # a joint fit tells stars apart that are farther from each other than this, in sigmas of the PSF
)
TEMPLATE_SNR = 50.0  # a template's own noise must not matter beside that of the stars it finds
MIN_STARS_FOR_ZERO_POINT = 4  # a median of fewer follows a single wrong star


def predict(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Predict stars with the a priori pointing; whatever was found before is dropped."""
    margin = context.settings.max_shift_px
    stars = predict_stars(
        inputs.stars, inputs.et, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000, margin
    )
    stars = brightest(stars, context.settings.max_stars)
    status = unsearched(stars.on_detector)
    topics = {skipped_topic(name) for name in state.skipped_targets}
    fresh = SessionState(
        a_priori=stars,
        found_status=status,
        decisions=state.decisions,
        targets=state.targets,
        skipped_targets=state.skipped_targets,
        notes=MappingProxyType({topic: said for topic, said in state.notes.items() if topic in topics}),
    )
    return fresh.replace(status=with_verdicts(fresh, status)).noting("predict", *_empty_field(stars))


def _empty_field(stars: StarPrediction) -> list[str]:
    if stars.on_detector.any():
        return []
    message = (
        "the catalog has no star on the predicted field; "
        "take a deeper catalog (--catalog) or check the pointing and the time."
    )
    return [message]


def find_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Find the predicted stars in the picture and fit their centers."""
    _predicted(state)
    initial, final = parameters["initial"], parameters["final"]
    if initial not in INITIAL_METHODS or final not in FINAL_METHODS:
        raise SessionError(
            f"unknown method {initial!r} / {final!r}: initial is one of {', '.join(INITIAL_METHODS)}, "
            f"final one of {', '.join(FINAL_METHODS)}."
        )
    match = identify_field(context, inputs, state)
    state = state.noting("stars", *match.messages)
    if match.found is None and state.pointing is None:
        return state.replace(centers=None, star_field=None)
    if match.stars is not None:
        state = state.replace(a_priori=match.stars)
    stars = _predicted(state)
    radius = parameters["search_radius_px"] or match.radius_px
    centers, psf = _measure(context, state, match, initial, final, radius)
    blend_px = UNSEPARATED_SIGMAS * psf.sigma_px if final in FITTED else context.settings.blend_radius_px
    found = _judge(context, stars, match, centers, radius, blend_px)
    state = state.replace(centers=centers, psf=psf, found_status=found, star_field=match.found)
    return state.replace(status=with_verdicts(state, found))


def _predicted(state: SessionState) -> StarPrediction:
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    return state.a_priori


def _measure(
    context: Context, state: SessionState, match: FieldMatch, initial: Initial, final: str, radius_px: float
) -> tuple[StarCenters, ShapePrior]:
    """Coarse centers by correlation around the expected places, then least squares for all stars at once."""
    prior = state.psf or context.camera_psf
    saturated = context.frame.saturated
    method: Initial = final if final in INITIAL_METHODS else initial
    coarse = correlate(
        context.signal_dn,
        context.noise_dn,
        context.bad,
        match.expected_px,
        _template(context, match, prior, method),
        search_radius_px=radius_px,
        method=method,
        saturated=saturated,
    )
    if final not in FITTED:
        return coarse, prior
    start = np.where(np.isfinite(coarse.pixel_line), coarse.pixel_line, match.expected_px)
    if final == "psf_fit":
        psf = context.camera.psf_model
        centers = fit_psf(
            context.signal_dn,
            context.noise_dn,
            context.bad,
            start,
            psf,
            saturated=saturated,
            noise_model=context.noise_model,
        )
        return centers, prior
    return fit_stars(
        context.signal_dn,
        context.noise_dn,
        context.bad,
        start,
        prior,
        saturated=saturated,
        noise_model=context.noise_model,
    )


def _template(context: Context, match: FieldMatch, prior: ShapePrior, method: Initial) -> Template:
    """A Gaussian for cross-correlation; for the matched filter a well-exposed star of this picture, if there is one."""
    gaussian = gaussian_template(prior.sigma_px, default_box_px(prior.sigma_px))
    if method == "cross_correlation" or not match.visible.any():
        return gaussian
    centers = correlate(
        context.signal_dn,
        context.noise_dn,
        context.bad,
        match.expected_px[match.visible],
        gaussian,
        search_radius_px=match.radius_px,
        saturated=context.frame.saturated,
    )
    clean = centers.usable & (centers.flags == 0) & (centers.snr > TEMPLATE_SNR)
    if not clean.any():
        return gaussian
    best = int(np.argmax(np.where(clean, centers.snr, -np.inf)))
    radius = default_box_px(prior.sigma_px) / 2.0
    return extract_template(context.signal_dn, context.bad, centers.pixel_line[best], radius)


def _judge(
    context: Context,
    stars: StarPrediction,
    match: FieldMatch,
    centers: StarCenters,
    radius_px: float,
    blend_px: float,
) -> tuple[StarStatus, ...]:
    """Give every star its status, the first that applies."""
    settings = context.settings
    blended = _blended(match.expected_px, stars.mag, blend_px, settings.blend_magnitude)
    moved = np.hypot(*(centers.pixel_line - match.expected_px).T)
    magnitude_error = _magnitude_error(context, stars.mag, centers, match)
    rows = []
    for i in range(len(stars)):
        snr = centers.snr[i]
        if not match.visible[i]:
            rows.append(StarStatus("off_detector", "outside the detector with the pointing found"))
        elif centers.flags[i] & StarFlag.SATURATED:
            rows.append(StarStatus("saturated", "its core is saturated"))
        elif not np.isfinite(snr) or snr < settings.min_snr:
            rows.append(StarStatus("not_detected", f"SNR {snr:.1f} is below {settings.min_snr:g}"))
        elif moved[i] > radius_px + 1.0:
            rows.append(
                StarStatus("not_detected", f"nothing within {radius_px:.1f} px of its expected place")
            )
        elif centers.flags[i] & (StarFlag.NOT_CONVERGED | StarFlag.NOT_FINITE):
            rows.append(StarStatus("rejected", "the fit did not converge"))
        elif centers.flags[i] & StarFlag.COSMIC_RAY:
            rows.append(StarStatus("rejected", "sharper than a star can be: a cosmic ray"))
        elif blended[i]:
            rows.append(StarStatus("blended", f"another star within {blend_px:.1f} px"))
        elif abs(magnitude_error[i]) > settings.max_magnitude_error:
            rows.append(StarStatus("rejected", f"{magnitude_error[i]:+.1f} mag off its catalog brightness"))
        else:
            rows.append(StarStatus("used"))
    return tuple(rows)


def _blended(pixel_line: FloatArray, mag: FloatArray, radius_px: float, fainter_by: float) -> BoolArray:
    distance = np.hypot(*(pixel_line[:, None] - pixel_line[None]).transpose(2, 0, 1))
    near = (distance < radius_px) & ~np.eye(len(mag), dtype=bool)
    matters: BoolArray = (near & (mag[None, :] < mag[:, None] + fainter_by)).any(axis=1)
    return matters


def _magnitude_error(
    context: Context, mag: FloatArray, centers: StarCenters, match: FieldMatch
) -> FloatArray:
    """Magnitude from the fitted flux minus the catalog's, about the frame's median (or the camera's zero point)."""
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


def reject_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record the analyst's rejection of stars."""
    return decide(state, parameters["ids"], REJECTED, parameters["reason"])


def accept_stars(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record the analyst's acceptance of stars, which outranks an automatic rejection."""
    return decide(state, parameters["ids"], ACCEPTED, parameters["reason"])
