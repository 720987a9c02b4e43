"""How improbable it is that a proposed attitude explains the detections by chance.

A proposal says where catalog stars should be. Of a star within the picture, the probability to be seen falls about the
picture's depth, from `SEEN` to nothing within the scatter of magnitudes, and then its detection lies about its place as a
Gaussian; by chance a detection lies anywhere. The log odds of the two sum over the stars; where the picture's depth lies is
unknown, and all depths count alike that do not show more stars than there are detections. From the sum goes what the
freedom costs to have chosen attitude and scale among all that can be told apart (the marginal likelihood of four fitted
numbers), and the scatter. Brightness adds its own: matched stars differ from their detections by one zero point and a
scatter, chance pairs by all that stars and detections differ among themselves. What is left is compared with
`SURE_LOG_ODDS`.
"""

from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import logsumexp, ndtr, pdtr

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.stars.lost_in_space.sky_index import SkyIndex

__all__ = ["SURE_LOG_ODDS", "Plane", "Proposal", "Verdict", "enough_stars", "judge", "promising"]

SURE_LOG_ODDS = float(
    np.log(1e3)
)  # random dots reach -2 in three hundred pictures, a factor of e for each unit
SEEN = (
    0.75  # of the catalog's stars that are bright enough: the others are blended, on bad pixels, or variable
)
# Of detections about their places: noise, pixel phase, distortion left over.
SCATTERS_PX = (0.18, 0.35, 0.7, 1.4, 2.8)
MOST_OF_BRIGHTNESS = 2.0  # log odds of a star by its magnitude: of stars that differ by four
DEPTHS = 24  # of a picture that are tried: nearer to each other than magnitudes scatter
MATCH_SIGMAS = 4.0
# Of matches with a proposal from four stars; share of the picture
FIRST_REACH_PX, FIRST_REACH_SHARE = 4.0, 0.006
FOURTH_REACH_PX = 4.5  # of a fourth star from where three put it, 1.9 px off each, half their width outside
MIN_DEPTH = np.float32(0.05)  # of a star along the boresight: beyond 87 deg nothing is in a picture
CELLS_OF_REACH, MAX_CELLS = 3.0, 1000  # of the map of detections
MIN_STARS = 4  # four fitted numbers and as many to prove them by; whether it is enough, the odds say
REFINEMENTS = 4
REACH_SIGMAS = 3.0
STARS_PER_DETECTION = 3.0  # catalog stars looked at: the picture may be in a poor part of the sky
MAG_SCATTER = 0.5  # of a star's detection: color, variability, the filter's flux
STRANGE_SHARE = 0.05  # of stars whose brightness says nothing
ZERO_POINT_REACH = (
    1.0  # of the matches about the mean of all, in their scatter: how little is known of the depth
)
MIN_MAG_SPREAD = 0.1  # detections that all have one brightness tell nothing
TURN_RAD = 2.0 * np.pi

Matches = tuple[IntArray, IntArray, FloatArray]  # stars, their detections, distances in px


