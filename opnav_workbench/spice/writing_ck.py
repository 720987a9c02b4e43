"""Attitudes as CK files of type 3: quaternions and angular rates, interpolated within intervals and never across gaps.

The writer checks its input first, writes under a temporary name and renames: a file that is there is whole.

Source: NAIF, CK Required Reading (type 3), Rotations Required Reading.
"""

import os
from collections.abc import Sequence

import numpy as np
import spiceypy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.geometry.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    vector_from_rotation,
)
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.newfile import (
    as_kernel_error,
    check_epochs,
    check_finite,
    new_daf,
    require_frame,
)

__all__ = ["angular_rates_from_attitudes", "write_ck"]


def write_ck(
    path: str | os.PathLike[str],
    structure_id: int,
    spacecraft_id: int,
    et: ArrayLike,
    frame_from_reference: ArrayLike,
    angular_rates: ArrayLike | None = None,
    reference: str = "J2000",
    *,
    max_gap_s: float | None = None,
    interval_starts: Sequence[int] = (),
    comment: str = "",
) -> None:
    """Write attitudes as a CK file of one type 3 segment: SPICE turns evenly from each attitude to the next.

    Needs the clock's kernels (LSK and SCLK) in the active `KernelSet`.

    Parameters
    ----------
    path : path
        An older file of that name is replaced once the new one is whole.
    structure_id : int
        NAIF id of what is oriented, in a CK the id of its frame's class: -98000, the bus of New Horizons.
    spacecraft_id : int
        Whose clock the attitudes are tagged with.
    et : (n,) array_like
        Epochs, s past J2000 TDB, increasing.
    frame_from_reference : (n, 3, 3) or (n, 4) array_like
        Attitudes, ``v_frame = matrix @ v_reference``; or their SPICE quaternions, of any length but zero.
        Neighbours in one interval must be less than half a turn apart.
    angular_rates : (n, 3) array_like, optional
        Angular velocity of the frame, rad/s, components in `reference`; from the attitudes if not given.
    reference : str
        SPICE frame that the attitudes refer to.
    max_gap_s : float, optional
        Neighbours further apart than this are not interpolated between.
    interval_starts : sequence of int
        More places where an interpolation interval starts, as indices into `et`.

    Raises
    ------
    KernelError
        Epochs, attitudes or rates that make no CK; a clock that is not loaded or not running then;
        a frame that SPICE does not know; a folder that cannot be written.
    """
    with as_kernel_error(f"CK of {structure_id}"):
        times = readonly(et, (None,), "et")
        check_epochs(times, 1)
        matrices = _matrices(frame_from_reference, len(times))
        starts = _interval_starts(times, max_gap_s, interval_starts)
        rates = (
            _rates(times, matrices, starts)
            if angular_rates is None
            else readonly(angular_rates, (len(times), 3), "angular_rates")
        )
        check_finite(rates, "angular_rates")
    require_frame(reference)
    ticks = _ticks(spacecraft_id, times)
    with new_daf(path, spiceypy.ckopn, spiceypy.ckcls, comment) as handle:
        spiceypy.ckw03(
            handle, ticks[0], ticks[-1], structure_id, reference, True, f"{structure_id} from {reference}",
            len(times), ticks, quaternion_from_matrix(matrices), rates.copy(), len(starts), ticks[starts],
        )  # fmt: skip


def angular_rates_from_attitudes(et: FloatArray, frame_from_reference: FloatArray) -> FloatArray:
    """Return angular velocities (n, 3), rad/s in the reference frame, of attitudes (n, 3, 3) at epochs (n,).

    Second order in the step inside; at the ends the mean rate of the first and last step.

    Raises
    ------
    ValueError
        An attitude is not a rotation.

    Examples
    --------
    >>> import numpy as np
    >>> from opnav_workbench.geometry.rotations import rotation_from_vector
    >>> et = np.array([0.0, 1.0, 3.0])
    >>> spin = rotation_from_vector(np.outer(et, [0.0, 0.0, -0.1]))  # frame turns by +0.1 rad/s about +z
    >>> angular_rates_from_attitudes(et, spin).round(12).tolist()
    [[0.0, 0.0, 0.1], [0.0, 0.0, 0.1], [0.0, 0.0, 0.1]]
    """
    n = len(et)
    if n == 1:
        return np.zeros((1, 3))
    step = np.diff(et)[:, None]
    # The frame's turn during a step as an active rotation: reference_from_later @ earlier_from_reference.
    turn = np.swapaxes(frame_from_reference[1:], -1, -2) @ frame_from_reference[:-1]
    mean = vector_from_rotation(turn) / step
    rates = np.empty((n, 3))
    rates[0], rates[-1] = mean[0], mean[-1]
    # Mean rates hold at mid-step: interpolate them linearly to the epoch between.
    rates[1:-1] = (mean[:-1] * step[1:] + mean[1:] * step[:-1]) / (step[1:] + step[:-1])
    return rates


def _rates(et: FloatArray, matrices: FloatArray, starts: FloatArray) -> FloatArray:
    pieces = zip(np.split(et, starts[1:]), np.split(matrices, starts[1:]), strict=True)
    return np.concatenate([angular_rates_from_attitudes(t, m) for t, m in pieces])


def _matrices(attitudes: ArrayLike, n: int) -> FloatArray:
    array = np.asarray(attitudes, float)
    if array.shape == (n, 4):
        return matrix_from_quaternion(array)
    matrices = readonly(array, (n, 3, 3), "attitudes")
    # Through quaternions and back: what SPICE will read, exactly orthonormal.
    return matrix_from_quaternion(quaternion_from_matrix(matrices))


def _interval_starts(et: FloatArray, max_gap_s: float | None, extra: Sequence[int]) -> FloatArray:
    gaps = np.flatnonzero(np.diff(et) > (np.inf if max_gap_s is None else max_gap_s)) + 1
    starts = np.unique(np.concatenate([[0], gaps, np.asarray(extra, int)]).astype(int))
    if starts[0] < 0 or starts[-1] >= len(et):
        raise ValueError(f"interval_starts {list(extra)} go beyond the {len(et)} epochs")
    return starts


def _ticks(spacecraft_id: int, et: FloatArray) -> FloatArray:
    ticks = np.array([_tick(spacecraft_id, t) for t in et.tolist()])
    with as_kernel_error(f"clock {spacecraft_id}"):
        if np.any(np.diff(ticks) <= 0.0):
            i = int(np.argmin(np.diff(ticks)))
            raise ValueError(f"epochs {et[i]} and {et[i + 1]} fall on the same clock tick; space them out")
    return ticks


def _tick(spacecraft_id: int, et: float) -> float:
    with spice_call(Request(f"reading of clock {spacecraft_id}", et), needs_kernels=True):
        return float(spiceypy.sce2c(spacecraft_id, et))
