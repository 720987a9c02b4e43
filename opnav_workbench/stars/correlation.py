"""First centers of stars: matched filter and cross-correlation with a template, batched over the stars with the FFT.

Both correlate a sub-image with a template and fit a paraboloid to the peak. The matched filter divides by the noise of
each pixel and cuts a circle about the prediction; the cross-correlation takes a plain 16 x 16 sub-image. A template is
a pixel-integrated Gaussian, or cut out of a real image: a well-exposed star, its background removed, of unit flux.

Reference: Jackman & Dumont (2013), AAS 13-443, "The Matched Filter Algorithm", "The Cross-Correlation Algorithm".
"""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import box_integrals
from opnav_workbench.stars.boxes import Boxes, check_image, check_points, cut_boxes
from opnav_workbench.stars.flags import StarFlag, combine_flags
from opnav_workbench.stars.peaks import refine_peaks
from opnav_workbench.stars.results import StarCenters, StarImages

__all__ = ["StarTemplate", "correlate", "extract_template", "gaussian_template"]


# ---- Templates of a star image for the matched filter and the cross-correlation.

MIN_SIGMA_PX = 0.15  # noise can make a second moment of an undersampled star negative
MAX_UNUSABLE_FRACTION = 0.1  # a template with more masked pixels than this is no image of a star


@dataclass(frozen=True, slots=True, eq=False)
class StarTemplate:
    """A star image of unit flux, and where in it the star's center lies."""

    values: FloatArray  # (size, size) [line, pixel]
    center: FloatArray  # (2,) pixel, line in the template's own coordinates
    ellipse: FloatArray  # (3,) sigma_major_px, sigma_minor_px, angle_rad before integration over pixels

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return int(self.values.shape[0])


def gaussian_template(sigma_px: float, size: int) -> StarTemplate:
    """Return a pixel-integrated round Gaussian centered in `size` x `size` pixels.

    Raises
    ------
    CenterfindingError
        A sigma or size that is not positive.

    Examples
    --------
    >>> template = gaussian_template(0.8, 9)
    >>> template.center.tolist(), round(float(template.values.sum()), 4)
    ([4.0, 4.0], 1.0)
    """
    if not 0.0 < sigma_px < np.inf or size < 1:
        raise CenterfindingError(f"a template needs a positive sigma and size, got {sigma_px} px and {size}.")
    center = np.full((1, 2), (size - 1) / 2.0)
    shape = np.array([[np.log(sigma_px), 0.0, 0.0]])
    return StarTemplate(
        box_integrals(center, shape, np.zeros((1, 2)), size).value[0],
        center[0],
        np.array([sigma_px, sigma_px, 0.0]),
    )


def extract_template(
    image_dn: ArrayLike, bad: ArrayLike | None, pixel_line: ArrayLike, radius_px: float
) -> StarTemplate:
    """Cut a well-exposed star out of a real image: a circle about its center, background removed, unit flux.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image; the median of the rim of the circle is taken as its background.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out (also saturated ones); they count as empty.
    pixel_line : (2,) array_like
        Center of the star, sub-pixel: what is found with the template refers to it.
    radius_px
        Radius of the circle: large enough for the wings, too small for another star.

    Raises
    ------
    CenterfindingError
        The circle leaves the detector, is masked, or holds no star.
    """
    pixels = check_image(image_dn, 1.0, bad)
    center = check_points(pixel_line, "pixel_line")
    if len(center) != 1 or not 1.0 <= radius_px < np.inf:
        raise CenterfindingError(
            f"a template needs one star and a radius of at least 1 px, got {radius_px} px."
        )
    boxes = cut_boxes(pixels, center, 2 * int(np.ceil(radius_px)) + 3)
    dx, dy = boxes.offsets(center)
    distance = np.hypot(dx[0][None, :], dy[0][:, None])
    usable, circle = np.isfinite(boxes.variance_dn2[0]), distance <= radius_px
    rim = usable & (distance > radius_px - 1.0) & (distance <= radius_px + 1.0)
    if np.mean(~usable[circle]) > MAX_UNUSABLE_FRACTION or not rim.any():
        raise CenterfindingError(
            f"{np.mean(~usable[circle]):.0%} of the circle of {radius_px} px about "
            f"{center[0].round(2).tolist()} is masked or off the detector; choose another star."
        )
    values = np.where(circle & usable, boxes.data_dn[0] - np.median(boxes.data_dn[0][rim]), 0.0)
    if not values.sum() > 0.0:
        raise CenterfindingError(f"no star at {center[0].round(2).tolist()}: its flux is not positive.")
    values /= values.sum()
    middle = center[0] - boxes.first[0]
    return StarTemplate(values, middle, _ellipse_of_moments(values, middle))


