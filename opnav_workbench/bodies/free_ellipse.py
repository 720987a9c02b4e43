"""An ellipse of any center, size and orientation through limb points: the check of a body's radii.

It is ``|S^-1 (x - c)| = 1`` with a symmetric matrix S, whose eigenvalues are the semi-axes: no parameter loses its meaning
where the ellipse is a circle. What is minimised is the distance of the points to first order,
``(|y| - 1) |y| / |S^-1 y|`` with ``y = S^-1 (x - c)`` (Sampson 1982, doi:10.1016/0146-664X(82)90101-0). Our own, since
scikit-image's `EllipseModel` takes no weights, gives no covariance, and is undefined toward the circle.
"""

import numpy as np
from scipy import linalg
from scipy.optimize import least_squares

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.results import FreeEllipse
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import Ellipse

__all__ = ["compare_ellipses", "pinhole_px"]

ELLIPSE_PARAMETERS = 5
LEAST_ELLIPSE_POINTS = 8
# With a shorter arc the free ellipse says nothing of the far side.
LEAST_ARC_RAD = np.radians(150.0)
MODEL_POINTS = 64
MOST_ELLIPSE_TRIALS = 50


def compare_ellipses(
    points_px: FloatArray, covariance_px2: FloatArray, outline_px: FloatArray, arc_rad: float
) -> FreeEllipse | None:
    """Fit an ellipse to limb points and compare its radii with the model's.

    Parameters
    ----------
    points_px : (n, 2) array
        Limb points, distortion removed (`pinhole_px`).
    covariance_px2 : (n, n) array
        Of their errors across the limb, with what neighbours share.
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
    model, _ = _fitted_ellipse(sparse, np.eye(len(sparse)), _mean_circle(sparse))
    free, covariance = _fitted_ellipse(points_px, covariance_px2, model)
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
    points: FloatArray, covariance: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return parameters (5,) and their covariance (5, 5)."""
    root = linalg.cholesky(covariance, lower=True)

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(linalg.solve_triangular(root, _sampson_distance(parameters, points), lower=True))

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
