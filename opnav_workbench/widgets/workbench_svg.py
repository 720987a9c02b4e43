"""Small plots as SVG: axes with round ticks, points with error bars, lines.  Colors are CSS classes, for light and dark."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.widgets.workbench_html import text

__all__ = ["Plot", "round_ticks"]

FONT_PX = 11
WANTED_TICKS = 4
RANGE_MARGIN = 0.06  # of the data's range, so that no mark sits on the frame


def round_ticks(low: float, high: float, wanted: int = WANTED_TICKS) -> FloatArray:
    """Return about `wanted` round numbers from `low` to `high`.

    Examples
    --------
    >>> round_ticks(8.2, 12.1).tolist()
    [9.0, 10.0, 11.0, 12.0]
    """
    span = max(high - low, 1e-12)
    power = 10.0 ** np.floor(np.log10(span / wanted))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power * (wanted + 0.5) >= span)
    ticks = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0) * step
    return np.asarray(np.where(np.abs(ticks) < 1e-9 * step, 0.0, ticks))


def data_range(values: ArrayLike, *, with_zero: bool = False) -> tuple[float, float]:
    """Return the range of the finite values with a margin; (-1, 1) about what there is where that is no range."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if with_zero:
        finite = np.append(finite, 0.0)
    if finite.size == 0:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = RANGE_MARGIN * (high - low) or 1.0
    return low - margin, high + margin


@dataclass(slots=True)
class Plot:
    """A plot that is built up piece by piece; `svg` gives it out.

    Parameters
    ----------
    width_px, height_px : int
    x_range, y_range : (float, float)
        At left and right, at bottom and top; descending is fine.
    title, x_label, y_label : str
    bare : bool
        No axes and no labels: a thumbnail.
    ticks : int
        About so many on each axis.
    """

    width_px: int
    height_px: int
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    bare: bool = False
    ticks: int = WANTED_TICKS
    _parts: list[str] = field(default_factory=list)

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of the frame, px."""
        if self.bare:
            return 1.0, 1.0, self.width_px - 1.0, self.height_px - 1.0
        top = 20.0 if self.title else 6.0
        bottom = self.height_px - (34.0 if self.x_label else 20.0)
        return (58.0 if self.y_label else 40.0), top, self.width_px - 14.0, bottom

    def x(self, value: ArrayLike) -> FloatArray:
        """Return where values stand across, px."""
        left, _, right, _ = self.frame
        low, high = self.x_range
        return left + (np.asarray(value, dtype=float) - low) / (high - low) * (right - left)

    def y(self, value: ArrayLike) -> FloatArray:
        """Return where values stand down the page, px."""
        _, top, _, bottom = self.frame
        low, high = self.y_range
        return bottom - (np.asarray(value, dtype=float) - low) / (high - low) * (bottom - top)

    def line(self, x: ArrayLike, y: ArrayLike, style: str) -> "Plot":
        """Draw a line through the finite points."""
        across, down = self.x(x), self.y(y)
        good = np.isfinite(across) & np.isfinite(down)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across[good], down[good], strict=True))
        self._parts.append(f'<polyline class="{style}" points="{points}" clip-path="url(#{self._clip})"/>')
        return self

    def points(
        self,
        x: ArrayLike,
        y: ArrayLike,
        style: str,
        sigma: ArrayLike | None = None,
        titles: Sequence[str] = (),
    ) -> "Plot":
        """Draw points, round or (style ``line``) square, with error bars and a tooltip each."""
        across, down = self.x(x), self.y(y)
        bars = np.zeros_like(down) if sigma is None else np.abs(self.y(np.asarray(sigma)) - self.y(0.0))
        for i, (a, b, bar) in enumerate(zip(across, down, bars, strict=True)):
            if not (np.isfinite(a) and np.isfinite(b)):
                continue
            title = f"<title>{text(titles[i])}</title>" if titles else ""
            whisker = (
                f'<path d="M{a:.1f} {b - bar:.1f}V{b + bar:.1f}"/>' if bar > 0.5 and np.isfinite(bar) else ""
            )
            shape = (
                f'<rect x="{a - 3:.1f}" y="{b - 3:.1f}" width="6" height="6"/>'
                if style == "line"
                else f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3"/>'
            )
            self._parts.append(f'<g class="pt {style}">{title}{whisker}{shape}</g>')
        return self

    def raw(self, svg: str) -> "Plot":
        """Add a piece of SVG in the plot's pixels."""
        self._parts.append(svg)
        return self

    @property
    def _clip(self) -> str:
        return f"c{self.width_px}x{self.height_px}" + ("b" if self.bare else "t" if self.title else "")

    def _axes(self) -> Iterator[str]:
        left, top, right, bottom = self.frame
        for value in round_ticks(min(self.x_range), max(self.x_range), self.ticks):
            a = float(self.x(value))
            yield f'<path class="tick" d="M{a:.1f} {bottom:.1f}v4"/>'
            yield f'<text x="{a:.1f}" y="{bottom + 15:.1f}" text-anchor="middle">{value:.6g}</text>'
        for value in round_ticks(min(self.y_range), max(self.y_range), self.ticks):
            b = float(self.y(value))
            yield f'<path class="tick" d="M{left:.1f} {b:.1f}h-4"/>'
            yield f'<text x="{left - 6:.1f}" y="{b + 4:.1f}" text-anchor="end">{value:.6g}</text>'
        middle, center = (left + right) / 2.0, (top + bottom) / 2.0
        if self.title:
            yield f'<text class="title" x="{middle:.1f}" y="13" text-anchor="middle">{text(self.title)}</text>'
        if self.x_label:
            yield f'<text x="{middle:.1f}" y="{self.height_px - 4}" text-anchor="middle">{text(self.x_label)}</text>'
        if self.y_label:
            turn = f'transform="rotate(-90 12 {center:.1f})"'
            yield f'<text x="12" y="{center:.1f}" text-anchor="middle" {turn}>{text(self.y_label)}</text>'

    def svg(self) -> str:
        """Return the plot as an SVG element."""
        left, top, right, bottom = self.frame
        low, high = sorted(self.y_range)
        zero = (
            f'<path class="zero" d="M{left} {float(self.y(0.0)):.1f}H{right}"/>' if low < 0.0 < high else ""
        )
        size = f'width="{self.width_px}" height="{self.height_px}"'
        box = f'x="{left}" y="{top}" width="{right - left:.1f}" height="{bottom - top:.1f}"'
        return (
            f'<svg class="ow-plot" {size} viewBox="0 0 {self.width_px} {self.height_px}" font-size="{FONT_PX}">'
            f'<clipPath id="{self._clip}"><rect {box}/></clipPath><rect class="frame" {box}/>{zero}'
            f"{''.join(self._parts)}{'' if self.bare else ''.join(self._axes())}</svg>"
        )
