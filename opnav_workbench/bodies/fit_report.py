"""From a fit of rendered bodies to their `BodyCenter`: covariance with what the residuals say, flags, status, messages.

Covariances hold the noise of the pixels, the pattern that the model lacks (``residuals``), the
sampling of the rendering and the centering error of the frame's stars.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.detection import DetectedBody, DetectedScene
from opnav_workbench.bodies.judgement import is_thin_crescent
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.residuals import (
    MIN_PIXELS,
    SIGNIFICANT,
    ResidualPattern,
    find_residual_pattern,
    size_ratios,
)
from opnav_workbench.bodies.results import (
    CIRCLE_SIZE_TOLERANCE,
    DOUBTFUL_FLAGS,
    SIZE_TOLERANCE,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    ModelFit,
    flag_messages,
    flags_where,
    size_messages,
)
from opnav_workbench.bodies.scene_fit import SceneFit
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["report_fitted_bodies"]


# ---- Verdict over a body's center: flags, status, and what the analyst must know.

LOST_LIGHT = 0.1  # share of a body's light off the detector that makes its center doubtful
SATURATED_PART = 0.2  # of its bright pixels
BAD_PART = 0.1
CERTAIN_SNR = 5.0
POORLY_EXPLAINED = (
    0.6  # share of the light's variation under it; an albedo map of Pluto's contrast leaves 0.9
)
WEAK_RATIO = 10.0  # of the axes of the error ellipse
WEAK_SIGMA_PX = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class FitEvidence:
    """What a fit tells of one body.

    Attributes
    ----------
    center_px : (2,) array
    covariance_px2 : (2, 2) array
    occulted
        Share of its light that others hide.
    light_dn : (n_line, n_pixel) array
        Its light in the window, at the solution.
    flux_dn
        All of its light, on and off the window.
    use, saturated, hits : (n_line, n_pixel) arrays of bool
    explained
        Share, 0..1, of the data's variation under the body.
    size_ratio
        Size of its image over the model's, where that was checked; nan where not.
    """

    found: DetectedBody
    center_px: FloatArray
    covariance_px2: FloatArray
    snr: float
    occulted: float
    light_dn: FloatArray
    flux_dn: float
    use: BoolArray
    saturated: BoolArray
    hits: BoolArray
    explained: float
    size_ratio: float
    converged: bool

    @property
    def bright(self) -> BoolArray:
        """Pixels that show the body."""
        return np.asarray(self.light_dn > 0.1 * self.light_dn.max(initial=0.0))

    @property
    def lost_light(self) -> float:
        """Share of its light that falls off the window."""
        return float(1.0 - self.light_dn.sum() / self.flux_dn) if self.flux_dn > 0.0 else 0.0


def fit_flags(picture: BodyPicture, evidence: FitEvidence, *, size_solved: bool) -> BodyFlag:
    """Return what is known against a center."""
    expected, bright = evidence.found.expectation, evidence.bright
    unusable = bright & ~evidence.use & ~evidence.saturated
    error = np.linalg.eigvalsh(evidence.covariance_px2)
    beyond = float(np.hypot(*(evidence.center_px - expected.center_px))) > expected.search_px + 1.0
    conditions = {
        BodyFlag.CUT_BY_EDGE: _cut(picture, evidence),
        BodyFlag.OVEREXPOSED: bool(np.any(bright & evidence.saturated)),
        BodyFlag.OCCULTED: evidence.occulted > 0.0,
        BodyFlag.THIN_CRESCENT: is_thin_crescent(picture, expected.name, expected.radius_px),
        BodyFlag.CIRCLE_MISFIT: _misfit(evidence, size_solved=size_solved),
        BodyFlag.POOR_FIT: evidence.explained < POORLY_EXPLAINED,
        BodyFlag.AT_LIMIT: beyond,
        BodyFlag.WEAK_GEOMETRY: bool(
            error[1] > WEAK_SIGMA_PX**2 and error[1] > WEAK_RATIO**2 * max(error[0], 0.0)
        ),
        BodyFlag.BAD_PIXELS: bool(unusable.any()),
        BodyFlag.HIT: bool(np.any(bright & evidence.hits)),
        BodyFlag.NOT_CONVERGED: not evidence.converged,
    }
    return flags_where(conditions)


def fit_status(evidence: FitEvidence, flags: BodyFlag) -> str:
    """Return ``ok`` or ``uncertain``."""
    bright = evidence.bright
    count = max(int(bright.sum()), 1)
    saturated = int((bright & evidence.saturated).sum()) / count
    bad = int((bright & ~evidence.use & ~evidence.saturated).sum()) / count
    doubtful = (
        bool(flags & DOUBTFUL_FLAGS)
        or evidence.lost_light > LOST_LIGHT
        or saturated > SATURATED_PART
        or bad > BAD_PART
        or evidence.snr < CERTAIN_SNR
    )
    return "uncertain" if doubtful else "ok"


def fit_messages(picture: BodyPicture, evidence: FitEvidence, flags: BodyFlag) -> tuple[str, ...]:
    """Return what is known against a center, in words and numbers."""
    notes = {
        BodyFlag.CUT_BY_EDGE: f"{100 * evidence.lost_light:.0f} % of its light",
        BodyFlag.OCCULTED: f"{100 * evidence.occulted:.0f} % of its light",
        BodyFlag.POOR_FIT: f"the model explains {100 * evidence.explained:.0f} % of the light",
        BodyFlag.CIRCLE_MISFIT: _size_words(picture, evidence),
        BodyFlag.OVEREXPOSED: f"{int((evidence.bright & evidence.saturated).sum())} px",
        BodyFlag.BAD_PIXELS: f"{int((evidence.bright & ~evidence.use & ~evidence.saturated).sum())} px",
        BodyFlag.HIT: f"{int((evidence.bright & evidence.hits).sum())} px",
    }
    messages = flag_messages(flags, notes)
    if evidence.snr < CERTAIN_SNR:
        messages.append(f"SNR {evidence.snr:.1f} is below {CERTAIN_SNR:g}")
    return tuple(messages)


def _cut(picture: BodyPicture, evidence: FitEvidence) -> bool:
    radius = evidence.found.expectation.radius_px
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low, high = evidence.center_px - radius, evidence.center_px + radius
    return bool(np.any(low < -0.5) or np.any(high > size - 0.5))


def _misfit(evidence: FitEvidence, *, size_solved: bool) -> bool:
    off = abs(evidence.size_ratio - 1.0)
    if np.isfinite(off) and off > SIZE_TOLERANCE:
        return True
    ratio = evidence.found.expectation.circle_ratio
    return (
        bool(not size_solved and abs(np.log(ratio)) > CIRCLE_SIZE_TOLERANCE) if np.isfinite(ratio) else False
    )


def _size_words(picture: BodyPicture, evidence: FitEvidence) -> str:
    expected = evidence.found.expectation
    remedy = "check its range and radii, or solve for its range"
    words = size_messages(
        evidence.size_ratio, expected.circle_ratio, picture.diameter_px(expected.name), "it is about", remedy
    )
    return "; ".join(words)


# ---- From a fit of rendered bodies to their centers: covariance with what the residuals say, flags, pictures.

# Limbs are sampled in cells of 1/32 px. What that does to a center, over the root of the diameter: nothing for a full
# disk, whose errors cancel, most for a crescent.
RENDERING_ERROR_PX = 0.004


def report_fitted_bodies(
    picture: BodyPicture,
    cutout: Cutout,
    detected: DetectedScene,
    fit: SceneFit,
    method: str,
    range_solved: BoolArray,
) -> tuple[dict[str, BodyCenter], FloatArray]:
    """Return the centers of the bodies that were found, and their joint covariance (2 n, 2 n)."""
    patterns = _patterns(fit)
    n = len(fit.state.names)
    covariance = fit.noise_covariance * _misfit_factor(fit, patterns)
    covariance = covariance + sum(pattern.covariance for pattern in patterns)
    own = np.array([_rendering_error(picture, fit, index) for index in range(n)]) ** 2
    covariance[np.arange(2 * n), np.arange(2 * n)] += np.repeat(own + picture.excess_sigma_px**2, 2)
    ratios = np.full(n, np.nan)
    if not range_solved.any():
        ratios = size_ratios(picture, cutout, fit, tuple(detected.found.values()))
    reported = list(detected.found)
    context = _FitContext(picture, cutout, detected, fit, method, range_solved, patterns, covariance, ratios)
    centers = {name: _body_center(context, index) for index, name in enumerate(reported)}
    return centers, covariance[: 2 * len(reported), : 2 * len(reported)]


def _rendering_error(picture: BodyPicture, fit: SceneFit, index: int) -> float:
    phase = picture.phase_rad(fit.state.names[index])
    dark = 0.5 * (1.0 - np.cos(phase)) if np.isfinite(phase) else 0.0
    return float(RENDERING_ERROR_PX * dark / np.sqrt(max(fit.light.diameter_px[index], 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class _FitContext:
    picture: BodyPicture
    cutout: Cutout
    detected: DetectedScene
    fit: SceneFit
    method: str
    range_solved: BoolArray
    patterns: list[ResidualPattern]
    covariance: FloatArray
    size_ratios: FloatArray


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
    scale, light = float(fit.state.scales[index]), fit.light.each[index] * fit.state.scales[index]
    scale_sigma = float(np.sqrt(fit.covariance[_scale_row(fit, index), _scale_row(fit, index)]))
    if not scale > 0.0 or not np.isfinite(fit.state.centers_px[index]).all():
        return BodyCenter.without_center(
            name, context.method, "not_detected", "the fit found no light of it at its place"
        )
    part = slice(2 * index, 2 * index + 2)
    evidence = FitEvidence(
        found=context.detected.found[name],
        center_px=fit.state.centers_px[index],
        covariance_px2=context.covariance[part, part],
        snr=scale / scale_sigma if scale_sigma > 0.0 else np.nan,
        occulted=float(fit.light.occulted[index]),
        light_dn=light,
        flux_dn=float(fit.light.flux_dn[index]) * scale,
        use=context.cutout.use & ~fit.hits,
        saturated=context.cutout.saturated,
        hits=fit.hits,
        explained=explained_share(
            context.cutout.data_dn, fit.residual_dn, fit.weight, light, fit.state.level_dn
        ),
        size_ratio=float(context.size_ratios[index]),
        converged=fit.converged,
    )
    return _result(context, index, evidence, scale_sigma)


def _result(context: _FitContext, index: int, evidence: FitEvidence, scale_sigma: float) -> BodyCenter:
    fit, picture = context.fit, context.picture
    name, part = fit.state.names[index], slice(2 * index, 2 * index + 2)
    solved = bool(context.range_solved[index])
    flags = fit_flags(picture, evidence, size_solved=solved)
    range_km = picture.model(name).target.range_km * float(np.exp(fit.state.log_range[index]))
    log_sigma = np.nan
    if solved:
        row = 2 * len(fit.state.names) + int(context.range_solved[:index].sum())
        log_sigma = float(np.sqrt(context.covariance[row, row]))
    diameter = float(fit.light.diameter_px[index])
    return BodyCenter(
        name=name,
        method=context.method,
        status=fit_status(evidence, flags),
        pixel_line=evidence.center_px,
        covariance_px2=evidence.covariance_px2,
        flux_dn=evidence.flux_dn,
        snr=evidence.snr,
        diameter_px=diameter if solved else np.nan,
        messages=fit_messages(picture, evidence, flags),
        flags=int(flags),
        noise_covariance_px2=fit.noise_covariance[part, part],
        chi2_reduced=fit.chi2 / fit.degrees_of_freedom,
        diameter_sigma_px=diameter * log_sigma,
        brightness_scale=float(fit.state.scales[index]),
        brightness_scale_sigma=scale_sigma,
        background_dn=fit.state.level_dn,
        background_sigma_dn=float(np.sqrt(fit.covariance[-1, -1])),
        range_km=range_km if solved else np.nan,
        range_sigma_km=range_km * log_sigma,
        pictures=_pictures(context),
        detail=_detail(context, index),
    )


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
