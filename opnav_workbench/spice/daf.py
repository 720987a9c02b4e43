"""Binary SPICE kernels read without SPICE: is the file whole, and which segments does it hold?

SPICE opens a truncated DAF without a word and fails later, or reads zeros. So the file record, the chain of summary
records and the numbers themselves are looked at before a file is furnished.

Source: NAIF, DAF Required Reading (file record, summary records, FTP validation string).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from opnav_workbench.errors import KernelError

__all__ = ["Segment", "read_daf", "require_whole"]

RECORD_BYTES = 1024
WORD_BYTES = 8
SUMMARY_CONTROL_WORDS = 3  # next record, previous record, number of summaries
LARGEST_VALUE = 1e30  # km, s, ticks, Chebyshev coefficients: flight kernels stay below 1e20
DEEP_CHECK_BYTES = 1 << 30  # larger files get their structure checked, not each number: it would take seconds
FTP_STRING = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"  # any text-mode transfer alters it
FTP_OFFSET_BYTES = 699
ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}
DOUBLES_INTEGERS = {"SPK": (2, 6), "CK": (2, 6), "PCK": (2, 5)}  # per summary


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment's summary; for a CK: structure, reference frame, type, rates flag, first and last word."""

    doubles: tuple[float, ...]
    integers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Layout:
    order: str
    n_doubles: int
    n_integers: int
    first_record: int
    last_record: int
    free_word: int

    @property
    def summary(self) -> struct.Struct:
        padding = 4 * (self.n_integers % 2)
        return struct.Struct(f"{self.order}{self.n_doubles}d{self.n_integers}i{padding}x")


def read_daf(path: Path, kind: str) -> tuple[Segment, ...]:
    """Return the segments of a binary SPK, CK or PCK, after a look at its structure.

    Parameters
    ----------
    path : Path
        A file whose first word says DAF.
    kind : str
        "SPK", "CK" or "PCK".

    Raises
    ------
    KernelError
        The file is cut short or its structure is damaged.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(RECORD_BYTES)
            layout = _layout(path, data, kind)
            size = path.stat().st_size
            if size < (layout.free_word - 1) * WORD_BYTES:
                raise _damaged(path, f"cut short: {size} bytes of at least {(layout.free_word - 1) * WORD_BYTES}")
            segments: list[Segment] = []
            for record in _summary_records(path, stream.read, stream.seek, layout):
                segments.extend(_summaries(path, record, layout))
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}.") from error
    _require_ordered(path, segments, kind)
    return tuple(segments)
