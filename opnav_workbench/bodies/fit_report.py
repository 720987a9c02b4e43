"""From a fit of rendered bodies to their `BodyCenter`: covariance with what the residuals say, flags, status, messages.

Covariances hold the noise of the pixels, the pattern that the model lacks (``residuals``), the figure where that is the
disk's and not the model's, the sampling of the rendering, the centering error of the frame's stars, and half of the
difference from the likelihood of the disk, which confirms a center or does not (``judgement``).
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.detection import DetectedScene, FoundBody
from opnav_workbench.bodies.disk.centerfinder import judged_disk
from opnav_workbench.bodies.disk.measurement import MeasuredDisk
from opnav_workbench.bodies.disk.problem import SEEN_PX, SEEN_SHARE
from opnav_workbench.bodies.judgement import (
    confirmed_center,
    is_other_size,
    lost_pixels,
    size_words,
    standing_flags,
)
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.residuals import (
    MIN_PIXELS,
    SIGNIFICANT,
    ResidualPattern,
    find_residual_pattern,
)
from opnav_workbench.bodies.results import (
    DOUBTFUL_FLAGS,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    ModelFit,
    flag_messages,
    flags_where,
)
from opnav_workbench.bodies.scene_fit import SceneFit
from opnav_workbench.bodies.subarray import Cutout, left_search, outline_radius_px

__all__ = ["report_fitted_bodies", "without_pixels"]

POORLY_EXPLAINED = (
    0.6  # share of the light's variation under it; an albedo map of Pluto's contrast leaves 0.9
)
BRIGHT_SHARE = 0.1  # of the brightest part: pixels that show the body
# Limbs are sampled in cells of 1/32 px. What that does to a center, over the root of the diameter: nothing for a full
# disk, whose errors cancel, most for a crescent.
RENDERING_ERROR_PX = 0.004


def report_fitted_bodies(
    cutout: Cutout, detected: DetectedScene, fit: SceneFit, method: str, range_solved: BoolArray
) -> tuple[dict[str, BodyCenter], FloatArray]:
    """Return the centers of the bodies that were found, and their joint covariance (2 n, 2 n)."""
    patterns = _patterns(fit)
    n, picture = len(fit.state.names), detected.picture
    covariance = fit.noise_covariance * _misfit_factor(fit, patterns)
    covariance = covariance + sum(pattern.covariance for pattern in patterns)
    own = np.array([_rendering_error(picture, fit, index) for index in range(n)]) ** 2
    covariance[np.arange(2 * n), np.arange(2 * n)] += np.repeat(own + picture.excess_sigma_px**2, 2)
    for index, body in enumerate(detected.found.values()):
        if body.measured is not None and body.of_disk:  # then the light knows no more than the disk
            covariance[_block(index)] += body.measured.fit.covariance_px2
    context = _FitContext(cutout, detected, fit, method, range_solved, patterns, covariance)
    centers = {}
    for index, (name, body) in enumerate(detected.found.items()):
        centers[name] = _confirmed(_body_center(context, index), body)
        covariance[_block(index)] = centers[name].covariance_px2
    return centers, covariance[: 2 * len(centers), : 2 * len(centers)]


def without_pixels(name: str, method: str) -> BodyCenter:
    """Return what a fit tells of a body that no usable pixel shows."""
    flags = int(BodyFlag.EMPTY)
    return BodyCenter.without_center(name, method, "failed", "no usable pixels about its place", flags=flags)


def _block(index: int) -> tuple[slice, slice]:
    part = slice(2 * index, 2 * index + 2)
    return part, part


def _confirmed(center: BodyCenter, body: FoundBody) -> BodyCenter:
    if body.disk is None:
        return center
    disk = judged_disk(body.disk) if isinstance(body.disk, MeasuredDisk) else body.disk
    return confirmed_center(center, disk)


def _rendering_error(picture: BodyPicture, fit: SceneFit, index: int) -> float:
    phase = picture.phase_rad(fit.state.names[index])
    dark = 0.5 * (1.0 - np.cos(phase)) if np.isfinite(phase) else 0.0
    return float(RENDERING_ERROR_PX * dark / np.sqrt(max(fit.light.diameter_px[index], 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class _FitContext:
    cutout: Cutout
    detected: DetectedScene
    fit: SceneFit
    method: str
    range_solved: BoolArray
    patterns: list[ResidualPattern]
    covariance: FloatArray


def _patterns(fit: SceneFit) -> list[ResidualPattern]:
    """Return what each body has that its model lacks."""
    gain = fit.gain
    return [
        find_residual_pattern(fit.residual_dn, fit.weight, scale * light, fit.columns, gain)
        for scale, light in zip(fit.state.scales, fit.light.each, strict=True)
    ]


def _misfit_factor(fit: SceneFit, patterns: list[ResidualPattern]) -> float:
    """Return what the noise is multiplied with where bodies are too small to tell a pattern from noise."""
    if any(pattern.relative_sigma > 0.0 for pattern in patterns):
        return 1.0
    lit = fit.model_dn > 0.1 * fit.model_dn.max()
    if np.count_nonzero(lit & (fit.weight > 0.0)) >= MIN_PIXELS:
        return 1.0
    reduced = fit.chi2 / fit.degrees_of_freedom
    return reduced if reduced > 1.0 + SIGNIFICANT * np.sqrt(2.0 / fit.degrees_of_freedom) else 1.0


def explained_share(
    data: FloatArray, residual: FloatArray, weight: FloatArray, light: FloatArray, level: float
) -> float:
    """Return the share, 0..1, of the data's power under a body that its model explains, noise taken out."""
    under = (light > 0.01 * light.max(initial=0.0)) & (weight > 0.0)
    power = float(np.sum((weight * (data - level) ** 2)[under]))
    left = float(np.sum((weight * residual**2)[under])) - np.count_nonzero(under)
    return float(np.clip(1.0 - left / max(power, 1e-300), 0.0, 1.0))


