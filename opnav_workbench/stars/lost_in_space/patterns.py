"""Four stars as five numbers that place, twist and a little noise do not change.

The two stars farthest apart are A and B: they span a plane picture in which A lies at (0, 0) and B at (1, 0). Where the
other two lie there are four numbers, the code; the fifth is the angle from A to B. Of the four ways to name the stars the
one is taken with x_C <= x_D and x_C + x_D <= 1. The mirrored picture has another code.

Source of the code: Lang et al. (2010), doi:10.1088/0004-6256/139/5/1782 (there, A and B lie on a diagonal).
"""

from itertools import combinations, permutations

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["ORDERS", "STARS", "code_of", "named_orders", "triples"]

STARS = 4
ORDERS = np.array(list(permutations(range(STARS))), dtype=np.int64)  # (24, 4): which of four is A, B, C, D
PAIRS = tuple(combinations(range(STARS), 2))


def triples(n: int) -> IntArray:
    """Return all sets of three (k, 3) of n things, that a fourth makes patterns with."""
    return np.array(list(combinations(range(n), STARS - 1)), dtype=np.int64)


def code_of(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return codes (q, 4) (x_C, y_C, x_D, y_D) and angles from A to B (q,), rad, of unit vectors (q, 4, 3) A, B, C, D."""
    a, b = vectors[:, 0], vectors[:, 1]
    along = b - a
    chord = np.sqrt(np.einsum("ij,ij->i", along, along))
    middle = a + b
    middle /= np.sqrt(np.einsum("ij,ij->i", middle, middle))[:, None]
    along /= chord[:, None]
    across = np.cross(middle, along)
    half = 0.5 * chord  # sine of half the angle; its tangent is the plane's unit
    unit = 2.0 * half / np.sqrt(1.0 - half**2)
    others = vectors[:, 2:]
    depth = np.einsum("qsk,qk->qs", others, middle) * unit[:, None]
    x = np.einsum("qsk,qk->qs", others, along) / depth + 0.5
    y = np.einsum("qsk,qk->qs", others, across) / depth
    return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1), 2.0 * np.arcsin(half)


def named_orders(vectors: FloatArray, slack: float = 0.0) -> tuple[IntArray, IntArray]:
    """Return the rows of unit vectors (q, 4, 3) and their `ORDERS` that name the stars as the rule says.

    Parameters
    ----------
    slack
        How far from the rule an order may be, for pictures in which noise decides; such rows come several times.
    """
    apart = np.stack([_square(vectors[:, i] - vectors[:, j]) for i, j in PAIRS], axis=1)
    longest = apart >= apart.max(axis=1, keepdims=True) * (1.0 - 2.0 * slack)
    if slack == 0.0:  # of two that are equal, the first
        longest &= np.cumsum(longest, axis=1) == 1
    rows, orders = [], []
    for place, (i, j) in enumerate(PAIRS):
        chosen = np.flatnonzero(longest[:, place])
        if len(chosen) == 0:
            continue
        a, along = vectors[chosen, i], vectors[chosen, j] - vectors[chosen, i]
        along = along / _square(along)[:, None]
        x = np.einsum(
            "qsk,qk->qs", vectors[chosen] - a[:, None], along
        )  # the chord's x: near enough to the code's
        for number, (first, second, c, d) in enumerate(ORDERS.tolist()):
            if {first, second} == {i, j}:
                x_c, x_d = (x[:, c], x[:, d]) if first == i else (1.0 - x[:, c], 1.0 - x[:, d])
                fits = _follows(x_c, x_d, slack)
                rows.append(chosen[fits])
                orders.append(np.full(int(fits.sum()), number))
    return np.concatenate(rows), np.concatenate(orders)


def _follows(x_c: FloatArray, x_d: FloatArray, slack: float) -> BoolArray:
    return np.asarray((x_c <= x_d + slack) & (x_c + x_d <= 1.0 + slack))


def _square(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))
