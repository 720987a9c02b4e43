"""Figures of a body's center: with one method, and with several side by side.

One method: data, model at the solution and their difference (Figures 13 and 16 of Jackman & Dumont 2013, AAS
13-443); data and model share one linear stretch, the difference has its own, even about zero. Several methods:
their centers with 1 sigma error ellipses, and their differences on one stretch, so that colours compare.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter, BodyResiduals
from opnav_workbench.errors import SessionError
from opnav_workbench.report.body_panels import (
    DARK_EDGE,
    OUTLINE,
    ShownBody,
    draw_compass,
    draw_mark,
    draw_panel,
    legend_below,
    linear_limits,
    method_title,
    pictures_around,
    shown_body,
    shown_of_session,
    symmetric_limit,
    title_remarks,
)
from opnav_workbench.report.drawing import (
    OBSERVED_COLOR,
    SERIES_COLORS,
    error_ellipse_patch,
    png_bytes,
    titled_figure,
    write_png,
)
from opnav_workbench.report.scales import round_scale
from opnav_workbench.session import ImageSession

__all__ = [
    "body_figure",
    "body_png",
    "difference_figure",
    "difference_png",
    "methods_figure",
    "methods_png",
    "write_body",
]


# ---- Figure of a body's center with one method: data, model at the solution, and their difference.

# The error ellipse is enlarged so that its longer semi-axis is at most this share of the picture's smaller side.
ELLIPSE_SHARE = 0.15
WIDTH_INCH, DATA_PANEL_INCH = 14.0, 3.55
AROUND_INCH, TITLE_INCH = 1.15, 0.19  # labels and legend; a line of the title
VEIL = 0.45  # opacity over pixels that were not used
RIM = 2  # px around the sub-array: methods that leave it out leave out no light
CENTER_NAMES = {"predicted": "predicted center", "observed": "observed center", "truth": "true center"}


def body_figure(
    source: BodyCenter | ImageSession,
    name: str = "",
    method: str = "",
    *,
    truth_px: FloatArray | None = None,
) -> Figure:
    """Draw data, model at the solution and difference side by side.

    Parameters
    ----------
    name, method
        Which center of a session; default its last one.
    truth_px : (2,) array_like, optional
        True center (pixel, line), where it is known.

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window.

    Raises
    ------
    SessionError
        There is no such center, or it comes without pictures.
    """
    shown = shown_body(source, name, method)
    pictures = pictures_around(shown)
    n_pixel, n_line = pictures.window[2:]
    title = _center_title(shown)
    height = DATA_PANEL_INCH * float(np.clip(n_line / n_pixel, 0.4, 1.6)) + AROUND_INCH
    figure = titled_figure(WIDTH_INCH, height + TITLE_INCH * (1 + title.count("\n")), title)
    panels = figure.subplots(1, 3)
    entries = _draw_pictures(panels, pictures)
    draw_compass(panels[0], shown)
    truth = None if truth_px is None else np.asarray(truth_px, dtype=np.float64)
    legend_below(figure, [*_draw_marks(panels, shown, truth), *entries])
    panels[0].set_ylabel("line", fontsize=9)
    return figure


def body_png(
    source: BodyCenter | ImageSession, name: str = "", method: str = "", *, truth_px: FloatArray | None = None
) -> bytes:
    """Return `body_figure` as a PNG, for a notebook: ``display(Image(body_png(session, "PLUTO")))``."""
    return png_bytes(body_figure(source, name, method, truth_px=truth_px))


def write_body(source: BodyCenter | ImageSession, path: str | Path, name: str = "", method: str = "") -> None:
    """Write `body_figure` as a PNG, whole or not at all."""
    write_png(body_figure(source, name, method), path)


def _center_title(shown: ShownBody) -> str:
    center = shown.center
    lines = [f"{center.name}, {method_title(center.method)}: {center.status}   {shown.where}".rstrip()]
    if center.pixel_line is not None:
        lines.append(_center_numbers(shown, center.pixel_line))
    return "\n".join([*lines, *title_remarks(center)])


def _center_numbers(shown: ShownBody, place: FloatArray) -> str:
    center = shown.center
    sigma = np.sqrt(np.diag(center.covariance_px2))
    words = [f"pixel {place[0]:.3f} ± {sigma[0]:.3f}   line {place[1]:.3f} ± {sigma[1]:.3f}"]
    if shown.predicted_px is not None:
        o_c = place - shown.predicted_px
        words.append(f"observed − predicted {o_c[0]:+.2f}, {o_c[1]:+.2f} px")
    if np.isfinite(center.diameter_px):
        words.append(f"diameter {center.diameter_px:.2f} ± {center.diameter_sigma_px:.2f} px")
    if np.isfinite(center.chi2_reduced):
        words.append(f"reduced χ² {center.chi2_reduced:.2f}")
    return "   ".join(words)


def _draw_pictures(panels: Sequence[Axes], pictures: BodyResiduals) -> list[tuple[Artist, str]]:
    """Draw the three panels; return what the veil over pixels that were not used means, where there is one."""
    window, light = pictures.window, linear_limits(pictures.data_dn, pictures.model_dn)
    limit = symmetric_limit(pictures.difference_dn)
    draw_panel(panels[0], window, pictures.data_dn, light, "data, background removed")
    draw_panel(panels[1], window, pictures.model_dn, light, "model at the solution")
    draw_panel(panels[2], window, pictures.difference_dn, (-limit, limit), "data − model", cmap="RdBu_r")
    if not (~pictures.mask)[RIM:-RIM, RIM:-RIM].any():
        return []
    veil = np.where(pictures.mask, np.nan, 1.0)
    panels[2].imshow(veil, cmap=ListedColormap(["0.5"]), alpha=VEIL, extent=panels[2].images[0].get_extent())
    return [(Patch(facecolor="0.65", edgecolor="w", linewidth=0.6), "veiled: pixels not used")]


def _draw_marks(
    panels: Sequence[Axes], shown: ShownBody, truth: FloatArray | None
) -> list[tuple[Artist, str]]:
    entries: dict[str, Artist] = {}
    places = {"predicted": shown.predicted_px, "observed": shown.center.pixel_line, "truth": truth}
    _draw_circle(panels[0], shown, entries)
    for axes in panels:
        limits = axes.axis()
        if len(shown.outline_px):
            closed = np.concatenate([shown.outline_px, shown.outline_px[:1]])
            (entries["limb of the model at the observed center"],) = axes.plot(*closed.T, **OUTLINE)
        axes.axis(limits)
        for what, place in places.items():
            artist = draw_mark(axes, what, place)
            if artist is not None:
                entries[CENTER_NAMES[what]] = artist
    _draw_ellipse(panels[0], shown.center, entries)
    return [(artist, text) for text, artist in entries.items()]


def _draw_circle(axes: Axes, shown: ShownBody, entries: dict[str, Artist]) -> None:
    if shown.circle is not None:
        pixel, line = (float(value) for value in shown.circle.center_px)
        style = {"fill": False, "edgecolor": "w", "linestyle": ":", "linewidth": 1.4}
        axes.add_patch(Circle((pixel, line), shown.circle.radius_px, **style))
        entries["analyst's circle"] = Line2D([], [], color="w", linestyle=":", linewidth=1.4)


def _draw_ellipse(axes: Axes, center: BodyCenter, entries: dict[str, Artist]) -> None:
    """Draw the error ellipse as large as is seen well, and say by how much it is enlarged."""
    if center.pixel_line is None or not np.isfinite(center.covariance_px2).all():
        return
    side = min(abs(np.diff(axes.get_xlim())[0]), abs(np.diff(axes.get_ylim())[0]))
    factor = max(1.0, round_scale(ELLIPSE_SHARE * side / _semi_major_px(center)))
    style = {"edgecolor": OBSERVED_COLOR, "linewidth": 1.3, "path_effects": [DARK_EDGE]}
    axes.add_patch(error_ellipse_patch(center.pixel_line, center.covariance_px2, factor, **style))
    enlarged = f", drawn {factor:g} × larger" if factor > 1.0 else ""
    entries[f"1 sigma error ellipse of the observed center{enlarged}"] = Line2D(
        [], [], color=OBSERVED_COLOR, linewidth=1.3
    )


# ---- Figures that set methods side by side.

CentersByMethod = ImageSession | Mapping[str, BodyCenter]
DASHES = ("solid", (0, (5, 2)), (0, (1, 1)), (0, (5, 2, 1, 2)), (0, (8, 2)), (0, (3, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P")
SIZE_INCH = (13.0, 4.9)
DIFFERENCE_PANEL_INCH, PANEL_ASPECT, MOST_COLUMNS = 4.6, 0.86, 3
MARGIN = 0.1  # of what is shown, around it
CLOSE_UP = 5.0  # sigmas to either side of the best center


def methods_figure(source: CentersByMethod, name: str = "", *, truth_px: ArrayLike | None = None) -> Figure:
    """Draw the centers that several methods found of one body, with their 1 sigma error ellipses.

    Parameters
    ----------
    source : ImageSession or mapping of str to BodyCenter
        A mapping's keys are the names in the figure, such as ``"limb scan, by hand"``.
    name
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
        label: body
        for label, body in _shown_by_method(source, name).items()
        if body.center.pixel_line is not None
    }
    if not shown:
        raise SessionError(f"no center of {name or 'any body'} to show; find_body() makes one.")
    best = min(shown, key=lambda label: _semi_major_px(shown[label].center))
    first = shown[best]
    origin = np.asarray(first.center.pixel_line if truth_px is None else truth_px, dtype=np.float64)
    reference = f"the center by {best}" if truth_px is None else "the true center"
    title = f"{first.center.name}: centers less {reference} at pixel {origin[0]:.3f}, line {origin[1]:.3f}   {first.where}"
    figure = titled_figure(*SIZE_INCH, title)
    whole, close = figure.subplots(1, 2)
    places = {label: body.center.pixel_line - origin for label, body in shown.items()}  # type: ignore[operator]
    _set_view(whole, *_square_around(shown, places), "all methods")
    _set_view(close, places[best], CLOSE_UP * _semi_major_px(first.center), f"close to {best}")
    for axes in (whole, close):
        entries = _draw_centers(axes, shown, places)
        if truth_px is not None:
            (mark,) = axes.plot(0.0, 0.0, "x", color="k", markersize=9, markeredgewidth=1.6, zorder=4)
            entries.append((mark, "true center"))
    _legend(figure, entries)
    return figure


