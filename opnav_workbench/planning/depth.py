"""How deep a catalog goes around a field: pictures show fainter stars than a shallow one has."""

import math

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import Catalog
from opnav_workbench.geometry import radec_from_unit

__all__ = ["catalog_depth_mag"]

CONE_DEG = 3.0  # some hundred stars of a catalog to magnitude 10
# Star counts grow by a factor of 2 to 3 a magnitude, up to where a catalog ends: 95 % of its stars are brighter than
# 0.1 mag before that.
SHARE = 95.0
FEWEST = 20


def catalog_depth_mag(catalog: Catalog, direction: FloatArray, mag_limit: float = math.inf) -> float:
    """Return the magnitude, in the catalog's own band, to which it goes around a direction (3,), J2000.

    nan where it has too few stars to tell.
    """
    ra, dec = (float(a) for a in radec_from_unit(direction))
    stars = catalog.cone(ra, dec, math.radians(CONE_DEG), mag_limit=mag_limit)
    known = stars.mag[np.isfinite(stars.mag)]
    return float(np.percentile(known, SHARE)) if len(known) >= FEWEST else float("nan")
