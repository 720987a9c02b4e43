"""Limb scans as a person chooses them: numbers and ranges, clicks and boxes in the picture; and their page.

Scans are numbered from 0. Places are arrays (scan, sample, 2) of (pixel, line). The page shows one scan large (data,
model, correlation), its neighbors small, and all of them as a strip.
"""

import re
from collections.abc import Iterable

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.bodies.results import NOT_CHOSEN, REJECTED, USED, LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.markup import button, text
from opnav_workbench.workbench.plots import SvgPlot, data_range
from opnav_workbench.workbench.viewer import Layer

__all__ = [
    "chosen_scans",
    "format_scan_numbers",
    "parse_scan_numbers",
    "scan_at",
    "scan_layer",
    "scans_crossing",
    "scans_html",
    "scans_of",
]


# ---- Limb scans as a person chooses them: numbers and ranges, the choice in words, and where they lie in the ...

_RANGE = re.compile(r"(\d+)(?:\s*-\s*(\d+))?")
# Share of a scan's length that is left out in the picture, so that the body stays in sight.
SHOWN_FROM = {"focus": 0.0, "used": 0.6, "rejected": 0.6, "unused": 0.9}
FEWEST_NUMBERS, MOST_NUMBERS = 4, 12  # scans that have their number in the picture
NUMBER_SHARE = 0.11  # of the picture's longer side, that a number takes along the circle of the scans' ends
CLICK_PX = 6.0  # a click so near to a scan, on screen-sized pictures, means it


def parse_scan_numbers(typed: str, n_scans: int) -> list[int]:
    """Return the scans that a text names.

    Parameters
    ----------
    typed : str
        Numbers and ranges, such as ``3-9,12``.
    n_scans : int
        There are scans 0 to ``n_scans - 1``.

    Raises
    ------
    SessionError
        The text is no such list, is empty, or names a scan that does not exist.

    Examples
    --------
    >>> parse_scan_numbers("3-6, 12", 24)
    [3, 4, 5, 6, 12]
    """
    chosen: set[int] = set()
    for part in filter(None, (piece.strip() for piece in typed.split(","))):
        found = _RANGE.fullmatch(part)
        if found is None:
            raise SessionError(f"{part!r} is no scan number or range; type such as 3-9,12.")
        first, last = int(found[1]), int(found[2] or found[1])
        if first > last or last >= n_scans:
            raise SessionError(f"{part!r}: the scans are numbered 0 to {n_scans - 1}, in rising order.")
        chosen.update(range(first, last + 1))
    if not chosen:
        raise SessionError("no scan is named; type such as 3-9,12, or Y for the automatic choice.")
    return sorted(chosen)


def format_scan_numbers(numbers: Iterable[int]) -> str:
    """Return scan numbers as a person types them.

    Examples
    --------
    >>> format_scan_numbers([3, 4, 5, 6, 12])
    '3-6,12'
    """
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


def scan_center(session: ImageSession, name: str) -> BodyCenter | None:
    """Return the body's limb-scan center with its scans, if there is one."""
    for center in session.state.bodies:
        if center.name == name and center.method == "limb_scan" and isinstance(center.detail, LimbScans):
            return center
    return None


def scans_of(session: ImageSession, name: str) -> LimbScans | None:
    """Return the scans of the body's limb-scan center, if there is one."""
    center = scan_center(session, name)
    return None if center is None or not isinstance(center.detail, LimbScans) else center.detail


def chosen_scans(status: Iterable[str]) -> list[int]:
    """Return the numbers of the scans that are chosen: in use, or rejected by the fit."""
    return [number for number, word in enumerate(status) if word != NOT_CHOSEN]


def scan_layer(places_px: FloatArray, status: Iterable[str], focus: int, frame_px: float) -> Layer:
    """Return the scans (n, m, 2) as lines with some of their numbers; `frame_px` is the picture's longer side."""
    words = list(status)
    ends = np.concatenate([places_px[:, :1], places_px[:, -1:]], axis=1)
    names = {USED: "used", REJECTED: "rejected"}
    styles = ["focus" if i == focus else names.get(word, "unused") for i, word in enumerate(words)]
    inner = np.array([SHOWN_FROM[style] for style in styles])[:, None]
    begins = ends[:, 0] + inner * (ends[:, 1] - ends[:, 0])
    outward = ends[:, 1] + 0.06 * (ends[:, 1] - ends[:, 0])
    step = max(1, round(len(ends) / _numbered(ends, frame_px)))
    return Layer(
        [
            (float(a[0]), float(a[1]), float(b[0]), float(b[1]))
            for a, b in zip(begins, ends[:, 1], strict=True)
        ],
        styles,
        [(float(x), float(y), str(i)) for i, (x, y) in enumerate(outward) if i % step == 0 or i == focus],
    )


