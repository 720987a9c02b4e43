"""What a navigator is shown and hands on: figures of pictures, solutions, plans and campaigns, and HTML pages.

Enter by `summary_figure` (one picture), `body_figure`, `methods_figure` and `scan_figure` (centers of a body); each
has a sister that returns a PNG for a notebook, and one that writes a file. Nothing here computes results; figures
are matplotlib's, not tied to any window.

``drawing``
    Palette, empty figures, error ellipses, PNG files: what all figures share.
``scales``
    Round scales and the shape of a picture: numbers, which the workbench shares.
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
``campaign_pages``
    The pages of an archive, made when they are asked for.
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
    How a page is made of a template in ``templates/``, and the page of a night.
``paper``
    Panels, captions and tables of comparison, for the notebooks of the paper.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.report.body_centers import (
        body_figure,
        body_png,
        difference_figure,
        difference_png,
        methods_figure,
        methods_png,
        write_body,
    )
    from opnav_workbench.report.calibration import camera_figure, psf_figure
    from opnav_workbench.report.campaign import comparison_figure, stack_figure, trends_figure
    from opnav_workbench.report.drawing import png_bytes, write_png
    from opnav_workbench.report.kernel_coverage import coverage_figure, write_coverage
    from opnav_workbench.report.limb_scans import scan_figure, scan_png, write_scans
    from opnav_workbench.report.pages import night_causes, night_pages
    from opnav_workbench.report.planning import field_chart, timeline_figure, write_plan_page
    from opnav_workbench.report.rehearsal import orbit_solution_page, score_page, solution_page
    from opnav_workbench.report.star_chart import write_star_chart
    from opnav_workbench.report.summary import summary_figure, summary_png, write_summary

__all__ = [
    "body_figure",
    "body_png",
    "camera_figure",
    "comparison_figure",
    "coverage_figure",
    "difference_figure",
    "difference_png",
    "field_chart",
    "methods_figure",
    "methods_png",
    "night_causes",
    "night_pages",
    "orbit_solution_page",
    "png_bytes",
    "psf_figure",
    "scan_figure",
    "scan_png",
    "score_page",
    "solution_page",
    "stack_figure",
    "summary_figure",
    "summary_png",
    "timeline_figure",
    "trends_figure",
    "write_body",
    "write_coverage",
    "write_plan_page",
    "write_png",
    "write_scans",
    "write_star_chart",
    "write_summary",
]

# Loaded on first use: who asks for a page of a night needs no figure, and who only might draw needs nothing.
_HOMES = {
    "body_figure": "body_centers",
    "body_png": "body_centers",
    "camera_figure": "calibration",
    "comparison_figure": "campaign",
    "coverage_figure": "kernel_coverage",
    "difference_figure": "body_centers",
    "difference_png": "body_centers",
    "field_chart": "planning",
    "methods_figure": "body_centers",
    "methods_png": "body_centers",
    "night_causes": "pages",
    "night_pages": "pages",
    "png_bytes": "drawing",
    "psf_figure": "calibration",
    "scan_figure": "limb_scans",
    "scan_png": "limb_scans",
    "orbit_solution_page": "rehearsal",
    "score_page": "rehearsal",
    "solution_page": "rehearsal",
    "stack_figure": "campaign",
    "summary_figure": "summary",
    "summary_png": "summary",
    "timeline_figure": "planning",
    "trends_figure": "campaign",
    "write_body": "body_centers",
    "write_coverage": "kernel_coverage",
    "write_plan_page": "planning",
    "write_png": "drawing",
    "write_scans": "limb_scans",
    "write_star_chart": "star_chart",
    "write_summary": "summary",
}
__getattr__ = names_on_demand(__name__, _HOMES)
