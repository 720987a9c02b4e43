"""Directions to a target over time as Chebyshev series: few calls of SPICE, and none of the rounding of its light times.

SPICE differences positions about the solar-system barycenter at two epochs, one light time apart; epoch and positions
are rounded, and the direction of a near target jumps by that. A least-squares series through more points than it has
terms runs through the middle of the jumps, so that differences of attitudes are rates and not noise.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

from opnav_workbench.arrays import FloatArray

__all__ = ["smooth_track"]

DEGREE = 15
POINTS = 33  # twice as many as terms: rounding averages out, and an even miss shows
LONGEST_S = 14400.0  # a moon's swing about its planet, of a day or more, cannot hide between points
SHORTEST_S = 0.1  # nothing real turns within less


def smooth_track(
    directions: Callable[[FloatArray], FloatArray], start: float, end: float, tolerance_rad: float
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of epochs (n,) that gives vectors (n, 3) along `directions`, smoothly.

    Parameters
    ----------
    directions : callable
        Epochs (n,) to unit vectors (n, 3), smooth but for rounding.
    start, end : float
        Epochs between which it is asked.
    tolerance_rad : float
        Largest miss of the series; where rounding is larger, the shortest series that are tried stand.

    Examples
    --------
    >>> def circling(et):
    ...     return np.stack([np.cos(et / 1000.0), np.sin(et / 1000.0), 0.0 * et], axis=1)
    >>> track = smooth_track(circling, 0.0, 5000.0, 1e-12)
    >>> et = np.linspace(0.0, 5000.0, 777)
    >>> bool(np.abs(track(et) - circling(et)).max() < 2e-12)
    True
    """
    nodes = np.cos(np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    fit = np.linalg.pinv(chebyshev.chebvander(nodes, DEGREE))
    done: list[tuple[float, float, FloatArray]] = []
    count = max(1, int(np.ceil((end - start) / LONGEST_S)))
    edges = np.linspace(start, end, count + 1)
    waiting = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    while waiting:
        a, b = waiting.pop()
        values = directions(0.5 * (a + b) + 0.5 * (b - a) * nodes)
        terms = fit @ values
        miss = np.abs(chebyshev.chebval(nodes, terms).T - values).max()
        if miss <= tolerance_rad or b - a < 2.0 * SHORTEST_S:
            done.append((a, b, terms))
        else:
            waiting += [(a, 0.5 * (a + b)), (0.5 * (a + b), b)]
    return _series(sorted(done, key=lambda piece: piece[0]))


def _series(pieces: list[tuple[float, float, FloatArray]]) -> Callable[[FloatArray], FloatArray]:
    starts, ends = (np.array([piece[i] for piece in pieces]) for i in (0, 1))
    terms = np.stack([piece[2] for piece in pieces])  # (n, DEGREE + 1, 3)

    def evaluate(et: FloatArray) -> FloatArray:
        row = np.clip(np.searchsorted(starts, et, side="right") - 1, 0, len(starts) - 1)
        x = ((2.0 * et - starts[row] - ends[row]) / (ends[row] - starts[row]))[:, None]
        after, here = np.zeros((len(et), 3)), np.zeros((len(et), 3))
        for k in range(DEGREE, 0, -1):  # Clenshaw's recurrence
            here, after = terms[row, k] + 2.0 * x * here - after, here
        return np.asarray(terms[row, 0] + x * here - after)

    return evaluate
