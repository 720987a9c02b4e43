"""Where a catalog keeps its stars: what the one search of `indexed` asks of any of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.sky import SkyIndex
from opnav_workbench.catalog.table import StarTable

__all__ = ["ArrayStore", "Candidates", "StarStore"]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Stars that a search looks at before any row of a table is built; columns (k,)."""

    rows: IntArray  # the store's own numbers of the stars; they ascend as `near` gives them
    ra_rad: FloatArray
    dec_rad: FloatArray
    records: NDArray[Any] | None = None  # as the store read them, where it reads whole records

    def take(self, which: IntArray | BoolArray) -> "Candidates":
        """Return some of them, by index or mask."""
        records = self.records
        if records is not None:
            # As plain bytes: numpy copies the fields of a record one by one, five times slower.
            records = records.view(f"V{records.itemsize}")[which].view(records.dtype)
        return Candidates(self.rows[which], self.ra_rad[which], self.dec_rad[which], records)


class StarStore(Protocol):
    """Stars on the sky: candidates near a direction, and what is known of some of them."""

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return candidates that contain every star within `radius_rad` of a direction, and a few beyond it."""

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes (k,)."""

    def flags(self, found: Candidates) -> IntArray:
        """Return the `StarQuality` flags (k,)."""

    def build(self, found: Candidates) -> StarTable:
        """Return the stars, in their order."""

    def summary(self) -> Mapping[str, Any]:
        """Return at least ``n_stars``, ``brightest_mag`` and ``faintest_mag``."""


class ArrayStore:
    """Stars in memory: positions and magnitudes of all, their rows built only when asked for.

    Parameters
    ----------
    ra_rad, dec_rad, mag : (n,) ndarray
        Position (rad, J2000, at each star's epoch) and magnitude of every star.
    build : callable
        Turns row numbers (k,) into the StarTable of these rows, in their order.
    flags : (n,) ndarray of int, optional
        `StarQuality` flags; none: nothing is known against any star.
    """

    __slots__ = ("_build", "_dec_rad", "_flags", "_index", "_mag", "_ra_rad")

    def __init__(
        self,
        ra_rad: FloatArray,
        dec_rad: FloatArray,
        mag: FloatArray,
        build: Callable[[IntArray], StarTable],
        flags: NDArray[Any] | None = None,
    ) -> None:
        self._ra_rad, self._dec_rad, self._flags, self._build = ra_rad, dec_rad, flags, build
        # A float32 column would be compared with a limit in float32, its rows come out in float64.
        self._mag = np.asarray(mag, dtype=np.float64)
        self._index = SkyIndex(ra_rad, dec_rad)

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars of the index ranges that the cone meets."""
        rows = np.sort(self._index.candidates(ra_rad, dec_rad, radius_rad))
        return Candidates(rows, self._ra_rad[rows], self._dec_rad[rows])

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes."""
        return self._mag[found.rows]

    def flags(self, found: Candidates) -> IntArray:
        """Return the flags."""
        none = np.zeros(len(found.rows), dtype=np.int64)
        return none if self._flags is None else self._flags[found.rows].astype(np.int64)

    def build(self, found: Candidates) -> StarTable:
        """Return the stars of these rows."""
        return self._build(found.rows)

    def summary(self) -> Mapping[str, Any]:
        """Return the number of stars and the limits of their magnitudes."""
        return {
            "n_stars": int(self._mag.size),
            "brightest_mag": float(self._mag.min()),
            "faintest_mag": float(self._mag.max()),
        }
