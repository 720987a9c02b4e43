"""Binary SPICE kernels read without SPICE: whether a file is whole, and which segments it holds.

SPICE opens a truncated DAF without a word and fails later, or reads zeros. So the file record, the chain of
summary records and the numbers themselves are looked at before a file is furnished. No checksum exists: a
changed digit of a plausible number stays unseen.

Source: NAIF, DAF, SPK and CK Required Reading.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import KernelError

__all__ = ["Segment", "read_segments"]

RECORD_BYTES = 1024
WORD_BYTES = 8
CONTROL = 3  # words that begin a summary record: next record, previous record, number of summaries
LARGEST_VALUE = 1e30  # km, s, ticks, Chebyshev coefficients: flight kernels stay below 1e20
DEEP_CHECK_BYTES = 1 << 30  # of larger files only the structure is checked: the numbers would take seconds
UNIT_TOLERANCE = 1e-2  # quaternion norm; writers differ in rounding, damage shows far beyond this
STEP_TOLERANCE_S = 1.0  # Chebyshev record midpoints against the even spacing that the segment promises
FTP_STRING = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"  # any text-mode transfer alters it
ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment's summary. SPK: target, center, frame, type; CK: structure, frame, type, rates flag."""

    doubles: tuple[float, float]  # SPK, PCK: et; CK: encoded clock ticks
    integers: tuple[int, ...]  # the last two: first and last word, counted from 1

    @property
    def words(self) -> slice:
        """Where the segment's numbers stand among the file's 8-byte words."""
        return slice(self.integers[-2] - 1, self.integers[-1])


@dataclass(frozen=True, slots=True)
class _Header:
    order: str  # struct's sign of the byte order
    doubles: int  # per summary
    integers: int
    first_record: int
    free_word: int

    @property
    def summary(self) -> struct.Struct:
        return struct.Struct(f"{self.order}{self.doubles}d{self.integers}i{4 * (self.integers % 2)}x")