@dataclass(frozen=True, slots=True, eq=False)
class DetectionMap:
    """Which detection is next to a place, told by a look at a table: millions of places are asked for."""

    table: NDArray[np.int16]  # (n, n), -1 where none is within reach
    from_plane: FloatArray  # (3, 3), to homogeneous rows and columns of the table

    @classmethod
    def drawn(cls, places: FloatArray, reach: float) -> "DetectionMap":
        """Return the map of the detections at `places` (m, 2), as far as `reach` about them."""
        corner = places.min(axis=0) - 3.0 * reach  # so that nothing stands on the table's rim
        width = float((places.max(axis=0) + 3.0 * reach - corner).max())
        cell = max(reach / CELLS_OF_REACH, width / MAX_CELLS)
        half = int(np.ceil(reach / cell))
        table = np.full((int(width / cell) + 2 * half,) * 2, -1, np.int16)
        step = np.arange(-half, half + 1)
        disk = np.stack(np.meshgrid(step, step, indexing="ij"), axis=-1).reshape(-1, 2)
        disk = disk[np.hypot(*disk.T) * cell <= reach]
        cells = np.floor((places - corner) / cell).astype(np.int64)[:, None] + disk
        apart = np.linalg.norm((cells + 0.5) * cell + corner - places[:, None], axis=2).ravel()
        x, y = cells.reshape(-1, 2)[order := np.argsort(-apart, kind="stable")].T
        table[x, y] = order // len(disk)  # the nearest is written last
        return cls(table, np.array([[1.0, 0.0, -corner[0]], [0.0, 1.0, -corner[1]], [0.0, 0.0, cell]]) / cell)

    def axes(self, rotations: FloatArray, scales: FloatArray) -> NDArray[np.float32]:
        """Return matrices (c, 3, 3) that take stars, in rows, to homogeneous places in the table."""
        to_plane = rotations * np.stack([np.ones_like(scales)] * 2 + [scales], axis=1)[:, :, None]
        return np.asarray(np.swapaxes(self.from_plane @ to_plane, 1, 2), np.float32)

    def near(self, stars: NDArray[np.float32], axes: NDArray[np.float32]) -> NDArray[np.int16]:
        """Return the detections (c, k) next to where `axes` (c, 3, 3) put stars (c, k, 3), -1 where none is."""
        seen = np.matmul(stars, axes)
        last = len(self.table) - 1  # the table's rim is empty
        in_front = np.maximum(seen[..., 2], MIN_DEPTH)
        x, y = (np.clip(seen[..., i] / in_front, 0, last).astype(np.int32) for i in (0, 1))
        return np.asarray(self.table.ravel().take(x * (last + 1) + y))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Detections in the plane of focal length 1, free of distortion, boresight at (0, 0), brightest first."""

    places: FloatArray  # (m, 2)
    mag: FloatArray  # (m,) -2.5 log10(flux), nan where saturated
    scale_rad: float  # of a pixel
    corners: FloatArray  # (4, 2) of the detector, in order around it
    focal_error: float
    tree: cKDTree = field(init=False)
    fourths: "DetectionMap" = field(init=False)  # as far as a fourth star may be off
    map: "DetectionMap" = field(init=False)  # as far as any star may, with a proposal from four

    def __post_init__(self) -> None:
        object.__setattr__(self, "tree", cKDTree(self.places))
        reaches = {"fourths": FOURTH_REACH_PX, "map": self.first_reach_px}
        for name, reach_px in reaches.items():
            object.__setattr__(self, name, DetectionMap.drawn(self.places, reach_px * self.scale_rad))

    @property
    def reach_rad(self) -> float:
        """Angle from the boresight to the farthest corner."""
        return float(np.arctan(np.hypot(*self.corners.T).max() * (1.0 + self.focal_error)))

    @property
    def first_reach_px(self) -> float:
        """How far from its place a detection may lie with a proposal from four stars."""
        return FIRST_REACH_PX + FIRST_REACH_SHARE * float(np.sqrt(self.area_px2))

    @property
    def area_px2(self) -> float:
        """Area of the detector."""
        x, y = self.corners.T
        return abs(0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / self.scale_rad**2

    def inside(self, places: FloatArray) -> np.ndarray:
        """Tell which places (n, 2) lie on the detector."""
        edge = np.roll(self.corners, -1, axis=0) - self.corners
        offset = places[:, None] - self.corners
        side = edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0]
        return np.asarray((side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A rotation from J2000 to the plane's axes, and by what the plane's places are to be multiplied."""

    rotation: FloatArray  # (3, 3)
    scale: float  # told focal length over the true one


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """A refined proposal, its matches, and the log odds against chance."""

    proposal: Proposal
    stars: IntArray  # (k,) rows of the index
    detections: IntArray  # (k,)
    scatter_px: float
    scale_sigma: float  # relative
    log_odds: float

    @property
    def sure(self) -> bool:
        """Whether it is no chance."""
        return self.log_odds >= SURE_LOG_ODDS


