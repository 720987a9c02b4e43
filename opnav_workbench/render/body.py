"""One body to render: its model, that model placed before the camera and under the Sun, and its light as a whole.

The light (flux, center and spread) is summed over the surface, independent of the pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.constants import AU_KM, SUN_RADIUS_KM
from opnav_workbench.errors import MissionError
from opnav_workbench.render.ellipsoid import Ellipsoid, Surface, SurfacePoints, column_dot
from opnav_workbench.render.maps import AlbedoMap
from opnav_workbench.render.scattering import Lambert, ScatteringLaw
from opnav_workbench.render.shape import PlateSurface, ShapeModel
from opnav_workbench.targets import TargetState

__all__ = ["BodyModel", "FigureUncertainty", "IntegratedLight", "PlacedBody", "integrate_light"]


# ---- One body to render: its model, and that model placed before the camera and under the Sun.

PATTERN_PX = 0.25  # map cells are averaged up to this size: the spacing of rays in a divided pixel
COARSE_PATTERN_PX = 1.5  # a map of larger cells shows in rays one pixel apart


UNSTATED_SIZE, UNSTATED_AXES, UNSTATED_ALBEDO = 0.10, 0.05, 0.2  # of a first approach
LARGEST_SIGMA = 0.9  # what a part of a radius can be uncertain by
# Even in the logarithm, down to 0.08 and 0.04 %: as well as spacecraft that passed by have measured large bodies
# (Archinal et al. 2018, doi:10.1007/s10569-017-9805-5: 0.07 % for Pluto, 0.08 % for Rhea).
SCALES = (1.0, 0.2, 0.04, 0.008)
WILDEST_ALBEDO = 2.5  # of what is usual, as hemispheres of Iapetus differ


@dataclass(frozen=True, slots=True)
class FigureUncertainty:
    """How far a body may differ from its model: 1 sigma, as parts of the mean radius or brightness, above 0 and below 1.

    The defaults suit a first approach, where size and shape come from brightness and light curves. Of size and axes they say
    that nobody has stated how well they are known: then smaller scales, down to those of a figure that was measured before,
    are held to be as likely, and a picture of the disk weighs them (`size_scales`, `axes_scales`); so it does with what
    hemispheres differ by, which may be more as well (`albedo_scales`). What is stated is believed as it is.

    Attributes
    ----------
    size_sigma
        Of the mean radius.
    axes_sigma
        Of each principal axis of the outline, beside the common size.
    limb_roughness
        Root mean square of the topography. A limb that shows to be rougher by far is believed.
    albedo_sigma
        Of what whole hemispheres differ by in brightness. Light curves of Pluto, Charon, the large satellites of Jupiter and
        Saturn, Ceres and Vesta have 0.2 mag rms, with Iapetus 0.5.
    law_sigma
        How far the scattering law may be from the body's toward Lommel-Seeliger's, which is at 1. None: nothing is known of
        a law of Lambert's, which lies anywhere from there to Lommel-Seeliger's; any other is good to 0.3.

    Raises
    ------
    MissionError
        One of them is not between 0 and 1.
    """

    size_sigma: float = UNSTATED_SIZE
    axes_sigma: float = UNSTATED_AXES
    limb_roughness: float = 0.003
    albedo_sigma: float = UNSTATED_ALBEDO
    law_sigma: float | None = None

    def __post_init__(self) -> None:
        for label in (one.name for one in fields(self)):
            value = getattr(self, label)
            if value is not None and not 0.0 < value < 1.0:
                whole = {"albedo_sigma": "brightness", "law_sigma": "way between two laws"}.get(
                    label, "mean radius"
                )
                raise MissionError(f"{label} is {value}; give a part of the {whole}, above 0 and below 1.")

    @property
    def size_scales(self) -> tuple[float, ...]:
        """Sigmas that the size may have, the largest first; one if it is stated."""
        return _scales(self.size_sigma, UNSTATED_SIZE)

    @property
    def axes_scales(self) -> tuple[float, ...]:
        """Sigmas that the axes may have, the largest first; one if it is stated."""
        return _scales(self.axes_sigma, UNSTATED_AXES)

    @property
    def albedo_scales(self) -> tuple[float, ...]:
        """Sigmas that hemispheres may differ by, the largest first; one if it is stated."""
        return _scales(self.albedo_sigma, UNSTATED_ALBEDO, (WILDEST_ALBEDO, *SCALES))


def _scales(sigma: float, unstated: float, shares: tuple[float, ...] = SCALES) -> tuple[float, ...]:
    return tuple(sigma * share for share in shares) if sigma == unstated else (sigma,)


@dataclass(frozen=True, slots=True, eq=False)
class BodyModel:
    """A body and how its surface reflects light.

    Attributes
    ----------
    target
        Where it is, how it is turned and where its Sun is. A target without radii (and without `shape`) is a point.
    albedo
        Normal albedo, see `opnav_workbench.render.scattering`.
    shape
        Replaces the ellipsoid of ``target.radii_km``.
    flux_e
        Electrons of the whole body, unocculted and uneclipsed; `albedo` then sets the pattern only. None: from albedo
        and sunlight.
    figure
        How far size, axes and limb may differ from radii or shape; centerfinders ask, the picture that is drawn does not.

    Raises
    ------
    MissionError
        A negative albedo or flux, a point without `flux_e`, a body whose Sun is unknown, or one whose orientation matters
        and is unknown.
    """

    target: TargetState
    law: ScatteringLaw = field(default_factory=Lambert)
    albedo: float | AlbedoMap = 1.0
    shape: ShapeModel | None = None
    flux_e: float | None = None
    figure: FigureUncertainty = field(default_factory=FigureUncertainty)

    def __post_init__(self) -> None:
        name = self.target.name
        for label, value in (("albedo", self.albedo), ("flux_e", self.flux_e)):
            if isinstance(value, int | float) and not 0.0 <= value < np.inf:
                raise MissionError(f"{name}: {label} is {value}; give a finite number, not negative.")
        if self.is_point:
            if self.flux_e is None:
                raise MissionError(f"{name} has no radii; give flux_e for a point, or its radii or shape.")
            return
        if self.target.sun_position_km is None:
            raise MissionError(f"{name}: the Sun's direction is unknown; give the target's sun_position_km.")
        radii = self.target.radii_km
        round_and_plain = (
            self.shape is None
            and radii is not None
            and np.ptp(radii) == 0.0
            and not isinstance(self.albedo, AlbedoMap)
        )
        if self.target.body_from_j2000 is None and not round_and_plain:
            raise MissionError(
                f"{name}: its orientation is unknown, but its shape or map needs it; give body_from_j2000 (its pole and "
                "spin in a PCK), or make it a plain sphere (radius_km)."
            )

    @property
    def is_point(self) -> bool:
        """Whether the body has neither shape nor size."""
        radii = self.target.radii_km
        return self.shape is None and (radii is None or not np.all(radii > 0.0))

    @property
    def seen_figure(self) -> FigureUncertainty:
        """The figure with the size as it looks: where the range is uncertain, the size in the picture is, too."""
        covariance, along = self.target.covariance_km2, self.target.direction
        if covariance is None:
            return self.figure
        range_sigma = np.sqrt(np.maximum(along @ covariance @ along, 0.0)) / self.target.range_km
        size = float(np.hypot(self.figure.size_sigma, range_sigma))
        return (
            self.figure
            if size == self.figure.size_sigma
            else replace(self.figure, size_sigma=min(size, LARGEST_SIGMA))
        )


class PlacedBody:
    """A body that is not a point, placed before a camera: what every ray that meets it shows.

    Rays are J2000 vectors (3, n) from the camera, of any length; points on the surface are body-fixed, km.
    """

    def __init__(self, model: BodyModel, pixel_scale_rad: float) -> None:
        target = model.target
        assert target.sun_position_km is not None
        turn = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
        self.model, self.body_from_j2000 = model, turn
        self.camera_km, self.sun_km = -turn @ target.position_km, turn @ target.sun_position_km
        self.position_km: FloatArray = target.position_km
        self.surface: Surface = (
            PlateSurface(model.shape, self.camera_km, self.sun_km)
            if model.shape is not None
            else Ellipsoid(np.asarray(target.radii_km), self.camera_km, self.sun_km)
        )
        self.albedo = model.albedo
        self._finely_patterned = False
        if isinstance(self.albedo, AlbedoMap):
            pixel_rad = pixel_scale_rad * float(np.linalg.norm(self.camera_km)) / self.surface.bounding_km
            self.albedo = self.albedo.coarsened(PATTERN_PX * pixel_rad)
            self._finely_patterned = self.albedo.cell_rad < COARSE_PATTERN_PX * pixel_rad
        self._shading_bodies: list[PlacedBody] = []
        self._occulters: list[PlacedBody] = []

    @property
    def sunlight(self) -> float:
        """Sunlight at the body over that at 1 au."""
        return float((AU_KM / np.linalg.norm(self.sun_km)) ** 2)

    @property
    def occulters(self) -> "list[PlacedBody]":
        """Bodies that may stand before this one."""
        return self._occulters

    @property
    def finely_patterned(self) -> bool:
        """Whether its map has cells that one ray a pixel may miss."""
        return self._finely_patterned

    @property
    def angular_radius_rad(self) -> float:
        """Angular radius of the sphere that holds the body."""
        return float(np.arcsin(self.surface.bounding_km / np.linalg.norm(self.camera_km)))

    @property
    def phase_rad(self) -> float:
        """Angle Sun - body - camera, at the body's center."""
        cosine = self.camera_km @ self.sun_km / (np.linalg.norm(self.camera_km) * np.linalg.norm(self.sun_km))
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def to_body(self, rays: FloatArray) -> FloatArray:
        """Return J2000 rays (3, n) in the body-fixed frame."""
        return np.asarray(self.body_from_j2000 @ rays)

    def note_occulters(self, others: "list[PlacedBody]") -> None:
        """Note which of the other bodies may hide this one, or shade it."""
        self._occulters = [b for b in others if b is not self and b.may_occult(self)]
        self._shading_bodies = [b for b in others if b is not self and b.may_shade(self)]

    def radiance(self, rays: FloatArray) -> FloatArray:
        """Return I/F (n,) times sunlight (see `sunlight`) along rays; 0 where another body is nearer."""
        points = self.surface.first_hits(self.to_body(rays))
        out = np.zeros(rays.shape[1])
        out[points.ray] = self.brightness(points.point, points.normal)
        for other in self._occulters:
            if len(points.ray) == 0:
                break
            hidden = other.blocks(rays[:, points.ray], points.distance)
            out[points.ray[hidden]] = 0.0
        return out

    def brightness(self, point: FloatArray, normal: FloatArray) -> FloatArray:
        """Return I/F (n,) times sunlight of surface points (3, n) with outward normals."""
        to_camera, to_sun = self.camera_km[:, None] - point, self.sun_km[:, None] - point
        to_camera /= np.sqrt(column_dot(to_camera, to_camera))
        to_sun /= np.sqrt(column_dot(to_sun, to_sun))
        cos_i = column_dot(normal, to_sun)
        phase = (
            np.arccos(np.clip(column_dot(to_camera, to_sun), -1.0, 1.0)) if self.model.law.uses_phase else 0.0
        )
        shine = self.model.law.reflectance(cos_i, column_dot(normal, to_camera), phase)
        shine *= self.albedo.sample_points(point) if isinstance(self.albedo, AlbedoMap) else self.albedo
        shine *= self.sunlight
        return shine * self._sun_visible(point, to_sun, shine > 0.0)

    def blocks(self, rays: FloatArray, distance: FloatArray) -> BoolArray:
        """Tell which rays meet this body before `distance` (n,), in lengths of the ray vectors."""
        met: SurfacePoints = self.surface.first_hits(self.to_body(rays))
        out = np.zeros(rays.shape[1], dtype=bool)
        out[met.ray] = met.distance < distance[met.ray]
        return out

    def nodes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return J2000 rays (3, n) to points over the lit and visible surface, the light of each, and whether it is seen.

        Light is I/F times sunlight times solid angle, sr; the third array is 0 where another body stands before.
        """
        nodes = self.surface.nodes(patterned=isinstance(self.albedo, AlbedoMap))
        rays = self.body_from_j2000.T @ (nodes.point - self.camera_km[:, None])
        light = self.brightness(nodes.point, nodes.normal) * nodes.solid_angle
        seen = np.ones(len(light))
        for other in self._occulters:
            seen[other.blocks(rays, np.ones(len(light)))] = 0.0
        return rays, light, seen

    def _sun_visible(self, point: FloatArray, to_sun: FloatArray, lit: BoolArray) -> FloatArray:
        share = np.ones(point.shape[1])
        rows = np.flatnonzero(lit)
        share[rows] = self.surface.sunlit(point[:, rows])
        for other in self._shading_bodies:
            share[rows] *= other.sun_share_behind(self, point[:, rows], to_sun[:, rows])
        return share

    def sun_share_behind(self, shaded: "PlacedBody", point: FloatArray, to_sun: FloatArray) -> FloatArray:
        """Return the share of the Sun's disk that this body leaves free, seen from points of another body.

        The limb counts as straight across the Sun, and a body smaller than the Sun hides no more than its own area.
        """
        here_from_there = self.body_from_j2000 @ shaded.body_from_j2000.T
        offset = self.body_from_j2000 @ (shaded.position_km - self.position_km)
        inside = self.surface.inside_limb(here_from_there @ point + offset[:, None], here_from_there @ to_sun)
        sun_radius = SUN_RADIUS_KM / float(np.linalg.norm(self.sun_km))
        own_radius = self.surface.bounding_km / float(np.linalg.norm(offset))
        depth = np.clip(inside / sun_radius, -1.0, 1.0)
        covered = 0.5 + (depth * np.sqrt(1.0 - depth * depth) + np.arcsin(depth)) / np.pi
        return np.asarray(1.0 - covered * min(1.0, (own_radius / sun_radius) ** 2))

    def may_occult(self, other: "PlacedBody") -> bool:
        """Tell whether this body may stand before another, as the camera sees them."""
        cosine = self.position_km @ other.position_km
        across = float(np.linalg.norm(np.cross(self.position_km, other.position_km)))
        separation = np.arctan2(across, cosine)
        nearer = np.linalg.norm(self.camera_km) < np.linalg.norm(other.camera_km)
        return bool(nearer and separation < self.angular_radius_rad + other.angular_radius_rad)

    def touches(self, other: "PlacedBody") -> bool:
        """Tell whether this body may hide another, or cast its shadow on it."""
        return self.may_occult(other) or self.may_shade(other)

    def may_shade(self, other: "PlacedBody") -> bool:
        """Tell whether this body may cast its shadow on another."""
        offset = self.position_km - other.position_km
        sun = other.body_from_j2000.T @ other.sun_km
        along = float(offset @ sun / np.linalg.norm(sun))
        across = float(np.linalg.norm(offset - along * sun / np.linalg.norm(sun)))
        penumbra = along * SUN_RADIUS_KM / float(np.linalg.norm(sun))
        return along > 0.0 and across < self.surface.bounding_km + other.surface.bounding_km + penumbra


# ---- A body's light as a whole: flux, center and spread, summed over its surface.


@dataclass(frozen=True, slots=True, eq=False)
class IntegratedLight:
    """Light is the integral of I/F times sunlight over solid angle, sr; arrays are read-only.

    Attributes
    ----------
    total
        Light of the body alone.
    seen
        The part of it that no other body hides.
    center_px : (2,) array
        Its center; nan where none is seen, or where it falls behind the camera.
    covariance_px2 : (2, 2) array
        Its second moments about that.
    """

    total: float
    seen: float
    center_px: FloatArray
    covariance_px2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def occulted_fraction(self) -> float:
        """Share of the light that other bodies hide."""
        return 1.0 - self.seen / self.total if self.total > 0.0 else 0.0

    def four_points(self, scale: float) -> tuple[FloatArray, FloatArray]:
        """Return places (4, 2) px and light (4,) of points with this flux, center and second moments."""
        variance, axes = np.linalg.eigh(self.covariance_px2)
        arms = axes * np.sqrt(2.0 * np.maximum(variance, 0.0))
        places = self.center_px + np.concatenate([arms.T, -arms.T])
        return places, np.full(4, 0.25 * scale * self.seen)


def integrate_light(body: PlacedBody, project: Callable[[FloatArray], FloatArray]) -> IntegratedLight:
    """Return the light of a body; `project` gives the places (n, 2) px of geometric J2000 rays (3, n)."""
    rays, light, visible = body.nodes()
    total, weight = float(light.sum()), light * visible
    seen = float(weight.sum())
    if seen <= 0.0:
        return IntegratedLight(total, 0.0, np.full(2, np.nan), np.zeros((2, 2)))
    shining = weight > 0.0
    places, weight = project(rays[:, shining]), weight[shining] / seen
    if not np.isfinite(places).all():
        return IntegratedLight(total, seen, np.full(2, np.nan), np.zeros((2, 2)))
    center = weight @ places
    offset = places - center
    return IntegratedLight(total, seen, center, (offset * weight[:, None]).T @ offset)
