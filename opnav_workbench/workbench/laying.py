"""Another image laid over the one at hand, pixel by pixel, so that both can be blinked, wiped and stood side by side.

Flow   pixel of this image -> J2000 direction -> pixel of the other -> its value; or the same pixel
Values are the other image's own, of its nearest pixel: nothing is blended. Aberration is taken out between the two
"""

import numpy as np
from scipy.ndimage import map_coordinates

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import apparent_direction, geometric_direction
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.overlays import expected_directions, expected_places

__all__ = ["laid_over"]

NODE_PX = (
    16.0  # between places that are carried over the sky; linear between them, as cameras bend little in that
)


def laid_over(other: ImageSession, onto: ImageSession, lock: str) -> FloatArray:
    """Return another image on the pixels of this one (n_line, n_pixel), DN; nan where it has none.

    Parameters
    ----------
    lock : {"sky", "pixel"}
        Same direction, each with the best attitude known of it, or same pixel.
    """
    shape = onto.context.picture.image_dn.shape
    place = np.indices(shape)[::-1].astype(float) if lock == "pixel" else _places(other, onto, shape)
    values = other.context.picture.image_dn
    pixel, line = (np.where(np.isfinite(axis), axis, -1.0) for axis in place)
    column, row = np.rint(pixel).astype(int), np.rint(line).astype(int)
    there = (column >= 0) & (row >= 0) & (column < values.shape[1]) & (row < values.shape[0])
    laid = np.full(shape, np.nan)
    laid[there] = values[row[there], column[there]]
    return laid


def _places(other: ImageSession, onto: ImageSession, shape: tuple[int, ...]) -> FloatArray:
    """Place (2, n_line, n_pixel) in the other image of each pixel of this one."""
    axes = [np.linspace(0.0, n - 1.0, max(2, int(np.ceil(n / NODE_PX)) + 1)) for n in shape]
    line, pixel = np.meshgrid(*axes, indexing="ij")
    nodes = np.stack([pixel.ravel(), line.ravel()], axis=1)
    sky = geometric_direction(expected_directions(onto, nodes), onto.inputs.observer.velocity_km_s)
    seen = apparent_direction(sky, other.inputs.observer.velocity_km_s)
    found = expected_places(other, seen).T.reshape(2, *line.shape)
    fine = [np.arange(n) * (len(axis) - 1.0) / max(n - 1.0, 1.0) for n, axis in zip(shape, axes, strict=True)]
    at = np.meshgrid(*fine, indexing="ij")
    return np.stack([map_coordinates(part, at, order=1) for part in found])
