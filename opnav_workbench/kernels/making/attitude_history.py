"""Attitudes of a camera over time: nodes, as close as even turns between them need, in intervals with gaps between.

The same interpolation as SPICE makes of a CK of type 3, so that what is computed here is what a reader will see. A law
gives the attitude at any epoch; its nodes stand as close to each other as a tolerance asks, and no closer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry.rotations import rotation_from_vector, vector_from_rotation

__all__ = [
    "MOST_NODES",
    "AttitudeHistory",
    "AttitudeLaw",
    "adaptive_epochs",
    "even_epochs",
    "joined_histories",
    "rates_of",
    "refined_epochs",
]


# ---- Attitudes of a camera over time.

AttitudeLaw = Callable[[FloatArray], FloatArray]  # epochs (n,) -> camera_from_j2000 (n, 3, 3)

# A time given as UTC, as clock reading or as et differs by rounding, 1e-7 s: a window must hold its own ends.
EDGE_S = 1e-4
# Windows that touch are kept this far apart: neither may lend its attitude to the other.
TOUCHING_S = 1e-3
# Rates are differences over this part of the steps to a node's neighbours: laws are smooth, and steps of milliseconds
# or more leave rounding far below 1e-11 rad/s.
STENCIL = 0.125


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeHistory:
    """Attitudes and angular rates at nodes; arrays are read-only.

    Attributes
    ----------
    et : (n,) array
        s past J2000 TDB, increasing.
    camera_from_j2000 : (n, 3, 3) array
    rates_rad_s : (n, 3) array
        Angular velocity of the camera, J2000 components.
    interval_starts : (k,) array of int
        Nodes at which an interval starts; nothing is known between the last node of one and the next.
    """

    et: FloatArray
    camera_from_j2000: FloatArray
    rates_rad_s: FloatArray
    interval_starts: IntArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def attitudes_at(self, et: FloatArray) -> FloatArray:
        """Return the attitudes (m, 3, 3) at epochs (m,), each in the interval whose nodes enclose it."""
        left, part = self._places(et)
        first, second = self.camera_from_j2000[left], self.camera_from_j2000[left + 1]
        turn = vector_from_rotation(second @ np.swapaxes(first, -1, -2))
        return np.asarray(rotation_from_vector(part[:, None] * turn) @ first)

    def rates_at(self, et: FloatArray) -> FloatArray:
        """Return the rates (m, 3) at epochs (m,), linear between nodes."""
        left, part = self._places(et)
        return np.asarray(
            (1.0 - part[:, None]) * self.rates_rad_s[left] + part[:, None] * self.rates_rad_s[left + 1]
        )

    def intervals(self) -> list[tuple[int, int]]:
        """Return first and last node of each interval."""
        ends = [*(self.interval_starts[1:] - 1).tolist(), len(self.et) - 1]
        return list(zip(self.interval_starts.tolist(), ends, strict=True))

    def widened(self) -> "AttitudeHistory":
        """Return a history without gaps that goes on evenly a tenth of a millisecond before its start and after its end."""
        ends = np.array([0, -1])
        steps = np.array([-EDGE_S, EDGE_S])[:, None]
        turned = self.camera_from_j2000[ends] @ rotation_from_vector(-steps * self.rates_rad_s[ends])
        return AttitudeHistory(
            et=np.concatenate([self.et[:1] - EDGE_S, self.et, self.et[-1:] + EDGE_S]),
            camera_from_j2000=np.concatenate([turned[:1], self.camera_from_j2000, turned[1:]]),
            rates_rad_s=self.rates_rad_s[np.r_[0, : len(self.et), -1]],
            interval_starts=self.interval_starts,
        )

    def _places(self, et: FloatArray) -> tuple[IntArray, FloatArray]:
        left = np.clip(np.searchsorted(self.et, et, side="right") - 1, 0, len(self.et) - 2)
        at_end = np.isin(left + 1, self.interval_starts) & (
            left > 0
        )  # the last node of an interval, or rounding
        left = np.where(at_end, left - 1, left)
        return left, (et - self.et[left]) / (self.et[left + 1] - self.et[left])


def rates_of(law: AttitudeLaw, et: FloatArray) -> FloatArray:
    """Return the angular velocity (n, 3), J2000 components, of a law at epochs (n,) without gaps.

    Central differences over an eighth of the step to the neighbours, one-sided of second order at the ends, so that
    the law is not asked outside them.
    """
    step = np.diff(et)
    reach = STENCIL * np.minimum(np.append(step, np.inf), np.append(np.inf, step))
    side = np.zeros(len(et))  # 0: both sides; at the ends both points lie inside
    side[0], side[-1] = 1.0, -1.0
    near = et + np.where(side == 0.0, -reach, side * reach)
    far = et + np.where(side == 0.0, reach, 2.0 * side * reach)
    here, first, second = (law(t) for t in (et, near, far))
    turns = [_turn(here, other) for other in (first, second)]
    before, after = near - et, far - et  # as they are after rounding
    # The parabola through the origin and two points: its slope at the origin.
    slope = (turns[0] * (after**2)[:, None] - turns[1] * (before**2)[:, None]) / (
        before * after * (after - before)
    )[:, None]
    return np.asarray(slope)


def _turn(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the turns (n, 3) of the frame from one attitude to another, as a rotation vector in J2000."""
    return vector_from_rotation(np.swapaxes(end, -1, -2) @ start)


