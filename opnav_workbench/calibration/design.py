"""The calibration problem linearized: rows of stars and of a priori attitudes, columns of camera and of frames.

    star of frame i       observed - project(camera, A_i d) = d(px)/d(camera) dc + d(px)/d(eps) eps_i + noise
    a priori attitude i   theta_i - M mu = noise_i,  theta_i the rotation vector from the a priori to the solved one

Every row touches the shared columns and those of one frame only, so the matrix is sparse and the normal matrix an
arrow: a small dense block, and 3 x 3 blocks along the diagonal.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.calibration.frames import StarFrames
from opnav_workbench.calibration.parameters import CameraParameters
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.pointing.models import attitude_jacobian

__all__ = ["Design", "linearize", "residuals"]

STEP_PX = 1e-2  # of the difference quotients: far above rounding (1e-10 px), far below any curvature
TRIAL_PART = 1e-9  # of a parameter's value, for the first look at what it does
TRIAL_LEAST, TRIAL_MOST = 1e-12, 1e9
TRIAL_GROWTH = 100.0
VISIBLE_PX = 1e-7  # a motion that is no rounding


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Rows in units of their sigmas.

    Attributes
    ----------
    matrix : sparse (r, q + 3 m)
        q shared parameters (optical, then mounting), then three angles a frame.
    residual : (r,) array
    effect_px : (q,) array
        Root mean square motion of the stars by a unit of each shared parameter, before anything absorbs it.
    """

    matrix: sparse.csr_matrix
    residual: FloatArray
    effect_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def residuals(stars: StarFrames, camera: Camera, attitudes: FloatArray) -> FloatArray:
    """Return observed minus computed (n, 2), px; nan out of the camera's sight."""
    return np.asarray(stars.observed_px - camera.project(_in_camera(stars, attitudes)))


def linearize(
    stars: StarFrames,
    parameters: CameraParameters,
    values: FloatArray,
    attitudes: FloatArray,
    mounting_rad: FloatArray,
    covariance_px2: FloatArray,
    a_priori_covariance_rad2: FloatArray | None,
    used: BoolArray,
) -> Design:
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
        Of each frame's a priori attitude, its own part.
    """
    camera = parameters.camera_with(values)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_px2[used]))
    in_camera = _in_camera(stars, attitudes)[used]
    shared = camera_jacobian(parameters, values, in_camera)
    rotation = attitude_jacobian(camera, in_camera)
    turn = _mounting_effect(parameters, rotation)
    residual = stars.observed_px[used] - camera.project(in_camera)
    blocks = [_star_rows(whiten @ shared, whiten @ rotation, stars.frame[used], stars.n_frames, parameters)]
    right = [(whiten @ residual[..., None]).ravel()]
    if parameters.mounting and a_priori_covariance_rad2 is not None:
        rows, left = _prior_rows(stars, parameters, attitudes, mounting_rad, a_priori_covariance_rad2)
        blocks.append(rows)
        right.append(left)
    effect = np.sqrt(np.mean(np.sum(np.concatenate([shared, turn], axis=2) ** 2, axis=1), axis=0))
    return Design(sparse.csr_matrix(sparse.vstack(blocks)), np.concatenate(right), effect)


def camera_jacobian(parameters: CameraParameters, values: FloatArray, in_camera: FloatArray) -> FloatArray:
    """Return d(pixel, line) / d(optical parameters), (n, 2, p), by central differences."""
    columns = np.zeros((len(in_camera), 2, len(values)))
    for j in range(len(values)):
        step = _step(parameters, values, j, in_camera)
        if step == 0.0:  # no effect at all, such as that of a term in r on a star at the center
            continue
        plus, minus = (
            parameters.camera_with(_stepped(values, j, s)).project(in_camera) for s in (step, -step)
        )
        columns[:, :, j] = (plus - minus) / (2.0 * step)
    return columns


def _step(parameters: CameraParameters, values: FloatArray, index: int, in_camera: FloatArray) -> float:
    """Step that moves the stars by `STEP_PX`; distortion terms are nearly linear, but their units differ by 1e10."""
    place = parameters.camera_with(values).project(in_camera)
    step = max(TRIAL_LEAST, TRIAL_PART * abs(values[index]))
    while step < TRIAL_MOST:
        moved = np.abs(parameters.camera_with(_stepped(values, index, step)).project(in_camera) - place)
        largest = float(np.nanmax(moved, initial=0.0))
        if largest > VISIBLE_PX:
            return float(step * STEP_PX / largest)
        step *= TRIAL_GROWTH
    return 0.0


def _stepped(values: FloatArray, index: int, step: float) -> FloatArray:
    stepped = values.copy()
    stepped[index] += step
    return stepped


def _in_camera(stars: StarFrames, attitudes: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", attitudes[stars.frame], stars.directions))


def _mounting_effect(parameters: CameraParameters, rotation: FloatArray) -> FloatArray:
    """Motion of the stars by the mounting angles that are solved, (n, 2, k)."""
    axes = parameters.camera.focal_from_camera[list(parameters.mounting)]
    return np.asarray(rotation @ axes.T)


def _star_rows(
    shared: FloatArray, rotation: FloatArray, frame: IntArray, n_frames: int, parameters: CameraParameters
) -> sparse.csr_matrix:
    n, _, p = shared.shape
    q = len(parameters.names)
    values = np.concatenate([shared, rotation], axis=2)
    own = q + 3 * frame[:, None] + np.arange(3)
    columns = np.concatenate([np.broadcast_to(np.arange(p), (n, p)), own], axis=1)
    columns = np.repeat(columns[:, None], 2, axis=1)
    starts = np.arange(2 * n + 1) * (p + 3)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), starts), shape=(2 * n, q + 3 * n_frames))


def _prior_rows(
    stars: StarFrames,
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
    m, p = stars.n_frames, len(parameters.optical)
    shared = np.zeros((3, len(parameters.names)))
    shared[:, p:] = -whiten @ axes[list(parameters.mounting)].T
    frames = sparse.kron(sparse.eye(m), whiten, format="csr")
    common = sparse.csr_matrix(np.tile(shared, (m, 1)))
    return sparse.csr_matrix(sparse.hstack([common, frames])), left.ravel()
