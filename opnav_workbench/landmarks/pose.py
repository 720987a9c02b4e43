"""The camera's position and attitude from landmarks, alone or with the attitude that stars gave.

Flow   centers -> consensus among triples -> robust Gauss-Newton on the whole camera model -> excess scatter -> covariance

Solved are a shift of the spacecraft and a small rotation of the camera. What is known of both beforehand enters with its
covariance; without any, landmarks alone must tell all six. Small shifts and rotations of a narrow camera look alike:
what the landmarks cannot separate shows in the covariance.

Frame  shift J2000, rotation about the camera frame's axes
Units  km, rad, px
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import rotation_from_vector, vector_from_rotation
from opnav_workbench.landmarks.prediction import body_axes, landmark_partials, landmark_places
from opnav_workbench.landmarks.results import PoseSolution
from opnav_workbench.robust import moment_excess
from opnav_workbench.targets import TargetState

__all__ = [
    "PoseKnowledge",
    "PosedLandmarks",
    "camera_position_from_landmarks",
    "consensus",
    "pose_from_landmarks",
]

LEAST_LANDMARKS = 4  # one more than three, so that there is a residual
TRIPLES = 400  # of landmarks: with 60 % false ones, one in 16 triples is sound
AGREE_SIGMAS = 4.0  # of a landmark with the sound ones
LOOSE_PX = (
    0.5  # by which templates drawn at the wrong place, or the linear model, may be off in the consensus
)
TUKEY_SIGMAS = 4.685  # 95 % efficient on normal errors (Holland & Welsch 1977)
MOST_STEPS = 20
STEP_TOLERANCE = 1e-4  # of a pixel, in all landmarks
EXCESS_TOLERANCE_PX = 1e-4
SINGULAR = 1e-13  # of scaled normal equations: beyond, rounding solves them
SEED = 60213


@dataclass(frozen=True, slots=True, eq=False)
class PoseKnowledge:
    """What is known of the pose beside the landmarks; None: nothing.

    Attributes
    ----------
    position_covariance_km2 : (3, 3) array or None
        Of the spacecraft relative to the body, J2000.
    attitude_covariance_rad2 : (3, 3) array or None
        Of the small rotation vector about the camera frame's axes, as that of a pointing solved from stars.
    """

    position_covariance_km2: FloatArray | None = None
    attitude_covariance_rad2: FloatArray | None = None

    def information(self) -> FloatArray:
        """Return the information matrix (6, 6).

        Raises
        ------
        EstimationError
            A covariance that is none.
        """
        out = np.zeros((6, 6))
        for part, value in (
            (slice(0, 3), self.position_covariance_km2),
            (slice(3, 6), self.attitude_covariance_rad2),
        ):
            if value is None:
                continue
            covariance = np.asarray(value, dtype=np.float64)
            if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
                raise EstimationError(
                    "an a priori covariance of a pose needs shape (3, 3) and finite values."
                )
            scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            try:
                np.linalg.cholesky(covariance / np.outer(scale, scale))
            except np.linalg.LinAlgError as error:
                raise EstimationError("an a priori covariance of a pose is not positive definite.") from error
            out[part, part] = np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class PosedLandmarks:
    """Measured places of known points of a body, and the camera and body as they are believed to be.

    Attributes
    ----------
    place_km, place_covariance_km2 : (n, 3), (n, 3, 3) arrays
        Body-fixed.
    observed_px, covariance_px2 : (n, 2), (n, 2, 2) arrays
    common_covariance_px2 : (2, 2) array
        Error that all share.
    window_px
        Side of the patches that were measured: patches that overlap have errors in common, by the share of their area.
    """

    place_km: FloatArray
    place_covariance_km2: FloatArray
    observed_px: FloatArray
    covariance_px2: FloatArray
    target: TargetState
    camera: Camera
    camera_from_j2000: FloatArray
    velocity_km_s: FloatArray
    common_covariance_px2: FloatArray
    window_px: float = 0.0

    def moved(self, step: FloatArray) -> "PosedLandmarks":
        """Return the same with the spacecraft shifted and the camera turned by (6,)."""
        target = replace(self.target, position_km=self.target.position_km - step[:3])
        return replace(
            self, target=target, camera_from_j2000=rotation_from_vector(step[3:]) @ self.camera_from_j2000
        )

    def residual_px(self) -> FloatArray:
        """Observed minus predicted (n, 2)."""
        places = landmark_places(
            self.place_km, self.target, self.camera, self.camera_from_j2000, self.velocity_km_s
        )
        return np.asarray(self.observed_px - places)

    def design(self) -> tuple[FloatArray, FloatArray]:
        """Return partials (n, 2, 6) with shift and rotation, and covariances (n, 2, 2) with the places' share."""
        partials = landmark_partials(
            self.place_km, self.target, self.camera, self.camera_from_j2000, self.velocity_km_s
        )
        by_place = partials.place_px_per_km
        by_places = by_place @ self.place_covariance_km2 @ np.swapaxes(by_place, 1, 2)
        return (
            np.concatenate([partials.spacecraft_px_per_km, partials.attitude_px_per_rad], axis=2),
            self.covariance_px2 + by_places,
        )


