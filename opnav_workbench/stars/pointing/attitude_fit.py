"""Iterated weighted least squares of an attitude; what is known of it beforehand enters as further measurements.

Flow   observed centers, star directions, an attitude to start from -> here -> attitude, residuals, covariance
Frame  directions J2000; rotation vectors about the camera frame's axes
Units  px, rad

Known beforehand may be
twist     the a priori rotation about the boresight: one measurement, which enters where, and only where, the stars
          alone determine that rotation less well: with one star always, with two when they are close together
attitude  all three angles with their covariance: three measurements, which always enter
"""

from dataclasses import dataclass, field, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import radec_from_unit, tangent_basis, vector_from_rotation
from opnav_workbench.stars.pointing.attitude_steps import StepModel

__all__ = [
    "AttitudeFit",
    "AttitudePrior",
    "LinearizedProblem",
    "PointingProblem",
    "catalog_turns",
    "fit_attitude",
    "with_common_errors",
    "with_excess_covariance",
]


# ---- What is known of the attitude beforehand, as measurements beside the stars.


@dataclass(frozen=True, slots=True, eq=False)
class AttitudePrior:
    """An a priori attitude and how well it is known.

    Attributes
    ----------
    attitude : (3, 3) array
        camera_from_j2000.
    axis : (3,) array
        Boresight, camera frame.
    twist_sigma_rad
        1 sigma of the rotation about it.
    covariance_rad2 : (3, 3) array or None
        Of the rotation vector about the camera frame's axes; None where only the twist counts.
    """

    attitude: FloatArray
    axis: FloatArray
    twist_sigma_rad: float
    covariance_rad2: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def rows(self, stars_twist_information: float) -> FloatArray:
        """Return what enters, (k, 3), in units of its sigmas: k is 3, 1 or 0.

        Parameters
        ----------
        stars_twist_information
            Inverse variance, rad^-2, with which the stars alone determine the twist.
        """
        if self.covariance_rad2 is not None:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance_rad2)))
        if self.decides_twist(stars_twist_information):
            return np.asarray(self.axis[None] / self.twist_sigma_rad)
        return np.zeros((0, 3))

    def decides_twist(self, stars_twist_information: float) -> bool:
        """Tell whether the stars alone determine the twist less well."""
        covariance = self.covariance_rad2
        variance = self.twist_sigma_rad**2 if covariance is None else self.axis @ covariance @ self.axis
        return bool(stars_twist_information * variance < 1.0)

    def residual(self, rows: FloatArray, attitude: FloatArray) -> FloatArray:
        """Return a priori minus `attitude`, (k,), in units of the sigmas of `rows`."""
        if len(rows) == 0:
            return np.zeros(0)
        return np.asarray(-rows @ vector_from_rotation(attitude @ self.attitude.T))


# ---- Iterated weighted least squares of an attitude.

CONVERGENCE_PX = (
    1e-5  # no star would move more in another step; a thousandth of what the best centers are worth
)
MAX_ITERATIONS = 30  # Euler angles need 3 or 4, a strongly distorted image plane 10


@dataclass(frozen=True, slots=True, eq=False)
class PointingProblem:
    """n stars that have an observed center, and what is known beforehand.

    Attributes
    ----------
    observed_px : (n, 2) array
    covariance_px2 : (n, 2, 2) array
        Of the observed center and of the catalog place together.
    directions : (n, 3) array
        Apparent unit vectors, J2000.
    prior
        The a priori attitude.
    start : (3, 3) array
        camera_from_j2000 to start from.
    """

    observed_px: FloatArray
    covariance_px2: FloatArray
    directions: FloatArray
    camera: Camera
    prior: AttitudePrior
    start: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.observed_px)


