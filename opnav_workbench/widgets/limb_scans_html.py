"""The page of the limb scans: one scan large (data, model, correlation), its neighbors small, all of them as a strip."""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.limb_scan_results import LimbScans
from opnav_workbench.widgets.actions import ActionRegistry
from opnav_workbench.widgets.limb_scans import shown_scans, used_scans
from opnav_workbench.widgets.workbench_html import button, text
from opnav_workbench.widgets.workbench_svg import Plot, data_range

__all__ = ["THUMBS", "scans_html"]

THUMBS = 6  # scans shown small, the one at hand among them
THUMB_W, THUMB_H, THUMB_POINTS = 68, 32, 60
STRIP_W, STRIP_H = 458, 88
SIGNS = {"used": "✓", "rejected": "✗", "not_chosen": "–"}
WORDS = {"used": "in use", "rejected": "left out by the fit", "not_chosen": "not chosen"}


def scans_html(scans: LimbScans, focus: int, by_hand: bool, registry: ActionRegistry, boxing: bool) -> str:
    """Return the scans of a limb-scan center as a page.

    Parameters
    ----------
    scans : LimbScans
    focus : int
        The scan shown large.
    by_hand : bool
        Whether the analyst chose the scans.
    registry : ActionRegistry
    boxing : bool
        Whether a box is being drawn in the picture.
    """
    return (
        f'<section class="scans">{_large(scans, focus)}{_thumbs(scans, focus)}'
        f"{_tools(scans, by_hand, registry, boxing)}{_strip(scans, focus)}</section>"
    )


def _tools(scans: LimbScans, by_hand: bool, registry: ActionRegistry, boxing: bool) -> str:
    chosen = shown_scans(used_scans(scans.status))
    used = sum(word == "used" for word in scans.status)
    how = "by hand" if by_hand else "automatic"
    field = f'<input data-act="scans" size="9" title="Numbers and ranges, such as 3-9,12" value="{chosen}">'
    said = "; ".join(scans.summary)
    return (
        f'<div class="tools">{field}{button(registry["box_scans"], on=boxing)}'
        f"{button(registry['automatic_scans'], enabled=by_hand)}"
        f'<span class="hint" title="{text(said)}">{used} of {len(scans.status)} used, {how}</span></div>'
    )


def _strip(scans: LimbScans, focus: int) -> str:
    """All scans by number: residual where in use, else offset; a click looks at one, a box uses exactly those in it."""
    n = len(scans.status)
    value = np.where(np.asarray(scans.status) == "used", scans.residual_px, scans.offset_px)
    shown = value[np.isfinite(value)]
    limit = float(np.percentile(np.abs(shown), 90.0)) * 1.5 if shown.size else 1.0
    plot = Plot(
        STRIP_W, STRIP_H, (-0.5, n - 0.5), (-limit or -1.0, limit or 1.0), x_label="scan number", ticks=6
    )
    _, top, _, bottom = plot.frame
    column = float(plot.x(1.0) - plot.x(0.0))
    for number in range(n):
        word = str(scans.status[number])
        left = float(plot.x(number - 0.5))
        at = float(np.clip(plot.y(np.clip(np.nan_to_num(value[number]), -limit, limit)), top, bottom))
        here = " here" if number == focus else ""
        hint = f"scan {number}: {WORDS.get(word, word)}; {scans.reason[number]}"
        plot.raw(
            f'<g class="column {word}{here}" data-act="look_scan" data-arg="{number}" data-pick="{number}">'
            f"<title>{text(hint)}</title>"
            f'<rect x="{left:.1f}" y="{top}" width="{column:.1f}" height="{bottom - top:.0f}"/>'
            f'<circle cx="{left + column / 2:.1f}" cy="{at:.1f}" r="{2.2 if word == "used" else 1.4}"/></g>'
        )
    hint = "Residual of the scans in use, offset of the others, px. Click: look at it. Drag a box: use exactly these."
    return f'<div class="strip-plot" data-box="pick_scans" title="{hint}">{plot.svg()}</div>'


def _thumbs(scans: LimbScans, focus: int) -> str:
    first = focus // THUMBS * THUMBS
    shown = range(first, min(first + THUMBS, len(scans.status)))
    return f'<div class="thumbs">{"".join(_thumb(scans, number, number == focus) for number in shown)}</div>'


def _thumb(scans: LimbScans, number: int, here: bool) -> str:
    step = max(1, len(scans.distance_px) // THUMB_POINTS)
    distance, data, model = (
        scans.distance_px[::step],
        scans.data_dn[number, ::step],
        scans.model_dn[number, ::step],
    )
    plot = Plot(THUMB_W, THUMB_H, _ends(scans.distance_px), _levels(scans), bare=True)
    plot.line(distance, model, "model").line(distance, data, "data")
    word = str(scans.status[number])
    hint = f"scan {number}: {WORDS.get(word, word)}; {scans.reason[number]}. Click: use it, or leave it out."
    return (
        f'<div class="thumb {word}{" here" if here else ""}" data-act="scan" data-arg="{number}"'
        f' data-scan="{number}" title="{text(hint)}"><span>{SIGNS.get(word, "")} {number}</span>{plot.svg()}</div>'
    )


def _large(scans: LimbScans, number: int) -> str:
    word = str(scans.status[number])
    data, model = scans.data_dn[number], scans.model_dn[number]
    profile = Plot(
        246, 110, _ends(scans.distance_px), data_range([data, model], with_zero=True), f"scan {number}: DN", "px along it"
    )  # fmt: skip
    profile.line(scans.distance_px, model, "model").line(scans.distance_px, data, "data")
    curve = Plot(
        206, 110, _ends(scans.lag_px), data_range(scans.correlation[number]), "correlation", "offset, px"
    )
    curve.line(scans.lag_px, scans.correlation[number], "data")
    offset, said = float(scans.offset_px[number]), "no offset"
    if np.isfinite(offset):
        at = float(curve.x(offset))
        curve.raw(f'<path class="peak" d="M{at:.1f} {curve.frame[1]}V{curve.frame[3]}"/>')
        said = f"offset {offset:+.2f} ± {float(scans.sigma_px[number]):.2f} px"
        residual = float(scans.residual_px[number])
        said += f", {residual:+.2f} after the fit" if np.isfinite(residual) else ""
    return (
        f'<div class="plots">{profile.svg()}{curve.svg()}</div>'
        f'<p class="legend"><span class="key data">— data</span><span class="key model">┄ model</span>'
        f'<span>{said}</span></p><p class="why {word}"><b>{SIGNS.get(word, "")} {WORDS.get(word, word)}</b> '
        f"{text(scans.reason[number])}</p>"
    )


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(values[-1])


def _levels(scans: LimbScans) -> tuple[float, float]:
    """One brightness range for all thumbnails, so that a bright limb looks bright."""
    finite = scans.data_dn[np.isfinite(scans.data_dn)]
    high = float(np.percentile(finite, 99.5)) if finite.size else 1.0
    return data_range([0.0, high])
