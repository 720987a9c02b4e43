"""Sub-pixel peak of a sampled surface: a least-squares paraboloid through 3 x 3 samples about the largest."""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["paraboloid_coefficients", "refine_peaks"]

RIDGE = 1e-6  # a curvature this small against the other one is rounding
MAX_OFFSET_PX = 1.0  # the top of a true peak lies within its 3 x 3 samples


def _paraboloid_solver() -> FloatArray:
    """Pseudo-inverse (6, 9) for c0 + cx x + cy y + cxx x^2 + cyy y^2 + cxy x y, samples line by line."""
    y, x = np.indices((3, 3)).reshape(2, -1) - 1.0
    return np.linalg.pinv(np.column_stack([np.ones(9), x, y, x * x, y * y, x * y]))


SOLVER = _paraboloid_solver()


def refine_peaks(surface: FloatArray, row: IntArray, column: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return offset (n, 2) (pixel, line) of each peak from its largest sample, and its Hessian (n, 2, 2).

    Parameters
    ----------
    surface : (n, h, w) array
        One surface per peak.
    row, column : (n,) int array
        Largest sample of each; not on the rim of the surface.

    Notes
    -----
    Where the paraboloid has no maximum (a ridge, a saddle) the offset is 0; offsets stay within one pixel.

    Examples
    --------
    >>> y, x = np.indices((5, 5))
    >>> offset, _ = refine_peaks(-((x - 2.2) ** 2) - (y - 1.9)[None] ** 2, np.array([2]), np.array([2]))
    >>> offset.round(6).tolist()
    [[0.2, -0.1]]
    """
    n = np.arange(len(row))[:, None, None]
    patch = surface[n, (row[:, None] + (-1, 0, 1))[:, :, None], (column[:, None] + (-1, 0, 1))[:, None, :]]
    return paraboloid_peak(patch)


def paraboloid_coefficients(patch: FloatArray) -> FloatArray:
    """Return (n, 6) for c0 + cx x + cy y + cxx x^2 + cyy y^2 + cxy x y, x and y from the middle of (n, 3, 3) samples."""
    return np.asarray((SOLVER @ patch.reshape(len(patch), 9).T).T)


def paraboloid_peak(patch: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return offset (n, 2) and Hessian (n, 2, 2) of paraboloids through (n, 3, 3) samples."""
    _, cx, cy, cxx, cyy, cxy = paraboloid_coefficients(patch).T
    hessian = np.stack([2.0 * cxx, cxy, cxy, 2.0 * cyy], axis=-1).reshape(-1, 2, 2)
    det = 4.0 * cxx * cyy - cxy**2
    peaked = (cxx < 0.0) & (cyy < 0.0) & (det > RIDGE * (cxx**2 + cyy**2))
    det = np.where(peaked, det, 1.0)
    offset = np.stack([cxy * cy - 2.0 * cyy * cx, cxy * cx - 2.0 * cxx * cy], axis=-1) / det[:, None]
    return np.clip(np.where(peaked[:, None], offset, 0.0), -MAX_OFFSET_PX, MAX_OFFSET_PX), hessian