def methods_png(source: CentersByMethod, name: str = "", *, truth_px: ArrayLike | None = None) -> bytes:
    """Return `methods_figure` as a PNG, for a notebook: ``display(Image(methods_png(session, "PLUTO")))``."""
    return png_bytes(methods_figure(source, name, truth_px=truth_px))


def difference_figure(
    source: CentersByMethod, name: str = "", *, truth_px: ArrayLike | None = None
) -> Figure:
    """Draw data minus model at the solutions of several methods, with one stretch for all.

    Parameters
    ----------
    source : ImageSession or mapping of str to BodyCenter
    name
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
    shown = {
        label: body
        for label, body in _shown_by_method(source, name).items()
        if body.center.pictures is not None
    }
    if not shown:
        raise SessionError(
            f"no center of {name or 'any body'} has pictures to show; find_body() with a method for extended bodies "
            "makes them."
        )
    rows = -(-len(shown) // MOST_COLUMNS)
    columns = -(-len(shown) // rows)
    first = next(iter(shown.values()))
    title = f"{first.center.name}: data − model at the solution of each method, one stretch   {first.where}"
    figure = titled_figure(
        DIFFERENCE_PANEL_INCH * columns, 0.9 + PANEL_ASPECT * DIFFERENCE_PANEL_INCH * rows, title
    )
    panels = figure.subplots(rows, columns, squeeze=False)
    limit = symmetric_limit(*(pictures_around(body).difference_dn for body in shown.values()))
    for axes, (label, body) in zip(panels.flat, shown.items(), strict=False):
        _draw_difference(axes, label, body, limit, truth_px)
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("line", fontsize=9)
    legend_below(figure, _legend_entries(panels[0, 0]))
    return figure


def difference_png(source: CentersByMethod, name: str = "", *, truth_px: ArrayLike | None = None) -> bytes:
    """Return `difference_figure` as a PNG, for a notebook."""
    return png_bytes(difference_figure(source, name, truth_px=truth_px))


def _shown_by_method(source: CentersByMethod, name: str) -> dict[str, ShownBody]:
    """Return the centers to show under the names they have in the figure, in their order."""
    if isinstance(source, Mapping):
        return {label: shown_body(center) for label, center in source.items()}
    name = name or shown_body(source).center.name
    return {
        method_title(b.method): shown_of_session(source, b) for b in source.state.bodies if b.name == name
    }


# -- centers with their ellipses -------------------------------------------------------------------------------------


def _semi_major_px(center: BodyCenter) -> float:
    """Return the semi-major axis of a center's error ellipse, px; a far too large one where it is not known."""
    finite = np.isfinite(center.covariance_px2).all()
    return max(float(np.sqrt(np.linalg.eigvalsh(center.covariance_px2)[-1])), 1e-6) if finite else np.inf


