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
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.proper_motion import with_mean_motion
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Cone, Region
from opnav_workbench.catalog.star_table import DeferredStars, StarTable
from opnav_workbench.geometry import jyear_from_et, unit_from_radec

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
        return self.rows(self.places(ra_rad, dec_rad, radius_rad))

    def rows(self, places: IntArray) -> IntArray:
        """Return the rows of the stars that stand at these places of the sky's order."""
        return places if self._order is None else self._order.take(places)

    def places(self, ra_rad: float, dec_rad: float, radius_rad: float) -> IntArray:
        """Return the places in the sky's order of every star within `radius_rad` of a direction, and of a few beyond it."""
        reach = radius_rad + GUARD_RAD
        first, last = _band_of(dec_rad - reach), _band_of(dec_rad + reach)
        spans = ra_spans(ra_rad, dec_rad, reach)
        if len(spans) > 1:
            spans.sort()
        elif spans[0] == (0.0, 1.0):
            return self._between([float(first), float(last + 1)])
        return self._between(
            [band + edge for band in range(first, last + 1) for span in spans for edge in span]
        )

    def _between(self, edges: list[float]) -> IntArray:
        """Places of the keys in half-open ranges: their edges one after the other, in ascending order."""
        found = iter(self._keys.searchsorted(edges).tolist())
        parts = [np.arange(start, stop) for start, stop in zip(found, found, strict=True) if stop > start]
        return parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.empty(0, np.int64)


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
    half = (math.asin(min(math.sin(radius_rad) / math.cos(dec_rad), 1.0)) + GUARD_RAD) / TURN_RAD
    center = (ra_rad / TURN_RAD) % 1.0
    low, high = center - half, center + half
    if low >= 0.0 and high <= 1.0:  # as of nearly all; the rest of this takes as long again
        return [(low, high)]
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


def _band_of(dec_rad: float) -> int:
    """`_declination_band` of one star: arrays of one number take ten times as long."""
    band = int((dec_rad + 0.5 * math.pi) / BAND_RAD)  # toward 0: below the south pole, too, it is the first
    return 0 if band < 0 else band if band < LAST_BAND else int(LAST_BAND)


def _declination_band(dec_rad: FloatArray) -> FloatArray:
    bands = np.floor((np.clip(dec_rad, -0.5 * np.pi, 0.5 * np.pi) + 0.5 * np.pi) / BAND_RAD)
    return np.asarray(np.minimum(bands, LAST_BAND))


# ---- Where a catalog keeps its stars: what the one search of `IndexedCatalog` asks of any of them.


NO_DIRECTIONS = np.empty((0, 3))


class Candidates(NamedTuple):  # made in half the time of a frozen dataclass, three times for each cone
    """Stars that a search looks at before any row of a table is built; columns (k,)."""

    rows: IntArray  # the store's own numbers of the stars
    directions: FloatArray  # (k, 3), J2000, at each star's epoch
    records: NDArray[Any] | None = None  # as the store read them, where it reads whole records

    def take(self, which: IntArray | BoolArray) -> "Candidates":
        """Return some of them, by index or mask; their directions have served, and copying them takes longest."""
        records = self.records
        if records is not None:
            # As plain bytes: numpy copies the fields of a record one by one, five times slower.
            records = records.view(f"V{records.itemsize}")[which].view(records.dtype)
        return Candidates(self.rows[which], NO_DIRECTIONS, records)


class StarStore(Protocol):
    """Stars on the sky: candidates near a direction, and what is known of some of them."""

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return candidates that contain every star within `radius_rad` of a direction, and a few beyond it."""

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes (k,)."""

    def flags(self, found: Candidates) -> IntArray:
        """Return the `StarQuality` flags (k,)."""

    def brightest_first(self, found: Candidates) -> Candidates:
        """Return the candidates by magnitude; of equal ones, the first of the catalog first."""

    def build(self, found: Candidates) -> StarTable:
        """Return the stars, in their order."""

    def columns(self, found: Candidates) -> Mapping[str, Callable[[], FloatArray]]:
        """Return what gives single columns (k,) of `build` at once, where the store has them so."""

    def summary(self) -> Mapping[str, Any]:
        """Return at least ``n_stars``, ``brightest_mag`` and ``faintest_mag``."""


def picked(values: FloatArray, rows: IntArray) -> Callable[[], FloatArray]:
    """Return what gives some rows of a column."""
    take: Callable[[IntArray], FloatArray] = values.take
    return partial(take, rows)


