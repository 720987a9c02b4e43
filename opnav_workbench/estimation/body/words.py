"""What a sequence tells of a body and what it does not, in plain words.

Each quantity's standard deviation after the batch is held against what was believed before: where little of that is gone the
pictures have not observed it. Quantities that go together (correlation) are told as pairs: what they make together is known,
neither of them by itself.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.estimation.body.knowledge import (
    LIMB,
    MAP,
    MERIDIAN,
    OFFSET,
    POLE,
    POSITION,
    RADII,
    SHARED,
    SPIN,
    VELOCITY,
)

__all__ = ["observability_words"]

NOT_OBSERVED, HARDLY = 0.9, 0.5  # of the a priori sigma left
TOGETHER = 0.95  # correlation of two that cannot be told apart
WORTH_SAYING = 0.1  # of the a priori sigma left: less is known well enough, whatever goes with it
OF_OUTLINES = (RADII, OFFSET, LIMB)
DEG = 180.0 / np.pi


class _Quantity(NamedTuple):
    name: str
    row: FloatArray  # (20,)
    unit: str
    factor: float


def observability_words(
    covariance: FloatArray,
    a_priori: FloatArray,
    line_of_sight: FloatArray,
    *,
    with_outlines: bool = True,
    with_map: bool = False,
) -> tuple[str, ...]:
    """Return one line for each quantity that is not or hardly observed, and for each pair that goes together.

    Parameters
    ----------
    covariance, a_priori : (20, 20) arrays
        After and before.
    line_of_sight : (3,) array
        Mean direction from the spacecraft to the body, J2000.
    with_outlines, with_map
        Whether outlines, whether landmarks were used: what only the others could tell is no news.
    """
    quantities = _quantities(line_of_sight)
    unasked = [*([] if with_outlines else OF_OUTLINES), *([] if with_map else [MAP])]
    quantities = [q for q in quantities if not any(q.row[group.columns].any() for group in unasked)]
    rows = np.array([q.row for q in quantities])
    after, before = rows @ covariance @ rows.T, rows @ a_priori @ rows.T
    sigma, known = np.sqrt(np.diag(after)), np.sqrt(np.diag(before))
    out = []
    for quantity, left, was in zip(quantities, sigma, known, strict=True):
        value = f"{left * quantity.factor:.3g} {quantity.unit}".rstrip()
        if left > NOT_OBSERVED * was:
            out.append(f"{quantity.name} is not observed: 1 sigma stays {value}, as believed before")
        elif left > HARDLY * was:
            out.append(
                f"{quantity.name} is hardly observed: 1 sigma {value}, {left / was:.0%} of what it was before"
            )
    if not with_outlines:
        out.append("no outline was used: size, axes and center of figure stay as believed")
    return (*out, *_pairs(quantities, after, sigma, known))


def _pairs(
    quantities: Sequence[_Quantity], after: FloatArray, sigma: FloatArray, known: FloatArray
) -> list[str]:
    correlation = after / np.outer(sigma, sigma)
    return [
        f"{quantities[i].name} and {quantities[j].name} cannot be told apart (correlation {correlation[i, j]:+.2f})"
        for i in range(len(quantities))
        for j in range(i)
        if abs(correlation[i, j]) > TOGETHER and min(sigma[i] / known[i], sigma[j] / known[j]) > WORTH_SAYING
    ]


def _quantities(line_of_sight: FloatArray) -> list[_Quantity]:
    across = np.linalg.svd(line_of_sight[None])[2][1:]
    axes = (
        ("along the line of sight", line_of_sight),
        *(
            (f"across the line of sight ({k} way)", one)
            for k, one in zip(("one", "other"), across, strict=True)
        ),
    )
    out = [_quantity(f"the position {words}", POSITION.columns, axis, "km") for words, axis in axes]
    out += [_quantity(f"the velocity {words}", VELOCITY.columns, axis, "km/s") for words, axis in axes]
    out.append(_quantity("the size", RADII.columns, np.full(3, 1.0 / 3.0), "%", 100.0))
    for k, name in enumerate("abc"):
        out.append(
            _quantity(f"the axis {name} beside the size", RADII.columns, np.eye(3)[k] - 1.0 / 3.0, "%", 100.0)
        )
    for k, side in enumerate(("east", "north")):
        out.append(_quantity(f"the pole toward {side}", POLE.columns, np.eye(2)[k], "deg", DEG))
    out.append(_quantity("the prime meridian", MERIDIAN.columns, np.ones(1), "deg", DEG))
    out.append(_quantity("the spin rate", SPIN.columns, np.ones(1), "deg/day", DEG * 86400.0))
    for k, axis in enumerate("xyz"):
        out.append(_quantity(f"the center of figure along {axis}", OFFSET.columns, np.eye(3)[k], "km"))
    out.append(_quantity("how far out limbs are read", LIMB.columns, np.ones(1), "px"))
    for k, axis in enumerate("xyz"):
        out.append(_quantity(f"the landmarks' scale along {axis}", MAP.columns, np.eye(3)[k], "%", 100.0))
    return out


def _quantity(name: str, columns: slice, weights: FloatArray, unit: str, factor: float = 1.0) -> _Quantity:
    row = np.zeros(SHARED)
    row[columns] = weights
    return _Quantity(name, row, unit, factor)
