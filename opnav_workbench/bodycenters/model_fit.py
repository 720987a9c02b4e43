"""From a fit of rendered bodies to their centers: covariance with what the residuals say, flags, pictures."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.company import Company
from opnav_workbench.bodycenters.cutout import Cutout
from opnav_workbench.bodycenters.judging import Evidence, flags_of, messages_of, status_of
from opnav_workbench.bodycenters.pattern import MIN_PIXELS, SIGNIFICANT, Pattern, find_pattern
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter, BodyPictures
from opnav_workbench.bodycenters.scene_fit import SceneFit
from opnav_workbench.bodycenters.size_check import size_ratios

__all__ = ["ModelFit", "explained_share", "measured_bodies"]

# Limbs are sampled in cells of 1/32 px. What that does to a center, over the root of the diameter: nothing for a full
# disk, whose errors cancel, most for a crescent.
RENDERING_ERROR_PX = 0.004


@dataclass(frozen=True, slots=True, eq=False)
class ModelFit:
    """How a model was fitted to the data.

    Attributes
    ----------
    parameters : tuple of str
    values : (p,) array
    covariance : (p, p) array
        From the noise of the pixels.
    iterations : tuple of (float, float)
        Steps of the center, px.
    residual_sigma : (n_line, n_pixel) array
        Data minus model in units of the noise; 0 where a pixel was not used.
    hits : (n_line, n_pixel) array of bool
        Left out as cosmic rays or stars.
    pattern_sigma, pattern_length_px : float
        Contrast and correlation length of what the model lacks on the body; 0 where nothing.
    """

    parameters: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    iterations: tuple[tuple[float, float], ...]
    residual_sigma: FloatArray
    hits: BoolArray
    pattern_sigma: float
    pattern_length_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def measured_bodies(
    picture: BodyPicture,
    cutout: Cutout,
    company: Company,
    fit: SceneFit,
    method: str,
    range_solved: BoolArray,
) -> tuple[dict[str, BodyCenter], FloatArray]:
    """Return the centers of the bodies that were found, and their joint covariance (2 n, 2 n)."""
    patterns = _patterns(fit)
    n = len(fit.state.names)
    honest = fit.noise_covariance * _misfit_factor(fit, patterns)
    honest = honest + sum(pattern.covariance for pattern in patterns)
    own = np.array([_rendering_error(picture, fit, index) for index in range(n)]) ** 2
    honest[np.arange(2 * n), np.arange(2 * n)] += np.repeat(own + picture.excess_sigma_px**2, 2)
    ratios = np.full(n, np.nan)
    if not range_solved.any():
        ratios = size_ratios(picture, cutout, fit, tuple(company.found.values()))
    reported = list(company.found)
    task = _Task(picture, cutout, company, fit, method, range_solved, patterns, honest, ratios)
    centers = {name: _measured(task, index) for index, name in enumerate(reported)}
    return centers, honest[: 2 * len(reported), : 2 * len(reported)]


def _rendering_error(picture: BodyPicture, fit: SceneFit, index: int) -> float:
    phase = picture.phase_rad(fit.state.names[index])
    dark = 0.5 * (1.0 - np.cos(phase)) if np.isfinite(phase) else 0.0
    return float(RENDERING_ERROR_PX * dark / np.sqrt(max(fit.light.diameter_px[index], 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    picture: BodyPicture
    cutout: Cutout
    company: Company
    fit: SceneFit
    method: str
    range_solved: BoolArray
    patterns: list[Pattern]
    covariance: FloatArray
    size_ratios: FloatArray


def _patterns(fit: SceneFit) -> list[Pattern]:
    """Return what each body has that its model lacks."""
    gain = fit.gain
    return [
        find_pattern(fit.residual_dn, fit.weight, scale * light, fit.columns, gain)
        for scale, light in zip(fit.state.scales, fit.light.each, strict=True)
    ]


def _misfit_factor(fit: SceneFit, patterns: list[Pattern]) -> float:
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


def _measured(task: _Task, index: int) -> BodyCenter:
    fit, name = task.fit, task.fit.state.names[index]
    scale, light = float(fit.state.scales[index]), fit.light.each[index] * fit.state.scales[index]
    scale_sigma = float(np.sqrt(fit.covariance[_scale_row(fit, index), _scale_row(fit, index)]))
    if not scale > 0.0 or not np.isfinite(fit.state.centers_px[index]).all():
        return BodyCenter.without_center(
            name, task.method, "not_detected", "the fit found no light of it at its place"
        )
    part = slice(2 * index, 2 * index + 2)
    evidence = Evidence(
        found=task.company.found[name],
        center_px=fit.state.centers_px[index],
        covariance_px2=task.covariance[part, part],
        snr=scale / scale_sigma if scale_sigma > 0.0 else np.nan,
        occulted=float(fit.light.occulted[index]),
        light_dn=light,
        flux_dn=float(fit.light.flux_dn[index]) * scale,
        use=task.cutout.use & ~fit.hits,
        saturated=task.cutout.saturated,
        hits=fit.hits,
        explained=explained_share(
            task.cutout.data_dn, fit.residual_dn, fit.weight, light, fit.state.level_dn
        ),
        size_ratio=float(task.size_ratios[index]),
        converged=fit.converged,
    )
    return _result(task, index, evidence, scale_sigma)


def _result(task: _Task, index: int, evidence: Evidence, scale_sigma: float) -> BodyCenter:
    fit, picture = task.fit, task.picture
    name, part = fit.state.names[index], slice(2 * index, 2 * index + 2)
    solved = bool(task.range_solved[index])
    flags = flags_of(picture, evidence, size_solved=solved)
    range_km = picture.model(name).target.range_km * float(np.exp(fit.state.log_range[index]))
    log_sigma = np.nan
    if solved:
        row = 2 * len(fit.state.names) + int(task.range_solved[:index].sum())
        log_sigma = float(np.sqrt(task.covariance[row, row]))
    diameter = float(fit.light.diameter_px[index])
    return BodyCenter(
        name=name,
        method=task.method,
        status=status_of(evidence, flags),
        pixel_line=evidence.center_px,
        covariance_px2=evidence.covariance_px2,
        flux_dn=evidence.flux_dn,
        snr=evidence.snr,
        diameter_px=diameter if solved else np.nan,
        messages=messages_of(picture, evidence, flags),
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
        pictures=_pictures(task),
        detail=_detail(task, index),
    )


def _pictures(task: _Task) -> BodyPictures:
    fit = task.fit
    return BodyPictures(
        window=task.cutout.window,
        data_dn=task.cutout.data_dn,
        model_dn=fit.model_dn + fit.state.level_dn,
        difference_dn=np.where(task.cutout.use, fit.residual_dn, 0.0),
        mask=fit.weight > 0.0,
    )


def _scale_row(fit: SceneFit, index: int) -> int:
    return len(fit.columns) - 1 - len(fit.state.names) + index


def _detail(task: _Task, index: int) -> ModelFit:
    fit, names = task.fit, task.fit.state.names
    solved = [name for name, wanted in zip(names, task.range_solved, strict=True) if wanted]
    parameters = [f"{name} {axis}" for name in names for axis in ("pixel", "line")]
    parameters += [f"{name} log range" for name in solved] + [f"{name} scale" for name in names] + ["level"]
    log_range = fit.state.log_range[task.range_solved]
    values = [*fit.state.centers_px.ravel(), *log_range, *fit.state.scales, fit.state.level_dn]
    return ModelFit(
        parameters=tuple(parameters),
        values=np.array(values),
        covariance=fit.covariance,
        iterations=tuple((float(step[index, 0]), float(step[index, 1])) for step in fit.steps_px),
        residual_sigma=fit.residual_dn * np.sqrt(fit.weight),
        hits=fit.hits,
        pattern_sigma=task.patterns[index].relative_sigma,
        pattern_length_px=task.patterns[index].length_px,
    )
