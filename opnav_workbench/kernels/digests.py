"""What kernels say of a time, as digests: equal where every answer at that time is the same.

An SPK, CK or binary PCK counts by its segments, each for its own span of time; all other kernels hold at any time.  Names
and places of files do not count, their order does: later ones outrank.  A metakernel is what it lists; of itself only what
it assigns besides counts.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from opnav_workbench.errors import KernelError
from opnav_workbench.files import HASH_CHUNK_BYTES, digest
from opnav_workbench.kernels import coverage, pool
from opnav_workbench.kernels.calls import spice_call
from opnav_workbench.kernels.files import DafSegment, KernelFile, segments
from opnav_workbench.kernels.loading import META_VARIABLES, LoadedKernels
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = ["KernelPart", "kernel_parts"]

# A target is seen where it was a light time ago: from anywhere within 170 au less than this.
LIGHT_TIME_S = 86_400.0
WORD_BYTES = 8


@dataclass(frozen=True, slots=True)
class KernelPart:
    """A kernel file, or what it holds of one span of time.

    Attributes
    ----------
    name
        Of the file, for people.
    sha256
        Of the content.
    start_et, stop_et
        TDB s past J2000; infinite for what holds at any time.
    """

    name: str
    sha256: str
    start_et: float = -np.inf
    stop_et: float = np.inf

    def matters_at(self, et: float | None) -> bool:
        """Tell whether a picture of this time may ask it; one of unknown time may ask all."""
        return et is None or (self.start_et <= et and et - LIGHT_TIME_S <= self.stop_et)


def kernel_parts(kernels: LoadedKernels) -> tuple[KernelPart, ...]:
    """Return all parts of the open kernels in loading order, and one that says which spacecraft and structures they know.

    The last one tells a kernel that does not cover a time from one that is not there: without any CK the header's attitude
    serves, without any SPK of the spacecraft its state.

    Raises
    ------
    KernelError
        A file cannot be read.
    """
    with spice_call("digests of the kernels"):
        parts = [part for file in kernels.kernels() for part in _parts_of(file)]
        spacecraft = [body for body in coverage.held_bodies("SPK") if body < 0]
        known = [spacecraft, coverage.held_bodies("CK")]
    return (*parts, KernelPart("spacecraft and structures", digest(known)))


def _parts_of(file: KernelFile) -> Iterator[KernelPart]:
    held = segments(file.path)
    if file.kind == "META":
        yield from _own_values(file.path)
    elif not held:
        yield KernelPart(file.path.name, file.sha256)
    else:
        try:
            with file.path.open("rb") as stream:
                for segment in held:
                    yield _segment_part(file, segment, stream)
        except OSError as error:
            raise KernelError(f"cannot read {file.path}: {error.strerror}; check its permissions.") from error


def _segment_part(file: KernelFile, segment: DafSegment, stream: BinaryIO) -> KernelPart:
    what = segment.words
    summed = hashlib.sha256(repr((file.kind, segment.doubles, segment.integers[:-2])).encode())
    stream.seek(what.start * WORD_BYTES)  # not mapped: a file cut short meanwhile would end this process
    left = (what.stop - what.start) * WORD_BYTES
    while left > 0 and (piece := stream.read(min(left, HASH_CHUNK_BYTES))):
        summed.update(piece)
        left -= len(piece)
    start, stop = segment.doubles
    if file.kind == "CK":
        start, stop = _times_of_ticks(segment)
    return KernelPart(file.path.name, summed.hexdigest(), start, stop)


def _times_of_ticks(segment: DafSegment) -> tuple[float, float]:
    """Return a CK segment's span; without its clock it may hold at any time."""
    try:
        clock = spiceypy.ckmeta(segment.integers[0], "SCLK")
        start, stop = (float(spiceypy.sct2e(clock, ticks)) for ticks in segment.doubles)
    except spiceypy.SpiceyError:
        return -np.inf, np.inf
    return start, stop


def _own_values(metakernel: Path) -> Iterator[KernelPart]:
    """What a metakernel assigns besides the list of files."""
    with pool.isolated():
        spiceypy.ldpool(str(metakernel))
        values = {n: pool.pool_value(n) for n in pool.pool_names("*") if n not in META_VARIABLES}
    if values:
        yield KernelPart(metakernel.name, digest(values))
