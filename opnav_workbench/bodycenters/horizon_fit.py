"""From shifts of limb pieces to the motion of the body: robust weighted least squares with an honest covariance.

Flow   shifts and their responses -> outliers out, with reasons -> motion of the center (and range) -> covariance

A rough body's limb leaves its model by more than the noise, and neighbouring pieces together: topography is a stretch of
correlated residuals, which do not average out like noise. Its variance is estimated where the residuals exceed the noise
beyond doubt, its length from their correlation along the limb, and both enter the covariance.

Sources  Paule & Mandel (1982), doi:10.6028/jres.087.022, for the variance that decides on weights and outliers;
         restricted maximum likelihood for variance and length in the covariance
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import chdtri

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric

__all__ = ["LimbMotion", "limb_motion"]

OUTLIER_SIGMAS = 4.0  # of noise and roughness together: 6e-5 of good points
ROUNDS = 12  # of leaving out and taking back
DOUBT = 0.01  # residuals larger than this share of mere noise would give count as roughness
NORMAL_MAD = 1.4826
FIRST_LENGTH = 2.0  # pieces, to start from
SHORTEST, SHORTEST_PULL = 0.2, 1.0
MOST_TRIALS = 80
LONGEST_SHARE = 1.0 / 12.0  # of the limb: what is alike over more than 30 deg is a wrong figure, not relief


@dataclass(frozen=True, slots=True, eq=False)
class LimbMotion:
    """Motion of a body that fits the shifts of its limb.

    Attributes
    ----------
    motion : (3,) array
        Of center pixel and line (px), and of the logarithm of the range; 0 where not solved for.
    covariance, noise_covariance : (3, 3) arrays
        With roughness, and from noise alone.
    residual_px : (n,) array
        Shift left over.
    used : (n,) array of bool
    rough_px : float
        Standard deviation of the limb beyond noise.
    rough_length : float
        Pieces over which it is correlated (e-folding).
    chi2_reduced : float
        Of the residuals against noise alone.
    """

    motion: FloatArray
    covariance: FloatArray
    noise_covariance: FloatArray
    residual_px: FloatArray
    used: BoolArray
    rough_px: float
    rough_length: float
    chi2_reduced: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def limb_motion(
    shift_px: FloatArray,
    sigma_px: FloatArray,
    response: FloatArray,
    usable: BoolArray,
    *,
    solve_range: bool,
) -> LimbMotion | None:
    """Fit the motion of a body to the shifts of n pieces of its limb.

    Parameters
    ----------
    shift_px, sigma_px : (n,) arrays
        In order along the limb.
    response : (n, 3) array
        Of the shift to center pixel, line (px) and log range.
    usable : (n,) array of bool
        Pieces that count, unless they prove to be outliers.
    solve_range : bool

    Returns
    -------
    LimbMotion or None
        None where too few pieces remain.
    """
    columns = 3 if solve_range else 2
    design = response[:, :columns]
    used, rough = usable.copy(), 0.0
    if np.count_nonzero(used) <= columns:
        return None
    solution = _robust_start(shift_px, sigma_px, design, used)
    for _ in range(ROUNDS):
        residual = shift_px - design @ solution
        spread = _spread(residual[used], sigma_px[used])
        near = usable & (np.abs(residual) <= OUTLIER_SIGMAS * np.hypot(sigma_px, max(rough, spread)))
        if np.count_nonzero(near) <= columns:
            return None
        rough = _roughness(residual[near], sigma_px[near], columns)
        settled = bool(np.array_equal(near, used))
        used = near
        solution = _weighted(shift_px, np.hypot(sigma_px, rough), design, used)[0]
        if settled:
            break
    return _result(shift_px, sigma_px, design, used, rough, solution)


def _weighted(
    shift: FloatArray, sigma: FloatArray, design: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the weighted solution, and the matrix (columns, n used) that takes shifts to it."""
    weight = sigma[used] ** -2.0
    normal = design[used].T @ (weight[:, None] * design[used])
    gain = np.linalg.pinv(normal, hermitian=True) @ (design[used].T * weight)
    return np.asarray(gain @ shift[used]), np.asarray(gain)


