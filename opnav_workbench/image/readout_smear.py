"""Light that a body leaves all along its columns while a frame-transfer CCD is read out without a shutter.

Flow   picture -> light of each column -> level of the columns in lines without a body, before and behind -> one share of
       that light for all columns -> plane of smear

Every line that passes under a body takes the same share of its column's light: before the body by the one transfer, behind
it by the other (clearing before the exposure, reading after it). What falls off with the distance from a body, or does not
go with the light of the columns, is none: a coma, a halo, stray light.
"""

import numpy as np
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.constants import MAD_TO_SIGMA

__all__ = ["readout_smear"]

LINES_READ = 128  # of each part of the picture, for the level of its columns
FEWEST_LINES = 16  # beside a body, to tell a level far from it from one near to it
DARK_SHARE = 0.1  # of its lines a column shows at its darkest: a body fills no more than the others
RIM_PX = 4  # about a body: light of its PSF
BRIGHT_SHARE = 0.1  # of the body: its wings, and stars, are fainter
LEAST_SIGMAS = 8.0  # of a share of light, or there is no smear
LEAST_NOISES = 0.1  # of the sky, in the brightest column: less smear is no matter
SAME_SHARE, SAME_SIGMAS = 0.15, 4.0  # near and far levels may differ by
CLIP_SIGMAS, CLIP_PASSES = 3.0, 4


def readout_smear(image_dn: FloatArray, bad: BoolArray, noise_dn: float) -> FloatArray | None:
    """Return the smear (n_line, n_pixel) of the bodies in a picture; None where there is none, or nothing tells of it.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    bad : (n_line, n_pixel) array of bool
        Pixels to leave out of levels.
    noise_dn
        Of a pixel of sky.

    Examples
    --------
    >>> body = np.zeros((200, 120))
    >>> body[80:120, 40:80] = 1000.0
    >>> picture = body + 0.001 * body.sum(axis=0) + np.random.default_rng(1).normal(0.0, 2.0, body.shape)
    >>> smear = readout_smear(picture, np.zeros(body.shape, dtype=bool), 2.0)
    >>> round(float(smear[0, 60])), round(float(smear[0, 10]))
    (40, 0)
    """
    sky_dn = np.where(bad | ~np.isfinite(image_dn), np.nan, image_dn)
    light = _light_beside_columns(image_dn, sky_dn, noise_dn)
    lines = np.flatnonzero(light.any(axis=1))
    if not len(lines):
        return None
    total = light.sum(axis=0)
    parts = (np.arange(lines[0] - RIM_PX)[::-1], np.arange(lines[-1] + RIM_PX + 1, len(image_dn)))
    shares = [_share(sky_dn, noise_dn, total, part) for part in parts]
    known = [share for share in shares if share is not None]
    if not known or max(known) * float(total.max()) < LEAST_NOISES * noise_dn:
        return None
    before, behind = (known[0] if share is None else share for share in shares)
    through = np.cumsum(light, axis=0) - 0.5 * light
    return np.asarray(behind * through + before * (total - through))


def _light_beside_columns(image_dn: FloatArray, sky_dn: FloatArray, noise_dn: float) -> FloatArray:
    """Return the light (n_line, n_pixel) of bodies above the level of their columns, 0 elsewhere.

    That of a picture, saturated or not; levels are told by the pixels of `sky_dn`, nan where they are bad.
    """
    read = sky_dn[:: -(-len(sky_dn) // (2 * LINES_READ))]
    dark = np.sort(read, axis=0)[int(DARK_SHARE * len(read))]
    above = np.where(np.isfinite(image_dn), image_dn, 0.0) - np.nan_to_num(dark)
    bright = above > max(LEAST_SIGMAS * noise_dn, BRIGHT_SHARE * float(np.quantile(above[::2, ::2], 0.999)))
    wide = ndimage.minimum_filter(bright.view(np.uint8), 3)  # as no star is
    body = ndimage.maximum_filter(wide, 2 * RIM_PX + 3).view(np.bool_)
    return np.where(body, np.maximum(above, 0.0), 0.0)


def _share(sky_dn: FloatArray, noise_dn: float, light_dn: FloatArray, lines: IntArray) -> float | None:
    """Return the share of a column's light in some lines, nearest to the body first: 0 for none, None for too few lines."""
    if len(lines) < 2 * FEWEST_LINES:
        return None
    found = [_fitted_share(sky_dn, noise_dn, light_dn, half) for half in np.array_split(lines, 2)]
    (near, near_sigma), (far, far_sigma) = found
    allowed = SAME_SHARE * far + SAME_SIGMAS * float(np.hypot(near_sigma, far_sigma))
    return far if far > LEAST_SIGMAS * far_sigma and abs(near - far) < allowed else 0.0


def _fitted_share(
    sky_dn: FloatArray, noise_dn: float, light_dn: FloatArray, lines: IntArray
) -> tuple[float, float]:
    """Return by how much the level of columns grows with their light (n_pixel,), beside a slope, and its sigma."""
    chosen = np.sort(lines[:: -(-len(lines) // LINES_READ)])
    level, count = _column_means(sky_dn[chosen])
    kept = count >= FEWEST_LINES // 2
    if not kept.any():
        return 0.0, np.inf  # they show no sky
    most, least = float(light_dn.max()), noise_dn / float(np.sqrt(count[kept].max()))
    along = np.linspace(-1.0, 1.0, len(level))
    columns = np.stack([light_dn / most, np.ones_like(along), along, along**2], axis=1)
    for _ in range(CLIP_PASSES):
        solution = np.linalg.lstsq(columns[kept], level[kept], rcond=None)[0]
        residual = level - columns @ solution
        scatter = MAD_TO_SIGMA * float(np.median(np.abs(residual[kept] - np.median(residual[kept]))))
        sigma = max(scatter, least)
        kept &= np.abs(residual) < CLIP_SIGMAS * sigma
        if np.count_nonzero(kept) <= columns.shape[1]:
            return 0.0, np.inf
    covariance = np.linalg.pinv(columns[kept].T @ columns[kept])
    return float(solution[0]) / most, sigma * float(np.sqrt(covariance[0, 0])) / most


def _column_means(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the mean of the middle half of each column (n,), nan left out, and how many values it had.

    Of whole numbers a median would be one, too.
    """
    ordered = np.sort(values, axis=0)
    count = np.count_nonzero(np.isfinite(ordered), axis=0)
    sums = np.cumsum(np.nan_to_num(ordered), axis=0)
    first, last, at = count // 4, np.maximum(count - count // 4, 1) - 1, np.arange(len(count))
    inner = sums[last, at] - np.where(first > 0, sums[first - 1, at], 0.0)
    return np.asarray(inner / (last - first + 1)), np.asarray(count)
