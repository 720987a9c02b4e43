"""What a renderer asks of a body's surface, and a triaxial ellipsoid that answers.

`Surface` is the protocol that ellipsoids and shape models share. For the ellipsoid everything follows from one scaling, as
in `opnav_workbench.geometry.conics`: divide body coordinates by the radii, and the body becomes a unit sphere. A ray
``c + t m`` from the camera at ``c`` meets it where

    |m|^2 t^2 + 2 (c.m) t + |c|^2 - 1 = 0,    discriminant / 4 = |m|^2 - |c x m|^2

The second form of the discriminant keeps the shape of a distant body, which the first, a difference of two squares of
the distance, would lose. It is negative outside the limb.

Frame  body-fixed, origin at the body's center; vectors are arrays (3, n)
Units  km, rad
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, gauss_legendre
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import unit

__all__ = ["Ellipsoid", "Surface", "SurfaceNodes", "SurfacePoints", "column_dot"]


# ---- What a renderer asks of a body's surface, ellipsoid or shape model alike.


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Where rays first meet a surface; rays that miss it are left out."""

    ray: IntArray  # (n,) which ray
    point: FloatArray  # (3, n) km
    normal: FloatArray  # (3, n) outward unit vectors
    distance: FloatArray  # (n,) along the ray, in units of the ray vector's length


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceNodes:
    """Points that stand for the lit and visible surface: an integral over it is a sum over them."""

    point: FloatArray  # (3, n) km
    normal: FloatArray  # (3, n) outward unit vectors
    solid_angle: FloatArray  # (n,) sr, as the camera sees the piece that the node stands for


class Surface(Protocol):
    """A body's surface as one camera sees it and the Sun lights it."""

    @property
    def bounding_km(self) -> float:
        """Radius of a sphere about the body's center that holds the surface."""
        ...

    def first_hits(self, rays: FloatArray) -> SurfacePoints:
        """Return where rays (3, n) from the camera first meet the surface."""
        ...

    def crossed_by_limb(self, rays: FloatArray, reach_rad: float) -> BoolArray:
        """Tell for rays (3, n) whether the limb may lie within `reach_rad` of them."""
        ...

    def sunlit(self, points: FloatArray) -> BoolArray:
        """Tell which of its points (3, n) the surface itself does not shade from the Sun."""
        ...

    def inside_limb(self, points: FloatArray, toward: FloatArray) -> FloatArray:
        """Return how far rays from outside points (3, n) along unit vectors to the Sun pass inside the limb, rad.

        Negative for those that pass the body by.
        """
        ...

    def nodes(self, *, patterned: bool) -> SurfaceNodes:
        """Return points over the lit and visible part of the surface: more of them if it bears a pattern."""
        ...


def column_dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot products of vectors (3, ...), column by column."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


# ---- A triaxial ellipsoid as a surface to render.

