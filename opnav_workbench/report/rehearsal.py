"""A rehearsal as figures and as pages: flyby in the B-plane, O-C over time, errors in their own sigmas, and the score.

Pixel components are blue, line components vermilion (Okabe & Ito); bodies have markers of their own. Each figure
comes on a light and on a dark ground. What a team delivers, and how it was scored, is one file each that opens
anywhere, offline; every verdict has a word beside its colour.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.estimation import error_ellipse
from opnav_workbench.rehearsal.orbit.solution import OrbitSolution
from opnav_workbench.rehearsal.score import RULE, OrtScore
from opnav_workbench.rehearsal.solution import OrtSolution
from opnav_workbench.rehearsal.truth_checks import PictureScore, SolutionScore
from opnav_workbench.report.drawing import (
    BLUE,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    error_ellipse_patch,
    new_figure,
    png_bytes,
)
from opnav_workbench.report.pages import render_template
from opnav_workbench.templating import png_url

__all__ = ["orbit_solution_page", "score_page", "solution_page"]


# ---- Figures of a rehearsal.

LIGHT = {"pixel": BLUE, "line": VERMILION, "before": "#7a8594", "solved": BLUE, "true": "#000000"}
DARK = {"pixel": SKY_BLUE, "line": ORANGE, "before": "#9aa7b8", "solved": SKY_BLUE, "true": "#ffffff"}
DARK_INK, DARK_GROUND = "#e4e9f0", "#14181f"
MARKERS = ("o", "s", "^", "D", "v", "P")
SIGMAS = (1.0, 3.0)
CLOSE_UP = 5.0  # sigmas to either side


def _ground(dark: bool) -> AbstractContextManager[None]:
    if not dark:
        return mpl.rc_context({"font.size": 9.0})
    ink = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
    ground = ("figure.facecolor", "axes.facecolor", "legend.facecolor", "savefig.facecolor")
    values: Any = dict.fromkeys(ink, DARK_INK) | dict.fromkeys(ground, DARK_GROUND)
    return mpl.rc_context(values | {"font.size": 9.0, "legend.edgecolor": "#303947"})


# -- B-plane -------------------------------------------------------------------------------------------------------


def flyby_figure(solution: OrtSolution, true: FloatArray | None = None, *, dark: bool = False) -> Figure:
    """Draw the flyby as predicted, as solved and as it truly is, each with its ellipses of 1 and 3 sigma.

    Parameters
    ----------
    true : (3,) array, optional
        B.T, B.R, time; None before the truth is opened.

    Returns
    -------
    matplotlib.figure.Figure
        Left the B-plane with what was known before, in the middle the solution closely, right the times of arrival.
    """
    colors = DARK if dark else LIGHT
    with _ground(dark):
        figure = new_figure(12.5, 4.3)
        whole, close, times = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.0))
        _draw_b_plane(whole, solution, true, colors)
        whole.set_title(f"B-plane of {solution.b_plane_body.title()}", fontsize=10)
        whole.legend(fontsize=8, loc="upper left")
        _draw_b_plane(close, solution, true, colors)
        _close_up(close, solution, true)
        close.set_title("solution, closely (1 and 3 sigma)", fontsize=10)
        _draw_arrivals(times, solution, true, colors)
        return figure


def history_figure(solution: OrtSolution, true: FloatArray | None = None, *, dark: bool = False) -> Figure:
    """Draw B.T, B.R and arrival, solved minus predicted, against the time of data cutoff, each with 1 sigma.

    Parameters
    ----------
    true : (3,) array, optional
        As in `flyby_figure`.
    """
    colors = DARK if dark else LIGHT
    days = np.array([(row["et"] - solution.history[-1]["et"]) / DAY_S for row in solution.history])
    names = ("B·T, km", "B·R, km", "arrival, s")
    with _ground(dark):
        figure = new_figure(12.5, 3.4)
        for k, axes in enumerate(figure.subplots(1, 3)):
            shifts = [row["b_plane"][k] - solution.b_plane_before[k] for row in solution.history]
            sigmas = [np.sqrt(row["covariance"][k, k]) for row in solution.history]
            axes.errorbar(
                days, shifts, yerr=sigmas, color=colors["solved"], marker="o", markersize=4, capsize=3
            )
            if true is not None:
                axes.axhline(true[k] - solution.b_plane_before[k], color=colors["true"], linewidth=0.9)
            axes.set_xlabel("data cutoff, days before the last picture")
            axes.set_title(names[k], fontsize=10)
            axes.grid(alpha=0.25)
        return figure


def _draw_b_plane(
    axes: Axes, solution: OrtSolution, true: FloatArray | None, colors: Mapping[str, str]
) -> None:
    before, after = solution.b_plane_before, solution.b_plane_after
    _ellipses(axes, before, solution.b_plane_covariance_before, colors["before"], "--")
    _ellipses(axes, after, solution.b_plane_covariance, colors["solved"], "-")
    axes.plot(*before[:2], "+", color=colors["before"], markersize=11, markeredgewidth=2, label="a priori")
    axes.plot(*after[:2], "o", color=colors["solved"], markersize=5, label="solved")
    if true is not None:
        axes.plot(*true[:2], "x", color=colors["true"], markersize=8, markeredgewidth=1.6, label="true")
    axes.set(xlabel="B·T, km", ylabel="B·R, km (down)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.invert_yaxis()
    axes.grid(alpha=0.25)
    axes.locator_params(nbins=6)


def _ellipses(axes: Axes, center: FloatArray, covariance: FloatArray, color: str, line: str) -> None:
    for sigmas, width in zip(SIGMAS, (1.4, 0.8), strict=True):
        style: dict[str, Any] = {"edgecolor": color, "linestyle": line, "linewidth": width}
        axes.add_patch(error_ellipse_patch(center, covariance, sigmas, **style))


def _close_up(axes: Axes, solution: OrtSolution, true: FloatArray | None) -> None:
    center = solution.b_plane_after[:2]
    half = CLOSE_UP * error_ellipse(solution.b_plane_covariance[:2, :2]).semi_major_km
    if true is not None:
        half = max(half, 1.3 * float(np.abs(true[:2] - center).max()))
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(center[0] - half, center[0] + half), ylim=(center[1] + half, center[1] - half))
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(axis="x", labelrotation=20)


def _draw_arrivals(
    axes: Axes, solution: OrtSolution, true: FloatArray | None, colors: Mapping[str, str]
) -> None:
    """Times of arrival relative to the predicted one."""
    sigmas = [
        float(np.sqrt(c[2, 2])) for c in (solution.b_plane_covariance_before, solution.b_plane_covariance)
    ]
    rows = [
        ("a priori", 0.0, sigmas[0], "before", "+"),
        ("solved", solution.b_plane_shift[2], sigmas[1], "solved", "o"),
    ]
    for row, (_, late, sigma, color, marker) in enumerate(rows):
        axes.errorbar(late, row, xerr=3.0 * sigma, color=colors[color], linewidth=1.0, capsize=4)
        axes.errorbar(late, row, xerr=sigma, color=colors[color], marker=marker, linewidth=3.0)
        words = f"{late:+.1f} ± {sigma:.1f} s"
        axes.annotate(words, (late, row), (0, 10), textcoords="offset points", ha="center", fontsize=8)
    names = [name for name, *_ in rows]
    if true is not None:
        late = float(true[2] - solution.b_plane_before[2])
        axes.plot(late, len(names), "x", color=colors["true"], markeredgewidth=1.6)
        axes.annotate(
            f"{late:+.1f} s", (late, len(names)), (0, 10), textcoords="offset points", ha="center", fontsize=8
        )
        names.append("true")
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.7)
    axes.margins(x=0.15)
    axes.set_xlabel("arrival after the predicted one, s (1 and 3 sigma)")
    axes.set_title("linearised time of flight", fontsize=10)


# -- O-C -----------------------------------------------------------------------------------------------------------


def residual_figure(solution: OrtSolution, *, dark: bool = False) -> Figure:
    """Draw O-C of all centers over time: with the predicted trajectory, and what remains with the solved one."""
    colors = DARK if dark else LIGHT
    rows = [r for r in solution.residuals if r["kind"] == "center"]
    with _ground(dark):
        figure = new_figure(12.5, 3.6)
        before, after = figure.subplots(1, 2)
        for axes, which, title in (
            (before, "before", "predicted trajectory"),
            (after, "after", "solved trajectory"),
        ):
            _draw_residuals(axes, rows, which, colors)
            axes.set_title(f"O−C with the {title}", fontsize=10)
            axes.set(xlabel="days since the first picture", ylabel="O−C, px")
        if rows:
            after.legend(fontsize=8, ncols=2, loc="best")
        return figure


def _draw_residuals(
    axes: Axes, rows: Sequence[Mapping[str, Any]], which: str, colors: Mapping[str, str]
) -> None:
    axes.axhline(0.0, color=colors["before"], linewidth=0.8)
    start = min((float(r["et"]) for r in rows), default=0.0)
    for body, marker in zip(dict.fromkeys(r["body"] for r in rows), cycle(MARKERS), strict=False):
        of_body = [r for r in rows if r["body"] == body]
        time = np.array([(float(r["et"]) - start) / DAY_S for r in of_body])
        used = np.array([bool(r["used"]) for r in of_body])
        for i, axis in enumerate(("pixel", "line")):
            value = np.array([float(r[which][i]) for r in of_body])
            sigma = np.sqrt([float(r["covariance"][i, i]) for r in of_body])
            axes.errorbar(
                time,
                value,
                sigma,
                fmt=marker,
                color=colors[axis],
                markersize=4,
                elinewidth=0.9,
                label=f"{body} {axis}",
            )
            axes.plot(time[~used], value[~used], "o", mfc="none", mec=PURPLE, markersize=11, mew=1.5)


# -- errors --------------------------------------------------------------------------------------------------------


def center_error_figure(pictures: Sequence[PictureScore], *, dark: bool = False) -> Figure:
    """Draw the errors of pointing and of centers in their own sigmas, picture by picture."""
    colors = DARK if dark else LIGHT
    with _ground(dark):
        figure = new_figure(12.5, 3.8)
        axes = figure.subplots()
        for level, alpha in ((3.0, 0.08), (1.0, 0.12)):
            axes.axhspan(-level, level, color=colors["before"], alpha=alpha, linewidth=0)
        axes.axhline(0.0, color=colors["before"], linewidth=0.8)
        _draw_errors(axes, pictures, colors)
        axes.set_xticks(range(len(pictures)), [p.name for p in pictures], rotation=35, ha="right")
        axes.set(ylabel="error over its sigma", xlim=(-0.6, len(pictures) - 0.4))
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -3.6), max(high, 3.6))
        for i, picture in enumerate(pictures):
            if picture.lost:
                axes.text(i, 0.0, "lost", ha="center", va="center", rotation=90, color=colors["before"])
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8, ncols=4, loc="best")
        return figure


def _draw_errors(axes: Axes, pictures: Sequence[PictureScore], colors: Mapping[str, str]) -> None:
    bodies = tuple(dict.fromkeys(c.body for p in pictures for c in p.centers))
    for number, name in enumerate(("pointing", *bodies)):
        shift = (number - 0.5 * len(bodies)) * 0.6 / (len(bodies) + 1)
        points = [
            (i + shift, check.component_sigmas)
            for i, p in enumerate(pictures)
            for check in _checks_of(p, name)
        ]
        if not points:
            continue
        place, errors = np.array([x for x, _ in points]), np.array([e[:2] for _, e in points])
        marker = MARKERS[number % len(MARKERS)]
        for column, axis in enumerate(("pixel", "line")):
            axes.plot(
                place,
                errors[:, column],
                marker,
                color=colors[axis],
                markersize=5,
                linestyle="none",
                label=f"{name} {axis}",
            )


def _checks_of(picture: PictureScore, name: str) -> list[Any]:
    if name == "pointing":
        return [] if picture.pointing is None else [picture.pointing]
    return [c.check for c in picture.centers if c.body == name and c.check is not None]


# ---- The pages of a rehearsal.


def score_page(score: OrtScore) -> str:
    """Return the report of a scored rehearsal as HTML without a reference to the network."""
    found = score.solution
    figures = {"errors": _on_both_grounds(lambda dark: center_error_figure(score.pictures, dark=dark))}
    if isinstance(found, SolutionScore):
        figures |= _solution_figures(found.solution, found.b_plane_true)
    return render_template(
        "ort_page.html" if score.rule == RULE else "ort_orbit_page.html",
        score=score,
        solution=None if found is None else found.solution,
        figures=figures,
        heading=f"Score of {score.title or score.package}",
    )


def solution_page(solution: OrtSolution, title: str = "") -> str:
    """Return the overview of a solution, before the truth is opened, as HTML without a reference to the network."""
    return render_template(
        "ort_page.html",
        score=None,
        solution=solution,
        figures=_solution_figures(solution, None),
        heading=f"Solution of {title or solution.package}",
    )


def orbit_solution_page(solution: OrbitSolution, title: str = "") -> str:
    """Return the same of a rehearsal in orbit."""
    return render_template(
        "ort_orbit_page.html",
        score=None,
        solution=solution,
        figures={},
        heading=f"Solution of {title or solution.package}",
    )


def _solution_figures(solution: OrtSolution, true: Any) -> dict[str, dict[str, str]]:
    drawn = (
        {"history": _on_both_grounds(lambda dark: history_figure(solution, true, dark=dark))}
        if len(solution.history) > 1
        else {}
    )
    return drawn | {
        "flyby": _on_both_grounds(lambda dark: flyby_figure(solution, true, dark=dark)),
        "residuals": _on_both_grounds(lambda dark: residual_figure(solution, dark=dark)),
    }


def _on_both_grounds(draw: Callable[[bool], Figure]) -> dict[str, str]:
    """Return a figure as data URLs: on light ground, and on dark ground where the reader's screen is dark."""
    return {"light": png_url(png_bytes(draw(False))), "dark": png_url(png_bytes(draw(True)))}
