"""The summary figure of a picture: stretched image with predicted and observed places, residual vectors, residuals.

The paper's Figures 10 and 12 for one picture. Predicted places are yellow circles, observed ones blue crosses,
stars not used vermilion squares, targets purple diamonds. An image much wider than high (MVIC, TDI scans) is shown
as strips, one under the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from astropy.visualization import AsinhStretch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.files import atomic_path
from opnav_workbench.report.drawing import (
    BODY_COLOR,
    LINE_COLOR,
    OBSERVED_COLOR,
    PIXEL_COLOR,
    PREDICTED_COLOR,
    REJECTED_COLOR,
    png_bytes,
    titled_figure,
)
from opnav_workbench.report.scales import STRIP_ASPECT, vector_scale
from opnav_workbench.session import MEASURED_STATUSES, ImageSession

__all__ = ["summary_figure", "summary_png", "write_summary"]


# A session's figure, and what of the session it shows.
_DRAWN: WeakKeyDictionary[ImageSession, tuple[tuple[object, object], bytes]] = WeakKeyDictionary()

# ---- Layout of the summary figure for square frames and for long strips.
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


# ---- One figure a picture: stretched frame with predicted and observed places, residual vectors, residual ...
# The stretch begins below the background, so that its noise is seen as dark grain, and ends well inside the stars.
LOW_SIGMAS, HIGH_SIGMAS = -1.5, 60.0
ASINH_SOFTENING = 0.05


def write_summary(session: ImageSession, path: str | Path) -> None:
    """Write the summary figure as a PNG, whole or not at all."""
    picture = summary_png(session)
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture)


def summary_png(session: ImageSession) -> bytes:
    """Return the summary figure as a PNG, for a notebook: ``display(Image(summary_png(session)))``.

    As long as nothing is done in the session it is drawn once, for the notebook and for its file.
    """
    shown = (session.state, session.context)
    before, picture = _DRAWN.get(session, (None, b""))
    if before is None or any(now is not then for now, then in zip(shown, before, strict=True)):
        picture = png_bytes(summary_figure(session))
        _DRAWN[session] = (shown, picture)
    return picture


def summary_figure(session: ImageSession) -> Figure:
    """Draw a session's summary (the paper's Figures 10 and 12 for this picture).

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window.
    """
    panels = panels_of(session.context.picture.image_dn.shape)
    figure = titled_figure(*panels.size_inch, _title(session))
    _draw_image(panels, figure, session)
    vectors, before, after = panels.plots(figure)
    _draw_vectors(vectors, session)
    _draw_residuals(before, after, session)
    return figure


def _title(session: ImageSession) -> str:
    context, pointing = session.context, session.state.pointing
    picture, camera = context.picture, context.camera
    first = f"{picture.name}   {camera.name}   {session.inputs.utc} UTC   {picture.exposure_s:g} s"
    if pointing is None:
        return f"{first}\npointing not determined"
    return (
        f"{first}\n"
        f"RA {np.degrees(pointing.ra_rad):.5f}°   Dec {np.degrees(pointing.dec_rad):+.5f}°  "
        f"twist {np.degrees(pointing.twist_rad):.4f}°   moved {pointing.delta_pixel:+.2f} px, "
        f"{pointing.delta_line:+.2f} lines, {np.degrees(pointing.delta_twist_rad):+.4f}°   "
        f"{pointing.rests_on}"
    )


def _draw_image(panels: Panels, figure: Figure, session: ImageSession) -> None:
    n_line = session.context.picture.image_dn.shape[0]
    scaled = _stretched(session)
    for axes, first, last in panels.pictures(figure):
        axes.imshow(
            scaled[:, first:last],
            cmap="gray",
            origin="upper",
            interpolation="nearest",
            extent=(first - 0.5, last - 0.5, n_line - 0.5, -0.5),
        )
        _draw_marks(axes, session, first, last)
        axes.set_ylabel("line")
    axes.set_xlabel("pixel")
    _draw_legend(figure)


def _stretched(session: ImageSession) -> FloatArray:
    """Asinh stretch from just below the background to well into the stars, 0..1; bad pixels are black."""
    context = session.context
    signal = np.where(context.bad, np.nan, context.signal_dn)
    noise = float(np.nanmedian(context.noise_dn))
    low, high = LOW_SIGMAS * noise, max(HIGH_SIGMAS * noise, float(np.nanpercentile(signal, 99.8)))
    scaled = AsinhStretch(ASINH_SOFTENING)(np.clip((signal - low) / (high - low), 0.0, 1.0))
    return np.nan_to_num(np.asarray(scaled, dtype=np.float64))


def _draw_marks(axes: Axes, session: ImageSession, first: int, last: int) -> None:
    n_line = session.context.picture.image_dn.shape[0]
    for place in _star_places(session):
        _mark(axes, place, first, last, n_line, "o", PREDICTED_COLOR)
    for place, used in _observed(session):
        _mark(
            axes, place, first, last, n_line, "+" if used else "s", OBSERVED_COLOR if used else REJECTED_COLOR
        )
    for number, body in enumerate(session.current_observables):
        if _mark(axes, body.predicted_px, first, last, n_line, "D", BODY_COLOR):
            above = number % 2 == 0  # names of near neighbours then do not cover each other
            left = body.predicted_px[0] > first + 0.85 * (last - first)  # no room on the right
            axes.annotate(
                body.name,
                (float(body.predicted_px[0]), float(body.predicted_px[1])),
                (-12 if left else 12, 8 if above else -14),
                ha="right" if left else "left",
                textcoords="offset points",
                color=BODY_COLOR,
                fontsize=9,
                path_effects=[withStroke(linewidth=2.5, foreground="black")],
            )
        if body.observed_px is not None:
            _mark(axes, body.observed_px, first, last, n_line, "+", OBSERVED_COLOR)
    axes.set_xlim(first - 0.5, last - 0.5)
    axes.set_ylim(n_line - 0.5, -0.5)


def _mark(axes: Axes, place: FloatArray, first: int, last: int, n_line: int, marker: str, color: str) -> bool:
    """Draw one mark if it lies in this part of the picture."""
    if not (first - 0.5 <= place[0] < last - 0.5 and -0.5 <= place[1] < n_line - 0.5):
        return False
    style = _style(marker, color)
    axes.plot(*place, **style)
    return True


def _style(marker: str, color: str) -> dict[str, Any]:
    sizes = {"o": 13.0, "+": 7.0, "s": 13.0, "D": 13.0}
    return {
        "marker": marker,
        "color": color,
        "markersize": sizes[marker],
        "markeredgewidth": 1.2,
        "markerfacecolor": "none",
        "linestyle": "none",
    }


def _draw_legend(figure: Figure) -> None:
    entries = (
        ("star predicted", "o", PREDICTED_COLOR),
        ("observed", "+", OBSERVED_COLOR),
        ("star not used", "s", REJECTED_COLOR),
        ("target predicted", "D", BODY_COLOR),
    )
    handles = [Line2D([], [], **_style(marker, color), label=text) for text, marker, color in entries]
    legend = figure.legend(
        handles=handles, loc="upper right", ncols=4, fontsize=8, facecolor="0.25", labelcolor="w"
    )
    legend.set_in_layout(False)


def _star_places(session: ImageSession) -> FloatArray:
    stars = session.state.a_priori
    if stars is None:
        return np.empty((0, 2))
    return stars.places(session.context.camera, session.camera_from_j2000)


def _observed(session: ImageSession) -> list[tuple[FloatArray, bool]]:
    state = session.state
    if state.centers is None:
        return []
    return [
        (center, status.status == "used")
        for center, status in zip(state.centers.pixel_line, state.status, strict=True)
        if status.status in MEASURED_STATUSES
    ]


def _draw_vectors(axes: Axes, session: ImageSession) -> None:
    n_line, n_pixel = session.context.picture.image_dn.shape
    axes.set(xlim=(-0.5, n_pixel - 0.5), ylim=(n_line - 0.5, -0.5), xlabel="pixel", ylabel="line")
    if n_pixel <= STRIP_ASPECT * n_line:
        axes.set_aspect("equal")
    pointing, stars = session.state.pointing, session.state.a_priori
    if pointing is None or stars is None or not pointing.used.any():
        axes.set_title("residual vectors: no pointing", fontsize=9)
        return
    used = pointing.used
    places, residual = _star_places(session)[used], pointing.residual_px[used]
    scale = vector_scale(float(np.hypot(*residual.T).max()), n_pixel, n_line)
    axes.quiver(
        *places.T,
        *(residual * scale).T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        color=PIXEL_COLOR,
        width=0.004,
    )
    axes.plot(*places.T, "o", color=PREDICTED_COLOR, markeredgecolor="k", markersize=4)
    axes.set_title(f"residuals, observed − predicted, × {scale:g}", fontsize=9)


def _draw_residuals(before: Axes, after: Axes, session: ImageSession) -> None:
    stars, centers, pointing = session.state.a_priori, session.state.centers, session.state.pointing
    for axes, title in ((before, "before repointing"), (after, "after repointing")):
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("magnitude")
        axes.set_ylabel("observed − predicted, px")
    if stars is None or centers is None:
        return
    shown = session.state.mask("used")
    sigma = np.sqrt(np.diagonal(centers.covariance_px2, axis1=1, axis2=2))
    _plot_residuals(before, stars.mag, centers.pixel_line - stars.pixel_line, sigma, shown)
    before.legend(fontsize=8, loc="best")
    if pointing is not None:
        _plot_residuals(after, stars.mag, centers.pixel_line - _star_places(session), sigma, shown)


def _plot_residuals(
    axes: Axes, mag: FloatArray, residual: FloatArray, sigma: FloatArray, shown: BoolArray
) -> None:
    for column, (name, color, marker) in enumerate((("pixel", PIXEL_COLOR, "o"), ("line", LINE_COLOR, "s"))):
        axes.errorbar(
            mag[shown],
            residual[shown, column],
            sigma[shown, column],
            fmt=marker,
            color=color,
            markersize=4,
            linewidth=0.8,
            label=name,
        )
