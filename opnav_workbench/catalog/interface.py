"""What every catalog offers: a name, a description, and the stars of a cone or a polygon."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Cone, Region, polygon_region
from opnav_workbench.catalog.selection import NO_FLAGS, check_cone, check_limits
from opnav_workbench.catalog.table import StarTable

__all__ = ["Catalog"]


class Catalog(ABC):
    """A star catalog that can be asked for the stars within a region of the sky.

    Attributes
    ----------
    name : str
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
        exclude_flags : StarQuality
            Leave out stars with any of these flags.

        Returns
        -------
        StarTable
            Stars of equal magnitude in the order of the catalog; where a star's motion is unknown it is the mean
            one of such stars (see `mean_motion`), with `motion_known` False and the sigma of a single star.

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
