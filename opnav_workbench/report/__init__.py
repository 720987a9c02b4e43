"""Pictures that a navigator shows: the frame with its stars and bodies, and the residuals before and after repointing."""

from opnav_workbench.report.body_figure import body_figure, body_png, write_body
from opnav_workbench.report.body_figure_methods import (
    difference_figure,
    difference_png,
    methods_figure,
    methods_png,
)
from opnav_workbench.report.body_figure_scans import scan_figure, scan_png, write_scans
from opnav_workbench.report.coverage import coverage_figure, write_coverage
from opnav_workbench.report.figure import summary_figure, summary_png, write_summary
from opnav_workbench.report.night_page import night_page

__all__ = [
    "body_figure",
    "body_png",
    "coverage_figure",
    "difference_figure",
    "difference_png",
    "methods_figure",
    "methods_png",
    "night_page",
    "scan_figure",
    "scan_png",
    "summary_figure",
    "summary_png",
    "write_body",
    "write_coverage",
    "write_scans",
    "write_summary",
]
