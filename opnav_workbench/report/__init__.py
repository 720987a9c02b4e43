"""Pictures that a navigator shows: the frame with its stars and bodies, and the residuals before and after repointing."""

from opnav_workbench.report.coverage import coverage_figure, write_coverage
from opnav_workbench.report.figure import summary_figure, summary_png, write_summary
from opnav_workbench.report.night_page import night_page

__all__ = ["coverage_figure", "night_page", "summary_figure", "summary_png", "write_coverage", "write_summary"]