def _robust_start(shift: FloatArray, sigma: FloatArray, design: FloatArray, used: BoolArray) -> FloatArray:
    """Return a solution with Cauchy weights: outliers pull it little."""
    width = sigma.copy()
    solution = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        residual = shift - design @ solution
        scale = max(NORMAL_MAD * float(np.median(np.abs(residual[used] / sigma[used]))), 1.0)
        width = sigma * np.sqrt(1.0 + (residual / (2.0 * scale * sigma)) ** 2)
        solution = _weighted(shift, width, design, used)[0]
    return solution


def _spread(residual: FloatArray, sigma: FloatArray) -> float:
    """Return the width of the residuals' core beyond the noise, from their median."""
    core = NORMAL_MAD * float(np.median(np.abs(residual)))
    return float(np.sqrt(max(core**2 - float(np.median(sigma)) ** 2, 0.0)))


def _roughness(residual: FloatArray, sigma: FloatArray, columns: int) -> float:
    """Return the standard deviation that must be added to the noise to explain the residuals; 0 where it need not."""
    freedom = len(residual) - columns

    def surplus(rough: float) -> float:
        return float(np.sum(residual**2 / (sigma**2 + rough**2)) - freedom)

    if freedom < 1 or surplus(0.0) + freedom <= chdtri(freedom, DOUBT):
        return 0.0
    return float(brentq(surplus, 0.0, np.sqrt(np.sum(residual**2) / freedom) + 1e-12, xtol=1e-6))


def _result(
    shift: FloatArray,
    sigma: FloatArray,
    design: FloatArray,
    used: BoolArray,
    rough: float,
    solution: FloatArray,
) -> LimbMotion:
    residual = shift - design @ solution
    _, gain = _weighted(shift, np.hypot(sigma, rough), design, used)
    height, length = 0.0, 0.0
    if rough > 0.0:
        height, length = _relief(residual, sigma, design, used, rough)
    noise = (gain * sigma[used] ** 2) @ gain.T
    topography = height**2 * _correlation(np.flatnonzero(used).astype(np.int64), len(used), length)
    n = len(solution)
    motion, covariance, noise_covariance = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    motion[:n] = solution
    noise_covariance[:n, :n] = symmetric(noise)
    covariance[:n, :n] = symmetric(noise + gain @ topography @ gain.T)
    freedom = max(int(np.count_nonzero(used)) - n, 1)
    misfit = float(np.sum((residual[used] / sigma[used]) ** 2)) / freedom
    return LimbMotion(motion, covariance, noise_covariance, residual, used, rough, length, misfit)


def _relief(
    residual: FloatArray, sigma: FloatArray, design: FloatArray, used: BoolArray, rough: float
) -> tuple[float, float]:
    """Return standard deviation and length (pieces) of a limb's relief: those of the largest restricted likelihood.

    The residuals alone would tell too little of both: what relief has in common with a motion of the body is gone
    from them. Restricted likelihood: Patterson & Thompson (1971), doi:10.1093/biomet/58.3.545.
    """
    index = np.flatnonzero(used).astype(np.int64)
    data, columns, variance = residual[used], design[used], sigma[used] ** 2
    longest = LONGEST_SHARE * len(used)

    def unlikely(logs: FloatArray) -> float:
        deviation, length = np.exp(logs)
        spread = np.diag(variance) + deviation**2 * _correlation(index, len(used), min(length, longest))
        factor = np.linalg.cholesky(spread)
        white = np.linalg.solve(factor, np.column_stack([columns, data]))
        basis, triangle = np.linalg.qr(white[:, :-1])
        left = white[:, -1] - basis @ (basis.T @ white[:, -1])
        pivots = np.log(np.diag(factor)).sum() + np.log(np.abs(np.diag(triangle))).sum()
        # Very short relief is noise: nothing tells its length, which shall not wander off.
        return float(pivots + 0.5 * left @ left + SHORTEST_PULL * min(logs[1] - np.log(SHORTEST), 0.0) ** 2)

    start = np.log([rough, FIRST_LENGTH])
    found = minimize(
        unlikely, start, method="Nelder-Mead", options={"maxfev": MOST_TRIALS, "xatol": 0.05, "fatol": 0.05}
    )
    deviation, length = np.exp(found.x)
    return float(deviation), float(min(length, longest))


def _correlation(index: IntArray, n: int, length: float) -> FloatArray:
    """Return correlations between pieces of a closed limb that fall off exponentially."""
    apart = np.abs(index[:, None] - index[None, :])
    apart = np.minimum(apart, n - apart)
    if length <= 0.0:
        return np.asarray((apart == 0).astype(float))
    return np.asarray(np.exp(-apart / length))
