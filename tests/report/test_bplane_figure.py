"""The B-plane figure shows what it is given: places, ellipses, times."""

import numpy as np
import pytest
from matplotlib.patches import Ellipse

from opnav_workbench.constants import DAY_S
from opnav_workbench.estimation import BPlaneCutoff, b_plane
from opnav_workbench.estimation.bplane import BPlaneSolution
from opnav_workbench.report.bplane import bplane_figure, bplane_history_figure
from opnav_workbench.report.drawing import png_bytes

VELOCITY = np.array([0.0, -13.78, 0.0])


@pytest.fixture(scope="module")
def flybys():
    """As believed, and 4500 km sunward of it."""
    position = np.array([13000.0, 3.6e6, 4000.0])
    return b_plane(position, VELOCITY, 975.5), b_plane(position - [1165.0, 4347.0, 0.0], VELOCITY, 975.5)


@pytest.fixture(scope="module")
def solutions(flybys):
    before, after = flybys
    values = before.in_axes_of(before), after.in_axes_of(before)
    sizes = {"4 pictures": np.diag([90.0, 60.0, 80.0]), "8 pictures": np.diag([30.0, 20.0, 25.0])}
    turn = np.eye(3)
    turn[0, 1] = 0.6
    return {
        name: BPlaneSolution(before, after, *values, turn @ size**2 @ turn.T) for name, size in sizes.items()
    }


def test_figure_shows_solutions_and_truth(flybys, solutions):
    figure = bplane_figure(solutions, points={"truth": flybys[1]}, body_radius_km=1188.3)
    whole, close, times = figure.axes
    ellipses = [patch for patch in whole.patches if type(patch) is Ellipse]
    assert len(ellipses) == 4
    ellipse = solutions["8 pictures"].ellipse
    assert ellipses[2].width == pytest.approx(2.0 * ellipse.semi_major_km)
    assert ellipses[3].width == pytest.approx(6.0 * ellipse.semi_major_km)
    for axes in (whole, close):
        low, high = axes.get_ylim()
        assert low > high  # R points down
    labels = whole.get_legend_handles_labels()[1]
    assert labels == ["a priori", "4 pictures", "8 pictures", "truth", "body"]
    assert [text.get_text() for text in times.get_yticklabels()] == ["4 pictures", "8 pictures", "truth"]
    assert any("-315." in text.get_text() for text in times.texts)
    x, y = solutions["8 pictures"].values_after[:2]
    assert close.get_xlim()[0] < x < close.get_xlim()[1]
    assert close.get_ylim()[1] < y < close.get_ylim()[0]
    assert len(png_bytes(figure)) > 20_000


def test_figure_without_a_solution_is_an_error():
    with pytest.raises(ValueError, match="at least one"):
        bplane_figure({})


def test_history_shows_every_cutoff(flybys, solutions):
    history = [BPlaneCutoff("a", 0.0, 1, None, reason="not determined")]
    history += [
        BPlaneCutoff(name, (k + 1) * DAY_S, k + 2, solution)
        for k, (name, solution) in enumerate(solutions.items())
    ]
    figure = bplane_history_figure(history, points={"truth": flybys[1]})
    plane, *courses = figure.axes
    assert [patch.width for patch in plane.patches] == pytest.approx(
        [2.0 * s.ellipse.semi_major_km for s in solutions.values()]
    )
    assert plane.get_ylim()[0] > plane.get_ylim()[1]  # R points down
    for row, axes in enumerate(courses):
        (line,) = [x for x in axes.containers[0].lines if hasattr(x, "get_xdata")]
        assert list(line.get_xdata()) == [-1.0, 0.0]
        expected = [
            s.values_after[row] - (s.values_before[2] if row == 2 else 0.0) for s in solutions.values()
        ]
        assert list(line.get_ydata()) == pytest.approx(expected)
    with pytest.raises(ValueError, match="no data cutoff"):
        bplane_history_figure(history[:1])
