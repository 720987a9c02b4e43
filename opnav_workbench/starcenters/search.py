"""First guess of a fit: where in its search area a star of the expected shape is most significant."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from opnav_workbench.arrays import FloatArray
from opnav_workbench.psf import box_integrals
from opnav_workbench.starcenters.boxes import Pixels, cut_boxes
from opnav_workbench.starcenters.peaks import refine_peaks
from opnav_workbench.starcenters.results import ShapePrior

__all__ = ["brightest_pixel"]

KERNEL_SIGMAS = 2.0
MIN_KERNEL_HALF_PX = 1


def brightest_pixel(
    pixels: Pixels, start: FloatArray, prior: ShapePrior, search_radius_px: float
) -> FloatArray:
    """Return the most significant point within `search_radius_px` of each start, along each axis; (n, 2).

    At every pixel of the search area flux and background level are solved linearly; the pixel where flux over
    its sigma is largest wins, and a paraboloid gives the fraction. Without a single positive flux the start
    itself is returned.
    """
    reach = int(np.ceil(search_radius_px))
    half = max(MIN_KERNEL_HALF_PX, int(np.ceil(KERNEL_SIGMAS * prior.sigma_px)))
    if reach == 0 or len(start) == 0:
        return start
    boxes = cut_boxes(pixels, start, 2 * (reach + 1 + half) + 1)
    kernel = box_integrals(
        np.zeros((1, 2)), prior.mean[None], np.full((1, 2), -float(half)), 2 * half + 1
    ).value[0]
    snr = _significance(boxes.data_dn, boxes.weight, kernel)  # (n, 2 reach + 3, 2 reach + 3)
    origin = boxes.first + half
    dx, dy = np.arange(snr.shape[-1]) + (origin - start)[:, :, None].transpose(1, 0, 2)
    allowed = (np.abs(dx) <= search_radius_px)[:, None, :] & (np.abs(dy) <= search_radius_px)[:, :, None]
    inner = np.zeros_like(allowed)
    inner[:, 1:-1, 1:-1] = allowed[:, 1:-1, 1:-1]  # a paraboloid needs all neighbors
    flat = np.where(inner, snr, -np.inf).reshape(len(start), -1)
    best = flat.argmax(axis=1)
    row, column = np.divmod(best, snr.shape[-1])
    offset, _ = refine_peaks(snr, row, column)
    found = origin + np.stack([column, row], axis=1) + offset
    positive = flat[np.arange(len(start)), best] > 0.0
    found = np.clip(found, start - search_radius_px, start + search_radius_px)
    return np.where(positive[:, None], found, start)


def _significance(data: FloatArray, weight: FloatArray, kernel: FloatArray) -> FloatArray:
    """Flux over its sigma of a star at each pixel, its background level free; 0 where it cannot be had."""

    def correlate(values: FloatArray, taps: FloatArray) -> FloatArray:
        windows = sliding_window_view(values, taps.shape, axis=(1, 2))
        return np.asarray(np.einsum("nyxij,ij->nyx", windows, taps, optimize=True))

    ones = np.ones_like(kernel)
    s, st, stt = correlate(weight, ones), correlate(weight, kernel), correlate(weight, kernel**2)
    sd, std = correlate(weight * data, ones), correlate(weight * data, kernel)
    det = s * stt - st**2
    solvable = det > 1e-9 * s * stt
    scale = np.sqrt(np.where(solvable, s * det, 1.0))
    return np.where(solvable, (s * std - st * sd) / scale, 0.0)
