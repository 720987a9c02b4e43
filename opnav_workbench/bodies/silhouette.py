"""The outline of a body in the picture: where its limb falls, for ellipsoids and for shape models of plates.

Flow   body model -> limb directions (or edges of plates on the silhouette) -> stellar aberration -> camera -> px ->
       radius as a function of the angle about the center
Frame  (pixel, line); angles from +pixel toward +line

The camera model and aberration are exact for every point, so that nothing has to be undistorted afterwards, and the
center is the projected center of figure, which is not the center of the ellipse.

A plate model's silhouette runs along edges between a plate that faces the camera and one that does not. Where an outline
has several radii in one direction (a body that is not star-shaped as seen from its center) the outermost counts.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture, displaced_model
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, limb_points
from opnav_workbench.render import BodyModel, ShapeModel

__all__ = ["Outline", "Silhouette", "body_outline"]

# Grid of angles: its chords miss 1.2e-6 of the radius, 4e-4 px for a body of 600 px.
ANGLES = 2048
LIMB_SAMPLES = 360  # a periodic cubic spline through them follows an ellipse to 1e-7 of its radius
TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A closed line about a center, on an even grid of angles.

    Attributes
    ----------
    center_px : (2,) array
        Projected center of figure (pixel, line).
    angle_rad : (n,) array
        -pi to pi, the last a step short of it.
    radius_px : (n,) array
    """

    center_px: FloatArray
    angle_rad: FloatArray
    radius_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def radius(self, angle_rad: FloatArray) -> FloatArray:
        """Return the radius (...,) px in directions (...,)."""
        return np.asarray(np.interp(angle_rad, self.angle_rad, self.radius_px, period=TURN))

    def points(self, angle_rad: FloatArray) -> FloatArray:
        """Return the points (n, 2) px in directions (n,)."""
        wheel = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
        return np.asarray(self.center_px + self.radius(angle_rad)[:, None] * wheel)

    def strained(self, log_size: float, strain: FloatArray, height_px: FloatArray | float = 0.0) -> "Outline":
        """Return it larger, under `strain` (2,), xx = -yy and xy, to first order, and its radius larger by heights (n,)."""
        grown = np.exp(log_size) * (1.0 + strain @ self.waves(self.angle_rad, self.slant))
        return Outline(self.center_px, self.angle_rad, self.radius_px * grown + height_px)

    @staticmethod
    def waves(angle_rad: FloatArray, slant: FloatArray | float) -> FloatArray:
        """Return by how much of itself the radius grows (2, n) with each strain; `slant` (n,): its slope over itself.

        Of a circle cos 2a and sin 2a. A strain moves points along the outline, too.
        """
        cos, sin = np.cos(2.0 * angle_rad), np.sin(2.0 * angle_rad)
        return np.stack([cos + slant * sin, sin - slant * cos])

    def farthest_px(self, other: "Outline") -> float:
        """Return how far the limb lies from another one at most, along rays of the same grid of angles."""
        away = self.center_px - other.center_px
        shift = np.cos(self.angle_rad) * away[0] + np.sin(self.angle_rad) * away[1]
        return float(np.abs(shift + self.radius_px - other.radius_px).max())

    @property
    def slope_px(self) -> FloatArray:
        """Change of the radius with the angle (n,), px/rad."""
        step = TURN / len(self.angle_rad)
        return np.asarray((np.roll(self.radius_px, -1) - np.roll(self.radius_px, 1)) / (2.0 * step))

    @property
    def slant(self) -> FloatArray:
        """Slope over radius (n,), 1/rad."""
        return np.asarray(self.slope_px / self.radius_px)

    @property
    def diameter_px(self) -> float:
        """Diameter of the circle of the same area."""
        return float(2.0 * np.sqrt(np.mean(self.radius_px**2)))

    @property
    def reach_px(self) -> FloatArray:
        """Largest distance from the center to lower pixel, lower line, higher pixel, higher line (4,)."""
        away = self.points(self.angle_rad) - self.center_px
        return np.concatenate([-away.min(axis=0), away.max(axis=0)])


