"""The best exposure: the one whose picture tells most of the target's direction among the stars, nothing saturated.

A target's direction among the stars has the noise of its own center and that of the attitude. Longer exposures help both
until the target, or too many stars, saturate, or motion draws them out. The scene's light is scaled with the exposure;
light of the frame transfer does not depend on it.
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.planning.attitude import plan_pointing
from opnav_workbench.planning.bodies import BodyLight, TargetPlan, body_light, center_bound
from opnav_workbench.planning.light import ExpectedLight, star_psf
from opnav_workbench.planning.stars import StarPlan, star_bounds
from opnav_workbench.psf import Psf
from opnav_workbench.psf.protocol import covering_boxes

__all__ = ["BestExposure", "best_exposure"]

EXPOSURE_STEPS = 21  # of the exposure, in equal ratios
SHORTEST_S, LONGEST_RATIO = 1e-3, 100.0  # where the camera's own limits are not known
SATURATION_MARGIN = 0.9  # of the level: noise, phase and albedo take a pixel over what is expected


@dataclass(frozen=True, slots=True, eq=False)
class BestExposure:
    """Expected error against exposure.

    Attributes
    ----------
    exposure_s : (n,) array
    sigma_px : (n,) array
        Root mean square of the target's error along pixel and line with the attitude's (of the boresight's place
        without a target); nan where saturated or nothing is determined.
    stars : (n,) array of int
        Usable stars.
    best_s
        Of the smallest error; nan where no exposure gives one.
    limited_by
        What ends it: "saturation of NAME" or "saturation", "longest exposure allowed", "motion, background and bright
        stars", or "no exposure determines it".
    """

    exposure_s: FloatArray
    sigma_px: FloatArray
    stars: IntArray
    best_s: float
    limited_by: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class _ExposureSearch:
    """What every trial exposure shares."""

    light: ExpectedLight
    stars: StarPlan
    psf: Psf
    offered: BoolArray  # stars that may count once they are bright enough
    star_peak: FloatArray  # share of a star's light in its brightest pixel
    sky_e: FloatArray  # at each star, without it, scaling with the exposure
    smear_e: FloatArray
    smear_plane_e: FloatArray  # of the whole detector
    index: int | None
    seen: BodyLight | None
    min_snr: float


def best_exposure(
    light: ExpectedLight, stars: StarPlan, index: int | None, target: TargetPlan | None, min_snr: float
) -> BestExposure:
    """Return the error against exposure, and its minimum.

    Parameters
    ----------
    light
        Of the picture as planned.
    index
        Of the target among the picture's models; None: the pointing alone counts.
    target
        The same target.
    min_snr
        Below this a star is not used.
    """
    search = _exposure_search(light, stars, index, min_snr)
    grid = _exposure_grid(light)
    rows = [_error_px(search, target, t / light.inputs.exposure_s) for t in grid]
    sigma, count, full = (np.array(column) for column in zip(*rows, strict=True))
    if not np.isfinite(sigma).any():
        return BestExposure(grid, sigma, count, float("nan"), "no exposure determines it")
    best = int(np.nanargmin(sigma))
    if best + 1 < len(grid) and full[best + 1]:
        reason = f"saturation of {target.name}" if target else "saturation"
    else:
        reason = (
            "longest exposure allowed" if best == len(grid) - 1 else "motion, background and bright stars"
        )
    return BestExposure(grid, sigma, count, float(grid[best]), reason)


def _exposure_grid(light: ExpectedLight) -> FloatArray:
    limits, now = light.inputs.camera.exposure_limits, light.inputs.exposure_s
    shortest = max(SHORTEST_S, limits.min_s) if limits else min(SHORTEST_S, now)
    longest = limits.max_s if limits else LONGEST_RATIO * now
    grid = np.geomspace(shortest, max(longest, now), EXPOSURE_STEPS)
    return np.unique(np.append(grid, now))


def _exposure_search(
    light: ExpectedLight, stars: StarPlan, index: int | None, min_snr: float
) -> _ExposureSearch:
    psf = star_psf(light.inputs)
    first, size = covering_boxes(light.inputs.psf, stars.pixel_line) if len(stars) else (None, 0)
    peak = np.zeros(0) if first is None else psf.box(stars.pixel_line, first, size).max(axis=(1, 2))
    pixel, line = np.rint(stars.pixel_line).astype(np.int64).T
    line = np.clip(line, 0, light.inputs.camera.n_line - 1)
    pixel = np.clip(pixel, 0, light.inputs.camera.n_pixel - 1)
    plane = _smear(light)
    below, smear = light.without_stars_e[line, pixel], plane[line, pixel]
    return _ExposureSearch(
        light=light,
        stars=stars,
        psf=psf,
        offered=np.isin(stars.status, ("usable", "faint", "saturated")),
        star_peak=peak,
        sky_e=np.maximum(below - smear, 0.0),
        smear_e=smear,
        smear_plane_e=plane,
        index=index,
        seen=None if index is None else body_light(light, index),
        min_snr=min_snr,
    )


def _smear(light: ExpectedLight) -> FloatArray:
    """Return the electrons of the frame transfer, which do not grow with the exposure."""
    transfer = light.values.transfer
    if transfer is None:
        return np.zeros_like(light.expected_e)
    return np.maximum(light.expected_e - transfer.remove(light.expected_e), 0.0)


def _error_px(search: _ExposureSearch, target: TargetPlan | None, ratio: float) -> tuple[float, int, bool]:
    """Return the error, px, the number of stars, and whether the target is saturated, at `ratio` times the exposure."""
    light, camera = search.light, search.light.inputs.camera
    limit_e = _limit_dn(light) * light.values.gain_e_per_dn * SATURATION_MARGIN
    flux_e = ratio * search.stars.flux_dn * light.values.gain_e_per_dn
    below = ratio * search.sky_e + search.smear_e
    bright = flux_e * search.star_peak + below < limit_e
    covariance, snr = _star_bounds(search, flux_e, below, ratio)
    use = search.offered & bright & (snr >= search.min_snr)
    stars = replace(search.stars, covariance_px2=covariance)
    pointing = plan_pointing(stars, camera, light.inputs.path.middle, use, guarded=False)
    if pointing is None:
        return float("nan"), int(use.sum()), False
    if target is None or search.seen is None:
        return float(np.sqrt(np.mean(pointing.sigma_px**2))), int(use.sum()), False
    smear = search.seen.cut(search.smear_plane_e)
    mean = ratio * np.maximum(search.seen.cut(light.expected_e) - smear, 0.0) + smear
    if float(mean[search.seen.electrons > 0.1 * search.seen.electrons.max()].max(initial=0.0)) > limit_e:
        return float("nan"), int(use.sum()), True
    center, _ = center_bound(light, search.seen, ratio, mean)
    by_attitude = camera.attitude_jacobian(light.inputs.path.middle @ target.prediction.direction)
    total = center + by_attitude @ pointing.covariance_rad2 @ by_attitude.T
    return float(np.sqrt(0.5 * np.trace(total))), int(use.sum()), False


def _limit_dn(light: ExpectedLight) -> float:
    camera, values = light.inputs.camera, light.values
    levels = [camera.saturation_dn, None if values.ceiling_dn is None else values.ceiling_dn - values.bias_dn]
    levels.append(None if values.full_well_e is None else values.full_well_e / values.gain_e_per_dn)
    return min((level for level in levels if level is not None), default=np.inf)


def _star_bounds(
    search: _ExposureSearch, flux_e: FloatArray, below_e: FloatArray, ratio: float
) -> tuple[FloatArray, FloatArray]:
    light, gain = search.light, search.light.values.gain_e_per_dn
    psf = search.psf if light.inputs.path.is_still else star_psf(light.inputs, ratio)
    noise = np.sqrt(light.variance_dn2(below_e))
    return star_bounds(search.stars.pixel_line, flux_e / gain, noise, psf, light.noise_model)
