"""SPK and CK files written: tables of states (types 13 and 9), excerpts of other SPKs, attitudes (type 3).

A writer checks its input first, writes under a temporary name and renames: a file that is there is whole. Excerpts
copy the segments of some bodies over some time without loss. Between the attitudes of a CK SPICE turns evenly. The
checks and the new files of this module also serve DSK files.

Source: NAIF, SPK Required Reading (types 9 and 13, "SPKSUB"), CK Required Reading (type 3).
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import spiceypy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.constants import SOLAR_SYSTEM_BARYCENTER_ID
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.geometry.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    vector_from_rotation,
)
from opnav_workbench.kernels.calls import SpiceRequest, spice_call, time_words
from opnav_workbench.kernels.files import DafSegment, segments
from opnav_workbench.kernels.loading import require_short_path
from opnav_workbench.kernels.text_kernels import comment_lines

__all__ = ["SpkExcerpt", "SpkSegment", "new_das", "require_frame", "spk_excerpts", "write_ck", "write_spk"]


# ---- What all writers of binary kernels share: input checks, and new files that are whole or not there.

TITLE_CHARS = 60  # DAF internal file name
NEWLINE = 1  # SPICE stores one mark at each end of line in the comment area


def check_epochs(et: FloatArray, least: int) -> None:
    """Raise ValueError unless there are enough epochs, finite and increasing."""
    if len(et) < least:
        raise ValueError(f"{len(et)} epochs, at least {least} are needed")
    check_finite(et, "et")
    late = np.flatnonzero(np.diff(et) <= 0.0)
    if len(late):
        i = int(late[0])
        raise ValueError(f"epochs must increase: number {i + 1} is {et[i + 1]}, after {et[i]}; sort them")


def check_finite(values: FloatArray, name: str) -> None:
    """Raise ValueError naming the first value that is not finite."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"{name}{bad[0].tolist()} is not finite ({len(bad)} such values)")


def require_frame(frame: str) -> None:
    """Raise KernelError unless SPICE knows the frame."""
    with spice_call(f"frame {frame}"):
        known = spiceypy.namfrm(frame) != 0
    if not known:
        raise KernelError(f"frame {frame!r} is unknown to SPICE; load the FK that defines it, or use J2000.")


@contextlib.contextmanager
def as_kernel_error(label: str) -> Iterator[None]:
    """Turn the ValueError of a check into a KernelError that says which file it is about."""
    try:
        yield
    except ValueError as error:
        raise KernelError(f"{label}: {error}.") from error


@contextlib.contextmanager
def new_daf(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
) -> Iterator[int]:
    """Yield the handle of a new DAF (SPK, CK) under a temporary name; leave no open handle, no half file."""
    with _new_file(path, start, finish, comment, spiceypy.dafac, spiceypy.dafcls) as handle:
        yield handle


@contextlib.contextmanager
def new_das(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
) -> Iterator[int]:
    """Yield the handle of a new DAS file (DSK) as `new_daf` does."""
    with _new_file(path, start, finish, comment, _add_das_comment, spiceypy.dascls) as handle:
        yield handle


def _add_das_comment(handle: int, lines: Sequence[str]) -> None:
    spiceypy.dasac(handle, list(lines))


@contextlib.contextmanager
def _new_file(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
    add_comment: Callable[[int, Sequence[str]], None],
    abandon: Callable[[int], None],
) -> Iterator[int]:
    lines = comment_lines(comment)
    final = Path(path)
    require_short_path(final)
    try:
        with atomic_path(final) as temporary, spice_call(f"writing {final}"):
            temporary.unlink()  # SPICE makes the file itself, and refuses one that exists
            size = sum(len(line) + NEWLINE for line in lines)
            handle = start(str(temporary), final.name[:TITLE_CHARS], size)
            try:
                if lines:
                    add_comment(handle, lines)
                yield handle
                finish(handle)
            except BaseException:
                with contextlib.suppress(spiceypy.SpiceyError):
                    abandon(handle)
                raise
    except SessionError as error:
        raise KernelError(str(error)) from error


# ---- Excerpts of SPK files: segments of some bodies over some time, copied without loss.

SUMMARY_WORDS = 5  # two doubles, and six integers in the room of three


@dataclass(frozen=True, slots=True)
class SpkExcerpt:
    """The segments of one body in an SPK file, between two times."""

    source: Path
    target: int
    center: int
    start_et: float
    end_et: float


def spk_excerpts(source: Path, target: int, start_et: float, end_et: float) -> tuple[SpkExcerpt, ...]:
    """Return excerpts for a body and the centers it refers to, down to the Solar System barycenter.

    Raises
    ------
    KernelError
        The file does not hold the body, or not over the whole time.

    Examples
    --------
    >>> from opnav_workbench.kernels.making.forces import planet_ephemeris
    >>> [(e.target, e.center) for e in spk_excerpts(planet_ephemeris(), 399, 0.0, 86400.0)]
    [(399, 3), (3, 0)]
    """
    found: list[SpkExcerpt] = []
    body = target
    while body != SOLAR_SYSTEM_BARYCENTER_ID and body not in {e.target for e in found}:
        center = _covering_center(source, body, start_et, end_et)
        found.append(SpkExcerpt(source, body, center, start_et, end_et))
        body = center
    return tuple(found)


