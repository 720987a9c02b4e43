"""A body made of triangular plates: its shape, and that shape as a surface to render, with the shadows it casts on itself.

Frame  body-fixed, origin at the body's center; vectors are arrays (3, n), vertices rows (n, 3)
Units  km, rad
"""

from dataclasses import dataclass, field
from os import PathLike
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import unit as unit_vectors
from opnav_workbench.render.plates import MIRROR, NO_PLATE, bundle_axes, parallel_view, point_view
from opnav_workbench.render.surface import Nodes, SurfacePoints, column_dot
from opnav_workbench.spice.dsk import read_dsk
from opnav_workbench.spice.shapes import checked_shape, read_shape

__all__ = ["PlateSurface", "ShapeModel"]

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
        """Read an OBJ, cmod or DSK (``.bds``, type 2) file; see `opnav_workbench.spice.shapes.read_shape`.

        Raises
        ------
        KernelError
            The file cannot be read or holds no usable shape.
        """
        if str(path).lower().endswith((".bds", ".dsk")):
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
        self._shape, self._camera = shape, camera_km
        self._axes, self._sun_axes = bundle_axes(-camera_km), bundle_axes(sun_km)
        self._view = point_view(shape.vertices_km, shape.plates, camera_km, self._axes)
        self._sun_view = parallel_view(shape.vertices_km, shape.plates, self._sun_axes)

    @property
    def bounding_km(self) -> float:
        """Radius of the sphere about the center that holds the shape."""
        return self._shape.bounding_km

    def meet(self, rays: FloatArray) -> SurfacePoints:
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

    def nodes(self, *, patterned: bool) -> Nodes:  # noqa: ARG002 - plates are a pattern anyway
        """Return the surface points that a square grid of rays meets, of which those in the dark are left out."""
        far = float(np.linalg.norm(self._camera))
        reach = np.tan(np.arcsin(self.bounding_km / far))
        at = reach * ((2.0 * np.arange(NODES) + 1.0) / NODES - 1.0)
        u, v = (g.ravel() for g in np.meshgrid(at, at))
        points = self.meet(self._axes @ np.stack([u, v, np.ones_like(u)]))
        lit = self.sunlit(points.point)
        u, v = u[points.ray[lit]], v[points.ray[lit]]
        solid_angle = (2.0 * reach / NODES) ** 2 * (1.0 + u * u + v * v) ** -1.5
        return Nodes(points.point[:, lit], points.normal[:, lit], solid_angle)

    def _toward_sun(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points in the Sun's axes, and the height of the plate that the Sun sees at each."""
        local = self._sun_axes.T @ points
        return local, self._sun_view.first_met(local[:2] * MIRROR)[1]


def _volume(vertices: FloatArray, plates: IntArray) -> float:
    a, b, c = (vertices[plates[:, k]].T for k in range(3))
    return float(np.sum(column_dot(a, np.cross(b, c, axis=0))) / 6.0)