@dataclass(frozen=True, slots=True, eq=False)
class LinearizedProblem:
    """The problem linearized at an attitude: residual = jacobian @ eps + noise, and what was known beforehand."""

    residual_px: FloatArray  # (n, 2)
    jacobian: FloatArray  # (n, 2, 3) px/rad
    covariance_px2: FloatArray  # (n, 2, 2)
    prior_rows: FloatArray  # (k, 3) d/d(eps) in units of their sigmas; k = 0, 1 (twist) or 3 (attitude)
    prior_residual: FloatArray  # (k,) a priori minus current, in units of their sigmas
    _chi2: dict[float, float] = field(
        default_factory=dict, init=False, repr=False
    )  # asked for again and again

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: measurements minus three angles."""
        return self.residual_px.size + len(self.prior_rows) - 3

    def rows(
        self, excess_sigma_px: float, design: FloatArray | None = None, tangent: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return design (m, 3) and residuals (m,) in units of their sigmas.

        They are d/d(eps), or d/d(parameters) of a `design` (n, 2, 3) whose d(eps)/d(parameters) is `tangent`.
        """
        whiten = _whitening(self.covariance_px2, excess_sigma_px)
        stars = self.jacobian if design is None else design
        prior = self.prior_rows if tangent is None else self.prior_rows @ tangent
        matrix = np.vstack([(whiten @ stars).reshape(-1, 3), prior])
        residual = (whiten @ self.residual_px[..., None]).ravel()
        return matrix, np.append(residual, self.prior_residual)

    def chi2(self, excess_sigma_px: float) -> float:
        """Return the smallest weighted sum of squared residuals that any attitude nearby reaches."""
        if excess_sigma_px in self._chi2:
            return self._chi2[excess_sigma_px]
        matrix, residual = self.rows(excess_sigma_px)
        orthonormal, _ = np.linalg.qr(matrix)
        left = residual - orthonormal @ (orthonormal.T @ residual)
        return self._chi2.setdefault(excess_sigma_px, float(left @ left))


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeFit:
    """A converged attitude.

    Attributes
    ----------
    attitude : (3, 3) array
    path : tuple of (3, 3) arrays
        From the start to `attitude`.
    covariance_rad2, formal_covariance_rad2 : (3, 3) arrays
        With and without the excess.
    residual_px : (n, 2) array
        Of all stars, used or not.
    jacobian : (n, 2, 3) array
        d(pixel, line) / d(eps) of all stars.
    linear
        The used stars at `attitude`.
    twist_solved
        The stars alone determine the twist better than it was known beforehand.
    """

    attitude: FloatArray
    path: tuple[FloatArray, ...]
    covariance_rad2: FloatArray
    formal_covariance_rad2: FloatArray
    residual_px: FloatArray
    jacobian: FloatArray
    linear: LinearizedProblem
    twist_solved: bool

    def __post_init__(self) -> None:
        freeze_arrays(self)


def fit_attitude(
    stars: PointingProblem, model: StepModel, start: FloatArray, used: BoolArray, excess_sigma_px: float = 0.0
) -> AttitudeFit | None:
    """Fit an attitude to the `used` stars, from `start` on; None where the iteration does not converge.

    The covariance is that of the estimator, whether its design is the Jacobian (Euler angles: the inverse of
    the normal matrix) or an approximation of it (image plane): with design A, Jacobian J and weights W the
    solution has A^T W r = 0, so eps = (A^T W J)^-1 A^T W noise.
    """
    attitude = start
    path = [start]
    information = _twist_information(stars, start, used, excess_sigma_px)
    if information is None:
        return None
    prior = stars.prior.rows(information)
    for _ in range(MAX_ITERATIONS):
        linear, design = _linearize(stars, model, attitude, used, prior)
        if not np.all(np.isfinite(linear.residual_px)):
            return None
        matrix, residual = linear.rows(excess_sigma_px, design, model.tangent)
        step = _solve(matrix, residual)
        attitude = model.rotation(step) @ attitude
        path.append(attitude)
        if model.left_px(float(np.max(np.abs(design @ step)))) < CONVERGENCE_PX:
            solved = not stars.prior.decides_twist(information)
            return _finish(stars, model, path, used, prior, excess_sigma_px, solved)
    return None


