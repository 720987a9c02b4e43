"""What the notebooks of the paper show: panels with colour bars, captions, tables of comparison.

    figure = panels_figure([PaperPanel(template, "template star"), PaperPanel(data, "sub-image", first=(410, 233))])
    captioned(figure, "Figure 4", "Left: the template star. Right: the star of unknown center.")
    paper_comparison([PaperRow("pixel", 8.46, 8.50, "px")])

Arrays are indexed ``[line, pixel]``; lines grow downward. Figures and published values are those of Jackman &
Dumont (2013), AAS 13-443. A comparison is shown by a notebook and written as ECSV for the tests.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np
from astropy.stats import mad_std
from astropy.table import Column, Table
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator
from scipy import ndimage

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.files import atomic_path
from opnav_workbench.report.drawing import new_figure, png_bytes
from opnav_workbench.report.pages import render_template
from opnav_workbench.stars.peaks import paraboloid_coefficients
from opnav_workbench.templating import png_url

__all__ = [
    "PaperMarks",
    "PaperPanel",
    "PaperRow",
    "captioned",
    "panels_figure",
    "paper_comparison",
    "peak_figure",
    "shown_table",
    "sky_panel",
]


# ---- A figure with its number and caption, as a notebook shows it.


@dataclass(frozen=True, slots=True, eq=False)
class CaptionedFigure:
    """A figure with its number and caption, as a notebook shows it.

    Attributes
    ----------
    number
        "Figure 4".
    caption
        Plain text.
    """

    png: bytes
    number: str
    caption: str

    def _repr_html_(self) -> str:
        return render_template(
            "captioned_figure.html", picture=png_url(self.png), number=self.number, caption=self.caption
        )


def captioned(figure: Figure, number: str, caption: str) -> CaptionedFigure:
    """Return a figure with its caption; the last expression of a notebook's cell shows it.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> shown = captioned(Figure(figsize=(1.0, 1.0)), "Figure 4", "A star.")
    >>> "<b>Figure 4.</b> A star." in shown._repr_html_()
    True
    """
    return CaptionedFigure(png_bytes(figure), number, caption)


# ---- One picture of a paper's figure: an array with its axes, colour bar and marks.

GREEN = "#00C853"
# The stretch of a large picture ends at these percentiles, so that a hot pixel does not darken the rest.
DARKEST_PERCENT, BRIGHTEST_PERCENT = 1.0, 99.9
SMALL_PIXELS = 64 * 64  # a picture with no more than these is shown from its least to its largest value
MANY_PIXELS = 400  # along a side: more than a panel has points
LOG_RANGE = 300.0  # brightest over darkest of a logarithmic stretch
# A sky picture is smoothed by this and each pixel shows the brightest of its neighbours: a star stays visible in a figure
# that has fewer points than the picture pixels. Shown are these multiples of the noise above two sigmas below the sky.
SKY_SMOOTHING_PX, SKY_NEIGHBOURS_PX = 1.0, 3
SKY_SIGMAS = (2.5, 250.0)


@dataclass(frozen=True, slots=True, eq=False)
class PaperMarks:
    """Places marked in a panel.

    Attributes
    ----------
    pixel_line : (n, 2) array
    label
        For the legend; empty: none.
    size_px
        Radius of the circles, half width of the boxes, half length of a cross.
    """

    pixel_line: FloatArray
    label: str = ""
    shape: Literal["circle", "box", "cross"] = "circle"
    size_px: float = 12.0
    color: str = GREEN

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class PaperPanel:
    """One picture of a figure.

    Attributes
    ----------
    values : (n_line, n_pixel) array
        May hold nan, which is left blank.
    bar
        What the colour bar counts; empty: no bar.
    first : (2,) sequence of float
        Pixel and line of the array's first element.
    stretch
        Signed: even about zero, red for more and blue for less.
    limits : (2,) sequence of float, optional
        Values at the ends of the colours; default from the values.
    color_map
        Matplotlib's name.
    """

    values: FloatArray
    title: str = ""
    bar: str = "DN"
    first: Sequence[float] = (0.0, 0.0)
    stretch: Literal["linear", "log", "signed"] = "linear"
    limits: Sequence[float] | None = None
    color_map: str = ""
    marks: Sequence[PaperMarks] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge of the picture, px."""
        n_line, n_pixel = np.shape(self.values)
        left, top = (float(value) - 0.5 for value in self.first)
        return left, left + n_pixel, top + n_line, top


