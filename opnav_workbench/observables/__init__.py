"""Observables for orbit determination: O, C, O-C, covariances and partials of a body's center in the picture.

partials    how the center moves when the spacecraft or the camera moves: by differences and analytically
observable  one body's observable
table       many of them as an astropy table and an ECSV file
"""

from opnav_workbench.observables.observable import Observable, observe
from opnav_workbench.observables.partials import (
    analytic_position_partials,
    attitude_partials,
    numerical_position_partials,
)
from opnav_workbench.observables.table import observables_table, write_ecsv

__all__ = [
    "Observable",
    "analytic_position_partials",
    "attitude_partials",
    "numerical_position_partials",
    "observables_table",
    "observe",
    "write_ecsv",
]
