"""Figures that set methods side by side: their centers with error ellipses, and what each leaves over of the picture.

The second is Figure 16 of Jackman & Dumont (2013), AAS 13-443: differences on one stretch, so that colours compare.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.errors import SessionError
from opnav_workbench.report.body_figure_parts import (
    OUTLINE,
    ShownBody,
    blank,
    draw_mark,
    draw_panel,
    error_ellipse,
    legend_below,
    method_words,
    of_session,
    pictures_of,
    shown_body,
    signed_limit,
)
from opnav_workbench.report.png import png_bytes
from opnav_workbench.session import ImageSession

__all__ = ["difference_figure", "difference_png", "methods_figure", "methods_png"]

Centers = ImageSession | Mapping[str, BodyCenter]
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("solid", (0, (5, 2)), (0, (1, 1)), (0, (5, 2, 1, 2)), (0, (8, 2)), (0, (3, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P")
SIZE_INCH = (13.0, 4.9)
PANEL_INCH, PANEL_ASPECT, MOST_COLUMNS = 4.6, 0.86, 3
MARGIN = 0.1  # of what is shown, around it
CLOSE_UP = 5.0  # sigmas to either side of the best center


def methods_figure(source: Centers, name: str = "", *, truth_px: ArrayLike | None = None) -> Figure:
    """Draw the centers that several methods found of one body, with their 1 sigma error ellipses.

    Parameters
    ----------
    source : ImageSession or mapping of str to BodyCenter
        A mapping's keys are the names in the figure, such as ``"limb scan, by hand"``.
    name : str
        Which body of a session; default the last one found.
    truth_px : (2,) array_like, optional
        True center (pixel, line); it is then the origin, else the center with the smallest sigmas is.

    Returns
    -------
    matplotlib.figure.Figure
        Left all centers, in the middle those near the one with the smallest sigmas.

    Raises
    ------
    SessionError
        No method has found a center.
    """
    shown = {
        label: body for label, body in _bodies(source, name).items() if body.center.pixel_line is not None
    }
    if not shown:
        raise SessionError(f"no center of {name or 'any body'} to show; find_body() makes one.")
    best = min(shown, key=lambda label: _longest(shown[label].center))
    first = shown[best]
    origin = np.asarray(first.center.pixel_line if truth_px is None else truth_px, dtype=np.float64)
    reference = f"the center by {best}" if truth_px is None else "the true center"
    title = f"{first.center.name}: centers less {reference} at pixel {origin[0]:.3f}, line {origin[1]:.3f}   {first.where}"
    figure = blank(*SIZE_INCH, title)
    whole, close = figure.subplots(1, 2)
    places = {label: body.center.pixel_line - origin for label, body in shown.items()}  # type: ignore[operator]
    _frame(whole, *_around(shown, places), "all methods")
    _frame(close, places[best], CLOSE_UP * _longest(first.center), f"close to {best}")
    for axes in (whole, close):
        entries = _draw_centers(axes, shown, places)
        if truth_px is not None:
            (mark,) = axes.plot(0.0, 0.0, "x", color="k", markersize=9, markeredgewidth=1.6, zorder=4)
            entries.append((mark, "true center"))
    _legend(figure, entries)
    return figure


def methods_png(source: Centers, name: str = "", *, truth_px: ArrayLike | None = None) -> bytes:
    """Return `methods_figure` as a PNG, for a notebook: ``display(Image(methods_png(session, "PLUTO")))``."""
    return png_bytes(methods_figure(source, name, truth_px=truth_px))


def difference_figure(source: Centers, name: str = "", *, truth_px: ArrayLike | None = None) -> Figure:
    """Draw data minus model at the solutions of several methods, with one stretch for all.

    Parameters
    ----------
    source : ImageSession or mapping of str to BodyCenter
    name : str
        Which body of a session; default the last one found.
    truth_px : (2,) array_like, optional
        True center (pixel, line); titles then tell how far off every center is.

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window.

    Raises
    ------
    SessionError
        No center comes with pictures.
    """
    shown = {label: body for label, body in _bodies(source, name).items() if body.center.pictures is not None}
    if not shown:
        raise SessionError(
            f"no center of {name or 'any body'} has pictures to show; find_body() with a method for extended bodies "
            "makes them."
        )
    rows = -(-len(shown) // MOST_COLUMNS)
    columns = -(-len(shown) // rows)
    first = next(iter(shown.values()))
    title = f"{first.center.name}: data − model at the solution of each method, one stretch   {first.where}"
    figure = blank(PANEL_INCH * columns, 0.9 + PANEL_ASPECT * PANEL_INCH * rows, title)
    panels = figure.subplots(rows, columns, squeeze=False)
    limit = signed_limit(*(pictures_of(body).difference_dn for body in shown.values()))
    for axes, (label, body) in zip(panels.flat, shown.items(), strict=False):
        _difference(axes, label, body, limit, truth_px)
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("line", fontsize=9)
    legend_below(figure, _marks(panels[0, 0]))
    return figure


def difference_png(source: Centers, name: str = "", *, truth_px: ArrayLike | None = None) -> bytes:
    """Return `difference_figure` as a PNG, for a notebook."""
    return png_bytes(difference_figure(source, name, truth_px=truth_px))


def _bodies(source: Centers, name: str) -> dict[str, ShownBody]:
    """Return the centers to show under the names they have in the figure, in their order."""
    if isinstance(source, Mapping):
        return {label: shown_body(center) for label, center in source.items()}
    name = name or shown_body(source).center.name
    return {method_words(b.method): of_session(source, b) for b in source.state.bodies if b.name == name}


# -- centers with their ellipses -------------------------------------------------------------------------------------


def _longest(center: BodyCenter) -> float:
    """Return the semi-major axis of a center's error ellipse, px; a far too large one where it is not known."""
    finite = np.isfinite(center.covariance_px2).all()
    return max(float(np.sqrt(np.linalg.eigvalsh(center.covariance_px2)[-1])), 1e-6) if finite else np.inf


