"""How sure an identification is, and in which words.

The confidence is one minus the probability that the answer is a mistake, be it that the field is another one or that a
rival explains the detections as well. Above `SURE` an identification may be relied on: a field that has nothing to do
with the stars reaches that less than once in a thousand. With one star there is nothing to cross-check: nearness and
brightness choose among the detections, and it is never sure.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.starcenters.sky_scene import Hypothesis, Limits, Scene, shift_and_twist

__all__ = ["SURE", "Identification", "answer", "in_camera", "judge", "nothing"]

SURE = 0.999  # the evidence of a thousand; below this an identification is a proposal
SINGLE_STAR_CONFIDENCE = 0.99  # at most: detectors have more ways to mimic one star than statistics know
SAME_TOLERANCES = 2.0  # hypotheses that differ by less at the detector's corners are one


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Stars identified.

    `rotation` turns camera-frame directions from the a priori attitude to the one found: ``camera_from_j2000 = rotation
    @ a_priori_camera_from_j2000``. In a plane: observed = center + shift + R(twist) (predicted - center).
    """

    shift_px: (
        FloatArray  # (2,) pixel, line: where the a priori center of the field is seen, without distortion
    )
    twist_rad: float  # positive from +pixel toward +line
    pairs: IntArray  # (k, 2) star index, detection index
    confidence: float  # 1 - estimated probability that the pairs are a mistake
    message: str
    zero_point_mag: float | None = None  # magnitude of 1 DN, as given or fitted
    rotation: FloatArray | None = None  # (3, 3)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sure(self) -> bool:
        """True where the answer may be relied on; else it is a proposal to be confirmed."""
        return self.confidence >= SURE


def judge(scene: Scene, limits: Limits, hypotheses: list[Hypothesis], evidence: FloatArray) -> Identification:
    """Choose the likeliest hypothesis; its confidence is its share, "another field" having evidence one."""
    order = np.argsort(-evidence, kind="stable")
    pairs = [frozenset(map(tuple, h.pairs.tolist())) for h in hypotheses]
    rotations = np.stack([h.rotation for h in hypotheses])
    distinct: list[int] = []
    for i in order:
        near = _moved_px(scene, rotations[i], rotations[distinct]) <= SAME_TOLERANCES * limits.tolerance_px
        if not (np.any(near) or any(2 * len(pairs[i] & pairs[j]) > len(pairs[i]) for j in distinct)):
            distinct.append(int(i))
    best = hypotheses[distinct[0]]
    total = float(logsumexp(np.append(evidence[distinct], 0.0)))
    confidence = float(np.exp(evidence[distinct[0]] - total))
    if len(best.pairs) == 1:
        confidence = min(confidence, SINGLE_STAR_CONFIDENCE)
    return answer(scene, best, confidence)


def answer(scene: Scene, best: Hypothesis, confidence: float) -> Identification:
    """Word a hypothesis as the identification."""
    shift, twist = shift_and_twist(best.rotation, scene.focal_px)
    return Identification(
        scene.pixel_from_plane @ shift,
        float(twist),
        best.pairs,
        confidence,
        _message(scene, best, confidence),
        _optional(best.zero_point_mag),
        best.rotation,
    )


def _moved_px(scene: Scene, rotation: FloatArray, others: FloatArray) -> FloatArray:
    """Return how far the detector's corners are apart (n,), px, by a rotation and by others (n, 3, 3)."""
    between = vector_from_rotation(rotation @ np.swapaxes(others, -1, -2))
    shift, twist = np.hypot(between[:, 0], between[:, 1]), np.abs(between[:, 2])
    return np.asarray(scene.focal_px * shift + scene.half_diagonal_px * twist)


def _message(scene: Scene, h: Hypothesis, confidence: float) -> str:
    doubt = "" if confidence >= SURE else ": not sure, confirm by eye or mark two stars"
    if len(h.pairs) == 1:
        known = "nearness" if np.isnan(scene.zero_point_mag) else "brightness and nearness"
        return (
            f"one star only, chosen among {len(scene.detected)} detections by {known} only, "
            f"confidence {confidence:.2f}{doubt}"
        )
    expected = int(scene.inside(scene.places(h.rotation)).sum())
    return (
        f"{len(h.pairs)} of {expected} stars on the detector identified, confidence {confidence:.4f}{doubt}"
    )


def nothing(scene: Scene, message: str) -> Identification:
    """Return that nothing is identified, and why."""
    return Identification(
        np.zeros(2), 0.0, np.zeros((0, 2), np.int64), 0.0, message, _optional(scene.zero_point_mag)
    )


def _optional(value: float) -> float | None:
    return None if np.isnan(value) else value


def in_camera(found: Identification, kept: IntArray, axes: FloatArray) -> Identification:
    """Return the pairs with the caller's detections, and the rotation in the camera's frame."""
    pairs = np.column_stack([found.pairs[:, 0], kept[found.pairs[:, 1]]])
    rotation = None if found.rotation is None else axes.T @ found.rotation @ axes
    return Identification(
        found.shift_px,
        found.twist_rad,
        pairs,
        found.confidence,
        found.message,
        found.zero_point_mag,
        rotation,
    )
