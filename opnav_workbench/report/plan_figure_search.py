"""Figures of a plan's approach searches and of the best exposure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from opnav_workbench.planning import Approach, BestExposure, PicturePlan

__all__ = ["exposure_figure", "search_figure"]

SINGLE, STACK, LIMIT, SUN = "#0072B2", "#009E73", "#D55E00", "#E69F00"  # Okabe & Ito
DAY_S = 86_400.0
ROOM_BELOW = 0.25
CURVES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def search_figure(approach: Approach) -> Figure:
    """Draw the signal-to-noise ratio over the search, with the threshold and the epochs of first detection."""
    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    search = approach.search
    head = f"{search.name}: {search.target} with {search.camera}, {search.exposure_s:g} s"
    axes.set_title(head, fontsize=9, loc="left")
    if approach.problem:
        axes.text(0.5, 0.5, approach.problem, ha="center", va="center", wrap=True, transform=axes.transAxes)
        axes.set_axis_off()
        return figure
    days = (approach.et - approach.et[0]) / DAY_S
    axes.semilogy(days, approach.snr, color=SINGLE, label="single picture")
    if search.stack > 1:
        stacked = np.sqrt(search.stack) * approach.snr
        axes.semilogy(days, stacked, color=STACK, label=f"{search.stack} stacked")
    axes.axhline(search.snr, color=LIMIT, linewidth=1.0, linestyle="--", label=f"SNR {search.snr:g}")
    axes.set_ylim(
        bottom=ROOM_BELOW * min(float(approach.snr.min()), search.snr)
    )  # for the words at the threshold
    _mark_detections(axes, approach)
    if approach.keep_out.any():
        low, high = axes.get_ylim()
        axes.fill_between(
            days, low, high, where=approach.keep_out, color=SUN, alpha=0.2, label="Sun too near"
        )
    axes.set_xlabel(f"days since {search.start.isoformat().replace('T', ' ')}", fontsize=8)
    axes.set_ylabel("SNR", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.5)
    axes.legend(fontsize=7, loc="upper left")
    return figure


def _mark_detections(axes: Axes, approach: Approach) -> None:
    for detection, color, height in zip(approach.detections, (SINGLE, STACK), (0.03, 0.16), strict=False):
        if not detection.utc:
            continue
        # The epoch stands where the range curve has the detection's range: the times are those of the curve.
        order = np.argsort(approach.range_km)
        et = np.interp(detection.range_km, approach.range_km[order], approach.et[order])
        day = float((et - approach.et[0]) / DAY_S)
        axes.axvline(day, color=color, linewidth=0.9, linestyle=":")
        axes.annotate(
            f" {detection.utc[:16].replace('T', ' ')}\n {detection.range_km:.3g} km",
            (day, height),
            xycoords=axes.get_xaxis_transform(),
            fontsize=7,
            color=color,
        )


def exposure_figure(pictures: Sequence[PicturePlan]) -> Figure:
    """Draw the target's expected error against exposure for some pictures; dots mark the best."""
    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for plan, color in zip(pictures, CURVES * len(pictures), strict=False):
        best = None if plan.prospect is None else plan.prospect.best
        if best is not None and np.isfinite(best.sigma_px).any():
            _curve(axes, plan, best, color)
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("exposure, s (line: planned; dot: best)", fontsize=8)
    axes.set_ylabel("error of target among stars, px", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.5)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, loc="best", ncols=2)
    return figure


def _curve(axes: Axes, plan: PicturePlan, best: BestExposure, color: str) -> None:
    axes.plot(
        best.exposure_s,
        best.sigma_px,
        color=color,
        linewidth=1.2,
        label=f"{plan.name}, best {best.best_s:.3g} s",
    )
    axes.plot(best.best_s, np.nanmin(best.sigma_px), "o", color=color, markersize=6)
    axes.axvline(plan.picture.exposure_s, color=color, linewidth=0.7, linestyle="--", alpha=0.6)
