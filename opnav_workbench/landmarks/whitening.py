"""Patches fitted under the errors that a drawn surface has: generalized least squares.

What a template lacks (terrain between samples, albedo that no map has, the law) is as wide as the terrain itself, and far
larger than the picture's noise. Its autocorrelation is measured in the residuals of all patches together. With C made of
it, and A what shift, gain, bias and slope do,

    step = (X' A)^-1 X' r,   X = C^-1 A

Fine detail, of which such errors have little, then counts for more. Whatever X is, the step is without bias: a few steps
of conjugate gradients do, and the covariance is that of the operator as it is.

Units  px, DN
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.special import digamma, polygamma

from opnav_workbench.arrays import BoolArray, FloatArray, symmetric
from opnav_workbench.landmarks.drawing import Templates
from opnav_workbench.landmarks.matching import (
    LAGS,
    MOST_FIT_SHIFT_PX,
    STEP_TOLERANCE_PX,
    PatchFit,
    PicturePlanes,
    correlation_of,
    pooled_autocorrelation,
    slow_columns,
)

__all__ = ["fitted_white", "shift_covariances"]

GROUP = 40  # patches that share an autocorrelation: of 40,000 pixels
AT_ONCE = 32  # patches: their planes stay in the cache
GRADIENT_STEPS = 6  # preconditioned by the inverse of the spectrum: what is left are the edges
DESIGNS, DESIGN_TOLERANCE_PX = 5, 0.01
MOST_STEPS = 8  # of the fit, about the design of its start
SURROUNDINGS_PX, LEAST_NEAR = 2.0, 0.05
AROUND = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # px
# Patches that tell how they differ; fewer: as patches of an exam do, in counts
FEWEST_TOLD, FEW_WORTH = 10, 8.0
MOST_WORTH = 200.0  # counts of what all patches have in common: more change nothing
LEAST_SQUARE = np.float32(1e-30)  # of planes without any light
FLOOR = (
    0.02  # of the mean of the spectrum: white noise, and what an autocorrelation of few pixels does not know
)


AnyFloats = NDArray[np.floating[Any]]


class Whitening:
    """Errors of unit variance with a stationary autocorrelation, in windows of one size."""

    def __init__(self, rho: FloatArray, size: int) -> None:
        length = fft.next_fast_len(size + LAGS, real=True)
        taper = np.hanning(2 * LAGS + 3)[1:-1]
        kernel = np.zeros((length, length))
        kernel[: 2 * LAGS + 1, : 2 * LAGS + 1] = rho * np.outer(taper, taper)
        spectrum = fft.rfft2(np.roll(kernel, (-LAGS, -LAGS), axis=(0, 1))).real
        self.size, self.length = size, length
        self.spectrum = np.maximum(spectrum, FLOOR)

    @classmethod
    def of(cls, fits: Sequence[PatchFit | None]) -> "Whitening":
        """Return that of the residuals of some fits."""
        measured = [fit for fit in fits if fit is not None]
        return cls(pooled_autocorrelation(measured), len(measured[0].residual))

    def spread(self, planes: FloatArray) -> FloatArray:
        """Return C times planes (..., size, size)."""
        return np.asarray(self._through(planes, self.spectrum))

    def solved(self, planes: FloatArray, used: BoolArray) -> FloatArray:
        """Return C^-1 times planes (n, k, size, size), of the pixels in use (n, size, size), by conjugate gradients.

        In single precision: a few steps are far from exact anyway, and whatever comes out is as good a weight.
        """
        mask = used[:, None].astype(np.float32)
        left = planes.astype(np.float32) * mask
        spectrum = self.spectrum.astype(np.float32)
        inverse = np.float32(1.0) / spectrum
        x = np.zeros_like(left)
        z = mask * self._through(left, inverse)
        way, square = z, _dot(left, z)
        for _ in range(GRADIENT_STEPS):
            spread = mask * self._through(way, spectrum)
            length = square / np.maximum(_dot(way, spread), LEAST_SQUARE)
            x += length * way
            left = left - length * spread
            z = mask * self._through(left, inverse)
            before, square = square, _dot(left, z)
            way = z + square / np.maximum(before, LEAST_SQUARE) * way
        return np.asarray(x, dtype=np.float64)

    def _through(self, planes: AnyFloats, spectrum: AnyFloats) -> Any:
        """Return planes (..., size, size) with their spectrum multiplied, in the precision that they have."""
        full = (self.length, self.length)
        out = fft.irfft2(fft.rfft2(planes, full) * spectrum, full)
        return out[..., : self.size, : self.size]


def _dot(a: AnyFloats, b: AnyFloats) -> Any:
    return np.asarray(np.einsum("nkyx,nkyx->nk", a, b)[..., None, None])


def by_grain(fits: Sequence[PatchFit | None]) -> list[list[int]]:
    """Return rows of fits in groups of about `GROUP`, by how much neighboring residuals are alike.

    Patches seen obliquely, coarse or noisy have a finer grain than others: one autocorrelation for all would state too
    much for these and too little for those.
    """
    rows = [row for row, fit in enumerate(fits) if fit is not None]
    alike = [_neighbors_alike(fit) for fit in fits if fit is not None]
    order = [rows[k] for k in np.argsort(alike, kind="stable")]
    count = max(1, len(rows) // GROUP)
    return [part.tolist() for part in np.array_split(np.array(order, dtype=np.int64), count) if len(part)]


def _neighbors_alike(fit: PatchFit) -> float:
    plane, inside = fit.residual, fit.weight > 0.0
    products = (plane[:, 1:] * plane[:, :-1]).sum() + (plane[1:] * plane[:-1]).sum()
    count = (inside[:, 1:] & inside[:, :-1]).sum() + (inside[1:] & inside[:-1]).sum()
    square = float(np.mean(plane[inside] ** 2))
    return float(products / max(count, 1)) / square if square > 0.0 else 0.0


def _beyond_noise(fit: PatchFit, variance: FloatArray) -> FloatArray:
    """Return the variance (size, size) of residuals beyond the noise: half of the patch, half of their surroundings.

    Edges of shadows lie elsewhere on the true terrain, and are far worse than what lies between them.
    """
    inside = fit.weight > 0.0
    square = fit.residual**2 * variance
    near = ndimage.gaussian_filter(square, SURROUNDINGS_PX)
    near /= np.maximum(ndimage.gaussian_filter(fit.weight, SURROUNDINGS_PX), LEAST_NEAR)
    return np.asarray(np.maximum(0.5 * (float(square[inside].mean()) + near) - variance, 0.0))


def fitted_white(
    planes: PicturePlanes, templates: Templates, fits: Sequence[PatchFit | None]
) -> list[PatchFit | None]:
    """Return the fits of patches again, under errors as their residuals have them; None where that leads away.

    Parameters
    ----------
    fits
        By row of the templates: where each begins.
    """
    out: list[PatchFit | None] = [None] * len(fits)
    for group in by_grain(fits):
        white = Whitening.of([fits[row] for row in group])
        for begin in range(0, len(group), AT_ONCE):
            part = group[begin : begin + AT_ONCE]
            for row, fit in zip(part, _fitted_part(planes, templates, part, fits, white), strict=True):
                out[row] = fit
    return out


def _fitted_part(
    planes: PicturePlanes,
    templates: Templates,
    rows: Sequence[int],
    fits: Sequence[PatchFit | None],
    white: Whitening,
) -> list[PatchFit | None]:
    """Return the fits of some rows, with weights made anew where the last fit led: those of the start pull toward it."""
    patches = [_Patch(planes, templates, row, fits[row]) for row in rows]  # type: ignore[arg-type]
    out: list[PatchFit | None] = [None] * len(rows)
    open_, last = list(range(len(rows))), dict[int, tuple[FloatArray, FloatArray]]()
    for _ in range(DESIGNS):
        designs = np.array([patches[k].design() for k in open_])
        weighed = white.solved(designs, np.array([patches[k].used for k in open_]))
        last |= {k: (design, by_weight) for k, design, by_weight in zip(open_, designs, weighed, strict=True)}
        for k in open_:
            out[k] = patches[k].fitted(*last[k])
        open_ = [k for k in open_ if out[k] is not None and patches[k].moved_px > DESIGN_TOLERANCE_PX]
        if not open_:
            break
    return [
        None if fit is None else replace(fit, halves=patches[k].halves(*last[k])) for k, fit in enumerate(out)
    ]


class _Patch:
    """A patch with the scatter of its first fit as the size of its errors, beside the picture's noise."""

    def __init__(self, planes: PicturePlanes, templates: Templates, row: int, first: PatchFit) -> None:
        self.templates, self.row = templates, row
        self.whole = np.rint(first.shift_px).astype(np.int64)
        self.shift = first.shift_px - self.whole
        data, self.variance, good = planes.window(templates.first[row] + self.whole, templates.size)
        self.used = good & templates.covered[row]
        self.sigma = np.sqrt(self.variance + _beyond_noise(first, self.variance))
        self.data = np.where(self.used, data / self.sigma, 0.0)
        self.gain, self.moved_px = first.gain, np.inf
        self.slow = slow_columns(templates.size) / self.sigma

    def light(self, shift: FloatArray) -> FloatArray:
        """Return what gain, bias and slope do (4, size, size)."""
        template = self.templates.drawn(self.row, shift) / self.sigma
        return np.concatenate([template[None], self.slow])

    def design(self) -> FloatArray:
        """Return what shift, light and a wider PSF do (7, size, size), where the fit is."""
        template, by_pixel, by_line = self.templates.at(self.row, self.shift)
        around = sum(self.templates.drawn(self.row, self.shift + step) for step in AROUND)
        moved = np.stack([self.gain * by_pixel, self.gain * by_line]) / self.sigma
        light, wider = template / self.sigma, (around - len(AROUND) * template) / self.sigma
        return np.where(self.used, np.concatenate([moved, light[None], self.slow, wider[None]]), 0.0)

    def fitted(self, design: FloatArray, by_weight: FloatArray) -> PatchFit | None:
        """Return the fit with the operator of one design; where it ends the next begins."""
        flat, weights = design.reshape(len(design), -1), by_weight.reshape(len(design), -1)
        normal = weights @ flat.T
        try:
            operator = np.linalg.inv(normal[:-1, :-1]) @ weights[:-1]
            width = (np.linalg.inv(normal)[-1] @ weights).reshape(design.shape[1:])
        except np.linalg.LinAlgError:
            return None
        shift, light = self.shift.copy(), np.zeros(len(self.slow) + 1)
        for _ in range(MOST_STEPS):
            residual = self.data - np.tensordot(light, self.light(shift) * self.used, axes=1)
            step = operator @ residual.ravel()
            shift, light = shift + np.clip(step[:2], -0.5, 0.5), light + step[2:]
            if np.abs(shift).max() > MOST_FIT_SHIFT_PX:
                return None
            if np.abs(step[:2]).max() < STEP_TOLERANCE_PX:
                self.moved_px = float(np.abs(shift - self.shift).max())
                self.shift, self.gain = shift, float(light[0])
                return self._result(shift, light, operator[:2], width, design[-1])
        return None

    def halves(self, design: FloatArray, by_weight: FloatArray) -> FloatArray:
        """Return what differences of the shifts of a patch's halves are made of (k, 2, size, size)."""
        out = []
        for inside in _halved(self.used):
            parts = [_operator(design[:-1], by_weight[:-1] * half) for half in (inside, self.used & ~inside)]
            if parts[0] is not None and parts[1] is not None:
                out.append(parts[0] - parts[1])
        return np.array(out).reshape(-1, 2, *self.used.shape)

    def _result(
        self, shift: FloatArray, light: FloatArray, operator: FloatArray, width: FloatArray, wider: FloatArray
    ) -> PatchFit:
        model = np.tensordot(light, self.light(shift), axes=1)
        residual = np.where(self.used, self.data - model, 0.0)
        # Detail that is too soft or too sharp everywhere moves nothing, so it is no error of the shift.
        residual = residual - float(np.sum(width * residual)) * wider
        by_noise = operator * (np.where(self.used, self.variance, 0.0) / self.sigma**2).ravel()
        inside = self.used
        return PatchFit(
            shift + self.whole,
            float(light[0]),
            correlation_of((model * self.sigma)[inside], (self.data * self.sigma)[inside]),
            residual,
            inside.astype(np.float64),
            operator.reshape(2, *inside.shape),
            by_noise @ operator.T,
        )


