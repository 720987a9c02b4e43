"""Square-root information filter and smoother: linear algebra alone, for any state.

What is known of a state x is kept as rows ``R x = z - noise`` of unit noise, with R upper triangular, and only orthogonal
transformations touch it: no covariance is ever subtracted from another, none loses its sign by rounding, and a state that
is not yet determined is as good as any.

    measurement   rows H x = z - noise of unit noise are put below, and the whole is made triangular again
    time          x_k = B_u u + B_x x_k+1   with   E_u u + E_x x_k+1 = noise of unit size
                  u: what the step brings in or leaves behind; the triangle's rows of u are kept for the smoother
    smoother      from the last state back: u given x_k+1 by the kept rows, hence x_k; the covariance as a square root

The right-hand side may have more columns than one: those of parameters that are not solved for (consider parameters), whose
effect on the state is then known at every step.

References: Bierman (1977), Factorization Methods for Discrete Sequential Estimation, chapters V to VII and X (smoother after
Dyer & McReynolds).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import EstimationError

__all__ = [
    "Information",
    "Smoothed",
    "Step",
    "StepRows",
    "last_smoothed",
    "linear_step",
    "smooth",
    "with_measurements",
    "with_step",
]

# Of a column's length, what rounding leaves of a direction that nothing determines.
NOT_DETERMINED = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """What is known of a state: ``r @ x = z[:, 0] - z[:, 1:] @ y - noise`` of unit noise; arrays are read-only.

    Attributes
    ----------
    r : (n, n) array
        Upper triangular.
    z : (n, 1 + q) array
        First column the data, then those of q parameters that are not solved for, with the sign of the data.
    square_sum
        What the data of the first column leave unexplained so far: chi-squared.
    """

    r: FloatArray
    z: FloatArray
    square_sum: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def determined(self) -> bool:
        """Whether every direction of the state is known."""
        return not self.loose.any()

    @property
    def loose(self) -> BoolArray:
        """Which parameters (n,) nothing determines, those before them given."""
        lengths = np.linalg.norm(self.r, axis=0)
        return np.asarray(np.abs(np.diag(self.r)) <= NOT_DETERMINED * lengths)

    def state(self) -> FloatArray:
        """Return the state, and what each considered parameter moves it by, (n, 1 + q).

        Raises
        ------
        EstimationError
            It is not determined.
        """
        self._require_determined()
        return np.asarray(solve_triangular(self.r, self.z))

    @property
    def log_information(self) -> float:
        """Logarithm of the determinant of the state's information matrix."""
        return _log_square(self.r)

    def covariance_root(self) -> FloatArray:
        """Return S (n, n), covariance = S S'; considered parameters not included.

        Raises
        ------
        EstimationError
            The state is not determined.
        """
        self._require_determined()
        return np.asarray(solve_triangular(self.r, np.eye(len(self.r))))

    def _require_determined(self) -> None:
        if not self.determined:
            raise EstimationError(
                "the state is not determined yet; give a priori sigmas or wait for more measurements."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A step in time, told backward: ``x_k = by_noise @ u + by_next @ x_k+1``; arrays are read-only.

    Attributes
    ----------
    by_noise, by_next : (n, m), (n, n) arrays
    noise_rows, next_rows : (p, m), (p, n) arrays
        ``noise_rows @ u + next_rows @ x_k+1`` has zero mean and unit covariance.
    """

    by_noise: FloatArray
    by_next: FloatArray
    noise_rows: FloatArray
    next_rows: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class StepRows:
    """Rows of u that a step leaves for the smoother: ``r_u @ u + r_next @ x_k+1 = z - noise``; arrays are read-only."""

    step: Step
    r_u: FloatArray
    r_next: FloatArray
    z: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def log_information(self) -> float:
        """Logarithm of the determinant of what is known of u, the next state given."""
        return _log_square(self.r_u)


def _log_square(triangle: FloatArray) -> float:
    return float(2.0 * np.log(np.abs(np.diag(triangle))).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """A smoothed state (n, 1 + q), as `Information.state`, and the root S (n, n) of its covariance; arrays are read-only."""

    state: FloatArray
    root: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def linear_step(transition: ArrayLike, noise: ArrayLike) -> Step:
    """Return the step of ``x_k+1 = transition @ x_k + noise @ w``, w of unit covariance.

    Parameters
    ----------
    transition : (n, n) array_like
        To be inverted.
    noise : (n, m) array_like

    Examples
    --------
    A random walk: unit variance grows by another unit, and half of it is found again when the end is known.

    >>> start = Information(np.eye(1), np.zeros((1, 1)))
    >>> moved, rows = with_step(start, linear_step([[1.0]], [[1.0]]))
    >>> print((moved.covariance_root() ** 2).round(12))
    [[2.]]
    >>> exact = with_measurements(moved, [[1e6]], [[2e6]])
    >>> print(smooth(last_smoothed(exact), rows).state.round(6))
    [[1.]]
    """
    inverse = np.linalg.inv(np.asarray(transition, float))
    g = np.asarray(noise, float)
    m = g.shape[1]
    return Step(-inverse @ g, inverse, np.eye(m), np.zeros((m, len(inverse))))


def with_measurements(known: Information, rows: ArrayLike, right: ArrayLike) -> Information:
    """Return what is known with whitened measurements ``rows @ x = right[:, 0] - right[:, 1:] @ y - noise``.

    Parameters
    ----------
    rows : (k, n) array_like
    right : (k, 1 + q) array_like
    """
    n = len(known.r)
    table = np.block([[known.r, known.z], [np.asarray(rows, float), np.asarray(right, float)]])
    triangle, rest = _triangular(table, n)
    return Information(triangle[:, :n], triangle[:, n:], known.square_sum + float(rest[:, n] @ rest[:, n]))


def with_step(known: Information, step: Step) -> tuple[Information, StepRows]:
    """Return what is known of the next state, and the rows for the smoother."""
    n, m = step.by_noise.shape
    z = np.concatenate([known.z, np.zeros((len(step.noise_rows), known.z.shape[1]))])
    table = np.column_stack(
        [
            np.concatenate([known.r @ step.by_noise, step.noise_rows]),
            np.concatenate([known.r @ step.by_next, step.next_rows]),
            z,
        ]
    )
    triangle, rest = _triangular(table, m + n)
    kept = StepRows(step, triangle[:m, :m], triangle[:m, m : m + n], triangle[:m, m + n :])
    left = float(rest[:, m + n] @ rest[:, m + n])
    return Information(triangle[m:, m : m + n], triangle[m:, m + n :], known.square_sum + left), kept


def last_smoothed(known: Information) -> Smoothed:
    """Return the last state, where smoothing begins.

    Raises
    ------
    EstimationError
        It is not determined.
    """
    return Smoothed(known.state(), known.covariance_root())


def smooth(after: Smoothed, rows: StepRows) -> Smoothed:
    """Return the smoothed state before a step from the one after it."""
    step = rows.step
    both = solve_triangular(rows.r_u, np.column_stack([rows.z, rows.r_next, np.eye(len(rows.r_u))]))
    columns, n = rows.z.shape[1], len(after.root)
    mean, slope, spread = both[:, :columns], both[:, columns : columns + n], both[:, columns + n :]
    u = mean - slope @ after.state
    state = step.by_noise @ u + step.by_next @ after.state
    carried = (step.by_next - step.by_noise @ slope) @ after.root
    root = _triangular(np.concatenate([carried.T, (step.by_noise @ spread).T]), n)[0].T
    return Smoothed(state, root)


def _triangular(table: FloatArray, pivots: int) -> tuple[FloatArray, FloatArray]:
    """Make the first columns triangular by orthogonal transformations: (pivots, ...) rows, and those left below."""
    short = max(pivots - len(table), 0)
    table = np.concatenate([table, np.zeros((short, table.shape[1]))])
    turned = np.linalg.qr(table[:, :pivots], mode="complete")[0].T @ table
    top = turned[:pivots].copy()
    top[:, :pivots] = np.triu(top[:, :pivots])
    return top, turned[pivots:]
