"""What one picture says of a body beside its center: where its outline runs, and where its landmarks are.

An outline is five numbers with their covariance: center (pixel, line), logarithm of the size, and the change of its radius
as cos 2a and sin 2a, which is all that an ellipsoid's can tell.

Frame  J2000; (pixel, line) on the detector; angles from +pixel toward +line
Units  px, km, rad
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies import BodyCenter, BodyFlag, BodyPicture, Outline
from opnav_workbench.bodies.disk.centerfinder import METHOD, judged_disk
from opnav_workbench.bodies.disk.columns import Unknown
from opnav_workbench.bodies.disk.measurement import MeasuredDisk, measure_disk
from opnav_workbench.camera import Camera
from opnav_workbench.landmarks import LandmarkSolution
from opnav_workbench.targets import TargetState

__all__ = ["BodySighting", "LandmarkReading", "OutlineReading", "landmark_reading", "read_outline"]

OUTLINE = [Unknown.PIXEL, Unknown.LINE, Unknown.SIZE, Unknown.AXIS_COS, Unknown.AXIS_SIN]
SIZES = slice(2, 5)
# A size that is not the expected one is what is asked; a limb that is not the model's, or not confirmed, tells nothing.
UNUSABLE = (
    BodyFlag.POOR_FIT | BodyFlag.NOT_CONVERGED | BodyFlag.UNCONFIRMED | BodyFlag.EMPTY | BodyFlag.AT_LIMIT
    | BodyFlag.THIN_CRESCENT
)  # fmt: skip
LEAST_OWN = 0.05  # share of an outline's information that must be the picture's own, not the mission's


@dataclass(frozen=True, slots=True, eq=False)
class OutlineReading:
    """The outline of a body as a picture shows it.

    Attributes
    ----------
    outline
        As measured.
    covariance : (5, 5) array
        Of center (px), logarithm of the size, cos 2a and sin 2a; what was believed of the figure before is not in it.
    offset : (5,) array
        What the picture alone says beyond the outline, which what was believed holds back.
    lit : (n,) array
        Of the angles of the outline: 1 where the limb is lit, else 0.
    status
        Of the center that was read with it.
    """

    outline: Outline
    covariance: FloatArray
    offset: FloatArray
    lit: FloatArray
    status: str = "ok"

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkReading:
    """n landmarks as a picture shows them.

    Attributes
    ----------
    place_km, place_covariance_km2 : (n, 3), (n, 3, 3) arrays
        Body-fixed, as believed.
    observed_px, covariance_px2 : (n, 2), (n, 2, 2) arrays
    common_covariance_px2 : (2, 2) array
        Of an error that all of them share.
    """

    id: NDArray[np.str_]
    place_km: FloatArray
    place_covariance_km2: FloatArray
    observed_px: FloatArray
    covariance_px2: FloatArray
    common_covariance_px2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True, eq=False)
class BodySighting:
    """A picture of the body.

    Attributes
    ----------
    image, et
        Mid-exposure, TDB seconds past J2000.
    target
        Where the body is believed to have stood when the light left.
    camera_from_j2000, attitude_covariance_rad2 : (3, 3) arrays
        The picture's attitude, as its stars (or others) have it, and how well, about the camera frame's axes.
    velocity_km_s : (3,) array
        Of the spacecraft with respect to the solar-system barycenter.
    outline, landmarks
        What the picture shows; either may be missing.
    note
        Why one is missing.
    """

    image: str
    et: float
    target: TargetState
    camera: Camera
    camera_from_j2000: FloatArray
    attitude_covariance_rad2: FloatArray
    velocity_km_s: FloatArray
    outline: OutlineReading | None = None
    landmarks: LandmarkReading | None = None
    note: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


def read_outline(picture: BodyPicture, name: str) -> tuple[OutlineReading | None, str]:
    """Return the outline of a body, None where its limb cannot be read, and why or what is doubted.

    Raises
    ------
    CenterfindingError
        No such body in the picture.
    """
    disk = measure_disk(picture, name, METHOD, None, None)
    if isinstance(disk, BodyCenter):
        return None, f"{disk.status}: {'; '.join(disk.messages)}"
    center = judged_disk(disk, solve_range=False)
    if center.flags & UNUSABLE:
        return None, f"{center.status}: {'; '.join(center.messages)}"
    return _reading(disk, center), "" if center.status == "ok" else "; ".join(center.messages)


def landmark_reading(solution: LandmarkSolution) -> LandmarkReading | None:
    """Return the accepted landmarks of a picture; None where there are none."""
    rows, centers = np.flatnonzero(solution.accepted), solution.centers
    if len(rows) == 0:
        return None
    return LandmarkReading(
        centers.id[rows],
        centers.place_km[rows],
        centers.place_covariance_km2[rows],
        centers.observed_px[rows],
        solution.covariance_px2[rows],
        centers.common_covariance_px2,
    )


def _reading(disk: MeasuredDisk, center: BodyCenter) -> OutlineReading:
    fit, figure = disk.fit, disk.fit.figure
    stated = fit.solution.covariance[np.ix_(OUTLINE, OUTLINE)]
    known = np.array([0.0, 0.0, figure.size_sigma**-2.0, figure.axes_sigma**-2.0, figure.axes_sigma**-2.0])
    own = _without_prior(symmetric(stated), known)
    value = np.array([0.0, 0.0, fit.shape.log_size, *fit.shape.strain[:2]])
    offset = own @ (known * value)
    # What the judgement adds to the center: that the size hides behind a rim, and that two readings differ.
    added = np.zeros((5, 5))
    with_size = stated[:, 2] / stated[2, 2]
    rim = max(float(np.trace(fit.covariance_px2 - stated[:2, :2])), 0.0)
    length = float(with_size[:2] @ with_size[:2])
    if length > 0.0:
        added += rim / length * np.outer(with_size, with_size)
    judged = np.asarray(center.covariance_px2) - fit.covariance_px2
    added[:2, :2] += _positive(judged)
    return OutlineReading(
        fit.smooth_outline, symmetric(own + added), offset, _lit(disk), status=str(center.status)
    )


def _without_prior(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Return a covariance (5, 5) as it is without independent information (5,) that went into it."""
    factor = np.linalg.cholesky(covariance)
    left = np.eye(len(information)) - (factor.T * information) @ factor
    value, axes = np.linalg.eigh(symmetric(left))
    inverse = (axes / np.maximum(value, LEAST_OWN)) @ axes.T
    return symmetric(factor @ inverse @ factor.T)


def _positive(matrix: FloatArray) -> FloatArray:
    value, axes = np.linalg.eigh(symmetric(matrix))
    return np.asarray((axes * np.maximum(value, 0.0)) @ axes.T)


def _lit(disk: MeasuredDisk) -> FloatArray:
    """Return where along the outline the limb is lit and on the detector."""
    system = disk.fit.system
    light = system.shared[Unknown.BRIGHTNESS].max(axis=1)
    seen = np.isfinite(system.variance).sum(axis=1) > 0.5 * system.variance.shape[1]
    pieces = (light > 0.1 * float(light.max())) & seen
    angle = np.mod(disk.fit.smooth_outline.angle_rad, 2.0 * np.pi)
    piece = np.minimum((angle * len(pieces) / (2.0 * np.pi)).astype(int), len(pieces) - 1)
    return np.asarray(pieces[piece], dtype=np.float64)
