"""Small plots of the workbench's pages: where ticks, curves and points stand; templates/plots.html draws them as SVG.

With them the residuals of the stars are shown: against magnitude before and after repointing, and as vectors over the
picture, enlarged by a round factor that the title tells. Residuals are observed minus predicted, px.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.report.scales import STRIP_ASPECT, vector_scale
from opnav_workbench.session import ImageSession, SessionState
from opnav_workbench.workbench.markup import render
from opnav_workbench.workbench.overlays import expected_attitude, look_alike
from opnav_workbench.workbench.recent import Recent

__all__ = [
    "ResidualPage",
    "ResidualPlots",
    "StarResiduals",
    "SvgPlot",
    "VectorPlot",
    "data_range",
    "residual_plots",
    "star_residuals",
    "vector_plot",
]


# ---- A small plot: axes with round ticks, curves, points with error bars.

FONT_PX = 11
WANTED_TICKS = 4
LINE_SPACING = 1.4  # of numbers above each other, over their size
RANGE_MARGIN = 0.06  # of the data's range, so that no mark sits on the frame
# Points with a tooltip, error bar and click each; where there are more, those farthest from zero, and the rest as one crowd.
MOST_POINTS = 40


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


@dataclass(frozen=True, slots=True)
class Curve:
    """A line; `places` as SVG has them, px."""

    style: str
    places: str


@dataclass(frozen=True, slots=True)
class Point:
    """A point (px), round or (style ``line``) square, with half the length of its error bar, a tooltip, and whose it is."""

    style: str
    x: float
    y: float
    bar: float
    title: str
    star: str = ""


@dataclass(slots=True)
class SvgPlot:
    """A plot that is built up piece by piece, for the macro `plot` of templates/plots.html.

    Parameters
    ----------
    x_range, y_range : (float, float)
        At left and right, at bottom and top; descending is fine.
    bare
        No axes and no labels: a thumbnail.
    ticks
        About so many on each axis.
    focus_place
        Goes into the page where points that stand out are to be put.
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
    font_px: int = FONT_PX
    focus_place: Markup = Markup("")  # noqa: RUF009 - a text
    curves: list[Curve] = field(default_factory=list)
    crowds: list[Curve] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)

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

    def add_curve(self, x: ArrayLike, y: ArrayLike, style: str) -> "SvgPlot":
        """Draw a line through the finite points."""
        across, down = self.x(x), self.y(y)
        good = np.isfinite(across) & np.isfinite(down)
        places = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across[good], down[good], strict=True))
        self.curves.append(Curve(style, places))
        return self

    def add_points(
        self,
        x: ArrayLike,
        y: ArrayLike,
        style: str,
        sigma: ArrayLike,
        title: Callable[[int], str],
        stars: Sequence[str] = (),
    ) -> "SvgPlot":
        """Draw the finite points with error bars; round, or (style ``line``) square; of `stars`.

        Parameters
        ----------
        title
            Returns the tooltip of a point, where it is drawn by itself.
        """
        across, down = self.x(x), self.y(y)
        bars = np.abs(self.y(np.asarray(sigma)) - self.y(0.0))
        bars = np.where(np.isfinite(bars), bars, 0.0)
        whose = stars or [""] * len(across)
        shown = np.isfinite(across) & np.isfinite(down)
        alone = _alone(np.where(shown, np.abs(np.asarray(y, float)), -1.0)) & shown
        for row in np.flatnonzero(alone).tolist():
            place = float(across[row]), float(down[row])
            self.points.append(Point(style, *place, float(bars[row]), title(row), whose[row]))
        if (shown & ~alone).any():
            self.crowds.append(Curve(style, specks(across[shown & ~alone], down[shown & ~alone])))
        return self

    @property
    def clip(self) -> str:
        """Id of the frame, which curves are clipped to; plots of one page with the same id have the same frame."""
        return "clip" + "-".join(f"{edge:.0f}" for edge in self.frame)

    @property
    def zero(self) -> float | None:
        """Where the line of zero stands down the page, px; None outside the frame."""
        low, high = sorted(self.y_range)
        return float(self.y(0.0)) if low < 0.0 < high else None

    @property
    def x_ticks(self) -> list[tuple[float, str]]:
        """Where ticks stand across (px), and their numbers."""
        values = round_ticks(min(self.x_range), max(self.x_range), self.ticks)
        return [(float(self.x(value)), f"{value:.6g}") for value in values]

    @property
    def y_ticks(self) -> list[tuple[float, str]]:
        """Where ticks stand down the page (px), and their numbers."""
        _, top, _, bottom = self.frame
        room = int((bottom - top) / (LINE_SPACING * self.font_px))  # for as many lines of text
        values = round_ticks(min(self.y_range), max(self.y_range), max(min(self.ticks, room), 1))
        return [(float(self.y(value)), f"{value:.6g}") for value in values]