def joined_histories(pieces: Sequence[AttitudeHistory]) -> AttitudeHistory:
    """Return several histories, in order of time, as one; where two touch, the earlier ends a millisecond before."""
    cut = [_ended_before(piece, after.et[0]) for piece, after in pairwise(pieces)]
    parts = [*cut, pieces[-1]]
    firsts = np.cumsum([0, *(len(p.et) for p in parts[:-1])])
    return AttitudeHistory(
        et=np.concatenate([p.et for p in parts]),
        camera_from_j2000=np.concatenate([p.camera_from_j2000 for p in parts]),
        rates_rad_s=np.concatenate([p.rates_rad_s for p in parts]),
        interval_starts=np.concatenate(
            [p.interval_starts + n for p, n in zip(parts, firsts.tolist(), strict=True)]
        ),
    )


def _ended_before(piece: AttitudeHistory, end: float) -> AttitudeHistory:
    last = end - TOUCHING_S
    if piece.et[-1] <= last:
        return piece
    keep = piece.et < last
    when = np.array([last])
    return AttitudeHistory(
        et=np.append(piece.et[keep], last),
        camera_from_j2000=np.concatenate([piece.camera_from_j2000[keep], piece.attitudes_at(when)]),
        rates_rad_s=np.concatenate([piece.rates_rad_s[keep], piece.rates_at(when)]),
        interval_starts=piece.interval_starts[piece.interval_starts <= int(keep.sum())],
    )


# ---- Nodes of an attitude law, as close to each other as even turns between them need and no closer.

CHECKS = (0.25, 0.5, 0.75)  # of a step: the middle alone would miss an error that changes sign there
LONGEST_STEP_S = 1800.0  # a shorter swing of a target about its center could hide between checks
SHORTEST_STEP_S = 1e-3  # closer than any motion of a spacecraft needs: the law jumps
MOST_PIECES = 64  # a step is cut into, at once
SPARE = 1.05  # finer by this than the error asks, or every second cut would need another
MOST_NODES = 3_000_000  # 200 MB of CK


def even_epochs(start: float, end: float, step_s: float) -> FloatArray:
    """Return epochs from `start` to `end` at steps of `step_s`, the last one shorter.

    Examples
    --------
    >>> even_epochs(0.0, 25.0, 10.0).tolist()
    [0.0, 10.0, 20.0, 25.0]
    """
    _not_too_many((end - start) / step_s)
    et = np.append(np.arange(start, end, step_s), end)
    if len(et) > 2 and et[-1] - et[-2] < 1e-3 * step_s:  # rounding left a sliver
        et = np.delete(et, -2)
    return np.asarray(et)


