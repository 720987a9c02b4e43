"""What a batch estimate solves for, and what is known of it before."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray, symmetric
from opnav_workbench.errors import EstimationError

__all__ = [
    "APriori",
    "ParameterGroup",
    "parameter_count",
    "parse_groups",
    "prior_rows",
    "relative_state",
    "relative_state_matrix",
]

PARAMETER_UNITS = {
    "target_position": "km",
    "target_velocity": "km/s",
    "spacecraft_position": "km",
    "spacecraft_velocity": "km/s",
    "range_scale": "",
}
PARAMETER_KINDS = tuple(PARAMETER_UNITS)
OF_A_BODY = ("target_position", "target_velocity", "range_scale")
SINGLE_PARAMETER = "range_scale"

APriori = Mapping[str, ArrayLike] | FloatArray


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """Parameters that belong together.

    Attributes
    ----------
    kind
        One of `KINDS`.
    body
        The one body that it moves; empty for all (a barycenter with everything about it).
    start, size
        Its place among the parameters.
    """

    kind: str
    body: str
    start: int
    size: int

    @property
    def name(self) -> str:
        """Return its name as the user wrote it."""
        return f"{self.kind}:{self.body}" if self.body else self.kind

    @property
    def unit(self) -> str:
        """Return the unit of its parameters."""
        return PARAMETER_UNITS[self.kind]

    @property
    def columns(self) -> slice:
        """Return its columns among all parameters."""
        return slice(self.start, self.start + self.size)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of its parameters."""
        return (self.name,) if self.size == 1 else tuple(f"{self.name} {axis}" for axis in "xyz")

    def moves(self, body: str) -> bool:
        """Return whether it applies to an observed body."""
        return not self.body or self.body.casefold() == body.casefold()


def parse_groups(names: Sequence[str]) -> tuple[ParameterGroup, ...]:
    """Return the groups of names such as ``target_position`` or ``target_position:CHARON``.

    Raises
    ------
    EstimationError
        None, an unknown one, or one twice.

    Examples
    --------
    >>> [group.columns for group in parse_groups(["target_position", "range_scale:PLUTO"])]
    [slice(0, 3, None), slice(3, 4, None)]
    """
    if isinstance(names, str):
        names = (names,)
    if not names:
        raise EstimationError(f"no parameters to estimate; choose among {', '.join(PARAMETER_KINDS)}.")
    if len(set(names)) < len(names):
        raise EstimationError(f"parameters {', '.join(names)}: one is given twice.")
    groups, start = [], 0
    for name in names:
        kind, _, body = name.partition(":")
        if kind not in PARAMETER_KINDS or (body and kind not in OF_A_BODY):
            raise EstimationError(
                f"unknown parameter {name!r}; choose among {', '.join(PARAMETER_KINDS)}; "
                f"{', '.join(OF_A_BODY)} also of one body, as target_position:CHARON."
            )
        groups.append(ParameterGroup(kind, body, start, 1 if kind == SINGLE_PARAMETER else 3))
        start += groups[-1].size
    return tuple(groups)


def parameter_count(groups: Sequence[ParameterGroup]) -> int:
    """Return the number of parameters."""
    return sum(group.size for group in groups)


def relative_state_matrix(groups: Sequence[ParameterGroup], count: int, body: str = "") -> FloatArray:
    """Return d(spacecraft's state relative to a body, at the epoch)/d(parameters), (6, count).

    Parameters
    ----------
    body
        An observed body; empty for the system as a whole.
    """
    matrix = np.zeros((6, count))
    for group in groups:
        mover, _, quantity = group.kind.partition("_")
        if quantity in ("position", "velocity") and group.moves(body):
            rows = slice(0, 3) if quantity == "position" else slice(3, 6)
            matrix[rows, group.columns] += np.eye(3) * (1.0 if mover == "spacecraft" else -1.0)
    return matrix


def relative_state(
    groups: Sequence[ParameterGroup], correction: FloatArray, covariance: FloatArray, body: str = ""
) -> tuple[FloatArray, FloatArray]:
    """Return the correction (6,) of the spacecraft's state relative to a body at the epoch, and its covariance (6, 6)."""
    matrix = relative_state_matrix(groups, len(correction), body)
    return matrix @ correction, symmetric(matrix @ covariance @ matrix.T)


def prior_rows(groups: Sequence[ParameterGroup], a_priori: APriori | None) -> FloatArray:
    """Return the a priori knowledge as whitened rows (k, n): ``rows @ correction`` are k numbers of sigma 1.

    Parameters
    ----------
    a_priori : mapping or (n, n) array, optional
        By group a sigma, three sigmas or a (3, 3) covariance; or the covariance of all parameters. What is not given is
        not known at all.

    Raises
    ------
    EstimationError
        A group that is not estimated, a value of the wrong shape, or a matrix that is no covariance.
    """
    n = parameter_count(groups)
    if a_priori is None:
        return np.empty((0, n))
    if not isinstance(a_priori, Mapping):
        return _whitened_rows(np.asarray(a_priori, float), np.arange(n), n, "a priori covariance")
    unknown = [name for name in a_priori if name not in {group.name for group in groups}]
    if unknown:
        raise EstimationError(
            f"a priori sigma of {', '.join(unknown)}, which is not estimated; estimated are "
            f"{', '.join(group.name for group in groups)}."
        )
    rows = [_group_rows(group, a_priori[group.name], n) for group in groups if group.name in a_priori]
    return np.concatenate([np.empty((0, n)), *rows])


def _group_rows(group: ParameterGroup, value: ArrayLike, n: int) -> FloatArray:
    given = np.asarray(value, float)
    covariance = given if given.ndim == 2 else np.diag(np.broadcast_to(given, group.size).astype(float) ** 2)
    return _whitened_rows(covariance, np.arange(n)[group.columns], n, f"a priori covariance of {group.name}")


def _whitened_rows(covariance: FloatArray, columns: IntArray, n: int, what: str) -> FloatArray:
    size = len(columns)
    rows = np.zeros((size, n))
    if covariance.shape != (size, size):
        raise EstimationError(f"{what} has shape {covariance.shape}; expected ({size}, {size}).")
    try:
        rows[:, columns] = np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError as error:
        raise EstimationError(f"{what} is not positive definite; give sigmas greater than zero.") from error
    return rows
