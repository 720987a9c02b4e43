"""Least squares of an arrow: shared parameters, and three angles a frame that touch nothing else.

The frames' angles are eliminated (Schur complement), which leaves a small dense system for the shared parameters;
directions in it that the rows leave open are not moved along.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import splu

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.calibration.design import Design

__all__ = ["OPEN_PX", "ArrowSolution", "solve_arrow"]

# A combination of parameters whose 1 sigma moves stars by more than this, before the frames' angles take it up, is not
# determined: a camera of which a drawing exists is known better.
OPEN_PX = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class ArrowSolution:
    """One linear solution.

    Attributes
    ----------
    shared : (q,) array
        Step of the shared parameters, none along open directions.
    angles : (m, 3) array
        Steps of the frames' attitudes.
    covariance : (q, q) array
        Of the shared parameters, open directions left out.
    open_directions : (k, q) array
        Combinations that are not determined: unit vectors, in units of one pixel's effect of each parameter.
    """

    shared: FloatArray
    angles: FloatArray
    covariance: FloatArray
    open_directions: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def solve_arrow(design: Design) -> ArrowSolution:
    """Solve the normal equations; see the module."""
    q = len(design.effect_px)
    normal = (design.matrix.T @ design.matrix).tocsc()
    right = design.matrix.T @ design.residual
    frames = splu(normal[q:, q:])
    if q == 0:
        return _solution(np.zeros(0), frames.solve(right), np.zeros((0, 0)), np.zeros((0, 0)))
    mixed = normal[q:, :q].toarray()
    eliminated = frames.solve(mixed)
    reduced = symmetric(normal[:q, :q].toarray() - mixed.T @ eliminated)
    values, axes, scale = _spectrum(reduced, design.effect_px)
    known = values > OPEN_PX**-2
    kept = axes[:, known]
    covariance = scale[:, None] * ((kept / values[known]) @ kept.T) * scale
    shared = covariance @ (right[:q] - eliminated.T @ right[q:])
    angles = frames.solve(right[q:] - mixed @ shared)
    return _solution(shared, angles, symmetric(covariance), axes[:, ~known].T)


def _spectrum(reduced: FloatArray, effect_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information of combinations (eigenvalues and vectors) in units of one pixel's effect, and that unit."""
    scale = np.divide(1.0, effect_px, out=np.zeros_like(effect_px), where=effect_px > 0.0)
    values, axes = np.linalg.eigh(scale[:, None] * reduced * scale)
    return values, axes, scale


def _solution(
    shared: FloatArray, angles: FloatArray, covariance: FloatArray, open_directions: FloatArray
) -> ArrowSolution:
    return ArrowSolution(shared, np.asarray(angles).reshape(-1, 3), covariance, open_directions)
