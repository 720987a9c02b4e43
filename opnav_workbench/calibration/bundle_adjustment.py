"""The bundle adjustment of star pictures, linearized: rows of stars and a priori attitudes, columns of camera and pictures.

    star of picture i       observed - project(camera, A_i d) = d(px)/d(camera) dc + d(px)/d(eps) eps_i + noise
    a priori attitude i   theta_i - M mu = noise_i,  theta_i the rotation vector from the a priori to the solved one

Every row touches the shared columns and those of one picture only, so the matrix is sparse and the normal matrix an
arrowhead: a small dense block, and 3 x 3 blocks along the diagonal. The pictures' angles are eliminated (Schur complement),
which leaves a small dense system for the shared parameters; directions in it that the rows leave open are not moved along.
`StarPictures` holds the measured stars of all pictures.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.calibration.parameters import CameraParameters
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import vector_from_rotation

__all__ = ["MIN_STARS", "ArrowheadSolution", "StarPictures", "linearize", "residuals", "solve_arrowhead"]


# ---- The stars of many pictures of one camera, as arrays.

MIN_STARS = 2  # of a picture: with fewer its own three angles are not determined


@dataclass(frozen=True, slots=True, eq=False)
class StarPictures:
    """Measured centers of n identified stars on m pictures; arrays are read-only.

    Attributes
    ----------
    names
        The pictures, m.
    picture_index : (n,) array of int
        Which picture a star is on.
    observed_px : (n, 2) array
        Measured centers (pixel, line).
    covariance_px2 : (n, 2, 2) array
        Of the center and of the catalog place together.
    directions : (n, 3) array
        Apparent directions, J2000.
    attitudes : (m, 3, 3) array
        Solved camera_from_j2000, to start from.
    a_priori : (m, 3, 3) array
        The same before any star was seen, from the kernels or the header.

    Raises
    ------
    CameraError
        Arrays that do not fit together, or values that are not finite.
    """

    names: tuple[str, ...]
    picture_index: IntArray
    observed_px: FloatArray
    covariance_px2: FloatArray
    directions: FloatArray
    attitudes: FloatArray
    a_priori: FloatArray

    def __post_init__(self) -> None:
        n, m = len(self.picture_index), len(self.names)
        shapes = {
            "observed_px": (n, 2),
            "covariance_px2": (n, 2, 2),
            "directions": (n, 3),
            "attitudes": (m, 3, 3),
            "a_priori": (m, 3, 3),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise CameraError(
                    f"star frames: {name} must be finite of shape {shape}, it is {array.shape}."
                )
        if n and not (self.picture_index.min() >= 0 and self.picture_index.max() < m):
            raise CameraError(f"star frames: frame numbers must be 0..{m - 1}.")
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.picture_index)

    @property
    def n_pictures(self) -> int:
        """Number of pictures."""
        return len(self.names)


# ---- The calibration problem linearized.

DIFFERENCE_STEP_PX = (
    1e-2  # of the difference quotients: far above rounding (1e-10 px), far below any curvature
)
TRIAL_PART = 1e-9  # of a parameter's value, for the first look at what it does
TRIAL_LEAST, TRIAL_MOST = 1e-12, 1e9
TRIAL_GROWTH = 100.0
VISIBLE_PX = 1e-7  # a motion that is no rounding


@dataclass(frozen=True, slots=True, eq=False)
class WeightedRows:
    """Rows in units of their sigmas.

    Attributes
    ----------
    matrix : sparse (r, q + 3 m)
        q shared parameters (optical, then mounting), then three angles a picture.
    residual : (r,) array
    effect_px : (q,) array
        Root mean square motion of the stars by a unit of each shared parameter, before anything absorbs it.
    """

    matrix: sparse.csr_matrix
    residual: FloatArray
    effect_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def residuals(stars: StarPictures, camera: Camera, attitudes: FloatArray) -> FloatArray:
    """Return observed minus computed (n, 2), px; nan out of the camera's sight."""
    return np.asarray(stars.observed_px - camera.project(_in_camera(stars, attitudes)))


