"""Figures of a picture plan: a chart of each field, and how sigmas, signal and size change over the sequence."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.planning import PicturePlan, Prospect, TargetPlan
from opnav_workbench.simulation import stretched

__all__ = ["GRADE_COLORS", "field_chart", "timeline_figure"]

STAR, UNUSABLE, BODY, OTHER = "#0072B2", "#999999", "#D55E00", "#009E73"  # Okabe & Ito
GRADE_COLORS = {"good": "#009E73", "marginal": "#E69F00", "bad": "#D55E00"}
GRADE_SIGNS = {"good": "o", "marginal": "s", "bad": "X"}
TARGET_COLORS = ("#D55E00", "#0072B2", "#CC79A7", "#E69F00")
NAMED = 8  # the brightest stars get their magnitudes
CHART_INCH, STRIP_ASPECT = 5.6, 4.0
DAY_S = 86_400.0
LEAST_RING_PX = 0.018  # of the detector: a ring that is seen


def field_chart(plan: PicturePlan) -> Figure:
    """Draw the expected picture with its stars and bodies; a picture that cannot be predicted says why.

    Parameters
    ----------
    plan : PicturePlan

    Returns
    -------
    matplotlib.figure.Figure
        Pixel to the right, line down, as on the detector.
    """
    figure = Figure(figsize=(CHART_INCH, CHART_INCH * 1.02), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(
        f"{plan.name}: {plan.verdict.grade}",
        loc="left",
        fontsize=10,
        color=GRADE_COLORS[plan.verdict.grade],
        fontweight="bold",
    )
    axes.set_title(plan.utc.replace("T", " "), loc="right", fontsize=8)
    prospect = plan.prospect
    if prospect is None:
        axes.text(
            0.5,
            0.5,
            _folded(plan.verdict.words),
            ha="center",
            va="center",
            fontsize=9,
            transform=axes.transAxes,
        )
        axes.set_axis_off()
        return figure
    _draw_field(axes, prospect)
    axes.set_xlabel(_caption(prospect), fontsize=8)
    return figure


def _draw_field(axes: Axes, p: Prospect) -> None:
    n_line, n_pixel = p.camera.n_line, p.camera.n_pixel
    axes.imshow(stretched(p.image_dn, "log"), cmap="gray_r", alpha=0.75, interpolation="antialiased")
    least = LEAST_RING_PX * max(n_line, n_pixel)
    usable = p.stars.usable
    rings, crosses = p.stars.pixel_line[usable], p.stars.pixel_line[~usable]
    axes.scatter(rings[:, 0], rings[:, 1], s=60, facecolors="none", edgecolors=STAR, linewidths=1.2)
    axes.scatter(crosses[:, 0], crosses[:, 1], s=40, marker="x", color=UNUSABLE, linewidths=1.2)
    for place, mag in zip(p.stars.pixel_line[usable][:NAMED], p.stars.mag[usable][:NAMED], strict=True):
        axes.annotate(f"{mag:.1f}", place, xytext=(6, 4), textcoords="offset points", fontsize=7, color=STAR)
    for target in p.targets:
        _draw_body(axes, target, least)
    for other in p.visitors:
        axes.scatter(other.pixel, other.line, s=70, marker="D", facecolors="none", edgecolors=OTHER)
        axes.annotate(
            other.name,
            (other.pixel, other.line),
            xytext=(6, -9),
            textcoords="offset points",
            fontsize=7,
            color=OTHER,
        )
    axes.set(xlim=(-0.5, n_pixel - 0.5), ylim=(n_line - 0.5, -0.5))
    axes.set_aspect("auto" if n_pixel > STRIP_ASPECT * n_line else "equal")
    axes.tick_params(labelsize=7)


def _draw_body(axes: Axes, target: TargetPlan, least_px: float) -> None:
    place = target.prediction.pixel_line
    if not np.isfinite(place).all():
        return
    limb = target.prediction.limb_px
    if len(limb) and target.prediction.diameter_px > least_px:
        axes.plot(*np.vstack([limb, limb[:1]]).T, color=BODY, linewidth=1.2)
    else:  # a box around what is too small to be seen, as in the paper's Figure 3
        x, y = np.array([-1, 1, 1, -1, -1]), np.array([-1, -1, 1, 1, -1])
        axes.plot(place[0] + least_px * x, place[1] + least_px * y, color=BODY, linewidth=1.2)
    words = f"{target.name} {target.prediction.diameter_px:.2g} px"
    axes.annotate(
        words, (place[0], place[1]), xytext=(10, -14), textcoords="offset points", fontsize=8, color=BODY
    )


def _caption(p: Prospect) -> str:
    stars = f"{int(p.stars.usable.sum())} usable of {len(p.stars)} catalog stars (circles, magnitudes)"
    pointing = "no pointing"
    if p.pointing is not None:
        a = p.pointing
        pointing = f"pointing {a.sigma_px[0]:.3f}, {a.sigma_px[1]:.3f} px, twist {a.twist_sigma_deg:.2g}°"
    return f"{p.camera.name}, Sun {p.elongation_deg:.0f}° away; {stars}\n{pointing}"


def _folded(words: str, width: int = 52) -> str:
    return "\n".join(textwrap.wrap(words, width))


def timeline_figure(pictures: Sequence[PicturePlan], title: str = "") -> Figure:
    """Draw expected sigmas, signal-to-noise ratio, size and stars against time.

    Parameters
    ----------
    pictures : sequence of PicturePlan
        Those that cannot be predicted are marked by their time alone.
    title : str
    """
    figure = Figure(figsize=(9.5, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=10)
    axes = figure.subplots(4, 1, sharex=True)
    dated = sorted((p for p in pictures if p.prospect is not None), key=lambda p: p.utc)
    names = list(dict.fromkeys(t.name for p in dated for t in _of(p).targets))
    days, start = _days(dated)
    for name, color in zip(names, TARGET_COLORS * len(names), strict=False):
        rows = [(day, target) for day, p in zip(days, dated, strict=True) if (target := _of(p).target(name))]
        time = np.array([day for day, _ in rows])
        sigma = np.array([np.max(t.sigma_arcsec) for _, t in rows])
        axes[0].plot(
            time, sigma, "o-", color=color, markersize=4, linewidth=0.9, label=f"{name}, with pointing"
        )
        axes[1].plot(
            time, [t.snr for _, t in rows], "o-", color=color, markersize=4, linewidth=0.9, label=name
        )
        size = [t.prediction.diameter_px for _, t in rows]
        axes[2].plot(time, size, "o-", color=color, markersize=4, linewidth=0.9, label=name)
    pointing = [np.nan if (a := _of(p).pointing) is None else float(np.max(a.sigma_arcsec)) for p in dated]
    axes[0].plot(days, pointing, "s--", color="0.4", markersize=3.5, linewidth=0.8, label="pointing alone")
    _stars_panel(axes[3], days, dated)
    labels = ("sigma of direction, arcsec", "SNR of target", "diameter, px", "usable stars")
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25, linewidth=0.5)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, loc="best", ncols=2)
    for axis in axes[:3]:
        if any(np.nanmax(np.r_[0.0, line.get_ydata()]) > 0.0 for line in axis.get_lines()):
            axis.set_yscale("log")
    axes[3].set_xlabel(f"days since {start}" if start else "no picture can be predicted", fontsize=8)
    return figure


def _stars_panel(axes: Axes, days: FloatArray, pictures: Sequence[PicturePlan]) -> None:
    for grade, color in GRADE_COLORS.items():
        rows = [i for i, p in enumerate(pictures) if p.verdict.grade == grade]
        counts = [int(_of(pictures[i]).stars.usable.sum()) for i in rows]
        axes.plot(days[rows], counts, GRADE_SIGNS[grade], color=color, markersize=6, label=grade)
    axes.set_ylim(bottom=-0.4)


def _of(plan: PicturePlan) -> Prospect:
    assert plan.prospect is not None
    return plan.prospect


def _days(pictures: Sequence[PicturePlan]) -> tuple[FloatArray, str]:
    et = np.array([_of(p).et for p in pictures])
    if not len(et):
        return et, ""
    return (et - et[0]) / DAY_S, pictures[0].utc.replace("T", " ")
