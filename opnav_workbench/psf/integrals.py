"""The canonical star image: an elliptical Gaussian integrated over detector pixels.

Flow   center and shape of a star -> here -> its flux in each pixel, with derivatives -> `stars`, `GaussianPsf`
Frame  (pixel, line), integer = pixel center; every pixel is a unit square
Units  px; the integral over the whole plane is 1

With the density g and the edges u, v of a pixel relative to the star's center, the flux in a pixel is

    P = int_v N(v; S_vv) [Phi((u2 - b v) / s) - Phi((u1 - b v) / s)] dv,
    b = S_uv / S_vv,   s^2 = S_uu - b S_uv

which is exact along u (error function) and Gauss-Legendre along v. The derivatives need no quadrature: by Gauss's
theorem and by the heat equation (dg/dS_uu = g_uu / 2, dg/dS_uv = g_uv, dg/dS_vv = g_vv / 2) each is a difference of g,
or of its integral along an edge, between the edges of the pixel; and Stein's identity, (u, v) g = -S grad g, turns the
integral of g_u along an edge u = const into values that are already there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from opnav_workbench.arrays import FloatArray, freeze_arrays, gauss_legendre
from opnav_workbench.errors import CenterfindingError

__all__ = [
    "PixelIntegrals",
    "box_integrals",
    "box_parts",
    "box_values",
    "covariance_from_shape",
    "ellipse_from_shape",
    "pixel_gaussian",
    "shape_from_ellipse",
]

# Gauss-Legendre nodes per pixel that keep the error of P below 1e-9, by the smallest sigma (px) they are good
# for.
NODES_FOR_SIGMA_PX = (
    (1.4, 4), (1.0, 5), (0.65, 6), (0.5, 7), (0.4, 8), (0.3, 9), (0.25, 10), (0.2, 12), (0.15, 14), (0.0, 32)
)  # fmt: skip

SQRT2 = np.sqrt(2.0)
SQRT2PI = np.sqrt(2.0 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class PixelIntegrals:
    """Fraction of a star's flux in each pixel of its box, and derivatives; all (n, lines, pixels)."""

    value: FloatArray
    d_pixel: FloatArray  # with respect to the star's center
    d_line: FloatArray
    d_log_scale: FloatArray
    d_e1: FloatArray
    d_e2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def covariance_from_shape(log_scale: ArrayLike, e1: ArrayLike, e2: ArrayLike) -> FloatArray:
    """Return (S_uu, S_uv, S_vv), px^2, shape (3, ...), of ``exp(2 log_scale) [[1 + e1, e2], [e2, 1 - e1]]``.

    Unlike axes and an angle these parameters have no singular point at a round PSF.
    """
    return np.stack(_covariance(*np.broadcast_arrays(*(np.asarray(x, float) for x in (log_scale, e1, e2)))))


