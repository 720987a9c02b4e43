"""Several catalogs asked as one: ``SPEC+SPEC``, the first names the stars and gives their magnitudes.

Same star
    Both lists are moved to the mean epoch of the one whose motions are less known, where its own stars have spread
    least. Two rows are the same star if each is the other's nearest within MATCH_SIGMAS of their combined position
    sigmas (a star of unknown motion may have gone UNKNOWN_MOTION_REACH_MAS_YR a year; never more than
    MATCH_LIMIT_MAS) and their V magnitudes, where known, agree within MATCH_SIGMAS and MAG_TOLERANCE.
Matched star
    Name, magnitude and band of the first list. Position and epoch of the row with the smaller position sigma.
    Motion: the best of the first row's, the second row's and, where their epochs are MIN_YEARS or more apart, the
    one that carries the star from one position to the other. Where that one contradicts the motion taken by more
    than the sigmas say, the star is a binary or the match doubtful: the excess goes into the sigma of the motion.
    Parallax, V and B-V: the value with the smaller sigma. Radial velocity: the first known. Flags of both, except
    that a position which was replaced is no longer held against the star.
Unmatched stars
    Kept, from both lists.
"""

import math
import re
from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.interface import Catalog, select
from opnav_workbench.catalog.johnson import Johnson
from opnav_workbench.catalog.proper_motion import two_epoch_motion_rad_yr, with_mean_motion
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.constants import RAD_PER_MAS
from opnav_workbench.geometry import et_from_jyear, jyear_from_et, radec_from_unit
from opnav_workbench.geometry.near_places import NearPlaces

__all__ = ["CombinedCatalog", "combine_stars", "same_stars", "split_specs"]


# ---- Two lists of stars made one: which rows are the same star, and what is then known of it.

MATCH_SIGMAS = 5.0
MATCH_LIMIT_MAS = 5000.0
MATCH_FLOOR_MAS = 100.0  # systematic differences of catalogs, photocenters of close pairs
# One in fifty stars of magnitude 7 to 10 moves faster (Tycho-2 against Gaia); those stay two rows.
UNKNOWN_MOTION_REACH_MAS_YR = 150.0
MAG_TOLERANCE = 1.0  # variables, and what a transformation between bands leaves
MATCH_NEIGHBORS = 3  # the counterpart of a close pair need not be the nearest
MIN_YEARS = 5.0  # nearer epochs make a poor motion, of which orbits of binaries are too large a part
# Left over in motions from two positions by orbits and by the catalogs' local frames, one axis (Tycho-2 to ICRS: 0.6
# mas in position and 0.25 mas/yr, Hog et al. 2000, A&A 355, L27).
MOTION_FLOOR_MAS_YR = 0.25
FROM_FIRST, FROM_SECOND, FROM_BOTH, UNKNOWN = 0, 1, 2, -1  # where a motion is from


def combine_stars(first: StarTable, second: StarTable) -> StarTable:
    """Return the union of two lists by the rule at the head of this module: matched stars, then the others.

    Examples
    --------
    >>> from opnav_workbench.catalog import StarTable
    >>> len(combine_stars(StarTable.empty(), StarTable.empty()))
    0
    """
    if len(first) == 0 or len(second) == 0:
        return StarTable.concatenate([first, second])
    of_first, of_second = same_stars(first, second)
    others = [
        stars.take(np.setdiff1d(np.arange(len(stars)), rows))
        for stars, rows in ((first, of_first), (second, of_second))
    ]
    return StarTable.concatenate([_matched(first.take(of_first), second.take(of_second)), *others])


def same_stars(first: StarTable, second: StarTable) -> tuple[IntArray, IntArray]:
    """Return the rows (k,) of `first` and the rows (k,) of `second` that are the same stars."""
    known = [float(np.mean(stars.motion_known)) for stars in (first, second)]
    still = first if known[0] < known[1] else second  # moved least, so that its unknown motions matter least
    et = float(et_from_jyear(np.mean(still.epoch_jyear)))
    places = [stars.directions(et) for stars in (first, second)]
    radii = [_spread_rad(stars, et) for stars in (first, second)]
    reach = MATCH_LIMIT_MAS * RAD_PER_MAS
    apart, near = NearPlaces(places[1]).nearest(places[0], MATCH_NEIGHBORS, reach)
    found = near < len(second)
    partner = np.where(found, near, 0)
    allowed = np.minimum(np.hypot(radii[0][:, None], radii[1][partner]), reach)
    fits = found & (apart <= allowed) & _magnitudes_agree(first, second, partner)
    apart = np.where(fits, apart, np.inf)
    best = np.argmin(apart, axis=1)
    rows = np.flatnonzero(np.any(fits, axis=1))
    return _nearest_once(rows, partner[rows, best[rows]], apart[rows, best[rows]])


