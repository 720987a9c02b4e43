"""Several catalogs asked as one: ``SPEC+SPEC``, the first names the stars and gives their magnitudes."""

import math
import re
from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

from opnav_workbench.catalog.combine import MATCH_LIMIT_MAS, combine
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.mean_motion import with_mean_motion
from opnav_workbench.catalog.priors import RAD_PER_MAS
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.selection import select
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.geometry import radec_from_unit

__all__ = ["CombinedCatalog", "split_specs"]

# Where no epoch is asked for, the parts' positions are of different epochs: what stars of unknown motion move by in 25
# years (150 mas/yr), and the distance within which stars are matched.
MARGIN_RAD = (MATCH_LIMIT_MAS + 25.0 * 150.0) * RAD_PER_MAS
MAG_MARGIN = 2.0  # the same star in another catalog's band: a red star in BT and G


def split_specs(spec: str, kinds: Sequence[str]) -> list[str]:
    """Return the specs joined by ``+``; a plus inside a path does not count.

    Examples
    --------
    >>> split_specs("bundled+npz:a+b.npz+tycho2:cd", ["bundled", "npz", "tycho2"])
    ['bundled', 'npz:a+b.npz', 'tycho2:cd']
    """
    return re.split(rf"\+(?=(?:{'|'.join(map(re.escape, kinds))})(?::|\+|$))", spec.strip())


class CombinedCatalog(Catalog):
    """The union of catalogs by the rule of `catalog.combine`, applied to what lies in the region asked for.

    Parameters
    ----------
    parts : sequence of Catalog
        The first gives names, magnitudes and bands.
    """

    __slots__ = ("_parts",)

    def __init__(self, parts: Sequence[Catalog]) -> None:
        self._parts = tuple(parts)
        self.name = "+".join(part.name for part in parts)

    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is, and each of its parts."""
        parts = [dict(part.describe()) for part in self._parts]
        return {
            "name": self.name,
            # before stars in several parts are joined
            "n_stars": sum(int(part["n_stars"]) for part in parts),
            "brightest_mag": min(part["brightest_mag"] for part in parts),
            "faintest_mag": max(part["faintest_mag"] for part in parts),
            "parts": parts,
        }

    def search(
        self, region: Region, mag_limit: float, et_s: float | None, exclude_flags: StarQuality
    ) -> StarTable:
        """Return the stars within a region, brightest first; the magnitude limit is one in the band of each row."""
        ra, dec = (float(angle) for angle in radec_from_unit(region.center))
        reach = min(region.radius_rad + MARGIN_RAD, math.pi)
        found = [part.cone(ra, dec, reach, mag_limit + MAG_MARGIN, et_s) for part in self._parts]
        return select(with_mean_motion(reduce(combine, found)), region, mag_limit, et_s, exclude_flags)
