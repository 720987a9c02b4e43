"""What the residuals of a full-disk fit say of a center beyond the noise: a pattern that the model lacks.

Pattern  Albedo features leave residuals that many neighbouring pixels share. Scaling a covariance by reduced chi-squared
         counts each of those pixels as a witness of its own, and makes sigma too small by about the square root of the
         pixels in a feature. Here the data are the model's light times (1 + a): a is a random field with an exponential
         correlation (patterns have features of many sizes), of the variance and the length that the residuals show. The
         fit is linear in it, so that its error has the covariance

             cov = s^2 G R G^T,    G = (J^T W J)^-1 J^T W m,    R_ij = exp(-|x_i - x_j| / l)

         with the products by R done with the FFT. The fit absorbs part of the pattern (a dark half looks like a shift);
         that part is missing in the residuals, which therefore show too small a length and too small a variance; both
         are raised. What this cannot see: features as large as the body itself, which a shift imitates altogether. Over
         random maps of Pluto's contrast sigma is right to a factor of 1.7: too large for small features near full
         phase, too small for large ones on a half disk.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric

__all__ = ["ResidualPattern", "find_residual_pattern", "surface_excess"]


LIT_SHARE = 0.1  # of the peak: pixels that show a surface, not its blurred edge
MIN_PIXELS = 12
SIGNIFICANT = 4.0  # sigmas of chi-squared
SHORTEST_PX = 0.5  # of what differs from pixel to pixel
HALF = float(np.log(2.0))  # lengths at which an exponential correlation has fallen to one half
REACH = 4.0  # lengths: correlation 0.02
UNABSORBED = 1.4  # length of a pattern over that of its residuals, from mottled maps
MOST_ABSORBED = 0.8  # share of a pattern that a fit may absorb before its residuals say nothing


@dataclass(frozen=True, slots=True, eq=False)
class ResidualPattern:
    """A pattern on a body that its model lacks, and what it does to a fit.

    Attributes
    ----------
    relative_sigma
        Contrast over the model's light; 0 where the residuals are those of the noise.
    length_px
        Length of its exponential correlation.
    covariance : (q, q) array
        Of the q quantities that the gain is of.
    chi2_reduced
        Over the pixels that show the body's surface.
    """

    relative_sigma: float
    length_px: float
    covariance: FloatArray
    chi2_reduced: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


class SurfaceExcess(NamedTuple):
    """Pixels that show a body's surface; chi-squared beyond that of noise there, whether that is much, and a pixel."""

    lit: BoolArray
    excess: float
    significant: bool
    chi2_reduced: float


def surface_excess(residual_dn: FloatArray, weight: FloatArray, light_dn: FloatArray) -> SurfaceExcess:
    """Return what residuals on a body leave unexplained; parameters as of `find_residual_pattern`."""
    lit = (light_dn > LIT_SHARE * light_dn.max(initial=0.0)) & (weight > 0.0)
    count, chi2 = int(lit.sum()), float(np.sum((weight * residual_dn**2)[lit]))
    significant = count >= MIN_PIXELS and chi2 - count >= SIGNIFICANT * np.sqrt(2.0 * count)
    return SurfaceExcess(lit, chi2 - count, bool(significant), chi2 / count if count else np.nan)


def find_residual_pattern(
    residual_dn: FloatArray,
    weight: FloatArray,
    light_dn: FloatArray,
    columns: FloatArray,
    gain: FloatArray,
) -> ResidualPattern:
    """Find the pattern on a body from the residuals of a fit, and its effect.

    Parameters
    ----------
    residual_dn, weight : (n_line, n_pixel) arrays
        Data minus model; 1 / variance, 0 for pixels that are not used.
    light_dn : (n_line, n_pixel) array
        The body's light at the solution.
    columns : (p, n_line, n_pixel) array
        Derivatives with respect to what was fitted.
    gain : (q, n_line, n_pixel) array
        Change of each quantity of interest per DN in each pixel.
    """
    q, (lit, excess, significant, reduced) = len(gain), surface_excess(residual_dn, weight, light_dn)
    if not significant:
        return ResidualPattern(0.0, 0.0, np.zeros((q, q)), reduced)
    part = _bounds(light_dn > 0.0)
    shown, inside = (light_dn * lit)[part], weight[part]
    power = float(np.sum(inside * shown**2))
    length = _correlation_length(residual_dn[part], inside, shown, excess / power)
    normal = symmetric(np.einsum("plm,lm,qlm->pq", columns, weight, columns, optimize=True))
    shares = _joined(columns[(slice(None), *part)] * (inside * shown), length)
    absorbed = float(np.trace(np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ shares))
    variance = excess / max(power - absorbed, (1.0 - MOST_ABSORBED) * power)
    effect = _joined(gain[(slice(None), *part)] * light_dn[part], length)
    return ResidualPattern(float(np.sqrt(variance)), length, variance * effect, reduced)


def _bounds(mask: BoolArray) -> tuple[slice, slice]:
    lines, pixels = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(lines[0], lines[-1] + 1), slice(pixels[0], pixels[-1] + 1)


def _correlation_length(
    residual: FloatArray, weight: FloatArray, light: FloatArray, variance: float
) -> float:
    """Return the length at which the autocovariance of residual over light falls to half its variance, as a length."""
    good = [fft.next_fast_len(2 * n, real=True) for n in light.shape]

    def autocorrelation(plane: FloatArray) -> FloatArray:
        spectrum = fft.rfft2(plane, good)
        return np.asarray(fft.irfft2(np.abs(spectrum) ** 2, good))

    field, pairs = autocorrelation(weight * light * residual), autocorrelation(weight * light**2)
    distance = np.hypot(*np.meshgrid(*(fft.fftfreq(n, 1.0 / n) for n in good), indexing="ij"))
    farthest = max(light.shape) // 2
    near = (distance < farthest) & (pairs > 1e-6 * pairs.max())
    ring = np.rint(distance[near]).astype(np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.bincount(ring, field[near]) / np.bincount(ring, pairs[near])
    mean[0] = variance  # without the noise of the pixels
    below = np.flatnonzero(np.nan_to_num(mean) < 0.5 * variance)
    if not len(below):
        return float(UNABSORBED * farthest / HALF)
    end = int(below[0])
    over, under = float(mean[end - 1]), float(np.nan_to_num(mean[end]))
    half = end - 1 + (over - 0.5 * variance) / max(over - under, 1e-300)
    return float(max(UNABSORBED * half / HALF, SHORTEST_PX))


def _joined(images: FloatArray, length: float) -> FloatArray:
    """Return products (q, q) of images with each other through the exponential correlation."""
    pad = int(np.ceil(REACH * length))
    good = [fft.next_fast_len(n + pad, real=True) for n in images.shape[1:]]
    spectra = fft.rfft2(images, good)
    down, along = (np.minimum(np.arange(n), n - np.arange(n)) for n in good)
    kernel = fft.rfft2(np.exp(-np.hypot(down[:, None], along) / length)).real
    double = np.full(spectra.shape[-1], 2.0)  # the half of the spectrum that rfft2 leaves out
    double[0] = 1.0
    if good[1] % 2 == 0:
        double[-1] = 1.0
    weighted = spectra * np.maximum(kernel, 0.0) * double
    return symmetric(np.einsum("plm,qlm->pq", np.conj(spectra), weighted, optimize=True).real / np.prod(good))
