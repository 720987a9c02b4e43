"""Where the light of resolved bodies covers a picture, and the sky beside it, told from the picture alone.

Flow   picture less background -> pixels far above the noise -> of these, areas wider than any star -> all light connected

A star's light falls off so steeply that what has a tenth of its peak is a few pixels wide; a body's lit disk is not.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.image.background import Background, estimate_background
from opnav_workbench.image.readout_smear import readout_smear

__all__ = ["extended_light", "sky_and_bodies"]

BRIGHT_SIGMAS = 5.0  # of the background's noise: what counts as light
PEAK_SHARE = 0.1  # of an area's peak: a limb is above it, a star's wings are not
PEAK_PERCENTILE = 95.0  # cosmic rays are not a peak
RIM_SIGMAS = 4.0  # of the PSF: light beyond the area itself
RIM_PX = 2.0
BAND_PIXELS = 1 << 20  # that boxes are looked for in at once: some milliseconds
# An overexposed star is as wide, but most of its light lies in wings that fall off; a body's has an edge.
SATURATED_SHARE = 0.2  # of the area above `PEAK_SHARE`
EDGED_SHARE = 0.4  # of all its light
# A sky this much above the darkest part of the picture may be none, but a body that fills most of it and was taken for
# the sky: then the light above the darkest part ends at an edge, as stray light does not.
SKY_RANGE_SIGMAS = 10.0
EDGE_SIGMAS = 3.0
EDGE_FROM_PX, EDGE_TO_PX = 2.0, 6.0  # from the rim, to both sides
BLOCK_PX = 16  # of the search for the darkest part, which then is the sky
DARKEST_PERCENTILE = 2.0


def sky_and_bodies(
    image_dn: FloatArray, bad: BoolArray, saturated: BoolArray, *, radius_px: float, psf_sigma_px: float
) -> tuple[Background, BoolArray]:
    """Return the sky's background, undisturbed by resolved bodies, and where their light lies.

    What bodies leave along their columns in a readout without a shutter (`readout_smear`) is sky.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    bad, saturated : (n_line, n_pixel) arrays of bool
    radius_px, psf_sigma_px
        As in `extended_light`.

    Raises
    ------
    ImageError
        As `estimate_background`.
    """
    background, extended = _without_smear(
        image_dn, bad, saturated, radius_px=radius_px, psf_sigma_px=psf_sigma_px
    )
    noise_dn = float(np.median(background.noise_dn))
    smear = readout_smear(image_dn, bad | saturated, noise_dn) if extended.any() else None
    if smear is None:
        return background, extended
    background, extended = _without_smear(
        image_dn - smear, bad, saturated, radius_px=radius_px, psf_sigma_px=psf_sigma_px
    )
    return replace(background, level_dn=background.level_dn + smear, smear_dn=smear), extended


def _without_smear(
    image_dn: FloatArray, bad: BoolArray, saturated: BoolArray, *, radius_px: float, psf_sigma_px: float
) -> tuple[Background, BoolArray]:
    """Return what `sky_and_bodies` does of a picture that was not smeared."""
    masked = bad | saturated

    def bodies(level: FloatArray | float, noise: FloatArray | float) -> BoolArray:
        return extended_light(
            image_dn - level, noise, bad, saturated, radius_px=radius_px, psf_sigma_px=psf_sigma_px
        )

    background = estimate_background(image_dn, masked)
    extended = bodies(background.level_dn, background.noise_dn)
    darkest_dn, noise_dn = _darkest(np.where(masked, np.nan, image_dn))
    if background.level_dn.max() - darkest_dn > SKY_RANGE_SIGMAS * noise_dn:
        above = bodies(darkest_dn, noise_dn)
        if _has_edge(image_dn, above, masked, EDGE_SIGMAS * noise_dn):
            extended = above
    if extended.any() and not (masked | extended).all():
        background = estimate_background(image_dn, masked | extended)
        extended = bodies(background.level_dn, background.noise_dn)
    return background, extended


def _has_edge(image: FloatArray, area: BoolArray, masked: BoolArray, least_dn: float) -> bool:
    """Tell whether the picture is brighter by `least_dn` just within an area than just beside it."""
    if area.all() or not area.any():
        return False
    within = ndimage.distance_transform_edt(area) - RIM_PX
    beside = ndimage.distance_transform_edt(~area)
    inner = (within > EDGE_FROM_PX) & (within < EDGE_TO_PX + RIM_PX) & ~masked
    outer = (beside > EDGE_FROM_PX) & (beside < EDGE_TO_PX) & ~masked
    if not (inner.any() and outer.any()):
        return False
    return bool(np.median(image[inner]) - np.median(image[outer]) > least_dn)


def _darkest(image: FloatArray) -> tuple[float, float]:
    """Return level and noise of the darkest blocks of a picture; masked pixels are nan."""
    lines, pixels = (size // BLOCK_PX * BLOCK_PX for size in image.shape)
    blocks = image[:lines, :pixels].reshape(lines // BLOCK_PX, BLOCK_PX, pixels // BLOCK_PX, BLOCK_PX)
    values = blocks.swapaxes(1, 2).reshape(-1, BLOCK_PX * BLOCK_PX)
    values = values[np.isfinite(values).sum(axis=1) > BLOCK_PX * BLOCK_PX / 2]
    if len(values) == 0:
        return float(np.nanmedian(image)), float(np.nanstd(image))  # few pixels speak for the whole picture
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
    radius_px
        Radius of the smallest circle, all light, that is no star.

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
    covered = np.zeros(signal.shape, dtype=bool)
    if np.count_nonzero(light) < np.pi * radius_px**2:
        return covered
    filled = ndimage.binary_closing(light | (np.asarray(bad, dtype=bool) & _surrounded(light)))
    bright, rim = np.asarray(saturated, dtype=bool), RIM_SIGMAS * psf_sigma_px + RIM_PX
    areas = _large_areas(filled, radius_px)
    for number, box in enumerate(_boxes(areas), start=1):
        if min(part.stop - part.start for part in box) < radius_px:
            continue
        around = _widened(box, int(rim) + 2, signal.shape)
        area = areas[around] == number
        if _is_body(signal[around], area, bright[around], radius_px):
            covered[around] |= ndimage.distance_transform_edt(~area) <= rim
    return covered


def _large_areas(light: BoolArray, radius_px: float) -> IntArray:
    """Number the connected areas from 1, without those of too few pixels to reach `radius_px` both ways.

    Noise above the sky makes tens of thousands of areas; what is done for each of them would be most of opening a picture.
    """
    areas, _ = ndimage.label(light)
    # A connected area has width + height - 1 pixels or more.
    large = np.bincount(areas.ravel()) >= 2 * radius_px - 1
    large[0] = False
    return np.asarray(np.where(large, np.cumsum(large), 0)[areas])


def _boxes(areas: IntArray) -> list[tuple[slice, slice]]:
    """Return the box of each numbered area, a band of lines at a time.

    `ndimage.find_objects` keeps all other threads waiting while it works, a tenth of a second for all of 4096 x 4096: the
    analyst's key would wait for it while such a picture is opened ahead.
    """
    found: dict[int, tuple[slice, slice]] = {}
    n_lines = max(1, BAND_PIXELS // areas.shape[1])
    for first in range(0, len(areas), n_lines):
        for number, box in enumerate(ndimage.find_objects(areas[first : first + n_lines]), start=1):
            if box is not None:
                lines = slice(first + box[0].start, first + box[0].stop)
                found[number] = _both(found.get(number, (lines, box[1])), (lines, box[1]))
    return [found[number] for number in sorted(found)]


def _both(one: tuple[slice, slice], other: tuple[slice, slice]) -> tuple[slice, slice]:
    line, pixel = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return line, pixel


def _widened(box: tuple[slice, ...], by: int, shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(
        slice(max(part.start - by, 0), min(part.stop + by, size))
        for part, size in zip(box, shape, strict=True)
    )


def _surrounded(light: BoolArray) -> BoolArray:
    """Pixels of which most neighbours are light."""
    return np.asarray(ndimage.uniform_filter(light.astype(np.float32), 5) > 0.5)


def _wide(area: BoolArray, radius_px: float) -> BoolArray:
    """Pixels of an area that are at least `radius_px` from everything else."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(area, 1, mode="edge"))[1:-1, 1:-1] >= radius_px)


def _is_body(signal: FloatArray, area: BoolArray, saturated: BoolArray, radius_px: float) -> bool:
    if not _wide(area, radius_px).any():
        return False
    peak = np.percentile(signal[area], PEAK_PERCENTILE)
    bright = area & (signal > PEAK_SHARE * peak)
    edged = bright.sum() > EDGED_SHARE * area.sum() or saturated[bright].mean() < SATURATED_SHARE
    return bool(edged and _wide(bright, radius_px).any())
