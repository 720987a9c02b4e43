"""Limb scans as a person chooses them: numbers and ranges, clicks and boxes in the picture; and their page.

Scans are numbered from 0. Places are arrays (scan, sample, 2) of (pixel, line). The page shows one scan large (data,
model, correlation), its neighbors small, and all of them as a strip.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.results import NOT_CHOSEN, REJECTED, USED, LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.templating import png_url
from opnav_workbench.workbench.plots import SvgPlot, data_range
from opnav_workbench.workbench.stretch import gray_png
from opnav_workbench.workbench.viewer import Layer

__all__ = [
    "ScanPage",
    "chosen_scans",
    "format_scan_numbers",
    "parse_scan_numbers",
    "scan_at",
    "scan_layer",
    "scan_page",
    "scans_crossing",
    "scans_of",
]


# ---- Scans chosen by numbers and ranges, clicks and boxes; and where they lie in the picture.

_RANGE = re.compile(r"(\d+)(?:\s*-\s*(\d+))?")
# Share of a scan's length that is left out in the picture, so that the body stays in sight.
SHOWN_FROM = {"focus": 0.0, "used": 0.6, "rejected": 0.6, "unused": 0.9}
FEWEST_NUMBERS, MOST_NUMBERS = 4, 12  # scans that have their number in the picture
# Numbers: shares of a scan beyond its end; of its length across, below which they are centered.
BEYOND, LEVEL = 0.1, 0.35
NUMBER_SHARE = 0.11  # of the picture's longer side, that a number takes along the circle of the scans' ends
CLICK_PX = 6.0  # a click so near to a scan, on screen-sized pictures, means it


def parse_scan_numbers(typed: str, n_scans: int) -> list[int]:
    """Return the scans that a text names.

    Parameters
    ----------
    typed
        Numbers and ranges, such as ``3-9,12``.
    n_scans
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


def scans_of(session: ImageSession, name: str) -> LimbScans | None:
    """Return the scans of the body's limb-scan center, if there is one."""
    for center in session.state.bodies:
        if center.name == name and center.method == "limb_scan" and isinstance(center.detail, LimbScans):
            return center.detail
    return None


def chosen_scans(status: Iterable[str]) -> list[int]:
    """Return the numbers of the scans that are chosen: in use, or rejected by the fit."""
    return [number for number, word in enumerate(status) if word != NOT_CHOSEN]


def scan_layer(places_px: FloatArray, status: Iterable[str], focus: int, picture_px: float) -> Layer:
    """Return the scans (n, m, 2) as lines with some of their numbers; `picture_px` is the picture's longer side."""
    words = list(status)
    ends = np.concatenate([places_px[:, :1], places_px[:, -1:]], axis=1)
    names = {USED: "used", REJECTED: "rejected"}
    styles = ["focus" if i == focus else names.get(word, "unused") for i, word in enumerate(words)]
    inner = np.array([SHOWN_FROM[style] for style in styles])[:, None]
    begins = ends[:, 0] + inner * (ends[:, 1] - ends[:, 0])
    along = ends[:, 1] - ends[:, 0]
    outward = ends[:, 1] + BEYOND * along
    across = along[:, 0] / np.maximum(np.hypot(*along.T), 1e-9)
    sides = np.where(np.abs(across) < LEVEL, "center", np.where(across > 0.0, "left", "right"))
    step = max(1, round(len(ends) / _numbered(ends, picture_px)))
    numbered = [i for i in range(len(ends)) if i % step == 0 or i == focus]
    return Layer(
        [
            (float(a[0]), float(a[1]), float(b[0]), float(b[1]))
            for a, b in zip(begins, ends[:, 1], strict=True)
        ],
        styles,
        [(*outward[i].tolist(), str(i)) for i in numbered],
        sides[numbered].tolist(),
    )


def _numbered(ends: FloatArray, picture_px: float) -> int:
    """How many scans have their number: no more than there is room for while the whole picture is shown."""
    around = 2.0 * np.pi * float(np.median(np.hypot(*(ends[:, 1] - ends[:, 0]).T)))
    return int(np.clip(around / (NUMBER_SHARE * picture_px), FEWEST_NUMBERS, MOST_NUMBERS))


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


# ---- The page of the limb scans: one scan large (data, model, correlation), its neighbors small, all of them as a strip.

