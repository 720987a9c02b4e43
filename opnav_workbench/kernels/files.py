"""One kernel file, looked at before SPICE opens it: kind by content, wholeness, segments, checksum.

SPICE opens a truncated DAF without a word and fails later, or reads zeros. So the file record, the chain of summary
records and the numbers of a binary kernel are checked here without SPICE; text kernels are told by their KPL word,
their data or their suffix. What is found is remembered as long as a file's size and time of change stay. No checksum
exists inside kernels: a changed digit of a plausible number stays unseen. Shapes (DAS files) are tried out in a
supervised process.

Source: NAIF, DAF, SPK and CK Required Reading.
"""

import functools
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import KernelError
from opnav_workbench.files import sha256_of
from opnav_workbench.kernels.segment_layouts import layout_fault
from opnav_workbench.paths import regular_size
from opnav_workbench.supervised import TrialError, tried

__all__ = [
    "KINDS",
    "DafSegment",
    "KernelFile",
    "is_binary",
    "kernel_file",
    "looks_like_kernel",
    "read_segments",
    "segments",
]


# ---- Binary SPICE kernels read without SPICE: whether a file is whole, and which segments it holds.

RECORD_BYTES = 1024
WORD_BYTES = 8
CONTROL = 3  # words that begin a summary record: next record, previous record, number of summaries
LARGEST_VALUE = 1e30  # km, s, ticks, Chebyshev coefficients: flight kernels stay below 1e20
DEEP_CHECK_BYTES = 1 << 30  # of larger files only the structure is checked: the numbers would take seconds
FTP_STRING = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"  # any text-mode transfer alters it
ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}


@dataclass(frozen=True, slots=True)
class DafSegment:
    """One segment's summary. SPK: target, center, frame, type; CK: structure, frame, type, rates flag."""

    doubles: tuple[float, float]  # SPK, PCK: et; CK: encoded clock ticks
    integers: tuple[int, ...]  # the last two: first and last word, counted from 1

    @property
    def words(self) -> slice:
        """Where the segment's numbers stand among the file's 8-byte words."""
        return slice(self.integers[-2] - 1, self.integers[-1])

    def data_type(self, kind: str) -> int:
        """Return the type by which SPICE reads the numbers of a segment of a kind of kernel."""
        return self.integers[2 if kind == "CK" else -3]


@dataclass(frozen=True, slots=True)
class _Header:
    order: str  # struct's sign of the byte order
    doubles: int  # per summary
    integers: int
    first_record: int
    last_record: int
    free_word: int

    @property
    def summary(self) -> struct.Struct:
        return struct.Struct(f"{self.order}{self.doubles}d{self.integers}i{4 * (self.integers % 2)}x")


