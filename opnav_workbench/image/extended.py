"""Where the light of resolved bodies covers a picture, and the sky beside it, told from the picture alone.

Flow   picture less background -> pixels far above the noise -> of these, areas wider than any star -> all light connected

A star's light falls off so steeply that what has a tenth of its peak is a few pixels wide; a body's lit disk is not.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.image.background import Background, estimate_background

__all__ = ["extended_light", "sky_and_bodies"]

BRIGHT_SIGMAS = 5.0  # of the background's noise: what counts as light
PEAK_SHARE = 0.1  # of an area's peak: a limb is above it, a star's wings are not
PEAK_PERCENTILE = 95.0  # cosmic rays are not a peak
RIM_SIGMAS = 4.0  # of the PSF: light beyond the area itself
RIM_PX = 2.0
# A sky that varies by more than this is no sky: a body fills most of the picture and was taken for it.
SKY_RANGE_SIGMAS = 10.0
BLOCK_PX = 16  # of the search for the darkest part, which then is the sky
DARKEST_PERCENTILE = 2.0
MAD_TO_SIGMA = 1.482602


def sky_and_bodies(
    image_dn: FloatArray, bad: BoolArray, saturated: BoolArray, *, radius_px: float, psf_sigma_px: float
) -> tuple[Background, BoolArray]:
    """Return the sky's background, undisturbed by resolved bodies, and where their light lies.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    bad, saturated : (n_line, n_pixel) arrays of bool
    radius_px, psf_sigma_px : float
        As in `extended_light`.

    Raises
    ------
    ImageError
        As `estimate_background`.
    """
    masked = bad | saturated

    def bodies(level: FloatArray | float, noise: FloatArray | float) -> BoolArray:
        return extended_light(
            image_dn - level, noise, bad, saturated, radius_px=radius_px, psf_sigma_px=psf_sigma_px
        )

    background = estimate_background(image_dn, masked)
    extended = bodies(background.level_dn, background.noise_dn)
    if np.ptp(background.level_dn) > SKY_RANGE_SIGMAS * np.median(background.noise_dn):
        dark = bodies(*_darkest(np.where(masked, np.nan, image_dn)))
        extended = dark if dark.any() else extended
    if extended.any() and not (masked | extended).all():
        background = estimate_background(image_dn, masked | extended)
        extended = bodies(background.level_dn, background.noise_dn)
    return background, extended


def _darkest(image: FloatArray) -> tuple[float, float]:
    """Return level and noise of the darkest blocks of a picture; masked pixels are nan."""
    lines, pixels = (size // BLOCK_PX * BLOCK_PX for size in image.shape)
    blocks = image[:lines, :pixels].reshape(lines // BLOCK_PX, BLOCK_PX, -1, BLOCK_PX)
    values = blocks.swapaxes(1, 2).reshape(-1, BLOCK_PX * BLOCK_PX)
    values = values[np.isfinite(values).sum(axis=1) > BLOCK_PX * BLOCK_PX / 2]
    if len(values) == 0:
        return float(np.nanmedian(image)), float(np.nanstd(image))
    level = np.nanmedian(values, axis=1)
    dark = values[level <= np.percentile(level, DARKEST_PERCENTILE)]
    middle = np.nanmedian(dark, axis=1, keepdims=True)
    return float(np.median(middle)), float(MAD_TO_SIGMA * np.nanmedian(np.abs(dark - middle)))


def extended_light(
    signal_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike,
    saturated: ArrayLike,
    *,
    radius_px: float,
    psf_sigma_px: float,
) -> BoolArray:
    """Return the pixels (n_line, n_pixel) that the light of resolved bodies covers, with a rim for the PSF.

    Parameters
    ----------
    signal_dn, noise_dn : (n_line, n_pixel) array_like
        Picture less its background, and the background's noise.
    bad, saturated : (n_line, n_pixel) array_like of bool
        A bad pixel within a body counts to it; a saturated one is light.
    radius_px : float
        Radius of the smallest circle, all light, that is no star.
    psf_sigma_px : float

    Examples
    --------
    >>> line, pixel = np.indices((100, 100))
    >>> disk = 500.0 * (np.hypot(pixel - 40, line - 60) < 20) + 1e4 * np.exp(-np.hypot(pixel - 80, line - 20) ** 2)
    >>> mask = extended_light(disk, 1.0, disk < 0, disk > 1e5, radius_px=6, psf_sigma_px=0.8)
    >>> bool(mask[60, 40]), bool(mask[20, 80])
    (True, False)
    """
    signal = np.asarray(signal_dn, dtype=np.float64)
    light = np.asarray(saturated, dtype=bool) | (signal > BRIGHT_SIGMAS * np.asarray(noise_dn))
    nothing = np.zeros(signal.shape, dtype=bool)
    if np.count_nonzero(light) < np.pi * radius_px**2:
        return nothing
    filled = ndimage.binary_closing(light | (np.asarray(bad, dtype=bool) & _surrounded(light)))
    wide = _wide(filled, radius_px)
    if not wide.any():
        return nothing
    areas, _ = ndimage.label(ndimage.binary_propagation(wide, mask=filled))
    boxes = ndimage.find_objects(areas)
    bodies = [_is_body(signal[b], areas[b] == n, radius_px) for n, b in enumerate(boxes, start=1)]
    chosen = np.isin(areas, 1 + np.flatnonzero(bodies))
    return _grown(chosen, RIM_SIGMAS * psf_sigma_px + RIM_PX) if chosen.any() else nothing


def _surrounded(light: BoolArray) -> BoolArray:
    """Pixels of which most neighbours are light."""
    return np.asarray(ndimage.uniform_filter(light.astype(np.float32), 5) > 0.5)


def _wide(area: BoolArray, radius_px: float) -> BoolArray:
    """Pixels of an area that are at least `radius_px` from everything else."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(area, 1, mode="edge"))[1:-1, 1:-1] >= radius_px)


def _is_body(signal: FloatArray, area: BoolArray, radius_px: float) -> bool:
    peak = np.percentile(signal[area], PEAK_PERCENTILE)
    return bool(_wide(area & (signal > PEAK_SHARE * peak), radius_px).any())


def _grown(area: BoolArray, by_px: float) -> BoolArray:
    return np.asarray(ndimage.distance_transform_edt(~area) <= by_px)
