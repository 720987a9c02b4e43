"""The plates that rays of one bundle meet first: all rays through one point, or all parallel.

Seen from the bundle's origin a shape is a flat drawing: every vertex has a place (u, v) on a plane across the bundle,
and a nearness that is linear over each plate (1 / depth for rays through a point, height for parallel ones). A ray is a
point of that plane; the plate it meets is, among those whose triangle holds the point, the one of greatest nearness. A
square mesh over the drawing lists the plates that reach into each of its cells, so that a ray is tested against a
handful of plates, all rays at once.

SPICE's ``dskxv`` gives the same places (tests/render/test_plates.py), at 12 to 25 microseconds a ray instead of one.
"""

from dataclasses import dataclass, field

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.geometry import unit

__all__ = ["MIRROR", "NO_PLATE", "PlateView", "bundle_axes", "parallel_view", "point_view"]

NO_PLATE = -1
MIRROR = np.array(
    [[-1.0], [1.0]]
)  # parallel rays come down the third axis: seen along them, the first points left
PLATES_PER_CELL = 0.7  # mean: fewer make the lists long, more the tests many
MOST_CELLS = 1024  # along a side
RAYS_AT_ONCE = 200_000  # some 2 million tests of 8 numbers: 130 MB
# A ray along an edge belongs to both its plates: rounding must not let it slip between them.
EDGE_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class PlateView:
    """A shape's plates as a bundle of rays sees them."""

    plate: IntArray  # (m,) indices of the plates that face the origin of the rays
    barycentric: FloatArray  # (m, 2, 3) weights of corners 1 and 2 = rows @ (u, v, 1)
    nearness: FloatArray  # (m, 3) nearness = row @ (u, v, 1)
    low: FloatArray = field(repr=False)  # (2,) corner of the mesh
    per_cell: float = field(repr=False)  # side of a cell
    cells: tuple[int, int] = field(repr=False)
    start: IntArray = field(repr=False)  # (cells + 1,) where each cell's list starts
    listed: IntArray = field(repr=False)  # rows of `plate`, cell by cell

    def first_met(self, uv: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return for points (2, n) the plate met first, or `NO_PLATE`, and its nearness (-inf: none)."""
        plate = np.full(uv.shape[1], NO_PLATE)
        nearness = np.full(uv.shape[1], -np.inf)
        for begin in range(0, uv.shape[1], RAYS_AT_ONCE):
            part = slice(begin, begin + RAYS_AT_ONCE)
            plate[part], nearness[part] = self._first_met(uv[:, part])
        return plate, nearness

    def _first_met(self, uv: FloatArray) -> tuple[IntArray, FloatArray]:
        plate, nearness = np.full(uv.shape[1], NO_PLATE), np.full(uv.shape[1], -np.inf)
        ray, row = self._candidates(uv)
        if len(ray) == 0:
            return plate, nearness
        u, v = uv[0, ray], uv[1, ray]
        b = self.barycentric.reshape(-1, 6)[row]
        first, second = b[:, 0] * u + b[:, 1] * v + b[:, 2], b[:, 3] * u + b[:, 4] * v + b[:, 5]
        inside = (first >= -EDGE_TOLERANCE) & (second >= -EDGE_TOLERANCE)
        inside &= first + second <= 1.0 + EDGE_TOLERANCE
        ray, row, u, v = ray[inside], row[inside], u[inside], v[inside]
        if len(ray) == 0:
            return plate, nearness
        near = self.nearness[row]
        value = near[:, 0] * u + near[:, 1] * v + near[:, 2]
        begins = np.flatnonzero(np.diff(ray, prepend=-1))  # rays come in order: one run each
        best = np.maximum.reduceat(value, begins)
        counts = np.diff(begins, append=len(ray))
        winner = np.flatnonzero(value == np.repeat(best, counts))[::-1]
        met = ray[begins]
        plate[ray[winner]] = self.plate[row[winner]]  # of equals the first, written last
        nearness[met] = best
        return plate, nearness

    def _candidates(self, uv: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs (ray, row of `plate`) that share a cell, in the order of rays."""
        if len(self.plate) == 0:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        place = np.floor((uv - self.low[:, None]) / self.per_cell)
        held = np.flatnonzero(
            (place[0] >= 0) & (place[1] >= 0) & (place[0] < self.cells[0]) & (place[1] < self.cells[1])
        )
        cell = (place[1, held] * self.cells[0] + place[0, held]).astype(np.int64)
        counts = self.start[cell + 1] - self.start[cell]
        ray = np.repeat(held, counts)
        ends = np.cumsum(counts)
        within = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
        return ray, self.listed[np.repeat(self.start[cell], counts) + within]


def point_view(vertices: FloatArray, plates: IntArray, origin: FloatArray, axes: FloatArray) -> PlateView:
    """Return what rays through `origin` (3,) see; a ray d has u, v = its first two components over its third.

    `axes` (3, 3) has the columns of u, v and the axis of the bundle, which all plates stand in front of.
    """
    local = (vertices - origin) @ axes
    depth = local[:, 2]
    return _view(local[:, :2] / depth[:, None], 1.0 / depth, plates)


def parallel_view(vertices: FloatArray, plates: IntArray, axes: FloatArray) -> PlateView:
    """Return what rays along ``-axes[:, 2]`` see; nearness is the height along ``axes[:, 2]``.

    A ray through a point has u, v = `MIRROR` times the point's first two components.
    """
    local = vertices @ axes
    return _view(local[:, :2] * MIRROR.T, local[:, 2], plates)


def bundle_axes(axis: FloatArray) -> FloatArray:
    """Return right-handed axes (3, 3), in columns, whose third is along `axis`."""
    third = unit(axis)
    first = unit(np.cross(np.eye(3)[np.argmin(np.abs(third))], third))
    return np.stack([first, np.cross(third, first), third], axis=-1)


def _view(uv: FloatArray, nearness: FloatArray, plates: IntArray) -> PlateView:
    corner = uv[plates]  # (m, 3, 2)
    edge1, edge2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    twice_area = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]
    facing = np.flatnonzero(twice_area < 0.0)  # counterclockwise from outside is clockwise along the ray
    corner, edge1, edge2, twice_area = (a[facing] for a in (corner, edge1, edge2, twice_area))
    # Weights of corners 1 and 2 are linear in (u, v) and zero at corner 0.
    first = np.stack([edge2[:, 1], -edge2[:, 0]], axis=-1) / twice_area[:, None]
    second = np.stack([-edge1[:, 1], edge1[:, 0]], axis=-1) / twice_area[:, None]
    weights = np.stack([first, second], axis=1)
    offset = -np.einsum("mij,mj->mi", weights, corner[:, 0])
    barycentric = np.concatenate([weights, offset[..., None]], axis=-1)
    value = nearness[plates[facing]]
    rise = value[:, 1:] - value[:, :1]
    row = np.einsum("mi,mij->mj", rise, barycentric)
    row[:, 2] += value[:, 0]
    return PlateView(facing, barycentric, row, *_mesh(corner))


