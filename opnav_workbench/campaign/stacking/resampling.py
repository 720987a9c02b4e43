"""Pictures resampled by cubic convolution, as sparse matrices: their noise is known as well as their light.

A grid pixel is the weighted sum of 4 x 4 pixels of the picture about the place where it lies, times the area that it has
there. The weights sum to 1 over the pixels of the picture for every grid pixel, and over the grid pixels for every pixel
of the picture as far as both grids are alike: levels and fluxes are conserved. Being linear, the covariance of resampled
pixels is ``M diag(variance) M^T``.

Reference: Keys (1981), doi:10.1109/TASSP.1981.1163711 (a = -1/2).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.campaign.stacking.grid import Grid

__all__ = ["Resampling", "cubic_weights", "resample", "resampling"]

TAPS = 4
BLOCK_PIXELS = 65_536  # worked on at once: 25 MB of weights
KEYS = -0.5


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
    near = (KEYS + 2.0) * x**3 - (KEYS + 3.0) * x**2 + 1.0
    far = KEYS * (x**3 - 5.0 * x**2 + 8.0 * x - 4.0)
    return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0)) + 0.0


def resampling(grid: Grid, pixel_line: FloatArray, frame: StackFrame) -> Resampling:
    """Return the rows that make grid pixels at places (m, 2) of the reference camera out of a picture."""
    places = grid.to_frame(pixel_line, frame)
    area = np.abs(np.linalg.det(grid.jacobian(pixel_line, frame)))
    return cubic_rows(places, area, frame.bad)


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


def resample(grid: Grid, frame: StackFrame, response: float) -> tuple[FloatArray, FloatArray]:
    """Return a picture on the grid, and its variance there, both (n_line, n_pixel) of the grid; nan where unusable.

    Parameters
    ----------
    grid : Grid
    frame : StackFrame
    response : float
        The picture's light is divided by it.
    """
    centers = grid.centers()
    image, variance = np.full(len(centers), np.nan), np.full(len(centers), np.nan)
    signal, noise = np.asarray(frame.signal_dn).ravel(), frame.variance_dn2.ravel()
    for start in range(0, len(centers), BLOCK_PIXELS):
        block = slice(start, start + BLOCK_PIXELS)
        rows = resampling(grid, centers[block], frame)
        blank = np.where(rows.usable, 1.0, np.nan)
        image[block] = blank * (rows.matrix @ signal) / response
        variance[block] = blank * (rows.matrix.power(2) @ noise) / response**2
    return image.reshape(grid.shape), variance.reshape(grid.shape)
