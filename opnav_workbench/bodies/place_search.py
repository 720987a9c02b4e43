"""Where a body lies, to a fraction of a pixel: its rendered picture correlated with the data over the whole search area.

At every lag the model, times a brightness, plus a level is fitted to the pixels under it; all sums over pixels are
correlations, done with the FFT. Bad pixels have no weight and edges no pixels. The best lag is where the fit explains
most of what is there, in units of the noise; a paraboloid through the peak and its neighbours refines it.

Reference: Jackman & Dumont (2013), AAS 13-443, "Cross-Correlation Target Centerfinding".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture, model_picture
from opnav_workbench.bodies.subarray import Cutout, cut_out, edge_reach
from opnav_workbench.stars.peaks import refine_peaks

__all__ = ["CorrelationPeak", "brightest_point", "search_place"]

ComplexArray = NDArray[np.complex128]

MIN_INFORMATION = 0.02  # part of the body's light (squared) that must lie on usable pixels


@dataclass(frozen=True, slots=True, eq=False)
class CorrelationPeak:
    """Where a body was found.

    Attributes
    ----------
    center_px : (2,) array
        nan where there are no usable pixels.
    snr
        Of its brightness.
    explained
        Share, 0..1, of what is under the body that the model explains, noise taken out.
    flux_dn
        Light of all of it, as bright as it is found.
    """

    center_px: FloatArray
    snr: float
    explained: float
    flux_dn: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


NOWHERE = CorrelationPeak(np.full(2, np.nan), 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Template:
    light: FloatArray  # (t_line, t_pixel)
    center: FloatArray  # (2,) of the body in it, (pixel, line), first pixel 0


def search_place(
    picture: BodyPicture,
    name: str,
    center_px: FloatArray,
    radius_px: float,
    search_px: float,
    *,
    range_scale: float = 1.0,
) -> CorrelationPeak:
    """Search for a body within `search_px` of a place.

    Parameters
    ----------
    center_px : (2,) array
        Expected center of figure.
    radius_px
        Of the circle that holds its outline.
    range_scale
        Range over the a priori one.
    """
    reach = radius_px + edge_reach(picture)
    window = _clipped(picture, center_px, search_px + reach)
    if min(window[2:]) < 3:
        return NOWHERE
    data = cut_out(picture, window, keep_saturated=True)
    template = _template(picture, name, center_px, reach, range_scale)
    return _highest_peak(data, template, center_px, search_px) if data.use.any() else NOWHERE


def brightest_point(picture: BodyPicture, center_px: FloatArray, search_px: float) -> CorrelationPeak:
    """Search for a point of light, as a star is, within `search_px` of a place (2,)."""
    kernel = picture.psf.at(center_px).kernel(1)
    half = len(kernel) // 2
    data = cut_out(picture, _clipped(picture, center_px, search_px + half), keep_saturated=True)
    if min(data.window[2:]) < 1 or not data.use.any():
        return NOWHERE
    return _highest_peak(data, _Template(kernel, np.full(2, float(half))), center_px, search_px)


def _clipped(picture: BodyPicture, center: FloatArray, half: float) -> tuple[int, int, int, int]:
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    first = np.clip(np.floor(center - half), 0, size).astype(int)
    last = np.clip(np.ceil(center + half), -1, size - 1).astype(int)
    n_pixel, n_line = (int(n) for n in np.maximum(last - first + 1, 0))
    return int(first[0]), int(first[1]), n_pixel, n_line


def _template(
    picture: BodyPicture, name: str, center: FloatArray, reach: float, range_scale: float
) -> _Template:
    """Render the body alone, moved onto the detector as far as it goes there, so that all of it is seen."""
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low = np.minimum(reach, 0.5 * (size - 1))
    place = np.clip(center, low, size - 1 - low)
    window = _clipped(picture, place, reach)
    light = model_picture(picture, window, {name: place}, range_scale=range_scale, only=(name,))
    return _Template(light, place - np.array(window[:2]))


def _highest_peak(
    data: Cutout, template: _Template, expected: FloatArray, search_px: float
) -> CorrelationPeak:
    weight, light = data.weight(), template.light
    # The sample at lag k has the template's first pixel at pixel k of the data.
    origin = np.array(data.window[:2]) + template.center
    lags = _LagCorrelator(weight.shape, light.shape, expected - origin, max(search_px, 0.75))
    weighted, squared = weight * data.data_dn, weight * data.data_dn**2
    box, model, power = (lags.template(plane) for plane in (np.ones_like(light), light, light**2))
    usable = lags.spectrum((weight > 0.0).astype(float))
    of_w, of_wd, of_wdd = (lags.spectrum(plane) for plane in (weight, weighted, squared))
    w, wd, wdd = (lags.correlate(plane, box) for plane in (of_w, of_wd, of_wdd))
    wm, wmm, wdm = lags.correlate(of_w, model), lags.correlate(of_w, power), lags.correlate(of_wd, model)
    usual = float(np.median(weight[weight > 0.0]))
    whole = usual * float(np.sum(light**2))  # what all of the body on usable pixels gives
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(w > 1e-9 * usual * light.size, 1.0 / w, 0.0)
        information = wmm - wm**2 * mean
        signal = wdm - wd * wm * mean
        good = (wmm > MIN_INFORMATION * whole) & (information > 1e-9 * whole)
        scale = np.where(good, signal / np.where(good, information, 1.0), 0.0)
    snr = scale * np.sqrt(np.maximum(information, 0.0))
    variation = wdd - wd**2 * mean
    count = lags.correlate(usable, box)
    gain = np.maximum(snr, 0.0) ** 2
    explained = gain / np.maximum(np.maximum(variation - count, gain), 1e-300)
    grid = np.stack(np.meshgrid(lags.pixel, lags.line)) + origin[:, None, None]
    near = np.hypot(*(grid - expected[:, None, None])) <= max(search_px, 0.75)
    flux = scale * float(light.sum())
    return _refined_peak(snr * explained, near & good, grid, (snr, explained, flux))


def _refined_peak(
    surface: FloatArray,
    searched: BoolArray,
    grid: FloatArray,
    maps: tuple[FloatArray, ...],
) -> CorrelationPeak:
    if not searched.any():
        return NOWHERE
    row, column = np.unravel_index(np.where(searched, surface, -np.inf).argmax(), surface.shape)
    inner = 0 < row < surface.shape[0] - 1 and 0 < column < surface.shape[1] - 1
    center = grid[:, row, column]
    if inner:
        patch = surface[row - 1 : row + 2, column - 1 : column + 2]
        if not patch.max() > patch[1, 1]:
            offset, _ = refine_peaks(surface[None], np.array([row]), np.array([column]))
            center = center + offset[0]
    return CorrelationPeak(center, *(float(plane[row, column]) for plane in maps))


ROUND_LAG = 1  # beside those that are searched, for the paraboloid


class _LagCorrelator:
    """Correlations of planes with templates over the lags within `reach` of one, (pixel, line), at which they overlap.

    What a lag that is asked for does not see is cut off the template, and transforms are no longer than those lags need.
    """

    def __init__(
        self, plane: tuple[int, ...], template: tuple[int, ...], about: FloatArray, reach: float
    ) -> None:
        lags = []
        for p, t, middle in zip(plane, template, about[::-1], strict=True):
            first, last = np.clip([middle - reach - ROUND_LAG, middle + reach + ROUND_LAG], 1 - t, p - 1)
            lags.append(np.arange(int(np.ceil(first)), int(np.floor(last)) + 1))
        self.line, self.pixel = lags
        self._seen = tuple(
            slice(max(0, -k[-1]), min(t, p - k[0])) for k, p, t in zip(lags, plane, template, strict=True)
        )
        self._length = [fft.next_fast_len(p + len(k), real=True) for k, p in zip(lags, plane, strict=True)]

    def spectrum(self, plane: FloatArray) -> ComplexArray:
        """Return the transform of a plane, padded."""
        return np.asarray(fft.rfft2(plane, self._length))

    def template(self, light: FloatArray) -> ComplexArray:
        """Return the transform of what is seen of a template, padded."""
        seen = light[self._seen]
        padded = np.zeros(self._length)
        line, pixel = (np.arange(n) + part.start for n, part in zip(seen.shape, self._seen, strict=True))
        padded[np.ix_(line % self._length[0], pixel % self._length[1])] = seen
        return self.spectrum(padded)

    def correlate(self, plane: ComplexArray, template: ComplexArray) -> FloatArray:
        """Return sums over x of plane(x + lag) template(x), [line lag, pixel lag], from their transforms."""
        out = fft.irfft2(plane * np.conj(template), self._length)
        line, pixel = (k % n for k, n in zip((self.line, self.pixel), self._length, strict=True))
        return np.asarray(out[line[:, None], pixel[None, :]])
