"""A body made of triangular plates, as a shape and as a surface to render, with the shadows it casts on itself.

Frame  body-fixed, origin at the body's center; vectors are arrays (3, n), vertices rows (n, 3)
Units  km, rad

Seen by a bundle of rays (all through one point, or all parallel) a shape is a flat drawing: every vertex has a place (u, v)
on a plane across the bundle, and a nearness that is linear over each plate (1 / depth for rays through a point, height for
parallel ones). A ray is a point of that plane; the plate it meets is, among those whose triangle holds the point, the one
of greatest nearness. A square mesh over the drawing lists the plates that reach into each of its cells, so that a ray is
tested against a handful of plates, all rays at once. SPICE's ``dskxv`` gives the same places
(tests/render/test_shapes_rendered.py), at 12 to 25 microseconds a ray instead of one.
"""

from dataclasses import dataclass, field
from os import PathLike
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import unit
from opnav_workbench.geometry import unit as unit_vectors
from opnav_workbench.kernels.dsk_files import is_dsk, read_dsk
from opnav_workbench.kernels.shape_files import checked_shape, read_shape
from opnav_workbench.render.ellipsoid import SurfaceNodes, SurfacePoints, column_dot

__all__ = ["NO_PLATE", "PlateSurface", "ShapeModel", "bundle_axes", "parallel_view", "point_view"]