def sky_panel(
    image_dn: FloatArray,
    title: str = "",
    marks: Sequence[PaperMarks] = (),
    first: Sequence[float] = (0.0, 0.0),
) -> PaperPanel:
    """Return a picture of stars in a logarithmic gray stretch, lightly smoothed, black just above the sky.

    Examples
    --------
    >>> image = np.random.default_rng(1).normal(size=(64, 64))
    >>> image[20, 30] = 500.0
    >>> panel = sky_panel(image)
    >>> [int(i) for i in np.unravel_index(panel.values.argmax(), (64, 64))], panel.stretch
    ([19, 29], 'log')
    """
    smooth = ndimage.gaussian_filter(
        np.nan_to_num(image_dn, nan=float(np.nanmedian(image_dn))), SKY_SMOOTHING_PX
    )
    level = float(np.median(smooth))
    noise = float(mad_std(smooth)) or 1.0
    sigmas = ndimage.maximum_filter((smooth - level) / noise + 2.0, SKY_NEIGHBOURS_PX)
    return PaperPanel(sigmas, title, "", first, "log", SKY_SIGMAS, "gray", marks)


def draw_paper_panel(axes: Axes, panel: PaperPanel) -> None:
    """Draw a panel into its axes."""
    norm = _norm(panel)
    name = panel.color_map or ("RdBu_r" if panel.stretch == "signed" else "viridis")
    values = np.asarray(panel.values, dtype=np.float64)
    if panel.stretch == "log":
        values = np.maximum(values, float(norm.vmin or 0.0))  # what is darker is black, not blank
    drawn = axes.imshow(
        values, cmap=name, norm=norm, extent=panel.extent, interpolation=_interpolation(panel)
    )
    if panel.bar:
        bar = axes.figure.colorbar(
            drawn, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0))
        )  # as high as the picture
        bar.set_label(panel.bar, fontsize=9)
        bar.ax.tick_params(labelsize=8)
    limits = axes.axis()
    for marks in panel.marks:
        _draw_paper_marks(axes, marks)
    axes.axis(limits)
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel("pixel", fontsize=9)
    axes.set_ylabel("line", fontsize=9)
    axes.tick_params(labelsize=8)


def _interpolation(panel: PaperPanel) -> Literal["nearest", "antialiased"]:
    """Square pixels where each is seen, means of several where it is not."""
    return "antialiased" if max(np.shape(panel.values)) > MANY_PIXELS else "nearest"


def _norm(panel: PaperPanel) -> Normalize:
    values = panel.values[np.isfinite(panel.values)]
    if panel.limits is not None:
        low, high = (float(value) for value in panel.limits)
    elif panel.stretch == "signed":
        high = float(np.abs(values).max(initial=0.0)) or 1.0
        low = -high
    elif values.size > SMALL_PIXELS:
        low, high = (float(p) for p in np.percentile(values, (DARKEST_PERCENT, BRIGHTEST_PERCENT)))
    else:
        low, high = float(values.min()), float(values.max())
    if panel.stretch == "log":
        return LogNorm(max(low, high / LOG_RANGE), max(high, 1e-9))
    return Normalize(low, high if high > low else low + 1.0)


