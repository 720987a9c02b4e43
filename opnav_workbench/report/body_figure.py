"""Figure of a body's center with one method: data, model at the solution, and their difference.

As Figures 13 and 16 of Jackman & Dumont (2013), AAS 13-443. Data and model share one linear stretch; the difference has
its own, even about zero.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter, BodyPictures
from opnav_workbench.report.body_figure_parts import (
    EDGE,
    OUTLINE,
    ShownBody,
    blank,
    color_limits,
    draw_compass,
    draw_mark,
    draw_panel,
    error_ellipse,
    legend_below,
    method_words,
    pictures_of,
    said_of,
    shown_body,
    signed_limit,
)
from opnav_workbench.report.figure import OBSERVED
from opnav_workbench.report.png import png_bytes, write_png
from opnav_workbench.report.scales import round_scale
from opnav_workbench.session import ImageSession

__all__ = ["body_figure", "body_png", "write_body"]

# The error ellipse is enlarged so that its longer semi-axis is at most this share of the picture's smaller side.
ELLIPSE_SHARE = 0.15
WIDTH_INCH, PANEL_INCH = 14.0, 3.55
AROUND_INCH, TITLE_INCH = 1.15, 0.19  # labels and legend; a line of the title
VEIL = 0.45  # opacity over pixels that were not used
RIM = 2  # px around the sub-array: methods that leave it out leave out no light
NAMES = {"predicted": "predicted center", "observed": "observed center", "truth": "true center"}


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
    source : BodyCenter or ImageSession
    name, method : str
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
    pictures = pictures_of(shown)
    n_pixel, n_line = pictures.window[2:]
    title = _title(shown)
    height = PANEL_INCH * float(np.clip(n_line / n_pixel, 0.4, 1.6)) + AROUND_INCH
    figure = blank(WIDTH_INCH, height + TITLE_INCH * (1 + title.count("\n")), title)
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


def write_body(
    session: BodyCenter | ImageSession, path: str | Path, name: str = "", method: str = ""
) -> None:
    """Write `body_figure` as a PNG, whole or not at all."""
    write_png(body_figure(session, name, method), path)


def _title(shown: ShownBody) -> str:
    center = shown.center
    lines = [f"{center.name}, {method_words(center.method)}: {center.status}   {shown.where}".rstrip()]
    if center.pixel_line is not None:
        lines.append(_numbers(shown, center.pixel_line))
    return "\n".join([*lines, *said_of(center)])


def _numbers(shown: ShownBody, place: FloatArray) -> str:
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


def _draw_pictures(panels: Sequence[Axes], pictures: BodyPictures) -> list[tuple[Artist, str]]:
    """Draw the three panels; return what the veil over pixels that were not used means, where there is one."""
    window, light = pictures.window, color_limits(pictures.data_dn, pictures.model_dn)
    limit = signed_limit(pictures.difference_dn)
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
                entries[NAMES[what]] = artist
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
    longest = float(np.sqrt(np.linalg.eigvalsh(center.covariance_px2)[-1]))
    side = min(abs(np.diff(axes.get_xlim())[0]), abs(np.diff(axes.get_ylim())[0]))
    factor = max(1.0, round_scale(ELLIPSE_SHARE * side / max(longest, 1e-9)))
    style = {"edgecolor": OBSERVED, "linewidth": 1.3, "path_effects": [EDGE]}
    axes.add_patch(error_ellipse(center.pixel_line, center.covariance_px2, factor, **style))
    enlarged = f", drawn {factor:g} × larger" if factor > 1.0 else ""
    entries[f"1 sigma error ellipse of the observed center{enlarged}"] = Line2D(
        [], [], color=OBSERVED, linewidth=1.3
    )
