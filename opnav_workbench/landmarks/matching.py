"""A template against the picture: the correlation's peak, then shift, gain and bias by least squares.

What a rendered patch lacks (the terrain between samples, albedo, the law) is no white noise: it is of the patch's own size.
Its autocorrelation is measured in the residuals of patches together; see `opnav_workbench.landmarks.whitening`.

Units  px, DN
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.landmarks.drawing import Templates

__all__ = [
    "PatchFit",
    "PicturePlanes",
    "correlate",
    "correlation_of",
    "fit_patch",
    "law_share",
    "pooled_autocorrelation",
    "slow_columns",
]

LEAST_PIXELS = 60  # of a template that are covered and good
MOST_STEPS, STEP_TOLERANCE_PX = 12, 1e-3
MOST_FIT_SHIFT_PX = 1.5  # from the correlation's peak; farther, the peak was none
LAGS = 12  # px over which residuals are held to be correlated


@dataclass(frozen=True, slots=True, eq=False)
class PicturePlanes:
    """The picture as patches are cut from it: light above the sky, its variance, and which pixels count."""

    signal: FloatArray
    variance: FloatArray
    good: BoolArray

    def window(self, first: IntArray, size: int) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return signal, variance and good pixels (size, size) from (pixel, line) on; off the detector nothing is good."""
        n_line, n_pixel = self.signal.shape
        x0, y0 = int(first[0]), int(first[1])
        x, y = max(x0, 0), max(y0, 0)
        right, bottom = min(x0 + size, n_pixel), min(y0 + size, n_line)
        signal, variance, good = (
            np.zeros((size, size)),
            np.ones((size, size)),
            np.zeros((size, size), dtype=bool),
        )
        if right > x and bottom > y:
            into = (slice(y - y0, bottom - y0), slice(x - x0, right - x0))
            of = (slice(y, bottom), slice(x, right))
            signal[into], variance[into], good[into] = self.signal[of], self.variance[of], self.good[of]
        return signal, variance, good


def correlate(planes: PicturePlanes, templates: Templates, row: int, radius: int) -> FloatArray:
    """Return normalized correlations (2 r + 1, 2 r + 1), [line, pixel], of a template moved by -r .. r px.

    Pixels that are not good, or not the maplet's, are left out; where too few are left the correlation is -1.
    """
    wide = templates.size + 2 * radius
    data, _, good = planes.window(templates.first[row] - radius, wide)
    template = templates.drawn(row, np.zeros(2))
    mask = templates.covered[row].astype(np.float64)
    level = float(data[good].mean()) if good.any() else 0.0
    weight = good.astype(np.float64)
    data = (data - level) * weight
    template = (template - (template * mask).sum() / max(mask.sum(), 1.0)) * mask
    length = fft.next_fast_len(wide, real=True)
    of_data = fft.rfft2(np.stack([data, data * data, weight]), (length, length))
    of_template = np.conj(fft.rfft2(np.stack([template, template * template, mask]), (length, length)))
    pairs = [(0, 0), (0, 2), (1, 2), (2, 0), (2, 1), (2, 2)]
    n = 2 * radius + 1
    dt, d, dd, t, tt, count = (
        fft.irfft2(of_data[a] * of_template[b], (length, length))[:n, :n] for a, b in pairs
    )
    count = np.maximum(count, 1e-9)
    covariance = dt - d * t / count
    variance = np.maximum(dd - d * d / count, 0.0) * np.maximum(tt - t * t / count, 0.0)
    floor = 1e-12 * max(float(variance.max()), 1e-300)
    score = np.where(variance > floor, covariance / np.sqrt(np.maximum(variance, floor)), -1.0)
    return np.where(count >= min(LEAST_PIXELS, 0.5 * mask.sum()), np.clip(score, -1.0, 1.0), -1.0)


@dataclass(frozen=True, slots=True, eq=False)
class PatchFit:
    """A template fitted to the picture.

    Attributes
    ----------
    shift_px : (2,) array
        Of the template as drawn.
    gain
        Picture over template.
    correlation
        Normalized, of data and model at the fit.
    residual, weight : (size, size) arrays
        Data minus model over the sigma of each pixel; weight 0: not used.
    operator : (2, size, size) array
        d(shift) / d(residual).
    noise_covariance_px2 : (2, 2) array
        By the picture's noise alone.
    halves : (k, 2, size, size) array or None
        d(shift of one half of the patch - shift of the other) / d(residual), for k ways to halve it.
    """

    shift_px: FloatArray
    gain: float
    correlation: float
    residual: FloatArray
    weight: FloatArray
    operator: FloatArray
    noise_covariance_px2: FloatArray
    halves: FloatArray | None = None


