"""Camera calibration: optics and mounting angles shared by many star pictures, each with its own attitude.

Flow   centers of identified stars on many pictures -> here -> a camera with other values, and their covariance
Units  px, mm, rad; see `opnav_workbench.calibration.parameters` for the names

Gauss-Newton with the linear problem of `opnav_workbench.calibration.bundle_adjustment`; outliers are rejected, and the
scatter beyond the given covariances becomes one centering error for all stars. `CameraCalibration` holds what comes out,
also which combinations of parameters these pictures do not determine.

References
----------
Owen, "Methods of optical navigation", AAS 11-215 (2011), section on camera calibration; Owen and O'Connell, JPL
IOM 343L-11-002 (2011): focal length and distortion of LORRI from star fields with every picture's pointing solved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.calibration.bundle_adjustment import (
    MIN_STARS,
    ArrowheadSolution,
    StarPictures,
    linearize,
    residuals,
    solve_arrowhead,
)
from opnav_workbench.calibration.parameters import CameraParameters
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.robust import moment_excess

__all__ = ["CameraCalibration", "calibrate_camera"]


# ---- What calibrations hold; arrays are read-only.

STRONG_CORRELATION = (
    0.9  # a correlation above this is worth naming: one parameter is hardly known without the other
)
NAMED_PART = 0.2  # of an open direction, for a parameter to be named


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A calibrated camera and how far it can be trusted.

    Attributes
    ----------
    camera
        With the solved values; mounting angles turn its ``focal_from_camera``.
    names
        The q parameters; values in the unit of their name.
    initial, values : (q,) arrays
        Before and after; mounting angles start from 0.
    sigmas : (q,) array
        1 sigma; infinite where a parameter belongs to a combination that is not determined.
    covariance : (q, q) array
        Determined combinations only.
    open_directions : (k, q) array
        Combinations that are not determined: unit vectors in units of one pixel's effect of each parameter.
    attitudes : (m, 3, 3) array
        camera_from_j2000 of the pictures, for directions in the picture of the uncalibrated camera.
    used : (n,) array of bool
        Stars that were not rejected as outliers.
    residual_before_px, residual_after_px : (n, 2) arrays
        Observed minus computed, every picture's attitude fitted, with the old and with the new camera.
    excess_sigma_px
        Centering error beyond the given covariances that the remaining scatter asks for.
    chi2_reduced
        Per degree of freedom, with the given covariances.
    messages
        What is not determined, and what else the analyst should know.
    """

    camera: Camera
    names: tuple[str, ...]
    initial: FloatArray
    values: FloatArray
    sigmas: FloatArray
    covariance: FloatArray
    open_directions: FloatArray
    attitudes: FloatArray
    used: BoolArray
    residual_before_px: FloatArray
    residual_after_px: FloatArray
    excess_sigma_px: float
    chi2_reduced: float
    iterations: int
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def rms_before_px(self) -> float:
        """Root mean square of the residuals of the used stars, per coordinate, with the old camera."""
        return float(np.sqrt(np.mean(self.residual_before_px[self.used] ** 2)))

    @property
    def rms_after_px(self) -> float:
        """The same with the new camera."""
        return float(np.sqrt(np.mean(self.residual_after_px[self.used] ** 2)))

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (q, q) of the parameters; nan for those that are not determined."""
        sigma = np.where(np.isfinite(self.sigmas) & (self.sigmas > 0.0), self.sigmas, np.nan)
        return np.asarray(self.covariance / np.outer(sigma, sigma))

    @property
    def strong_correlations(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters that are hardly known one without the other, the strongest first."""
        matrix = self.correlation
        pairs = [
            (self.names[i], self.names[j], float(matrix[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(matrix[i, j]) > STRONG_CORRELATION
        ]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))


def undetermined_message(direction: FloatArray, names: tuple[str, ...]) -> str:
    """Say which parameters a direction that is not determined binds together."""
    order = np.argsort(-np.abs(direction))
    parts = [f"{direction[i]:+.2f} {names[i]}" for i in order if abs(direction[i]) > NAMED_PART]
    if len(parts) == 1:
        return (
            f"{names[order[0]]} is not determined by these frames (their own attitudes take up what it does): it keeps "
            "its value; leave it out, or give frames that tell it"
        )
    return (
        f"the combination {' '.join(parts)} (each in units of one pixel's effect) is not determined by these frames: "
        "its value stays; leave one of these parameters out, or give frames that tell them apart"
    )


# ---- Camera calibration: optics and mounting angles shared by many star pictures, each with its own attitude.

CONVERGED_PX = (
    1e-4  # no star moves more in the last step: a hundredth of what the best mean over a field is worth
)
MAX_ITERATIONS = 30
MAX_HALVINGS = 8  # of a step that would fold the distortion over
REJECT_SIGMA = 4.0  # of both coordinates together: one good star in 3000 is lost
MAX_PASSES = 6
EXCESS_TOLERANCE_PX = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    values: FloatArray  # optical
    mounting_rad: FloatArray  # (3,) about the focal axes
    attitudes: FloatArray


def calibrate_camera(
    stars: StarPictures,
    camera: Camera,
    names: Sequence[str],
    *,
    a_priori_covariance_rad2: ArrayLike | None = None,
) -> CameraCalibration:
    """Solve for parameters of a camera that many star pictures share.

    Parameters
    ----------
    camera
        The starting values, and everything that is not solved.
    names
        Parameters to solve for (see `opnav_workbench.calibration.parameters`); none fits the attitudes only.
    a_priori_covariance_rad2 : (3, 3) array_like, optional
        Covariance of each picture's a priori attitude, without what all have in common (rotation vector about the camera
        picture's axes); by default the camera's ``attitude_sigma``. It counts only with mounting angles.

    Raises
    ------
    CameraError
        Unknown parameters, fewer measurements than unknowns, pictures of less than two stars, or no convergence.
    """
    parameters = CameraParameters(camera, tuple(names))
    _check_counts(stars, parameters)
    prior = _prior(camera, a_priori_covariance_rad2)
    used: BoolArray = np.ones(len(stars), dtype=bool)
    excess = 0.0
    state = _State(parameters.values(), np.zeros(3), np.array(stars.attitudes))
    steps = 0
    for _ in range(MAX_PASSES):
        state, _, count = _iterate(stars, parameters, state, excess, prior, used)
        steps += count
        residual = residuals(stars, parameters.camera_with(state.values), state.attitudes)
        excess = _excess(stars, residual, used, parameters)
        before, used = used, _accepted(stars, residual, excess)
        _check_counts(stars, parameters, used)
        if np.array_equal(before, used):
            break
    state, last, count = _iterate(stars, parameters, state, excess, prior, used)
    return _result(stars, parameters, state, last, excess, used, steps + count)


def _check_counts(stars: StarPictures, parameters: CameraParameters, used: BoolArray | None = None) -> None:
    picture = stars.picture_index if used is None else stars.picture_index[used]
    count = np.bincount(picture, minlength=stars.n_pictures)
    poor = [name for name, n in zip(stars.names, count, strict=True) if n < MIN_STARS]
    if poor or not len(count):
        raise CameraError(
            f"{len(poor)} of {len(count)} frames have fewer than {MIN_STARS} usable stars ({', '.join(poor[:3])}); "
            "leave them out, or search fainter stars."
        )
    measured, unknown = 2 * len(picture), 3 * stars.n_pictures + len(parameters.optical)
    if measured <= unknown:
        raise CameraError(
            f"{len(picture)} stars give {measured} measurements for {unknown} unknowns; solve for fewer parameters "
            "or give more frames."
        )


def _prior(camera: Camera, covariance_rad2: ArrayLike | None) -> FloatArray:
    if covariance_rad2 is None:
        return camera.a_priori_covariance_rad2
    covariance = np.asarray(covariance_rad2, dtype=np.float64)
    if covariance.shape != (3, 3) or not np.linalg.eigvalsh(covariance)[0] > 0.0:
        raise CameraError("a_priori_covariance_rad2 must be a positive definite (3, 3) matrix, rad^2.")
    return covariance


def _iterate(
    stars: StarPictures,
    parameters: CameraParameters,
    state: _State,
    excess: float,
    prior: FloatArray,
    used: BoolArray,
) -> tuple[_State, ArrowheadSolution, int]:
    covariance = stars.covariance_px2 + excess**2 * np.eye(2)
    mounting = prior if parameters.mounting else None
    for count in range(1, MAX_ITERATIONS + 1):
        design = linearize(
            stars,
            parameters,
            state.values,
            state.attitudes,
            state.mounting_rad,
            covariance,
            mounting,
            used,
        )
        if not np.isfinite(design.residual).all():
            break
        step = solve_arrowhead(design)
        before, state = state, _take_step(stars, parameters, state, step)
        if _largest_motion(stars, parameters, before, state) < CONVERGED_PX:
            return state, step, count
    raise CameraError(
        f"the calibration of {parameters.camera.name} does not converge in {MAX_ITERATIONS} iterations; "
        "solve for fewer parameters, or start from a camera nearer the truth."
    )


def _take_step(
    stars: StarPictures, parameters: CameraParameters, state: _State, step: ArrowheadSolution
) -> _State:
    """Take the step, or half of it, or a quarter, until it is a camera that sees all stars."""
    p = len(parameters.optical)
    turn = np.zeros(3)
    turn[list(parameters.mounting)] = step.shared[p:]
    for halving in range(MAX_HALVINGS):
        part = 0.5**halving
        values = state.values + part * step.shared[:p]
        attitudes = rotation_from_vector(part * step.angles) @ state.attitudes
        try:
            seen = residuals(stars, parameters.camera_with(values), attitudes)
        except CameraError:
            continue
        if np.isfinite(seen).all():
            return _State(values, state.mounting_rad + part * turn, attitudes)
    raise CameraError(
        f"no step of the calibration of {parameters.camera.name} gives a camera that sees its stars; "
        "solve for fewer distortion terms."
    )


def _largest_motion(
    stars: StarPictures, parameters: CameraParameters, before: _State, after: _State
) -> float:
    """Largest motion of a star, and of the mounting, px."""
    places = [residuals(stars, parameters.camera_with(s.values), s.attitudes) for s in (before, after)]
    mounting = np.abs(after.mounting_rad - before.mounting_rad).max() / parameters.camera.pixel_scale_rad
    return float(max(np.abs(places[1] - places[0]).max(), mounting))


def _squared_sigmas(stars: StarPictures, residual: FloatArray, excess: float) -> FloatArray:
    inverse = np.linalg.inv(stars.covariance_px2 + excess**2 * np.eye(2))
    return np.asarray(np.einsum("ni,nij,nj->n", residual, inverse, residual))


def _freedom(stars: StarPictures, parameters: CameraParameters, used: BoolArray) -> int:
    return int(2 * used.sum()) - 3 * stars.n_pictures - len(parameters.optical)


def _excess(
    stars: StarPictures, residual: FloatArray, used: BoolArray, parameters: CameraParameters
) -> float:
    """Excess sigma that makes chi-squared its expectation; the many stars of a calibration tell it well."""
    freedom = _freedom(stars, parameters, used)

    def surplus(sigma_px: float) -> float:
        return float(_squared_sigmas(stars, residual, sigma_px)[used].sum()) - freedom

    return moment_excess(surplus, EXCESS_TOLERANCE_PX)


def _accepted(stars: StarPictures, residual: FloatArray, excess: float) -> BoolArray:
    return np.asarray(_squared_sigmas(stars, residual, excess) <= REJECT_SIGMA**2)


def _result(
    stars: StarPictures,
    parameters: CameraParameters,
    state: _State,
    last: ArrowheadSolution,
    excess: float,
    used: BoolArray,
    steps: int,
) -> CameraCalibration:
    camera = parameters.camera_with(state.values)
    after = residuals(stars, camera, state.attitudes)
    turn = state.mounting_rad[list(parameters.mounting)]
    open_part = np.abs(last.open_directions).max(axis=0, initial=0.0)
    free = _freedom(stars, parameters, used)
    return CameraCalibration(
        camera=_mounted(camera, state.mounting_rad),
        names=parameters.ordered,
        initial=np.append(parameters.values(), np.zeros(len(turn))),
        values=np.append(state.values, turn),
        sigmas=np.where(open_part > NAMED_PART, np.inf, np.sqrt(np.diag(last.covariance))),
        covariance=last.covariance,
        open_directions=last.open_directions,
        attitudes=state.attitudes,
        used=used,
        residual_before_px=_residuals_before(stars, parameters, excess, used),
        residual_after_px=after,
        excess_sigma_px=excess,
        chi2_reduced=float(_squared_sigmas(stars, after, 0.0)[used].sum()) / free,
        iterations=steps,
        messages=_messages(parameters, last, used, excess),
    )


def _mounted(camera: Camera, mounting_rad: FloatArray) -> Camera:
    """The turn goes into the focal axes: the SPICE frame stays what its kernel says."""
    axes = camera.focal_from_camera
    return replace(camera, focal_from_camera=axes @ rotation_from_vector(mounting_rad @ axes))


def _residuals_before(
    stars: StarPictures, parameters: CameraParameters, excess: float, used: BoolArray
) -> FloatArray:
    """Residuals with the old camera, every picture's attitude fitted to the same stars."""
    nothing = CameraParameters(parameters.camera, ())
    start = _State(np.zeros(0), np.zeros(3), np.array(stars.attitudes))
    state, *_ = _iterate(stars, nothing, start, excess, np.eye(3), used)
    return residuals(stars, parameters.camera, state.attitudes)


def _messages(
    parameters: CameraParameters, last: ArrowheadSolution, used: BoolArray, excess: float
) -> tuple[str, ...]:
    messages = [undetermined_message(direction, parameters.ordered) for direction in last.open_directions]
    rejected = int(np.sum(~used))
    if rejected:
        messages.append(f"{rejected} of {len(used)} stars rejected as outliers")
    if excess > 0.0:
        messages.append(
            f"the stars scatter more than their covariances say: a centering error of {excess:.3f} px is added to each"
        )
    return tuple(messages)
