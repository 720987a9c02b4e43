"""What a batch estimate says; arrays are read-only."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.observability import Direction
from opnav_workbench.estimation.parameters import Group

__all__ = ["Estimate", "Residual"]


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """One measured center or range, before and after.

    Attributes
    ----------
    image, body, kind : str
        `kind` is "center" or "range".
    et : float
    before, after : (2,) or (1,) array
        Observed minus computed, px or km.
    covariance : (2, 2) or (1, 1) array
        Of the measurement, pointing included, px^2 or km^2.
    sigmas : float
        Size of what remains over its predicted scatter: of a center the sigma of equal probability.
    used : bool
    reason : str
        Why it was not used.
    """

    image: str
    body: str
    kind: str
    et: float
    before: FloatArray
    after: FloatArray
    covariance: FloatArray
    sigmas: float
    used: bool
    reason: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A batch least-squares estimate.

    Attributes
    ----------
    groups : tuple of Group
    epoch_et : float
        Time of the corrected states, TDB seconds past J2000.
    correction : (n,) array
        True minus ephemeris, km, km/s or dimensionless; J2000. A range scale is measured over true range, minus one.
    covariance : (n, n) array
        Its covariance, by the measurements' own (a priori included).
    a_priori_rows : (k, n) array
        A priori knowledge, whitened.
    residuals : tuple of Residual
        Of every observable with a center, in their order; ranges last.
    left_out : tuple of str
        Observables without a usable center, with their status.
    chi2_before, chi2_after : float
        Of the used measurements; after with the a priori's share.
    degrees_of_freedom : int
    iterations : tuple of (n,) arrays
        Corrections after each pass.
    converged : bool
    directions : tuple of Direction
        What the measurements alone determine, best first.
    messages : tuple of str
    """

    groups: tuple[Group, ...]
    epoch_et: float
    correction: FloatArray
    covariance: FloatArray
    a_priori_rows: FloatArray
    residuals: tuple[Residual, ...]
    left_out: tuple[str, ...]
    chi2_before: float
    chi2_after: float
    degrees_of_freedom: int
    probability: float
    iterations: tuple[FloatArray, ...]
    converged: bool
    directions: tuple[Direction, ...]
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(label for group in self.groups for label in group.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the units of the parameters."""
        return tuple(group.unit for group in self.groups for _ in range(group.size))

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """Return the correlation coefficients (n, n)."""
        return np.asarray(self.covariance / np.outer(self.sigma, self.sigma))

    def group(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the correction (k,) and covariance (k, k) of one group.

        Raises
        ------
        EstimationError
            It was not estimated.
        """
        for group in self.groups:
            if group.name == name:
                c = group.columns
                return self.correction[c], self.covariance[c, c]
        raise EstimationError(
            f"{name!r} was not estimated; there are {', '.join(g.name for g in self.groups)}."
        )

    def relative_state(self, body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the correction (6,) of the spacecraft's state relative to a body at the epoch, and its covariance (6, 6).

        Parameters
        ----------
        body : str
            An observed body; empty for the system as a whole.
        """
        matrix = np.zeros((6, len(self.correction)))
        for group in self.groups:
            mover, _, quantity = group.kind.partition("_")
            if quantity in ("position", "velocity") and group.moves(body):
                rows = slice(0, 3) if quantity == "position" else slice(3, 6)
                matrix[rows, group.columns] += np.eye(3) * (1.0 if mover == "spacecraft" else -1.0)
        return matrix @ self.correction, symmetric(matrix @ self.covariance @ matrix.T)
