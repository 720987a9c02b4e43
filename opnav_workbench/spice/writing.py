"""Trajectories as SPK files: tables of states (type 13 or 9), and excerpts of other SPKs as they are.

The writer checks its input first, writes under a temporary name and renames: a file that is there is whole.

Source: NAIF, SPK Required Reading (types 9 and 13).
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import spiceypy

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.spice.excerpts import SpkExcerpt, copy_excerpt
from opnav_workbench.spice.newfile import (
    as_kernel_error,
    check_epochs,
    check_finite,
    new_daf,
    require_frame,
)

__all__ = ["SpkSegment", "write_spk"]

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
    segments : sequence of SpkSegment or SpkExcerpt
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
