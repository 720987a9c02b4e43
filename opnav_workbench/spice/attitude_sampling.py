"""Nodes of an attitude law, as close to each other as even turns between them need and no closer."""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.geometry.rotations import rotation_from_vector, vector_from_rotation
from opnav_workbench.spice.attitude_history import AttitudeLaw

__all__ = ["MOST_NODES", "adaptive_epochs", "even_epochs", "refined_epochs"]

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
    et = np.append(np.arange(start, end, step_s), end)
    if len(et) > 2 and et[-1] - et[-2] < 1e-3 * step_s:  # rounding left a sliver
        et = np.delete(et, -2)
    return np.asarray(et)


def adaptive_epochs(law: AttitudeLaw, start: float, end: float, tolerance_rad: float) -> FloatArray:
    """Return epochs between which even turns follow a smooth law within `tolerance_rad`.

    Raises
    ------
    ValueError
        The law jumps, or the tolerance asks for more nodes than a file should hold.
    """
    count = 1 + max(1, int(np.ceil((end - start) / LONGEST_STEP_S)))
    return refined_epochs(law, np.linspace(start, end, count), tolerance_rad)


def refined_epochs(law: AttitudeLaw, nodes: FloatArray, tolerance_rad: float) -> FloatArray:
    """Return `nodes` (n,) and as many epochs between them as `adaptive_epochs` needs; raises as it."""
    done: list[FloatArray] = []
    steps = np.stack([nodes[:-1], nodes[1:]], axis=1)
    while len(steps):
        pieces = _pieces_needed(_error(law, steps), tolerance_rad)
        done.append(steps[pieces == 1, 0])
        steps = _cut(steps[pieces > 1], pieces[pieces > 1])
        _refuse(steps, sum(map(len, done)), tolerance_rad)
    return np.append(np.sort(np.concatenate(done)), nodes[-1])


def _pieces_needed(error_rad: FloatArray, tolerance_rad: float) -> IntArray:
    """Return into how many pieces each step must be cut; the error goes with the square of the step."""
    wanted = np.ceil(SPARE * np.sqrt(error_rad / tolerance_rad))
    return np.where(error_rad <= tolerance_rad, 1.0, np.clip(wanted, 2, MOST_PIECES)).astype(np.int64)


def _cut(steps: FloatArray, pieces: IntArray) -> FloatArray:
    row = np.repeat(np.arange(len(steps)), pieces)
    number = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    length = (steps[row, 1] - steps[row, 0]) / pieces[row]
    first = steps[row, 0] + number * length
    # Ends are the next one's beginnings, to the last bit.
    last = np.where(number == pieces[row] - 1, steps[row, 1], steps[row, 0] + (number + 1) * length)
    return np.stack([first, last], axis=1)


def _error(law: AttitudeLaw, steps: FloatArray) -> FloatArray:
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


def _refuse(steps: FloatArray, done: int, tolerance_rad: float) -> None:
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