def fit_patch(planes: PicturePlanes, templates: Templates, row: int, whole: IntArray) -> PatchFit | None:
    """Fit shift, gain, bias and a slope of the bias; None where that does not converge.

    Parameters
    ----------
    whole : (2,) array of int
        Shift of the correlation's peak, whole pixels: the fit looks about it.
    """
    data, variance, good = planes.window(templates.first[row] + whole, templates.size)
    used = good & templates.covered[row]
    if used.sum() < LEAST_PIXELS:
        return None
    sigma = np.sqrt(variance[used])
    slow = (slow_columns(templates.size)[:, used] / sigma).T
    shift, gain = np.zeros(2), 1.0
    measured = data[used] / sigma
    for _ in range(MOST_STEPS):
        template, by_pixel, by_line = (plane[used] / sigma for plane in templates.at(row, shift))
        nuisance = np.column_stack([template, slow])
        light, *_ = np.linalg.lstsq(nuisance, measured, rcond=None)
        gain = float(light[0])
        residual = measured - nuisance @ light
        design = np.concatenate([gain * np.stack([by_pixel, by_line], axis=1), nuisance], axis=1)
        normal = design.T @ design
        scale = np.sqrt(np.diag(normal))
        if not np.all(scale > 0.0):
            return None
        inverse = _inverse(normal / np.outer(scale, scale))
        if inverse is None:
            return None
        inverse /= np.outer(scale, scale)
        operator = inverse[:2] @ design.T
        step = operator @ residual
        shift = shift + np.clip(step, -0.5, 0.5)
        if np.abs(shift).max() > MOST_FIT_SHIFT_PX:
            return None
        if np.abs(step).max() < STEP_TOLERANCE_PX:
            break
    else:
        return None
    model = measured - residual
    correlation = correlation_of(model * sigma, data[used])
    planes_of = [np.zeros(data.shape) for _ in range(4)]
    for plane, values in zip(
        planes_of, (residual, operator[0], operator[1], np.ones(len(sigma))), strict=True
    ):
        plane[used] = values
    return PatchFit(
        shift + whole,
        gain,
        correlation,
        planes_of[0],
        planes_of[3],
        np.stack(planes_of[1:3]),
        inverse[:2, :2],
    )


def slow_columns(size: int) -> FloatArray:
    """Return bias and slope of a window (3, size, size)."""
    y, x = np.mgrid[:size, :size] / size
    return np.stack([np.ones((size, size)), x, y])


def correlation_of(model: FloatArray, data: FloatArray) -> float:
    """Return the normalized correlation of pixels; 0 of an even model."""
    return float(np.corrcoef(model, data)[0, 1]) if np.ptp(model) > 0.0 else 0.0


def _inverse(matrix: FloatArray) -> FloatArray | None:
    try:
        factor = np.linalg.inv(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(factor.T @ factor)


# ---- How the surface shades its slopes, as the picture has it.

SHARES = np.linspace(0.0, 1.0, 21)


def law_share(planes: PicturePlanes, templates: Templates, fits: Sequence[PatchFit | None]) -> float:
    """Return the share of the templates' second law that fits all patches best, each with its own gain, bias and slope."""
    lost = np.zeros(len(SHARES))
    weight = np.stack([1.0 - SHARES, SHARES])
    for row, fit in enumerate(fits):
        if fit is None:
            continue
        whole = np.rint(fit.shift_px).astype(np.int64)
        data, variance, _ = planes.window(templates.first[row] + whole, templates.size)
        used = fit.weight > 0.0
        rows = np.stack([data[used], *templates.by_law(row, fit.shift_px - whole)[:, used]], axis=1)
        slow = slow_columns(templates.size)[:, used].T / np.sqrt(variance[used])[:, None]
        rows = rows / np.sqrt(variance[used])[:, None]
        rows -= slow @ np.linalg.lstsq(slow, rows, rcond=None)[0]
        gram = rows.T @ rows
        own = np.einsum("ks,kl,ls->s", weight, gram[1:, 1:], weight)
        shared = np.maximum(gram[0, 1:] @ weight, 0.0) ** 2 / np.maximum(own, 1e-300)
        lost += np.log(np.maximum(gram[0, 0] - shared, 1e-9 * gram[0, 0])) * used.sum()
    return float(SHARES[np.argmin(lost)])


# ---- What the residuals say of the error.


def pooled_autocorrelation(fits: Sequence[PatchFit]) -> FloatArray:
    """Return the autocorrelation (2 lags + 1, 2 lags + 1) of residuals, each patch by its own variance.

    With few pixels a patch's own fit takes out what is slow; a bias of parts in the number of its pixels.
    """
    product, count = np.zeros((2 * LAGS + 1,) * 2), np.zeros((2 * LAGS + 1,) * 2)
    for fit in fits:
        inside = fit.weight > 0.0
        variance = float(np.mean(fit.residual[inside] ** 2))
        if not variance > 0.0:
            continue
        product += _lagged(fit.residual) / variance
        count += _lagged(fit.weight)
    rho = product / np.maximum(count, 1.0)
    middle = rho[LAGS, LAGS]
    return np.asarray(rho / middle) if middle > 0.0 else np.zeros_like(rho)


def _lagged(plane: FloatArray) -> FloatArray:
    """Return sums of products of a plane with itself, moved by up to `LAGS`."""
    length = fft.next_fast_len(plane.shape[0] + LAGS + 1, real=True)
    spectrum = fft.rfft2(plane, (length, length))
    sums = fft.irfft2(spectrum * np.conj(spectrum), (length, length))
    return np.asarray(np.roll(sums, (LAGS, LAGS), axis=(0, 1))[: 2 * LAGS + 1, : 2 * LAGS + 1])