def copy_excerpt(handle: int, excerpt: SpkExcerpt) -> None:
    """Copy an excerpt into the SPK open for writing; lock held."""
    with _opened(excerpt.source) as source:
        for segment in _segments_of(excerpt.source, excerpt.target):
            start = max(segment.doubles[0], excerpt.start_et)
            end = min(segment.doubles[1], excerpt.end_et)
            if start < end and segment.integers[1] == excerpt.center:
                summary = spiceypy.dafps(2, 6, list(segment.doubles), list(segment.integers))[:SUMMARY_WORDS]
                title = f"{excerpt.target} about {excerpt.center}, from {excerpt.source.name}"
                spiceypy.spksub(source, summary, title[:40], start, end, handle)


def _segments_of(source: Path, body: int) -> list[DafSegment]:
    return [s for s in segments(source) if s.integers[0] == body]


def _covering_center(source: Path, body: int, start_et: float, end_et: float) -> int:
    """Return the center of the body's segments, which must leave no gap."""
    found = _segments_of(source, body)
    if not found:
        held = sorted({s.integers[0] for s in segments(source)})
        raise KernelError(f"{source.name} does not hold the body {body}; it holds {held}.")
    center = found[-1].integers[1]
    reached = start_et
    for start, end in sorted(s.doubles for s in found if s.integers[1] == center):
        if start <= reached:
            reached = max(reached, end)
    first, last = min(s.doubles[0] for s in found), max(s.doubles[1] for s in found)
    if reached < end_et or first > start_et:
        raise KernelError(
            f"{source.name} covers the body {body} from {time_words(first)} to {time_words(last)}, "
            f"not all of {time_words(start_et)} to {time_words(end_et)}."
        )
    return center


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    handle = spiceypy.dafopr(str(path))
    try:
        yield handle
    finally:
        spiceypy.dafcls(handle)


# ---- Trajectories as SPK files: tables of states (type 13 or 9), and excerpts of other SPKs as they are.

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
    span_et: tuple[float, float] | None = (
        None  # what the segment serves; none: from the first state to the last
    )

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
            first, last = self.coverage_et
            if not self.et[0] <= first < last <= self.et[-1]:
                raise ValueError(
                    f"span {first} to {last} is not within the states, {self.et[0]} to {self.et[-1]}"
                )
        freeze_arrays(self)

    @property
    def coverage_et(self) -> tuple[float, float]:
        """First and last epoch that the segment serves."""
        return self.span_et or (float(self.et[0]), float(self.et[-1]))

    @property
    def degree(self) -> int:
        """Degree of the interpolating polynomial: of six states, or of all if there are fewer."""
        window = min(len(self.et), WINDOW_STATES)
        return 2 * window - 1 if self.interpolation == "hermite" else window - 1


def write_spk(
    path: str | os.PathLike[str], segments: Sequence[SpkSegment | SpkExcerpt], comment: str = ""
) -> None:
    """Write trajectories as an SPK file of type 13 (Hermite) or 9 (Lagrange) segments, or copied ones.

    Parameters
    ----------
    path : path
        An older file of that name is replaced once the new one is whole.
    segments
        Where two segments of one target overlap in time, SPICE uses the later one.
    comment
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
        if isinstance(segment, SpkSegment):
            require_frame(segment.frame)
    with new_daf(path, spiceypy.spkopn, spiceypy.spkcls, comment) as handle:
        for segment in segments:
            if isinstance(segment, SpkSegment):
                _add_spk_segment(handle, segment)
            else:
                copy_excerpt(handle, segment)


def _add_spk_segment(handle: int, s: SpkSegment) -> None:
    write = spiceypy.spkw13 if s.interpolation == "hermite" else spiceypy.spkw09
    title = f"{s.target} about {s.center}, {s.interpolation} {s.degree}"
    et, states = s.et.copy(), s.states.copy()  # spiceypy takes no read-only arrays
    write(handle, s.target, s.center, s.frame, *s.coverage_et, title, s.degree, len(et), states, et)


# ---- Attitudes as CK files of type 3.


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
    structure_id
        NAIF id of what is oriented, in a CK the id of its frame's class: -98000, the bus of New Horizons.
    spacecraft_id
        Whose clock the attitudes are tagged with.
    et : (n,) array_like
        Epochs, s past J2000 TDB, increasing.
    frame_from_reference : (n, 3, 3) or (n, 4) array_like
        Attitudes, ``v_frame = matrix @ v_reference``; or their SPICE quaternions, of any length but zero.
        Neighbours in one interval must be less than half a turn apart.
    angular_rates : (n, 3) array_like, optional
        Angular velocity of the frame, rad/s, components in `reference`; from the attitudes if not given.
    reference
        SPICE frame that the attitudes refer to.
    max_gap_s
        Neighbours further apart than this are not interpolated between.
    interval_starts
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
    with spice_call(SpiceRequest(f"reading of clock {spacecraft_id}", et), needs_kernels=True):
        return float(spiceypy.sce2c(spacecraft_id, et))