def _nearest_once(rows: IntArray, partner: IntArray, apart: FloatArray) -> tuple[IntArray, IntArray]:
    """Keep of the rows that want the same partner the nearest; in the order of the rows."""
    nearest_first = np.argsort(apart, kind="stable")
    _, chosen = np.unique(partner[nearest_first], return_index=True)
    kept = np.sort(nearest_first[chosen])
    return rows[kept], partner[kept]


def _spread_rad(stars: StarTable, et: float) -> FloatArray:
    """Return how far a star may stand from its predicted place (n,), MATCH_SIGMAS and the unknown motion included."""
    variance = np.trace(stars.sky_covariance(et), axis1=-2, axis2=-1)
    years = np.abs(jyear_from_et(et) - stars.epoch_jyear)
    drift = np.where(stars.motion_known, 0.0, UNKNOWN_MOTION_REACH_MAS_YR * years)
    return np.asarray(
        np.hypot(MATCH_SIGMAS * np.sqrt(variance), (MATCH_FLOOR_MAS + drift) * RAD_PER_MAS), dtype=np.float64
    )


def _magnitudes_agree(first: StarTable, second: StarTable, partner: IntArray) -> BoolArray:
    """Return whether magnitudes allow rows of `first` (n,) and their neighbors (n, k) to be one star."""
    difference = np.abs(first.v_mag[:, None] - second.v_mag[partner])
    sigma = np.hypot(first.v_sigma[:, None], second.v_sigma[partner])
    # nan: nothing speaks against it
    return ~(difference > MAG_TOLERANCE + MATCH_SIGMAS * np.nan_to_num(sigma))


def _matched(first: StarTable, second: StarTable) -> StarTable:
    sharper = second.sigma[:, :2].sum(axis=1) < first.sigma[:, :2].sum(axis=1)
    motion, motion_sigma, source = _motion(first, second, sharper)
    nearer = second.sigma[:, 2] < first.sigma[:, 2]

    def pick(name: str, from_second: BoolArray) -> FloatArray:
        return np.asarray(np.where(from_second, getattr(second, name), getattr(first, name)))

    parallax_sigma = np.minimum(first.sigma[:, 2:3], second.sigma[:, 2:3])
    position_sigma = np.where(sharper[:, None], second.sigma[:, :2], first.sigma[:, :2])
    return StarTable(
        id=first.id,
        ra_rad=pick("ra_rad", sharper),
        dec_rad=pick("dec_rad", sharper),
        pmra_rad_yr=motion[:, 0],
        pmdec_rad_yr=motion[:, 1],
        parallax_rad=pick("parallax_rad", nearer),
        rv_km_s=np.where(np.isnan(first.rv_km_s), second.rv_km_s, first.rv_km_s),
        mag=first.mag,
        band=first.band,
        epoch_jyear=pick("epoch_jyear", sharper),
        sigma=np.concatenate([position_sigma, parallax_sigma, motion_sigma], axis=1),
        motion_known=source != UNKNOWN,
        flags=_flags(first, second, sharper),
        hip=np.where(first.hip > 0, first.hip, second.hip),
        position_motion=_position_motion(first, second, sharper, source, position_sigma),
        **_johnson(first).better_of(_johnson(second)).columns(),
    )


def _johnson(stars: StarTable) -> Johnson:
    return Johnson(stars.v_mag, stars.v_sigma, stars.b_v, stars.b_v_sigma)


def _flags(first: StarTable, second: StarTable, sharper: BoolArray) -> IntArray:
    of_position = int(StarQuality.NO_MEAN_POSITION | StarQuality.BAD_ASTROMETRY)
    kept = [
        np.where(sharper == is_second, stars.flags, stars.flags & ~of_position)
        for stars, is_second in ((first, False), (second, True))
    ]
    return np.asarray(kept[0] | kept[1])