def _ellipse_of_moments(values: FloatArray, center: FloatArray) -> FloatArray:
    """Second moments of a star image, pixel integration taken out, as an ellipse; (3,)."""
    line, pixel = np.indices(values.shape) - center[::-1, None, None]
    weight = np.maximum(values, 0.0) / np.maximum(values, 0.0).sum()
    uu, uv, vv = (float(np.sum(weight * product)) for product in (pixel * pixel, pixel * line, line * line))
    value, vector = np.linalg.eigh(np.array([[uu, uv], [uv, vv]]) - np.eye(2) / 12.0)
    sigma = np.sqrt(np.maximum(value, MIN_SIGMA_PX**2))
    return np.array([sigma[1], sigma[0], np.arctan2(vector[1, 1], vector[0, 1])])


# ---- First centers of stars: matched filter and cross-correlation, batched over the stars with the FFT.

METHODS = ("matched_filter", "cross_correlation")
SUB_IMAGE_PX = 16  # of the cross-correlation, as in the paper
MIN_SNR = 4.0  # below this a peak is as likely noise
MIN_COVERAGE = 0.3  # part of a star's information that must lie on usable pixels
# A paraboloid through 3 x 3 samples is no Gaussian. Its error in noise-free simulations at random phase, 1
# sigma, falls with the square of the PSF's sigma: 0.06 px at 0.5 px, 0.013 px at 1 px.
PARABOLOID_ERROR_PX3 = 0.0135
MAX_PARABOLOID_ERROR_PX = 0.15
CORE_PX = 1.5  # masked pixels this close to the center touch the measurement itself


