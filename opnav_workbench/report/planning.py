"""A picture plan as figures and as a page: field charts, the course of the sequence, searches, best exposures.

A field chart is drawn as on the detector, pixel to the right and line down. The page is one file that opens
anywhere, offline, with its figures inside; every verdict has a sign and a word beside its colour.
"""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.files import write_text
from opnav_workbench.planning import (
    Approach,
    BestExposure,
    PicturePlan,
    PicturePrediction,
    Plan,
    TargetPlan,
    catalog_words,
)
from opnav_workbench.report.drawing import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SERIES_COLORS,
    VERMILION,
    new_figure,
    png_bytes,
)
from opnav_workbench.report.pages import few_colors, render_template
from opnav_workbench.report.scales import STRIP_ASPECT
from opnav_workbench.simulation import stretched
from opnav_workbench.templating import png_url

__all__ = ["field_chart", "timeline_figure", "write_plan_page"]


# ---- Figures of a picture plan.

STAR, UNUSABLE, BODY, OTHER = BLUE, "#999999", VERMILION, GREEN
GRADE_COLORS = {"good": GREEN, "marginal": ORANGE, "bad": VERMILION}
GRADE_SIGNS = {"good": "o", "marginal": "s", "bad": "X"}
TARGET_COLORS = (VERMILION, BLUE, PURPLE, ORANGE)
NAMED = 8  # the brightest stars get their magnitudes
CHART_INCH = 5.6
LEAST_RING_PX = 0.018  # of the detector: a ring that is seen


def field_chart(plan: PicturePlan) -> Figure:
    """Draw the expected picture with its stars and bodies; a picture that cannot be predicted says why.

    Returns
    -------
    matplotlib.figure.Figure
        Pixel to the right, line down, as on the detector.
    """
    figure = new_figure(CHART_INCH, CHART_INCH * 1.02)
    axes = figure.add_subplot()
    axes.set_title(
        f"{plan.name}: {plan.verdict.grade}",
        loc="left",
        fontsize=10,
        color=GRADE_COLORS[plan.verdict.grade],
        fontweight="bold",
    )
    axes.set_title(plan.utc.replace("T", " "), loc="right", fontsize=8)
    prediction = plan.prediction
    if prediction is None:
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
    _draw_field(axes, prediction)
    axes.set_xlabel(_caption(prediction), fontsize=8)
    return figure


def _draw_field(axes: Axes, p: PicturePrediction) -> None:
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
        _draw_target(axes, target, least)
    for other in p.other_bodies:
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


def _draw_target(axes: Axes, target: TargetPlan, least_px: float) -> None:
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


def _caption(p: PicturePrediction) -> str:
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
    pictures
        Those that cannot be predicted are marked by their time alone.
    """
    figure = new_figure(9.5, 8.6, title, fontsize=10)
    axes = figure.subplots(4, 1, sharex=True)
    dated = sorted((p for p in pictures if p.prediction is not None), key=lambda p: p.utc)
    names = list(dict.fromkeys(t.name for p in dated for t in _predicted(p).targets))
    days, start = _days_since_first(dated)
    for name, color in zip(names, TARGET_COLORS * len(names), strict=False):
        rows = [
            (day, target)
            for day, p in zip(days, dated, strict=True)
            if (target := _predicted(p).target(name))
        ]
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
    pointing = [
        np.nan if (a := _predicted(p).pointing) is None else float(np.max(a.sigma_arcsec)) for p in dated
    ]
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
        counts = [int(_predicted(pictures[i]).stars.usable.sum()) for i in rows]
        axes.plot(days[rows], counts, GRADE_SIGNS[grade], color=color, markersize=6, label=grade)
    axes.set_ylim(bottom=-0.4)


def _predicted(plan: PicturePlan) -> PicturePrediction:
    assert plan.prediction is not None
    return plan.prediction


def _days_since_first(pictures: Sequence[PicturePlan]) -> tuple[FloatArray, str]:
    et = np.array([_predicted(p).et for p in pictures])
    if not len(et):
        return et, ""
    return (et - et[0]) / DAY_S, pictures[0].utc.replace("T", " ")


# ---- Figures of a plan's approach searches and of the best exposure.

SINGLE, STACK, LIMIT, SUN = BLUE, GREEN, VERMILION, ORANGE
ROOM_BELOW = 0.25


def search_figure(approach: Approach) -> Figure:
    """Draw the signal-to-noise ratio over the search, with the threshold and the epochs of first detection."""
    figure = new_figure(9.5, 3.6)
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
    figure = new_figure(9.5, 3.8)
    axes = figure.add_subplot()
    for plan, color in zip(pictures, SERIES_COLORS * len(pictures), strict=False):
        best = None if plan.prediction is None else plan.prediction.best_exposure
        if best is not None and np.isfinite(best.sigma_px).any():
            _draw_exposure_curve(axes, plan, best, color)
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("exposure, s (line: planned; dot: best)", fontsize=8)
    axes.set_ylabel("error of target among stars, px", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.5)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, loc="best", ncols=2)
    return figure


def _draw_exposure_curve(axes: Axes, plan: PicturePlan, best: BestExposure, color: str) -> None:
    axes.plot(
        best.exposure_s,
        best.sigma_px,
        color=color,
        linewidth=1.2,
        label=f"{plan.name}, best {best.best_s:.3g} s",
    )
    axes.plot(best.best_s, np.nanmin(best.sigma_px), "o", color=color, markersize=6)
    axes.axvline(plan.picture.exposure_s, color=color, linewidth=0.7, linestyle="--", alpha=0.6)


# ---- The page of a picture plan: one file that opens anywhere, offline, with its figures inside.

GRADE_MARKS = {"good": "✓", "marginal": "!", "bad": "✕"}
GRADE_WORDS = {"good": "as it stands", "marginal": "usable, with reservations", "bad": "not worth taking"}
MOST_CURVES = 6


def plan_page(plan: Plan, charts: Mapping[str, bytes] | None = None) -> str:
    """Return the page: HTML without a reference to the network.

    Parameters
    ----------
    charts
        Charts of the fields as PNG, by picture, where they are drawn already.
    """
    drawn = {p.name: png_bytes(field_chart(p)) for p in plan.pictures} if charts is None else charts
    return render_template(
        "plan_page.html",
        plan=plan,
        charts={name: _chart_url(png) for name, png in drawn.items()},
        signs=GRADE_MARKS,
        meaning=GRADE_WORDS,
        catalog=catalog_words(plan),
        timeline=_chart_url(png_bytes(timeline_figure(plan.pictures))) if plan.pictures else "",
        exposures=_chart_url(png_bytes(exposure_figure(curves))) if (curves := _shown_curves(plan)) else "",
        searches=[(approach, _chart_url(png_bytes(search_figure(approach)))) for approach in plan.searches],
    )


def write_plan_page(plan: Plan, path: Path, charts: Mapping[str, bytes] | None = None) -> None:
    """Write the page, whole or not at all."""
    write_text(path, plan_page(plan, charts))


def _shown_curves(plan: Plan) -> list[PicturePlan]:
    """Return pictures spread over the sequence whose exposure was searched."""
    known = [
        p
        for p in plan.pictures
        if p.prediction and p.prediction.best_exposure and np.isfinite(p.prediction.best_exposure.best_s)
    ]
    if len(known) <= MOST_CURVES:
        return known
    return [known[i] for i in np.linspace(0, len(known) - 1, MOST_CURVES).astype(int)]


def _chart_url(png: bytes) -> str:
    return png_url(few_colors(png))
