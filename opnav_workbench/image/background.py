"""Sky background and its noise, from the tiles of a coarse mesh.

Flow    picture -> tiles -> clipped level and noise of each -> tiles that show the sky -> every pixel
Body    a robust surface through the tiles tells the sky from a resolved body, whose tiles take its value
Source  the mesh is SExtractor's: Bertin & Arnouts (1996), doi:10.1051/aas:1996164
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
UNIFORM_SIGMA = 12.0**-0.5  # DN: of a value rounded to a whole number; no picture of whole numbers is quieter
NOISE_FREE_SHARE = 1e-6  # of the range of values: keeps the weights of a simulation without noise finite
MAD_TO_SIGMA = 1.482602


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


def estimate_background(
    image_dn: ArrayLike, bad: ArrayLike | None = None, box_px: int = DEFAULT_BOX_PX
) -> Background:
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
    Bodies may fill about a third of the picture. Where more than half of the tiles show a body, the body
    is taken for the sky: mask it with `bad`.

    Examples
    --------
    >>> picture = 20.0 + np.random.default_rng(1).normal(0.0, 2.0, (128, 128))
    >>> background = estimate_background(picture)
    >>> bool(abs(background.level_dn.mean() - 20.0) < 0.05)
    True
    """
    image, step_dn, floor_dn = _masked(image_dn, bad)
    mesh = make_mesh(image.shape, box_px)
    first = mesh.upsample(_smooth_sky(mesh, *_tile_statistics(image, mesh, step_dn)))
    # The second look is at a picture whose slope is gone; a slope would otherwise count as noise.
    level, noise = _tile_statistics(image - first, mesh, step_dn)
    surface, sky = _sky_tiles(mesh, level, noise)
    level = np.where(sky, level, surface)
    return Background(first + mesh.upsample(level), mesh.upsample(_noise_mesh(mesh, noise, sky, floor_dn)))


def _masked(image_dn: ArrayLike, bad: ArrayLike | None) -> tuple[FloatArray, float, float]:
    """Return a copy with nan in masked pixels, the step of its values (whole numbers: 1), the least noise."""
    image = np.array(image_dn, dtype=np.float64)
    if image.ndim != 2 or image.size == 0:
        raise ImageError(
            f"a background needs a picture of lines and pixels, not an array of shape {image.shape}."
        )
    masked = ~np.isfinite(image)
    if bad is not None:
        masked |= np.asarray(bad, dtype=bool)
    if masked.all():
        raise ImageError(
            f"all {image.size} pixels are masked: no background; check the bad-pixel mask and the file."
        )
    values = image[~masked]
    if values.min() == values.max():
        raise ImageError(
            f"all {values.size} usable pixels hold the value {values[0]:g}: an empty or lost picture."
        )
    image[masked] = np.nan
    if np.array_equal(values, np.rint(values)):
        return image, 1.0, UNIFORM_SIGMA
    return image, 0.0, NOISE_FREE_SHARE * float(np.ptp(values))


def _tile_statistics(image: FloatArray, mesh: Mesh, step_dn: float) -> tuple[FloatArray, FloatArray]:
    level, noise = clipped_statistics(tiles_of(image, mesh), step_dn)
    if np.isnan(level).all():  # a few pixels here and there: they speak for the whole picture
        values = image[np.isfinite(image)]
        level = np.full_like(level, np.median(values))
        noise = np.full_like(noise, MAD_TO_SIGMA * np.median(np.abs(values - level[0])))
    return level, noise


def _smooth_sky(mesh: Mesh, level: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the tiles' levels (k,), those of body tiles replaced by the surface."""
    surface, sky = _sky_tiles(mesh, level, noise)
    return np.where(sky, level, surface)


def _sky_tiles(mesh: Mesh, level: FloatArray, noise: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the surface through the sky's tiles, and which tiles (k,) show the sky."""
    surface, scatter = robust_surface(mesh.centers(), level)
    distance = np.abs(level - surface)
    nearest = distance <= np.nanmedian(distance)
    tolerance = max(SKY_TOLERANCE_SIGMA * float(np.median(noise[nearest])), SKY_TOLERANCE_SCATTER * scatter)
    return surface, np.asarray(distance <= tolerance)


def _noise_mesh(mesh: Mesh, noise: FloatArray, sky: BoolArray, floor_dn: float) -> FloatArray:
    """Return the tiles' noise (k,), smoothed; tiles without a sky of their own take the median."""
    measured = sky & (noise > floor_dn)
    typical = float(np.median(noise[measured])) if measured.any() else floor_dn
    filled = np.where(measured, noise, typical).reshape(mesh.tiles)
    smooth = ndimage.median_filter(filled, NOISE_SMOOTHING_TILES, mode="nearest")
    return np.maximum(smooth.ravel(), floor_dn)
