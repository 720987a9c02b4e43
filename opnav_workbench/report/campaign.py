"""Figures of a campaign: the trends of its pictures, and a stack of them.

Trends: O-C of bodies, pointing error, star residuals, detections against magnitude; pixel components are blue, line
components vermilion (Okabe & Ito), outliers are ringed. Stack: one picture, the stack, both in units of their own
noise, and how the signal-to-noise ratio grows with the number of pictures.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.campaign import Comparison, Completeness, Series, Trends
from opnav_workbench.campaign.comparison import axes_of
from opnav_workbench.campaign.stacking import Growth, Stacked
from opnav_workbench.campaign.stacking.grid import resample
from opnav_workbench.constants import DAY_S, HOUR_S
from opnav_workbench.report.drawing import (
    GREEN,
    LINE_COLOR,
    PIXEL_COLOR,
    PREDICTED_COLOR,
    PURPLE,
    VERMILION,
    new_figure,
)

__all__ = ["comparison_figure", "stack_figure", "trends_figure"]


# ---- Trends of a campaign in one figure.

TWIST_COLOR, OUTLIER_COLOR, GREY = GREEN, PURPLE, "0.6"
FEW_DAYS = 3.0  # below this the axis counts hours
PANEL_HEIGHT, WIDTH = 2.7, 12.0
MANY = 2000  # points of a series; beyond, error bars and full dots would hide all but the outermost


def trends_figure(trends: Trends, title: str = "") -> Figure:
    """Draw all trends: a panel for each body and method, one each for pointing, twist, residuals and detections."""
    panels = [*trends.bodies.values(), trends.pointing[:2], (trends.pointing[2],), (trends.residual,)]
    rows = len(panels) // 2 + 1
    figure = new_figure(WIDTH, PANEL_HEIGHT * rows, title)
    axes = figure.subplots(rows, 2, squeeze=False).ravel()
    start, scale, span, unit = _time_axis([series for panel in panels for series in panel])
    for axis, panel in zip(axes, panels, strict=False):
        series_axes(axis, panel, start, scale)
        axis.set_xlabel(f"{unit} since the first picture")
        axis.set_xlim(-0.03 * span, 1.03 * span)
    completeness_axes(axes[len(panels)], trends.detections)
    for spare in axes[len(panels) + 1 :]:
        spare.set_axis_off()
    return figure


def series_axes(axes: Axes, panel: Sequence[Series], start_et: float = 0.0, scale_s: float = 1.0) -> None:
    """Draw series of one quantity with their error bars, robust levels and outliers."""
    for series, color in zip(panel, _series_colors(panel), strict=True):
        time = (series.et - start_et) / scale_s
        value, sigma = np.asarray(series.value), np.where(np.isfinite(series.sigma), series.sigma, 0.0)
        label = series.name.rpartition(" ")[2] if len(panel) > 1 else None
        if len(value) <= MANY:
            _error_bars(axes, np.asarray(time), value, sigma, color)
            axes.plot(time, value, "o", color=color, markersize=3.5, label=label)
        else:
            axes.plot(time, value, "o", color=color, markersize=1.5, markeredgewidth=0.0, alpha=0.4)
            axes.plot([], [], "o", color=color, markersize=3.5, label=label)
        axes.plot(time, series.screened.level, color=color, linewidth=0.8, alpha=0.6)
        off = series.outlier
        axes.plot(
            time[off], series.value[off], "o", mfc="none", mec=OUTLIER_COLOR, mew=1.6, markersize=10, zorder=5
        )
    axes.axhline(0.0, color="0.3", linewidth=0.6)
    axes.set_title(_heading(panel), fontsize="medium")
    axes.set_ylabel(panel[0].unit)
    if not any(len(series) for series in panel):
        axes.text(0.5, 0.5, "no measurement", transform=axes.transAxes, ha="center", color=GREY)
    elif len(panel) > 1:
        axes.legend(
            loc="upper right", fontsize="small", ncols=2
        )  # the best place among 10,000 points takes long to find


def comparison_figure(found: Comparison, title: str = "") -> Figure:
    """Draw what moved between two archives, in sigmas: a panel for the pointing, one for each body and method."""
    names = sorted({d.what for d in found.differences}, key=lambda what: (what != "pointing", what))
    figure = new_figure(WIDTH, PANEL_HEIGHT * max(len(names), 1), title)
    axes = figure.subplots(max(len(names), 1), 1, squeeze=False, sharex=True).ravel()
    times = np.array([d.et for d in found.differences])
    start, scale, span, unit = _time_span(times)
    for axis, name in zip(axes, names, strict=False):
        rows = found.of(name)
        time = (np.array([d.et for d in rows]) - start) / scale
        moved = np.array([d.moved / d.sigma for d in rows])
        colors = (PIXEL_COLOR, LINE_COLOR, TWIST_COLOR)
        for component, color, values in zip(axes_of(name), colors, moved.T, strict=False):
            axis.plot(time, values, "o", color=color, markersize=3.5, label=component)
        axis.axhspan(-1.0, 1.0, color="0.92", zorder=0)
        axis.axhline(0.0, color="0.3", linewidth=0.6)
        axis.set_title(name if name == "pointing" else f"{name}: O-C", fontsize="medium")
        axis.set_ylabel("second - first, sigmas")
        axis.legend(loc="best", fontsize="small", ncols=3)
    if not names:
        axes[0].text(0.5, 0.5, "nothing solved in both", transform=axes[0].transAxes, ha="center", color=GREY)
    axes[-1].set_xlim(-0.03 * span, 1.03 * span)
    axes[-1].set_xlabel(f"{unit} since the first picture")
    return figure


def _error_bars(axes: Axes, x: FloatArray, y: FloatArray, sigma: FloatArray, color: str) -> None:
    """Draw error bars as one line with gaps: 10,000 lines of their own take ten times as long."""
    gap = np.full(len(x), np.nan)
    ends = np.stack([y - sigma, y + sigma, gap], axis=1)
    axes.plot(np.stack([x, x, gap], axis=1).ravel(), ends.ravel(), color=color, linewidth=0.9)


def completeness_axes(axes: Axes, found: Completeness) -> None:
    """Draw the detected share against magnitude, with the logistic curve and the number of stars in each bin."""
    axes.set(xlabel="magnitude", ylabel="detected share", ylim=(-0.05, 1.12))
    axes.set_title("detections against magnitude", fontsize="medium")
    filled = found.stars > 0
    if not filled.any():
        axes.text(0.5, 0.5, "no stars", transform=axes.transAxes, ha="center", color=GREY)
        return
    share, mag = found.share[filled], found.mag[filled]
    below, above = share - found.low[filled], found.high[filled] - share
    axes.errorbar(
        mag, share, np.maximum([below, above], 0.0), fmt="o", color=PIXEL_COLOR, markersize=4, elinewidth=0.9
    )
    for x, y, count in zip(mag, found.high[filled], found.stars[filled], strict=True):
        axes.annotate(str(count), (x, y), (0, 3), textcoords="offset points", ha="center", fontsize="x-small")
    if np.isfinite(found.half_mag):
        step = np.linspace(mag[0] - 0.5, mag[-1] + 0.5, 200)
        sigma = f" ± {found.half_mag_sigma:.2f}" if np.isfinite(found.half_mag_sigma) else ""
        axes.plot(step, found.curve(step), color=GREY, label=f"half at {found.half_mag:.2f}{sigma} mag")
        axes.legend(loc="lower left", fontsize="small")


def _series_colors(panel: Sequence[Series]) -> tuple[str, ...]:
    if len(panel) > 1:
        return (PIXEL_COLOR, LINE_COLOR)
    return (TWIST_COLOR if panel[0].unit == "deg" else PIXEL_COLOR,)


def _heading(panel: Sequence[Series]) -> str:
    name = panel[0].name
    return name.rpartition(" ")[0].rstrip(",") if len(panel) > 1 else name


def _time_axis(series: Sequence[Series]) -> tuple[float, float, float, str]:
    """Start (ET), seconds a unit, length in units, and the unit's name, of an axis that fits the campaign."""
    return _time_span(np.concatenate([s.et for s in series] or [np.zeros(0)]))