def enough_stars(index: SkyIndex, plane: Plane) -> float:
    """Return how many of the index's brightest stars bring into the picture as many as its detections deserve."""
    part = plane.area_px2 * plane.scale_rad**2 / (2.0 * TURN_RAD)
    return STARS_PER_DETECTION * len(plane.places) / part * index.coverage


def promising(
    index: SkyIndex, plane: Plane, rotations: FloatArray, scales: FloatArray, most: int
) -> IntArray:
    """Return the proposals (rotations (c, 3, 3), scales (c,)) that bring most stars nearest to detections, best first."""
    tree = index.brightest_tree(enough_stars(index, plane))
    chord = 2.0 * np.sin(0.5 * plane.reach_rad)
    near = tree.query_ball_point(rotations[:, 2], chord)
    count = [len(rows) for rows in near]
    which = np.repeat(np.arange(len(near)), count)
    row = np.fromiter(chain.from_iterable(near), np.int64, len(which))
    axes = plane.map.axes(rotations, scales).take(which, axis=0)
    found = plane.map.near(index.vectors.take(row, axis=0)[:, None], axes)[:, 0]
    hit = np.flatnonzero(found >= 0)
    which, row, found = which[hit], row[hit], found[hit]
    turned = np.einsum("cij,cj->ci", rotations.take(which, axis=0), index.vectors.take(row, axis=0))
    places = turned[:, :2] / (turned[:, 2] * scales.take(which))[:, None]
    apart = np.hypot(*(places - plane.places.take(found, axis=0)).T) / plane.scale_rad
    reach = plane.first_reach_px
    sigma = reach / REACH_SIGMAS  # of places by an attitude from three stars
    gain = np.log1p(plane.area_px2 / (TURN_RAD * sigma**2 * len(plane.places)))
    gain = np.where(apart <= reach, np.maximum(gain - 0.5 * (apart / sigma) ** 2, 0.0), 0.0)
    best = np.zeros((len(rotations), len(plane.places)))  # a detection counts once
    np.maximum.at(best, (which, found), gain)
    enough = np.flatnonzero((best > 0.0).sum(axis=1) >= MIN_STARS)
    order = np.argsort(-best.sum(axis=1)[enough], kind="stable")
    return np.asarray(enough[order][:most])


def _nearest(plane: Plane, places: FloatArray, reach: float) -> tuple[FloatArray, IntArray]:
    """Return distances (n,) to the nearest detections, inf where none is within reach, and their rows (n,)."""
    apart, found = plane.tree.query(places, distance_upper_bound=reach)
    return np.asarray(apart, np.float64), np.asarray(found, np.int64)


def judge(index: SkyIndex, plane: Plane, proposal: Proposal) -> Verdict | None:
    """Refine a proposal by its matches, and weigh it; None where it loses its stars."""
    tree = index.brightest_tree(enough_stars(index, plane))
    rows = np.sort(tree.query_ball_point(proposal.rotation[2], 2.0 * np.sin(0.5 * plane.reach_rad)))
    stars = index.vectors[rows].astype(np.float64)
    reach_px = plane.first_reach_px
    for _ in range(REFINEMENTS):
        star, detection, _ = _matches(plane, proposal, stars, reach_px)
        if len(star) < MIN_STARS:
            return None
        proposal = _fitted(plane, proposal, stars[star], plane.places[detection])
        apart = _residuals_px(plane, proposal, stars[star], plane.places[detection])
        reach_px = min(max(MATCH_SIGMAS * 1.05 * float(np.median(apart)), 1.5), reach_px)
    on = plane.inside(_places(proposal, stars))
    matches = _matches(plane, proposal, stars[on], MATCH_SIGMAS * max(SCATTERS_PX))
    return max(
        (_weighed(index, plane, proposal, matches, rows[on], scatter) for scatter in SCATTERS_PX),
        key=lambda v: v.log_odds,
    )


