"""Pixels that no star explains: cosmic rays, hot pixels, unlisted neighbors within a fitted box.

A pixel's residual is compared with its own standard deviation: noise v (1 - h), with h the leverage of the pixel
on its fit, and what an error of the PSF model would leave. A hit is far sharper than the PSF, so it stands out
even where the fit followed it.

Reference: studentized residuals, Cook & Weisberg (1982), Residuals and Influence in Regression, chapter 2.
"""

import numpy as np
from scipy.ndimage import binary_dilation, maximum_filter

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.starcenters.levenberg import Evaluation

__all__ = ["find_hits"]

HIT_SIGMAS = 5.0  # noise does this once in 3 million pixels, some 20 000 stars
SKIRT_SIGMAS = 3.0  # pixels beside a hit that it also touched
MIN_FREEDOM = 0.02  # 1 - leverage: a pixel that alone decides its own fit cannot be judged
PSF_TOLERANCE = 0.1  # of the star's light in a pixel or beside it: no real PSF is known better at every phase
WING_TOLERANCE = 0.01  # of a star's flux in any pixel of the box: wings, ghosts, spikes that the model lacks
AROUND = np.ones((1, 3, 3), bool)


def find_hits(
    final: Evaluation, covariance: FloatArray, light: FloatArray, psf_error: float, size: int
) -> BoolArray:
    """Return True for pixels with light that is not the stars'; (g, size, size).

    Parameters
    ----------
    final : Evaluation
        The fit at its end, g boxes of m = size^2 pixels.
    covariance : (g, q, q) array
        Of the fitted parameters, from the noise alone.
    light : (g, m) array
        Of the fitted stars.
    psf_error : float
        Relative error of the PSF model, where it is known to be larger than `PSF_TOLERANCE`.
    """
    used = final.weight > 0.0
    gain = np.matmul(covariance, final.jacobian)  # (g, q, m)
    free = 1.0 - final.weight * np.sum(gain * final.jacobian, axis=1)
    judged = used & (free > MIN_FREEDOM)
    noise = np.where(judged, free / np.where(used, final.weight, 1.0), 1.0)
    significance = np.where(judged, final.residual / np.sqrt(noise), 0.0)
    suspect = np.flatnonzero((significance > HIT_SIGMAS).any(axis=1))
    tolerated = _tolerated(final, gain, light, psf_error, size, suspect)
    significance[suspect] /= np.sqrt(1.0 + tolerated / noise[suspect])
    boxes = significance.reshape(-1, size, size)
    peak = boxes > HIT_SIGMAS
    if not peak.any():
        return peak
    return np.asarray(peak | (binary_dilation(peak, AROUND) & (boxes > SKIRT_SIGMAS)))


def _tolerated(
    final: Evaluation, gain: FloatArray, light: FloatArray, psf_error: float, size: int, rows: IntArray
) -> FloatArray:
    """Variance (k, m) of the residuals of some boxes from errors of the PSF model.

    With K = J C J'W the fit's part of the data, an error of variance D of the pixels leaves the residuals
    (1 - K) D (1 - K)'.
    """
    boxes = light[rows].reshape(-1, size, size)
    beside = maximum_filter(boxes, size=(1, 3, 3)).reshape(len(rows), size**2)
    error = max(PSF_TOLERANCE, 2.0 * psf_error) * beside
    error += WING_TOLERANCE * np.maximum(boxes.sum(axis=(1, 2)), 0.0)[:, None]
    variance = np.where(final.weight[rows] > 0.0, error**2, 0.0)
    followed = np.matmul(np.swapaxes(final.jacobian[rows], 1, 2), gain[rows]) * final.weight[rows, None]
    own = np.einsum("kmm->km", followed)
    return np.asarray(np.matmul(followed**2, variance[:, :, None])[:, :, 0] + (1.0 - 2.0 * own) * variance)
