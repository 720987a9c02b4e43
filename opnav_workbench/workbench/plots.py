"""Small plots of the workbench's pages, as SVG: axes with round ticks, points with error bars, lines.

Colors are CSS classes, for light and dark. With them the residuals of the stars are shown: against magnitude before and
after repointing, and as vectors over the picture, enlarged by a round factor that the title tells. Residuals are
observed minus predicted, px.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.report.drawing import round_scale
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.markup import text

__all__ = ["SvgPlot", "residual_plots", "small_residual_plots", "star_residuals", "vector_plot"]


# ---- Small plots as SVG: axes with round ticks, points with error bars, lines. Colors are CSS classes, for ...

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
class SvgPlot:
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

    def line(self, x: ArrayLike, y: ArrayLike, style: str) -> "SvgPlot":
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
    ) -> "SvgPlot":
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

    def raw(self, svg: str) -> "SvgPlot":
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


# ---- Residuals of the stars: against magnitude before and after repointing, and as vectors over the frame.

VECTOR_SHARE = 0.12  # of the frame's shorter side, for the longest residual
STRIP_ASPECT = 4.0  # a frame longer than this is drawn without square pixels
RESIDUAL_LEGEND = (
    '<p class="legend"><span class="key pixel">● pixel</span><span class="key line">■ line</span>'
    "<span>observed − predicted, px, against magnitude</span></p>"
)


@dataclass(frozen=True, slots=True, eq=False)
class StarResiduals:
    """Residuals of the stars in use.

    Attributes
    ----------
    ids : tuple of str
    mag : (n,) array
    place_px : (n, 2) array
        Where they are predicted now.
    before_px, after_px : (n, 2) array
        Observed minus predicted, with the a priori and with the present pointing.
    sigma_px : (n, 2) array
    solved : bool
        Whether a pointing stands, so that ``after_px`` means something.
    frame : (int, int)
        Pixels and lines of the frame.
    """

    ids: tuple[str, ...]
    mag: FloatArray
    place_px: FloatArray
    before_px: FloatArray
    after_px: FloatArray
    sigma_px: FloatArray
    solved: bool
    frame: tuple[int, int]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def star_residuals(session: ImageSession) -> StarResiduals:
    """Return the residuals of the stars in use, as the session stands."""
    state, context = session.state, session.context
    stars, centers = state.a_priori, state.centers
    frame = (context.camera.n_pixel, context.camera.n_line)
    if stars is None or centers is None:
        none = np.empty((0, 2))
        return StarResiduals((), np.empty(0), none, none, none, none, False, frame)
    shown: BoolArray = np.asarray(state.mask("used")) & np.isfinite(centers.pixel_line).all(axis=1)
    place = stars.places(context.camera, session.camera_from_j2000)
    before = stars.places(context.camera, session.inputs.a_priori_camera_from_j2000)
    return StarResiduals(
        ids=tuple(stars.id[shown].tolist()),
        mag=stars.mag[shown],
        place_px=place[shown],
        before_px=(centers.pixel_line - before)[shown],
        after_px=(centers.pixel_line - place)[shown],
        sigma_px=centers.sigma_px[shown],
        solved=state.pointing is not None,
        frame=frame,
    )


def _against_magnitude(
    rows: StarResiduals, residual_px: FloatArray, title: str, size: tuple[int, int], *, y_label: str
) -> str:
    reach = residual_px + np.array([-1.0, 1.0])[:, None, None] * rows.sigma_px
    plot = SvgPlot(
        *size, data_range(rows.mag), data_range(reach, with_zero=True), title, x_label="", y_label=y_label
    )
    for column, style in enumerate(("pixel", "line")):
        titles = [
            f"{star}: {style} {value:+.3f} ± {sigma:.3f} px"
            for star, value, sigma in zip(
                rows.ids, residual_px[:, column], rows.sigma_px[:, column], strict=True
            )
        ]
        plot.points(rows.mag, residual_px[:, column], style, rows.sigma_px[:, column], titles)
    return plot.svg()


def small_residual_plots(rows: StarResiduals) -> str:
    """Return before and after side by side, small; nothing before stars are found."""
    return residual_plots(rows, (222, 118), y_label="") if rows.ids else ""


def residual_plots(rows: StarResiduals, size: tuple[int, int], y_label: str = "residual, px") -> str:
    """Return the plots of residual against magnitude, before and after repointing."""
    if not rows.ids:
        return '<p class="hint">No star is in use: nothing to plot.</p>'
    after = (
        _against_magnitude(rows, rows.after_px, "after repointing", size, y_label=y_label)
        if rows.solved
        else f'<div class="blank" style="width:{size[0]}px;height:{size[1]}px">not repointed yet</div>'
    )
    before = _against_magnitude(rows, rows.before_px, "before repointing", size, y_label=y_label)
    return f'<div class="plots">{before}{after}</div>{RESIDUAL_LEGEND}'


def vector_plot(rows: StarResiduals, width_px: int) -> str:
    """Return the residual vectors over the frame, enlarged by a round factor that the title tells."""
    n_pixel, n_line = rows.frame
    height = 120 if n_pixel > STRIP_ASPECT * n_line else round((width_px - 66) * n_line / n_pixel) + 54
    longest = float(np.hypot(*rows.after_px.T).max()) if rows.ids else 0.0
    scale = round_scale(VECTOR_SHARE * max(min(n_pixel, n_line), 0.05 * n_pixel) / max(longest, 1e-6))
    plot = SvgPlot(
        width_px,
        height,
        (-0.5, n_pixel - 0.5),
        (n_line - 0.5, -0.5),
        f"residual vectors, × {scale:g}" if rows.ids else "residual vectors: no star in use",
        x_label="pixel",
        y_label="line",
    )
    for star, place, residual in zip(rows.ids, rows.place_px, rows.after_px, strict=True):
        tip = place + scale * residual
        (x0, x1), (y0, y1) = plot.x([place[0], tip[0]]), plot.y([place[1], tip[1]])
        plot.raw(
            f'<path class="vector" d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"><title>{star}</title></path>'
        )
        plot.raw(f'<circle class="root" cx="{x0:.1f}" cy="{y0:.1f}" r="2.5"/>')
    return plot.svg()