def consensus(landmarks: PosedLandmarks, known: PoseKnowledge, usable: BoolArray) -> BoolArray:
    """Return which of the usable landmarks (n,) agree with one pose, the one with which most do.

    Poses are made of triples, and of all landmarks together; each counts how many agree with it.
    """
    rows = np.flatnonzero(usable)
    out = np.zeros(len(usable), dtype=bool)
    if len(rows) < LEAST_LANDMARKS:
        return out
    residual = landmarks.residual_px()[rows]
    partials, covariance = (values[rows] for values in landmarks.design())
    weight = np.linalg.inv(covariance + LOOSE_PX**2 * np.eye(2))
    random = np.random.default_rng(SEED)
    triples = np.array([random.choice(len(rows), size=3, replace=False) for _ in range(TRIPLES)])
    by_weight = np.swapaxes(partials, 1, 2) @ weight
    normal, right = by_weight @ partials, (by_weight @ residual[:, :, None])[..., 0]
    whole = known.information()
    matrices = np.concatenate([normal[triples].sum(axis=1), normal.sum(axis=0)[None]]) + whole
    sides = np.concatenate([right[triples].sum(axis=1), right.sum(axis=0)[None]])
    scale = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300))
    scaled = matrices / (scale[:, :, None] * scale[:, None, :])
    # A ridge of rounding's size: three points that stand in line leave one direction open.
    steps = np.linalg.solve(scaled + 1e-9 * np.eye(6), (sides / scale)[..., None])[..., 0] / scale
    left = residual - np.einsum("nij,tj->tni", partials, steps)
    square = np.einsum("tni,nij,tnj->tn", left, weight, left)
    bounded = np.minimum(square, AGREE_SIGMAS**2).sum(axis=1)
    best = int(np.argmin(bounded + np.einsum("ti,ij,tj->t", steps, whole, steps)))
    out[rows] = square[best] < AGREE_SIGMAS**2
    return out


