"""A body's light as a whole: flux, center and spread, summed over its surface."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.render.body import PlacedBody

__all__ = ["BodyLight", "body_light"]


@dataclass(frozen=True, slots=True, eq=False)
class BodyLight:
    """Light is the integral of I/F times sunlight over solid angle, sr; arrays are read-only.

    Attributes
    ----------
    total : float
        Light of the body alone.
    seen : float
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


def body_light(body: PlacedBody, project: Callable[[FloatArray], FloatArray]) -> BodyLight:
    """Return the light of a body; `project` gives the places (n, 2) px of geometric J2000 rays (3, n)."""
    rays, light, visible = body.nodes()
    total, weight = float(light.sum()), light * visible
    seen = float(weight.sum())
    if seen <= 0.0:
        return BodyLight(total, 0.0, np.full(2, np.nan), np.zeros((2, 2)))
    shining = weight > 0.0
    places, weight = project(rays[:, shining]), weight[shining] / seen
    if not np.isfinite(places).all():
        return BodyLight(total, seen, np.full(2, np.nan), np.zeros((2, 2)))
    center = weight @ places
    offset = places - center
    return BodyLight(total, seen, center, (offset * weight[:, None]).T @ offset)