def _around(shown: Mapping[str, ShownBody], places: Mapping[str, FloatArray]) -> tuple[FloatArray, float]:
    """Return middle and half side of the square that holds the origin and all ellipses."""
    reach = np.array([np.nan_to_num(_longest(body.center), posinf=0.0) for body in shown.values()])[:, None]
    centers = np.array(list(places.values()))
    low = np.minimum((centers - reach).min(axis=0), 0.0)
    high = np.maximum((centers + reach).max(axis=0), 0.0)
    return 0.5 * (low + high), (0.5 + MARGIN) * max(float((high - low).max()), 1e-6)


def _frame(axes: Axes, middle: FloatArray, half: float, title: str) -> None:
    if not np.isfinite(half):
        half = 1.0
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] + half, middle[1] - half))
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("pixel, px", fontsize=9)
    axes.set_ylabel("line, px (down)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25)


def _draw_centers(
    axes: Axes, shown: Mapping[str, ShownBody], places: Mapping[str, FloatArray]
) -> list[tuple[Artist, str]]:
    entries: list[tuple[Artist, str]] = []
    for index, (label, body) in enumerate(shown.items()):
        color, dashes, marker = (styles[index % len(styles)] for styles in (COLORS, DASHES, MARKERS))
        place, covariance = places[label], body.center.covariance_px2
        (mark,) = axes.plot(*place, marker=marker, color=color, linestyle=dashes, markersize=5, linewidth=1.3)
        if np.isfinite(covariance).all():
            axes.add_patch(
                error_ellipse(place, covariance, 1.0, edgecolor=color, linestyle=dashes, linewidth=1.3)
            )
        sigma = np.sqrt(np.diag(covariance))
        numbers = f"pixel {place[0]:+.3f} ± {sigma[0]:.3f}, line {place[1]:+.3f} ± {sigma[1]:.3f}"
        entries.append((mark, f"{label} ({body.center.status})\n{numbers}"))
    return entries


def _legend(figure: Figure, entries: list[tuple[Artist, str]]) -> None:
    handles, labels = zip(*entries, strict=True)
    figure.legend(
        handles,
        labels,
        loc="outside right upper",
        fontsize=8.5,
        labelspacing=1.0,
        handlelength=3.5,
        title="center ± 1 sigma, px; ellipses are 1 sigma;\nof the center alone, without the pointing's",
        title_fontsize=8.5,
        alignment="left",
    )


# -- differences -----------------------------------------------------------------------------------------------------


def _difference(axes: Axes, label: str, body: ShownBody, limit: float, truth_px: ArrayLike | None) -> None:
    pictures, place = pictures_of(body), body.center.pixel_line
    title = label
    if truth_px is not None and place is not None:
        off = place - np.asarray(truth_px)
        title += f": off by {off[0]:+.3f}, {off[1]:+.3f} px"
    draw_panel(axes, pictures.window, pictures.difference_dn, (-limit, limit), title, cmap="RdBu_r")
    limits = axes.axis()
    if len(body.outline_px):
        axes.plot(*np.concatenate([body.outline_px, body.outline_px[:1]]).T, **OUTLINE)
        axes.axis(limits)
    draw_mark(axes, "observed", place)


def _marks(axes: Axes) -> list[tuple[Artist, str]]:
    """Return a panel's marks with their meaning: a line of many points is the limb, a single one the center."""
    words = {True: "limb of the model at the observed center", False: "observed center"}
    return [(line, words[len(np.asarray(line.get_xdata())) > 1]) for line in axes.lines]