def pose_from_landmarks(
    landmarks: PosedLandmarks,
    known: PoseKnowledge | None = None,
    usable: ArrayLike | None = None,
    *,
    agreed: BoolArray | None = None,
) -> tuple[PoseSolution, BoolArray]:
    """Solve position and attitude of the camera.

    Parameters
    ----------
    known
        A priori knowledge about the state in `landmarks`; without it landmarks alone tell.
    usable : (n,) array_like of bool, optional
        Landmarks that may take part; by default all that are measured.
    agreed : (n,) array of bool, optional
        Landmarks to take without asking for consensus among them.

    Returns
    -------
    solution : PoseSolution
    used : (n,) array of bool
        Landmarks that agree and took part.

    Raises
    ------
    EstimationError
        Fewer than four landmarks agree, or they do not tell the pose.
    """
    prior = PoseKnowledge() if known is None else known
    measured = np.isfinite(landmarks.observed_px).all(axis=1)
    allowed = np.array(measured if usable is None else measured & np.asarray(usable, dtype=bool), dtype=bool)
    used = consensus(landmarks, prior, allowed) if agreed is None else agreed & measured
    if used.sum() < LEAST_LANDMARKS:
        raise EstimationError(
            f"{int(used.sum())} of {int(allowed.sum())} landmarks agree on a pose; {LEAST_LANDMARKS} are needed."
        )
    solved, step = _robust(landmarks, prior, used)
    for _ in range(3):  # the linear consensus is judged anew with the pose it led to
        again = used if agreed is not None else allowed & _within(solved, used, allowed)
        if again.sum() < LEAST_LANDMARKS or np.array_equal(again, used):
            break
        used = again
        solved, step = _robust(landmarks, prior, used)
    return _solution(landmarks, solved, step, prior, used), used


