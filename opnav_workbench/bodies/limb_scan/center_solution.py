"""From the offsets of scans to the center of the body: weighted least squares, outliers rejected, honest covariance.

An offset along a scan is ``motion @ step``: the projection of the center's step on the limb's normal, over the cosine
between normal and scan. Noise is traced back to the pixels, which neighbouring scans share; errors from the albedo are
shared by scans that cross the same region.

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies.limb_scan.fan import ScanSampler
from opnav_workbench.bodies.limb_scan.matching import ScanMatch
from opnav_workbench.bodies.limb_scan.view import CORRELATION_RAD
from opnav_workbench.constants import MAD_TO_SIGMA

__all__ = ["CenterStep", "ErrorSources", "OffsetErrors", "offset_errors", "solve_center"]

OUTLIER_SIGMAS = 4.0
ROUNDS = 10
FEWEST = 3
MAX_REJECTED = 0.4  # of the scans: more outliers than that are the rule
# A common distance of all offsets from zero, beyond this many sigmas, is not noise: the body has another size, and a limb
# seen from one side would turn that into a shift. It is then solved for, fully where it is much larger than that.
SIZE_SIGMAS = 3.0
# Regions of one albedo are longer along the limb than what a scan meets across it: centers on 60 mottled surfaces of 40 to
# 190 px scatter by 0.6 to 2.1 sigma with this angle, by 0.7 to 2.7 with that of the profiles.
REGION_RAD = np.radians(16.0)
EXCESS = 1.3  # reduced chi-squared that the residuals of right sigmas stay below


@dataclass(frozen=True, slots=True, eq=False)
class OffsetErrors:
    """Uncertainty of n offsets.

    Attributes
    ----------
    noise2 : (n,) array
        Variance from noise, px^2.
    albedo2 : (n,) array
        Variance from an uneven albedo.
    """

    noise2: FloatArray
    albedo2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sigma_px(self) -> FloatArray:
        """Both (n,)."""
        return np.sqrt(self.noise2 + self.albedo2)


@dataclass(frozen=True, slots=True, eq=False)
class CenterStep:
    """What the offsets say of the center.

    Attributes
    ----------
    step_px : (2,) array
        From the model's center.
    covariance_px2, noise_covariance_px2 : (2, 2) arrays
    used : (n,) array of bool
    residual_px : (n,) array
    size, size_sigma
        Logarithm of the size over the predicted one, solved together with the center.
    size_trust
        How far the center follows that solution, 0..1: 0 unless the size is significantly different.
    """

    step_px: FloatArray
    covariance_px2: FloatArray
    noise_covariance_px2: FloatArray
    used: BoolArray
    residual_px: FloatArray
    chi2_reduced: float
    size: float
    size_sigma: float
    size_trust: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSources:
    """Where errors of offsets come from.

    Attributes
    ----------
    sampler
        Which pixels the samples of the scans rest on.
    variance_dn2 : (n_line, n_pixel) array
        Of the noise of pixels.
    roughness
        Relative scatter of the albedo.
    angle_rad : (n,) array
        Of the scans: those that lie close share an albedo.
    common_covariance : (g, g) array
        Of what was taken out of all scans (`opnav_workbench.bodies.limb_scan.matching`).
    """

    sampler: ScanSampler
    variance_dn2: FloatArray
    roughness: float
    angle_rad: FloatArray
    common_covariance: FloatArray

    def noise(self, estimator: FloatArray, match: ScanMatch) -> FloatArray:
        """Return the noise covariance (p, p) of linear combinations (p, n) of offsets."""
        rows = [self.sampler.pixel_weights(row[:, None] * match.gain).sum(axis=0) for row in estimator]
        weights = np.stack([np.asarray(row).ravel() for row in rows])
        return np.asarray((weights * self.variance_dn2.ravel()) @ weights.T)

    def shared(self, match: ScanMatch, along_rad: float = CORRELATION_RAD) -> FloatArray:
        """Return the covariance (n, n) of offsets from albedo, alike over an angle, and from what all scans share."""
        apart = np.abs(self.angle_rad[:, None] - self.angle_rad)
        apart = np.minimum(apart, 2.0 * np.pi - apart)
        nearby = np.exp(-0.5 * (apart / along_rad) ** 2)
        albedo = self.roughness**2 * (match.albedo @ match.albedo.T) * nearby
        return np.asarray(albedo + match.common @ self.common_covariance @ match.common.T)


def offset_errors(
    match: ScanMatch, sampler: ScanSampler, variance_dn2: FloatArray, roughness: FloatArray | float
) -> OffsetErrors:
    """Return the uncertainty of offsets from the noise of pixels (n_line, n_pixel) and an albedo's roughness."""
    weights = sampler.pixel_weights(match.gain)
    noise2 = np.asarray(weights.multiply(weights) @ variance_dn2.ravel())
    noise2 = np.where(noise2 > 0.0, noise2, np.inf)  # without light a scan says nothing
    albedo2 = np.square(roughness) * np.sum(match.albedo**2, axis=1)
    return OffsetErrors(noise2, albedo2)


