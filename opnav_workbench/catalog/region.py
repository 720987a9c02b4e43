"""Regions of the sky that a catalog can be asked for: a cone, and a convex polygon such as a detector's footprint."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import angle_between

__all__ = ["Cone", "Region", "polygon_region"]

MIN_CORNERS = 3
# Sine of the distance by which a star may stand beyond an edge and still count: rounding, 0.2 microarcsec. Corners
# nearer to each other than SAME_CORNER span no edge.
EDGE_TOLERANCE = 1e-12
SAME_CORNER = 1e-9
WIDE_RAD = 1e-3  # of wider cones the cosine tells the edge to 1e-9 rad, where the angle decides
COSINE_ROUNDING = 1e-12
EDGE_SHARE = 1e-6  # a star whose squared distance is this near to that of a cone's edge is measured exactly


class Region(Protocol):
    """A part of the sky inside a cone about its center."""

    @property
    def center(self) -> FloatArray:
        """Unit vector (3,), J2000."""

    @property
    def radius_rad(self) -> float:
        """Angle from the center that nothing inside exceeds."""

    def contains(self, directions: FloatArray) -> BoolArray:
        """Return whether unit vectors (n, 3) lie inside, the edge included."""


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """All directions within `radius_rad` of a center."""

    center: FloatArray  # (3,)
    radius_rad: float

    @classmethod
    def about(cls, ra_rad: float, dec_rad: float, radius_rad: float) -> "Cone":
        """Return the cone about a right ascension and declination."""
        # As `unit_from_radec`, which is for arrays: for one direction that is a third of a small cone's time.
        across = math.cos(dec_rad)
        center = np.array([across * math.cos(ra_rad), across * math.sin(ra_rad), math.sin(dec_rad)])
        return cls(center, radius_rad)

    def contains(self, directions: FloatArray) -> BoolArray:
        """Return whether unit vectors (n, 3) lie within the radius (n,)."""
        if self.radius_rad > WIDE_RAD:
            above = directions @ self.center
            above -= math.cos(self.radius_rad)
            inside, perhaps = above > COSINE_ROUNDING, above >= -COSINE_ROUNDING
            if np.count_nonzero(inside) == np.count_nonzero(perhaps):  # as nearly always, and told soon
                return inside
            return self._exact_at(perhaps & ~inside, inside, directions)
        offset = directions - self.center
        chord2 = np.einsum("ij,ij->i", offset, offset)
        limit2 = 4.0 * np.sin(0.5 * self.radius_rad) ** 2
        inside = chord2 < limit2
        edge = np.abs(chord2 - limit2) <= EDGE_SHARE * limit2 + SAME_CORNER**2
        return self._exact_at(edge, inside, directions)

    def _exact_at(self, edge: BoolArray, inside: BoolArray, directions: FloatArray) -> BoolArray:
        if edge.any():  # the angle itself is exact to rounding, but takes ten times as long
            inside[edge] = angle_between(directions[edge], self.center) <= self.radius_rad
        return np.asarray(inside)


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """A convex spherical polygon smaller than a hemisphere, by the planes of its edges."""

    center: FloatArray  # (3,)
    radius_rad: float  # to the farthest corner
    normals: FloatArray  # (m, 3) unit vectors, pointing inside

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def contains(self, directions: FloatArray) -> BoolArray:
        """Return whether unit vectors (n, 3) lie on the inner side of every edge (n,)."""
        return np.asarray(np.all(directions @ self.normals.T >= -EDGE_TOLERANCE, axis=-1))


def polygon_region(corners: ArrayLike) -> Polygon:
    """Return the polygon with these corners.

    Parameters
    ----------
    corners : (m, 3) array_like
        Directions of at least three corners in order along the edge, either way round, J2000; any length.

    Raises
    ------
    CatalogError
        Fewer than three corners, one that is no direction, or corners that are not those of a convex polygon
        smaller than a hemisphere.

    Examples
    --------
    >>> octant = polygon_region(np.eye(3))
    >>> octant.contains(np.array([[0.6, 0.8, 0.0], [0.6, -0.8, 0.0]])).tolist()
    [True, False]
    """
    points = np.asarray(corners, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < MIN_CORNERS:
        raise CatalogError(f"polygon corners have shape {points.shape}; give (m, 3) with m of at least 3.")
    length = np.linalg.norm(points, axis=1, keepdims=True)
    if not np.all(np.isfinite(length)) or np.any(length == 0.0):
        raise CatalogError("a polygon corner is no direction; give finite vectors that are not zero.")
    points = points / length
    normals = np.cross(points, np.roll(points, -1, axis=0))
    spans = np.linalg.norm(normals, axis=1, keepdims=True)
    center = points.sum(axis=0)
    if np.any(spans < SAME_CORNER) or np.linalg.norm(center) < SAME_CORNER:
        raise CatalogError(
            "two polygon corners that follow each other coincide or are opposite; give each corner once."
        )
    center, normals = center / np.linalg.norm(center), normals / spans
    normals = normals * np.sign(np.sum(normals @ center))
    if not _is_convex(points, normals, center):
        raise CatalogError(
            "the corners are not those of a convex polygon smaller than a hemisphere; give them in order along the edge."
        )
    return Polygon(center, float(np.max(angle_between(points, center))), normals)


def _is_convex(points: FloatArray, normals: FloatArray, center: FloatArray) -> bool:
    sides = points @ normals.T  # (corner, edge)
    return bool(
        np.all(sides >= -SAME_CORNER) and np.all(points @ center > 0.0) and np.all(normals @ center > 0.0)
    )
