"""The grid of a stack, and pictures resampled on it by cubic convolution: their noise is known as well as their light.

    grid pixel -> reference camera -> J2000 -> aberration, or the target's motion -> picture's attitude -> its camera

Both cameras' distortions are in it, so pictures of any pointing and twist fall on each other.  A grid that follows the
target turns with the direction in which ephemeris expects it: what it holds still is the target's O-C.

A grid pixel is the weighted sum of 4 x 4 pixels of the picture about the place where it lies, times the area that it has
there.  The weights sum to 1 over the pixels of the picture for every grid pixel, and over the grid pixels for every pixel
of the picture as far as both grids are alike: levels and fluxes are conserved.  Being linear (sparse matrices), the
covariance of resampled pixels is ``M diag(variance) M^T``.

Reference: Keys (1981), doi:10.1109/TASSP.1981.1163711 (a = -1/2).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.campaign.stacking.pictures import StackPicture
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, geometric_direction, least_turn, rotation_from_vector

__all__ = ["Follow", "Grid", "cubic_weights", "resample", "resampling_rows", "target_direction"]


# ---- The grid of a stack: pixels of a reference camera, and where each of them lies in every picture.

Follow = Literal["stars", "target"]


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Pixels of a stack; arrays are read-only.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
    observer_velocity_km_s : (3,) array
    follow : {"stars", "target"}
    target : (3,) array or None
        Apparent direction of the target at the stack's epoch, J2000.
    first : (2,) array of int
        (pixel, line) of the grid's first pixel in the reference camera.
    shape : (int, int)
        (n_line, n_pixel) of the grid.
    """

    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    follow: Follow
    target: FloatArray | None
    first: FloatArray
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if self.follow == "target" and self.target is None:
            raise CenterfindingError("a grid that follows the target needs its direction.")
        freeze_arrays(self)

    def centers(self) -> FloatArray:
        """Return the pixels' places in the reference camera (n, 2), line by line."""
        line, pixel = np.indices(self.shape)
        return np.asarray(np.stack([pixel.ravel(), line.ravel()], axis=1) + self.first, dtype=np.float64)

    def index(self, pixel_line: FloatArray) -> FloatArray:
        """Return places (..., 2) of the reference camera as (pixel, line) of the grid's own arrays."""
        return np.asarray(pixel_line - self.first)

    def to_picture(self, pixel_line: FloatArray, picture: StackPicture) -> FloatArray:
        """Return where places (n, 2) of the reference camera lie in a picture (n, 2); nan out of sight."""
        apparent = self.camera.unproject(pixel_line) @ self.camera_from_j2000
        there = self._seen(apparent, picture)
        return np.asarray(picture.camera.project(there @ picture.camera_from_j2000.T))

    def from_picture(self, pixel_line: FloatArray, picture: StackPicture) -> FloatArray:
        """Return where places (n, 2) of a picture lie in the reference camera (n, 2); nan out of sight."""
        there = picture.camera.unproject(pixel_line) @ picture.camera_from_j2000
        if self.follow == "target":
            here = there @ self._turn(picture)
        else:
            geometric = geometric_direction(there, picture.observer_velocity_km_s)
            here = apparent_direction(geometric, self.observer_velocity_km_s)
        return np.asarray(self.camera.project(here @ self.camera_from_j2000.T))

    def jacobian(self, pixel_line: FloatArray, picture: StackPicture) -> FloatArray:
        """Return d(place in the picture)/d(place in the reference camera), (n, 2, 2).

        Aberration changes by 1e-4 over the sky; over a pixel it does not count.
        """
        apparent = self.camera.unproject(pixel_line) @ self.camera_from_j2000
        turned = picture.camera_from_j2000 @ (self._turn(picture) if self.follow == "target" else np.eye(3))
        there = self._seen(apparent, picture) @ picture.camera_from_j2000.T
        inward = self.camera.unproject_jacobian(pixel_line)
        return np.asarray(picture.camera.project_jacobian(there) @ turned @ self.camera_from_j2000.T @ inward)

    def _seen(self, apparent: FloatArray, picture: StackPicture) -> FloatArray:
        """Directions (n, 3) as the other picture's spacecraft sees what is there at the stack's epoch."""
        if self.follow == "target":
            return np.asarray(apparent @ self._turn(picture).T)
        geometric = geometric_direction(apparent, self.observer_velocity_km_s)
        return apparent_direction(geometric, picture.observer_velocity_km_s)

    def _turn(self, picture: StackPicture) -> FloatArray:
        """Smallest rotation that carries the target's direction at the stack's epoch to that in the picture."""
        assert self.target is not None
        return rotation_from_vector(least_turn(self.target, target_direction(picture)))


