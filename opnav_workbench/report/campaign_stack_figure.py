"""A stack in one figure: one picture, the stack, its noise, and how the signal-to-noise ratio grows."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.campaign.stacking import Growth, Stacked
from opnav_workbench.campaign.stacking.resampling import resample

__all__ = ["stack_figure"]

MARK_COLOR, PREDICTED_COLOR, GREY = "#D55E00", "#56B4E9", "0.6"
LOW_SIGMAS, HIGH_SIGMAS = -2.0, 8.0  # of the shown picture: noise is seen, and a target of SNR 5
MARK_PX = 3.0
CUT_PX = 24.0  # half the side that is shown about a target: enough to see it


def stack_figure(
    stacked: Stacked, center: BodyCenter | None = None, growth: Growth | None = None, title: str = ""
) -> Figure:
    """Draw one picture beside the stack, both in units of their own noise, and the growth of the SNR.

    Parameters
    ----------
    stacked : Stacked
    center : BodyCenter, optional
        The target; it is marked, and the panels show its surroundings.
    growth : Growth, optional
        Without it, the third panel shows how many pictures each pixel has.
    """
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title)
    single, together, last = figure.subplots(1, 3)
    number = len(stacked.frames) // 2
    image, variance = resample(stacked.grid, stacked.frames[number], float(stacked.response[number]))
    _picture(single, stacked, image / np.sqrt(variance), f"one picture: {stacked.frames[number].name}")
    words = "star field subtracted" if stacked.subtractions is not None else f"on the {_followed(stacked)}"
    _picture(
        together, stacked, stacked.image_dn / stacked.noise_dn, f"stack of {len(stacked.frames)}, {words}"
    )
    figure.colorbar(together.images[0], ax=[single, together], label="DN over noise", shrink=0.8)
    for axes in (single, together):
        _mark(axes, stacked, center)
    if growth is None:
        _counts(last, stacked)
    else:
        _growth(last, growth)
    return figure


def _followed(stacked: Stacked) -> str:
    return "target's motion" if stacked.grid.follow == "target" else "stars"


def _extent(stacked: Stacked) -> tuple[float, float, float, float]:
    n_line, n_pixel = stacked.grid.shape
    left, top = stacked.grid.first - 0.5
    return float(left), float(left + n_pixel), float(top + n_line), float(top)


def _picture(axes: Axes, stacked: Stacked, sigmas: FloatArray, title: str) -> None:
    axes.imshow(sigmas, cmap="gray", vmin=LOW_SIGMAS, vmax=HIGH_SIGMAS, extent=_extent(stacked))
    axes.set_title(title, fontsize="medium")
    axes.set(xlabel="pixel", ylabel="line")


def _mark(axes: Axes, stacked: Stacked, center: BodyCenter | None) -> None:
    expected = stacked.predicted_px
    if np.isfinite(expected).all():
        axes.plot(*expected, "+", color=PREDICTED_COLOR, markersize=9, label="predicted")
    if center is not None and center.pixel_line is not None:
        place = (float(center.pixel_line[0]), float(center.pixel_line[1]))
        axes.add_patch(Circle(place, MARK_PX, fill=False, edgecolor=MARK_COLOR, linewidth=1.2, label="found"))
    if center is not None and np.isfinite(expected).all():
        left, right, bottom, top = _extent(stacked)
        axes.set_xlim(max(left, expected[0] - CUT_PX), min(right, expected[0] + CUT_PX))
        axes.set_ylim(min(bottom, expected[1] + CUT_PX), max(top, expected[1] - CUT_PX))
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right", fontsize="small")


def _counts(axes: Axes, stacked: Stacked) -> None:
    drawn = axes.imshow(stacked.count, cmap="viridis", extent=_extent(stacked))
    axes.figure.colorbar(drawn, ax=axes, label="pictures in each pixel", shrink=0.8)
    axes.set(xlabel="pixel", ylabel="line", title="coverage")


def _growth(axes: Axes, growth: Growth) -> None:
    """Growth of flux over sigma beside that of the root of the number, through the whole stack."""
    flux, most = float(growth.flux_dn[-1]), int(growth.pictures[-1])
    count = np.linspace(0.0, most, 200)
    root = flux / growth.flux_sigma_dn[-1] * np.sqrt(count / most)
    axes.plot(count, root, "--", color=GREY, label="square root of the number")
    snr = flux / growth.flux_sigma_dn
    axes.plot(growth.pictures, snr, "o", color=MARK_COLOR, label="flux of the stack over sigma")
    axes.set(xlabel="pictures", ylabel="signal-to-noise ratio", title="growth", xlim=(0, None))
    axes.legend(fontsize="small", loc="lower right")