def _time_span(times: FloatArray) -> tuple[float, float, float, str]:
    times = times[np.isfinite(times)]
    if not times.size:
        return 0.0, HOUR_S, 1.0, "hours"
    start, span = float(times.min()), float(np.ptp(times))
    scale, unit = (DAY_S, "days") if span > FEW_DAYS * DAY_S else (HOUR_S, "hours")
    return start, scale, span / scale or 1.0, unit


# ---- A stack in one figure: one picture, the stack, its noise, and how the signal-to-noise ratio grows.

FOUND_COLOR, ROOT_COLOR = VERMILION, "0.6"
LOW_SIGMAS, HIGH_SIGMAS = -2.0, 8.0  # of the shown picture: noise is seen, and a target of SNR 5
MARK_PX = 3.0
CUT_PX = 24.0  # half the side that is shown about a target: enough to see it


def stack_figure(
    stacked: Stacked, center: BodyCenter | None = None, growth: Growth | None = None, title: str = ""
) -> Figure:
    """Draw one picture beside the stack, both in units of their own noise, and the growth of the SNR.

    Parameters
    ----------
    center
        The target; it is marked, and the panels show its surroundings.
    growth
        Without it, the third panel shows how many pictures each pixel has.
    """
    figure = new_figure(13.0, 4.6, title)
    single, together, last = figure.subplots(1, 3)
    number = len(stacked.pictures) // 2
    image, variance = resample(stacked.grid, stacked.pictures[number], float(stacked.response[number]))
    _draw_sigmas(single, stacked, image / np.sqrt(variance), f"one picture: {stacked.pictures[number].name}")
    words = "star field subtracted" if stacked.subtractions is not None else f"on the {_grid_words(stacked)}"
    _draw_sigmas(
        together, stacked, stacked.image_dn / stacked.noise_dn, f"stack of {len(stacked.pictures)}, {words}"
    )
    figure.colorbar(together.images[0], ax=[single, together], label="DN over noise", shrink=0.8)
    for axes in (single, together):
        _mark_target(axes, stacked, center)
    if growth is None:
        _draw_counts(last, stacked)
    else:
        _draw_growth(last, growth)
    return figure