def by_magnitude(found: Candidates, mag: FloatArray) -> Candidates:
    """Return the candidates by magnitude; of equal ones, that of the lowest number first."""
    return found.take(np.lexsort((found.rows, mag)))


# Once cones have looked at this part of a catalog, what the next ones need is found for all its stars and kept: 0.7 s and
# 40 bytes a star for two million. Pictures ask for a small cone or two and never pay that.
KEEP_AFTER = 0.3


class SkyOfMany:
    """Directions of stars in the order of the sky, and their ranks by brightness: kept where cones look at many.

    Parameters
    ----------
    index
        Of the stars' places.
    ra_rad, dec_rad, mag : (n,) ndarray
        In the order of the catalog; they may be parts of records, in memory or mapped.
    """

    __slots__ = ("_by_rank", "_index", "_looked_at", "_rank", "_stars", "_vectors")

    def __init__(self, index: SkyIndex, ra_rad: FloatArray, dec_rad: FloatArray, mag: FloatArray) -> None:
        self._index, self._stars = index, (ra_rad, dec_rad, mag)
        self._looked_at = 0
        self._vectors: FloatArray | None = None
        self._rank: NDArray[np.int32] | None = None
        self._by_rank: IntArray | None = None

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars of the index ranges that a cone meets."""
        places = self._index.places(ra_rad, dec_rad, radius_rad)
        rows = self._index.rows(places)
        self._looked_at += len(rows)
        if self._vectors is None and self._looked_at > KEEP_AFTER * len(self._stars[0]):
            self._keep()
        if self._vectors is None:
            return Candidates(rows, unit_from_radec(self._stars[0][rows], self._stars[1][rows]))
        return Candidates(rows, self._vectors.take(places, axis=0))

    def _keep(self) -> None:
        ra, dec, mag = self._stars
        order = self._index.rows(np.arange(len(ra)))
        self._by_rank = np.argsort(mag, kind="stable")
        self._rank = np.empty(len(order), np.int32)
        self._rank[self._by_rank] = np.arange(len(order), dtype=np.int32)
        self._vectors = unit_from_radec(ra[order], dec[order])

    def brightest_first(self, found: Candidates) -> Candidates:
        """Return candidates by magnitude, of equal ones the first of the catalog first; without their directions."""
        if self._rank is None or self._by_rank is None:
            rows = np.sort(found.rows)
            rows = rows[np.argsort(self._stars[2][rows], kind="stable")]
        else:
            ranks = self._rank.take(found.rows)  # of a few numbers in half the time of an index in brackets
            ranks.sort()
            rows = self._by_rank.take(ranks)
        return Candidates(rows, NO_DIRECTIONS)


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

    __slots__ = ("_build", "_dec_rad", "_flags", "_mag", "_ra_rad", "_sky")

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
        self._sky = SkyOfMany(SkyIndex(ra_rad, dec_rad), ra_rad, dec_rad, self._mag)

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars of the index ranges that the cone meets."""
        return self._sky.near(ra_rad, dec_rad, radius_rad)

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes."""
        return self._mag[found.rows]

    def flags(self, found: Candidates) -> IntArray:
        """Return the flags."""
        none = np.zeros(len(found.rows), dtype=np.int64)
        return none if self._flags is None else self._flags[found.rows].astype(np.int64)

    def brightest_first(self, found: Candidates) -> Candidates:
        """Return the candidates by magnitude."""
        return self._sky.brightest_first(found)

    def build(self, found: Candidates) -> StarTable:
        """Return the stars of these rows."""
        return self._build(found.rows)

    def columns(self, found: Candidates) -> Mapping[str, Callable[[], FloatArray]]:
        """Return what gives places and magnitudes."""
        columns = {"ra_rad": self._ra_rad, "dec_rad": self._dec_rad, "mag": self._mag}
        return {name: picked(values, found.rows) for name, values in columns.items()}

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
        wanted = region if et_s is None else Cone(region.center, reach)
        found = found.take(wanted.contains(found.directions).nonzero()[0])
        if mag_limit < math.inf:
            found = found.take(self._store.mag(found) <= mag_limit)
        if exclude_flags:
            found = found.take((self._store.flags(found) & int(exclude_flags)) == 0)
        found = self._store.brightest_first(found)
        build = partial(self._built, found)
        stars = DeferredStars.of(len(found.rows), build, self._store.columns(found))
        return stars if et_s is None else stars.take(region.contains(stars.directions(et_s)))

    def _built(self, found: Candidates) -> StarTable:
        return with_mean_motion(self._store.build(found))


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
