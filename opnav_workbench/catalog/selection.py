"""What every catalog does alike with a question: check its numbers, and choose the stars that answer it."""

import math

import numpy as np

from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import unit_from_radec

__all__ = ["NO_FLAGS", "check_cone", "check_limits", "select"]

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