def _mesh(corner: FloatArray) -> tuple[FloatArray, float, tuple[int, int], IntArray, IntArray]:
    """Return low corner, cell size, cells along u and v, and the list of plates of every cell."""
    if len(corner) == 0:
        return np.zeros(2), 1.0, (0, 0), np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int64)
    low, high = corner.min(axis=1), corner.max(axis=1)
    origin, extent = low.min(axis=0), np.ptp(np.concatenate([low, high]), axis=0)
    side = float(np.sqrt(extent.prod() * PLATES_PER_CELL / len(corner)))
    side = max(side, float(extent.max()) / MOST_CELLS, np.finfo(float).tiny)
    cells = (int(extent[0] / side) + 1, int(extent[1] / side) + 1)
    begin, end = (
        np.floor((low - origin) / side).astype(np.int64),
        np.floor((high - origin) / side).astype(np.int64),
    )
    spans = end - begin + 1
    counts = spans.prod(axis=1)
    plate = np.repeat(np.arange(len(corner)), counts)
    within = np.arange(len(plate)) - np.repeat(np.cumsum(counts) - counts, counts)
    width = spans[plate, 0]
    cell = (begin[plate, 1] + within // width) * cells[0] + begin[plate, 0] + within % width
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(cells[0] * cells[1] + 1))
    return origin, side, cells, start.astype(np.int64), plate[order]