def _alone(far: FloatArray) -> BoolArray:
    """Tell which points are drawn by themselves: all of few, of many the farthest."""
    if len(far) <= MOST_POINTS:
        return np.ones(len(far), bool)
    alone = np.zeros(len(far), bool)
    alone[np.argpartition(far, -MOST_POINTS)[-MOST_POINTS:]] = True
    return alone


def specks(across: FloatArray, down: FloatArray) -> str:
    """Return dots as one SVG path, one for each screen px.

    Examples
    --------
    >>> specks(np.array([1.0, 1.2, 5.0]), np.array([2.0, 2.1, 7.0]))
    'M1 2h0M5 7h0'
    """
    places = np.unique(np.rint(np.stack([across, down], axis=1)).astype(int), axis=0)
    return "".join(f"M{x} {y}h0" for x, y in places.tolist())


# ---- Residuals of the stars: against magnitude before and after repointing, and as vectors over the picture.


@dataclass(frozen=True, slots=True, eq=False)
class StarResiduals:
    """Residuals of the stars in use.

    Attributes
    ----------
    mag : (n,) array
    place_px : (n, 2) array
        Where they are predicted now.
    before_px, after_px : (n, 2) array
        Observed minus predicted, with the a priori and with the present pointing.
    sigma_px : (n, 2) array
    reference
        What ``after_px`` is relative to: ``after repointing`` or ``from the field found``; empty: nothing but the a priori.
    size_px : (int, int)
        Pixels and lines of the picture.
    """

    ids: tuple[str, ...]
    mag: FloatArray
    place_px: FloatArray
    before_px: FloatArray
    after_px: FloatArray
    sigma_px: FloatArray
    reference: str
    size_px: tuple[int, int]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def is_as(self, other: "StarResiduals") -> bool:
        """Whether all of it is as in another one."""
        if (self.ids, self.reference, self.size_px) != (other.ids, other.reference, other.size_px):
            return False
        names = ("mag", "place_px", "before_px", "after_px", "sigma_px")
        return all(np.array_equal(getattr(self, one), getattr(other, one), equal_nan=True) for one in names)


# As last asked for, of the inputs and the states that they are of.
_KEPT: WeakKeyDictionary[ImageSession, Recent[tuple[object, SessionState, StarResiduals]]] = (
    WeakKeyDictionary()
)


def star_residuals(session: ImageSession) -> StarResiduals:
    """Return the residuals of the stars in use, as the session stands: the same object as long as they are the same."""
    inputs, state = session.inputs, session.state
    kept = _KEPT.setdefault(session, Recent())

    def residuals() -> StarResiduals:
        known = [one for of, at, one in kept if of is inputs and look_alike(at, state)]
        if known:
            return known[0]
        fresh = _residuals_of(session)
        return next((one for _, _, one in kept if fresh.is_as(one)), fresh)

    return kept.of((inputs, state), lambda: (inputs, state, residuals()))[2]


def _residuals_of(session: ImageSession) -> StarResiduals:
    state, context = session.state, session.context
    stars, centers = state.a_priori, state.centers
    size_px = (context.camera.n_pixel, context.camera.n_line)
    if stars is None or centers is None:
        none = np.empty((0, 2))
        return StarResiduals((), np.empty(0), none, none, none, none, "", size_px)
    shown: BoolArray = np.asarray(state.mask("used")) & np.isfinite(centers.pixel_line).all(axis=1)
    place = stars.places(context.camera, expected_attitude(session))
    before = stars.places(context.camera, session.inputs.a_priori_camera_from_j2000)
    return StarResiduals(
        ids=tuple(stars.id[shown].tolist()),
        mag=stars.mag[shown],
        place_px=place[shown],
        before_px=(centers.pixel_line - before)[shown],
        after_px=(centers.pixel_line - place)[shown],
        sigma_px=centers.sigma_px[shown],
        reference=_reference(session),
        size_px=size_px,
    )


def _reference(session: ImageSession) -> str:
    if session.state.pointing is not None:
        return "after repointing"
    return "" if session.state.star_field is None else "from the field found"


@dataclass(frozen=True, slots=True)
class ResidualPlots:
    """Residual against magnitude, from the a priori places and from those now expected; None where these are the same."""

    rows: StarResiduals
    before: SvgPlot
    after: SvgPlot | None

    def focused(self, star: str) -> Iterator[list[Point]]:
        """Yield the points of a star in each of the plots; none where it is not in use."""
        row = [self.rows.ids.index(star)] if star in self.rows.ids else []
        for plot, residual_px in ((self.before, self.rows.before_px), (self.after, self.rows.after_px)):
            if plot is not None:
                alone = replace(plot, curves=[], crowds=[], points=[])
                _add_residuals(alone, self.rows, residual_px, row)
                yield alone.points


FOCUS_PLACE = Markup("<g></g>")