def camera_position_from_landmarks(
    landmarks: PosedLandmarks, attitude_covariance_rad2: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the spacecraft's position from the body (3,) km, J2000, and its covariance (3, 3), with the stars' attitude.

    The attitude of `landmarks` is held with its covariance; see `pose_from_landmarks` for all that is solved.
    """
    known = PoseKnowledge(attitude_covariance_rad2=np.asarray(attitude_covariance_rad2, dtype=np.float64))
    solution, _ = pose_from_landmarks(landmarks, known)
    return solution.position_km, solution.position_covariance_km2


def _robust(
    start: PosedLandmarks, known: PoseKnowledge, used: BoolArray
) -> tuple[PosedLandmarks, FloatArray]:
    """Return landmarks about the solved pose, and the whole step there (6,), by Tukey's weights."""
    information, total, here = known.information(), np.zeros(6), start
    for _ in range(MOST_STEPS):
        partials, covariance = here.design()
        residual = here.residual_px()
        inside = used & np.isfinite(residual).all(axis=1)
        excess = _excess(residual[inside], covariance[inside])
        weight = np.linalg.inv(covariance[inside] + excess**2 * np.eye(2))
        square = np.einsum("ni,nij,nj->n", residual[inside], weight, residual[inside])
        tukey = np.clip(1.0 - square / (2.0 * TUKEY_SIGMAS**2), 0.0, 1.0) ** 2
        if tukey.sum() < LEAST_LANDMARKS:  # far off still: all of those that agree, alike
            tukey = np.ones_like(tukey)
        by_weight = np.swapaxes(partials[inside], 1, 2) @ (weight * tukey[:, None, None])
        normal = (by_weight @ partials[inside]).sum(axis=0) + information
        right = (by_weight @ residual[inside][..., None]).sum(axis=0)[:, 0] - information @ total
        step = _solved(normal) @ right
        here, total = here.moved(step), _composed(total, step)
        if np.abs(partials[inside] @ step).max() < STEP_TOLERANCE:
            break
    return here, total


def _composed(total: FloatArray, step: FloatArray) -> FloatArray:
    turned = vector_from_rotation(rotation_from_vector(step[3:]) @ rotation_from_vector(total[3:]))
    return np.concatenate([total[:3] + step[:3], turned])


def _solved(normal: FloatArray) -> FloatArray:
    """Return the inverse of normal equations.

    Raises
    ------
    EstimationError
        They are singular.
    """
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(scale, scale)
    value, axes = np.linalg.eigh(scaled)
    if not value[0] > SINGULAR * value[-1]:
        raise EstimationError(
            "the landmarks do not tell position and attitude apart; hold the stars' attitude, or give an a priori position."
        )
    return np.asarray((axes / value) @ axes.T / np.outer(scale, scale))


def _excess(residual: FloatArray, covariance: FloatArray) -> float:
    """Return the scatter of each coordinate beyond what is stated, from the middle half of the residuals.

    Of two coordinates of unit variance the median of the square is 2 ln 2.
    """
    if len(residual) <= LEAST_LANDMARKS:
        return 0.0

    def surplus(sigma: float) -> float:
        weight = np.linalg.inv(covariance + sigma**2 * np.eye(2))
        square = np.einsum("ni,nij,nj->n", residual, weight, residual)
        lost = 1.0 - 3.0 / len(residual)  # six unknowns of 2 n numbers
        return float(np.median(square) - 2.0 * np.log(2.0) * lost)

    return moment_excess(surplus, EXCESS_TOLERANCE_PX)


def _within(solved: PosedLandmarks, used: BoolArray, allowed: BoolArray) -> BoolArray:
    """Tell which landmarks (n,) lie within `AGREE_SIGMAS` of a pose."""
    _, covariance = solved.design()
    residual = solved.residual_px()
    inside = used & np.isfinite(residual).all(axis=1)
    excess = _excess(residual[inside], covariance[inside])
    whole = covariance + excess**2 * np.eye(2)
    good = allowed & np.isfinite(residual).all(axis=1)
    square = np.full(len(used), np.inf)
    weight = np.linalg.inv(whole[good])
    square[good] = np.einsum("ni,nij,nj->n", residual[good], weight, residual[good])
    return np.asarray(square < AGREE_SIGMAS**2)


def _solution(
    start: PosedLandmarks, solved: PosedLandmarks, step: FloatArray, known: PoseKnowledge, used: BoolArray
) -> PoseSolution:
    partials, stated = solved.design()
    residual = solved.residual_px()
    rows = np.flatnonzero(used)
    excess = _excess(residual[rows], stated[rows])
    weight = np.linalg.inv(stated[rows] + excess**2 * np.eye(2))
    by_weight = np.swapaxes(partials[rows], 1, 2) @ weight
    information = known.information()
    inverse = _solved((by_weight @ partials[rows]).sum(axis=0) + information)
    # The estimator is linear: its covariance is that of the measurements, carried through it, and what was known before.
    gain = np.einsum("ij,njk->nik", inverse, by_weight)
    together = _carried(gain, start, stated[rows] + excess**2 * np.eye(2), rows)
    shared = gain.sum(axis=0)
    together = together + shared @ start.common_covariance_px2 @ shared.T
    covariance = symmetric(together + inverse @ information @ inverse)
    square = np.einsum("ni,nij,nj->n", residual[rows], np.linalg.inv(stated[rows]), residual[rows])
    position = -solved.target.position_km
    return PoseSolution(
        position_km=position,
        position_body_km=body_axes(solved.target) @ position,
        camera_from_j2000=solved.camera_from_j2000,
        covariance=covariance,
        position_shift_km=step[:3],
        attitude_shift_rad=step[3:],
        rms_px=float(np.sqrt(np.mean(residual[rows] ** 2))),
        chi2_reduced=float(square.sum() / max(2 * len(rows) - 6, 1)),
        excess_sigma_px=excess,
        n_landmarks=len(rows),
        attitude_held=known.attitude_covariance_rad2 is not None,
        post_fit_px=residual,
    )


def _carried(gain: FloatArray, landmarks: PosedLandmarks, whole: FloatArray, rows: IntArray) -> FloatArray:
    """Return gain C gain' (6, 6), C the joint covariance of patches that overlap; `gain` (n, 6, 2), `whole` (n, 2, 2)."""
    own = np.einsum("nij,njk,nlk->il", gain, whole, gain)
    if not landmarks.window_px > 0.0:
        return np.asarray(own)
    apart = (
        np.abs(landmarks.observed_px[rows, None] - landmarks.observed_px[None, rows]) / landmarks.window_px
    )
    overlap = np.prod(np.maximum(1.0 - apart, 0.0), axis=2)
    np.fill_diagonal(overlap, 0.0)
    spread = gain @ np.linalg.cholesky(landmarks.covariance_px2[rows])
    return np.asarray(own + np.einsum("nik,nm,mjk->ij", spread, overlap, spread, optimize=True))