def _motion(
    first: StarTable, second: StarTable, sharper: BoolArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the best motion (k, 2), its sigma (k, 2) and where it is from (k,): FIRST, SECOND, BOTH or NOWHERE."""
    two_epoch, two_epoch_sigma, usable = _two_epoch(first, second, sharper)
    sigmas = np.stack(
        [_motion_sigma(first), _motion_sigma(second), np.where(usable[:, None], two_epoch_sigma, np.inf)]
    )
    motions = np.stack([_own_motion(first), _own_motion(second), two_epoch])
    best = np.argmin(sigmas.sum(axis=2), axis=0)
    rows = np.arange(len(first))
    known = np.isfinite(sigmas[best, rows]).all(axis=1)
    sharp_motion = np.where(sharper[:, None], _own_motion(second), _own_motion(first))
    sharp_sigma = np.where(sharper[:, None], second.sigma[:, 3:], first.sigma[:, 3:])
    motion = np.where(known[:, None], motions[best, rows], sharp_motion)
    sigma = np.where(known[:, None], sigmas[best, rows], sharp_sigma)
    against = usable & known & (best != FROM_BOTH)
    expected = np.mean(two_epoch_sigma**2 + sigma**2, axis=1)
    excess = np.where(
        against, np.maximum(np.mean((two_epoch - motion) ** 2, axis=1) - MATCH_SIGMAS * expected, 0.0), 0.0
    )
    return motion, np.sqrt(sigma**2 + excess[:, None]), np.where(known, best, UNKNOWN)


def _position_motion(
    first: StarTable, second: StarTable, sharper: BoolArray, source: IntArray, position_sigma: FloatArray
) -> FloatArray:
    """Return the covariance (k, 2) of the position with the motion, rad^2/yr.

    A motion of the position's own row has that row's; one of both positions has the position's variance over the years
    between them; one of the other row has none.
    """
    own = np.where(sharper, FROM_SECOND, FROM_FIRST) == source
    of_row = np.where(sharper[:, None], second.position_motion, first.position_motion)
    years = np.where(sharper, 1.0, -1.0) * (second.epoch_jyear - first.epoch_jyear)
    of_both = position_sigma**2 / np.where(source == FROM_BOTH, years, np.inf)[:, None]
    return np.asarray(np.where(own[:, None], of_row, of_both))


def _own_motion(stars: StarTable) -> FloatArray:
    return np.stack([stars.pmra_rad_yr, stars.pmdec_rad_yr], axis=-1)


def _motion_sigma(stars: StarTable) -> FloatArray:
    return np.where(stars.motion_known[:, None], stars.sigma[:, 3:], np.inf)


def _two_epoch(
    first: StarTable, second: StarTable, sharper: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the motion from one position to the other, its sigma, and whether the epochs are far enough apart."""
    years = first.epoch_jyear - second.epoch_jyear
    usable = np.abs(years) >= MIN_YEARS
    span = np.where(usable, years, 1.0)
    of_first = two_epoch_motion_rad_yr(first.ra_rad, first.dec_rad, second.ra_rad, second.dec_rad, span)
    of_second = two_epoch_motion_rad_yr(second.ra_rad, second.dec_rad, first.ra_rad, first.dec_rad, -span)
    sigma = np.hypot(first.sigma[:, :2], second.sigma[:, :2]) / np.abs(span)[:, None]
    motion = np.where(sharper[:, None], of_second, of_first)
    return motion, np.hypot(sigma, MOTION_FLOOR_MAS_YR * RAD_PER_MAS), usable


# ---- Several catalogs asked as one: ``SPEC+SPEC``, the first names the stars and gives their magnitudes.

# Where no epoch is asked for, the parts' positions are of different epochs: what stars of unknown motion move by in 25
# years (150 mas/yr), and the distance within which stars are matched.
SEARCH_MARGIN_RAD = (MATCH_LIMIT_MAS + 25.0 * 150.0) * RAD_PER_MAS
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
    """The union of catalogs by the rule of `combine_stars`, applied to what lies in the region asked for.

    Parameters
    ----------
    parts
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
        reach = min(region.radius_rad + SEARCH_MARGIN_RAD, math.pi)
        found = [part.cone(ra, dec, reach, mag_limit + MAG_MARGIN, et_s) for part in self._parts]
        return select(with_mean_motion(reduce(combine_stars, found)), region, mag_limit, et_s, exclude_flags)