def _not_too_many(count: float) -> None:
    if count > MOST_NODES:
        raise ValueError(
            f"{count:.3g} attitudes, the limit is {MOST_NODES}; take longer steps or a shorter span"
        )


def adaptive_epochs(law: AttitudeLaw, start: float, end: float, tolerance_rad: float) -> FloatArray:
    """Return epochs between which even turns follow a smooth law within `tolerance_rad`.

    Raises
    ------
    ValueError
        The law jumps, or the tolerance asks for more nodes than a file should hold.
    """
    _not_too_many((end - start) / LONGEST_STEP_S)
    count = 1 + max(1, int(np.ceil((end - start) / LONGEST_STEP_S)))
    return refined_epochs(law, np.linspace(start, end, count), tolerance_rad)


def refined_epochs(law: AttitudeLaw, nodes: FloatArray, tolerance_rad: float) -> FloatArray:
    """Return `nodes` (n,) and as many epochs between them as `adaptive_epochs` needs; raises as it."""
    done: list[FloatArray] = []
    steps = np.stack([nodes[:-1], nodes[1:]], axis=1)
    while len(steps):
        pieces = _pieces_needed(_law_error(law, steps), tolerance_rad)
        done.append(steps[pieces == 1, 0])
        steps = _subdivided(steps[pieces > 1], pieces[pieces > 1])
        _require_reachable(steps, sum(map(len, done)), tolerance_rad)
    return np.append(np.sort(np.concatenate(done)), nodes[-1])


def _pieces_needed(error_rad: FloatArray, tolerance_rad: float) -> IntArray:
    """Return into how many pieces each step must be cut; the error goes with the square of the step."""
    wanted = np.ceil(SPARE * np.sqrt(error_rad / tolerance_rad))
    return np.where(error_rad <= tolerance_rad, 1.0, np.clip(wanted, 2, MOST_PIECES)).astype(np.int64)


def _subdivided(steps: FloatArray, pieces: IntArray) -> FloatArray:
    row = np.repeat(np.arange(len(steps)), pieces)
    number = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    length = (steps[row, 1] - steps[row, 0]) / pieces[row]
    first = steps[row, 0] + number * length
    # Ends are the next one's beginnings, to the last bit.
    last = np.where(number == pieces[row] - 1, steps[row, 1], steps[row, 0] + (number + 1) * length)
    return np.stack([first, last], axis=1)


def _law_error(law: AttitudeLaw, steps: FloatArray) -> FloatArray:
    """Return the largest angle (n,) between the law and even turns at the checks inside steps (n, 2)."""
    length = steps[:, 1] - steps[:, 0]
    first, last = law(steps[:, 0]), law(steps[:, 1])
    turn = vector_from_rotation(last @ np.swapaxes(first, -1, -2))
    worst = np.zeros(len(steps))
    for part in CHECKS:
        even = rotation_from_vector(part * turn) @ first
        off = vector_from_rotation(law(steps[:, 0] + part * length) @ np.swapaxes(even, -1, -2))
        worst = np.maximum(worst, np.linalg.norm(off, axis=1))
    return worst


def _require_reachable(steps: FloatArray, done: int, tolerance_rad: float) -> None:
    if len(steps) + done > MOST_NODES:
        raise ValueError(
            f"a tolerance of {tolerance_rad:g} rad needs more than {MOST_NODES} attitudes; give a larger "
            "tolerance_rad, a step_s, or shorter windows"
        )
    if len(steps) and np.min(steps[:, 1] - steps[:, 0]) < SHORTEST_STEP_S:
        raise ValueError(
            f"the attitude turns too fast for {tolerance_rad:g} rad between attitudes "
            f"{SHORTEST_STEP_S:g} s apart; give a larger tolerance_rad, a step_s, or another twist or offset"
        )
