"""Pixels whose light is not that of the bodies: cosmic rays and stars, told from what surrounds them."""

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import BoolArray, FloatArray

__all__ = ["find_hit_pixels"]

CANDIDATE_SIGMAS = 5.0
HIT_SIGMAS = 6.0  # one false alarm in 500 million pixels of pure noise
TAIL_SIGMAS = 3.0  # of pixels beside a hit
MAX_CANDIDATES = 20_000  # more than a frame's cosmic rays: the model is wrong, not the pixels
AROUND = 2  # pixels to each side: 24 neighbours, of whom a hit of up to 11 pixels cannot set the median
NEIGHBOURS = [
    (line, pixel)
    for line in range(-AROUND, AROUND + 1)
    for pixel in range(-AROUND, AROUND + 1)
    if line or pixel
]


def find_hit_pixels(residual_dn: FloatArray, weight: FloatArray) -> BoolArray:
    """Return pixels that stand out of their surroundings.

    What a model lacks (an albedo pattern, a limb that is off) makes residuals that neighbours share; a hit does not.

    Parameters
    ----------
    residual_dn, weight : (n_line, n_pixel) arrays
        Data minus model; 1 / variance, 0 for pixels that are not used.

    Examples
    --------
    >>> residual = np.zeros((9, 9))
    >>> residual[4, 5] = 8.0
    >>> int(find_hit_pixels(residual, np.ones((9, 9))).sum())
    1
    """
    in_sigmas = np.where(weight > 0.0, residual_dn * np.sqrt(weight), np.nan)
    line, pixel = np.nonzero(np.abs(np.nan_to_num(in_sigmas)) > CANDIDATE_SIGMAS)
    hits = np.zeros(weight.shape, dtype=bool)
    if not 0 < len(line) <= MAX_CANDIDATES:
        return hits
    excess = _excess(in_sigmas, line, pixel)
    hits[line, pixel] = excess > HIT_SIGMAS
    beside = binary_dilation(hits) & ~hits & (weight > 0.0)
    line, pixel = np.nonzero(beside)
    if len(line):
        hits[line, pixel] = _excess(in_sigmas, line, pixel) > TAIL_SIGMAS
    return hits


def _excess(in_sigmas: FloatArray, line: np.ndarray, pixel: np.ndarray) -> FloatArray:
    """How far pixels (n,) lie from the median of their neighbours, in units of noise and the neighbours' own scatter."""
    padded = np.pad(in_sigmas, AROUND, constant_values=np.nan)
    around = np.stack([padded[line + AROUND + a, pixel + AROUND + b] for a, b in NEIGHBOURS])
    known = np.isfinite(around)
    enough = known.sum(axis=0) >= len(NEIGHBOURS) // 3
    around = np.where(known | ~enough, np.where(enough, around, 0.0), np.nan)
    middle = np.nanmedian(around, axis=0)
    scatter = 1.4826 * np.nanmedian(np.abs(around - middle), axis=0)
    away = np.abs(in_sigmas[line, pixel] - middle)
    return np.asarray(np.where(enough, away / np.maximum(scatter, 1.0), 0.0))
