"""Many points added to a picture through a PSF."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.psf.protocol import Psf, covering_boxes

__all__ = ["add_boxes", "add_sources"]

FEW_PIXELS = (
    10  # where boxes have fewer pixels than the picture by this factor, summing up whole pictures is slower
)
CHUNK_PIXELS = 2_000_000  # pixels of boxes held at once: 16 MB an array


def add_sources(picture: FloatArray, psf: Psf, center_px: ArrayLike, flux: ArrayLike) -> None:
    """Add n points to `picture` in place; the light that falls off its edges is lost.

    Parameters
    ----------
    picture : (n_line, n_pixel) array
    psf : Psf
    center_px : (n, 2) array_like
        (pixel, line); points that are not finite (behind the camera) are left out.
    flux : (n,) array_like
        Total flux of each, in the unit of the picture.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> picture = np.zeros((20, 30))
    >>> add_sources(picture, GaussianPsf(0.8, 0.8), [[10.3, 9.9], [22.0, 8.5]], [100.0, 50.0])
    >>> round(float(picture.sum()), 4)
    150.0
    """
    centers = np.asarray(center_px, dtype=np.float64).reshape(-1, 2)
    fluxes = np.broadcast_to(np.asarray(flux, dtype=np.float64), len(centers))
    size_px = np.array(picture.shape[::-1])
    reach = np.ceil(psf.half_size_px) + 1.0
    near = ((centers > -reach) & (centers < size_px - 1.0 + reach)).all(axis=1)  # nan: no
    centers, fluxes = centers[near], fluxes[near]
    if len(centers) == 0:
        return
    first, size = covering_boxes(psf, centers)
    step = max(1, CHUNK_PIXELS // size**2)
    for start in range(0, len(centers), step):
        part = slice(start, start + step)
        light = psf.box(centers[part], first[part], size) * fluxes[part, None, None]
        add_boxes(picture, light, first[part])


def add_boxes(picture: FloatArray, boxes: FloatArray, first: ArrayLike) -> None:
    """Add boxes (n, size, size) whose first pixels are `first` (n, 2) to `picture` in place."""
    step = np.arange(boxes.shape[-1])
    corner = np.asarray(first, dtype=np.int64)
    n_line, n_pixel = picture.shape
    line, pixel = corner[:, 1, None] + step, corner[:, 0, None] + step
    line_in, pixel_in = (line >= 0) & (line < n_line), (pixel >= 0) & (pixel < n_pixel)
    place = line[:, :, None] * n_pixel + pixel[:, None, :]
    inside = line_in[:, :, None] & pixel_in[:, None, :]
    if boxes.size * FEW_PIXELS < picture.size:
        np.add.at(picture, np.divmod(place[inside], n_pixel), boxes[inside])
    else:
        summed = np.bincount(place[inside], weights=boxes[inside], minlength=picture.size)
        picture += summed.reshape(picture.shape)
