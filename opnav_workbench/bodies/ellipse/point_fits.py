"""What limb points say of a body: its motion from where it was rendered, and whether its radii are right.

`limb_motion`  Shifts of limb pieces (px) to the motion of the body, by robust weighted least squares with an honest
    covariance. A rough body's limb leaves its model by more than the noise, and neighbouring pieces together: topography
    is a stretch of correlated residuals, which do not average out like noise. Its variance is estimated where the
    residuals exceed the noise beyond doubt, its length from their correlation along the limb; both enter the covariance.
    Paule & Mandel (1982), doi:10.6028/jres.087.022, for the variance that decides on weights and outliers; restricted
    maximum likelihood for variance and length in the covariance

`compare_ellipses`  An ellipse of any center, size and orientation through the points, against the model's.
    It is ``|S^-1 (x - c)| = 1`` with a symmetric matrix S, whose eigenvalues are the semi-axes: no parameter loses its
    meaning where the ellipse is a circle. What is minimised is the distance of the points to first order,
    ``(|y| - 1) |y| / |S^-1 y|`` with ``y = S^-1 (x - c)`` (Sampson 1982, doi:10.1016/0146-664X(82)90101-0). Our own,
    since scikit-image's `EllipseModel` takes no weights, gives no covariance, and is undefined toward the circle.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.special import chdtri

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.bodies.results import FreeEllipse
from opnav_workbench.camera import Camera
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.geometry import Ellipse
from opnav_workbench.robust import moment_excess

__all__ = ["LimbMotion", "compare_ellipses", "limb_motion", "pinhole_px"]


# ---- From shifts of limb pieces to the motion of the body.

OUTLIER_SIGMAS = 4.0  # of noise and roughness together: 6e-5 of good points
ROUNDS = 12  # of leaving out and taking back
ROUGHNESS_TOLERANCE_PX = 1e-6
DOUBT = 0.01  # residuals larger than this share of mere noise would give count as roughness
FIRST_LENGTH = 2.0  # pieces, to start from
SHORTEST, SHORTEST_PULL = 0.2, 1.0
MOST_RELIEF_TRIALS = 80
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
    rough_px
        Standard deviation of the limb beyond noise.
    rough_length
        Pieces over which it is correlated (e-folding).
    chi2_reduced
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
        spread = _excess_scatter(residual[used], sigma_px[used])
        near = usable & (np.abs(residual) <= OUTLIER_SIGMAS * np.hypot(sigma_px, max(rough, spread)))
        if np.count_nonzero(near) <= columns:
            return None
        rough = _roughness(residual[near], sigma_px[near], columns)
        settled = bool(np.array_equal(near, used))
        used = near
        solution = _weighted(shift_px, np.hypot(sigma_px, rough), design, used)[0]
        if settled:
            break
    return _motion_with_covariance(shift_px, sigma_px, design, used, rough, solution)


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
        scale = max(MAD_TO_SIGMA * float(np.median(np.abs(residual[used] / sigma[used]))), 1.0)
        width = sigma * np.sqrt(1.0 + (residual / (2.0 * scale * sigma)) ** 2)
        solution = _weighted(shift, width, design, used)[0]
    return solution


def _excess_scatter(residual: FloatArray, sigma: FloatArray) -> float:
    """Return the width of the residuals' core beyond the noise, from their median."""
    core = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
    return float(np.sqrt(max(core**2 - float(np.median(sigma)) ** 2, 0.0)))


def _roughness(residual: FloatArray, sigma: FloatArray, columns: int) -> float:
    """Return the standard deviation that must be added to the noise to explain the residuals; 0 where it need not."""
    freedom = len(residual) - columns

    def surplus(rough: float) -> float:
        return float(np.sum(residual**2 / (sigma**2 + rough**2)) - freedom)

    if freedom < 1 or surplus(0.0) + freedom <= chdtri(freedom, DOUBT):
        return 0.0
    largest = float(np.sqrt(np.sum(residual**2) / freedom)) + 1e-12  # explains everything without any noise
    return moment_excess(surplus, ROUGHNESS_TOLERANCE_PX, largest)


