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
CELLS_OF_WHOLE = 8  # cells along a pixel that the kernel of a uniform pixel is averaged over


def add_spread_light(
    picture: FloatArray,
    first: tuple[int, int],
    whole: FloatArray,
    divided: IntArray,
    cells: FloatArray,
    psf: Psf,
    shift_px: FloatArray,
) -> None:
    """Add the light of a window to `picture` in place; what falls off its edges is lost.

    Parameters
    ----------
    picture : (n_line, n_pixel) array
    first : (int, int)
        (pixel, line) of the window's first pixel, in the picture.
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
        _add_whole(picture, first, whole, psf, shift_px)
    if len(divided) == 0:
        return
    kernels = _cell_kernels(psf, shift_px, cells.shape[1], -1.0)
    size = kernels.shape[-1]
    line, pixel = np.divmod(divided, whole.shape[2])
    corner = np.stack([pixel + first[0], line + first[1]], axis=-1) - size // 2
    flat = kernels.reshape(-1, size * size)
    for begin in range(0, len(divided), BOXES_AT_ONCE):
        part = slice(begin, begin + BOXES_AT_ONCE)
        boxes = cells[part].reshape(-1, flat.shape[0]) @ flat
        add_boxes(picture, boxes.reshape(-1, size, size), corner[part])


def _add_whole(
    picture: FloatArray, first: tuple[int, int], whole: FloatArray, psf: Psf, shift_px: FloatArray
) -> None:
    cells = _cell_kernels(psf, shift_px, CELLS_OF_WHOLE, +1.0)
    at = (np.arange(CELLS_OF_WHOLE) + 0.5) / CELLS_OF_WHOLE - 0.5
    kernels = np.stack([cells, cells * at[:, None, None], cells * at[:, None, None, None]]).mean(axis=(1, 2))
    reach = kernels.shape[-1] // 2
    size = [n + 2 * reach for n in whole.shape[1:]]
    good = [fft.next_fast_len(n, real=True) for n in size]
    spectrum = np.einsum("kij,kij->ij", fft.rfft2(whole, good), fft.rfft2(kernels, good))
    spread = fft.irfft2(spectrum, good)[: size[0], : size[1]]
    pixel, line = first[0] - reach, first[1] - reach
    into = picture[max(line, 0) : line + size[0], max(pixel, 0) : pixel + size[1]]
    top, left = max(-line, 0), max(-pixel, 0)
    into += spread[top : top + into.shape[0], left : left + into.shape[1]]


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
