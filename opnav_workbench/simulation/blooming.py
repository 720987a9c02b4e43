"""Blooming: charge above the full well spills along its column, half up and half down, until pixels take it.

With excess u_i and room r_i of the pixels of a column, the charge that flows past pixel i is
``c_i = max(0, c_(i-1) + u_i - r_i)``, whose solution is a cumulative sum less its running minimum (D. V. Lindley,
1952, doi:10.1017/S0305004100027638): no loop over pixels.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray

__all__ = ["bloom"]


def bloom(electrons: FloatArray, full_well_e: float, *, spill: bool = True) -> FloatArray:
    """Limit the charge of every pixel to the full well.

    Parameters
    ----------
    electrons : (n_line, n_pixel) array
    full_well_e : float
    spill : bool
        Whether the excess flows along the column (line axis); else a drain takes it.

    Returns
    -------
    (n_line, n_pixel) array
        Charge is conserved but for what flows over the ends of a column.

    Examples
    --------
    >>> column = np.array([[0.0], [10.0], [170.0], [0.0], [0.0]])
    >>> bloom(column, 100.0).ravel()
    array([  0.,  45., 100.,  35.,   0.])
    """
    held = np.minimum(electrons, full_well_e)
    columns = np.flatnonzero((electrons > full_well_e).any(axis=0)) if spill else np.empty(0, dtype=np.int64)
    if len(columns) == 0:
        return held
    excess = (electrons - held)[:, columns]
    down = np.floor(0.5 * excess)
    filled = _flow(held[:, columns], down, full_well_e)
    held[:, columns] = _flow(filled[::-1], (excess - down)[::-1], full_well_e)[::-1]
    return held


def _flow(held: FloatArray, excess: FloatArray, full_well_e: float) -> FloatArray:
    """Let the excess flow toward higher lines and fill what room it finds."""
    balance = np.cumsum(excess - (full_well_e - held), axis=0)
    passing = balance - np.minimum(np.minimum.accumulate(balance, axis=0), 0.0)
    arriving = np.zeros_like(passing)
    arriving[1:] = passing[:-1]
    return held + (arriving + excess - passing)