def _body_center(context: _FitContext, index: int) -> BodyCenter:
    fit, name = context.fit, context.fit.state.names[index]
    scale, center = float(fit.state.scales[index]), fit.state.centers_px[index]
    if not scale > 0.0 or not np.isfinite(center).all():
        return BodyCenter.without_center(
            name, context.method, "not_detected", "the fit found no light of it at its place"
        )
    scale_sigma = float(np.sqrt(fit.covariance[_scale_row(fit, index), _scale_row(fit, index)]))
    flags, messages = _judged(context, index)
    target = context.detected.picture.model(name).target
    range_km = target.range_km * float(np.exp(fit.state.log_range[index]))
    solved, log_sigma = bool(context.range_solved[index]), np.nan
    if solved:
        row = 2 * len(fit.state.names) + int(context.range_solved[:index].sum())
        log_sigma = float(np.sqrt(context.covariance[row, row]))
    diameter = float(fit.light.diameter_px[index])
    return BodyCenter(
        name=name,
        method=context.method,
        status="uncertain" if flags & DOUBTFUL_FLAGS else "ok",
        pixel_line=center,
        covariance_px2=context.covariance[_block(index)],
        flux_dn=float(fit.light.flux_dn[index]) * scale,
        snr=scale / scale_sigma if scale_sigma > 0.0 else np.nan,
        diameter_px=diameter if solved else np.nan,
        messages=messages,
        flags=int(flags),
        noise_covariance_px2=fit.noise_covariance[_block(index)],
        chi2_reduced=fit.chi2 / fit.degrees_of_freedom,
        diameter_sigma_px=diameter * log_sigma,
        brightness_scale=scale,
        brightness_scale_sigma=scale_sigma,
        background_dn=fit.state.level_dn,
        background_sigma_dn=float(np.sqrt(fit.covariance[-1, -1])),
        range_km=range_km if solved else np.nan,
        range_sigma_km=range_km * log_sigma,
        pictures=_pictures(context),
        detail=_detail(context, index),
    )


