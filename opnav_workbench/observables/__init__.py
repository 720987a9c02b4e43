"""Observables for orbit determination: O, C, O-C, covariances and partials of a body's center in the picture.

partials     how the center moves when spacecraft, target or camera move: by differences and analytically
observable   one body's observable
observing    how a measured center becomes one
joint        the covariance of several bodies, which share their picture's pointing error
columns      names, units and descriptions of an observable's values in files
rows         an observable as a row of plain values, and back
table, text, json_file, tdm, tdm_reading
             ECSV, CSV, JSON and the CCSDS Tracking Data Message, written and read back
"""

from opnav_workbench.observables.joint import center_cross, cross_covariance_px2, joint_covariance_px2
from opnav_workbench.observables.json_file import observables_dict, read_json, write_observables_json
from opnav_workbench.observables.observable import Observable
from opnav_workbench.observables.observing import observe
from opnav_workbench.observables.partials import (
    analytic_position_partials,
    analytic_target_partials,
    attitude_partials,
    numerical_position_partials,
    numerical_target_partials,
)
from opnav_workbench.observables.table import observables_table, read_ecsv, table_observables, write_ecsv
from opnav_workbench.observables.tdm import TdmOptions, tdm_text, write_tdm
from opnav_workbench.observables.tdm_reading import TrackingMessage, parse_tdm, read_tdm, tdm_table
from opnav_workbench.observables.text import csv_text, read_csv, write_csv

__all__ = [
    "Observable",
    "TdmOptions",
    "TrackingMessage",
    "analytic_position_partials",
    "analytic_target_partials",
    "attitude_partials",
    "center_cross",
    "cross_covariance_px2",
    "csv_text",
    "joint_covariance_px2",
    "numerical_position_partials",
    "numerical_target_partials",
    "observables_dict",
    "observables_table",
    "observe",
    "parse_tdm",
    "read_csv",
    "read_ecsv",
    "read_json",
    "read_tdm",
    "table_observables",
    "tdm_table",
    "tdm_text",
    "write_csv",
    "write_ecsv",
    "write_observables_json",
    "write_tdm",
]
