"""Catalogs over a store of stars: the one search of a region, the stores, and the index of the sky.

A `StoredCatalog` asks a `StarStore` for candidates near a direction, tests them exactly and builds the rows of
those that stay. Stores are arrays in memory (`ArrayStore`), memory-mapped records (`cache.RecordStore`) or zone
files (`zones.ZoneStore`). `SkyIndex` orders stars by bands of declination and, within a band, by right ascension:
candidates for a cone without looking at every star. A search at another epoch reaches as far as the catalog's
fastest star may have moved (`MotionBound`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.proper_motion import with_mean_motion
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.geometry import angle_between, jyear_from_et, unit_from_radec

__all__ = [
    "Candidates",
    "IndexedCatalog",
    "MotionBound",
    "SkyIndex",
    "StoredCatalog",
    "ra_spans",
    "sort_keys",
]


# ---- Where on the sky the stars of a catalog stand: candidates for a cone without looking at every star.

BAND_RAD = np.pi / 360.0  # declination bands of half a degree: a narrow camera's cone touches two or three
GUARD_RAD = 1e-9  # widens the search beyond rounding of the sort keys; the caller's exact test decides
LAST_BAND = np.ceil(np.pi / BAND_RAD) - 1.0
TURN_RAD = 2.0 * np.pi
BELOW_ONE = np.nextafter(1.0, 0.0)


class SkyIndex:
    """Stars sorted by declination band and, within a band, by right ascension.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) ndarray
        Positions; any right ascension, declination within +-pi/2.
    keys : (n,) ndarray, optional
        Their `sort_keys` where the stars stand in that order already, memory-mapped or not; the positions are not
        looked at then.

    Examples
    --------
    >>> index = SkyIndex(np.array([0.1, 6.2, 3.0]), np.array([0.0, 0.0, 0.0]))
    >>> [int(row) for row in np.sort(index.candidates(0.0, 0.0, 0.2))]
    [0, 1]
    """

    __slots__ = ("_keys", "_order")

    def __init__(self, ra_rad: FloatArray, dec_rad: FloatArray, *, keys: FloatArray | None = None) -> None:
        self._order: IntArray | None = None
        if keys is None:
            keys = sort_keys(ra_rad, dec_rad)
            if np.any(keys[1:] < keys[:-1]):
                self._order = np.argsort(keys, kind="stable")
                keys = keys[self._order]
        self._keys = keys

    def candidates(self, ra_rad: float, dec_rad: float, radius_rad: float) -> IntArray:
        """Return rows that contain every star within `radius_rad` of a direction, and a few beyond it."""
        reach = radius_rad + GUARD_RAD
        first, last = (
            int(_declination_band(np.asarray(edge))) for edge in (dec_rad - reach, dec_rad + reach)
        )
        spans = ra_spans(ra_rad, dec_rad, reach)
        if spans == [(0.0, 1.0)]:
            return self._rows([(float(first), float(last + 1))])
        return self._rows([(band + a, band + b) for band in range(first, last + 1) for a, b in spans])

    def _rows(self, key_ranges: list[tuple[float, float]]) -> IntArray:
        starts = np.searchsorted(self._keys, [low for low, _ in key_ranges], side="left")
        stops = np.searchsorted(self._keys, [high for _, high in key_ranges], side="right")
        # In ascending order; ranges that meet at a key may both hold the star that stands on it.
        order = np.argsort(starts, kind="stable")
        starts, stops = starts[order], stops[order]
        starts[1:] = np.maximum(starts[1:], np.maximum.accumulate(stops)[:-1])
        length = np.maximum(stops - starts, 0)
        ends = np.cumsum(length)
        places = np.arange(ends[-1]) + np.repeat(starts - (ends - length), length)
        return np.asarray(places if self._order is None else self._order[places])


def ra_spans(ra_rad: float, dec_rad: float, radius_rad: float) -> list[tuple[float, float]]:
    """Return the ranges of right ascension, in turns of 0 to 1, that a cone meets: one, or two across RA 0.

    Examples
    --------
    >>> [(round(a, 3), round(b, 3)) for a, b in ra_spans(0.0, 0.0, 0.02 * np.pi)]
    [(0.0, 0.01), (0.99, 1.0)]
    >>> ra_spans(1.0, 1.5, 0.1)
    [(0.0, 1.0)]
    """
    if abs(dec_rad) + radius_rad >= 0.5 * np.pi:  # the cone holds a pole, so it meets every right ascension
        return [(0.0, 1.0)]
    half = (np.arcsin(np.sin(radius_rad) / np.cos(dec_rad)) + GUARD_RAD) / TURN_RAD
    center = (ra_rad / TURN_RAD) % 1.0
    low, high = float(center - half), float(center + half)
    if high - low >= 1.0:
        return [(0.0, 1.0)]
    spans = [(max(low, 0.0), min(high, 1.0))]
    spans += [(low + 1.0, 1.0)] if low < 0.0 else []
    spans += [(0.0, high - 1.0)] if high > 1.0 else []
    return spans


def sort_keys(ra_rad: FloatArray, dec_rad: FloatArray) -> FloatArray:
    """Return band number plus fraction of a turn in right ascension (n,): the order of a `SkyIndex`."""
    turns = np.minimum((ra_rad / TURN_RAD) % 1.0, BELOW_ONE)
    return np.asarray(_declination_band(dec_rad) + turns)


def _declination_band(dec_rad: FloatArray) -> FloatArray:
    bands = np.floor((np.clip(dec_rad, -0.5 * np.pi, 0.5 * np.pi) + 0.5 * np.pi) / BAND_RAD)
    return np.asarray(np.minimum(bands, LAST_BAND))


# ---- Where a catalog keeps its stars: what the one search of `IndexedCatalog` asks of any of them.


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
    build
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


# ---- Catalogs over any `StarStore`: the search of a region, at the catalog's epoch or another.

# Linear space motion speeds up a star that comes nearer: 0.013 % a year for Barnard's star, the fastest
# known, so that this holds for four centuries about the epoch.
APPROACH_MARGIN = 1.05


@dataclass(frozen=True, slots=True)
class MotionBound:
    """How far any star of a catalog may have moved: its fastest motion and the range of its epochs."""

    fastest_rad_yr: float
    first_jyear: float
    last_jyear: float

    def reach_rad(self, et_s: float) -> float:
        """Return an upper bound of the angle between any star's catalog position and its place at `et_s`."""
        jyear = float(jyear_from_et(et_s))
        years = max(abs(jyear - self.first_jyear), abs(jyear - self.last_jyear))
        return APPROACH_MARGIN * self.fastest_rad_yr * years