def _judged(context: _FitContext, index: int) -> tuple[BodyFlag, tuple[str, ...]]:
    """Return what is known against a center: flags, and words with numbers."""
    fit, picture, cutout = context.fit, context.detected.picture, context.cutout
    name, center = fit.state.names[index], fit.state.centers_px[index]
    body, light = context.detected.found[name], fit.light.each[index] * fit.state.scales[index]
    radius = outline_radius_px(picture, name) * float(np.exp(-fit.state.log_range[index]))
    pixel, line, n_pixel, n_line = cutout.window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    bright = np.asarray(light > BRIGHT_SHARE * light.max(initial=0.0))
    lost = lost_pixels(picture, part, bright, cutout.use, fit.hits)
    expected = picture.center_px(name) if body.circle is None else body.circle.center_px
    away, hidden = float(np.hypot(*(center - expected))), float(fit.light.occulted[index])
    explained = explained_share(cutout.data_dn, fit.residual_dn, fit.weight, light, fit.state.level_dn)
    size, size_sigma = body.seen_log_size
    allowed = 0.0 if body.measured is None else picture.model(name).seen_figure.size_sigma
    if body.measured is None:  # its size is the model's, and what the limb's crossings know of another
        size_sigma = float(np.hypot(SEEN_SHARE * size_sigma, SEEN_PX / radius))
    covariance = context.covariance[_block(index)]
    conditions = {
        **standing_flags(picture, name, (center - radius, center + radius), radius, covariance),
        **lost,
        BodyFlag.OCCULTED: hidden > 0.0 or (len(context.detected.apart) > 0 and lost[BodyFlag.OCCULTED] > 0),
        BodyFlag.CIRCLE_MISFIT: is_other_size(size, size_sigma, allowed) and not context.range_solved[index],
        BodyFlag.POOR_FIT: explained < POORLY_EXPLAINED,
        BodyFlag.AT_LIMIT: left_search(away, radius, body.circle, body.search_px),
        BodyFlag.NOT_CONVERGED: not fit.converged,
    }
    flags = flags_where(conditions)
    cut_off = 1.0 - float(light.sum() / max(fit.light.flux_dn[index] * fit.state.scales[index], 1e-300))
    notes = {flag: f"{count} px" for flag, count in lost.items()} | {
        BodyFlag.CUT_BY_EDGE: f"{100 * cut_off:.0f} % of its light",
        BodyFlag.OCCULTED: f"{100 * hidden:.0f} % of its light",
        BodyFlag.POOR_FIT: f"the model explains {100 * explained:.0f} % of the light",
        BodyFlag.CIRCLE_MISFIT: size_words(size),
    }
    return flags, tuple(flag_messages(flags, notes))


def _pictures(context: _FitContext) -> BodyResiduals:
    fit = context.fit
    return BodyResiduals(
        window=context.cutout.window,
        data_dn=context.cutout.data_dn,
        model_dn=fit.model_dn + fit.state.level_dn,
        difference_dn=np.where(context.cutout.use, fit.residual_dn, 0.0),
        mask=fit.weight > 0.0,
    )


def _scale_row(fit: SceneFit, index: int) -> int:
    return len(fit.columns) - 1 - len(fit.state.names) + index


def _detail(context: _FitContext, index: int) -> ModelFit:
    fit, names = context.fit, context.fit.state.names
    solved = [name for name, wanted in zip(names, context.range_solved, strict=True) if wanted]
    parameters = [f"{name} {axis}" for name in names for axis in ("pixel", "line")]
    parameters += [f"{name} log range" for name in solved] + [f"{name} scale" for name in names] + ["level"]
    log_range = fit.state.log_range[context.range_solved]
    values = [*fit.state.centers_px.ravel(), *log_range, *fit.state.scales, fit.state.level_dn]
    return ModelFit(
        parameters=tuple(parameters),
        values=np.array(values),
        covariance=fit.covariance,
        iterations=tuple((float(step[index, 0]), float(step[index, 1])) for step in fit.steps_px),
        residual_sigma=fit.residual_dn * np.sqrt(fit.weight),
        hits=fit.hits,
        pattern_sigma=context.patterns[index].relative_sigma,
        pattern_length_px=context.patterns[index].length_px,
    )
