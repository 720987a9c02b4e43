"""One picture of a paper's figure: an array with its axes, colour bar and marks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from astropy.stats import mad_std
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import Circle, Rectangle
from scipy import ndimage

from opnav_workbench.arrays import FloatArray, freeze_arrays

__all__ = ["PaperMarks", "PaperPanel", "draw_paper_panel", "sky_panel"]

GREEN = "#00C853"
# The stretch of a large picture ends at these percentiles, so that a hot pixel does not darken the rest.
DARKEST_PERCENT, BRIGHTEST_PERCENT = 1.0, 99.9
SMALL_PIXELS = 64 * 64  # a picture with no more than these is shown from its least to its largest value
MANY_PIXELS = 400  # along a side: more than a panel has points
LOG_RANGE = 300.0  # brightest over darkest of a logarithmic stretch
# A sky picture is smoothed by this and each pixel shows the brightest of its neighbours: a star stays visible in a figure
# that has fewer points than the picture pixels. Shown are these multiples of the noise above two sigmas below the sky.
SKY_SMOOTHING_PX, SKY_NEIGHBOURS_PX = 1.0, 3
SKY_SIGMAS = (2.5, 250.0)


@dataclass(frozen=True, slots=True, eq=False)
class PaperMarks:
    """Places marked in a panel.

    Attributes
    ----------
    pixel_line : (n, 2) array
    label : str
        For the legend; empty: none.
    shape : {"circle", "box", "cross"}
    size_px : float
        Radius of the circles, half width of the boxes, half length of a cross.
    color : str
    """

    pixel_line: FloatArray
    label: str = ""
    shape: Literal["circle", "box", "cross"] = "circle"
    size_px: float = 12.0
    color: str = GREEN

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class PaperPanel:
    """One picture of a figure.

    Attributes
    ----------
    values : (n_line, n_pixel) array
        May hold nan, which is left blank.
    title : str
    bar : str
        What the colour bar counts; empty: no bar.
    first : (2,) sequence of float
        Pixel and line of the array's first element.
    stretch : {"linear", "log", "signed"}
        Signed: even about zero, red for more and blue for less.
    limits : (2,) sequence of float, optional
        Values at the ends of the colours; default from the values.
    color_map : str, optional
        Matplotlib's name.
    marks : sequence of PaperMarks
    """

    values: FloatArray
    title: str = ""
    bar: str = "DN"
    first: Sequence[float] = (0.0, 0.0)
    stretch: Literal["linear", "log", "signed"] = "linear"
    limits: Sequence[float] | None = None
    color_map: str = ""
    marks: Sequence[PaperMarks] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge of the picture, px."""
        n_line, n_pixel = np.shape(self.values)
        left, top = (float(value) - 0.5 for value in self.first)
        return left, left + n_pixel, top + n_line, top


def sky_panel(
    image_dn: FloatArray,
    title: str = "",
    marks: Sequence[PaperMarks] = (),
    first: Sequence[float] = (0.0, 0.0),
) -> PaperPanel:
    """Return a picture of stars in a logarithmic gray stretch, lightly smoothed, black just above the sky.

    Examples
    --------
    >>> image = np.random.default_rng(1).normal(size=(64, 64))
    >>> image[20, 30] = 500.0
    >>> panel = sky_panel(image)
    >>> [int(i) for i in np.unravel_index(panel.values.argmax(), (64, 64))], panel.stretch
    ([19, 29], 'log')
    """
    smooth = ndimage.gaussian_filter(
        np.nan_to_num(image_dn, nan=float(np.nanmedian(image_dn))), SKY_SMOOTHING_PX
    )
    level = float(np.median(smooth))
    noise = float(mad_std(smooth)) or 1.0
    sigmas = ndimage.maximum_filter((smooth - level) / noise + 2.0, SKY_NEIGHBOURS_PX)
    return PaperPanel(sigmas, title, "", first, "log", SKY_SIGMAS, "gray", marks)


def draw_paper_panel(axes: Axes, panel: PaperPanel) -> None:
    """Draw a panel into its axes."""
    norm = _norm(panel)
    name = panel.color_map or ("RdBu_r" if panel.stretch == "signed" else "viridis")
    values = np.asarray(panel.values, dtype=np.float64)
    if panel.stretch == "log":
        values = np.maximum(values, float(norm.vmin or 0.0))  # what is darker is black, not blank
    drawn = axes.imshow(
        values, cmap=name, norm=norm, extent=panel.extent, interpolation=_interpolation(panel)
    )
    if panel.bar:
        bar = axes.figure.colorbar(
            drawn, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0))
        )  # as high as the picture
        bar.set_label(panel.bar, fontsize=9)
        bar.ax.tick_params(labelsize=8)
    limits = axes.axis()
    for marks in panel.marks:
        _mark(axes, marks)
    axes.axis(limits)
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel("pixel", fontsize=9)
    axes.set_ylabel("line", fontsize=9)
    axes.tick_params(labelsize=8)


def _interpolation(panel: PaperPanel) -> Literal["nearest", "antialiased"]:
    """Square pixels where each is seen, means of several where it is not."""
    return "antialiased" if max(np.shape(panel.values)) > MANY_PIXELS else "nearest"


def _norm(panel: PaperPanel) -> Normalize:
    values = panel.values[np.isfinite(panel.values)]
    if panel.limits is not None:
        low, high = (float(value) for value in panel.limits)
    elif panel.stretch == "signed":
        high = float(np.abs(values).max(initial=0.0)) or 1.0
        low = -high
    elif values.size > SMALL_PIXELS:
        low, high = (float(p) for p in np.percentile(values, (DARKEST_PERCENT, BRIGHTEST_PERCENT)))
    else:
        low, high = float(values.min()), float(values.max())
    if panel.stretch == "log":
        return LogNorm(max(low, high / LOG_RANGE), max(high, 1e-9))
    return Normalize(low, high if high > low else low + 1.0)


def _mark(axes: Axes, marks: PaperMarks) -> None:
    size = marks.size_px
    for pixel, line in np.atleast_2d(marks.pixel_line):
        if marks.shape == "cross":
            style: dict[str, Any] = {"color": marks.color, "linewidth": 1.4}
            axes.plot([pixel - size, pixel + size], [line, line], **style)
            axes.plot([pixel, pixel], [line - size, line + size], **style)
            continue
        outline: dict[str, Any] = {"fill": False, "edgecolor": marks.color, "linewidth": 1.1}
        if marks.shape == "circle":
            axes.add_patch(Circle((pixel, line), size, **outline))
        else:
            axes.add_patch(Rectangle((pixel - size, line - size), 2.0 * size, 2.0 * size, **outline))