def residual_plots(rows: StarResiduals, size: tuple[int, int]) -> ResidualPlots | None:
    """Return the plots of residual against magnitude, before and after repointing; None without a star in use.

    Parameters
    ----------
    size : (int, int)
        Width and height of each, px.
    """
    if not rows.ids:
        return None
    before = _against_magnitude(rows, rows.before_px, "from the a priori places", size)
    after = _against_magnitude(rows, rows.after_px, rows.reference, size) if rows.reference else None
    return ResidualPlots(rows, before, after)


class ResidualPage:
    """The plots of residual against magnitude as they stand in the page: drawn once for residuals that stay as they are.

    A key that goes to another star, or decides on one, changes but the points that stand out.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._recent: Recent[tuple[ResidualPlots | None, Markup]] = Recent()

    def html(self, rows: StarResiduals, focus: str) -> Markup | None:
        """Return the plots with the star `focus` standing out; None without a star in use."""
        plots, drawn = self._recent.of((rows,), lambda: self._draw(rows))
        if plots is None:
            return None
        first, *others = drawn.split(FOCUS_PLACE)
        points = [render("focus_points.html", list=one) for one in plots.focused(focus)]
        return first + Markup("").join(a + b for a, b in zip(points, others, strict=True))

    def _draw(self, rows: StarResiduals) -> tuple[ResidualPlots | None, Markup]:
        plots = residual_plots(rows, self._size)
        return plots, Markup("") if plots is None else render("residual_plots.html", residuals=plots)


def _against_magnitude(
    rows: StarResiduals, residual_px: FloatArray, title: str, size: tuple[int, int]
) -> SvgPlot:
    reach = residual_px + np.array([-1.0, 1.0])[:, None, None] * rows.sigma_px
    plot = SvgPlot(
        *size, data_range(rows.mag), data_range(reach, with_zero=True), title, focus_place=FOCUS_PLACE
    )
    return _add_residuals(plot, rows, residual_px, range(len(rows.ids)))


def _add_residuals(
    plot: SvgPlot, rows: StarResiduals, residual_px: FloatArray, which: Sequence[int]
) -> SvgPlot:
    """Add the residuals in pixels and lines of some of the stars."""
    ids, index = [rows.ids[row] for row in which], np.array(which, np.intp)
    for column, style in enumerate(("pixel", "line")):
        residual, sigma = residual_px[index, column], rows.sigma_px[index, column]
        plot.add_points(rows.mag[index], residual, style, sigma, _tooltips(ids, style, residual, sigma), ids)
    return plot


def _tooltips(
    ids: Sequence[str], style: str, residual_px: FloatArray, sigma_px: FloatArray
) -> Callable[[int], str]:
    return lambda row: f"{ids[row]}: {style} {residual_px[row]:+.3f} ± {sigma_px[row]:.3f} px"


@dataclass(frozen=True, slots=True)
class Vector:
    """The residual of a star, from where it is predicted, px of the plot."""

    star: str
    x0: float
    y0: float
    x1: float
    y1: float


@dataclass(frozen=True, slots=True)
class VectorPlot:
    """Residual vectors over the picture; of many stars the longest by themselves, the others as one path with its roots."""

    plot: SvgPlot
    vectors: list[Vector]
    crowd: str = ""
    crowd_roots: str = ""


def vector_plot(rows: StarResiduals, width_px: int) -> VectorPlot:
    """Return the residual vectors over the picture, enlarged by a round factor that the title tells."""
    n_pixel, n_line = rows.size_px
    height = 120 if n_pixel > STRIP_ASPECT * n_line else round((width_px - 66) * n_line / n_pixel) + 54
    longest = float(np.hypot(*rows.after_px.T).max()) if rows.ids else 0.0
    scale = vector_scale(longest, n_pixel, n_line)
    title = f"residual vectors, × {scale:g}" if rows.ids else "residual vectors: no star in use"
    plot = SvgPlot(
        width_px, height, (-0.5, n_pixel - 0.5), (n_line - 0.5, -0.5), title, x_label="pixel", y_label="line"
    )
    tips = rows.place_px + scale * rows.after_px
    ends = np.stack(
        [plot.x(rows.place_px[:, 0]), plot.y(rows.place_px[:, 1]), plot.x(tips[:, 0]), plot.y(tips[:, 1])]
    )
    order = np.argsort(-np.hypot(*rows.after_px.T), kind="stable")
    alone, rest = np.sort(order[:MOST_POINTS]), np.sort(order[MOST_POINTS:])
    vectors = [Vector(rows.ids[row], *ends[:, row].tolist()) for row in alone.tolist()]
    crowd = "".join(f"M{x0:.0f} {y0:.0f}L{x1:.0f} {y1:.0f}" for x0, y0, x1, y1 in ends[:, rest].T.tolist())
    return VectorPlot(plot, vectors, crowd, specks(*ends[:2, rest]))
