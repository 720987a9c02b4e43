"""What a navigator is shown and hands on: figures of pictures, solutions, plans and campaigns, and HTML pages.

Enter by `summary_figure` (one picture), `body_figure`, `methods_figure` and `scan_figure` (centers of a body); each
has a sister that returns a PNG for a notebook, and one that writes a file. Nothing here computes results; figures
are matplotlib's, not tied to any window.

``drawing``
    Palette, round scales, PNG files: what all figures share.
``summary``
    The summary figure of a picture: stars, residual vectors, residuals before and after repointing.
``body_panels``
    What the figures of a body's center share.
``body_centers``
    A body's center with one method, and with several side by side.
``limb_scans``
    The scans of a limb, on the picture and one by one.
``bplane``
    Solutions in the B-plane, with error ellipses and times of arrival.
``calibration``
    Star residuals of a calibrated camera, and an empirical PSF.
``campaign``
    Trends over many pictures, and a stack of them.
``kernel_coverage``
    What loaded kernels cover in time.
``star_chart``
    Catalog stars about a direction.
``planning``
    Field charts, course, searches and exposures of a plan, and its page.
``rehearsal``
    Flyby, residuals and errors of a rehearsal, and its pages.
``pages``
    How a page is made of a template, and the page of a night.
``paper``
    Panels, captions and tables of comparison, for the notebooks of the paper.
"""

from opnav_workbench.report.body_centers import (
    body_figure,
    body_png,
    difference_figure,
    difference_png,
    methods_figure,
    methods_png,
    write_body,
)
from opnav_workbench.report.kernel_coverage import coverage_figure, write_coverage
from opnav_workbench.report.limb_scans import scan_figure, scan_png, write_scans
from opnav_workbench.report.pages import night_page
from opnav_workbench.report.summary import summary_figure, summary_png, write_summary

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