def _numbered(ends: FloatArray, frame_px: float) -> int:
    """How many scans have their number: no more than there is room for while the whole frame is shown."""
    around = 2.0 * np.pi * float(np.median(np.hypot(*(ends[:, 1] - ends[:, 0]).T)))
    return int(np.clip(around / (NUMBER_SHARE * frame_px), FEWEST_NUMBERS, MOST_NUMBERS))


def scan_at(places_px: FloatArray, pixel: float, line: float) -> int | None:
    """Return the scan (n, m, 2) nearest to a click; None where none is near."""
    distance = np.hypot(places_px[..., 0] - pixel, places_px[..., 1] - line).min(axis=1)
    reach = max(CLICK_PX, float(np.median(np.hypot(*(places_px[:, -1] - places_px[:, 0]).T))) * 0.05)
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] <= reach else None


def scans_crossing(
    places_px: FloatArray, pixel0: float, line0: float, pixel1: float, line1: float
) -> list[int]:
    """Return the scans (n, m, 2) with a sample inside a box."""
    low = np.minimum([pixel0, line0], [pixel1, line1])
    high = np.maximum([pixel0, line0], [pixel1, line1])
    inside = np.all((places_px >= low) & (places_px <= high), axis=2)
    return [int(number) for number in np.flatnonzero(np.any(inside, axis=1))]


# ---- The page of the limb scans: one scan large (data, model, correlation), its neighbors small, all of them ...

THUMBS = 6  # scans shown small, the one at hand among them
THUMB_W, THUMB_H, THUMB_POINTS = 68, 32, 60
STRIP_W, STRIP_H = 458, 88
SCAN_SIGNS = {"used": "✓", "rejected": "✗", "not_chosen": "–"}
SCAN_WORDS = {"used": "in use", "rejected": "left out by the fit", "not_chosen": "not chosen"}


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
    chosen = format_scan_numbers(chosen_scans(scans.status))
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
    plot = SvgPlot(
        STRIP_W, STRIP_H, (-0.5, n - 0.5), (-limit or -1.0, limit or 1.0), x_label="scan number", ticks=6
    )
    _, top, _, bottom = plot.frame
    column = float(plot.x(1.0) - plot.x(0.0))
    for number in range(n):
        word = str(scans.status[number])
        left = float(plot.x(number - 0.5))
        at = float(np.clip(plot.y(np.clip(np.nan_to_num(value[number]), -limit, limit)), top, bottom))
        here = " here" if number == focus else ""
        hint = f"scan {number}: {SCAN_WORDS.get(word, word)}; {scans.reason[number]}"
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
    plot = SvgPlot(THUMB_W, THUMB_H, _ends(scans.distance_px), _levels(scans), bare=True)
    plot.line(distance, model, "model").line(distance, data, "data")
    word = str(scans.status[number])
    hint = f"scan {number}: {SCAN_WORDS.get(word, word)}; {scans.reason[number]}. Click: use it, or leave it out."
    return (
        f'<div class="thumb {word}{" here" if here else ""}" data-act="scan" data-arg="{number}"'
        f' data-scan="{number}" title="{text(hint)}"><span>{SCAN_SIGNS.get(word, "")} {number}</span>{plot.svg()}</div>'
    )


def _large(scans: LimbScans, number: int) -> str:
    word = str(scans.status[number])
    data, model = scans.data_dn[number], scans.model_dn[number]
    profile = SvgPlot(
        246, 110, _ends(scans.distance_px), data_range([data, model], with_zero=True), f"scan {number}: DN", "px along it"
    )  # fmt: skip
    profile.line(scans.distance_px, model, "model").line(scans.distance_px, data, "data")
    curve = SvgPlot(
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
        f'<span>{said}</span></p><p class="why {word}"><b>{SCAN_SIGNS.get(word, "")} {SCAN_WORDS.get(word, word)}</b> '
        f"{text(scans.reason[number])}</p>"
    )


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(values[-1])


def _levels(scans: LimbScans) -> tuple[float, float]:
    """One brightness range for all thumbnails, so that a bright limb looks bright."""
    finite = scans.data_dn[np.isfinite(scans.data_dn)]
    high = float(np.percentile(finite, 99.5)) if finite.size else 1.0
    return data_range([0.0, high])
