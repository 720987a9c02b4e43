"""What every catalog offers: a name, a description, and the stars of a cone or a polygon.

The numbers of a question are checked here, and the stars that answer it are chosen here: inside the region at an
epoch (none: by their catalog positions), not fainter than the limit, without excluded flags, brightest first.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Cone, Region, polygon_region
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import unit_from_radec

__all__ = ["Catalog", "check_cone", "select"]


# ---- What every catalog does alike with a question: check its numbers, and choose the stars that answer it.

NO_FLAGS = StarQuality(0)


def select(
    stars: StarTable, region: Region, mag_limit: float, et_s: float | None, exclude_flags: StarQuality
) -> StarTable:
    """Return the stars inside a region at an epoch (None: by their catalog positions), brightest first."""
    places = unit_from_radec(stars.ra_rad, stars.dec_rad) if et_s is None else stars.directions(et_s)
    keep = region.contains(places) & (stars.mag <= mag_limit)
    chosen = stars.take(keep & ((stars.flags & int(exclude_flags)) == 0))
    return chosen.take(np.argsort(chosen.mag, kind="stable"))


def check_cone(ra_rad: float, dec_rad: float, radius_rad: float) -> None:
    """Raise a CatalogError unless the numbers are those of a cone on the sky."""
    if not (math.isfinite(ra_rad) and abs(dec_rad) <= 0.5 * math.pi):
        raise CatalogError(
            f"cone center RA {math.degrees(ra_rad):.6g} deg, dec {math.degrees(dec_rad):.6g} deg is no direction; "
            "give a declination of -90 to 90 deg (-pi/2 to pi/2 rad)."
        )
    if not 0.0 <= radius_rad <= math.pi:
        raise CatalogError(
            f"cone radius {radius_rad:.6g} rad is out of range: {math.degrees(radius_rad):.6g} deg; "
            "give 0 to 180 deg (pi rad)."
        )


def check_limits(mag_limit: float, et_s: float | None) -> None:
    """Raise a CatalogError unless magnitude limit and epoch are usable."""
    if math.isnan(mag_limit):
        raise CatalogError("the magnitude limit is nan; give a magnitude, or inf for no limit.")
    if et_s is not None and not math.isfinite(et_s):
        raise CatalogError(f"the epoch et = {et_s} is not finite; give TDB seconds past J2000, or None.")


# ---- What every catalog offers: a name, a description, and the stars of a cone or a polygon.


class Catalog(ABC):
    """A star catalog that can be asked for the stars within a region of the sky.

    Attributes
    ----------
    name
        The spec that opens this catalog.
    """

    __slots__ = ("name",)

    name: str

    @abstractmethod
    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is: source, number of stars, epochs, bands, limits."""

    @abstractmethod
    def search(
        self, region: Region, mag_limit: float, et_s: float | None, exclude_flags: StarQuality
    ) -> StarTable:
        """Return the stars within a region, brightest first: what `cone` and `polygon` ask, their numbers checked."""

    def cone(
        self,
        ra_rad: float,
        dec_rad: float,
        radius_rad: float,
        mag_limit: float = math.inf,
        et_s: float | None = None,
        exclude_flags: StarQuality = NO_FLAGS,
    ) -> StarTable:
        """Return the stars within `radius_rad` of a direction, brightest first.

        Parameters
        ----------
        ra_rad, dec_rad
            Center of the cone, J2000; any right ascension, declination within +-pi/2.
        radius_rad
            0 to pi; a star at exactly this great-circle distance belongs to the cone.
        mag_limit
            Faintest magnitude, itself included, in the catalog's own band.
        et_s
            Epoch, TDB seconds past J2000, at which the stars' places, moved to it as seen from the solar
            system's barycenter, are compared with the cone. None: the catalog positions are. The returned
            columns are the catalog's at its own epoch in either case. A star's parallax at the observer is
            not part of this test: leave a margin for it.
        exclude_flags
            Leave out stars with any of these flags.

        Returns
        -------
        StarTable
            Stars of equal magnitude in the order of the catalog; where a star's motion is unknown it is the mean
            one of such stars (see `mean_motion_rad_yr`), with `motion_known` False and the sigma of a single star.

        Raises
        ------
        CatalogError
            A number is not finite or out of range, or a file that the cone needs is missing or damaged.
        """
        check_cone(ra_rad, dec_rad, radius_rad)
        check_limits(mag_limit, et_s)
        return self.search(Cone.about(ra_rad, dec_rad, radius_rad), mag_limit, et_s, exclude_flags)

    def polygon(
        self,
        corners: ArrayLike,
        mag_limit: float = math.inf,
        et_s: float | None = None,
        exclude_flags: StarQuality = NO_FLAGS,
    ) -> StarTable:
        """Return the stars within a convex spherical polygon, its edge included, brightest first.

        Parameters
        ----------
        corners : (m, 3) array_like
            Directions of the corners in order along the edge, either way round, J2000: those of a detector.
        mag_limit, et_s, exclude_flags
            As of `cone`.

        Returns
        -------
        StarTable
            As of `cone`.

        Raises
        ------
        CatalogError
            As of `cone`, or the corners are not those of a convex polygon smaller than a hemisphere.
        """
        check_limits(mag_limit, et_s)
        return self.search(polygon_region(corners), mag_limit, et_s, exclude_flags)
