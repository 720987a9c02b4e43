"""What all figures share: the colours of what is marked in a picture, and PNG files.

Predicted places are yellow, observed ones blue, what was not used vermilion, bodies purple; pixel components are
blue, line components vermilion. The palette is that of Okabe & Ito, which colour-blind readers can tell apart;
every mark has a shape of its own as well. Figures are written with one resolution, and a file is whole or not
there.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Ellipse

from opnav_workbench.arrays import FloatArray
from opnav_workbench.files import atomic_path

__all__ = [
    "BLUE",
    "BODY_COLOR",
    "GREEN",
    "LINE_COLOR",
    "OBSERVED_COLOR",
    "ORANGE",
    "PIXEL_COLOR",
    "PREDICTED_COLOR",
    "PURPLE",
    "REJECTED_COLOR",
    "SERIES_COLORS",
    "SKY_BLUE",
    "VERMILION",
    "YELLOW",
    "error_ellipse_patch",
    "new_figure",
    "png_bytes",
    "titled_figure",
    "write_png",
]


# ---- The palette of Okabe & Ito, and what its colours mean in a picture.

BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
ORANGE, SKY_BLUE, YELLOW = "#E69F00", "#56B4E9", "#F0E442"
SERIES_COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE)  # of things side by side, in this order
PREDICTED_COLOR, OBSERVED_COLOR, REJECTED_COLOR, BODY_COLOR = YELLOW, SKY_BLUE, VERMILION, PURPLE
PIXEL_COLOR, LINE_COLOR = BLUE, VERMILION


# ---- Figures that are not tied to any window.


def new_figure(
    width_inch: float,
    height_inch: float,
    title: str = "",
    *,
    pads_inch: tuple[float, float] | tuple[None, None] = (None, None),
    **style: Any,
) -> Figure:
    """Return an empty figure whose panels make room for their labels.

    Parameters
    ----------
    title
        Above all panels; empty: none.
    pads_inch : (2,) tuple of float
        Above and below, left and right of each panel; default matplotlib's.
    **style
        Of the title, as `matplotlib.figure.Figure.suptitle` takes it.
    """
    above, beside = pads_inch
    layout = ConstrainedLayoutEngine(h_pad=above, w_pad=beside)
    figure = Figure(figsize=(width_inch, height_inch), layout=layout)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, parse_math=False, **style)  # a $ in a file's name is no formula
    return figure


def titled_figure(width_inch: float, height_inch: float, title: str) -> Figure:
    """Return an empty figure with its title at the left."""
    return new_figure(width_inch, height_inch, title, pads_inch=(0.08, 0.06), fontsize=11, x=0.01, ha="left")


def error_ellipse_patch(center: FloatArray, covariance: FloatArray, sigmas: float, **style: Any) -> Ellipse:
    """Return the ellipse of `sigmas` standard deviations about a center; of larger arrays the first two components."""
    variance, axes = np.linalg.eigh(covariance[:2, :2])
    minor, major = 2.0 * sigmas * np.sqrt(np.maximum(variance, 0.0))
    angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
    return Ellipse((float(center[0]), float(center[1])), major, minor, angle=angle, fill=False, **style)


# ---- Figures as PNG: one resolution for all, and files that are whole or not there.

DPI = 110


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    stream = io.BytesIO()
    figure.set_dpi(DPI)
    canvas = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
    # savefig would draw all a second time for the layout, to the same pixels
    canvas.print_png(stream)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def write_png(figure: Figure, path: str | Path) -> None:
    """Write a figure as a PNG, whole or not at all."""
    picture = png_bytes(figure)
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture)
