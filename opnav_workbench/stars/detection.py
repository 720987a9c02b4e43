"""Blind detection of stars: matched filter over the whole image, local maxima of its signal-to-noise ratio.

With weights w = 1 / noise^2 (0 where masked) and the PSF T at each pixel, flux = (w d * T) / (w * T^2) and its sigma
is (w * T^2)^-1/2: masked pixels and uneven noise cost what they must. Both correlations are separable for a round PSF.

A star off the center of its pixel answers less to the filter than one on it, 15 to 30 % where the PSF is
undersampled; how much less, and how far off it is, follow from the answers of the pixels around. Of saturated stars
the filter sees only the wings: their cores say where they are, and take the place of what was found around them.

References: Zackay & Ofek (2017), doi:10.3847/1538-4357/836/2/187; sharpness after Stetson (1987), doi:10.1086/131977.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.ndimage import correlate1d
from scipy.special import erf, gammainc

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars.boxes import Pixels, check_image
from opnav_workbench.stars.flags import StarFlag, combine_flags

__all__ = ["Detections", "detect", "in_defect_rows", "on_tracks"]


# ---- What blind detection finds in an image.


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Sources of an image, brightest first."""

    pixel_line: FloatArray  # (m, 2) good to about 0.1 px
    flux_dn: FloatArray  # (m,) total flux of a star with the given PSF
    snr: FloatArray  # (m,)
    sharpness: FloatArray  # (m,) largest pixel's part of the flux in its 3 x 3, over the most a star can have
    flags: IntArray  # (m,) sum of StarFlag
    limit_dn: float = float("nan")  # total flux of a star at the threshold, where the noise is usual

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.flags)

    def take(self, rows: IntArray | BoolArray) -> "Detections":
        """Return some of the detections, in the given order."""
        return Detections(
            self.pixel_line[rows], self.flux_dn[rows], self.snr[rows], self.sharpness[rows], self.flags[rows],
            self.limit_dn,
        )  # fmt: skip


# ---- Saturated stars in a detection list: the filter sees only their wings, their cores say where they are.

WING_SIGMAS = 4.0  # a core's wings, beyond its own radius, in which detections are parts of the same star


def replace_saturated(found: Detections, saturated: BoolArray, sigma_px: float) -> Detections:
    """Return the detections with one at the middle of each saturated core, in place of those around it.

    Its flux is that of the brightest detection it replaces (of all, where it replaces none), a lower limit; it is
    flagged SATURATED.
    """
    if not saturated.any():
        return found
    from skimage.measure import label, regionprops  # noqa: PLC0415 (few pictures are saturated)

    cores = regionprops(label(saturated, connectivity=2))
    middle = np.array([core.centroid[::-1] for core in cores])
    radius = np.array([0.5 * core.equivalent_diameter_area for core in cores]) + WING_SIGMAS * sigma_px
    near = scipy.spatial.cKDTree(found.pixel_line.reshape(-1, 2)).query_ball_point(middle, radius)
    kept = np.setdiff1d(np.arange(len(found)), np.concatenate([*near, []]).astype(np.int64))
    brightest = float(np.max(found.flux_dn, initial=1.0))
    flux = np.array([float(found.flux_dn[n].max()) if n else brightest for n in near])
    snr = np.array([float(found.snr[n].max()) if n else float(np.max(found.snr, initial=1.0)) for n in near])
    return replace(
        found,
        pixel_line=np.vstack([found.pixel_line[kept], middle]),
        flux_dn=np.r_[found.flux_dn[kept], flux],
        snr=np.r_[found.snr[kept], snr],
        sharpness=np.r_[found.sharpness[kept], np.ones(len(cores))],
        flags=np.r_[found.flags[kept], np.full(len(cores), int(StarFlag.SATURATED))],
    )


# ---- Blind detection of stars.

DETECTION_SNR = 6.0  # in 10^6 pixels noise exceeds it in one frame of a thousand
KERNEL_SIGMAS = 3.0
MIN_COVERAGE = 0.3  # part of a star's information that must lie on usable pixels
STRIP_LINES = 64  # filtered at a time
MEDIAN_SAMPLES = 200_000  # pixels that suffice for the median of an image
# A star centered on a pixel is the sharpest that the PSF allows; noise is allowed this many sigmas beyond it.
COSMIC_RAY_SIGMAS = 3.0
COSMIC_RAY_MARGIN = 0.1  # for a PSF sharper than described: field, focus, temperature
PHASES = np.linspace(-0.5, 0.5, 41)  # places of a star within its pixel for which the answers are tabulated