def read_segments(path: Path, kind: str) -> tuple[Segment, ...]:
    """Return the segments of a binary SPK, CK or PCK, after a look at its structure and numbers.

    Parameters
    ----------
    path : Path
        A file whose first word says DAF.
    kind : str
        "SPK", "CK" or "PCK".

    Raises
    ------
    KernelError
        The file is cut short, altered by a text-mode transfer or damaged.
    """
    try:
        size = path.stat().st_size
        if size < RECORD_BYTES:
            raise _damaged(path, f"it is cut short: {size} bytes, less than one record")
        data = np.memmap(path, dtype=np.uint8, mode="r")
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}; check its permissions.") from error
    header = _header(path, data, kind)
    if size < (needed := (header.free_word - 1) * WORD_BYTES):
        raise _damaged(path, f"it is cut short: {size} bytes where its own record says {needed}")
    segments = tuple(s for record in _summary_records(path, data, header) for s in _summaries(record, header))
    words = data[: size // WORD_BYTES * WORD_BYTES].view(f"{header.order}f8")
    for number, segment in enumerate(segments, start=1):
        fault = _fault(segment, words, kind, deep=size <= DEEP_CHECK_BYTES)
        if fault:
            raise _damaged(path, f"segment {number} of {len(segments)}: {fault}")
    return segments


def _damaged(path: Path, reason: str) -> KernelError:
    return KernelError(f"{path} is not a whole kernel: {reason}; fetch or build it again.")


def _header(path: Path, data: np.ndarray[Any, np.dtype[np.uint8]], kind: str) -> _Header:
    record = data[:RECORD_BYTES].tobytes()
    order = ORDERS.get(record[88:96], "<")  # files of the 1990s leave it blank: native order
    doubles, integers = struct.unpack_from(f"{order}2i", record, 8)
    first, _, free = struct.unpack_from(f"{order}3i", record, 76)
    if (b"FTPSTR" in record or b"ENDFTP" in record) and FTP_STRING not in record:  # old files have none
        raise _damaged(path, "it went through a text-mode transfer, which altered bytes")
    if (doubles, integers) != (2, 5 if kind == "PCK" else 6) or first < 2 or free < 2:
        raise _damaged(path, "its file record holds impossible numbers")
    return _Header(order, doubles, integers, first, free)


def _summary_records(
    path: Path, data: np.ndarray[Any, np.dtype[np.uint8]], header: _Header
) -> Iterator[bytes]:
    """Follow the chain of summary records, which must neither leave the file nor turn back."""
    number, seen = header.first_record, set[int]()
    while number:
        record = data[(number - 1) * RECORD_BYTES : number * RECORD_BYTES].tobytes() if number > 0 else b""
        if len(record) < RECORD_BYTES or number in seen:
            raise _damaged(path, f"its chain of segment summaries breaks at record {number}")
        seen.add(number)
        following, _, count = struct.unpack_from(f"{header.order}3d", record)
        room = (RECORD_BYTES - CONTROL * WORD_BYTES) // header.summary.size
        if not (0 <= count <= room and following >= 0 and count % 1 == following % 1 == 0):
            raise _damaged(path, f"its summary record {number} holds impossible numbers")
        yield record
        number = int(following)


def _summaries(record: bytes, header: _Header) -> Iterator[Segment]:
    count = int(struct.unpack_from(f"{header.order}3d", record)[2])
    start = CONTROL * WORD_BYTES
    for values in header.summary.iter_unpack(record[start : start + count * header.summary.size]):
        yield Segment(values[: header.doubles], values[header.doubles :])


def _fault(segment: Segment, words: FloatArray, kind: str, *, deep: bool) -> str:
    """Return what is wrong with one segment, or nothing."""
    begin, end = segment.doubles
    where = segment.words
    if not (begin <= end and max(abs(begin), abs(end)) < LARGEST_VALUE):
        return f"impossible time span {begin:g} to {end:g}"
    if not 0 < where.start < where.stop <= len(words):
        return f"words {where.start + 1} to {where.stop} of a file of {len(words)}"
    if not deep:
        return ""
    values = words[where]
    if not (np.abs(values) < LARGEST_VALUE).all():  # false for nan, too
        return "numbers that no kernel holds"
    check = LAYOUT_CHECKS.get((kind, segment.integers[2 if kind == "CK" else -3]))
    return "its bookkeeping contradicts its size or itself" if check and not check(values) else ""


def _chebyshev_holds(values: FloatArray) -> bool:
    """SPK, PCK types 2, 3: equal records (midpoint, radius, coefficients); then start, step, size, count."""
    start, step, size, count = values[-4:]
    if not (size >= 3 and count >= 1 and size % 1 == count % 1 == 0 and size * count + 4 == len(values)):
        return False
    midpoints, radii = values[:-4].reshape(int(count), int(size))[:, :2].T
    expected = start + step * (np.arange(int(count)) + 0.5)
    return bool((np.abs(midpoints - expected) < STEP_TOLERANCE_S).all() and (radii > 0).all())


def _state_table_holds(values: FloatArray) -> bool:
    """SPK types 9 and 13: n states, n epochs, every 100th epoch, degree, n."""
    count = values[-1]
    if not (count >= 1 and count % 1 == 0 and 7 * count + (count - 1) // 100 + 2 == len(values)):
        return False
    n = int(count)
    epochs, directory = values[6 * n : 7 * n], values[7 * n : -2]
    return bool((np.diff(epochs) > 0).all() and np.array_equal(directory, epochs[99::100][: len(directory)]))


def _pointing_table_holds(values: FloatArray) -> bool:
    """CK type 3: n quaternions (with rates or not), n clock ticks, interval starts, directories, counts."""
    n_intervals, n = values[-2:]
    if not (n >= 1 and n_intervals >= 1 and n % 1 == n_intervals % 1 == 0):
        return False
    rest = len(values) - 2 - n - n_intervals - (n - 1) // 100 - (n_intervals - 1) // 100
    if rest not in (4 * n, 7 * n):
        return False
    packets = values[: int(rest)].reshape(int(n), -1)
    norms = np.linalg.norm(packets[:, :4], axis=1)
    ticks = values[int(rest) : int(rest + n)]
    return bool((np.abs(norms - 1.0) < UNIT_TOLERANCE).all() and (np.diff(ticks) > 0).all())


LAYOUT_CHECKS = {
    ("SPK", 2): _chebyshev_holds,
    ("SPK", 3): _chebyshev_holds,
    ("PCK", 2): _chebyshev_holds,
    ("SPK", 9): _state_table_holds,
    ("SPK", 13): _state_table_holds,
    ("CK", 3): _pointing_table_holds,
}
