"""From the offsets of scans to the outline of the body: weighted least squares, outliers rejected, honest covariance.

An offset along a scan is ``motion @ step``, the projection of the center's step on the limb's normal over the cosine
between normal and scan, and what size, axes, law and PSF add. Size and axes have the uncertainty that the likelihood of
the disk begins with, the look of the disk that which it ends with; errors that neighbouring scans share, from noise,
albedo and topography, are in the weights.

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies.disk.columns import FIGURE, DiskShape
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.limb_scan.matching import ScanMatch
from opnav_workbench.bodies.limb_scan.view import LOOK, OUTLINE
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.robust import moment_excess

__all__ = ["FEWEST", "OutlineStep", "solve_outline"]

FEWEST = 3
OUTLIER_SIGMAS = 4.0
ROUNDS = 10
MAX_REJECTED = 0.4  # of the scans: more outliers than that are the rule
FREE_PX = 1e3  # of the center
UNSHARED_PX = 1e-3  # to which an excess is found


@dataclass(frozen=True, slots=True, eq=False)
class OutlineStep:
    """What the offsets say of an outline.

    Attributes
    ----------
    step : (p,) array
        From the scans' shape, as `opnav_workbench.bodies.limb_scan.view.COMMON`: center (px), logarithm of the size, ...
    covariance, noise_covariance : (p, p) arrays
    used : (n,) array of bool
    residual_px : (n,) array
    offset_covariance : (n, n) array
        Of the scans' offsets, with what each has for itself beyond what was known of it.
    chi2_reduced
        Of the residuals with what was known.
    """

    step: FloatArray
    covariance: FloatArray
    noise_covariance: FloatArray
    used: BoolArray
    residual_px: FloatArray
    offset_covariance: FloatArray
    chi2_reduced: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def solve_outline(match: ScanMatch, chosen: BoolArray, fit: DiskFit, shape: DiskShape) -> OutlineStep:
    """Solve for the outline with the chosen scans, less those that are off, as a step from a shape."""
    mean, precision = _prior(fit, shape)
    used, own = chosen, match.covariance
    limit = max(FEWEST, int(np.floor((1.0 - MAX_REJECTED) * chosen.sum())))
    for _ in range(ROUNDS):
        own = match.covariance + _unshared(match, used, mean, precision) * np.eye(len(used))
        estimator, step, covariance = _solved(match, own, used, mean, precision)
        residual = match.offset_px - match.common @ step
        off = np.abs(residual) / np.sqrt(np.diag(own))
        near = chosen & (off < OUTLIER_SIGMAS * max(MAD_TO_SIGMA * float(np.median(off[used])), 1.0))
        if near.sum() < limit or np.array_equal(near, used):
            break
        rows, used = used, near
    else:
        used = rows
    scatter = _scatter(residual[used], match.covariance[np.ix_(used, used)])
    noise = estimator @ match.noise[np.ix_(used, used)] @ estimator.T
    return OutlineStep(step, symmetric(covariance), symmetric(noise), used, residual, own, scatter)


def _scatter(residual: FloatArray, covariance: FloatArray) -> float:
    """Return chi-squared of residuals (n,) a degree of freedom."""
    return float(residual @ np.linalg.solve(covariance, residual)) / max(len(residual) - 2, 1)


def _unshared(match: ScanMatch, used: BoolArray, mean: FloatArray, precision: FloatArray) -> float:
    """Return the variance, px^2, that each scan has for itself beyond what is known of it.

    Edges, relief and rays that are finer than the disk's pieces of limb: with it the scans scatter as they should.
    """

    def surplus(sigma: float) -> float:
        own = match.covariance + sigma**2 * np.eye(len(used))
        _, step, _ = _solved(match, own, used, mean, precision)
        residual = (match.offset_px - match.common @ step)[used]
        return _scatter(residual, own[np.ix_(used, used)]) - 1.0

    return moment_excess(surplus, UNSHARED_PX) ** 2


def _prior(fit: DiskFit, shape: DiskShape) -> tuple[FloatArray, FloatArray]:
    """Return mean (p,) and precision (p, p) of what all scans share, as a step from a shape."""
    outline, system = len(OUTLINE), fit.system
    mean = np.zeros(outline + len(LOOK))
    figure, fixed = system.figure_prior(fit.solution, FIGURE)
    mean[2:outline] = figure - np.array([shape.log_size, *shape.strain[:2]])
    precision = np.zeros((len(mean), len(mean)))
    precision[range(outline), range(outline)] = [*(FREE_PX**-2.0,) * 2, *fixed]
    precision[outline:, outline:] = np.linalg.inv(fit.solution.covariance[np.ix_(LOOK, LOOK)])
    return mean, precision


def _solved(
    match: ScanMatch, own: FloatArray, used: BoolArray, mean: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the matrix (p, n used) from offsets to the solution, the solution (p,) and its covariance (p, p)."""
    columns = match.common[used]
    weighted = np.linalg.solve(own[np.ix_(used, used)], columns)
    covariance = np.asarray(np.linalg.inv(columns.T @ weighted + precision), dtype=np.float64)
    estimator = np.asarray(covariance @ weighted.T)
    return estimator, estimator @ match.offset_px[used] + covariance @ (precision @ mean), covariance
