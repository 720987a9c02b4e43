"""Writers of SPICE kernels: trajectories (SPK), attitudes (CK) and text kernels.

Every writer checks its input first, writes under a temporary name and renames: a file that is there is whole.

Source: NAIF, SPK Required Reading (types 9 and 13), CK Required Reading (type 3), Rotations Required Reading.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import spiceypy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.errors import KernelError
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
from opnav_workbench.spice.text_kernels import write_text_kernel

__all__ = ["SpkSegment", "write_ck", "write_spk", "write_text_kernel"]

WINDOW_STATES = 6  # states an interpolation looks at: with more, uneven epochs make it swing
MIN_STATES = 2


@dataclass(frozen=True, slots=True, eq=False)
class SpkSegment:
    """States of one body about another, between which SPICE interpolates; arrays are read-only.

    Examples
    --------
    >>> import numpy as np
    >>> et = np.linspace(0.0, 3600.0, 3)
    >>> states = np.column_stack([1e6 + 10.0 * et, 0 * et, 0 * et, 10.0 + 0 * et, 0 * et, 0 * et])
    >>> SpkSegment(-999, 9, et, states).degree
    5
    """

    target: int
    center: int
    et: FloatArray  # (n,) s past J2000 TDB, increasing
    states: FloatArray  # (n, 6) km, km/s
    frame: str = "J2000"
    interpolation: Literal["hermite", "lagrange"] = "hermite"  # SPK types 13 and 9

    def __post_init__(self) -> None:
        """Check shapes, order and finiteness.

        Raises
        ------
        KernelError
            The states cannot make a segment.
        """
        label = f"SPK segment of {self.target} about {self.center}"
        with as_kernel_error(label):
            object.__setattr__(self, "et", readonly(self.et, (None,), "et"))
            object.__setattr__(self, "states", readonly(self.states, (len(self.et), 6), "states"))
            check_epochs(self.et, MIN_STATES)
            check_finite(self.states, "states")
            if self.target == self.center:
                raise ValueError("target and center are the same body")
            if self.interpolation not in {"hermite", "lagrange"}:
                raise ValueError(f"interpolation {self.interpolation!r} is neither hermite nor lagrange")
        freeze_arrays(self)

    @property
    def degree(self) -> int:
        """Degree of the interpolating polynomial: of six states, or of all if there are fewer."""
        window = min(len(self.et), WINDOW_STATES)
        return 2 * window - 1 if self.interpolation == "hermite" else window - 1


def write_spk(path: str | os.PathLike[str], segments: Sequence[SpkSegment], comment: str = "") -> None:
    """Write trajectories as an SPK file of type 13 (Hermite) or 9 (Lagrange) segments.

    Parameters
    ----------
    path : path
        An older file of that name is replaced once the new one is whole.
    segments : sequence of SpkSegment
        Where two segments of one target overlap in time, SPICE uses the later one.
    comment : str
        Goes into the file's comment area: where the numbers come from.

    Raises
    ------
    KernelError
        No segments, a frame that SPICE does not know, or a folder that cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> et = np.linspace(0.0, 3600.0, 3)
    >>> states = np.column_stack([1e6 + 10.0 * et, 0 * et, 0 * et, 10.0 + 0 * et, 0 * et, 0 * et])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_spk(Path(folder, "orbit.bsp"), [SpkSegment(-999, 9, et, states)])
    ...     Path(folder, "orbit.bsp").stat().st_size % 1024  # SPICE files are whole records
    0
    """
    if not segments:
        raise KernelError(f"{path}: no segments; an SPK needs one at least.")
    for segment in segments:
        require_frame(segment.frame)
    with new_daf(path, spiceypy.spkopn, spiceypy.spkcls, comment) as handle:
        for segment in segments:
            _add_spk_segment(handle, segment)


def _add_spk_segment(handle: int, s: SpkSegment) -> None:
    write = spiceypy.spkw13 if s.interpolation == "hermite" else spiceypy.spkw09
    title = f"{s.target} about {s.center}, {s.interpolation} {s.degree}"
    et, states = s.et.copy(), s.states.copy()  # spiceypy takes no read-only arrays
    write(handle, s.target, s.center, s.frame, et[0], et[-1], title, s.degree, len(et), states, et)


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
    with spice_call(Request(f"clock {spacecraft_id}", float(et[0])), needs_kernels=True):
        ticks = np.array([spiceypy.sce2c(spacecraft_id, t) for t in et])
    with as_kernel_error(f"clock {spacecraft_id}"):
        if np.any(np.diff(ticks) <= 0.0):
            i = int(np.argmin(np.diff(ticks)))
            raise ValueError(f"epochs {et[i]} and {et[i + 1]} fall on the same clock tick; space them out")
    return ticks
