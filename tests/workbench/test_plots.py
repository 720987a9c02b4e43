"""Small plots: numbers at the ticks stand clear of each other."""

import numpy as np
import pytest

from opnav_workbench.workbench.plots import FONT_PX, SvgPlot


@pytest.mark.parametrize("height_px", [60, 80, 120, 400])
@pytest.mark.parametrize("ends", [(-0.17, 0.16), (-1.0, 1.0), (0.0, 9.9), (-100.0, 33.0)])
def test_numbers_beside_a_low_plot_do_not_touch(height_px, ends):
    plot = SvgPlot(300, height_px, (0.0, 1.0), ends, ticks=6)
    places = [place for place, _ in plot.y_ticks]
    assert places
    assert len(places) == 1 or np.abs(np.diff(places)).min() >= FONT_PX
