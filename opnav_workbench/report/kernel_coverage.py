"""Kernel coverage as a picture: one bar a body or structure, gaps open, overlaps hatched, the time asked as a line."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.kernels import CoverageRow, KernelCheck, utc_from_et
from opnav_workbench.report.drawing import BLUE, GREEN, SKY_BLUE, VERMILION, new_figure, write_png

__all__ = ["coverage_figure", "write_coverage"]

COLORS = {"spacecraft SPK": BLUE, "target SPK": SKY_BLUE, "CK": GREEN}
ASKED_TIME_COLOR = VERMILION
NARROWEST = 0.002  # of the axis: a shorter window would not be seen
ROW_INCH, MARGIN_INCH, WIDTH_INCH = 0.28, 1.3, 10.0
BAR_HEIGHT = 0.7
N_TICKS = 5


def write_coverage(check: KernelCheck, path: str | Path) -> None:
    """Write the coverage as PNG, whole or not at all; an LSK must be loaded."""
    write_png(coverage_figure(check), path)


def coverage_figure(check: KernelCheck) -> Figure:
    """Draw what kernels cover.

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window.
    """
    rows = [row for row in check.rows if row.needed]
    height = MARGIN_INCH + ROW_INCH * max(len(rows), 1)
    figure = new_figure(WIDTH_INCH, height)
    axes = figure.add_subplot()
    start, stop = check.plot_span_et()
    for number, row in enumerate(rows):
        _draw_row(axes, number, row, start, stop)
    if check.et is not None:
        axes.axvline(check.et, color=ASKED_TIME_COLOR, linewidth=1.2)
        axes.set_title(f"{utc_from_et(check.et, 0)} UTC", color=ASKED_TIME_COLOR, fontsize=9, loc="right")
    axes.set_title("What the kernels cover", fontsize=10, loc="left")
    axes.set_yticks(range(len(rows)), [_label(row) for row in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlim(start, stop)
    ticks = np.linspace(start, stop, N_TICKS)
    digits = 10 if stop - start > N_TICKS * DAY_S else 16
    axes.set_xticks(ticks, [utc_from_et(t, 0)[:digits].replace("T", "\n") for t in ticks], fontsize=8)
    axes.set_xlabel("UTC", fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    _draw_legend(figure)
    return figure


def _draw_row(axes: Axes, number: int, row: CoverageRow, start: float, stop: float) -> None:
    bottom = (number - BAR_HEIGHT / 2, BAR_HEIGHT)
    axes.broken_barh(_spans_on_axis(row.windows_et, start, stop), bottom, color=COLORS[row.kind])
    axes.broken_barh(
        _spans_on_axis(row.gaps_et, start, stop), bottom, color="white"
    )  # so that a short one is seen
    axes.broken_barh(
        _spans_on_axis(row.overlaps_et, start, stop),
        bottom,
        facecolor="none",
        edgecolor="white",
        hatch="////",
        linewidth=0,
    )


def _spans_on_axis(spans: FloatArray, start: float, stop: float) -> list[tuple[float, float]]:
    """Return begin and length of what of the spans lies on the axis, none of it too short to be seen."""
    inside = spans[(spans[:, 1] >= start) & (spans[:, 0] <= stop)].clip(start, stop)
    return [(a, max(b - a, NARROWEST * (stop - start))) for a, b in inside.tolist()]


def _label(row: CoverageRow) -> str:
    return f"{row.name} (CK)" if row.kind == "CK" else row.name


def _draw_legend(figure: Figure) -> None:
    handles = [Patch(color=color, label=kind) for kind, color in COLORS.items()]
    handles.append(
        Patch(facecolor="grey", edgecolor="white", hatch="////", label="two files: the later one wins")
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
