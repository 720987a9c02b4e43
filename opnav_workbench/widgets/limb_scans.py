"""Limb scans as a person chooses them: numbers and ranges, the choice in words, and where they lie in the picture."""

import re
from collections.abc import Iterable

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.bodycenters.limb_scan_results import NOT_CHOSEN, REJECTED, USED, LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.widgets.workbench_viewer import Layer

__all__ = [
    "parsed_scans",
    "scan_at",
    "scan_center",
    "scan_layer",
    "scans_crossing",
    "scans_of",
    "shown_scans",
    "used_scans",
]

_RANGE = re.compile(r"(\d+)(?:\s*-\s*(\d+))?")
# Share of a scan's length that is left out in the picture, so that the body stays in sight.
SHOWN_FROM = {"focus": 0.0, "used": 0.6, "rejected": 0.6, "unused": 0.9}
FEWEST_NUMBERS, MOST_NUMBERS = 4, 12  # scans that have their number in the picture
NUMBER_SHARE = 0.11  # of the picture's longer side, that a number takes along the circle of the scans' ends
CLICK_PX = 6.0  # a click so near to a scan, on screen-sized pictures, means it


def parsed_scans(typed: str, n_scans: int) -> list[int]:
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
    >>> parsed_scans("3-6, 12", 24)
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


def shown_scans(numbers: Iterable[int]) -> str:
    """Return scan numbers as a person types them.

    Examples
    --------
    >>> shown_scans([3, 4, 5, 6, 12])
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


def used_scans(status: Iterable[str]) -> list[int]:
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