def _places(proposal: Proposal, stars: FloatArray) -> FloatArray:
    turned = stars @ proposal.rotation.T
    depth = np.where(turned[:, 2:] > MIN_DEPTH, turned[:, 2:], np.nan)
    return np.asarray(np.nan_to_num(turned[:, :2] / depth / proposal.scale, nan=1e6))


def _matches(plane: Plane, proposal: Proposal, stars: FloatArray, reach_px: float) -> Matches:
    """One-to-one matches: star, detection, distance in px."""
    apart, found = _nearest(plane, _places(proposal, stars), reach_px * plane.scale_rad)
    star = np.flatnonzero(np.isfinite(apart))
    star = star[np.argsort(apart[star], kind="stable")]
    _, first = np.unique(found[star], return_index=True)
    star = np.sort(star[first])
    return star, found[star], apart[star] / plane.scale_rad


def _residuals_px(plane: Plane, proposal: Proposal, stars: FloatArray, seen: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(*(seen - _places(proposal, stars)).T) / plane.scale_rad)


def _fitted(plane: Plane, proposal: Proposal, stars: FloatArray, seen: FloatArray) -> Proposal:
    """Least squares for rotation and scale, far residuals at less weight; two steps, as a proposal is near."""
    for _ in range(2):
        turned = stars @ proposal.rotation.T
        x, y = turned[:, 0] / turned[:, 2], turned[:, 1] / turned[:, 2]
        scale = proposal.scale
        residual = (seen - np.column_stack([x, y]) / scale).ravel()
        one = np.ones_like(x)
        slope = np.empty((len(x), 2, 4))
        slope[:, 0] = np.column_stack([-x * y, one + x**2, -y, -x / scale]) / scale
        slope[:, 1] = np.column_stack([-(one + y**2), x * y, x, -y / scale]) / scale
        size = np.hypot(*residual.reshape(-1, 2).T)
        soft = max(2.0 * float(np.median(size)), 0.2 * plane.scale_rad)
        weight = np.repeat(1.0 / np.sqrt(1.0 + (size / soft) ** 2), 2)
        step = np.linalg.lstsq(slope.reshape(-1, 4) * weight[:, None], residual * weight, rcond=None)[0]
        proposal = Proposal(rotation_from_vector(step[:3]) @ proposal.rotation, scale + float(step[3]))
    return proposal


def _weighed(
    index: SkyIndex, plane: Plane, proposal: Proposal, matches: Matches, rows: IntArray, scatter_px: float
) -> Verdict:
    """Weigh a refined proposal by its matches with the stars on the detector, rows (n,) of the index, brightest first."""
    star, detection, apart = matches
    near = apart < MATCH_SIGMAS * scatter_px
    star, detection, apart = star[near], detection[near], apart[near]
    nothing = Verdict(proposal, rows[:0], rows[:0], scatter_px, np.nan, -np.inf)
    if len(star) < MIN_STARS or abs(proposal.scale - 1.0) > 1.1 * plane.focal_error:
        return nothing
    likely = np.exp(-0.5 * (apart / scatter_px) ** 2)  # than chance, each match
    likely *= plane.area_px2 / (TURN_RAD * scatter_px**2 * len(plane.places))
    freedom = _cost_of_freedom(plane, len(star), _spread_px(plane, plane.places[detection]), scatter_px)
    most = np.maximum(np.log1p(SEEN * (likely - 1.0)), 0.0) + MOST_OF_BRIGHTNESS
    if most.sum() - freedom < SURE_LOG_ODDS:  # whatever else is true of it
        return nothing
    mag = index.mag[rows].astype(np.float64)
    ratio = np.zeros(len(rows))
    ratio[star] = likely
    depth = _depths(mag)[:, None]
    seen = SEEN * ndtr((depth - mag) / MAG_SCATTER)  # (depths, stars)
    believed = pdtr(
        len(plane.places), seen.sum(axis=1)
    )  # (depths,): no more are seen than there are detections
    total = np.log1p(seen * (ratio - 1.0)).sum(axis=1) + np.log(
        np.maximum(believed / believed.sum(), np.finfo(float).tiny)
    )
    best = int(np.argmax(total))
    kept = ratio[star] > 1.0  # nearer than chance brings a detection
    star, detection = star[kept], detection[kept]
    if len(star) < MIN_STARS:
        return nothing
    spread_px = _spread_px(plane, plane.places[detection])
    log_odds = float(logsumexp(total)) - np.log(len(SCATTERS_PX))
    log_odds -= _cost_of_freedom(plane, len(star), spread_px, scatter_px)
    shown = mag <= max(float(depth[best, 0]), float(mag[star].max()))
    log_odds += _brightness_odds(mag, shown, plane.mag, star, detection)
    return Verdict(proposal, rows[star], detection, scatter_px, scatter_px / spread_px, log_odds)