THUMBS = 6  # scans shown small, the one at hand among them
THUMB_W, THUMB_H, THUMB_POINTS = 68, 32, 60
STRIP_W, STRIP_H = 458, 88
UNROLLED_H, UNROLLED_FROM = 118, 0.72  # px; share of the limb's distance from the center that it begins at
PROFILE_W, CORRELATION_W, LARGE_H = 246, 206, 110
SCAN_SIGNS = {USED: "✓", REJECTED: "✗", NOT_CHOSEN: "–"}
SCAN_WORDS = {USED: "in use", REJECTED: "left out by the fit", NOT_CHOSEN: "not chosen"}


@dataclass(frozen=True, slots=True)
class ScanShown:
    """A scan as the page names it."""

    number: int
    status: str
    reason: str

    @property
    def sign(self) -> str:
        """Sign of its status."""
        return SCAN_SIGNS.get(self.status, "")

    @property
    def status_words(self) -> str:
        """Its status in words."""
        return SCAN_WORDS.get(self.status, self.status)

    @property
    def hint(self) -> str:
        """One line on the scan."""
        return f"scan {self.number}: {self.status_words}; {self.reason}"


@dataclass(frozen=True, slots=True)
class ScanThumb:
    """A scan shown small: data and model."""

    scan: ScanShown
    plot: SvgPlot


@dataclass(frozen=True, slots=True)
class ScanColumn:
    """A scan in the strip: left edge of its column, and where its point stands down the page, px."""

    scan: ScanShown
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class UnrolledLimb:
    """The picture about the limb, unrolled: scan by scan across, distance from the center up.

    Attributes
    ----------
    plot
        Its axes, with the limb where it is predicted and where the scans see it.
    url
        Of its picture, which fills the frame.
    """

    plot: SvgPlot
    url: str


@dataclass(frozen=True, slots=True)
class ScanPage:
    """Everything that the page shows of the limb scans (templates/limb_scans.html).

    Attributes
    ----------
    focus
        The scan shown large.
    profile, correlation
        Its data and model; their correlation.
    peak_x
        Where the offset stands in the plot of the correlation, px.
    offset
        The offset in words.
    chosen
        Numbers of the scans that are chosen.
    boxing, by_hand
        Whether a box is being drawn in the picture; whether the analyst chose the scans.
    strip
        All scans by number.
    column_px
        Width of a column of the strip.
    unrolled
        The picture above the strip, column by column.
    """

    focus: ScanShown
    profile: SvgPlot
    correlation: SvgPlot
    peak_x: float | None
    offset: str
    thumbs: list[ScanThumb]
    chosen: str
    boxing: bool
    by_hand: bool
    n_used: int
    n_scans: int
    summary: str
    strip: SvgPlot
    columns: list[ScanColumn]
    column_px: float
    unrolled: UnrolledLimb


def scan_page(scans: LimbScans, focus: int, *, by_hand: bool, boxing: bool) -> ScanPage:
    """Return what the page shows of the scans of a limb-scan center.

    Parameters
    ----------
    focus
        The scan shown large.
    by_hand
        Whether the analyst chose the scans.
    boxing
        Whether a box is being drawn in the picture.
    """
    shown = [
        ScanShown(number, str(status), reason)
        for number, (status, reason) in enumerate(zip(scans.status, scans.reason, strict=True))
    ]
    first = focus // THUMBS * THUMBS
    correlation, offset_px = _correlation_plot(scans, focus), float(scans.offset_px[focus])
    strip, columns = _strip(scans, shown)
    return ScanPage(
        focus=shown[focus],
        profile=_profile_plot(scans, focus),
        correlation=correlation,
        peak_x=float(correlation.x(offset_px)) if np.isfinite(offset_px) else None,
        offset=_offset_words(scans, focus),
        thumbs=[ScanThumb(scan, _thumb_plot(scans, scan.number)) for scan in shown[first : first + THUMBS]],
        chosen=format_scan_numbers(chosen_scans(scans.status)),
        boxing=boxing,
        by_hand=by_hand,
        n_used=sum(word == USED for word in scans.status),
        n_scans=len(shown),
        summary="; ".join(scans.summary),
        strip=strip,
        columns=columns,
        column_px=float(strip.x(1.0) - strip.x(0.0)),
        unrolled=unrolled_limb(scans),
    )


