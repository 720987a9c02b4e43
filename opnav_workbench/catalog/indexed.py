"""Catalogs over any `StarStore`: the search of a region, at the catalog's epoch or another."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.mean_motion import with_mean_motion
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.store import ArrayStore, StarStore
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.geometry import angle_between, jyear_from_et, unit_from_radec

__all__ = ["IndexedCatalog", "MotionBound", "StoredCatalog"]

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
    name : str
        The spec that opens this catalog.
    facts : mapping
        What `describe` reports beside the number of stars and the magnitude limits.
    store : StarStore
        Where the stars are.
    motion : MotionBound
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
