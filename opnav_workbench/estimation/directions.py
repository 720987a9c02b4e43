"""What pictures determine: independent directions among the parameters, with their sigmas, in plain words.

The whitened Jacobian's singular vectors, in units that make parameters comparable: a priori sigmas where they are given;
else 1 km, and for velocities what moves a body by 1 km over the arc. A picture shows what lies across the line of sight
(cross-track) and, through apparent size or through the change of direction on a passing trajectory, weakly what lies
along it (down-track).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.estimation.parameters import ParameterGroup, parameter_count

__all__ = ["ParameterDirection", "directions_of", "is_determined", "scales_of"]

NOT_DETERMINED = (
    1e-10  # of the largest singular value: what rounding leaves of a direction that nothing measures
)
WORTH_SAYING = 0.1  # smallest share of a direction that the words mention
ONE_GROUP = 0.8  # a direction that lies so far in one group has that group's unit
MIN_ARC_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ParameterDirection:
    """One direction among the parameters.

    Attributes
    ----------
    vector : (n,) array
        Physical units; one sigma of the direction is `sigma` times this.
    sigma
        By the measurements alone; inf where they do not determine it.
    """

    vector: FloatArray
    sigma: float
    determined: bool
    words: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


def scales_of(groups: Sequence[ParameterGroup], arc_s: float, a_priori_rows: FloatArray) -> FloatArray:
    """Return one unit of each parameter (n,), for comparison."""
    scales = np.ones(parameter_count(groups))
    for group in groups:
        if group.kind.endswith("velocity"):
            scales[group.columns] = 1.0 / max(arc_s, MIN_ARC_S)
        elif group.kind == "range_scale":
            scales[group.columns] = 1e-3
    information = np.sum(a_priori_rows**2, axis=0)
    known = information > 0.0
    scales[known] = 1.0 / np.sqrt(information[known])
    return scales


def is_determined(scaled: FloatArray) -> bool:
    """Return whether rows (k, n), in comparable units, determine every one of n directions."""
    values = np.linalg.svd(scaled, compute_uv=False)
    return len(values) == scaled.shape[1] and bool(values[-1] > NOT_DETERMINED * values[0])


def directions_of(
    whitened: FloatArray, groups: Sequence[ParameterGroup], scales: FloatArray, line_of_sight: FloatArray
) -> tuple[ParameterDirection, ...]:
    """Return the independent directions, best determined first.

    Parameters
    ----------
    whitened : (k, n) array
        d(computed / sigma)/d(parameters).
    scales : (n,) array
        As `scales_of`.
    line_of_sight : (3,) array
        Mean direction from spacecraft to target.
    """
    n = len(scales)
    padded = np.concatenate(
        [whitened * scales, np.zeros((n, n))]
    )  # fewer rows than parameters: the rest is zero
    _, values, vectors = np.linalg.svd(padded, full_matrices=False)
    largest = max(float(values[0]), np.finfo(float).tiny)
    found = []
    for value, vector in zip(values, vectors, strict=True):
        determined = bool(value > NOT_DETERMINED * largest)
        sigma = 1.0 / float(value) if determined else np.inf
        words = _direction_words(vector, sigma, groups, scales, line_of_sight)
        found.append(ParameterDirection(vector * scales, sigma, determined, words))
    return tuple(found)


def _direction_words(
    vector: FloatArray,
    sigma: float,
    groups: Sequence[ParameterGroup],
    scales: FloatArray,
    line_of_sight: FloatArray,
) -> str:
    shares = sorted(_group_shares(vector, groups, line_of_sight), key=lambda s: -s[0])
    named = [(share, words) for share, words, _ in shares if share >= WORTH_SAYING]
    what = " with ".join(
        words if share > 1.0 - WORTH_SAYING else f"{share:.0%} {words}" for share, words in named
    )
    if not np.isfinite(sigma):
        return f"{what}: not determined by the measurements"
    main = shares[0][2]
    total = sum(share for share, _, group in shares if group is main)
    if total >= ONE_GROUP:
        physical = sigma * float(np.linalg.norm((vector * scales)[main.columns]))
        return f"{what}: 1 sigma {physical:.3g} {main.unit}".rstrip()
    return f"{what}: 1 sigma {sigma:.3g} of their units"


def _group_shares(
    vector: FloatArray, groups: Sequence[ParameterGroup], line_of_sight: FloatArray
) -> list[tuple[float, str, ParameterGroup]]:
    """Squared shares of a direction by group, positions and velocities split along and across the line of sight."""
    shares = []
    for group in groups:
        part = vector[group.columns]
        name = group.name.replace("_", " ")
        if group.size == 1:
            shares.append((float(part @ part), name, group))
            continue
        along = float(part @ line_of_sight) ** 2
        shares.append((along, f"{name} down-track (along the line of sight)", group))
        shares.append((float(part @ part) - along, f"{name} cross-track", group))
    return shares