def detect(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    sigma_px: float,
    threshold_snr: float = DETECTION_SNR,
    *,
    saturated: ArrayLike | None = None,
    max_detections: int | None = None,
    sharpest_px: float | None = None,
) -> Detections:
    """Find everything that stands out of the noise like a star.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image with its uneven background removed; a constant level may be left (the median is subtracted).
    noise_dn : (n_line, n_pixel) array_like or float
        Expected 1-sigma noise of the pixels.
    bad, saturated : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out; stars with saturated pixels are found by what is left of them, and flagged.
    sigma_px
        PSF, before integration over the pixels.
    threshold_snr
        Smallest signal-to-noise ratio of the matched filter.
    max_detections
        Keep the brightest only.
    sharpest_px
        The least sigma that the PSF of this picture may have; `sigma_px` where left out.

    Returns
    -------
    Detections
        Single pixels too sharp for a star are flagged COSMIC_RAY but kept: where the PSF is undersampled a
        star centered on its pixel looks the same.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, or a PSF or threshold that is not positive.

    Examples
    --------
    >>> image = np.random.default_rng(1).normal(0.0, 1.0, (64, 64))
    >>> image[30:33, 40:43] += 50.0 * np.outer([0.25, 0.5, 0.25], [0.25, 0.5, 0.25])
    >>> found = detect(image, 1.0, None, sigma_px=0.7)
    >>> len(found), np.rint(found.pixel_line[0]).tolist()
    (1, [41.0, 31.0])
    """
    if not (0.0 < sigma_px < np.inf and 0.0 < threshold_snr < np.inf):
        raise CenterfindingError(
            f"PSF sigma and threshold must be positive, got {sigma_px} px and {threshold_snr}."
        )
    pixels = check_image(image_dn, noise_dn, bad, saturated)
    median = _image_median(pixels.image_dn, np.isfinite(pixels.noise_dn))
    kernel = _kernel(sigma_px)
    line, pixel, patch, flux_sigma, usual = _filtered_peaks(pixels, median, kernel, threshold_snr)
    offset, answer = _PixelPhase(kernel, sigma_px).of(patch)
    sharpness, sharpness_sigma = _sharpness(pixels, median, line, pixel, kernel)
    least = min(sharpest_px or sigma_px, sigma_px)
    most = _most_sharpness(_kernel(least)) / _most_sharpness(kernel)
    too_sharp = sharpness > most + COSMIC_RAY_MARGIN + COSMIC_RAY_SIGMAS * sharpness_sigma
    peak = patch[:, 1, 1]
    found = Detections(
        pixel_line=np.column_stack([pixel, line]) + offset,
        flux_dn=peak * flux_sigma / answer,
        snr=peak,
        sharpness=sharpness,
        flags=_flags(pixels, line, pixel, too_sharp),
        limit_dn=threshold_snr * usual,
    )
    found = replace_saturated(found, pixels.saturated, sigma_px)
    return found.take(np.argsort(-found.flux_dn, kind="stable")[:max_detections])


ROW_CHANCE = 1e-6  # that a picture's stars stand so in any of its columns
ROW_NEIGHBORS = 10  # columns on each side that tell how many are usual there: a cluster is no defect
ROW_SPAN = 0.25  # of the detector: a star's trail is shorter


def in_defect_rows(found: Detections, shape: tuple[int, int]) -> BoolArray:
    """Tell which detections (n,) are a hot column's or line's: far more of them in it than beside it, far apart.

    Parameters
    ----------
    shape
        (n_line, n_pixel) of the picture.
    """
    odd = np.zeros(len(found), bool)
    for axis in (0, 1):
        width, length = shape[1 - axis], shape[axis]
        at = np.clip(np.rint(found.pixel_line[:, axis]).astype(int), 0, width - 1)
        along = found.pixel_line[:, 1 - axis]
        count = np.bincount(at, minlength=width)
        first, last = np.full(width, np.inf), np.full(width, -np.inf)
        np.minimum.at(first, at, along)
        np.maximum.at(last, at, along)
        # The median of the neighbors, for defects may stand together.
        beside = np.pad(count, ROW_NEIGHBORS, mode="reflect")
        usual = np.median(sliding_window_view(beside, 2 * ROW_NEIGHBORS + 1), axis=1)
        usual = np.maximum(usual, np.median(count)) + 1.0
        many = gammainc(np.maximum(count, 1), usual) < ROW_CHANCE / width  # Poisson: that many or more
        odd |= (many & (last - first > ROW_SPAN * length))[at]
    return odd


