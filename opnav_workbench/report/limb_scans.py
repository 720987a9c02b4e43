"""Figure of a limb scan: the scans on the picture, brightness and correlation along some of them, and their residuals.

As Figure 15 of Jackman & Dumont (2013), AAS 13-443.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.bodies.results import NOT_CHOSEN, REJECTED, USED, LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.report.body_panels import (
    DARK_EDGE,
    ShownBody,
    draw_compass,
    draw_mark,
    draw_panel,
    legend_below,
    linear_limits,
    method_title,
    pictures_around,
    shown_body,
    title_remarks,
)
from opnav_workbench.report.drawing import (
    LINE_COLOR,
    OBSERVED_COLOR,
    PIXEL_COLOR,
    PREDICTED_COLOR,
    VERMILION,
    png_bytes,
    titled_figure,
    write_png,
)
from opnav_workbench.session import ImageSession

__all__ = ["scan_figure", "scan_png", "write_scans"]

SIZE_INCH = (14.0, 8.6)
N_SHOWN = 7  # scans with a plot of their own
NUMBER_EVERY = 10  # of the scans on the picture
# A scan is drawn from this share of its limb's distance outward, so that the disk stays in view.
INNER = 0.86
# Brightness is shown from so far inside of the limb: a share of its distance, px at least.
INSIDE, LEAST_INSIDE_PX = 0.3, 8.0
# Status: colour, dashes, width, marker; in words.
STYLES = {
    NOT_CHOSEN: ("0.65", (0, (1, 2)), 0.9, ".", "not chosen"),
    REJECTED: (VERMILION, (0, (4, 2)), 1.4, "x", "rejected"),
    USED: (OBSERVED_COLOR, "solid", 1.2, "o", "used"),
}


def scan_figure(
    source: BodyCenter | ImageSession, name: str = "", *, numbers: Sequence[int] | None = None
) -> Figure:
    """Draw a body's limb scans.

    Parameters
    ----------
    source
        Found with method ``limb_scan``.
    name
        Which body of a session; default the last one scanned.
    numbers
        Scans whose brightness and correlation are plotted; default some of those used, all around the limb.

    Returns
    -------
    matplotlib.figure.Figure
        Not tied to any window.

    Raises
    ------
    SessionError
        There is no such center, it has no scans, or not the ones that were asked for.
    """
    shown = shown_body(source, name, "limb_scan")
    scans = shown.center.detail
    if not isinstance(scans, LimbScans):
        raise SessionError(
            f"{shown.center.name} ({shown.center.method}, {shown.center.status}) has no limb scans to show; "
            "find_body(..., method='limb_scan') makes them."
        )
    plotted = _plotted(scans, numbers)
    figure = titled_figure(*SIZE_INCH, _title(shown, scans))
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.12), squeeze=False)[0]
    picture, rest = left.subplots(2, 1, height_ratios=(2.7, 1.0))
    entries = _draw_scans(picture, shown, scans, plotted)
    _draw_residuals(rest, scans)
    legend_below(figure, entries)
    legend_below(figure, _draw_plots(right, scans, plotted), dark=False)
    return figure


def scan_png(
    source: BodyCenter | ImageSession, name: str = "", *, numbers: Sequence[int] | None = None
) -> bytes:
    """Return `scan_figure` as a PNG, for a notebook: ``display(Image(scan_png(session, "PLUTO")))``."""
    return png_bytes(scan_figure(source, name, numbers=numbers))


def write_scans(source: BodyCenter | ImageSession, path: str | Path, name: str = "") -> None:
    """Write `scan_figure` as a PNG, whole or not at all."""
    write_png(scan_figure(source, name), path)


def _title(shown: ShownBody, scans: LimbScans) -> str:
    counts = ", ".join(
        f"{int(np.sum(scans.status == status))} {STYLES[status][4]}"
        for status in (USED, NOT_CHOSEN, REJECTED)
    )
    return (
        f"{shown.center.name}, {method_title('limb_scan')}: {shown.center.status}   {shown.where}\n"
        f"{len(scans)} scans, {counts}; scan k leaves the center at {360.0 / len(scans):g}° × k from +pixel toward +line"
        + "".join(f"\n{line}" for line in title_remarks(shown.center))
    )


def _plotted(scans: LimbScans, numbers: Sequence[int] | None) -> list[int]:
    """Return the scans asked for, else some of those used, spread over the arc that they span."""
    if numbers is None:
        able = scans.used if len(scans.used) else np.flatnonzero(np.isfinite(scans.offset_px))
        in_order = np.roll(able, -_largest_gap(able, len(scans)))
        spread = np.linspace(0, len(able) - 1, min(N_SHOWN, len(able))).round().astype(int)
        return [int(number) for number in in_order[spread]]
    unknown = [number for number in numbers if not 0 <= number < len(scans)]
    if unknown:
        raise SessionError(f"no limb scan {unknown}; they are numbered 0 to {len(scans) - 1}.")
    return [int(number) for number in numbers]


def _largest_gap(numbers: np.ndarray, n: int) -> int:
    """Return which of these scan numbers follows the largest gap around the circle."""
    if not len(numbers):
        return 0
    return int(np.argmax(np.diff(numbers, prepend=numbers[-1] - n)))


# -- the picture -----------------------------------------------------------------------------------------------------


def _draw_scans(
    axes: Axes, shown: ShownBody, scans: LimbScans, plotted: Sequence[int]
) -> list[tuple[Artist, str]]:
    pictures = pictures_around(shown)
    draw_panel(
        axes,
        pictures.window,
        pictures.data_dn,
        linear_limits(pictures.data_dn),
        "data and scans; those with yellow numbers are plotted",
    )
    axes.set_ylabel("line", fontsize=9)
    axes.set_facecolor("black")
    begin, end = _ends(scans)
    entries: list[tuple[Artist, str]] = []
    for status, (color, dashes, width, _, words) in STYLES.items():
        of_kind = np.flatnonzero(scans.status == status)
        if len(of_kind):
            segments = np.stack([begin[of_kind], end[of_kind]], axis=1)
            drawn = LineCollection(list(segments), colors=color, linestyles=[dashes], linewidths=width)
            axes.add_collection(drawn)
            entries.insert(0, (drawn, f"scan {words}"))
    _write_numbers(axes, scans, end, plotted)
    draw_compass(axes, shown)
    reach = np.abs(end - scans.start_px).max() * 1.13
    x, y = (float(value) for value in scans.start_px)
    axes.set(xlim=(x - reach, x + reach), ylim=(y + reach, y - reach))
    for what, words in (("predicted", "predicted center"), ("observed", "observed center")):
        place = shown.predicted_px if what == "predicted" else shown.center.pixel_line
        mark = draw_mark(axes, what, place)
        if mark is not None:
            entries.append((mark, words))
    return entries


def _ends(scans: LimbScans) -> tuple[FloatArray, FloatArray]:
    """Return where the drawn part of every scan begins and ends (n, 2), px."""
    along = np.stack([np.cos(scans.angle_rad), np.sin(scans.angle_rad)], axis=-1)
    limb = np.where(np.isfinite(scans.limb_px), scans.limb_px, 0.95 * scans.distance_px[-1])
    return (
        scans.start_px + INNER * limb[:, None] * along,
        scans.start_px + float(scans.distance_px[-1]) * along,
    )


def _write_numbers(axes: Axes, scans: LimbScans, end: FloatArray, plotted: Sequence[int]) -> None:
    """Write every tenth number around the picture, and the numbers of the plotted scans, which are bold and yellow."""
    spaced = NUMBER_EVERY * max(1, round(len(scans) / 180))
    crowded = [number for k in plotted for number in range(k - spaced // 3, k + spaced // 3 + 1)]
    for number in sorted({*range(0, len(scans), spaced), *plotted}):
        if number in crowded and number not in plotted:
            continue
        place = scans.start_px + 1.065 * (end[number] - scans.start_px)
        axes.text(
            float(place[0]),
            float(place[1]),
            str(number),
            color=PREDICTED_COLOR if number in plotted else "0.85",
            fontweight="bold" if number in plotted else "normal",
            fontsize=8,
            ha="center",
            va="center",
            path_effects=[DARK_EDGE],
        )


def _draw_residuals(axes: Axes, scans: LimbScans) -> None:
    """Plot what every scan leaves over, against its number."""
    for status, (color, _, _, marker, _) in STYLES.items():
        of_kind = np.flatnonzero((scans.status == status) & np.isfinite(scans.residual_px))
        if len(of_kind):
            axes.errorbar(
                of_kind,
                scans.residual_px[of_kind],
                scans.sigma_px[of_kind],
                fmt=marker,
                color=color if status != USED else PIXEL_COLOR,
                markersize=3.5 if marker != "x" else 5.0,
                linewidth=0.6,
                zorder=3 if status == USED else 2,
            )
    used = scans.status == USED
    shown = np.abs(scans.residual_px[used & np.isfinite(scans.residual_px)])
    most = 1.6 * float(max(shown.max(), 2.0 * np.median(scans.sigma_px[used]))) if len(shown) else 1.0
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.set(xlim=(-1.5, len(scans) + 0.5), ylim=(-most, most))
    axes.set_title("what the solved center leaves over, observed − model", fontsize=10)
    axes.set_xlabel("number of the scan", fontsize=9)
    axes.set_ylabel("px along the scan", fontsize=9)
    axes.tick_params(labelsize=8)


# -- brightness and correlation ------------------------------------------------------------------------------------------


def _draw_plots(area: SubFigure, scans: LimbScans, plotted: Sequence[int]) -> list[tuple[Artist, str]]:
    if not plotted:
        area.text(0.5, 0.5, "no scan has an offset", ha="center")
        return []
    rows = area.subplots(len(plotted), 2, sharex="col", width_ratios=(1.7, 1.0), squeeze=False)
    entries: list[tuple[Artist, str]] = []
    for number, (left, right) in zip(plotted, rows, strict=True):
        entries = _draw_brightness(left, scans, number)
        entries += _draw_correlation(right, scans, number)
        for axes in (left, right):
            axes.tick_params(labelsize=8)
    area.align_ylabels(rows[:, 0])
    rows[0, 0].set_title("brightness along the scan, DN", fontsize=10)
    rows[0, 1].set_title("correlation; offset ± sigma, px", fontsize=10)
    rows[-1, 0].set_xlabel("distance from the model's limb, px", fontsize=9)
    rows[-1, 1].set_xlabel("data outside of the model by, px", fontsize=9)
    return entries


def _draw_brightness(axes: Axes, scans: LimbScans, number: int) -> list[tuple[Artist, str]]:
    far = scans.distance_px[-1]
    limb = scans.limb_px[number] if np.isfinite(scans.limb_px[number]) else far
    outward = scans.distance_px - limb
    seen = outward >= -max(INSIDE * limb, LEAST_INSIDE_PX)
    brightness = scans.brightness[number] if np.isfinite(scans.brightness[number]) else 1.0
    data, model = scans.data_dn[number], brightness * scans.model_dn[number]
    (points,) = axes.plot(outward[seen], data[seen], ".", color=PIXEL_COLOR, markersize=3.5)
    (line,) = axes.plot(outward[seen], model[seen], color=LINE_COLOR, linewidth=1.2)
    axes.axvline(0.0, color="0.6", linewidth=0.8)
    axes.set_ylabel(f"scan {number}", fontsize=9)
    axes.margins(x=0.01)
    return [(points, "data"), (line, "model × brightness of the scan")]


def _draw_correlation(axes: Axes, scans: LimbScans, number: int) -> list[tuple[Artist, str]]:
    (curve,) = axes.plot(
        scans.lag_px, scans.correlation[number], ".-", color="0.35", markersize=4, linewidth=0.9
    )
    offset, sigma, peak = scans.offset_px[number], scans.sigma_px[number], None
    axes.set(xlim=(scans.lag_px[0], scans.lag_px[-1]), ylim=(-0.35, 1.2))
    words = f"no offset: {scans.reason[number]}"
    if np.isfinite(offset):
        peak = axes.axvline(offset, color=PIXEL_COLOR, linewidth=1.2)
        words = f"{offset:+.3f} ± {sigma:.3f}"
    axes.text(0.98, 0.92, words, transform=axes.transAxes, ha="right", va="top", fontsize=8)
    return [(curve, "correlation, data with model"), *([(peak, "offset")] if peak else [])]
