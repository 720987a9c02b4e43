"""Tables of states from a known motion: as many as SPICE needs to give it back to a quarter of a metre.

Intervals are halved where SPICE, reading the table, misses the motion at their middle.
"""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.spice.guard import spice_call
from opnav_workbench.spice.writing import WINDOW_STATES, SpkSegment, write_spk

__all__ = ["MAX_STATES", "read_back", "sampled"]

# At the middle of an interval, where an interpolation is worst or nearly so; 1 m is promised anywhere.
LARGEST_ERROR_KM = 2.5e-4
RELATIVE_ERROR = 2.5e-7  # of the distance from the center: orbits about a small body are small themselves
MAX_STATES = 200_000  # 11 MB
MAX_ROUNDS = 40  # halving a day this often leaves less than a microsecond

States = Callable[[FloatArray], FloatArray]


def sampled(
    states: States,
    span_et: tuple[float, float],
    segment: Callable[[FloatArray, FloatArray], SpkSegment],
    longest_step_s: float,
) -> SpkSegment:
    """Return a segment whose interpolation keeps to a motion.

    Parameters
    ----------
    states : callable
        Epochs (n,), in order, to states (n, 6), km and km/s.
    span_et : (start, end)
        What the segment covers.
    segment : callable
        Makes a segment of epochs (n,) and states (n, 6).
    longest_step_s : float
        To begin with.

    Raises
    ------
    ValueError
        The motion is too rough for a table of `MAX_STATES`.
    """
    start, end = span_et
    n_steps = max(math.ceil((end - start) / longest_step_s), WINDOW_STATES - 1)
    et = np.linspace(start, end, min(n_steps, MAX_STATES) + 1)
    for _ in range(MAX_ROUNDS):
        if len(et) > MAX_STATES:
            break
        table = segment(et, states(et))
        middle = 0.5 * (et[1:] + et[:-1])
        truth = states(middle)
        error_km = np.linalg.norm(read_back(table, middle)[:, :3] - truth[:, :3], axis=1)
        rough = error_km > np.minimum(LARGEST_ERROR_KM, RELATIVE_ERROR * np.linalg.norm(truth[:, :3], axis=1))
        if not rough.any():
            return table
        et = np.sort(np.concatenate([et, middle[rough]]))
    raise ValueError(
        f"a table of {MAX_STATES} states does not follow this motion to {LARGEST_ERROR_KM * 1e3} m"
    )


def read_back(segment: SpkSegment, et: FloatArray) -> FloatArray:
    """Return the states (n, 6) that SPICE makes of a segment at epochs (n,), in the segment's frame."""
    with tempfile.TemporaryDirectory() as folder, spice_call(f"reading back body {segment.target}"):
        path = Path(folder, "segment.bsp")
        write_spk(path, [segment])
        handle = spiceypy.spklef(str(path))
        try:
            rows = [spiceypy.spkgeo(segment.target, t, segment.frame, segment.center)[0] for t in et]
        finally:
            spiceypy.spkuef(handle)
    return np.array(rows)