def _motion_with_covariance(
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
    topography = height**2 * _relief_correlation(np.flatnonzero(used).astype(np.int64), len(used), length)
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
        spread = np.diag(variance) + deviation**2 * _relief_correlation(
            index, len(used), min(length, longest)
        )
        factor = np.linalg.cholesky(spread)
        white = np.linalg.solve(factor, np.column_stack([columns, data]))
        basis, triangle = np.linalg.qr(white[:, :-1])
        left = white[:, -1] - basis @ (basis.T @ white[:, -1])
        pivots = np.log(np.diag(factor)).sum() + np.log(np.abs(np.diag(triangle))).sum()
        # Very short relief is noise: nothing tells its length, which shall not wander off.
        return float(pivots + 0.5 * left @ left + SHORTEST_PULL * min(logs[1] - np.log(SHORTEST), 0.0) ** 2)

    start = np.log([rough, FIRST_LENGTH])
    found = minimize(
        unlikely,
        start,
        method="Nelder-Mead",
        options={"maxfev": MOST_RELIEF_TRIALS, "xatol": 0.05, "fatol": 0.05},
    )
    deviation, length = np.exp(found.x)
    return float(deviation), float(min(length, longest))


def _relief_correlation(index: IntArray, n: int, length: float) -> FloatArray:
    """Return correlations between pieces of a closed limb that fall off exponentially."""
    apart = np.abs(index[:, None] - index[None, :])
    apart = np.minimum(apart, n - apart)
    if length <= 0.0:
        return np.asarray((apart == 0).astype(float))
    return np.asarray(np.exp(-apart / length))


# ---- An ellipse of any center, size and orientation through points: the check of a body's radii.

ELLIPSE_PARAMETERS = 5
LEAST_ELLIPSE_POINTS = 8
# With a shorter arc the free ellipse says nothing of the far side.
LEAST_ARC_RAD = np.radians(150.0)
MODEL_POINTS = 64
MOST_ELLIPSE_TRIALS = 50


def compare_ellipses(
    points_px: FloatArray, sigma_px: FloatArray, outline_px: FloatArray, arc_rad: float
) -> FreeEllipse | None:
    """Fit an ellipse to limb points and compare its radii with the model's.

    Parameters
    ----------
    points_px : (n, 2) array
        Limb points, distortion removed (`pinhole_px`).
    sigma_px : (n,) array
        Their errors across the limb, roughness of the body included.
    outline_px : (m, 2) array
        The model's limb, distortion removed.
    arc_rad
        Angle that the points cover.

    Returns
    -------
    FreeEllipse or None
        None where the points are too few or cover too short an arc.
    """
    if len(points_px) < LEAST_ELLIPSE_POINTS or arc_rad < LEAST_ARC_RAD:
        return None
    sparse = outline_px[:: max(1, len(outline_px) // MODEL_POINTS)]
    model, _ = _fitted_ellipse(sparse, np.ones(len(sparse)), _mean_circle(sparse))
    free, covariance = _fitted_ellipse(points_px, sigma_px, model)
    # An arc may leave its far end open: no ellipse, or one of twice the size, is no check.
    if not np.all(np.linalg.eigvalsh(_ellipse_matrix(free)) > 0.0) or not np.isfinite(covariance).all():
        return None
    model_ellipse, axes = _ellipse(model)
    free_ellipse, _ = _ellipse(free)
    ratio = np.array([_radius(free, axis) / _radius(model, axis) for axis in axes])
    sigma = np.array([_radius_sigma(free, covariance, axis) / _radius(model, axis) for axis in axes])
    rms = float(np.sqrt(np.mean(_sampson_distance(free, points_px) ** 2)))
    return FreeEllipse(free_ellipse, model_ellipse, axes, ratio, sigma, rms)


def pinhole_px(camera: Camera, points_px: FloatArray) -> FloatArray:
    """Return where points (n, 2) px would lie without distortion: in a plane where an ellipsoid's limb is an ellipse."""
    focal = camera.unproject(points_px) @ camera.focal_from_camera.T
    ideal = camera.focal_length_mm * focal[:, :2] / focal[:, 2:]
    return np.asarray(camera.center_pixel_line + ideal @ camera.pixel_from_mm.T)


def _mean_circle(points: FloatArray) -> FloatArray:
    center = points.mean(axis=0)
    radius = float(np.hypot(*(points - center).T).mean())
    return np.array([*center, radius, 0.0, radius])


def _ellipse_matrix(parameters: FloatArray) -> FloatArray:
    return np.array([[parameters[2], parameters[3]], [parameters[3], parameters[4]]])


def _sampson_distance(parameters: FloatArray, points: FloatArray) -> FloatArray:
    inverse = np.linalg.inv(_ellipse_matrix(parameters))
    scaled = (points - parameters[:2]) @ inverse
    length = np.hypot(*scaled.T)
    return np.asarray((length - 1.0) * length / np.hypot(*(scaled @ inverse).T))


def _fitted_ellipse(
    points: FloatArray, sigma: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return parameters (5,) and their covariance (5, 5)."""

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(_sampson_distance(parameters, points) / sigma)

    solved = least_squares(
        misfit, start, x_scale=np.maximum(np.abs(start), 1.0), max_nfev=MOST_ELLIPSE_TRIALS
    )
    jacobian = np.asarray(solved.jac, dtype=np.float64)
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return np.asarray(solved.x), np.asarray(inverse)


def _ellipse(parameters: FloatArray) -> tuple[Ellipse, FloatArray]:
    """Return the ellipse and its axes (2, 2), rows major and minor."""
    lengths, axes = np.linalg.eigh(_ellipse_matrix(parameters))
    major = axes[:, 1] * (1.0 if axes[0, 1] > 0.0 or (axes[0, 1] == 0.0 and axes[1, 1] > 0.0) else -1.0)
    minor = np.array([-major[1], major[0]])
    angle = float(np.arctan2(major[1], major[0]))
    return Ellipse(parameters[:2].copy(), lengths[::-1].copy(), angle), np.stack([major, minor])


def _radius(parameters: FloatArray, axis: FloatArray) -> float:
    return float(1.0 / np.linalg.norm(np.linalg.solve(_ellipse_matrix(parameters), axis)))


def _radius_sigma(parameters: FloatArray, covariance: FloatArray, axis: FloatArray) -> float:
    step = 1e-4 * float(np.abs(parameters[2:]).max())
    slope = np.zeros(ELLIPSE_PARAMETERS)
    for k in range(2, ELLIPSE_PARAMETERS):
        moved = np.zeros(ELLIPSE_PARAMETERS)
        moved[k] = step
        slope[k] = (_radius(parameters + moved, axis) - _radius(parameters - moved, axis)) / (2.0 * step)
    return float(np.sqrt(slope @ covariance @ slope))