def linearize(
    stars: StarPictures,
    parameters: CameraParameters,
    values: FloatArray,
    attitudes: FloatArray,
    mounting_rad: FloatArray,
    covariance_px2: FloatArray,
    a_priori_covariance_rad2: FloatArray | None,
    used: BoolArray,
) -> WeightedRows:
    """Return the rows of the `used` stars and, where mounting angles are solved, of the a priori attitudes.

    Parameters
    ----------
    values : (p,) array
        Optical parameters.
    mounting_rad : (3,) array
        Turn about the focal axes so far.
    covariance_px2 : (n, 2, 2) array
        Excess included.
    a_priori_covariance_rad2 : (3, 3) array or None
        Of each picture's a priori attitude, its own part.
    """
    camera = parameters.camera_with(values)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_px2[used]))
    in_camera = _in_camera(stars, attitudes)[used]
    shared = camera_jacobian(parameters, values, in_camera)
    rotation = camera.attitude_jacobian(in_camera)
    turn = _mounting_effect(parameters, rotation)
    residual = stars.observed_px[used] - camera.project(in_camera)
    blocks = [
        _star_rows(
            whiten @ shared, whiten @ rotation, stars.picture_index[used], stars.n_pictures, parameters
        )
    ]
    right = [(whiten @ residual[..., None]).ravel()]
    if parameters.mounting and a_priori_covariance_rad2 is not None:
        rows, left = _prior_rows(stars, parameters, attitudes, mounting_rad, a_priori_covariance_rad2)
        blocks.append(rows)
        right.append(left)
    effect = np.sqrt(np.mean(np.sum(np.concatenate([shared, turn], axis=2) ** 2, axis=1), axis=0))
    return WeightedRows(sparse.csr_matrix(sparse.vstack(blocks)), np.concatenate(right), effect)


def camera_jacobian(parameters: CameraParameters, values: FloatArray, in_camera: FloatArray) -> FloatArray:
    """Return d(pixel, line) / d(optical parameters), (n, 2, p), by central differences."""
    columns = np.zeros((len(in_camera), 2, len(values)))
    place = parameters.camera_near(values).project(in_camera)
    for j in range(len(values)):
        step = _difference_step(parameters, values, j, in_camera, place)
        if step == 0.0:  # no effect at all, such as that of a term in r on a star at the center
            continue
        plus, minus = (
            parameters.camera_near(_with_step(values, j, s)).project(in_camera) for s in (step, -step)
        )
        columns[:, :, j] = (plus - minus) / (2.0 * step)
    return columns


def _difference_step(
    parameters: CameraParameters, values: FloatArray, index: int, in_camera: FloatArray, place: FloatArray
) -> float:
    """Step that moves the stars from their `place` by `DIFFERENCE_STEP_PX`: terms are nearly linear, in units 1e10 apart."""
    step = max(TRIAL_LEAST, TRIAL_PART * abs(values[index]))
    while step < TRIAL_MOST:
        moved = np.abs(parameters.camera_near(_with_step(values, index, step)).project(in_camera) - place)
        largest = float(np.nanmax(moved, initial=0.0))
        if largest > VISIBLE_PX:
            return float(step * DIFFERENCE_STEP_PX / largest)
        step *= TRIAL_GROWTH
    return 0.0


def _with_step(values: FloatArray, index: int, step: float) -> FloatArray:
    stepped = values.copy()
    stepped[index] += step
    return stepped


def _in_camera(stars: StarPictures, attitudes: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", attitudes[stars.picture_index], stars.directions))


def _mounting_effect(parameters: CameraParameters, rotation: FloatArray) -> FloatArray:
    """Motion of the stars by the mounting angles that are solved, (n, 2, k)."""
    axes = parameters.camera.focal_from_camera[list(parameters.mounting)]
    return np.asarray(rotation @ axes.T)


def _star_rows(
    shared: FloatArray, rotation: FloatArray, picture: IntArray, n_pictures: int, parameters: CameraParameters
) -> sparse.csr_matrix:
    n, _, p = shared.shape
    q = len(parameters.names)
    values = np.concatenate([shared, rotation], axis=2)
    own = q + 3 * picture[:, None] + np.arange(3)
    columns = np.concatenate([np.broadcast_to(np.arange(p), (n, p)), own], axis=1)
    columns = np.repeat(columns[:, None], 2, axis=1)
    starts = np.arange(2 * n + 1) * (p + 3)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), starts), shape=(2 * n, q + 3 * n_pictures))