def with_excess_covariance(fit: AttitudeFit, excess_sigma_px: float) -> AttitudeFit:
    """Return the same attitude, its covariance that of centers with an excess error the weights do not know of."""
    # Whitened centers have unit variance and, of the excess, that of the whitening itself.
    parts = _turns_of_centers(fit.linear, 0.0)
    added = excess_sigma_px**2 * np.sum(parts @ np.swapaxes(parts, 1, 2), axis=0)
    return replace(fit, covariance_rad2=symmetric(fit.covariance_rad2 + added))


def with_common_errors(fit: AttitudeFit, common_px: FloatArray, excess_sigma_px: float) -> AttitudeFit:
    """Return the same attitude, its covariance that of centers that share errors.

    Parameters
    ----------
    common_px : (n, 2, r) array
        What each of r independent one-sigma errors makes of the used stars' centers at once. As errors of each star for
        itself they are in the covariances already.
    excess_sigma_px
        With which the stars were weighted.
    """
    each = _turns_of_centers(fit.linear, excess_sigma_px) @ common_px  # (n, 3, r)
    shared = np.sum(each, axis=0)
    added = shared @ shared.T - np.sum(each @ np.swapaxes(each, 1, 2), axis=0)
    return replace(
        fit,
        covariance_rad2=symmetric(fit.covariance_rad2 + added),
        formal_covariance_rad2=symmetric(fit.formal_covariance_rad2 + added),
    )


def _turns_of_centers(linear: LinearizedProblem, excess_sigma_px: float) -> FloatArray:
    """d(eps)/d(center) of each star, (n, 3, 2) rad/px."""
    rows, _ = linear.rows(excess_sigma_px)
    gain = np.linalg.solve(rows.T @ rows, rows.T)[:, : linear.residual_px.size]
    whiten = _whitening(linear.covariance_px2, excess_sigma_px)
    return np.asarray(gain.reshape(3, -1, 2).transpose(1, 0, 2) @ whiten)


def catalog_turns(
    fit: AttitudeFit,
    center_covariance_px2: FloatArray,
    directions: FloatArray,
    excess_sigma_px: float,
) -> FloatArray:
    """Return how far one sigma of each star's catalog errors turns an attitude, (n, 3, 2) rad.

    The two unit errors of a star are along the axes of the symmetric root of its covariance toward east and north, so that
    they are the same ones in every picture, whatever its attitude.

    Parameters
    ----------
    center_covariance_px2 : (n, 2, 2) array
        Of the centers alone; what `fit` counts beyond it is the catalog's.
    directions : (n, 3) array
        J2000.
    """
    of_catalog = fit.linear.covariance_px2 - center_covariance_px2
    east, north = tangent_basis(*radec_from_unit(directions))
    axes = np.stack([east, north], axis=-1)  # (n, 3, 2)
    # A turn of v x d about the camera's axes moves v by d.
    moved = np.cross((directions @ fit.attitude.T)[:, None], np.swapaxes(fit.attitude @ axes, 1, 2))
    to_px = fit.linear.jacobian @ np.swapaxes(moved, 1, 2)  # (n, 2, 2) px/rad toward east, north
    to_sky = np.linalg.inv(to_px)
    values, vectors = np.linalg.eigh(symmetric(to_sky @ of_catalog @ np.swapaxes(to_sky, 1, 2)))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(_turns_of_centers(fit.linear, excess_sigma_px) @ to_px @ root)