def _depths(mag: FloatArray) -> FloatArray:
    """Return the depths (d,) that a picture may have: among its stars, or deeper than the catalog."""
    among = np.quantile(mag, np.linspace(0.0, 1.0, min(DEPTHS, len(mag))))
    return np.append(among, among[-1] + 3.0 * MAG_SCATTER)


def _spread_px(plane: Plane, seen: FloatArray) -> float:
    """Return the root of the summed squares of distances from the mean: the lever of twist and scale."""
    offset = (seen - seen.mean(axis=0)) / plane.scale_rad
    return float(np.sqrt(max(np.sum(offset**2), 1.0)))


def _cost_of_freedom(plane: Plane, n_stars: int, spread_px: float, scatter_px: float) -> float:
    """Return the logarithm of how many attitudes and scales could be told apart by so many stars."""
    shift_px2 = scatter_px**2 / n_stars
    turn_rad2 = (scatter_px / spread_px) ** 2  # that of the scale's logarithm, too
    fitted = TURN_RAD**2 * shift_px2 * turn_rad2
    room = 2.0 * TURN_RAD / plane.scale_rad**2 * TURN_RAD * 2.0 * plane.focal_error
    return float(np.log(room / fitted))


def _brightness_odds(
    mag: FloatArray, shown: BoolArray, seen: FloatArray, star: IntArray, detection: IntArray
) -> float:
    """Return the log odds that stars and detections have each other's brightness, to one zero point.

    Chance draws from the stars that are `shown`, those down to the picture's depth.
    """
    known = np.isfinite(seen[detection])
    if known.sum() < MIN_STARS or not shown.any():
        return 0.0
    spread = float(np.hypot(np.nanstd(seen), np.std(mag[shown])))
    if np.nanstd(seen) < MIN_MAG_SPREAD or spread <= MAG_SCATTER:
        return 0.0
    difference = (seen[detection] - mag[star])[known] - (np.nanmean(seen) - np.mean(mag[shown]))
    zero_point = float(np.median(difference))
    by_chance = _gaussian(difference, spread)
    as_stars = (1.0 - STRANGE_SHARE) * _gaussian(
        difference - zero_point, MAG_SCATTER
    ) + STRANGE_SHARE * by_chance
    reach = ZERO_POINT_REACH * spread
    found = MAG_SCATTER / np.sqrt(known.sum()) * np.sqrt(TURN_RAD) * _gaussian(zero_point, reach)
    return float(np.sum(np.log(as_stars / by_chance)) + np.log(found))


def _gaussian(x: FloatArray | float, sigma: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * np.square(np.asarray(x) / sigma)) / (sigma * np.sqrt(TURN_RAD)))
