"""Where the pixels of a window look: exact directions, made cheap by a polynomial that is checked against them.

Every pixel of a window needs its geometric direction (distortion and stellar aberration undone). Both are smooth, so
they are evaluated at Chebyshev nodes only; the interpolating polynomial is compared with exact directions between the
nodes, and its degree doubled until they agree. Within one pixel directions are linear: the second derivative of any
distortion that a flight camera has (1e-3 px/px^2 at most) moves them by less than 1e-4 px over half a pixel.

Frame  gnomonic plane about the window's middle: direction = axis + x east + y north, J2000, not normalised
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import geometric_direction, unit

__all__ = ["PixelGrid", "Window", "pixel_grid"]

Window = tuple[int, int, int, int]  # first pixel, first line, pixels, lines

DEGREES = (3, 6, 12, 24, 48)
ALLOWED_ERROR_PX = 1e-6  # an edge that runs along a row of finest cells is not moved to the next row


@dataclass(frozen=True, slots=True, eq=False)
class PixelGrid:
    """Directions of the pixel centers of a window, and how they change across a pixel."""

    window: Window
    axes: FloatArray  # (3, 3) columns east, north, axis: J2000
    xy: FloatArray  # (2, n_line, n_pixel) gnomonic plane
    slope: FloatArray  # (2, 2, n_line, n_pixel) d(x, y) / d(pixel, line)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and pixels."""
        return self.window[3], self.window[2]

    @property
    def solid_angle(self) -> FloatArray:
        """Solid angle of each pixel, sr (n_line, n_pixel)."""
        area = np.abs(self.slope[0, 0] * self.slope[1, 1] - self.slope[0, 1] * self.slope[1, 0])
        return np.asarray(area * (1.0 + self.xy[0] ** 2 + self.xy[1] ** 2) ** -1.5)

    @property
    def half_pixel_rad(self) -> float:
        """Largest angle from a pixel's center to its corner."""
        return float(0.5 * np.max(np.hypot(self.slope[0], self.slope[1]).sum(axis=0)))

    def directions(self) -> FloatArray:
        """Return the directions of all pixel centers, (3, n_line * n_pixel), not normalised."""
        return self._to_j2000(self.xy[0].ravel(), self.xy[1].ravel())

    def directions_within(self, pixels: IntArray, offsets: FloatArray) -> FloatArray:
        """Return directions (3, n, k) at offsets (n or 1, k, 2) px from the centers of pixels (n,), flat indices."""
        slope = self.slope.reshape(4, -1)[:, pixels, None]
        dx, dy = offsets[..., 0], offsets[..., 1]
        x = self.xy[0].ravel()[pixels, None] + slope[0] * dx + slope[1] * dy
        y = self.xy[1].ravel()[pixels, None] + slope[2] * dx + slope[3] * dy
        return self._to_j2000(x, y)

    def _to_j2000(self, x: FloatArray, y: FloatArray) -> FloatArray:
        out = np.empty((3, *x.shape))
        for row in range(3):
            np.multiply(x, self.axes[row, 0], out=out[row])
            out[row] += y * self.axes[row, 1]
            out[row] += self.axes[row, 2]
        return out


def pixel_grid(
    camera: Camera, camera_from_j2000: FloatArray, observer_velocity_km_s: FloatArray, window: Window
) -> PixelGrid:
    """Return the directions that the pixels of a window look along.

    Raises
    ------
    CameraError
        The window reaches beyond what the camera's distortion model covers.
    """
    first = np.array(window[:2], dtype=np.float64) - 0.5
    size = np.array(window[2:], dtype=np.float64)

    def look(at: FloatArray) -> FloatArray:
        apparent = camera.unproject(first + 0.5 * size * (at + 1.0)) @ camera_from_j2000
        if not np.isfinite(apparent).all():
            raise CameraError(
                f"{camera.name}: window {window} reaches beyond the distortion model; keep it nearer to the detector."
            )
        return geometric_direction(apparent, observer_velocity_km_s)

    axes = _tangent_axes(look(np.zeros((1, 2)))[0])
    coefficients = _fitted(lambda at: _gnomonic(look(at), axes), camera)
    return _evaluated(window, axes, coefficients)


def _tangent_axes(axis: FloatArray) -> FloatArray:
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    east = unit(np.cross(helper, axis))
    return np.stack([east, np.cross(axis, east), axis], axis=-1)


def _gnomonic(directions: FloatArray, axes: FloatArray) -> FloatArray:
    local = directions @ axes
    return np.asarray(local[..., :2] / local[..., 2:])


def _fitted(xy_at: Callable[[FloatArray], FloatArray], camera: Camera) -> FloatArray:
    """Return Chebyshev coefficients (2, degree + 1, degree + 1) [axis, line power, pixel power]."""
    for degree in DEGREES:
        n = degree + 1
        node = np.cos(np.pi * (np.arange(n) + 0.5) / n)
        inverse = np.linalg.inv(chebyshev.chebvander(node, degree))
        fitted = np.einsum("ai,bj,ijk->kab", inverse, inverse, xy_at(_mesh(node)))
        probe = np.cos(np.pi * np.arange(n + 1) / n)  # the ends and the places between the nodes
        vander = chebyshev.chebvander(probe, degree)
        error = np.einsum("ia,jb,kab->ijk", vander, vander, fitted) - xy_at(_mesh(probe))
        if np.max(np.abs(error)) < ALLOWED_ERROR_PX * camera.pixel_scale_rad:
            return np.asarray(fitted)
    raise CameraError(
        f"{camera.name}: directions over the picture do not follow a polynomial of degree {DEGREES[-1]} to "
        f"{ALLOWED_ERROR_PX} px; check the distortion coefficients."
    )


def _mesh(at: FloatArray) -> FloatArray:
    line, pixel = np.meshgrid(at, at, indexing="ij")
    return np.stack([pixel, line], axis=-1)


def _evaluated(window: Window, axes: FloatArray, coefficients: FloatArray) -> PixelGrid:
    degree = coefficients.shape[-1] - 1
    tables = []
    for size in window[2:]:
        at = (2.0 * np.arange(size) + 1.0) / size - 1.0
        value = chebyshev.chebvander(at, degree)
        derivative = value[:, :-1] @ chebyshev.chebder(np.eye(degree + 1)) * (2.0 / size)
        tables.append((value, derivative))
    (pixel, d_pixel), (line, d_line) = tables
    xy = line @ coefficients @ pixel.T
    slope = np.stack([line @ coefficients @ d_pixel.T, d_line @ coefficients @ pixel.T], axis=1)
    return PixelGrid(window, axes, xy, slope)
