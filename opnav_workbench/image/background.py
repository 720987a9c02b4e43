"""Sky background and its noise, from the tiles of a coarse mesh.

Flow    picture -> tiles -> clipped level and noise of each -> tiles that show the sky -> every pixel
Body    a robust surface through the tiles tells sky from a resolved body, whose tiles take the surface's value
Source  the mesh is that of SExtractor (Bertin & Arnouts 1996, doi:10.1051/aas:1996164); the robust surface is least
        trimmed squares with concentration steps (Rousseeuw & Van Driessen 2006, doi:10.1007/s10618-005-0024-4)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import ImageError
from opnav_workbench.image.mesh import Mesh, clipped_statistics, make_mesh, tiles_of
from opnav_workbench.image.surface import robust_surface

__all__ = ["Background", "estimate_background"]

DEFAULT_BOX_PX = 64
# A tile this far from the surface (in the sky's noise per pixel) shows a body, a data gap or a dark column;
# what is fainter than that is stray light, and the background follows it.
SKY_TOLERANCE_SIGMA = 0.5
# ... unless the tiles scatter more by themselves: then five times their scatter about the surface.
SKY_TOLERANCE_SCATTER = 5.0
NOISE_SMOOTHING_TILES = 3  # median filter: a tile's noise is known to 2 %, its neighbours share it
UNIFORM_SIGMA = 12.0**-0.5  # of a value rounded to a whole step


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The sky level and its noise, in every pixel; arrays are read-only.

    Attributes
    ----------
    level_dn : (n_line, n_pixel) array
        Sky level, without stars and without a resolved body.
    noise_dn : (n_line, n_pixel) array
        Standard deviation of one pixel about that level: what an empty pixel shows.
    """

    level_dn: FloatArray
    noise_dn: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def estimate_background(image_dn: ArrayLike, bad: ArrayLike | None = None, box_px: int = DEFAULT_BOX_PX) -> Background:
    """Estimate the sky level and its noise in every pixel of a picture.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Picture; non-finite pixels are masked by themselves.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    box_px : int
        Side of a tile; smaller pictures get smaller tiles, so that about eight fit across.

    Returns
    -------
    Background

    Raises
    ------
    ImageError
        The picture is not two-dimensional, has no usable pixel, or has the same value in all of them.

    Notes
    -----
    Bodies may fill about a third of the picture. Where more than half of the tiles show a body, the body is taken
    for the sky: mask it with `bad`.

    Examples
    --------
    >>> picture = 20.0 + np.random.default_rng(1).normal(0.0, 2.0, (128, 128))
    >>> background = estimate_background(picture)
    >>> bool(abs(background.level_dn.mean() - 20.0) < 0.05)
    True
    """
    image, step = _masked(image_dn, bad)
    mesh = make_mesh(image.shape, _checked_box(box_px))
    tiles = tiles_of(image, mesh)
    coarse = _sky_level(mesh, *clipped_statistics(tiles, step))
    # The second look is at a picture whose slope is gone, which would otherwise count as noise.
    first = mesh.upsample(coarse)
    correction, noise = clipped_statistics(tiles_of(image - first, mesh), step)
    level, sky = _levels(mesh, correction, noise)
    return Background(first + mesh.upsample(level), mesh.upsample(_noise_mesh(mesh, noise, sky)))