class Silhouette:
    """The outlines of one body of a picture, wherever it is placed.

    Raises
    ------
    CenterfindingError
        The body has no size.
    """

    def __init__(self, picture: BodyPicture, name: str) -> None:
        model = picture.model(name)
        if model.is_point:
            raise CenterfindingError(
                f"{name} has no radii and no shape, so it has no limb; give its radii, or use method 'unresolved'."
            )
        self.picture, self.name, self.shape = picture, name, model.shape
        self._edges = None if model.shape is None else _shared_edges(model.shape)
        self._outlines: dict[tuple[float, ...], Outline] = {}  # asked for again and again at the same place

    def at(self, center_px: FloatArray, range_scale: float = 1.0) -> Outline:
        """Return the outline with the center of figure at `center_px`, the range scaled.

        Raises
        ------
        CenterfindingError
            The body there leaves what the camera model covers.
        """
        center = np.array(center_px, dtype=np.float64)
        where = (*center.tolist(), range_scale)
        if where not in self._outlines:
            model = displaced_model(self.picture, self.name, center, range_scale)
            radius = (
                self._ellipsoid_radius(model, center) if self.shape is None else self._plates(model, center)
            )
            self._outlines[where] = Outline(center, _grid(), radius)
        return self._outlines[where]

    def _project(self, directions: FloatArray) -> FloatArray:
        picture = self.picture
        apparent = apparent_direction(directions, picture.observer_velocity_km_s)
        places = picture.camera.project(apparent @ picture.camera_from_j2000.T)
        if not np.isfinite(places).all():
            raise CenterfindingError(
                f"{self.name}: its limb leaves what the model of {picture.camera.name} covers; it is too near or too "
                "far off the detector for a limb fit."
            )
        return places

    def _ellipsoid_radius(self, model: BodyModel, center: FloatArray) -> FloatArray:
        target = model.target
        turn = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
        assert target.radii_km is not None
        limb = self._project(limb_points(target.position_km, target.radii_km, turn.T, LIMB_SAMPLES)) - center
        angle, radius = np.arctan2(limb[:, 1], limb[:, 0]), np.hypot(limb[:, 0], limb[:, 1])
        order = np.argsort(angle)
        angle, radius = angle[order], radius[order]
        spline = CubicSpline(
            np.append(angle, angle[0] + TURN), np.append(radius, radius[0]), bc_type="periodic"
        )
        return np.asarray(spline(_grid()))

    def _plates(self, model: BodyModel, center: FloatArray) -> FloatArray:
        assert self.shape is not None
        assert self._edges is not None
        target = model.target
        turn = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
        camera_km = -turn @ target.position_km
        corner = self.shape.vertices_km[self.shape.plates[:, 0]]
        faces = np.einsum("ij,ij->i", self.shape.normals, camera_km - corner) > 0.0
        ends, plates = self._edges
        on_rim = ends[faces[plates[:, 0]] != faces[plates[:, 1]]]
        used, index = np.unique(on_rim, return_inverse=True)
        rays = (self.shape.vertices_km[used] - camera_km) @ turn
        places = self._project(rays) - center
        return _outermost(places[index.reshape(on_rim.shape)])


def body_outline(picture: BodyPicture, name: str) -> Outline:
    """Return a body's predicted outline.

    Raises
    ------
    CenterfindingError
        No such body, one without a size, or one that leaves what the camera model covers.
    """
    return Silhouette(picture, name).at(picture.center_px(name))


def _grid() -> FloatArray:
    return np.linspace(-np.pi, np.pi, ANGLES, endpoint=False)


@lru_cache(maxsize=4)  # a body is outlined again and again, strained or not
def _shared_edges(shape: ShapeModel) -> tuple[IntArray, IntArray]:
    """Return the edges (n, 2) of vertices that two plates share, and those plates (n, 2)."""
    plates = shape.plates
    edges = np.sort(np.concatenate([plates[:, [0, 1]], plates[:, [1, 2]], plates[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(plates)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero(np.all(edges[1:] == edges[:-1], axis=1))
    return edges[same], np.stack([owner[same], owner[same + 1]], axis=-1)


def _outermost(segments: FloatArray) -> FloatArray:
    """Return the largest radius on the grid of angles that segments (n, 2 ends, 2) about the origin reach."""
    step = TURN / ANGLES
    begin, end = segments[:, 0], segments[:, 1]
    first = np.arctan2(begin[:, 1], begin[:, 0])
    swing = np.arctan2(begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0], np.einsum("ij,ij->i", begin, end))
    low = np.minimum(first, first + swing)
    start = np.ceil((low + np.pi) / step).astype(np.int64)
    stop = np.floor((low + np.abs(swing) + np.pi) / step).astype(np.int64)
    count = np.maximum(stop - start + 1, 0)
    which = np.repeat(np.arange(len(segments)), count)
    cell = start[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    angle = cell * step - np.pi
    # The ray at this angle meets the segment's line where its cross product with the segment says.
    along = end[which] - begin[which]
    across = np.cos(angle) * along[:, 1] - np.sin(angle) * along[:, 0]
    moment = begin[which, 0] * along[:, 1] - begin[which, 1] * along[:, 0]
    radius = np.divide(moment, across, out=np.zeros_like(moment), where=np.abs(across) > 1e-12)
    out = np.zeros(ANGLES)
    np.maximum.at(out, cell % ANGLES, radius)
    if not np.any(out > 0.0):
        raise CenterfindingError(
            "the shape model has no silhouette about its center; check its origin and unit (km)."
        )
    gaps = out <= 0.0  # vertices that no plate pair shares leave holes: bridged by their neighbours
    out[gaps] = np.interp(np.flatnonzero(gaps), np.flatnonzero(~gaps), out[~gaps], period=ANGLES)
    return out
