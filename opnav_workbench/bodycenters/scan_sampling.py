"""Pictures along scans: interpolated between pixels, with the weights of the pixels kept.

Data and model go through the same cubic convolution, so that it leaves no offset between them; what noise a sum over
samples has follows exactly from the weights.

Reference: Keys (1981), IEEE Trans. ASSP 29, 1153, doi:10.1109/TASSP.1981.1163711.
"""

import numpy as np
from scipy.sparse import csr_matrix

from opnav_workbench.arrays import BoolArray, FloatArray

__all__ = ["ScanSampler"]

BLOCKED_SHARE = 0.05  # of a sample's weight on unusable pixels


class ScanSampler:
    """Samples of a window's planes at places on the detector.

    Parameters
    ----------
    places_px : (..., 2) array
        (pixel, line).
    window : (int, int, int, int)
        First pixel, first line, pixels, lines of the planes.

    Examples
    --------
    >>> sampler = ScanSampler(np.array([[[11.5, 7.0], [12.5, 7.0]]]), (10, 5, 6, 4))
    >>> sampler.sample(np.tile(np.arange(6.0), (4, 1)))
    array([[1.5, 2.5]])
    """

    def __init__(self, places_px: FloatArray, window: tuple[int, int, int, int]) -> None:
        first_pixel, first_line, self._n_pixel, self._n_line = window
        self.shape = places_px.shape[:-1]
        self._pixel, pixel_weight = _taps(places_px[..., 0] - first_pixel)
        self._line, line_weight = _taps(places_px[..., 1] - first_line)
        self._outside = self._out_of_window()
        weight = line_weight[..., :, None] * pixel_weight[..., None, :]
        self._weight = weight.reshape(*self.shape, 16)
        lines = np.clip(self._line, 0, self._n_line - 1)
        pixels = np.clip(self._pixel, 0, self._n_pixel - 1)
        index = lines[..., :, None] * self._n_pixel + pixels[..., None, :]
        self._index = index.reshape(*self.shape, 16)

    def _out_of_window(self) -> BoolArray:
        off_pixel = (self._pixel[..., 1] < 0) | (self._pixel[..., 2] >= self._n_pixel)
        off_line = (self._line[..., 1] < 0) | (self._line[..., 2] >= self._n_line)
        return np.asarray(off_pixel | off_line)

    def sample(self, plane: FloatArray) -> FloatArray:
        """Return the values (...,) of a plane (n_line, n_pixel); beyond its edge the edge's values count."""
        return np.asarray(np.einsum("...k,...k->...", plane.reshape(-1)[self._index], self._weight))

    def blocked(self, usable: BoolArray) -> BoolArray:
        """Tell which samples (...,) rest on pixels that are not usable, or lie outside of the window."""
        lost = (~usable).astype(np.float64)
        share = np.einsum("...k,...k->...", lost.reshape(-1)[self._index], np.abs(self._weight))
        return np.asarray(self._outside | (share > BLOCKED_SHARE))

    def pixel_weights(self, sample_weight: FloatArray) -> csr_matrix:
        """Return the weights (n, pixels) of the window's pixels in sums over samples (n, w) with given weights."""
        n = self.shape[0]
        values = (sample_weight[..., None] * self._weight).reshape(n, -1)
        index = self._index.reshape(n, -1)
        rows = np.repeat(np.arange(n), index.shape[1])
        size = (n, self._n_line * self._n_pixel)
        return csr_matrix((values.ravel(), (rows, index.ravel())), shape=size)


def _taps(place: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Return the four pixels (..., 4) about places (...,), and their weights."""
    below = np.floor(place)
    pixel = below.astype(np.int64)[..., None] + np.arange(-1, 3)
    t = (place - below)[..., None] - np.arange(-1.0, 3.0)
    return pixel, _keys(np.abs(t))


def _keys(t: FloatArray) -> FloatArray:
    near = (1.5 * t - 2.5) * t * t + 1.0
    far = ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0
    return np.where(t < 1.0, near, np.where(t < 2.0, far, 0.0))