def _operator(design: FloatArray, by_weight: FloatArray) -> FloatArray | None:
    """Return the planes (2, size, size) that read a shift off residuals; None where the pixels do not tell it."""
    weights = by_weight.reshape(len(by_weight), -1)
    normal = weights @ design.reshape(len(design), -1).T
    try:
        return np.asarray(np.linalg.inv(normal)[:2] @ weights).reshape(2, *design.shape[1:])
    except np.linalg.LinAlgError:
        return None


def _halved(used: BoolArray) -> list[BoolArray]:
    """Return the pixels in use on one side of their middle, along lines and along pixels."""
    out = []
    for axis in (0, 1):
        count = np.cumsum(used.sum(axis=1 - axis))
        edge = int(np.searchsorted(count, 0.5 * count[-1]))
        side = np.arange(len(count)) <= edge
        out.append(used & (side[:, None] if axis == 0 else side[None, :]))
    return out


def shift_covariances(fits: Sequence[PatchFit | None]) -> FloatArray:
    """Return covariances (n, 2, 2) px^2 of shifts under correlated residuals, at least by the noise; nan without a fit."""
    out = np.full((len(fits), 2, 2), np.nan)
    rows: list[int] = []
    apart: list[FloatArray] = []
    for group in by_grain(fits):
        these = [fit for fit in (fits[row] for row in group) if fit is not None]
        white = Whitening.of(these)
        out[group] = [_carried(fit, fit.operator, white) for fit in these]
        apart += [_disagreement(fit, white) for fit in these]
        rows += group
    for row, scale in zip(rows, _scales(apart), strict=True):
        fit = fits[row]
        assert fit is not None
        out[row] = _larger(scale * out[row], fit.noise_covariance_px2)
    return out


