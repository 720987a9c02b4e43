"""First guess of a fit: where in their search area stars of the expected shape are most significant."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from opnav_workbench.arrays import FloatArray
from opnav_workbench.starcenters.boxes import Pixels, cut_boxes
from opnav_workbench.starcenters.peaks import refine_peaks
from opnav_workbench.starcenters.profiles import Profile
from opnav_workbench.starcenters.star_model import StarModel

__all__ = ["best_shift", "most_significant"]

KERNEL_SIGMAS = 2.0
MIN_KERNEL_HALF_PX = 1
HALF_PX = 0.5
SHIFT_SIGMA_PX = 0.5  # starts of a group are about this good: decides only where the fit cannot


def most_significant(
    pixels: Pixels, start: FloatArray, profile: Profile, search_radius_px: float
) -> FloatArray:
    """Return the most significant point within `search_radius_px` of each start, along each axis; (n, 2).

    At every pixel of the search area flux and background level are solved linearly; the pixel where flux over
    its sigma is largest wins, and a paraboloid gives the fraction. Without a single positive flux the start
    itself is returned.
    """
    reach = int(np.ceil(search_radius_px))
    half = max(MIN_KERNEL_HALF_PX, int(np.ceil(KERNEL_SIGMAS * profile.reach_px)))
    if reach == 0 or len(start) == 0:
        return start
    boxes = cut_boxes(pixels, start, 2 * (reach + 1 + half) + 1)
    kernel = profile.value(np.zeros((1, 2)), np.full((1, 2), -half), 2 * half + 1)[0]
    snr = _significance(boxes.data_dn, boxes.weight, kernel)  # (n, 2 reach + 3, 2 reach + 3)
    side, origin = snr.shape[-1], boxes.first + half
    allowed = np.abs(np.arange(side) + (origin - start)[:, :, None]) <= search_radius_px
    allowed[:, :, [0, -1]] = False  # a paraboloid needs all neighbors
    flat = np.where(allowed[:, 1, :, None] & allowed[:, 0, None, :], snr, -np.inf).reshape(len(start), -1)
    best = flat.argmax(axis=1)
    row, column = np.divmod(best, side)
    fraction, _ = refine_peaks(snr, row, column)
    found = origin + np.stack([column, row], axis=1) + fraction
    found = np.clip(found, start - search_radius_px, start + search_radius_px)
    positive = flat[np.arange(len(start)), best] > 0.0
    return np.where(positive[:, None], found, start)


def best_shift(model: StarModel, start: FloatArray, guess: FloatArray, search_radius_px: float) -> FloatArray:
    """Return where groups of stars (g, k, 2) fit best, as patterns: all fluxes are solved at each trial shift.

    Tried are no shift, and those that put each star where it is found for itself (`guess`): for all but one of
    them that is often their brightest neighbor. Of places that fit equally well (one star alone in the picture)
    the nearest is taken.
    """
    k = start.shape[1]
    shifts = [np.zeros((len(start), 2)), *(guess[:, i] - start[:, i] for i in range(k))]
    tried = [_refined(model, start, _refined(model, start, shift)) for shift in shifts]
    cost = np.stack([_cost(model, start, shift, search_radius_px) for shift in tried])
    best = np.stack(tried)[cost.argmin(axis=0), np.arange(len(start))]
    return start + np.where(np.isfinite(cost.min(axis=0))[:, None], best, 0.0)[:, None]


def _refined(model: StarModel, start: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the shift (g, 2) at the top of a paraboloid through the fits half a pixel around."""
    steps = HALF_PX * np.array([-1.0, 0.0, 1.0])
    around = [[shift + np.array([x, y]) for x in steps] for y in steps]
    surface = np.stack([[_cost(model, start, trial, np.inf) for trial in row] for row in around])
    middle = np.ones(len(start), np.int64)
    offset, _ = refine_peaks(-surface.transpose(2, 0, 1), middle, middle)
    return shift + HALF_PX * offset


def _cost(model: StarModel, start: FloatArray, shift: FloatArray, search_radius_px: float) -> FloatArray:
    """Chi-square of groups at a shift (g, 2), and what the shift itself costs; (g,)."""
    state = model(np.arange(len(start)), model.linear_start(start + shift[:, None]))
    chi2 = np.sum(state.residual**2 / model.variance, axis=1) + np.sum((shift / SHIFT_SIGMA_PX) ** 2, axis=1)
    return np.where(np.all(np.abs(shift) <= search_radius_px, axis=1), chi2, np.inf)


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
