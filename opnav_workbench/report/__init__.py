"""Pictures that a navigator shows: the frame with its stars and bodies, and the residuals before and after repointing."""

from opnav_workbench.report.coverage import coverage_figure, write_coverage
from opnav_workbench.report.figure import summary_figure, summary_png, write_summary

__all__ = ["coverage_figure", "summary_figure", "summary_png", "write_coverage", "write_summary"]