def _carried(fit: PatchFit, planes: FloatArray, white: Whitening) -> FloatArray:
    """Return the covariance (2, 2) of what planes (2, size, size) read off a patch's residuals."""
    freedom = max(int((fit.weight > 0.0).sum()) - 6, 1)
    variance = float(np.sum(fit.residual**2)) / freedom
    return symmetric(variance * np.einsum("iyx,jyx->ij", planes, white.spread(planes)))


def _disagreement(fit: PatchFit, white: Whitening) -> FloatArray:
    """Return squares, each of two degrees of freedom, of how far a patch's halves are from one another."""
    out = []
    for planes in () if fit.halves is None else fit.halves:
        apart = np.einsum("iyx,yx->i", planes, fit.residual)
        out.append(float(apart @ np.linalg.pinv(_carried(fit, planes, white), hermitian=True) @ apart))
    return np.array(out)


def _scales(apart: Sequence[FloatArray]) -> FloatArray:
    """Return factors of the covariances (n,), by what the halves of all patches say, and those of each.

    Covariances are made of what errors are in the mean of many patches; where an edge of a shadow or a pattern that no map
    has lies in one, its halves tell. Variances of patches are drawn from a scaled inverse chi-squared distribution whose
    size and width come from the moments of the logarithms (Smyth 2004, doi:10.2202/1544-6115.1027, section 6.2).
    """
    freedom = np.array([2.0 * len(one) for one in apart])
    ratio = np.array([one.mean() / 2.0 if len(one) else 1.0 for one in apart])
    told = (freedom > 0.0) & (ratio > 0.0)
    typical, worth = 1.0, FEW_WORTH
    if told.sum() >= FEWEST_TOLD:
        half = 0.5 * freedom[told]
        log = np.log(ratio[told]) - digamma(half) + np.log(half)
        spread = float(np.var(log, ddof=1) - np.mean(polygamma(1, half)))
        worth = 2.0 * _inverse_trigamma(max(spread, polygamma(1, 0.5 * MOST_WORTH)))
        typical = float(np.exp(log.mean() + digamma(0.5 * worth) - np.log(0.5 * worth)))
    # The mean of the variance, not its most probable value: errors over sigmas then have unit variance.
    return np.asarray((worth * typical + freedom * ratio) / np.maximum(worth + freedom - 2.0, 1.0))


def _inverse_trigamma(value: float) -> float:
    """Return x with trigamma(x) = value, by Newton's steps on 1 / trigamma, which is nearly a line."""
    x = 0.5 + 1.0 / value
    for _ in range(50):
        now = float(polygamma(1, x))
        step = now * (1.0 - now / value) / float(polygamma(2, x))
        x += step
        if -step < 1e-8 * x:
            break
    return x


def _larger(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a covariance that is nowhere below either of two."""
    value, axes = np.linalg.eigh(a - b)
    return np.asarray(b + (axes * np.maximum(value, 0.0)) @ axes.T)
