"""Figure of the B-plane: where flybys go, with error ellipses, and when they arrive.

T to the right and R down, as target planes are drawn: with a pole in the north, north is up. Colors from Okabe & Ito; every
solution has a marker of its own as well.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.estimation import BPlane, BPlaneCutoff, BPlaneSolution
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.report.drawing import SERIES_COLORS, error_ellipse_patch, new_figure

__all__ = ["bplane_figure", "bplane_history_figure"]

MARKERS = ("o", "s", "^", "D", "v")
SIGMAS = (1.0, 3.0)
GREY = "0.55"
MARGIN = 0.18  # of what is shown, around it
CLOSE_UP = 6.0  # sigmas to either side of a solution


def bplane_figure(
    solutions: Mapping[str, BPlaneSolution],
    *,
    points: Mapping[str, BPlane] | None = None,
    body_radius_km: float | None = None,
    title: str = "",
) -> Figure:
    """Draw solutions in the B-plane of the first one's a priori trajectory.

    Parameters
    ----------
    solutions
        By name, at least one; all mapped from the same a priori trajectory and epoch.
    points
        Further flybys, such as the truth or the aim point.
    body_radius_km
        Draws the body.

    Returns
    -------
    matplotlib.figure.Figure
        Left the whole B-plane, in the middle the last solution closely, right the times of arrival.

    Raises
    ------
    ValueError
        No solution.
    """
    if not solutions:
        raise ValueError("no solution to draw; give at least one BPlaneSolution")
    reference = next(iter(solutions.values())).a_priori
    marks = {name: point.in_axes_of(reference) for name, point in (points or {}).items()}
    figure = new_figure(13.0, 4.8, title or _heading(reference), fontsize=11)
    whole, close, times = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    _draw_whole(whole, solutions, marks, reference, body_radius_km)
    _draw_close_up(close, solutions, marks)
    _draw_arrivals(times, solutions, marks)
    return figure


def bplane_history_figure(
    history: Sequence[BPlaneCutoff], *, points: Mapping[str, BPlane] | None = None, title: str = ""
) -> Figure:
    """Draw what was known of a flyby against the time of data cutoff.

    Parameters
    ----------
    history
        As `estimation.b_plane_history` returns it; cutoffs without a solution are left out.
    points
        Further flybys, such as the truth or the aim point.

    Returns
    -------
    matplotlib.figure.Figure
        Left the 1-sigma ellipses in the B-plane, pale to dark as pictures come in; right B.T, B.R and arrival against the
        last picture, with 1 sigma.

    Raises
    ------
    ValueError
        No cutoff has a solution.
    """
    solved = [(cutoff, cutoff.solution) for cutoff in history if cutoff.solution is not None]
    if not solved:
        raise ValueError("no data cutoff with a solution to draw")
    reference = solved[0][1].a_priori
    marks = {name: point.in_axes_of(reference) for name, point in (points or {}).items()}
    figure = new_figure(12.0, 5.4, title or _heading(reference), fontsize=11)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.1))
    _draw_cutoffs(figure.add_subplot(grid[:, 0]), solved, marks)
    for row, name in enumerate(("B·T, km", "B·R, km", "arrival, s")):
        axes = figure.add_subplot(grid[row, 1])
        _draw_course(axes, solved, marks, row)
        axes.set_ylabel(name)
        axes.tick_params(labelsize=8, labelbottom=row == 2)
    axes.set_xlabel("data cutoff, days before the last picture")
    return figure


def _draw_cutoffs(
    axes: Axes, solved: Sequence[tuple[BPlaneCutoff, BPlaneSolution]], marks: Mapping[str, FloatArray]
) -> None:
    corners = []
    for k, (cutoff, solution) in enumerate(solved):
        dark = 0.25 + 0.75 * (k + 1) / len(solved)
        axes.add_patch(
            error_ellipse_patch(
                solution.values_after,
                solution.covariance,
                1.0,
                edgecolor=SERIES_COLORS[0],
                linewidth=1.2,
                alpha=dark,
            )
        )
        label = f"{cutoff.pictures} pictures" if k == len(solved) - 1 else None
        axes.plot(*solution.values_after[:2], ".", color=SERIES_COLORS[0], alpha=dark, label=label)
        corners += [solution.values_after + sign * solution.sigma for sign in (-1.0, 1.0)]
    _draw_marks(axes, marks)
    _square(axes, np.array([*corners, *marks.values()])[:, :2], None)
    axes.set_title("1 sigma after each picture", fontsize=10)
    axes.legend(fontsize=8, loc="best")


def _draw_course(
    axes: Axes,
    solved: Sequence[tuple[BPlaneCutoff, BPlaneSolution]],
    marks: Mapping[str, FloatArray],
    row: int,
) -> None:
    """One value against the cutoff; arrivals relative to the a priori one."""
    zero = solved[0][1].values_before[2] if row == 2 else 0.0
    last = solved[-1][0].cutoff_et
    days = [(cutoff.cutoff_et - last) / DAY_S for cutoff, _ in solved]
    values = [solution.values_after[row] - zero for _, solution in solved]
    sigmas = [solution.sigma[row] for _, solution in solved]
    axes.errorbar(days, values, yerr=sigmas, color=SERIES_COLORS[0], marker="o", markersize=4, capsize=3)
    for style, (name, mark) in zip(cycle(("-", "--", ":")), marks.items(), strict=False):
        axes.axhline(mark[row] - zero, color="k", linestyle=style, linewidth=0.9, label=name)
    axes.grid(alpha=0.25)


def _heading(reference: BPlane) -> str:
    ra, dec = (float(np.degrees(angle)) for angle in radec_from_unit(reference.s))
    return f"B-plane: S toward RA {ra:.3f}°, Dec {dec:.3f}°, v∞ {reference.v_infinity_km_s:.3f} km/s"


def _draw_whole(
    axes: Axes,
    solutions: Mapping[str, BPlaneSolution],
    marks: Mapping[str, FloatArray],
    reference: BPlane,
    body_radius_km: float | None,
) -> None:
    before = reference.in_axes_of(reference)
    axes.plot(*before[:2], "+", color=GREY, markersize=11, markeredgewidth=1.8, label="a priori")
    for name, solution, color, marker in _styled(solutions):
        after = solution.values_after
        axes.annotate(
            "",
            tuple(after[:2]),
            tuple(before[:2]),
            arrowprops={"arrowstyle": "->", "color": color, "linewidth": 1.0},
        )
        axes.plot(*after[:2], marker, color=color, markersize=5, label=name)
        _ellipses(axes, solution, color)
    _draw_marks(axes, marks)
    axes.plot(0.0, 0.0, "k.", markersize=3)
    if body_radius_km:
        axes.add_patch(Circle((0.0, 0.0), body_radius_km, color="0.85", zorder=0, label="body"))
    places = [before, *marks.values(), *(s.values_after for s in solutions.values()), np.zeros(3)]
    _square(axes, np.array(places)[:, :2], body_radius_km or 0.0)
    axes.set_title("from the body (center)", fontsize=10)
    axes.legend(fontsize=8, loc="best")


def _draw_close_up(
    axes: Axes, solutions: Mapping[str, BPlaneSolution], marks: Mapping[str, FloatArray]
) -> None:
    for _, solution, color, marker in _styled(solutions):
        axes.plot(*solution.values_after[:2], marker, color=color, markersize=5)
        _ellipses(axes, solution, color)
    _draw_marks(axes, marks)
    name, last = list(solutions.items())[-1]
    half = max(CLOSE_UP * last.ellipse.semi_major_km, 1e-6)
    center = last.values_after[:2]
    axes.set(xlim=(center[0] - half, center[0] + half), ylim=(center[1] + half, center[1] - half))
    axes.set_aspect("equal")
    axes.set_title(f"{name}: 1 and 3 sigma", fontsize=10)
    _labels(axes)
    ellipse = last.ellipse
    words = (
        f"B·T {center[0]:,.1f} ± {last.sigma[0]:.1f} km\nB·R {center[1]:,.1f} ± {last.sigma[1]:.1f} km\n"
        f"ellipse {ellipse.semi_major_km:.1f} × {ellipse.semi_minor_km:.1f} km, "
        f"{np.degrees(ellipse.angle_rad):.0f}° from T to R"
    )
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(0.03, 0.97, words, transform=axes.transAxes, va="top", fontsize=8, bbox=box, zorder=5)


def _draw_arrivals(
    axes: Axes, solutions: Mapping[str, BPlaneSolution], marks: Mapping[str, FloatArray]
) -> None:
    """Linearised time of flight, relative to the a priori one."""
    before = next(iter(solutions.values())).values_before[2]
    axes.axvline(0.0, color=GREY, linewidth=1.0)
    names = []
    for row, (name, solution, color, marker) in enumerate(_styled(solutions)):
        late, sigma = solution.shift[2], solution.sigma[2]
        axes.errorbar(late, row, xerr=3.0 * sigma, color=color, linewidth=1.0, capsize=4)
        axes.errorbar(late, row, xerr=sigma, color=color, marker=marker, markersize=5, linewidth=3.0)
        axes.annotate(
            f"{late:+.1f} ± {sigma:.1f} s",
            (late, row),
            (0, 10),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
        names.append(name)
    for name, values in marks.items():
        axes.plot(values[2] - before, len(names), "x", color="k")
        names.append(name)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.7)
    axes.margins(x=0.2)
    axes.set_xlabel("arrival after the a priori one, s (1 and 3 sigma)")
    axes.set_title("linearised time of flight", fontsize=10)


def _styled(
    solutions: Mapping[str, BPlaneSolution],
) -> list[tuple[str, BPlaneSolution, str, str]]:
    styles = zip(cycle(SERIES_COLORS[: len(MARKERS)]), cycle(MARKERS), strict=False)
    return [
        (name, solution, *style) for (name, solution), style in zip(solutions.items(), styles, strict=False)
    ]


def _ellipses(axes: Axes, solution: BPlaneSolution, color: str) -> None:
    for sigmas, width in zip(SIGMAS, (1.2, 0.7), strict=True):
        axes.add_patch(
            error_ellipse_patch(
                solution.values_after, solution.covariance, sigmas, edgecolor=color, linewidth=width
            )
        )


def _draw_marks(axes: Axes, marks: Mapping[str, FloatArray]) -> None:
    for marker, (name, values) in zip(cycle("x*P"), marks.items(), strict=False):
        axes.plot(*values[:2], marker, color="k", markersize=8, linestyle="none", label=name)


def _square(axes: Axes, places: FloatArray, radius_km: float | None) -> None:
    """Show all places, and the body if there is one, in a square, R growing downward."""
    low, high = places.min(axis=0), places.max(axis=0)
    if radius_km is not None:
        low, high = np.minimum(low, -radius_km), np.maximum(high, radius_km)
    half = (0.5 + MARGIN) * max(float((high - low).max()), 1e-6)
    center = 0.5 * (low + high)
    axes.set(xlim=(center[0] - half, center[0] + half), ylim=(center[1] + half, center[1] - half))
    axes.set_aspect("equal")
    _labels(axes)


def _labels(axes: Axes) -> None:
    axes.set(xlabel="B·T, km", ylabel="B·R, km (down)")
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25)