def _square_around(
    shown: Mapping[str, ShownBody], places: Mapping[str, FloatArray]
) -> tuple[FloatArray, float]:
    """Return middle and half side of the square that holds the origin and all ellipses."""
    reach = np.array([np.nan_to_num(_semi_major_px(body.center), posinf=0.0) for body in shown.values()])[
        :, None
    ]
    centers = np.array(list(places.values()))
    low = np.minimum((centers - reach).min(axis=0), 0.0)
    high = np.maximum((centers + reach).max(axis=0), 0.0)
    return 0.5 * (low + high), (0.5 + MARGIN) * max(float((high - low).max()), 1e-6)


def _set_view(axes: Axes, middle: FloatArray, half: float, title: str) -> None:
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
        color, dashes, marker = (styles[index % len(styles)] for styles in (SERIES_COLORS, DASHES, MARKERS))
        place, covariance = places[label], body.center.covariance_px2
        (mark,) = axes.plot(*place, marker=marker, color=color, linestyle=dashes, markersize=5, linewidth=1.3)
        if np.isfinite(covariance).all():
            axes.add_patch(
                error_ellipse_patch(place, covariance, 1.0, edgecolor=color, linestyle=dashes, linewidth=1.3)
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


def _draw_difference(
    axes: Axes, label: str, body: ShownBody, limit: float, truth_px: ArrayLike | None
) -> None:
    pictures, place = pictures_around(body), body.center.pixel_line
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


def _legend_entries(axes: Axes) -> list[tuple[Artist, str]]:
    """Return a panel's marks with their meaning: a line of many points is the limb, a single one the center."""
    words = {True: "limb of the model at the observed center", False: "observed center"}
    return [(line, words[len(np.asarray(line.get_xdata())) > 1]) for line in axes.lines]