def unrolled_limb(scans: LimbScans) -> UnrolledLimb:
    """Return the limb unrolled: an edge of the albedo goes its own way in it, the limb stays level."""
    limb = (
        float(np.nanmedian(scans.limb_px))
        if np.isfinite(scans.limb_px).any()
        else float(scans.distance_px[-1])
    )
    first = int(np.searchsorted(scans.distance_px, UNROLLED_FROM * limb))
    distance, data = scans.distance_px[first:], scans.data_dn[:, first:]
    finite = data[np.isfinite(data)]
    low, high = np.percentile(finite, (2.0, 99.0)) if finite.size else (0.0, 1.0)
    plot = SvgPlot(
        STRIP_W, UNROLLED_H, (-0.5, len(data) - 0.5), _ends(distance), "unrolled: px from the center", ticks=4
    )
    number = np.arange(len(data))
    plot.add_curve(number, scans.limb_px, "limb")
    seen = np.where(np.asarray(scans.status) != NOT_CHOSEN, scans.edge_px + scans.offset_px, np.nan)
    plot.add_points(number, seen, "seen", np.zeros(len(data)), lambda _: "")
    return UnrolledLimb(plot, png_url(gray_png(data.T[::-1], float(low), float(high))))


def _profile_plot(scans: LimbScans, number: int) -> SvgPlot:
    data, model = scans.data_dn[number], scans.model_dn[number]
    shown = data_range([data, model], with_zero=True)
    plot = SvgPlot(
        PROFILE_W, LARGE_H, _ends(scans.distance_px), shown, f"scan {number}: DN", x_label="px along it"
    )
    return plot.add_curve(scans.distance_px, model, "model").add_curve(scans.distance_px, data, "data")


def _correlation_plot(scans: LimbScans, number: int) -> SvgPlot:
    curve = scans.correlation[number]
    plot = SvgPlot(
        CORRELATION_W, LARGE_H, _ends(scans.lag_px), data_range(curve), "correlation", x_label="offset, px"
    )
    return plot.add_curve(scans.lag_px, curve, "data")


def _offset_words(scans: LimbScans, number: int) -> str:
    offset, residual = float(scans.offset_px[number]), float(scans.residual_px[number])
    if not np.isfinite(offset):
        return "no offset"
    after = f", {residual:+.2f} after the fit" if np.isfinite(residual) else ""
    return f"offset {offset:+.2f} ± {float(scans.sigma_px[number]):.2f} px{after}"


def _thumb_plot(scans: LimbScans, number: int) -> SvgPlot:
    step = max(1, len(scans.distance_px) // THUMB_POINTS)
    distance = scans.distance_px[::step]
    plot = SvgPlot(THUMB_W, THUMB_H, _ends(scans.distance_px), _levels(scans), bare=True)
    plot.add_curve(distance, scans.model_dn[number, ::step], "model")
    return plot.add_curve(distance, scans.data_dn[number, ::step], "data")


def _strip(scans: LimbScans, shown: Sequence[ScanShown]) -> tuple[SvgPlot, list[ScanColumn]]:
    """All scans by number: residual where in use, else offset; a click looks at one, a box uses exactly those in it."""
    value = np.where(np.asarray(scans.status) == USED, scans.residual_px, scans.offset_px)
    finite = value[np.isfinite(value)]
    limit = float(np.percentile(np.abs(finite), 90.0)) * 1.5 if finite.size else 1.0
    plot = SvgPlot(
        STRIP_W,
        STRIP_H,
        (-0.5, len(shown) - 0.5),
        (-limit or -1.0, limit or 1.0),
        x_label="scan number",
        ticks=6,
    )
    _, top, _, bottom = plot.frame
    left = plot.x(np.arange(len(shown)) - 0.5)
    down = np.clip(plot.y(np.clip(np.nan_to_num(value), -limit, limit)), top, bottom)
    columns = [ScanColumn(scan, float(x), float(y)) for scan, x, y in zip(shown, left, down, strict=True)]
    return plot, columns


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(values[-1])


def _levels(scans: LimbScans) -> tuple[float, float]:
    """One brightness range for all thumbnails, so that a bright limb looks bright."""
    finite = scans.data_dn[np.isfinite(scans.data_dn)]
    high = float(np.percentile(finite, 99.5)) if finite.size else 1.0
    return data_range([0.0, high])
