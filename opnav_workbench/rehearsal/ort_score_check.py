"""One quantity against its truth, with the sigmas that its own covariance gives the error."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.estimation.editing import equal_sigmas

__all__ = ["GOOD_SIGMAS", "WRONG_SIGMAS", "Check", "checked", "sigma_ratios"]

GOOD_SIGMAS = 3.0  # an honest sigma is left behind once in 370 times
WRONG_SIGMAS = 5.0  # once in 1.7 million times


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """A quantity of k components; arrays (k,) are read-only.

    Attributes
    ----------
    name : str
    labels, units : tuple of str
        Of the components.
    solved, truth, error, sigma : arrays
        Error: solved minus true.
    sigmas : float
        Of the normal error that is as improbable as all components together.
    """

    name: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    solved: FloatArray
    truth: FloatArray
    error: FloatArray
    sigma: FloatArray
    sigmas: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def verdict(self) -> str:
        """Return ``good``, ``poor`` or ``wrong``."""
        if self.sigmas <= GOOD_SIGMAS:
            return "good"
        return "poor" if self.sigmas <= WRONG_SIGMAS else "wrong"

    @property
    def component_sigmas(self) -> FloatArray:
        """Return each component's error over its own sigma (k,)."""
        return np.asarray(self.error / self.sigma)


def checked(
    name: str,
    labels: tuple[str, ...],
    units: tuple[str, ...],
    solved: ArrayLike,
    truth: ArrayLike,
    covariance: ArrayLike,
) -> Check:
    """Hold a quantity against its truth.

    Parameters
    ----------
    name : str
    labels, units : tuple of str
    solved, truth : (k,) array_like
    covariance : (k, k) array_like
        Of the solved values.

    Examples
    --------
    >>> check = checked("center", ("pixel", "line"), ("px", "px"), [10.1, 20.0], [10.0, 20.0], np.eye(2) * 0.01)
    >>> round(check.sigmas, 2), check.verdict
    (0.52, 'good')
    """
    values, true, matrix = (np.asarray(v, dtype=np.float64) for v in (solved, truth, covariance))
    error = values - true
    square = _square(error, matrix)
    sigma = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    return Check(name, labels, units, values, true, error, sigma, equal_sigmas(square, len(error)))


def _square(error: FloatArray, covariance: FloatArray) -> float:
    """Return the squared error in sigmas; a matrix that is no covariance gives no error any credit."""
    try:
        return float(np.sum(np.linalg.solve(np.linalg.cholesky(covariance), error) ** 2))
    except np.linalg.LinAlgError:
        return np.inf if error.any() else 0.0


def sigma_ratios(claimed: ArrayLike, supported: ArrayLike) -> tuple[float, float]:
    """Return least and largest ratio of claimed to supported sigma over all directions; (k, k) covariances.

    Examples
    --------
    >>> sigma_ratios(np.diag([1.0, 4.0]), np.eye(2))
    (1.0, 2.0)
    """
    factor = np.linalg.inv(np.linalg.cholesky(np.asarray(supported, float)))
    values = np.linalg.eigvalsh(factor @ np.asarray(claimed, float) @ factor.T)
    least, largest = (float(np.sqrt(max(v, 0.0))) for v in values[[0, -1]])
    return least, largest
