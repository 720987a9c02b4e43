"""Cross-correlation of data and model along scans, over many lags.

At every lag the model is compared with the data that lie there, in the metric of `scan_matching`: what noise, background
and an uneven albedo may do does not count.

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodycenters.scan_matching import ScanSystem

__all__ = ["correlate_scans", "correlation_peaks"]

BLOCKED_SHARE = 0.1  # of a window's samples: more of them unusable, and a lag says nothing


def correlate_scans(
    system: ScanSystem, model: FloatArray, data: FloatArray, blocked: BoolArray, roughness: float
) -> FloatArray:
    """Return correlations (n, k) in -1..1 of models (n, w) with windows of data (n, w + k - 1); nan where unusable."""
    diagonal, columns = system.metric(roughness)
    data = np.where(blocked, 0.0, data)
    windows, squares = (sliding_window_view(d, model.shape[1], axis=1) for d in (data, data**2))
    lacks = np.einsum("nw,nwj->nj", model, columns)
    weighted = diagonal * model - np.einsum("nwj,nj->nw", columns, lacks)
    norm = np.einsum("nw,nw->n", weighted, model)
    both = np.einsum("nkw,nw->nk", windows, weighted, optimize=True)
    power = np.einsum("nkw,nw->nk", squares, diagonal, optimize=True)
    power = power - np.square(np.matmul(windows, columns)).sum(axis=-1)
    share = sliding_window_view(blocked, model.shape[1], axis=1).mean(axis=-1)
    good = (share <= BLOCKED_SHARE) & (norm > 0.0)[:, None] & (power > 0.0)
    below = np.sqrt(np.where(good, norm[:, None] * np.where(good, power, 1.0), 1.0))
    return np.where(good, np.clip(both / below, -1.0, 1.0), np.nan)


def correlation_peaks(correlation: FloatArray, lag_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return place (n,) px and height (n,) of each scan's maximum, refined with a parabola; nan without one inside.

    Examples
    --------
    >>> lag = np.arange(-3.0, 4.0)
    >>> place, height = correlation_peaks(0.9 - 0.1 * (lag - 0.2)[None] ** 2, lag)
    >>> place.round(3), height.round(3)
    (array([0.2]), array([0.9]))
    """
    filled = np.where(np.isfinite(correlation), correlation, -2.0)
    rows = np.arange(len(filled))
    best = filled.argmax(axis=1)
    inner = np.clip(best, 1, filled.shape[1] - 2)
    left, middle, right = (filled[rows, inner + k] for k in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    found = (best == inner) & (bend < 0.0) & (np.minimum(left, right) >= -1.0)
    shift = np.where(found, 0.5 * (left - right) / np.where(found, bend, -1.0), 0.0)
    place = lag_px[inner] + (lag_px[1] - lag_px[0]) * shift
    height = middle - 0.25 * (left - right) * shift
    return np.where(found, place, np.nan), np.where(found, height, np.nan)