def solve_center(
    match: ScanMatch,
    weight_sigma_px: FloatArray,
    chosen: BoolArray,
    limb_px: FloatArray,
    sources: ErrorSources,
    size_in_model: float,
    trust: float | None,
) -> CenterStep:
    """Solve for the center with the chosen scans.

    Parameters
    ----------
    weight_sigma_px : (n,) array
        Sigma that a scan is weighted and judged with.
    chosen : (n,) array of bool
    limb_px : (n,) array
        Distance of the limb: the change of an offset with the logarithm of the body's size.
    size_in_model
        Logarithm of the size that the model has over the predicted one.
    trust
        How far to follow the measured size, 0..1; None: as it is significant.
    """
    used = _without_outliers(match, weight_sigma_px, chosen)
    weight = np.where(used, 1.0 / weight_sigma_px**2, 0.0)
    plain = _estimator(match.motion, weight)
    sizing = _estimator(np.concatenate([match.motion, limb_px[:, None]], axis=1), weight)[2:]
    shared = sources.shared(match)
    size = size_in_model + float(sizing[0] @ match.offset_px)
    size_variance = float((sources.noise(sizing, match) + sizing @ shared @ sizing.T)[0, 0])
    trust = _trust(size, size_variance) if trust is None else trust
    offset = match.offset_px - (trust * size - size_in_model) * limb_px
    step = plain @ offset
    residual = offset - match.motion @ step
    own = offset_errors(match, sources.sampler, sources.variance_dn2, sources.roughness)
    chi2 = float(np.sum((residual[used] / own.sigma_px[used]) ** 2)) / max(int(used.sum()) - 2, 1)
    excess = max(1.0, chi2 / EXCESS)
    estimator = plain - trust * (plain @ limb_px)[:, None] * sizing
    noise = sources.noise(estimator, match)
    wide = sources.shared(match, REGION_RAD)
    return CenterStep(
        step_px=step,
        covariance_px2=symmetric(excess * (noise + estimator @ wide @ estimator.T)),
        noise_covariance_px2=symmetric(noise),
        used=used,
        residual_px=residual,
        chi2_reduced=chi2,
        size=size,
        size_sigma=float(np.sqrt(excess * size_variance)),
        size_trust=trust,
    )


def _trust(size: float, variance: float) -> float:
    """Return how far a measured size is followed: not at all within `SIZE_SIGMAS`, nearly fully far beyond."""
    return max(0.0, 1.0 - SIZE_SIGMAS**2 * variance / max(size**2, np.finfo(float).tiny))


def _without_outliers(match: ScanMatch, sigma: FloatArray, chosen: BoolArray) -> BoolArray:
    """Return the scans (n,) that agree with each other, starting from the median of their residuals."""
    used = chosen.copy()
    limit = int(np.ceil(MAX_REJECTED * chosen.sum()))
    for turn in range(ROUNDS):
        weight = np.where(used, 1.0 / sigma**2, 0.0)
        step = _estimator(match.motion, weight) @ match.offset_px
        residual = np.abs(match.offset_px - match.motion @ step) / sigma
        spread = max(MAD_TO_SIGMA * float(np.median(residual[used])), 1.0)
        near = chosen & (residual < OUTLIER_SIGMAS * spread)
        if near.sum() < max(FEWEST, int(chosen.sum()) - limit):
            return used
        if turn and np.array_equal(near, used):
            break
        used = near
    return used


def _estimator(columns: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the matrix (p, n) of weighted least squares; of the shortest solution where the columns do not tell all."""
    weighted = columns * weight[:, None]
    scale = np.sqrt(np.maximum(np.einsum("np,np->p", weighted, columns), np.finfo(float).tiny))
    normal = (columns.T @ weighted) / np.outer(scale, scale)
    return np.asarray(
        np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (weighted / scale).T / scale[:, None]
    )
