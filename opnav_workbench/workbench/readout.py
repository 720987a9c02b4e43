"""What the page needs to tell RA and Dec under the cursor without asking Python.

Flow   (pixel, line) -> Chebyshev series of its tile -> tangents (a/c, b/c) of the camera's focal axes -> J2000
Error  held against the camera when the series are made; tiles are halved until it is below `TOLERANCE_PX`

Series stand for every distortion model alike, so that the page holds one short evaluation (static/camera.js) and none
of the models. Tiles, because a model may have a kink where its series ends (MVIC: 12 columns from the edge).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera

__all__ = ["sky_readout"]

TOLERANCE_PX = 1e-3  # a tenth of what a person reads
DEGREE = 8
CHECK_POINTS = (
    21  # a side of the grid on which a tile is held against the camera; shares no node with the series
)
SMALLEST_PX = 4.0  # a tile this small is not halved any more


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A rectangle of the detector and its series.

    Attributes
    ----------
    corners : (2, 2) array
        First and last (pixel, line), px.
    coefficients : (2, d + 1, d + 1) array
        Of T_i(u) T_j(v), for the tangents along pixel and line; u and v run from -1 to 1 over the tile.
    error_px
        Largest difference from the camera that was found.
    """

    corners: FloatArray
    coefficients: FloatArray
    error_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def tangents(self, pixel_line: FloatArray) -> FloatArray:
        """Tangents (n, 2) along pixel and line of points (n, 2) px."""
        u, v = (2.0 * (pixel_line - self.corners[0]) / (self.corners[1] - self.corners[0]) - 1.0).T
        return np.stack([chebyshev.chebval2d(u, v, series) for series in self.coefficients], axis=-1)

    def holds(self, pixel_line: FloatArray) -> np.ndarray:
        """Tell which points lie in the tile."""
        return np.asarray(((pixel_line >= self.corners[0]) & (pixel_line <= self.corners[1])).all(axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class SkyReadout:
    """A camera with an attitude, as series over the detector.

    Attributes
    ----------
    tiles
        They cover the detector, edges included.
    j2000_from_focal : (3, 3) array
        From the focal axes (pixel, line, boresight) to J2000.
    """

    tiles: tuple[Tile, ...]
    j2000_from_focal: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def error_px(self) -> float:
        """Largest difference from the camera that was found."""
        return max(tile.error_px for tile in self.tiles)

    def directions(self, pixel_line: ArrayLike) -> FloatArray:
        """Return J2000 unit vectors (n, 3) of points (n, 2) px, as the page computes them; nan off the detector."""
        points = np.asarray(pixel_line, float)
        rays = np.full((len(points), 3), np.nan)
        for tile in self.tiles:
            here = tile.holds(points)
            rays[here] = np.c_[tile.tangents(points[here]), np.ones(here.sum())]
        return np.asarray((rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ self.j2000_from_focal.T)

    def as_page_values(self) -> dict[str, Any]:
        """Return plain values for static/camera.js."""
        tiles = [{"corners": t.corners.tolist(), "coefficients": t.coefficients.tolist()} for t in self.tiles]
        return {"tiles": tiles, "j2000_from_focal": self.j2000_from_focal.tolist()}


def sky_readout(camera: Camera, camera_from_j2000: FloatArray) -> SkyReadout:
    """Return the series of a camera at an attitude.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> readout = sky_readout(camera, np.eye(3))
    >>> readout.directions([[611.5, 511.5]]).round(6) + 0.0
    array([[0.001, 0.   , 1.   ]])
    """
    return SkyReadout(_tiles(camera), camera_from_j2000.T @ camera.focal_from_camera.T)


@lru_cache(maxsize=8)  # a session's camera stays, its attitude changes with every star
def _tiles(camera: Camera) -> tuple[Tile, ...]:
    whole = _tile(camera, np.array([[-0.5, -0.5], [camera.n_pixel - 0.5, camera.n_line - 0.5]]))
    return tuple(_halved(camera, whole)) if whole.error_px > TOLERANCE_PX else (whole,)


def _halved(camera: Camera, tile: Tile) -> list[Tile]:
    """Halve a tile across a kink: the half without it is then good at once."""
    pairs = []
    for axis in (0, 1):
        lower, upper = tile.corners.copy(), tile.corners.copy()
        lower[1, axis] = upper[0, axis] = tile.corners[:, axis].mean()
        pairs.append([_tile(camera, lower), _tile(camera, upper)])
    best = min(pairs, key=lambda pair: min(half.error_px for half in pair))
    if (best[0].corners[1] - best[0].corners[0]).min() < SMALLEST_PX:
        return best
    good = [half for half in best if half.error_px <= TOLERANCE_PX]
    return good + [part for half in best if half not in good for part in _halved(camera, half)]


def _tile(camera: Camera, corners: FloatArray) -> Tile:
    """Interpolate at Chebyshev's nodes, and hold the series against the camera."""
    nodes = chebyshev.chebpts1(DEGREE + 1)
    values = _tangents(camera, _grid(nodes, corners)).reshape(DEGREE + 1, DEGREE + 1, 2)
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, DEGREE))
    coefficients = np.stack([inverse @ values[..., axis] @ inverse.T for axis in (0, 1)])
    check = _grid(np.linspace(-1.0, 1.0, CHECK_POINTS), corners)
    found = Tile(corners, coefficients, np.nan).tangents(check)
    error_px = float(np.abs(found - _tangents(camera, check)).max() / camera.pixel_scale_rad)
    return Tile(corners, coefficients, error_px)


def _grid(nodes: FloatArray, corners: FloatArray) -> FloatArray:
    """Points (k^2, 2) px, the pixel changing slowest."""
    axes = [low + 0.5 * (high - low) * (nodes + 1.0) for low, high in corners.T]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def _tangents(camera: Camera, pixel_line: FloatArray) -> FloatArray:
    focal = camera.unproject(pixel_line) @ camera.focal_from_camera.T
    return np.asarray(focal[:, :2] / focal[:, 2:])