LIGHT_SIGMAS = 2.5  # of the noise: fainter pixels have no say in how an image is drawn out
# Second moments of a track along and across, in those of the PSF: at least, at most.
TRACK_LENGTH, TRACK_WIDTH = 3.0, 2.0
ALIKE = 0.5  # mean vector of the directions, twice the angle: above, the camera moved and the tracks are its stars


def on_tracks(
    image_dn: FloatArray, noise_dn: FloatArray | float, found: Detections, sigma_px: float
) -> BoolArray:
    """Tell which detections (n,) lie on narrow tracks, of cosmic rays, that run in all directions.

    Where most are tracks, also whatever else is not compact: they cross.

    Parameters
    ----------
    image_dn, noise_dn
        As in `detect`.
    sigma_px
        The largest that the PSF may be.
    """
    noise = np.broadcast_to(np.asarray(noise_dn, float), image_dn.shape)
    half = int(np.ceil(KERNEL_SIGMAS * sigma_px)) + 1
    middle = np.rint(found.pixel_line).astype(int)
    whole = np.all((middle >= half) & (middle < np.array(image_dn.shape[::-1]) - half), axis=1)
    odd = np.zeros(len(found), bool)
    rows = np.flatnonzero(whole)
    step = np.arange(-half, half + 1)
    window = middle[rows, 1, None, None] + step[:, None], middle[rows, 0, None, None] + step
    light = image_dn[window] - _image_median(image_dn, np.isfinite(image_dn) & np.isfinite(noise))
    with np.errstate(invalid="ignore"):
        light = np.where(light > LIGHT_SIGMAS * noise[window], light, 0.0)
    total = np.maximum(light.sum(axis=(1, 2)), np.finfo(float).tiny)
    x, y = (np.sum(light * axis, axis=(1, 2)) / total for axis in (step, step[:, None]))
    xx = np.sum(light * (step - x[:, None, None]) ** 2, axis=(1, 2)) / total
    yy = np.sum(light * (step[:, None] - y[:, None, None]) ** 2, axis=(1, 2)) / total
    xy = np.sum(light * step * step[:, None], axis=(1, 2)) / total - x * y
    mean, stretch = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    usual = sigma_px**2 + PIXEL_VARIANCE_PX2
    drawn = (mean + stretch > TRACK_LENGTH * usual) & (mean - stretch < TRACK_WIDTH * usual)
    turn = np.exp(1j * np.arctan2(xy, 0.5 * (xx - yy)))[drawn]
    if len(turn) and abs(turn.mean()) < ALIKE:
        crowded = np.count_nonzero(drawn) > 0.5 * len(drawn)
        odd[rows] = mean + stretch > TRACK_LENGTH * usual if crowded else drawn
    return odd


Peaks = tuple[IntArray, IntArray, FloatArray, FloatArray, float]


def _filtered_peaks(pixels: Pixels, median: float, kernel: FloatArray, threshold: float) -> Peaks:
    """Local maxima of the matched filter: lines, pixels, the filter around each (k, 3, 3), flux sigmas; the usual sigma.

    The picture is filtered strip by strip: what is computed of a strip stays in the processor's cache.
    """
    least = MIN_COVERAGE * _full_information(pixels.noise_dn, kernel)
    n_line, half = len(pixels.image_dn), len(kernel) // 2
    found, sigmas = [], []
    for start in range(0, n_line, STRIP_LINES):
        stop = min(start + STRIP_LINES, n_line)
        low, high = max(start - 1, 0), min(stop + 1, n_line)  # a maximum needs its neighbors
        signal, information = _filtered_strip(pixels, median, kernel, low, high)
        line, pixel, patch = _local_maxima(signal, information, least, threshold)
        found.append((line + low, pixel, patch, information[line, pixel] ** -0.5))
        some = information[:: half + 1, :: half + 1]
        sigmas.append(some[some > least] ** -0.5)
    line, pixel, patch, flux_sigma = (np.concatenate(column) for column in zip(*found, strict=True))
    covered = np.concatenate(sigmas)
    return line, pixel, patch, flux_sigma, float(np.median(covered)) if len(covered) else float("nan")


