"""Where scans run, and pictures sampled along them: interpolated between pixels, with the weights of the pixels kept.

Frame  (pixel, line); angles from +pixel toward +line; distances from the center, px

Data and model are interpolated with the same cubic convolution, so that it leaves no offset between them; as the weights
of the pixels are kept, the noise of a sum over samples follows exactly from them.

References: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding"; Keys (1981), IEEE
Trans. ASSP 29, 1153, doi:10.1109/TASSP.1981.1163711, for the convolution.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_light import cubic_weights
from opnav_workbench.bodies.silhouette import TURN, Outline

__all__ = ["N_SCANS", "STEP_PX", "ScanFan", "ScanSampler", "lay_fan"]

N_SCANS = 180  # one every 2 deg: as far apart as the PSF is wide on a disk of 100 px
STEP_PX = 0.5  # between samples: half a pixel loses nothing of a PSF that pixels resolve
BLOCKED_SHARE = 0.05  # of a sample's weight on unusable pixels


@dataclass(frozen=True, slots=True, eq=False)
class ScanFan:
    """n scans about a center; scan k leaves it at ``360 k / n`` degrees.

    Attributes
    ----------
    center_px : (2,) array
    angle_rad : (n,) array
    limb_px : (n,) array
        Distance of the limb.
    first : (n,) array of int
        Sample where each window about the limb begins: distance ``STEP_PX * first``.
    n_samples
        Of a window.
    """

    center_px: FloatArray
    angle_rad: FloatArray
    limb_px: FloatArray
    first: IntArray
    n_samples: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)

    @property
    def depth_px(self) -> FloatArray:
        """Distance (n, w) of the windows' samples from the limb, outward."""
        return self.distances() - self.limb_px[:, None]

    def distances(self, beside: int = 0) -> FloatArray:
        """Return the distances (n, w) of the windows' samples, with some more before and after."""
        steps = np.arange(-beside, self.n_samples + beside)
        return np.asarray(STEP_PX * (self.first[:, None] + steps))

    def places(self, distance_px: FloatArray) -> FloatArray:
        """Return points (n, w, 2) at distances (n, w) or (w,) along the scans."""
        direction = np.stack([np.cos(self.angle_rad), np.sin(self.angle_rad)], axis=-1)
        distance = np.broadcast_to(distance_px, (len(self), np.shape(distance_px)[-1]))
        return np.asarray(self.center_px + direction[:, None, :] * distance[..., None])


def lay_fan(outline: Outline, n_scans: int, reach_px: tuple[float, float]) -> ScanFan:
    """Lay out scans about the center of an outline, with windows that reach inward and outward of it."""
    angle: FloatArray = np.arange(float(n_scans)) * (TURN / n_scans)
    limb = outline.radius(angle)
    first = np.maximum(np.floor((limb - reach_px[0]) / STEP_PX), 0).astype(np.int64)
    last = np.floor((limb + reach_px[1]) / STEP_PX).astype(np.int64)
    return ScanFan(outline.center_px, angle, limb, first, int((last - first).min()) + 1)


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
        pixel, pixel_weight = _taps(places_px[..., 0] - first_pixel)
        line, line_weight = _taps(places_px[..., 1] - first_line)
        off_pixel = (pixel[..., 1] < 0) | (pixel[..., 2] >= self._n_pixel)
        self._outside = off_pixel | (line[..., 1] < 0) | (line[..., 2] >= self._n_line)
        weight = line_weight[..., :, None] * pixel_weight[..., None, :]
        self._weight = weight.reshape(*self.shape, 16)
        line, pixel = np.clip(line, 0, self._n_line - 1), np.clip(pixel, 0, self._n_pixel - 1)
        index = line[..., :, None] * self._n_pixel + pixel[..., None, :]
        self._index = index.reshape(*self.shape, 16)

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


def _taps(place: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the four pixels (..., 4) about places (...,), and their weights."""
    below = np.floor(place)
    pixel = below.astype(np.int64)[..., None] + np.arange(-1, 3)
    return pixel, np.stack(cubic_weights(place - below), axis=-1)