def _covariance(
    log_scale: FloatArray, e1: FloatArray, e2: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    variance = np.exp(2.0 * log_scale)
    return variance * (1.0 + e1), variance * e2, variance * (1.0 - e1)


def ellipse_from_shape(log_scale: ArrayLike, e1: ArrayLike, e2: ArrayLike) -> FloatArray:
    """Return (..., 3): sigma_major_px, sigma_minor_px, angle_rad of the major axis from +pixel toward +line.

    Examples
    --------
    >>> ellipse_from_shape(np.log(2.0), 0.0, 0.6).round(3).tolist()
    [2.53, 1.265, 0.785]
    """
    size, a, b = np.broadcast_arrays(*(np.asarray(x, float) for x in (log_scale, e1, e2)))
    scale, e = np.exp(size), np.hypot(a, b)
    return np.stack([scale * np.sqrt(1.0 + e), scale * np.sqrt(1.0 - e), 0.5 * np.arctan2(b, a)], axis=-1)


def shape_from_ellipse(shape: FloatArray) -> FloatArray:
    """Return (..., 3) log scale, e1, e2 from sigma_major_px, sigma_minor_px, angle_rad."""
    major2, minor2, angle = shape[..., 0] ** 2, shape[..., 1] ** 2, shape[..., 2]
    e = (major2 - minor2) / (major2 + minor2)
    log_scale = 0.5 * np.log(0.5 * (major2 + minor2))
    return np.stack([log_scale, e * np.cos(2.0 * angle), e * np.sin(2.0 * angle)], axis=-1)


def pixel_gaussian(center: ArrayLike, shape: ArrayLike, pixel: ArrayLike, line: ArrayLike) -> PixelIntegrals:
    """Integrate n elliptical Gaussians over m pixels each, anywhere on the detector.

    Parameters
    ----------
    center : (n, 2) array_like
        Star centers (pixel, line).
    shape : (n, 3) array_like
        Log scale, e1, e2 (see `covariance_from_shape`).
    pixel, line : (n, m) or (1, m) array_like
        Centers of the pixels; any position is allowed, not only integers.

    Returns
    -------
    PixelIntegrals
        Arrays of shape (n, m); `value` is accurate to 1e-9 of the total flux for sigma from 0.15 px up.

    Examples
    --------
    >>> star = pixel_gaussian([[3.0, 4.0]], [[np.log(0.5), 0.0, 0.0]], [[3.0]], [[4.0]])
    >>> star.value.round(4).tolist()
    [[0.4661]]
    """
    centers, shapes = np.asarray(center, float), np.asarray(shape, float)
    columns, rows, _ = np.broadcast_arrays(np.asarray(pixel, float), np.asarray(line, float), centers[:, :1])
    n, m = columns.shape
    first = np.stack([columns.ravel(), rows.ravel()], axis=-1)
    boxes = box_integrals(np.repeat(centers, m, axis=0), np.repeat(shapes, m, axis=0), first, 1)
    names = ("value", "d_pixel", "d_line", "d_log_scale", "d_e1", "d_e2")
    return PixelIntegrals(*(getattr(boxes, name).reshape(n, m) for name in names))


def box_integrals(center: FloatArray, shape: FloatArray, first: FloatArray, size: int) -> PixelIntegrals:
    """Integrate n elliptical Gaussians over a square box of pixels each; neighbors share their edges.

    Parameters
    ----------
    center : (n, 2) array
        Star centers (pixel, line).
    shape : (n, 3) array
        Log scale, e1, e2 (see `covariance_from_shape`).
    first : (n, 2) array
        Center (pixel, line) of the first pixel of each box.
    size
        Pixels along each side of the box.

    Returns
    -------
    PixelIntegrals
        Arrays of shape (n, size, size), indexed [star, line, pixel].

    Raises
    ------
    CenterfindingError
        A shape that is no ellipse (|e| >= 1) or not finite.
    """
    return PixelIntegrals(*box_parts(center, shape, first, size))


def box_parts(center: FloatArray, shape: FloatArray, first: FloatArray, size: int) -> tuple[FloatArray, ...]:
    """Return the fields of `box_integrals` in their order, for fits that ask a thousand times."""
    u, v, uu, uv, vv, sigma_minor = _edges_and_covariance(center, shape, first, size)
    value = _values(u, v, uu, uv, vv, _node_count(sigma_minor))

    corner, along_v, along_u = _edge_integrals(u, v, uu, uv, vv)
    g_u = _diff_u(along_v)  # integral of dg/du over the pixel
    g_v = _diff_v(along_u)
    corner_v = _diff_v(corner)
    g_uv = _diff_u(corner_v)
    uu, uv, vv = uu[:, None, None], uv[:, None, None], vv[:, None, None]
    g_uu = -_diff_u(u[:, None, :] * along_v + uv * corner_v) / uu
    g_vv = -_diff_v(v[:, :, None] * along_u + uv * _diff_u(corner)) / vv
    variance = 0.5 * (uu + vv)
    d_log_scale = uu * g_uu + 2.0 * uv * g_uv + vv * g_vv
    return value, -g_u, -g_v, d_log_scale, 0.5 * variance * (g_uu - g_vv), variance * g_uv


def box_values(center: FloatArray, shape: FloatArray, first: FloatArray, size: int) -> FloatArray:
    """Return the `value` of `box_integrals` alone, (n, size, size): several times faster without derivatives.

    Where the axes of every Gaussian run along pixel and line, the integral is a product of error functions.
    """
    u, v, uu, uv, vv, sigma_minor = _edges_and_covariance(center, shape, first, size)
    if np.any(uv != 0.0):
        return _values(u, v, uu, uv, vv, _node_count(sigma_minor))
    along_u = 0.5 * np.diff(erf(u / (SQRT2 * np.sqrt(uu))[:, None]), axis=-1)
    along_v = 0.5 * np.diff(erf(v / (SQRT2 * np.sqrt(vv))[:, None]), axis=-1)
    return np.asarray(along_v[:, :, None] * along_u[:, None, :])


def _edges_and_covariance(
    center: FloatArray, shape: FloatArray, first: FloatArray, size: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Edges u, v (n, size + 1) of the pixels from the centers; S_uu, S_uv, S_vv and the smaller sigma (n,)."""
    log_scale, e1, e2 = np.asarray(shape, float).T
    ellipticity = np.hypot(e1, e2)
    if not (ellipticity < 1.0).all() or not np.isfinite(log_scale).all():
        worst = float(np.max(ellipticity, initial=0.0))
        raise CenterfindingError(
            f"PSF ellipticity must stay below 1 and its scale finite; largest |e| is {worst:.3g}."
        )
    start = np.asarray(first, float) - 0.5 - np.asarray(center, float)
    edges = start[:, :, None] + np.arange(size + 1)
    uu, uv, vv = _covariance(log_scale, e1, e2)
    return edges[:, 0], edges[:, 1], uu, uv, vv, np.exp(log_scale) * np.sqrt(1.0 - ellipticity)


def _node_count(sigma_minor: FloatArray) -> int:
    smallest = float(np.min(sigma_minor, initial=np.inf))
    return next(nodes for sigma, nodes in NODES_FOR_SIGMA_PX if smallest >= sigma)


def _values(
    u: FloatArray, v: FloatArray, uu: FloatArray, uv: FloatArray, vv: FloatArray, nodes: int
) -> FloatArray:
    """Integral over each pixel: error function along u, Gauss-Legendre along v."""
    t, weight = gauss_legendre(nodes)
    at = 0.5 * (v[:, 1:, None] + v[:, :-1, None]) + 0.5 * t  # (n, lines, nodes)
    slope = (uv / vv)[:, None, None]
    scale = SQRT2 * np.sqrt(uu - uv * uv / vv)[:, None, None]
    density = (
        np.exp(-0.5 * at * at / vv[:, None, None]) * (0.25 * weight) / (SQRT2PI * np.sqrt(vv))[:, None, None]
    )
    argument = (u / scale[:, 0])[:, None, None, :] - (slope * at / scale)[..., None]
    cumulative = np.matmul(density[:, :, None, :], erf(argument, out=argument))[:, :, 0, :]
    return _diff_u(cumulative)


def _edge_integrals(
    u: FloatArray, v: FloatArray, uu: FloatArray, uv: FloatArray, vv: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Density at the corners, and its integrals along the vertical and the horizontal edges of the pixels."""
    u, v = u[:, None, :], v[:, :, None]
    uu, uv, vv = uu[:, None, None], uv[:, None, None], vv[:, None, None]
    det = uu * vv - uv * uv
    corner = np.exp(-0.5 * (vv * u * u - 2.0 * uv * u * v + uu * v * v) / det) / (2.0 * np.pi * np.sqrt(det))
    marginal_u = 0.5 * np.exp(-0.5 * u * u / uu) / (SQRT2PI * np.sqrt(uu))
    marginal_v = 0.5 * np.exp(-0.5 * v * v / vv) / (SQRT2PI * np.sqrt(vv))
    along_v = marginal_u * _diff_v(erf((v - (uv / uu) * u) * (np.sqrt(uu / det) / SQRT2)))
    along_u = marginal_v * _diff_u(erf((u - (uv / vv) * v) * (np.sqrt(vv / det) / SQRT2)))
    return corner, along_v, along_u


def _diff_u(values: FloatArray) -> FloatArray:
    return values[:, :, 1:] - values[:, :, :-1]


def _diff_v(values: FloatArray) -> FloatArray:
    return values[:, 1:, :] - values[:, :-1, :]