def _filtered_strip(
    pixels: Pixels, median: float, kernel: FloatArray, low: int, high: int
) -> tuple[FloatArray, FloatArray]:
    """Weighted flux and inverse variance of a star's flux on each pixel of the lines from low to high."""
    half = len(kernel) // 2
    top, bottom = max(low - half, 0), min(high + half, len(pixels.image_dn))
    margin = half - (low - top), half - (bottom - high)  # of lines beyond the picture's edge
    weight = 1.0 / np.square(pixels.noise_dn[top:bottom])  # a power of -2 takes as long as all that follows
    signal = (pixels.image_dn[top:bottom] - median) * weight
    if np.all(weight == weight[0, 0]):  # a matter of the edges
        ones = (np.ones(n) for n in weight.shape)
        line, pixel = (correlate1d(one, kernel**2, mode="constant") for one in ones)
        information = weight[0, 0] * line[low - top : high - top, None] * pixel
    else:
        information = _separable(weight, kernel**2, margin)
    return _separable(signal, kernel, margin), information


class _PixelPhase:
    """Where a star lies within its pixel, and what part of its flux the filter answers with there.

    Along an axis the filter's answers to a star at phase x, one pixel before, on and after its own, depend on x
    only; the vertex of the parabola through them is tabulated against x, and read backward.
    """

    def __init__(self, kernel: FloatArray, sigma_px: float) -> None:
        half = len(kernel) // 2
        edges = np.arange(-half - 1, half + 3) - 0.5
        star = 0.5 * np.diff(erf((edges - PHASES[:, None]) / (np.sqrt(2.0) * sigma_px)), axis=1)
        answers = np.stack([star[:, k : k + len(kernel)] @ kernel for k in range(3)], axis=1)
        self._answer = answers[:, 1] / np.sum(kernel**2)
        self._vertex = _vertex(answers)

    def of(self, patch: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places (n, 2) within the pixel and parts of the flux (n,) from answers (n, 3, 3)."""
        vertex = np.column_stack([_vertex(patch.sum(axis=1)), _vertex(patch.sum(axis=2))])
        phase = np.interp(vertex, self._vertex, PHASES)
        return phase, np.interp(phase, PHASES, self._answer).prod(axis=1)


def _vertex(three: FloatArray) -> FloatArray:
    """Vertex (n,) of the parabolas through values (n, 3) at -1, 0, 1; 0 where they have no top."""
    before, here, after = three.T
    bend = 2.0 * here - before - after
    return np.asarray(np.where(bend > 0.0, 0.5 * (after - before) / np.where(bend > 0.0, bend, 1.0), 0.0))


def _image_median(image: FloatArray, usable: BoolArray) -> float:
    step = max(1, int(np.sqrt(image.size / MEDIAN_SAMPLES)))
    sample = image[::step, ::step][usable[::step, ::step]]
    return float(np.median(sample if sample.size else image[usable]))


def _kernel(sigma_px: float) -> FloatArray:
    """Return the flux of a centered star in each column of pixels; (2 half + 1,)."""
    half = max(1, int(np.ceil(KERNEL_SIGMAS * sigma_px)))
    edges = np.arange(-half, half + 2) - 0.5
    return np.asarray(0.5 * np.diff(erf(edges / (np.sqrt(2.0) * sigma_px))))


def _separable(strip: FloatArray, kernel: FloatArray, margin: tuple[int, int]) -> FloatArray:
    """Filter along lines and columns; half a kernel is lost above and below but for the `margin`, which is dark.

    Sums of shifted arrays: of a strip that stays in the cache, a third of the time that `correlate1d` takes.
    """
    half = len(kernel) // 2
    tall = np.pad(strip, (margin, (half, half)))
    n_line, n_pixel = tall.shape[0] - 2 * half, strip.shape[1]
    down = _shifted_sum([tall[k : k + n_line] for k in range(len(kernel))], kernel)
    return _shifted_sum([down[:, k : k + n_pixel] for k in range(len(kernel))], kernel)


def _shifted_sum(shifted: list[FloatArray], kernel: FloatArray) -> FloatArray:
    """Sum of arrays times a kernel that is symmetric."""
    half = len(kernel) // 2
    total = kernel[half] * shifted[half]
    pair = np.empty_like(total)
    for k in range(half):
        np.add(shifted[k], shifted[-1 - k], out=pair)
        pair *= kernel[k]
        total += pair
    return np.asarray(total)


def _full_information(noise_dn: FloatArray, kernel: FloatArray) -> float:
    step = max(1, int(np.sqrt(noise_dn.size / MEDIAN_SAMPLES)))
    some = noise_dn[::step, ::step]
    some = some[np.isfinite(some)] if np.isfinite(some).any() else noise_dn[np.isfinite(noise_dn)]
    return float(np.median(some) ** -2.0 * np.sum(kernel**2) ** 2)


def _local_maxima(
    signal: FloatArray, information: FloatArray, least: float, threshold: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Lines and pixels above the threshold and above their eight neighbors (of equal ones, the first); the ratios there.

    A ratio of signal to noise is the weighted flux over the root of its information; 0 where that is too little.
    """
    inner = slice(1, -1), slice(1, -1)
    here = signal[inner]
    above = (here * np.abs(here) >= threshold**2 * information[inner]) & (information[inner] > least)
    line, pixel = np.divmod(np.flatnonzero(above), max(signal.shape[1] - 2, 1))
    line, pixel, steps = line + 1, pixel + 1, np.array([-1, 0, 1])
    around = line[:, None, None] + steps[:, None], pixel[:, None, None] + steps
    known = information[around]
    patch = np.where(known > least, signal[around] / np.sqrt(np.where(known > least, known, 1.0)), 0.0)
    flat, middle = patch.reshape(-1, 9), patch[:, 1, 1, None]
    top = (middle > flat[:, :4]).all(axis=1) & (middle >= flat[:, 5:]).all(axis=1)
    return line[top], pixel[top], patch[top]


def _sharpness(
    pixels: Pixels, median: float, line: IntArray, pixel: IntArray, kernel: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Part of the 3 x 3 flux in the largest pixel, over that of a star on the pixel's center; its sigma."""
    steps = np.array([-1, 0, 1])
    window = line[:, None, None] + steps[:, None], pixel[:, None, None] + steps
    usable = np.isfinite(pixels.noise_dn[window])
    patch = np.where(usable, pixels.image_dn[window] - median, 0.0).reshape(len(line), 9)
    noise = np.where(usable, pixels.noise_dn[window], 0.0).reshape(len(line), 9)
    most = _most_sharpness(kernel)
    total = np.maximum(patch.sum(axis=1), np.sqrt(np.sum(noise**2, axis=1)))
    total = np.where(total > 0.0, total, 1.0)
    fraction = patch.max(axis=1) / total
    return fraction / most, np.sqrt(np.sum(noise**2, axis=1)) / (total * most)


def _most_sharpness(kernel: FloatArray) -> float:
    """Return the part of the 3 x 3 flux in the middle pixel of a star that is centered on it."""
    middle = len(kernel) // 2
    return float(kernel[middle] / kernel[middle - 1 : middle + 2].sum()) ** 2


def _flags(pixels: Pixels, line: IntArray, pixel: IntArray, too_sharp: BoolArray) -> IntArray:
    steps = np.array([-1, 0, 1])
    window = line[:, None, None] + steps[:, None], pixel[:, None, None] + steps
    n_line, n_pixel = pixels.image_dn.shape
    conditions = {
        StarFlag.SATURATED: pixels.saturated[window].any(axis=(1, 2)),
        StarFlag.BAD_PIXELS: pixels.bad[window].any(axis=(1, 2)),
        StarFlag.EDGE: (line < 2) | (pixel < 2) | (line >= n_line - 2) | (pixel >= n_pixel - 2),
        StarFlag.COSMIC_RAY: too_sharp,
    }
    return combine_flags(conditions, len(line))