def _grid_words(stacked: Stacked) -> str:
    return "target's motion" if stacked.grid.follow == "target" else "stars"


def _extent(stacked: Stacked) -> tuple[float, float, float, float]:
    n_line, n_pixel = stacked.grid.shape
    left, top = stacked.grid.first - 0.5
    return float(left), float(left + n_pixel), float(top + n_line), float(top)


def _draw_sigmas(axes: Axes, stacked: Stacked, sigmas: FloatArray, title: str) -> None:
    axes.imshow(sigmas, cmap="gray", vmin=LOW_SIGMAS, vmax=HIGH_SIGMAS, extent=_extent(stacked))
    axes.set_title(title, fontsize="medium")
    axes.set(xlabel="pixel", ylabel="line")


def _mark_target(axes: Axes, stacked: Stacked, center: BodyCenter | None) -> None:
    expected = stacked.predicted_px
    if np.isfinite(expected).all():
        axes.plot(*expected, "+", color=PREDICTED_COLOR, markersize=9, label="predicted")
    if center is not None and center.pixel_line is not None:
        place = (float(center.pixel_line[0]), float(center.pixel_line[1]))
        axes.add_patch(
            Circle(place, MARK_PX, fill=False, edgecolor=FOUND_COLOR, linewidth=1.2, label="found")
        )
    if center is not None and np.isfinite(expected).all():
        left, right, bottom, top = _extent(stacked)
        axes.set_xlim(max(left, expected[0] - CUT_PX), min(right, expected[0] + CUT_PX))
        axes.set_ylim(min(bottom, expected[1] + CUT_PX), max(top, expected[1] - CUT_PX))
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right", fontsize="small")


def _draw_counts(axes: Axes, stacked: Stacked) -> None:
    drawn = axes.imshow(stacked.count, cmap="viridis", extent=_extent(stacked))
    axes.figure.colorbar(drawn, ax=axes, label="pictures in each pixel", shrink=0.8)
    axes.set(xlabel="pixel", ylabel="line", title="coverage")


def _draw_growth(axes: Axes, growth: Growth) -> None:
    """Growth of flux over sigma beside that of the root of the number, through the whole stack."""
    flux, most = float(growth.flux_dn[-1]), int(growth.pictures[-1])
    count = np.linspace(0.0, most, 200)
    root = flux / growth.flux_sigma_dn[-1] * np.sqrt(count / most)
    axes.plot(count, root, "--", color=ROOT_COLOR, label="square root of the number")
    snr = flux / growth.flux_sigma_dn
    axes.plot(growth.pictures, snr, "o", color=FOUND_COLOR, label="flux of the stack over sigma")
    axes.set(xlabel="pictures", ylabel="signal-to-noise ratio", title="growth", xlim=(0, None))
    axes.legend(fontsize="small", loc="lower right")