# Gauss-Legendre nodes in latitude and in longitude: smooth laws to 1e-9, maps of 1 deg cells to 1e-3.
NODES, PATTERN_NODES = 64, 256


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """An ellipsoid seen by a camera at `camera_km` and lit by the Sun at `sun_km`, both body-fixed."""

    radii_km: FloatArray  # (3,) semi-axes along x, y, z
    camera_km: FloatArray  # (3,)
    sun_km: FloatArray  # (3,)
    _camera: FloatArray = field(
        init=False, repr=False
    )  # the same in the space where the body is a unit sphere

    def __post_init__(self) -> None:
        object.__setattr__(self, "_camera", self.camera_km / self.radii_km)
        for who, where in (("camera", self._camera), ("Sun", self.sun_km / self.radii_km)):
            if not np.linalg.norm(where) > 1.0:
                raise CameraError(
                    f"the {who} is {np.linalg.norm(where):.6g} body radii from the center of an ellipsoid of "
                    f"{self.radii_km.tolist()} km; it must stand outside."
                )

    @property
    def bounding_km(self) -> float:
        """Its largest radius."""
        return float(self.radii_km.max())

    def first_hits(self, rays: FloatArray) -> SurfacePoints:
        """Return where rays (3, n) from the camera first meet the surface."""
        scaled, under = self._discriminant(rays)
        toward = column_dot(self._camera, scaled)
        ray = np.flatnonzero((under > 0.0) & (toward < 0.0))
        scaled, under, toward = scaled[:, ray], under[ray], toward[ray]
        along = (-toward - np.sqrt(under)) / column_dot(scaled, scaled)
        sphere = scaled
        sphere *= along
        sphere += self._camera[:, None]
        return SurfacePoints(ray, sphere * self.radii_km[:, None], self._normal(sphere), along)

    def crossed_by_limb(self, rays: FloatArray, reach_rad: float) -> BoolArray:
        """Tell for rays (3, n) whether the limb may lie within `reach_rad` of them.

        The discriminant is a quadratic form of the ray: it cannot change by more than its gradient and half its
        largest curvature allow.
        """
        scaled, under = self._discriminant(rays)
        across = _cross(self._camera, scaled)
        gradient = 2.0 * (scaled - _cross(across, self._camera)) / self.radii_km[:, None]
        curvature = (self._camera @ self._camera + 1.0) / self.radii_km.min() ** 2
        reach = reach_rad * np.sqrt(column_dot(rays, rays))
        bound = np.sqrt(column_dot(gradient, gradient)) * reach + curvature * reach * reach
        return np.asarray(np.abs(under) <= bound)

    def sunlit(self, points: FloatArray) -> BoolArray:
        """Return True: a convex body casts no shadow on what faces the Sun."""
        return np.ones(points.shape[1], dtype=bool)

    def inside_limb(self, points: FloatArray, toward: FloatArray) -> FloatArray:
        """Return how far rays from points (3, n) along unit vectors `toward` (3, n) pass inside the limb, rad.

        Positive: through the body. The angle is that from the ray to the limb as the point sees it; behind the
        point counts as -pi.
        """
        start, step = points / self.radii_km[:, None], toward / self.radii_km[:, None]
        along = -column_dot(start, step) / column_dot(step, step)
        nearest = start + along * step
        miss = np.sqrt(column_dot(nearest, nearest))
        # The limb lies where the ray, turned about the point, just touches: scale the nearest point onto the surface.
        closest_km = np.sqrt(column_dot(nearest * self.radii_km[:, None], nearest * self.radii_km[:, None]))
        inside_km = closest_km * (1.0 / np.maximum(miss, 1e-12) - 1.0)
        return np.asarray(np.where(along > 0.0, np.arctan2(inside_km, np.maximum(along, 1e-300)), -np.pi))

    def nodes(self, *, patterned: bool) -> SurfaceNodes:
        """Return Gauss-Legendre nodes over the lit and visible part of the surface.

        On the scaled sphere limb and terminator are circles, so that at a latitude counted from the plane of camera
        and Sun the lit and visible longitudes are one interval with known ends: the integrand is smooth on it.
        """
        sphere, share = _lune(
            self._camera, self.sun_km / self.radii_km, PATTERN_NODES if patterned else NODES
        )
        normal = self._normal(sphere)
        point = sphere * self.radii_km[:, None]
        # Area of the ellipsoid per area of the unit sphere.
        stretch = np.prod(self.radii_km) * np.sqrt(
            column_dot(sphere / self.radii_km[:, None], sphere / self.radii_km[:, None])
        )
        to_camera = self.camera_km[:, None] - point
        range2 = column_dot(to_camera, to_camera)
        cos_e = column_dot(normal, to_camera) / np.sqrt(range2)
        return SurfaceNodes(point, normal, share * stretch * np.maximum(cos_e, 0.0) / range2)

    def _discriminant(self, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        scaled = rays / self.radii_km[:, None]
        across = _cross(self._camera, scaled)
        return scaled, column_dot(scaled, scaled) - column_dot(across, across)

    def _normal(self, sphere: FloatArray) -> FloatArray:
        normal = sphere / self.radii_km[:, None]
        normal /= np.sqrt(column_dot(normal, normal))
        return normal


def _lune(camera: FloatArray, sun: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return points (3, n) of the unit sphere that both see, and the area (n,) each stands for."""
    middle = unit(camera)
    pole = np.cross(camera, sun)
    if np.linalg.norm(pole) <= 1e-12 * np.linalg.norm(camera) * np.linalg.norm(sun):
        pole = np.cross(middle, np.eye(3)[np.argmin(np.abs(middle))])
    pole = unit(pole)
    side = np.cross(pole, middle)
    sun_longitude = np.arctan2(sun @ side, sun @ middle)
    node, weight = gauss_legendre(n)
    # Beyond the latitude where one of the circles ends there is nothing to see or no light.
    highest = np.arccos(1.0 / min(float(np.linalg.norm(camera)), float(np.linalg.norm(sun))))
    latitude, d_latitude = highest * node, highest * weight
    cos_latitude = np.cos(latitude)
    see = np.arccos(np.minimum(1.0 / (np.linalg.norm(camera) * cos_latitude), 1.0))
    lit = np.arccos(np.minimum(1.0 / (np.linalg.norm(sun) * cos_latitude), 1.0))
    low, high = np.maximum(-see, sun_longitude - lit), np.minimum(see, sun_longitude + lit)
    half = 0.5 * np.maximum(high - low, 0.0)
    longitude = 0.5 * (high + low) + half * node[:, None]
    area = weight[:, None] * half * d_latitude * cos_latitude
    c, s = np.cos(longitude) * cos_latitude, np.sin(longitude) * cos_latitude
    up = np.broadcast_to(np.sin(latitude), c.shape)
    points = [c * middle[k] + s * side[k] + up * pole[k] for k in range(3)]
    return np.stack(points).reshape(3, -1), area.ravel()


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of vectors (3,) or (3, n), of which one is an array."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