def target_direction(picture: StackPicture) -> FloatArray:
    """Return the apparent direction (3,), J2000, in which a picture's target is expected."""
    assert picture.target is not None
    return apparent_direction(picture.target.direction, picture.observer_velocity_km_s)


# ---- Pictures resampled by cubic convolution, as sparse matrices.

TAPS = 4
BLOCK_PIXELS = 65_536  # worked on at once: 25 MB of weights
KEYS_A = -0.5


@dataclass(frozen=True, slots=True, eq=False)
class Resampling:
    """Rows of a resampling: `matrix` (m, n_line * n_pixel) in CSR, and which rows (m,) rest on good pixels only."""

    matrix: sparse.csr_array
    usable: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def cubic_weights(fraction: FloatArray) -> FloatArray:
    """Return the weights (..., 4) of the pixels at -1, 0, 1, 2 for a place `fraction` (...) beyond pixel 0.

    Examples
    --------
    >>> cubic_weights(np.array([0.0, 0.5])).tolist()
    [[0.0, 1.0, 0.0, 0.0], [-0.0625, 0.5625, 0.5625, -0.0625]]
    """
    x = np.abs(np.asarray(fraction)[..., None] - np.arange(-1.0, 3.0))
    near = (KEYS_A + 2.0) * x**3 - (KEYS_A + 3.0) * x**2 + 1.0
    far = KEYS_A * (x**3 - 5.0 * x**2 + 8.0 * x - 4.0)
    return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0)) + 0.0


def resampling_rows(grid: Grid, pixel_line: FloatArray, picture: StackPicture) -> Resampling:
    """Return the rows that make grid pixels at places (m, 2) of the reference camera out of a picture."""
    places = grid.to_picture(pixel_line, picture)
    area = np.abs(np.linalg.det(grid.jacobian(pixel_line, picture)))
    return cubic_rows(places, area, picture.bad)


def cubic_rows(places: FloatArray, area: FloatArray, bad: BoolArray) -> Resampling:
    """Return the rows for places (m, 2) in a picture, each scaled by `area` (m,)."""
    n_line, n_pixel = bad.shape
    base = np.floor(places)
    base = np.where(np.isfinite(base), base, -TAPS).astype(np.int64)
    inside = np.asarray(((base >= 1) & (base <= np.array([n_pixel, n_line]) - 3)).all(axis=1))
    safe = np.where(inside[:, None], base, 1)
    by_pixel, by_line = (cubic_weights(np.where(inside, places[:, i] - base[:, i], 0.0)) for i in (0, 1))
    weight = by_line[:, :, None] * by_pixel[:, None, :] * np.where(inside, area, 0.0)[:, None, None]
    step = np.arange(-1, 3)
    index = (safe[:, 1, None] + step)[:, :, None] * n_pixel + (safe[:, 0, None] + step)[:, None, :]
    spoilt = ((weight != 0.0) & bad.ravel()[index]).any(axis=(1, 2))
    usable = inside & ~spoilt
    weight = np.where(usable[:, None, None], weight, 0.0)
    ends = np.arange(len(places) + 1) * TAPS**2
    shape = (len(places), n_line * n_pixel)
    return Resampling(sparse.csr_array((weight.ravel(), index.ravel(), ends), shape=shape), usable)


def resample(grid: Grid, picture: StackPicture, response: float) -> tuple[FloatArray, FloatArray]:
    """Return a picture on the grid, and its variance there, both (n_line, n_pixel) of the grid; nan where unusable.

    Parameters
    ----------
    response
        The picture's light is divided by it.
    """
    centers = grid.centers()
    image, variance = np.full(len(centers), np.nan), np.full(len(centers), np.nan)
    signal, noise = np.asarray(picture.signal_dn).ravel(), picture.variance_dn2.ravel()
    for start in range(0, len(centers), BLOCK_PIXELS):
        block = slice(start, start + BLOCK_PIXELS)
        rows = resampling_rows(grid, centers[block], picture)
        blank = np.where(rows.usable, 1.0, np.nan)
        image[block] = blank * (rows.matrix @ signal) / response
        variance[block] = blank * (rows.matrix.power(2) @ noise) / response**2
    return image.reshape(grid.shape), variance.reshape(grid.shape)