class StoredCatalog(Catalog):
    """A catalog over a `StarStore`.

    Parameters
    ----------
    name
        The spec that opens this catalog.
    facts
        What `describe` reports beside the number of stars and the magnitude limits.
    store
        Where the stars are.
    motion
        Bounds the motion of every star, so that a search at another epoch misses none.
    """

    __slots__ = ("_facts", "_motion", "_store")

    def __init__(self, name: str, facts: Mapping[str, Any], store: StarStore, motion: MotionBound) -> None:
        self.name = name
        self._facts, self._store, self._motion = dict(facts), store, motion

    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is: source, number of stars, epochs, bands, limits."""
        return {
            "name": self.name,
            **self._store.summary(),
            "first_epoch_jyear": self._motion.first_jyear,
            "last_epoch_jyear": self._motion.last_jyear,
            **self._facts,
        }

    def search(
        self, region: Region, mag_limit: float, et_s: float | None, exclude_flags: StarQuality
    ) -> StarTable:
        """Return the stars within a region, brightest first; see `Catalog.search`."""
        reach = region.radius_rad + (0.0 if et_s is None else self._motion.reach_rad(et_s))
        reach = min(reach, math.pi)
        x, y, z = region.center.tolist()
        ra, dec = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
        found = self._store.near(ra, dec, reach)
        places = unit_from_radec(found.ra_rad, found.dec_rad)
        inside = region.contains(places) if et_s is None else angle_between(places, region.center) <= reach
        mag = self._store.mag(found)
        chosen = np.flatnonzero(inside & (mag <= mag_limit))
        chosen = chosen[np.argsort(mag[chosen], kind="stable")]
        found = found.take(chosen)
        if exclude_flags:
            found = found.take((self._store.flags(found) & int(exclude_flags)) == 0)
        stars = self._store.build(found)
        if et_s is not None:
            stars = stars.take(region.contains(stars.directions(et_s)))
        return with_mean_motion(stars)


class IndexedCatalog(StoredCatalog):
    """A catalog in memory; see `ArrayStore` for the columns and `StoredCatalog` for the rest."""

    __slots__ = ()

    def __init__(
        self,
        name: str,
        facts: Mapping[str, Any],
        ra_rad: FloatArray,
        dec_rad: FloatArray,
        mag: FloatArray,
        build: Callable[[IntArray], StarTable],
        motion: MotionBound,
        flags: NDArray[Any] | None = None,
    ) -> None:
        super().__init__(name, facts, ArrayStore(ra_rad, dec_rad, mag, build, flags), motion)
