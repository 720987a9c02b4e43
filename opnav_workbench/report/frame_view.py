"""Layout of the summary figure for square frames and for long strips."""

from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

__all__ = ["STRIP_ASPECT", "Panels", "panels_of"]

# A frame wider than this many times its height is shown as strips, one under the other.
STRIP_ASPECT = 4.0
STRIPS = 4


@dataclass(slots=True)
class Panels:
    """Where the picture and the three plots go; use `pictures` before `plots`."""

    shape: tuple[int, int]
    strips: int
    size_inch: tuple[float, float]

    def pictures(self, figure: Figure) -> Iterator[tuple[Axes, int, int]]:
        """Yield axes with the first and one-past-last pixel column they show."""
        n_pixel = self.shape[1]
        rows = self._picture_cell(figure).subgridspec(self.strips, 1, hspace=0.0)
        for row in range(self.strips):
            first, last = row * n_pixel // self.strips, (row + 1) * n_pixel // self.strips
            yield figure.add_subplot(rows[row, 0]), first, last

    def plots(self, figure: Figure) -> tuple[Axes, Axes, Axes]:
        """Return axes for residual vectors, residuals before and residuals after."""
        if self.strips > 1:
            cells = figure.add_gridspec(2, 1, height_ratios=(1.6, 1.0))[1, 0].subgridspec(1, 3)
            return tuple(figure.add_subplot(cells[0, i]) for i in range(3))  # type: ignore[return-value]
        cells = figure.add_gridspec(1, 2, width_ratios=(1.45, 1.0))[0, 1].subgridspec(
            3, 1, height_ratios=(1.5, 1, 1)
        )
        return tuple(figure.add_subplot(cells[i, 0]) for i in range(3))  # type: ignore[return-value]

    def _picture_cell(self, figure: Figure) -> SubplotSpec:
        if self.strips > 1:
            return figure.add_gridspec(2, 1, height_ratios=(1.6, 1.0))[0, 0]
        return figure.add_gridspec(1, 2, width_ratios=(1.45, 1.0))[0, 0]


def panels_of(shape: tuple[int, ...]) -> Panels:
    """Choose the layout for a frame of `shape` (n_line, n_pixel)."""
    n_line, n_pixel = shape
    if n_pixel > STRIP_ASPECT * n_line:
        return Panels((n_line, n_pixel), STRIPS, (13.0, 10.2))
    return Panels((n_line, n_pixel), 1, (13.0, 8.2))