def _finish(
    stars: PointingProblem,
    model: StepModel,
    path: list[FloatArray],
    used: BoolArray,
    prior: FloatArray,
    excess_sigma_px: float,
    twist_solved: bool,
) -> AttitudeFit:
    attitude = path[-1]
    linear, design = _linearize(stars, model, attitude, used, prior)
    if used.all():
        residual, jacobian = linear.residual_px, linear.jacobian
    else:
        in_camera, camera = stars.directions @ attitude.T, stars.camera.standing(attitude)
        residual = stars.observed_px - camera.project(in_camera)
        jacobian = camera.attitude_jacobian(in_camera)
    covariance, formal = (
        _covariance(linear.rows(excess, design, model.tangent)[0], linear.rows(excess)[0])
        for excess in (excess_sigma_px, 0.0)
    )
    return AttitudeFit(
        attitude=attitude,
        path=tuple(path),
        covariance_rad2=covariance,
        formal_covariance_rad2=formal,
        residual_px=residual,
        jacobian=jacobian,
        linear=linear,
        twist_solved=twist_solved,
    )


def _linearize(
    stars: PointingProblem, model: StepModel, attitude: FloatArray, used: BoolArray, prior: FloatArray
) -> tuple[LinearizedProblem, FloatArray]:
    in_camera, camera = stars.directions[used] @ attitude.T, stars.camera.standing(attitude)
    predicted = camera.project(in_camera)
    linear = LinearizedProblem(
        residual_px=stars.observed_px[used] - predicted,
        jacobian=camera.attitude_jacobian(in_camera),
        covariance_px2=stars.covariance_px2[used],
        prior_rows=prior,
        prior_residual=stars.prior.residual(prior, attitude),
    )
    return linear, model.design(linear.jacobian, predicted)


def _twist_information(
    stars: PointingProblem, attitude: FloatArray, used: BoolArray, excess: float
) -> float | None:
    """Inverse variance with which the stars alone determine the twist; None where one is out of sight."""
    in_camera, camera = stars.directions[used] @ attitude.T, stars.camera.standing(attitude)
    along_axes = camera.attitude_jacobian(in_camera) @ camera.focal_from_camera.T
    if not np.all(np.isfinite(along_axes)):
        return None
    rows = (_whitening(stars.covariance_px2[used], excess) @ along_axes).reshape(-1, 3)
    # What the stars say of the rotation about the boresight beyond what the other two angles absorb.
    absorbed, *_ = np.linalg.lstsq(rows[:, :2], rows[:, 2], rcond=None)
    left = rows[:, 2] - rows[:, :2] @ absorbed
    return float(left @ left)


def _whitening(covariance_px2: FloatArray, excess_sigma_px: float) -> FloatArray:
    """Matrices (n, 2, 2) that turn errors of these covariances into independent ones of unit variance."""
    # The inverse of the Cholesky factor, written out: for 2 x 2 ten times as fast.
    a, b = covariance_px2[:, 0, 0] + excess_sigma_px**2, covariance_px2[:, 0, 1]
    rest = np.sqrt(covariance_px2[:, 1, 1] + excess_sigma_px**2 - b**2 / a)
    whiten = np.zeros_like(covariance_px2)
    whiten[:, 0, 0], whiten[:, 1, 0], whiten[:, 1, 1] = 1.0 / np.sqrt(a), -b / (a * rest), 1.0 / rest
    return whiten


def _solve(matrix: FloatArray, residual: FloatArray) -> FloatArray:
    scale = _column_scale(matrix)
    solution, *_ = np.linalg.lstsq(matrix / scale, residual, rcond=None)
    return np.asarray(solution / scale)


def _covariance(design: FloatArray, jacobian: FloatArray) -> FloatArray:
    scaled = design / _column_scale(design)
    inverse = np.linalg.inv(scaled.T @ jacobian)
    return symmetric(inverse @ (scaled.T @ scaled) @ inverse.T)


def _column_scale(matrix: FloatArray) -> FloatArray:
    """Norms of the columns: parameters in px and in rad differ by orders of magnitude."""
    norm = np.linalg.norm(matrix, axis=0)
    return np.where(norm > 0.0, norm, 1.0)
