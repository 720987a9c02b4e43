"""What a renderer asks of a body's surface, ellipsoid or shape model alike.

Frame  body-fixed, origin at the body's center; vectors are arrays (3, n)
Units  km
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Nodes", "Surface", "SurfacePoints", "column_dot"]


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Where rays first meet a surface; rays that miss it are left out."""

    ray: IntArray  # (n,) which ray
    point: FloatArray  # (3, n) km
    normal: FloatArray  # (3, n) outward unit vectors
    distance: FloatArray  # (n,) along the ray, in units of the ray vector's length


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
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

    def meet(self, rays: FloatArray) -> SurfacePoints:
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

    def nodes(self, *, patterned: bool) -> Nodes:
        """Return points over the lit and visible part of the surface: more of them if it bears a pattern."""
        ...


def column_dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot products of vectors (3, ...), column by column."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
