"""What a caller gives to `solve_pointing`, checked, and sorted into usable stars and reasons why not."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import checked_rotation, matrix_from_quaternion, quaternion_from_matrix
from opnav_workbench.pointing.fit import Sightings
from opnav_workbench.pointing.prior import Prior
from opnav_workbench.pointing.wahba import ClosedForm, wahba

__all__ = ["Given", "Start", "check_given"]

Start = Literal["a_priori"] | ClosedForm
STARTS = ("a_priori", *get_args(ClosedForm))

MAX_RECIPROCAL_CONDITION = 1e-12  # a covariance flatter than this has lost a direction to rounding


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """All n stars of the caller, used or not.

    Attributes
    ----------
    sightings : Sightings
        The usable ones.
    index : (m,) array of int
        Their rows.
    observed_px : (n, 2) array
    directions : (n, 3) array
    reasons : tuple of str
        Why a star is not usable, "" where it is; n entries.
    """

    sightings: Sightings
    index: np.ndarray
    observed_px: FloatArray
    directions: FloatArray
    reasons: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def check_given(
    observed_px: ArrayLike,
    covariance_px2: ArrayLike,
    catalog_covariance_px2: ArrayLike | None,
    directions: ArrayLike,
    usable: ArrayLike | None,
    camera: Camera,
    a_priori: ArrayLike,
    twist_sigma_rad: float | None,
    a_priori_covariance_rad2: ArrayLike | None,
    start: Start,
) -> Given:
    """Return the checked input.

    Raises
    ------
    PointingError
        An array of the wrong shape, an a priori attitude that is no rotation, a twist sigma that is not
        positive, an a priori covariance that is not positive definite, or an unknown start.
    """
    observed = _array("observed_px", observed_px, None, 2)
    n = len(observed)
    covariance = _array("covariance_px2", covariance_px2, n, 2, 2)
    if catalog_covariance_px2 is not None:
        covariance = covariance + _array("catalog_covariance_px2", catalog_covariance_px2, n, 2, 2)
    covariance = symmetric(covariance)
    sky = _array("directions", directions, n, 3)
    wanted: BoolArray = np.ones(n, dtype=bool) if usable is None else np.asarray(usable, dtype=bool)
    if wanted.shape != (n,):
        raise PointingError(f"usable has shape {wanted.shape}, expected ({n},): one entry per star")
    attitude = _attitude(a_priori)
    if start not in STARTS:
        raise PointingError(f"unknown start {start!r}; use one of {', '.join(STARTS)}")
    reasons = _reasons(wanted, observed, covariance, camera.project(sky @ attitude.T), start)
    index = np.array([i for i, reason in enumerate(reasons) if not reason], dtype=np.int64)
    prior = Prior(
        attitude,
        camera.boresight,
        _twist_sigma(twist_sigma_rad, camera),
        None if a_priori_covariance_rad2 is None else _attitude_covariance(a_priori_covariance_rad2),
    )
    begin = _start(start, observed[index], covariance[index], sky[index], camera, attitude)
    sightings = Sightings(observed[index], covariance[index], sky[index], camera, prior, begin)
    return Given(sightings, index, observed, sky, reasons)


def _start(
    start: Start,
    observed: FloatArray,
    covariance: FloatArray,
    sky: FloatArray,
    camera: Camera,
    a_priori: FloatArray,
) -> FloatArray:
    """Attitude (3, 3) to start from; stars that leave a closed form open take the a priori one."""
    in_camera = camera.unproject(observed)
    seen = np.isfinite(in_camera).all(axis=1)
    if start == "a_priori" or not seen.any():
        return a_priori
    weights = 2.0 / np.trace(covariance[seen], axis1=1, axis2=2)
    try:
        return wahba(in_camera[seen], sky[seen], weights, start)
    except PointingError:
        return a_priori


def _reasons(
    wanted: BoolArray, observed: FloatArray, covariance: FloatArray, predicted: FloatArray, start: Start
) -> tuple[str, ...]:
    finite: BoolArray = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], covariance, np.eye(2)))
    definite = eigenvalues[:, 0] > MAX_RECIPROCAL_CONDITION * np.abs(eigenvalues[:, 1])
    reasons = np.full(len(observed), "", dtype=object)
    # From the least to the most basic reason, which is the one that stays.
    if start == "a_priori":
        reasons[~np.isfinite(predicted).all(axis=1)] = "out of sight at the a priori attitude"
    reasons[~(finite & definite)] = "no usable covariance of its center"
    reasons[~np.isfinite(observed).all(axis=1)] = "no center"
    reasons[~wanted] = "not offered"
    return tuple(reasons.tolist())


def _array(name: str, values: ArrayLike, n: int | None, *rest: int) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.size == 0 and n in (None, 0):
        return np.zeros((0, *rest))
    if array.shape[1:] != rest or (n is not None and len(array) != n):
        expected = ", ".join(map(str, ("n" if n is None else n, *rest)))
        raise PointingError(f"{name} has shape {array.shape}, expected ({expected}): one row per star")
    return array


def _attitude(a_priori: ArrayLike) -> FloatArray:
    try:
        rotation = checked_rotation(a_priori, "a_priori_camera_from_j2000")
    except ValueError as error:
        raise PointingError(str(error)) from error
    # A matrix printed with few digits is orthonormal to 1e-7 only, which is already a tenth of a pixel.
    return matrix_from_quaternion(quaternion_from_matrix(rotation))


def _twist_sigma(twist_sigma_rad: float | None, camera: Camera) -> float:
    sigma = np.radians(camera.attitude_sigma.twist_deg) if twist_sigma_rad is None else twist_sigma_rad
    if not 0.0 < sigma < np.inf:
        raise PointingError(
            f"twist_sigma_rad is {sigma}; give a positive number (1 sigma of the a priori twist)"
        )
    return float(sigma)


def _attitude_covariance(covariance_rad2: ArrayLike) -> FloatArray:
    covariance = np.asarray(covariance_rad2, dtype=np.float64)
    if covariance.shape != (3, 3):
        raise PointingError(f"a_priori_covariance_rad2 has shape {covariance.shape}, expected (3, 3)")
    covariance = symmetric(covariance)
    if not (np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] > 0.0):
        raise PointingError(
            "a_priori_covariance_rad2 is not positive definite; give the covariance of the rotation vector about "
            "the camera frame's axes, rad^2"
        )
    return covariance