def _prior_rows(
    stars: StarPictures,
    parameters: CameraParameters,
    attitudes: FloatArray,
    mounting_rad: FloatArray,
    covariance_rad2: FloatArray,
) -> tuple[sparse.csr_matrix, FloatArray]:
    """Rows (3 m, q + 3 m): what is left of theta - M mu is the a priori attitude's own error."""
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_rad2))
    axes = parameters.camera.focal_from_camera
    theta = np.stack([vector_from_rotation(a @ b.T) for a, b in zip(attitudes, stars.a_priori, strict=True)])
    left = -(theta - mounting_rad @ axes) @ whiten.T
    m, p = stars.n_pictures, len(parameters.optical)
    shared = np.zeros((3, len(parameters.names)))
    shared[:, p:] = -whiten @ axes[list(parameters.mounting)].T
    pictures = sparse.kron(sparse.eye(m), whiten, format="csr")
    common = sparse.csr_matrix(np.tile(shared, (m, 1)))
    return sparse.csr_matrix(sparse.hstack([common, pictures])), left.ravel()


# ---- Least squares of an arrow: shared parameters, and three angles a picture that touch nothing else.

# A combination of parameters whose 1 sigma moves stars by more than this, before the pictures' angles take it up, is not
# determined: a camera of which a drawing exists is known better.
UNDETERMINED_PX = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class ArrowheadSolution:
    """One linear solution.

    Attributes
    ----------
    shared : (q,) array
        Step of the shared parameters, none along open directions.
    angles : (m, 3) array
        Steps of the pictures' attitudes.
    covariance : (q, q) array
        Of the shared parameters, open directions left out.
    open_directions : (k, q) array
        Combinations that are not determined: unit vectors, in units of one pixel's effect of each parameter.
    """

    shared: FloatArray
    angles: FloatArray
    covariance: FloatArray
    open_directions: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def solve_arrowhead(design: WeightedRows) -> ArrowheadSolution:
    """Solve the normal equations; see the module."""
    q = len(design.effect_px)
    normal = (design.matrix.T @ design.matrix).tocsc()
    right = design.matrix.T @ design.residual
    pictures = splu(normal[q:, q:])
    if q == 0:
        return _arrowhead_solution(np.zeros(0), pictures.solve(right), np.zeros((0, 0)), np.zeros((0, 0)))
    mixed = normal[q:, :q].toarray()
    eliminated = pictures.solve(mixed)
    reduced = symmetric(normal[:q, :q].toarray() - mixed.T @ eliminated)
    values, axes, scale = _spectrum(reduced, design.effect_px)
    known = values > UNDETERMINED_PX**-2
    kept = axes[:, known]
    covariance = scale[:, None] * ((kept / values[known]) @ kept.T) * scale
    shared = covariance @ (right[:q] - eliminated.T @ right[q:])
    angles = pictures.solve(right[q:] - mixed @ shared)
    return _arrowhead_solution(shared, angles, symmetric(covariance), axes[:, ~known].T)


def _spectrum(reduced: FloatArray, effect_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information of combinations (eigenvalues and vectors) in units of one pixel's effect, and that unit."""
    scale = np.divide(1.0, effect_px, out=np.zeros_like(effect_px), where=effect_px > 0.0)
    values, axes = np.linalg.eigh(scale[:, None] * reduced * scale)
    return values, axes, scale


def _arrowhead_solution(
    shared: FloatArray, angles: FloatArray, covariance: FloatArray, open_directions: FloatArray
) -> ArrowheadSolution:
    return ArrowheadSolution(shared, np.asarray(angles).reshape(-1, 3), covariance, open_directions)