def _draw_paper_marks(axes: Axes, marks: PaperMarks) -> None:
    size = marks.size_px
    for pixel, line in np.atleast_2d(marks.pixel_line):
        if marks.shape == "cross":
            style: dict[str, Any] = {"color": marks.color, "linewidth": 1.4}
            axes.plot([pixel - size, pixel + size], [line, line], **style)
            axes.plot([pixel, pixel], [line - size, line + size], **style)
            continue
        outline: dict[str, Any] = {"fill": False, "edgecolor": marks.color, "linewidth": 1.1}
        if marks.shape == "circle":
            axes.add_patch(Circle((pixel, line), size, **outline))
        else:
            axes.add_patch(Rectangle((pixel - size, line - size), 2.0 * size, 2.0 * size, **outline))


# ---- Figures in the manner of the paper.

PANEL_WIDTH_INCH, AROUND_INCH, BAR_INCH, AXIS_INCH = 4.3, 0.75, 0.85, 0.35
TITLE_INCH, LEGEND_INCH = 0.3, 0.35
PADS_INCH = (0.06, 0.08)
LARGEST_WIDTH_INCH = 14.5
PEAK_PX = 1.5  # the paraboloid is drawn this far to either side of its largest sample
AROUND_PEAK = 4  # samples of the surface on either side, in the relief
VIEW_DEG = (24.0, -58.0)  # elevation and azimuth from which the relief is seen
TICKS = 5


def panels_figure(panels: Sequence[PaperPanel], *, columns: int = 3, title: str = "") -> Figure:
    """Draw pictures side by side, each with its axes and colour bar.

    Parameters
    ----------
    columns
        Most panels in a row.
    title
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
    entries = _legend_entries(panels)
    figure = new_figure(
        width,
        height + TITLE_INCH * bool(title) + LEGEND_INCH * bool(entries),
        title,
        pads_inch=PADS_INCH,
        fontsize=11,
    )
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
    panel
        The surface; its largest value must not lie on the rim.

    Returns
    -------
    matplotlib.figure.Figure
        Left the surface with the top of the paraboloid marked, right samples near the peak and the paraboloid.
    """
    figure = new_figure(
        2.0 * PANEL_WIDTH_INCH + BAR_INCH + 0.6, PANEL_WIDTH_INCH + AROUND_INCH, pads_inch=PADS_INCH
    )
    cells = figure.add_gridspec(1, 2, width_ratios=(1.12, 1.0))
    left = figure.add_subplot(cells[0, 0])
    draw_paper_panel(left, panel)
    _draw_relief(figure.add_subplot(cells[0, 1], projection="3d"), panel)
    figure.axes[-1].set_title(paraboloid_title, fontsize=10)
    return figure


def _legend_entries(panels: Sequence[PaperPanel]) -> list[Line2D]:
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


# ---- Published values beside ours, as a table for a notebook and a file for the tests.

UNKNOWN = float("nan")
DASH = "–"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """A quantity of the paper, and ours.

    Attributes
    ----------
    paper
        None: the paper gives no number.
    digits
        After the point.
    remark
        Why they differ, or where a number comes from.
    difference
        Whether the difference means something.
    """

    quantity: str
    paper: float | None
    here: float | None
    unit: str = ""
    digits: int = 2
    remark: str = ""
    difference: bool = True

    @property
    def cells(self) -> tuple[str, str, str, str, str, str]:
        """What the table shows: quantity, unit, paper, here, difference, remark."""
        paper, here = (self._text(value) for value in (self.paper, self.here))
        both = self.paper is not None and self.here is not None and self.difference
        change = self._text(float(self.here) - float(self.paper), "+") if both else DASH  # type: ignore[arg-type]
        return self.quantity, self.unit, paper, here, change, self.remark

    def _text(self, value: float | None, sign: str = "") -> str:
        return DASH if value is None or not isfinite(value) else f"{value:{sign}.{self.digits}f}"


