"""What every catalog offers, and the one implementation of it for catalogs held in memory."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.mean_motion import with_mean_motion
from opnav_workbench.catalog.sky import SkyIndex
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import angle_between, jyear_from_et, unit_from_radec

__all__ = ["Catalog", "IndexedCatalog", "MotionBound"]

# Linear space motion speeds up a star that comes nearer: 0.013 % a year for Barnard's star, the fastest
# known, so that this holds for four centuries about the epoch.
APPROACH_MARGIN = 1.05


class Catalog(Protocol):
    """A star catalog that can be asked for the stars within a cone."""

    @property
    def name(self) -> str:
        """The spec that opens this catalog."""

    def cone(
        self,
        ra_rad: float,
        dec_rad: float,
        radius_rad: float,
        mag_limit: float = math.inf,
        et_s: float | None = None,
    ) -> StarTable:
        """Return the stars within `radius_rad` of a direction, brightest first."""

    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is: source, number of stars, epochs, bands, limits."""


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


class IndexedCatalog:
    """A catalog in memory: positions and magnitudes of all stars, their rows built only when asked for.

    Parameters
    ----------
    name : str
        The spec that opens this catalog.
    facts : mapping
        What `describe` reports beside the number of stars and the magnitude limits.
    ra_rad, dec_rad, mag : (n,) ndarray
        Position (rad, J2000, at each star's epoch) and magnitude of every star.
    build : callable
        Turns row numbers (k,) into the StarTable of these rows, in their order.
    motion : MotionBound
        Bounds the motion of every star, so that a cone at another epoch misses none.
    """

    __slots__ = ("_build", "_dec_rad", "_facts", "_index", "_mag", "_motion", "_ra_rad", "name")

    def __init__(
        self,
        name: str,
        facts: Mapping[str, Any],
        ra_rad: FloatArray,
        dec_rad: FloatArray,
        mag: FloatArray,
        build: Callable[[IntArray], StarTable],
        motion: MotionBound,
    ) -> None:
        self.name = name
        self._facts, self._build, self._motion = dict(facts), build, motion
        self._ra_rad, self._dec_rad = ra_rad, dec_rad
        # A float32 column would be compared with a limit in float32, its rows come out in float64.
        self._mag = np.asarray(mag, dtype=np.float64)
        self._index = SkyIndex(ra_rad, dec_rad)

    def cone(
        self,
        ra_rad: float,
        dec_rad: float,
        radius_rad: float,
        mag_limit: float = math.inf,
        et_s: float | None = None,
    ) -> StarTable:
        """Return the stars within `radius_rad` of a direction, brightest first.

        Parameters
        ----------
        ra_rad, dec_rad : float
            Center of the cone, J2000; any right ascension, declination within +-pi/2.
        radius_rad : float
            0 to pi; a star at exactly this great-circle distance belongs to the cone.
        mag_limit : float
            Faintest magnitude, itself included, in the catalog's own band.
        et_s : float, optional
            Epoch, TDB seconds past J2000, at which the stars' places, moved to it as seen from the solar
            system's barycenter, are compared with the cone. None: the catalog positions are. The returned
            columns are the catalog's at its own epoch in either case. A star's parallax at the observer is
            not part of this test: leave a margin for it.

        Returns
        -------
        StarTable
            Stars of equal magnitude in the order of the catalog; where a star's motion is unknown it is the mean
            one of such stars (see `mean_motion`), with `motion_known` False and the sigma of a single star.

        Raises
        ------
        CatalogError
            A number is not finite or out of range.
        """
        _check_cone(ra_rad, dec_rad, radius_rad, mag_limit, et_s)
        if et_s is None:
            near = self._near(ra_rad, dec_rad, radius_rad, mag_limit)
            return with_mean_motion(self._build(self._brightest_first(near)))
        reach = min(radius_rad + self._motion.reach_rad(et_s), math.pi)
        stars = self._build(self._brightest_first(self._near(ra_rad, dec_rad, reach, mag_limit)))
        apart = angle_between(stars.directions(et_s), unit_from_radec(ra_rad, dec_rad))
        return with_mean_motion(stars.take(apart <= radius_rad))

    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is: source, number of stars, epochs, bands, limits."""
        return {
            "name": self.name,
            "n_stars": int(self._mag.size),
            "brightest_mag": float(self._mag.min()),
            "faintest_mag": float(self._mag.max()),
            "first_epoch_jyear": self._motion.first_jyear,
            "last_epoch_jyear": self._motion.last_jyear,
            **self._facts,
        }

    def _near(self, ra_rad: float, dec_rad: float, radius_rad: float, mag_limit: float) -> IntArray:
        rows = self._index.candidates(ra_rad, dec_rad, radius_rad)
        rows = rows[self._mag[rows] <= mag_limit]
        places = unit_from_radec(self._ra_rad[rows], self._dec_rad[rows])
        return rows[angle_between(places, unit_from_radec(ra_rad, dec_rad)) <= radius_rad]

    def _brightest_first(self, rows: IntArray) -> IntArray:
        return rows[np.lexsort((rows, self._mag[rows]))]


def _check_cone(
    ra_rad: float, dec_rad: float, radius_rad: float, mag_limit: float, et_s: float | None
) -> None:
    if not (math.isfinite(ra_rad) and abs(dec_rad) <= 0.5 * math.pi):
        raise CatalogError(
            f"cone center RA {ra_rad} rad, dec {dec_rad} rad is no direction; give |dec| <= pi/2."
        )
    if not 0.0 <= radius_rad <= math.pi:
        raise CatalogError(f"cone radius {radius_rad} rad is out of range; give 0 to pi.")
    if math.isnan(mag_limit):
        raise CatalogError("the magnitude limit is nan; give a magnitude, or inf for no limit.")
    if et_s is not None and not math.isfinite(et_s):
        raise CatalogError(f"the epoch et = {et_s} is not finite; give TDB seconds past J2000, or None.")
