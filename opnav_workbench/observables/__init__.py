"""Observables for orbit determination: O, C, O-C, covariances and partials of a body's center in the picture.

Enter by `observe`, which makes an `Observable` of a measured center; by `write_ecsv`, `write_csv`,
`write_observables_json` or `write_tdm` to hand observables over, and by the `read_...` beside each to have them back.

``observable``
    `Observable`, and the covariance of several, which share their picture's pointing error.
``observing``
    `observe`: how a measured center becomes an observable.
``partials``
    How the center moves when spacecraft, target or camera move: by differences and analytically.
``columns``
    Names, units and descriptions of an observable's values in files; an observable as a row, and back.
``ecsv_writer``
    A table of observables as ECSV text, as astropy writes it.
``explanation``
    What every file of observables says of itself: conventions, program, camera, kernels.
``files``
    ECSV, CSV and JSON, written and read back; observables of a ``result.json``.
``tdm``
    The CCSDS Tracking Data Message, written and read back.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.observables.explanation import Origin
    from opnav_workbench.observables.files import (
        csv_text,
        ecsv_text,
        observables_dict,
        observables_table,
        read_csv,
        read_ecsv,
        read_json,
        read_with_origins,
        table_observables,
        write_csv,
        write_ecsv,
        write_observables_json,
    )
    from opnav_workbench.observables.observable import Observable, cross_covariance_px2, joint_covariance_px2
    from opnav_workbench.observables.observing import center_cross, observe
    from opnav_workbench.observables.partials import (
        analytic_position_partials,
        analytic_target_partials,
        numerical_position_partials,
        numerical_target_partials,
    )
    from opnav_workbench.observables.tdm import (
        TdmOptions,
        TrackingMessage,
        parse_tdm,
        read_tdm,
        tdm_table,
        tdm_text,
        write_tdm,
    )
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "Origin": "explanation",
            "csv_text": "files",
            "observables_dict": "files",
            "observables_table": "files",
            "read_csv": "files",
            "read_ecsv": "files",
            "read_json": "files",
            "read_with_origins": "files",
            "table_observables": "files",
            "write_csv": "files",
            "ecsv_text": "files",
            "write_ecsv": "files",
            "write_observables_json": "files",
            "Observable": "observable",
            "cross_covariance_px2": "observable",
            "joint_covariance_px2": "observable",
            "center_cross": "observing",
            "observe": "observing",
            "analytic_position_partials": "partials",
            "analytic_target_partials": "partials",
            "numerical_position_partials": "partials",
            "numerical_target_partials": "partials",
            "TdmOptions": "tdm",
            "TrackingMessage": "tdm",
            "parse_tdm": "tdm",
            "read_tdm": "tdm",
            "tdm_table": "tdm",
            "tdm_text": "tdm",
            "write_tdm": "tdm",
        },
    )

__all__ = [
    "Observable",
    "Origin",
    "TdmOptions",
    "TrackingMessage",
    "analytic_position_partials",
    "analytic_target_partials",
    "center_cross",
    "cross_covariance_px2",
    "csv_text",
    "ecsv_text",
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
    "read_with_origins",
    "table_observables",
    "tdm_table",
    "tdm_text",
    "write_csv",
    "write_ecsv",
    "write_observables_json",
    "write_tdm",
]