def read_segments(path: Path, kind: str) -> tuple[DafSegment, ...]:
    """Return the segments of a binary SPK, CK or PCK, after a look at its structure and numbers.

    Parameters
    ----------
    path
        A file whose first word says DAF.
    kind
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
    first, last, free = struct.unpack_from(f"{order}3i", record, 76)
    if (b"FTPSTR" in record or b"ENDFTP" in record) and FTP_STRING not in record:  # old files have none
        raise _damaged(path, "it went through a text-mode transfer, which altered bytes")
    if (doubles, integers) != (2, 5 if kind == "PCK" else 6) or first < 2 or free < 2:
        raise _damaged(path, "its file record holds impossible numbers")
    return _Header(order, doubles, integers, first, last, free)


def _summary_records(
    path: Path, data: np.ndarray[Any, np.dtype[np.uint8]], header: _Header
) -> Iterator[bytes]:
    """Follow the chain of summary records, which must neither leave the file nor turn back.

    SPICE follows it from its end, so that each record must name the one before it, and the file record the last.
    """
    number, before, seen = header.first_record, 0, set[int]()
    while number:
        record = data[(number - 1) * RECORD_BYTES : number * RECORD_BYTES].tobytes() if number > 0 else b""
        if len(record) < RECORD_BYTES or number in seen:
            raise _damaged(path, f"its chain of segment summaries breaks at record {number}")
        seen.add(number)
        following, previous, count = struct.unpack_from(f"{header.order}3d", record)
        room = (RECORD_BYTES - CONTROL * WORD_BYTES) // header.summary.size
        whole = 0 <= count <= room and following >= 0 and count % 1 == following % 1 == 0
        if not (whole and previous == before):
            raise _damaged(path, f"its summary record {number} holds impossible numbers")
        yield record
        number, before = int(following), number
    if header.last_record != before:
        raise _damaged(path, f"its file record names {header.last_record} as the last record of summaries")


def _summaries(record: bytes, header: _Header) -> Iterator[DafSegment]:
    count = int(struct.unpack_from(f"{header.order}3d", record)[2])
    start = CONTROL * WORD_BYTES
    for values in header.summary.iter_unpack(record[start : start + count * header.summary.size]):
        yield DafSegment(values[: header.doubles], values[header.doubles :])


def _fault(segment: DafSegment, words: FloatArray, kind: str, *, deep: bool) -> str:
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
    rates = kind == "CK" and segment.integers[3] == 1
    return layout_fault(kind, segment.data_type(kind), values, segment.doubles, rates=rates)


# ---- One kernel file: its kind by its content, its wholeness, its checksum; each found once per file state.

KINDS = (
    "LSK",
    "SCLK",
    "PCK",
    "FK",
    "IK",
    "SPK",
    "CK",
    "DSK",
    "EK",
    "TEXT",
    "META",
)  # a folder's loading order
BINARY_KINDS = {b"DAF/SPK": "SPK", b"DAF/CK": "CK", b"DAF/PCK": "PCK", b"DAS/DSK": "DSK", b"DAS/EK": "EK"}
TRIALS = {
    "DSK": "kernels/kernel_trial.py:try_dsk",
    "EK": "kernels/kernel_trial.py:try_ek",
}  # DAS files: not checked here
TEXT_KINDS = {f"KPL/{k}".encode(): k for k in ("LSK", "SCLK", "PCK", "FK", "IK")} | {b"KPL/MK": "META"}
# Text kernels need no identification word; the suffix then tells the kind.
SUFFIX_KINDS = {
    ".tls": "LSK", ".tsc": "SCLK", ".tpc": "PCK", ".tf": "FK", ".ti": "IK",
    ".bsp": "SPK", ".bc": "CK", ".bpc": "PCK", ".bds": "DSK", ".tm": "META", ".mk": "META", ".furnsh": "META",
}  # fmt: skip
LISTS_KERNELS = re.compile(rb"^\s*KERNELS_TO_LOAD\s*\+?=", re.MULTILINE)
TRANSFER_WORDS = (b"DAFETF", b"DASETF")
LARGEST_TEXT_BYTES = 1 << 28  # a text kernel beyond this is no text kernel
SHOWN_BYTES = 24


@dataclass(frozen=True, slots=True)
class KernelFile:
    """A kernel: its absolute path, and its kind as its content says."""

    path: Path
    kind: str  # SPK, CK, PCK, IK, FK, LSK, SCLK, DSK, EK, META, or TEXT where nothing tells more

    @property
    def sha256(self) -> str:
        """SHA-256 in hexadecimal, computed when first asked for and again only if the file has changed."""
        return _sha256(str(self.path), *_state(self.path))


def kernel_file(path: Path) -> KernelFile:
    """Look at a kernel file before SPICE does.

    Raises
    ------
    KernelError
        The file cannot be read, is not a kernel, or is a binary kernel cut short or damaged.
    """
    kind, _ = _inspect(str(path), *_state(path))
    return KernelFile(path, kind)


def segments(path: Path) -> tuple[DafSegment, ...]:
    """Return the segment summaries of a binary SPK, CK or PCK; none for other kernels."""
    return _inspect(str(path), *_state(path))[1]


def is_binary(path: Path) -> bool:
    """Tell a binary kernel from a text kernel, by its first word."""
    with path.open("rb") as stream:
        return stream.read(8).rstrip(b" \x00") in BINARY_KINDS


def looks_like_kernel(path: Path) -> bool:
    """Tell whether a file of a folder is meant as a kernel, by suffix or content; labels, notes are not."""
    if path.suffix.lower() in SUFFIX_KINDS:
        return True
    with path.open("rb") as stream:
        word = stream.read(SHOWN_BYTES)
    return any(word.startswith(known) for known in (*BINARY_KINDS, *TEXT_KINDS))


def _state(path: Path) -> tuple[int, int, int]:
    """Return both times of change, since a copy may keep that of what it is a copy of, and the size."""
    try:
        size = regular_size(path)  # a pipe would block
        status = path.stat()
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}; check the path.") from error
    return status.st_mtime_ns, status.st_ctime_ns, size


@functools.lru_cache(maxsize=1024)
def _sha256(path: str, mtime_ns: int, ctime_ns: int, size: int) -> str:  # noqa: ARG001 (the file's state is the cache's key)
    return sha256_of(path)


@functools.lru_cache(maxsize=1024)
def _inspect(path: str, mtime_ns: int, ctime_ns: int, size: int) -> tuple[str, tuple[DafSegment, ...]]:  # noqa: ARG001
    file = Path(path)
    try:
        with file.open("rb") as stream:
            start = stream.read(RECORD_BYTES)
            word = start[:8].rstrip(b" \x00")
            if word in BINARY_KINDS:
                return _inspect_binary(file, word, size)
            text = start + stream.read(LARGEST_TEXT_BYTES)
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}; check its permissions.") from error
    return _text_kind(file, text), ()


def _inspect_binary(file: Path, word: bytes, size: int) -> tuple[str, tuple[DafSegment, ...]]:
    kind = BINARY_KINDS[word]
    if word.startswith(b"DAF"):
        return kind, read_segments(file, kind)
    if size % RECORD_BYTES:
        raise KernelError(
            f"{file} is not a whole kernel: {size} bytes are no multiple of {RECORD_BYTES}; fetch it again."
        )
    try:
        tried(TRIALS[kind], str(file))
    except TrialError as error:
        raise _damaged(file, str(error)) from error
    return kind, ()


def _text_kind(file: Path, text: bytes) -> str:
    if text.startswith(TRANSFER_WORDS):
        raise KernelError(f"{file} is a kernel in transfer format; make it binary with NAIF's TOBIN first.")
    if b"\x00" in text or b"\\begindata" not in text:
        shown = text[:SHOWN_BYTES].decode("ascii", "backslashreplace").split("\n")[0]
        reason = "zero bytes within text" if b"\\begindata" in text else f"it starts with {shown!r}"
        if text.startswith(b"KPL/") and b"\x00" not in text:
            reason = f"it says {shown!r} but has no \\begindata and so no data"
        raise KernelError(
            f"{file} is not a SPICE kernel: {reason} ({len(text)} bytes); fetch it again or give another."
        )
    if any(LISTS_KERNELS.search(part.split(b"\\begintext")[0]) for part in text.split(b"\\begindata")[1:]):
        return "META"
    named = next((kind for word, kind in TEXT_KINDS.items() if text.startswith(word)), None)
    return named or SUFFIX_KINDS.get(file.suffix.lower(), "TEXT")
