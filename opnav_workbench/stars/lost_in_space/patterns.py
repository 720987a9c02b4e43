"""Three stars as three numbers that place, twist and a little noise do not change.

The two stars farthest apart are A and B, and A is the one nearer to the third: they span a plane picture in which A lies at
(0, 0) and B at (1, 0). Where C lies there are two numbers, the code; the third is the angle from A to B. The mirrored
picture has another code.

Of five stars in a picture there are ten triangles and five sets of four, and a set of four is in an index only where all
four stand close together among others: where a third of the detections is false and a fifth of the catalog missing,
triangles are what is left. A fourth star tells the true ones (`search`).

Source of the code, for four stars: Lang et al. (2010), doi:10.1088/0004-6256/139/5/1782.
"""

from itertools import combinations, permutations

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["ORDERS", "STARS", "code_of", "named_orders", "pairs"]

STARS = 3
ORDERS = np.array(list(permutations(range(STARS))), dtype=np.int64)  # (6, 3): which of three is A, B, C
OPPOSITE = ((1, 2), (0, 2), (0, 1))  # the side that star 0, 1, 2 is no end of


def pairs(n: int) -> IntArray:
    """Return all sets of two (k, 2) of n things, that a third makes triangles with."""
    return np.array(list(combinations(range(n), STARS - 1)), dtype=np.int64)


def code_of(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return codes (q, 2) (x_C, y_C) and angles from A to B (q,), rad, of unit vectors (q, 3, 3) A, B, C.

    The plane touches the sphere half-way between A and B. All is written in squares of chords, which small triangles
    lose no digits by, and the volume that the three vectors span.
    """
    a, b, c = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    long2, near2, far2 = _square(a - b), _square(a - c), _square(b - c)
    depth = 2.0 - 0.5 * (near2 + far2)  # of C along the sum of A and B
    unit = (4.0 - long2) / (long2 * depth)
    x = 0.5 + 0.25 * (near2 - far2) * unit
    y = np.einsum("ij,ij->i", c, np.cross(a - c, b - c)) * unit / np.sqrt(4.0 - long2)
    return np.stack([x, y], axis=1), 2.0 * np.arcsin(0.5 * np.sqrt(long2))


def named_orders(vectors: FloatArray, slack: float = 0.0) -> tuple[IntArray, IntArray]:
    """Return the rows of unit vectors (q, 3, 3) and their `ORDERS` that name the stars as the rule says.

    Parameters
    ----------
    slack
        How far from the rule an order may be, in parts of the longest side, for pictures in which noise decides; such rows
        come several times.
    """
    sides = np.stack([np.sqrt(_square(vectors[:, i] - vectors[:, j])) for i, j in OPPOSITE], axis=1)
    if slack == 0.0:  # of two that are equal, the first
        rank = np.argsort(sides, axis=1, kind="stable")  # opposite of B, A, C
        return np.arange(len(sides)), NUMBER_OF_ORDER[rank[:, 1], rank[:, 0]]
    sides /= sides.max(axis=1, keepdims=True)
    rows, orders = [], []
    for number, (a, b, c) in enumerate(ORDERS.tolist()):
        fits = np.flatnonzero((sides[:, b] <= sides[:, a] + slack) & (sides[:, a] <= sides[:, c] + slack))
        rows.append(fits)
        orders.append(np.full(len(fits), number))
    return np.concatenate(rows), np.concatenate(orders)


def _square(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


NUMBER_OF_ORDER = np.zeros((STARS, STARS), np.int64)  # by which star is A and which B
NUMBER_OF_ORDER[ORDERS[:, 0], ORDERS[:, 1]] = np.arange(len(ORDERS))
