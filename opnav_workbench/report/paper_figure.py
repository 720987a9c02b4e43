"""Figures in the manner of the paper: panels with colour bars, a correlation peak with its paraboloid, captions.

    figure = panels_figure([PaperPanel(template, "template star"), PaperPanel(data, "sub-image", first=(410, 233))])
    captioned(figure, "Figure 4", "Left: the template star. Right: the star of unknown center.")

Arrays are indexed ``[line, pixel]``; lines grow downward. The figures are those of Jackman & Dumont (2013), AAS 13-443.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from opnav_workbench.report.paper_caption import CaptionedFigure, captioned
from opnav_workbench.report.paper_panel import PaperMarks, PaperPanel, draw_paper_panel, sky_panel
from opnav_workbench.starcenters.peaks import paraboloid_coefficients

__all__ = [
    "CaptionedFigure",
    "PaperMarks",
    "PaperPanel",
    "captioned",
    "panels_figure",
    "peak_figure",
    "sky_panel",
]

PANEL_WIDTH_INCH, AROUND_INCH, BAR_INCH, AXIS_INCH = 4.3, 0.75, 0.85, 0.35
TITLE_INCH, LEGEND_INCH = 0.3, 0.35
LARGEST_WIDTH_INCH = 14.5
PEAK_PX = 1.5  # the paraboloid is drawn this far to either side of its largest sample
AROUND_PEAK = 4  # samples of the surface on either side, in the relief
VIEW_DEG = (24.0, -58.0)  # elevation and azimuth from which the relief is seen
TICKS = 5


def panels_figure(panels: Sequence[PaperPanel], *, columns: int = 3, title: str = "") -> Figure:
    """Draw pictures side by side, each with its axes and colour bar.

    Parameters
    ----------
    panels : sequence of PaperPanel
    columns : int
        Most panels in a row.
    title : str
        Above all of them.

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window; marks with labels have a legend below.
    """
    across = min(columns, len(panels))
    down = -(-len(panels) // across)
    n_line, n_pixel = np.shape(panels[0].values)
    width = min(across * (PANEL_WIDTH_INCH + BAR_INCH), LARGEST_WIDTH_INCH)
    side = width / across - BAR_INCH - AXIS_INCH
    height = down * (side * float(np.clip(n_line / n_pixel, 0.2, 2.0)) + AROUND_INCH)
    entries = _entries(panels)
    figure = _blank(width, height + TITLE_INCH * bool(title) + LEGEND_INCH * bool(entries), title)
    axes = figure.subplots(down, across, squeeze=False)
    for number, panel in enumerate(panels):
        draw_paper_panel(axes.flat[number], panel)
    for spare in axes.flat[len(panels) :]:
        spare.set_axis_off()
    if entries:
        figure.legend(handles=entries, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def peak_figure(
    panel: PaperPanel, *, paraboloid_title: str = "paraboloid through the highest samples"
) -> Figure:
    """Draw a correlation surface, and the paraboloid fitted to its peak as a relief (the paper's Figures 5 and 7).

    Parameters
    ----------
    panel : PaperPanel
        The surface; its largest value must not lie on the rim.

    Returns
    -------
    matplotlib.figure.Figure
        Left the surface with the top of the paraboloid marked, right samples near the peak and the paraboloid.
    """
    figure = _blank(2.0 * PANEL_WIDTH_INCH + BAR_INCH + 0.6, PANEL_WIDTH_INCH + AROUND_INCH, "")
    cells = figure.add_gridspec(1, 2, width_ratios=(1.12, 1.0))
    left = figure.add_subplot(cells[0, 0])
    draw_paper_panel(left, panel)
    _draw_relief(figure.add_subplot(cells[0, 1], projection="3d"), panel)
    figure.axes[-1].set_title(paraboloid_title, fontsize=10)
    return figure


def _blank(width_inch: float, height_inch: float, title: str) -> Figure:
    figure = Figure(figsize=(width_inch, height_inch), layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.08))
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _entries(panels: Sequence[PaperPanel]) -> list[Line2D]:
    """Legend entries of all marks with a label, each once."""
    labelled = {marks.label: marks for panel in panels for marks in panel.marks if marks.label}
    style: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "none", "markersize": 10}
    symbols = {"circle": "o", "box": "s", "cross": "+"}
    return [
        Line2D([], [], marker=symbols[marks.shape], color=marks.color, label=label, **style)
        for label, marks in labelled.items()
    ]


def _draw_relief(axes: Any, panel: PaperPanel) -> None:
    values = np.asarray(panel.values, dtype=np.float64)
    row, column = (
        int(i) for i in np.unravel_index(np.nanargmax(values[1:-1, 1:-1]), np.array(values.shape) - 2)
    )
    row, column = row + 1, column + 1
    window = np.s_[
        max(row - AROUND_PEAK, 0) : row + AROUND_PEAK + 1,
        max(column - AROUND_PEAK, 0) : column + AROUND_PEAK + 1,
    ]
    line, pixel = np.indices(values.shape)[(slice(None), *window)]
    line, pixel = line + float(panel.first[1]), pixel + float(panel.first[0])
    axes.plot_wireframe(pixel, line, values[window], color="0.55", linewidth=0.7)
    y, x = np.mgrid[-PEAK_PX:PEAK_PX:25j, -PEAK_PX:PEAK_PX:25j]
    c = paraboloid_coefficients(values[None, row - 1 : row + 2, column - 1 : column + 2])[0]
    bowl = c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * y * y + c[5] * x * y
    bowl[bowl < np.nanmin(values[window])] = np.nan
    at = x + column + float(panel.first[0]), y + row + float(panel.first[1])
    axes.plot_surface(*at, bowl, cmap="viridis", alpha=0.75, linewidth=0)
    axes.set_xlabel("pixel", fontsize=9)
    axes.set_ylabel("line", fontsize=9)
    axes.set_zlabel(panel.bar, fontsize=9, labelpad=6)
    axes.tick_params(labelsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(TICKS, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(TICKS, integer=True))
    axes.invert_yaxis()
    axes.view_init(elev=VIEW_DEG[0], azim=VIEW_DEG[1])
