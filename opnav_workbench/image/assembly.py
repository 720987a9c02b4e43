"""From the arrays and header of a file to a `Frame`: mission, planes, exposure, mid-exposure time."""

import math
import re
from pathlib import Path
from typing import Any

from opnav_workbench.image.attitude import header_geometry
from opnav_workbench.image.frame import Frame, Header
from opnav_workbench.image.keywords import KeywordMap, number
from opnav_workbench.image.planes import make_planes
from opnav_workbench.image.source import Source, image_error
from opnav_workbench.image.times import et_from_text, text_from_et

__all__ = ["frame_from_source"]

# s: UTC texts are printed to a millisecond, and two sources of leap seconds agree to less.
TIME_DISAGREEMENT_S = 0.002
ISO_CALENDAR = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d+)?")


def frame_from_source(
    path: Path, sha256: str, source: Source, keywords: KeywordMap, saturation_dn: float | None
) -> Frame:
    """Make a `Frame` of what a reader found.

    Raises
    ------
    ImageError
        See `read_image`.
    """
    name, header = path.name, Header(source.header)
    _check_mission(name, header, keywords)
    planes = make_planes(name, source, header, keywords, saturation_dn)
    exposure_s = _exposure(name, header, keywords)
    et, utc, time_remarks = _time(name, header, keywords, exposure_s)
    geometry, geometry_remarks = header_geometry(header, keywords)
    sclk = keywords.value(header, "sclk")
    return Frame(
        path=path,
        sha256=sha256,
        image_dn=planes.image_dn,
        error_dn=planes.error_dn,
        bad=planes.bad,
        saturated=planes.saturated,
        header=header,
        exposure_s=exposure_s,
        et=et,
        utc=utc,
        sclk=None if sclk is None else str(sclk),
        header_geometry=geometry,
        messages=(*planes.messages, *time_remarks, *geometry_remarks),
    )


def _check_mission(name: str, header: Header, keywords: KeywordMap) -> None:
    for keyword, wanted in keywords.required.items():
        choices = wanted if isinstance(wanted, list | tuple) else (wanted,)
        found = header.get(keyword)
        if not any(_same(found, choice) for choice in choices):
            expected = " or ".join(repr(choice) for choice in choices)
            state = f"has {keyword} = {found!r}" if found is not None else f"has no {keyword}"
            raise image_error(
                name,
                f"is not a frame of this mission: its header {state}, expected {expected}; choose the "
                "mission file that describes this picture (--mission).",
            )


def _same(found: Any, wanted: Any) -> bool:
    if isinstance(found, str) or isinstance(wanted, str):
        return str(found).strip().casefold() == str(wanted).strip().casefold()
    return bool(found == wanted)


def _exposure(name: str, header: Header, keywords: KeywordMap) -> float:
    if keywords.exposure_s is None:
        return math.nan
    value = keywords.value(header, "exposure_s")
    seconds = number(value)
    if seconds is None:
        raise image_error(
            name,
            f"no exposure time: {keywords.exposure_s} is {value!r}; correct the header or the mission file.",
        )
    if not 0.0 < seconds < math.inf:
        raise image_error(
            name,
            f"exposure time {keywords.exposure_s} = {value!r} is not positive; leave this picture out.",
        )
    return seconds * keywords.exposure_scale


def _time(
    name: str, header: Header, keywords: KeywordMap, exposure_s: float
) -> tuple[float | None, str | None, list[str]]:
    """Return mid-exposure et and UTC; both None where only a spacecraft clock is known."""
    et = number(keywords.value(header, "et"))
    et = et if et is not None and math.isfinite(et) else None
    text = keywords.value(header, "utc")
    stated = None if text is None else _et_of(name, str(text), keywords)
    known = et if et is not None else stated
    if known is None:
        return None, None, [_without_time(name, header, keywords)]
    messages = []
    agree = stated is None or abs(known - stated) <= TIME_DISAGREEMENT_S
    if stated is not None and not agree:
        messages.append(
            f"{keywords.et} and {keywords.utc} differ by {known - stated:+.3f} s; {keywords.et} is used"
        )
    shift_s = _half_exposure(name, keywords, exposure_s)
    keep = agree and shift_s == 0.0 and text is not None and ISO_CALENDAR.fullmatch(str(text))
    return known + shift_s, str(text) if keep else _utc_of(name, known + shift_s), messages


def _et_of(name: str, text: str, keywords: KeywordMap) -> float:
    try:
        return et_from_text(text)
    except ValueError as error:
        raise image_error(
            name, f"{keywords.utc} = {text!r} is no UTC ({error}); correct the header."
        ) from error


def _utc_of(name: str, et: float) -> str:
    try:
        return text_from_et(et)
    except (ValueError, OverflowError) as error:
        raise image_error(
            name, f"the time {et:g} s past J2000 is no date ({error}); correct the header."
        ) from error


def _half_exposure(name: str, keywords: KeywordMap, exposure_s: float) -> float:
    if keywords.time_reference == "middle":
        return 0.0
    if math.isnan(exposure_s):
        raise image_error(
            name,
            "the header gives the start of the exposure, not its length; name that keyword in the mission.",
        )
    return 0.5 * exposure_s


def _without_time(name: str, header: Header, keywords: KeywordMap) -> str:
    looked_for = [k for k in (keywords.et, keywords.utc, keywords.sclk) if k]
    if looked_for and keywords.value(header, "sclk") is None:
        raise image_error(
            name,
            f"no time in the header: looked for {', '.join(looked_for)}; correct it or the mission file.",
        )
    return "no time in the header but the spacecraft clock" if looked_for else "no time keyword is known"
