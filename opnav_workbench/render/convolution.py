"""Light on the focal plane spread by the PSF: whole pixels by FFT, divided pixels cell by cell.

A pixel left whole is a square with a mean and two slopes of brightness; its three kernels are averages of the PSF over
all places in the pixel, for the slopes weighted by the distance from its middle. A divided pixel's cells are sources at
their middles; that widens them by the cell's own second moment, which a three-point correction of the kernel takes out
again (and, for the pixel left whole, puts in).
"""

import numpy as np
from scipy import fft

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.psf import Psf, add_boxes

__all__ = ["add_spread_light"]

BOXES_AT_ONCE = 20_000  # 20 000 boxes of 13 x 13 pixels: 27 MB
SHIFT_STEP_PX = 0.05  # of derivatives: good to 0.5 % for a PSF of sigma 0.3 px, and far above rounding
CELLS_OF_WHOLE = 8  # cells along a pixel that the kernel of a uniform pixel is averaged over


def add_spread_light(
    pictures: FloatArray,
    first: tuple[int, int],
    whole: FloatArray,
    divided: IntArray,
    cells: FloatArray,
    psf: Psf,
    shift_px: FloatArray,
) -> None:
    """Add the light of a window to `pictures` in place; what falls off their edges is lost.

    Parameters
    ----------
    pictures : (1 or 3, n_line, n_pixel) array
        The light; with three pictures also its derivatives as all of it moves along pixel and along line, px^-1.
    first : (int, int)
        (pixel, line) of the window's first pixel, in the pictures.
    whole : (3, m_line, m_pixel) array
        Light of whole pixels, and its slopes along pixel and line.
    divided : (n,) array of int
        Flat indices into `whole` of the divided pixels.
    cells : (n, s, s) array
        Their light, [line, pixel].
    psf : Psf
    shift_px : (2,) array
        By which all of it is moved, (pixel, line).
    """
    if whole.any():
        _add_whole(pictures, first, whole, psf, shift_px)
    if len(divided) == 0:
        return
    kernels = _moving_kernels(len(pictures), psf, shift_px, cells.shape[1], -1.0)
    size = kernels.shape[-1]
    line, pixel = np.divmod(divided, whole.shape[2])
    corner = np.stack([pixel + first[0], line + first[1]], axis=-1) - size // 2
    flat = kernels.reshape(len(kernels), -1, size * size)
    for begin in range(0, len(divided), BOXES_AT_ONCE):
        part = slice(begin, begin + BOXES_AT_ONCE)
        light = cells[part].reshape(-1, flat.shape[1])
        for picture, kernel in zip(pictures, flat, strict=True):
            add_boxes(picture, (light @ kernel).reshape(-1, size, size), corner[part])


def _add_whole(
    pictures: FloatArray, first: tuple[int, int], whole: FloatArray, psf: Psf, shift_px: FloatArray
) -> None:
    cells = _moving_kernels(len(pictures), psf, shift_px, CELLS_OF_WHOLE, +1.0)
    at = (np.arange(CELLS_OF_WHOLE) + 0.5) / CELLS_OF_WHOLE - 0.5
    kernels = np.stack([cells, cells * at[:, None, None], cells * at[:, None, None, None]], axis=1)
    kernels = kernels.mean(axis=(2, 3))
    reach = kernels.shape[-1] // 2
    size = [n + 2 * reach for n in whole.shape[1:]]
    good = [fft.next_fast_len(n, real=True) for n in size]
    light = fft.rfft2(whole, good)
    pixel, line = first[0] - reach, first[1] - reach
    for picture, kernel in zip(pictures, kernels, strict=True):
        spectrum = np.einsum("kij,kij->ij", light, fft.rfft2(kernel, good))
        spread = fft.irfft2(spectrum, good)[: size[0], : size[1]]
        into = picture[max(line, 0) : line + size[0], max(pixel, 0) : pixel + size[1]]
        top, left = max(-line, 0), max(-pixel, 0)
        into += spread[top : top + into.shape[0], left : left + into.shape[1]]


def _moving_kernels(count: int, psf: Psf, shift_px: FloatArray, cells: int, width_sign: float) -> FloatArray:
    """Return `_cell_kernels` (1, s, s, k, k), or with `count` 3 their derivatives with respect to the shift as well."""
    if count == 1:
        return _cell_kernels(psf, shift_px, cells, width_sign)[None]
    steps = SHIFT_STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    moved = [_cell_kernels(psf, shift_px + step, cells, width_sign) for step in steps]
    size = max(kernel.shape[-1] for kernel in moved)
    pads = [(size - kernel.shape[-1]) // 2 for kernel in moved]
    here, right, left, down, up = (
        np.pad(kernel, ((0, 0), (0, 0), (n, n), (n, n))) for kernel, n in zip(moved, pads, strict=True)
    )
    return np.stack([here, (right - left) / (2.0 * SHIFT_STEP_PX), (down - up) / (2.0 * SHIFT_STEP_PX)])


def _cell_kernels(psf: Psf, shift_px: FloatArray, cells: int, width_sign: float) -> FloatArray:
    """Return the shares (s, s, k, k) in whole pixels of the light of each cell of a pixel, which lies in the middle."""
    # Second differences of a kernel, over 24, are the effect of a cell's own width.
    fine = np.pad(psf.kernel(cells, shift_px), 1)
    bend = sum(np.roll(fine, k, axis) for k in (1, -1) for axis in (0, 1)) - 4.0 * fine
    lines = _summed_by_pixel(fine + width_sign / 24.0 * bend, cells)  # [cell, pixel, kernel element]
    both = _summed_by_pixel(np.moveaxis(lines, 2, 0), cells)  # [pixel cell, pixel, line cell, line]
    return np.ascontiguousarray(both.transpose(2, 0, 3, 1))


def _summed_by_pixel(fine: FloatArray, cells: int) -> FloatArray:
    """Return sums (s, k, ...) over whole pixels of a kernel (n, ...) about each of the s cells of the middle pixel."""
    n = len(fine)
    pixels = -(-(n // 2) // cells)  # whole pixels that the kernel reaches to each side
    out = np.empty((cells, 2 * pixels + 1, *fine.shape[1:]))
    for cell in range(cells):
        padded = np.zeros(((2 * pixels + 1) * cells, *fine.shape[1:]))
        start = pixels * cells + cell - n // 2
        padded[start : start + n] = fine
        out[cell] = padded.reshape(2 * pixels + 1, cells, *fine.shape[1:]).sum(axis=1)
    return out