@dataclass(frozen=True, slots=True, eq=False)
class PaperComparison:
    """A table of published and own values; a notebook shows it, `write` keeps it."""

    rows: tuple[PaperRow, ...]
    title: str = ""
    source: str = "paper"  # heading of the published values

    def table(self) -> Table:
        """Return a row per quantity; nan where a number is not known."""
        rows = self.rows
        return Table(
            [
                Column([r.quantity for r in rows], "quantity", description="what is compared"),
                Column([r.unit for r in rows], "unit", description="of both values"),
                Column(
                    [_nan_if_none(r.paper) for r in rows],
                    "paper",
                    description="AAS 13-443; nan: gives no number",
                ),
                Column([_nan_if_none(r.here) for r in rows], "here", description="this run"),
                Column([r.remark for r in rows], "remark"),
            ]
        )

    def write(self, path: str | Path) -> Path:
        """Write the table as ECSV, whole or not at all; return its path."""
        with atomic_path(path) as temporary:
            self.table().write(temporary, format="ascii.ecsv", overwrite=True)
        return Path(path)

    def _repr_html_(self) -> str:
        names = ["", "unit", self.source, "here", f"here − {self.source}", "remark"]
        columns = [list(column) for column in zip(*(row.cells for row in self.rows), strict=True)]
        kept = [i for i, column in enumerate(columns) if any(cell not in ("", DASH) for cell in column)]
        return _html_table(
            [names[i] for i in kept], [columns[i] for i in kept], [i in (2, 3, 4) for i in kept], self.title
        )


@dataclass(frozen=True, slots=True, eq=False)
class ShownTable:
    """A table as a paper prints it: units under the names, no types, no row numbers."""

    content: Table
    title: str = ""

    def _repr_html_(self) -> str:
        columns = list(Table(self.content).itercols())  # quantities become columns
        units = ["" if column.unit is None else f" ({column.unit})" for column in columns]
        names = [f"{column.info.name}{unit}" for column, unit in zip(columns, units, strict=True)]
        cells = [column.pformat(show_name=False, show_unit=False, max_lines=-1) for column in columns]
        numeric = [column.dtype.kind in "if" for column in columns]
        return _html_table(
            names, [[_cell_text(cell) for cell in column] for column in cells], numeric, self.title
        )


def paper_comparison(rows: Sequence[PaperRow], title: str = "", source: str = "paper") -> PaperComparison:
    """Return a table of published values beside ours; `source` heads the column of published ones.

    Examples
    --------
    >>> rows = [PaperRow("pixel", 8.46, 8.50, "px"), PaperRow("line", 10.37, None, "px")]
    >>> print(paper_comparison(rows).table()["here"].tolist())
    [8.5, nan]
    >>> rows[0].cells[2:5]
    ('8.46', '8.50', '+0.04')
    """
    return PaperComparison(tuple(rows), title, source)


def shown_table(table: Table, title: str = "") -> ShownTable:
    """Return a table as a notebook shows it in print; the last expression of a cell.

    Examples
    --------
    >>> shown = shown_table(Table({"star": ["a"], "mag": [8.25]}), "Stars")
    >>> "Stars" in shown._repr_html_(), ">8.25<" in shown._repr_html_()
    (True, True)
    """
    return ShownTable(table, title)


def _nan_if_none(value: float | None) -> float:
    return UNKNOWN if value is None else float(value)


def _cell_text(cell: str) -> str:
    """Return a number's text without the padding, and a dash where there is none."""
    return DASH if cell.strip() in ("nan", "+nan", "--") else cell.strip()


def _html_table(
    names: Sequence[str], columns: Sequence[Sequence[str]], numeric: Sequence[bool], title: str
) -> str:
    """Return a table in which numbers stand at the right, and only words after the first column may wrap."""
    heads = [
        (name, "right" if number else "left", not number and i > 0)
        for i, (name, number) in enumerate(zip(names, numeric, strict=True))
    ]
    return render_template(
        "paper_table.html", title=title, columns=heads, rows=list(zip(*columns, strict=True))
    )
