"""The steps of a pointing solution as a table, such as the paper's Table 2."""

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.pointing.results import Iteration, PointingSolution

__all__ = ["iteration_table"]


def iteration_table(solution: PointingSolution) -> QTable:
    """Return one row an iteration, and their sum as the last row.

    Returns
    -------
    astropy.table.QTable
        iteration (1, 2, ... Total), delta_pixel and delta_line (pix), delta_twist (deg).

    Examples
    --------
    >>> table = iteration_table(solution)  # doctest: +SKIP
    >>> print(table)  # doctest: +SKIP
    iteration delta_pixel delta_line delta_twist
                  pix        pix         deg
    --------- ----------- ---------- -----------
            1     4.55319   12.27090 -1.0542e-02
            2    -0.00216    0.00310 -5.9722e-04
        Total     4.55103   12.27400 -1.1139e-02
    """
    total = Iteration(solution.delta_pixel, solution.delta_line, solution.delta_twist_rad)
    steps = [*solution.iterations, total]
    table = QTable()
    table["iteration"] = [*(str(i + 1) for i in range(len(solution.iterations))), "Total"]
    table["delta_pixel"] = [step.delta_pixel for step in steps] * u.pix
    table["delta_line"] = [step.delta_line for step in steps] * u.pix
    table["delta_twist"] = np.degrees([step.delta_twist_rad for step in steps]) * u.deg
    for name, text, form in (
        ("iteration", "step of the least squares", ""),
        ("delta_pixel", "motion of the sky at the a priori boresight along pixel", ".5f"),
        ("delta_line", "the same along line", ".5f"),
        ("delta_twist", "change of the twist, solved minus a priori", ".4e"),
    ):
        table[name].info.description = text
        table[name].info.format = form
    return table
