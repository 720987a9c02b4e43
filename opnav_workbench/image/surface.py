"""A smooth surface through scattered values of which up to nearly half may be wrong: least trimmed squares.

Source: Rousseeuw & Van Driessen (2006), "Computing LTS Regression for Large Data Sets",
doi:10.1007/s10618-005-0024-4.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["robust_surface"]

RANDOM_STARTS = 100  # with 40 % wrong values, 1 - (1 - 0.6^6)^100 = 0.99 that one start of six is clean
CONCENTRATION_STEPS = 6  # the fit hardly moves after four
SEED = 20_150_714  # the same picture gives the same background
VALUES_PER_TERM = 3  # fewer values a coefficient than this would follow the noise
# Standard deviation of the inner half of a unit Gaussian: sqrt(1 - 2 q phi(q) / 0.5) with q = 0.6745.
INNER_HALF_FACTOR = 0.377617
RIDGE = 1e-9  # keeps the normal equations of values on one line solvable


def robust_surface(positions: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Fit a quadratic surface to the better half of `values`; a plane or a constant where they are few.

    Parameters
    ----------
    positions : (n, 2) array
        Coordinates within about -1..1.
    values : (n,) array
        May hold nan, which is left out.

    Returns
    -------
    surface : (n,) array
        The surface at every position.
    scatter : float
        Standard deviation of the good values about it.
    """
    known = np.flatnonzero(np.isfinite(values))
    basis = _basis(positions, known)
    fitted, scatter = _least_trimmed_squares(basis[known], values[known])
    return np.asarray(basis @ fitted), scatter


def _basis(positions: FloatArray, known: IntArray) -> FloatArray:
    """Return the columns 1, x, y, x2, xy, y2 that `known` can determine."""
    x, y = positions.T
    distinct_x, distinct_y = (len(np.unique(axis[known])) for axis in (x, y))
    columns = [np.ones(len(x))]
    if len(known) >= 3 * VALUES_PER_TERM:
        columns += [axis for axis, distinct in ((x, distinct_x), (y, distinct_y)) if distinct > 1]
    if len(known) >= 6 * VALUES_PER_TERM:
        columns += [axis * axis for axis, distinct in ((x, distinct_x), (y, distinct_y)) if distinct > 3]
        columns += [x * y] if min(distinct_x, distinct_y) > 1 else []
    return np.stack(columns, axis=1)


def _least_trimmed_squares(basis: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    n, terms = basis.shape
    kept = (n + terms + 1) // 2
    subsets = _starts(values, terms)
    fits = np.stack([_solve(basis[s][None], values[s][None])[0] for s in subsets])
    for _ in range(CONCENTRATION_STEPS):
        best = np.argpartition((values - fits @ basis.T) ** 2, min(kept, n) - 1, axis=1)[:, :kept]
        fits = _solve(basis[best], values[best])
    squares = np.sort((values - fits @ basis.T) ** 2, axis=1)[:, :kept].mean(axis=1)
    winner = int(np.argmin(squares))
    return fits[winner], float(np.sqrt(squares[winner])) / INNER_HALF_FACTOR


def _starts(values: FloatArray, terms: int) -> list[IntArray]:
    """Return subsets to begin with: everything, the fainter half (bodies are bright), and random ones."""
    rng = np.random.default_rng(SEED)
    order = np.argsort(values)
    random = np.argsort(rng.random((RANDOM_STARTS, len(values))), axis=1)[:, :terms]
    return [order, order[: max(terms, len(values) // 2)], *random]


def _solve(basis: FloatArray, values: FloatArray) -> FloatArray:
    """Solve many subsets at once: basis (s, h, terms) and values (s, h) to coefficients (s, terms)."""
    transposed = np.swapaxes(basis, 1, 2)
    normal = transposed @ basis + RIDGE * np.eye(basis.shape[2])
    return np.asarray(np.linalg.solve(normal, transposed @ values[..., None])[..., 0])