# ---- The plates that rays of one bundle meet first: all rays through one point, or all parallel.

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
    a, b, c = np.moveaxis(corner, 1, 0)
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    origin = low.min(axis=0)
    extent = high.max(axis=0) - origin
    side = float(np.sqrt(extent.prod() * PLATES_PER_CELL / len(corner)))
    side = max(side, float(extent.max()) / MOST_CELLS, np.finfo(float).tiny)
    cells = (int(extent[0] / side) + 1, int(extent[1] / side) + 1)
    begin, end = (
        np.floor((low - origin) / side).astype(np.int64),
        np.floor((high - origin) / side).astype(np.int64),
    )
    spans = end - begin + 1
    counts = spans[:, 0] * spans[:, 1]
    plate = np.repeat(np.arange(len(corner)), counts)
    within = np.arange(len(plate)) - np.repeat(np.cumsum(counts) - counts, counts)
    width = spans[plate, 0]
    cell = (begin[plate, 1] + within // width) * cells[0] + begin[plate, 0] + within % width
    start = np.cumsum(np.bincount(cell, minlength=cells[0] * cells[1]))
    # Numbers that hold cell and plate are sorted in a fraction of the time that a stable order of cells takes.
    listed = np.sort(cell * len(corner) + plate) % len(corner)
    return origin, side, cells, np.concatenate([[0], start]), listed


# ---- A body made of triangular plates.

NODES = (
    384  # rays along a side of the square about the body: its light to 1e-3, that of a thin crescent to 1e-2
)
# A point lies in shadow if a plate stands this much nearer to the Sun, in radii: above the rounding of its own height.
SHADOW_CLEARANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """A closed surface of plates; arrays are read-only.

    Attributes
    ----------
    vertices_km : (n, 3) array
        Body-fixed, from the body's center.
    plates : (m, 3) array of int
        Rows of `vertices_km`, counterclockwise as seen from outside; a shape that is wound the other way (its volume is
        negative) is turned round.

    Raises
    ------
    KernelError
        Empty, not finite, or plates that refer to vertices which are not there.

    Examples
    --------
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> ShapeModel(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).volume_km3
    0.16666666666666666
    """

    vertices_km: FloatArray
    plates: IntArray
    normals: FloatArray = field(init=False, repr=False)  # (m, 3) outward unit vectors

    def __init__(self, vertices_km: ArrayLike, plates: ArrayLike) -> None:
        vertices, index = checked_shape(vertices_km, plates, "shape model")
        if _volume(vertices, index) < 0.0:
            index = index[:, ::-1]
        a, b, c = (vertices[index[:, k]] for k in range(3))
        area2 = np.cross(b - a, c - a)
        full = np.linalg.norm(area2, axis=1) > 0.0  # plates without area are never met
        object.__setattr__(self, "vertices_km", vertices)
        object.__setattr__(self, "plates", np.ascontiguousarray(index[full]))
        object.__setattr__(self, "normals", unit_vectors(area2[full]))
        freeze_arrays(self)

    @classmethod
    def from_file(cls, path: str | PathLike[str], unit: str = "km") -> Self:
        """Read a shape of any format of `opnav_workbench.kernels.shape_files`, or a DSK (type 2), told by its content.

        Raises
        ------
        KernelError
            The file cannot be read or holds no usable shape.
        """
        if is_dsk(path):
            return cls(*read_dsk(path))
        return cls(*read_shape(path, unit))

    @property
    def radii_km(self) -> FloatArray:
        """Half of the extents along x, y, z (3,)."""
        return np.asarray(0.5 * np.ptp(self.vertices_km, axis=0))

    @property
    def bounding_km(self) -> float:
        """Radius of the sphere about the center that holds all vertices."""
        return float(np.linalg.norm(self.vertices_km, axis=1).max())

    @property
    def volume_km3(self) -> float:
        """Enclosed volume."""
        return _volume(self.vertices_km, self.plates)


class PlateSurface:
    """A shape seen by a camera at `camera_km` and lit by the Sun at `sun_km`, both body-fixed.

    The Sun's rays count as parallel: over a body of radius R at a distance r from the Sun their directions differ by
    R / r, 1e-9 for Bennu.
    """

    def __init__(self, shape: ShapeModel, camera_km: FloatArray, sun_km: FloatArray) -> None:
        range_km = float(np.linalg.norm(camera_km))
        if not range_km > shape.bounding_km:
            raise CameraError(
                f"the camera is {range_km:.6g} km from the center of a shape that reaches {shape.bounding_km:.6g} km; "
                "it must stand outside."
            )
        self._shape, self._camera, self._bounding_km = shape, camera_km, shape.bounding_km
        self._axes, self._sun_axes = bundle_axes(-camera_km), bundle_axes(sun_km)
        self._view = point_view(shape.vertices_km, shape.plates, camera_km, self._axes)
        self._sun_view = parallel_view(shape.vertices_km, shape.plates, self._sun_axes)

    @property
    def bounding_km(self) -> float:
        """Radius of the sphere about the center that holds the shape."""
        return self._bounding_km

    def first_hits(self, rays: FloatArray) -> SurfacePoints:
        """Return where rays (3, n) from the camera first meet the surface."""
        local = self._axes.T @ rays
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = np.where(local[2] > 0.0, local[:2] / local[2], np.inf)
        plate, nearness = self._view.first_met(uv)
        ray = np.flatnonzero(plate != NO_PLATE)
        along = 1.0 / (nearness[ray] * local[2, ray])
        point = self._camera[:, None] + along * rays[:, ray]
        return SurfacePoints(ray, point, np.ascontiguousarray(self._shape.normals[plate[ray]].T), along)

    def crossed_by_limb(self, rays: FloatArray, reach_rad: float) -> BoolArray:  # noqa: ARG002 - of the protocol
        """Return False: the outline of a shape shows where neighbouring rays differ."""
        return np.zeros(rays.shape[1], dtype=bool)

    def sunlit(self, points: FloatArray) -> BoolArray:
        """Tell which of its points (3, n) no plate shades from the Sun."""
        local, height = self._toward_sun(points)
        return np.asarray(local[2] >= height - SHADOW_CLEARANCE * self.bounding_km)

    def inside_limb(self, points: FloatArray, toward: FloatArray) -> FloatArray:  # noqa: ARG002 - all to the Sun
        """Return how far rays from points (3, n) to the Sun pass inside the outline: half a turn, or minus that."""
        local, height = self._toward_sun(points)
        return np.asarray(np.where(height > local[2], np.pi, -np.pi))

    def nodes(self, *, patterned: bool) -> SurfaceNodes:  # noqa: ARG002 - plates are a pattern anyway
        """Return the surface points that a square grid of rays meets, of which those in the dark are left out."""
        far = float(np.linalg.norm(self._camera))
        reach = np.tan(np.arcsin(self.bounding_km / far))
        at = reach * ((2.0 * np.arange(NODES) + 1.0) / NODES - 1.0)
        u, v = (g.ravel() for g in np.meshgrid(at, at))
        points = self.first_hits(self._axes @ np.stack([u, v, np.ones_like(u)]))
        lit = self.sunlit(points.point)
        u, v = u[points.ray[lit]], v[points.ray[lit]]
        solid_angle = (2.0 * reach / NODES) ** 2 * (1.0 + u * u + v * v) ** -1.5
        return SurfaceNodes(points.point[:, lit], points.normal[:, lit], solid_angle)

    def _toward_sun(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points in the Sun's axes, and the height of the plate that the Sun sees at each."""
        local = self._sun_axes.T @ points
        return local, self._sun_view.first_met(local[:2] * MIRROR)[1]


def _volume(vertices: FloatArray, plates: IntArray) -> float:
    a, b, c = (vertices[plates[:, k]].T for k in range(3))
    return float(np.sum(column_dot(a, np.cross(b, c, axis=0))) / 6.0)