def correlate(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    start_pixel_line: ArrayLike,
    template: StarTemplate,
    *,
    search_radius_px: float,
    method: Literal["matched_filter", "cross_correlation"] = "matched_filter",
    saturated: ArrayLike | None = None,
) -> StarCenters:
    """Find each star near its predicted position by correlation with a template.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image; the median of each sub-image is removed.
    noise_dn : (n_line, n_pixel) array_like or float
        Expected 1-sigma noise of the pixels.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    start_pixel_line : (n, 2) array_like
        Predicted (pixel, line).
    template
        From `extract_template` or `gaussian_template`.
    search_radius_px
        How far from its prediction a star may be. The cross-correlation sees no farther than its sub-image.
    method
        See the module.
    saturated : (n_line, n_pixel) array_like of bool, optional
        Left out and flagged where they touch the star.

    Returns
    -------
    StarCenters
        Centers good to about 0.1 px, with an approximate covariance: width of the template, noise, and the
        paraboloid's own error. The shape is the template's. A peak on the border of the search area is
        flagged AT_BOUND.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, an unknown method, a search radius below 1 px.

    Examples
    --------
    >>> from opnav_workbench.stars.correlation import gaussian_template
    >>> template = gaussian_template(1.0, 9)
    >>> image = np.zeros((40, 40))
    >>> image[10:19, 20:29] += 500.0 * template.values
    >>> found = correlate(image, 1.0, None, [[21.0, 16.0]], template, search_radius_px=8)
    >>> found.pixel_line.round(2).tolist()
    [[24.0, 14.0]]
    """
    if method not in METHODS:
        raise CenterfindingError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    if not 1.0 <= search_radius_px < np.inf:
        raise CenterfindingError(f"search_radius_px must be at least 1, got {search_radius_px}.")
    pixels = check_image(image_dn, noise_dn, bad, saturated)
    start = check_points(start_pixel_line)
    matched = method == "matched_filter"
    size = 2 * (int(np.ceil(search_radius_px)) + template.size // 2) + 3 if matched else SUB_IMAGE_PX
    boxes = cut_boxes(pixels, start, size)
    weight = boxes.weight
    if matched:
        weight = weight * _in_circle(boxes, start, search_radius_px + template.size / 2)
    filtered = _filtered(boxes, weight, template, matched)
    surface = filtered.surface
    origin = boxes.first + template.center - _middle(template)  # detector position of a star at index 0
    row, column, inside = _largest_samples(
        surface, filtered.covered & _search_area(surface.shape, origin, start, search_radius_px)
    )
    offset, _ = refine_peaks(surface, row, column)
    center = origin + np.stack([column, row], axis=1) + np.where(inside[:, None], offset, 0.0)
    return _star_centers(boxes, filtered, template, center, (row, column), inside, method)


@dataclass(frozen=True, slots=True, eq=False)
class _Filtered:
    """What the filters say of a star at each sample of boxes (n, s, s)."""

    weight: FloatArray  # (n, s, s)
    median: FloatArray  # (n,)
    data: FloatArray  # (n, s, s) without the median, 0 where unusable
    covered: BoolArray  # (n, s, s) where enough of a star would be usable
    sigma: FloatArray  # (n, s, s) of its flux
    snr: FloatArray  # (n, s, s)
    surface: FloatArray  # (n, s, s) whose peak is the star


def _filtered(boxes: Boxes, weight: FloatArray, template: StarTemplate, matched: bool) -> _Filtered:
    median = _box_medians(boxes.data_dn, weight)
    data = np.where(weight > 0.0, boxes.data_dn - median[:, None, None], 0.0)
    information = np.maximum(
        _correlate_fft(weight, template.values**2, template), 0.0
    )  # of a star's flux at each lag
    covered = information > MIN_COVERAGE * information.max(axis=(1, 2), keepdims=True)
    sigma = 1.0 / np.sqrt(np.where(covered, information, np.inf))
    snr = _correlate_fft(weight * data, template.values, template) * sigma
    surface = snr if matched else _correlate_fft(data, template.values, template)
    return _Filtered(weight, median, data, covered, sigma, snr, surface)


def _star_centers(
    boxes: Boxes, filtered: _Filtered, template: StarTemplate, center: FloatArray,
    sample: tuple[IntArray, IntArray], inside: BoolArray, method: str,
) -> StarCenters:  # fmt: skip
    """Return what the boxes tell of stars at `center` (n, 2), whose peaks lie at the samples (row, column)."""
    at = np.arange(len(center)), *sample
    snr, sigma, finite = filtered.snr[at], filtered.sigma[at], filtered.covered[at]
    blank = np.where(finite, 1.0, np.nan)
    usable = filtered.weight > 0.0
    freedom = np.maximum(usable.sum(axis=(1, 2)) - 4.0, 0.0)  # flux, center, background
    chi2 = np.sum(filtered.weight * filtered.data**2, axis=(1, 2)) - snr**2
    drawn = (snr * sigma)[:, None, None] * _drawn_template(template, center - boxes.first, boxes.size)
    return StarCenters(
        pixel_line=center * blank[:, None],
        covariance_px2=_covariance(template, snr) * blank[:, None, None],
        flux_dn=snr * sigma * blank,
        flux_sigma_dn=sigma * blank,
        background_dn=filtered.median * blank,
        shape=template.ellipse * blank[:, None],
        shape_covariance=np.zeros((len(center), 3, 3)),
        chi2_reduced=chi2 / np.maximum(freedom, 1.0) * blank,
        snr=snr * blank,
        degrees_of_freedom=freedom,
        flags=_flags(boxes, center, inside, snr, finite),
        method=method,
        images=StarImages(
            first=boxes.first,
            data_dn=np.where(np.isfinite(boxes.variance_dn2), boxes.data_dn, np.nan),
            model_dn=filtered.median[:, None, None] + drawn,
            sigma_dn=np.where(usable, np.sqrt(boxes.variance_dn2), np.inf),
            surface=np.where(filtered.covered, filtered.surface, np.nan),
        ),
    )


def _middle(template: StarTemplate) -> IntArray:
    """Pixel of the template nearest to its star; index j of a correlation puts it on pixel j of the box."""
    return np.rint(template.center).astype(np.int64)


def _in_circle(boxes: Boxes, center: FloatArray, radius: float) -> BoolArray:
    dx, dy = boxes.offsets(center)
    return np.asarray(dx[:, None, :] ** 2 + dy[:, :, None] ** 2 <= radius**2)


def _box_medians(data: FloatArray, weight: FloatArray) -> FloatArray:
    """Median of the usable pixels of each box, 0 where there is none; (n,)."""
    flat = np.sort(np.where(weight > 0.0, data, np.inf).reshape(len(data), -1), axis=1)
    used = (weight > 0.0).sum(axis=(1, 2))
    rows, last = np.arange(len(data)), np.maximum(used, 1)
    median = 0.5 * (flat[rows, (last - 1) // 2] + flat[rows, last // 2])
    return np.where(used > 0, median, 0.0)


def _correlate_fft(boxes: FloatArray, kernel: FloatArray, template: StarTemplate) -> FloatArray:
    """Correlate (n, s, s) boxes with a kernel of the template's size; zero padding keeps borders apart.

    The inverse FFT of the product of the data's FFT with the complex conjugate of the kernel's.
    """
    s, t = boxes.shape[-1], template.size
    length = fft.next_fast_len(s + t, real=True)
    product = fft.rfft2(boxes, (length, length)) * np.conj(fft.rfft2(kernel, (length, length)))
    correlation = fft.irfft2(product, (length, length))
    column, row = ((np.arange(s) - middle) % length for middle in _middle(template))
    return np.asarray(correlation[:, row[:, None], column[None, :]])


def _drawn_template(template: StarTemplate, place: FloatArray, size: int) -> FloatArray:
    """Draw the template with its center at places (n, 2) of boxes (n, size, size), shared among four pixels."""
    corner = place - template.center
    whole = np.floor(corner).astype(np.int64)
    part = corner - whole
    padded = np.pad(template.values, 1)  # the rim stands for all that lies outside
    last = len(padded) - 1
    drawn = np.zeros((len(place), size, size))
    for line, pixel in product((0, 1), (0, 1)):
        step = np.arange(size) - whole[:, :, None] - np.array([pixel, line])[:, None]
        index = np.where((step >= 0) & (step < template.size), step + 1, last)
        share = np.prod(np.where([pixel, line], part, 1.0 - part), axis=1)
        drawn += share[:, None, None] * padded[index[:, 1, :, None], index[:, 0, None, :]]
    return drawn


def _search_area(shape: tuple[int, ...], origin: FloatArray, start: FloatArray, radius: float) -> BoolArray:
    """True where the star would lie within `radius` of its prediction; (n, s, s)."""
    distance = np.arange(shape[-1]) + (origin - start)[:, :, None]
    return np.asarray(distance[:, 0, None, :] ** 2 + distance[:, 1, :, None] ** 2 <= radius**2)


def _largest_samples(surface: FloatArray, searched: BoolArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Row and column of each largest sample in the search area, and whether it tops its eight neighbors."""
    n, s = surface.shape[0], surface.shape[-1]
    candidates = searched.copy()
    candidates[:, [0, -1], :] = candidates[:, :, [0, -1]] = False  # a paraboloid needs all neighbors
    best = np.where(candidates, surface, -np.inf).reshape(n, -1).argmax(axis=1)
    row, column = (np.clip(index, 1, s - 2) for index in np.divmod(best, s))
    rows = np.arange(n)[:, None, None]
    patch = surface[rows, (row[:, None] + (-1, 0, 1))[:, :, None], (column[:, None] + (-1, 0, 1))[:, None, :]]
    return row, column, (patch.max(axis=(1, 2)) <= patch[:, 1, 1]) & candidates.any(axis=(1, 2))


def _covariance(template: StarTemplate, snr: FloatArray) -> FloatArray:
    """Covariance of a Gaussian's center in even noise, 2 (S + 1/12) / snr^2, and the paraboloid's error."""
    major, minor, angle = template.ellipse
    along = np.array([np.cos(angle), np.sin(angle)])
    spread = minor**2 * np.eye(2) + (major**2 - minor**2) * np.outer(along, along)
    noise = 2.0 * (spread + np.eye(2) / 12.0) / np.maximum(snr, 1.0)[:, None, None] ** 2
    own = min(PARABOLOID_ERROR_PX3 / (major * minor), MAX_PARABOLOID_ERROR_PX)
    return np.asarray(noise + own**2 * np.eye(2))


def _flags(
    boxes: Boxes, center: FloatArray, inside: BoolArray, snr: FloatArray, finite: BoolArray
) -> IntArray:
    core = _in_circle(boxes, center, CORE_PX)
    conditions: dict[StarFlag, BoolArray] = {
        StarFlag.SATURATED: np.any(boxes.saturated & core, axis=(1, 2)),
        StarFlag.EDGE: np.any(boxes.outside, axis=(1, 2)),
        StarFlag.BAD_PIXELS: np.any(boxes.bad & core, axis=(1, 2)),
        StarFlag.LOW_SNR: ~(snr >= MIN_SNR),
        StarFlag.AT_BOUND: ~inside,
        StarFlag.NOT_FINITE: ~finite,
    }
    return combine_flags(conditions, len(center))
