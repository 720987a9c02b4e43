"""A picture in memory, and how it comes from a file: pixels, masks, exposure, mid-exposure time, header pointing.

Flow    file -> `StoredPicture` (`formats`) -> planes and masks (`planes`) -> time, pointing (`header`) -> `Picture`

Enter by `read_image`. Times are mid-exposure: a start time is shifted by half the exposure, and two statements of time in
one header must agree to 2 ms, as UTC texts are printed to a millisecond. Warnings of the libraries below do not escape;
they end in ``Picture.messages``.
"""

import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import ImageError, plain_line
from opnav_workbench.geometry.times import et_from_text, text_from_et
from opnav_workbench.image.file_bytes import file_bytes, image_error
from opnav_workbench.image.formats import StoredPicture, read_stored
from opnav_workbench.image.header import (
    Header,
    HeaderGeometry,
    KeywordMap,
    header_geometry,
    header_matches,
    header_number,
)
from opnav_workbench.image.planes import make_planes

__all__ = ["Picture", "picture_from_stored", "read_image"]


# ---- A picture in memory: pixels, masks and what the header says of time and pointing.


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture with its masks, time and header; arrays are read-only and indexed ``[line, pixel]``.

    Attributes
    ----------
    sha256
        Of the file that holds the pixels.
    image_dn : (n_line, n_pixel) array
        Native float64; 0 in pixels without a value, which are `bad` too.
    error_dn : (n_line, n_pixel) array or None
        One-sigma error as the file has it, positive everywhere. For the reader: measurements take `pixel_noise`,
        which knows what this picture's sky really scatters by.
    bad, saturated : (n_line, n_pixel) bool arrays
        Pixels not to use, and pixels whose value is only a lower bound. A saturated pixel need not be bad.
    exposure_s
        nan where no keyword for it is known.
    et
        Mid-exposure, TDB seconds past J2000.
    utc
        Mid-exposure, ISO calendar.
    sclk
        Spacecraft clock as the header has it, never shifted to mid-exposure.
    messages
        What a navigator should know about the file: masked pixels, departures from the standard, doubts.
    """

    path: Path
    sha256: str
    image_dn: FloatArray
    error_dn: FloatArray | None
    bad: BoolArray
    saturated: BoolArray
    header: Header
    exposure_s: float
    et: float | None
    utc: str | None
    sclk: str | None
    header_geometry: HeaderGeometry | None
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def name(self) -> str:
        """The file's name as people and tables read it: what is no text in it is written as such (see `plain_line`)."""
        return plain_line(self.path.name)

    def with_saturated(self, saturated: ArrayLike) -> "Picture":
        """Return the same picture with another saturation mask.

        Raises
        ------
        ImageError
            The mask has another shape than the picture.
        """
        mask = np.array(saturated, dtype=bool)
        if mask.shape != self.image_dn.shape:
            raise ImageError(
                f"{self.name}: a saturation mask of shape {mask.shape} does not fit a picture of shape "
                f"{self.image_dn.shape}; give one flag a pixel."
            )
        return replace(self, saturated=mask)


# ---- From the arrays and header of a file to a `Picture`: mission, planes, exposure, mid-exposure time.

# s: UTC texts are printed to a millisecond, and two sources of leap seconds agree to less.
TIME_DISAGREEMENT_S = 0.002
ISO_CALENDAR = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d+)?")


def picture_from_stored(
    path: Path, sha256: str, source: StoredPicture, keywords: KeywordMap, saturation_dn: float | None
) -> Picture:
    """Make a `Picture` of what a reader found.

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
    return Picture(
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
        found = header.get(keyword)
        if not header_matches(found, wanted):
            choices = wanted if isinstance(wanted, list | tuple) else (wanted,)
            expected = " or ".join(repr(choice) for choice in choices)
            state = f"has {keyword} = {found!r}" if found is not None else f"has no {keyword}"
            raise image_error(
                name,
                f"is not a frame of this mission: its header {state}, expected {expected}; choose the "
                "mission file that describes this picture (--mission).",
            )


def _exposure(name: str, header: Header, keywords: KeywordMap) -> float:
    if keywords.exposure_s is None:
        return math.nan
    value = keywords.value(header, "exposure_s")
    seconds = header_number(value)
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
    et = header_number(keywords.value(header, "et"))
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


# ---- From a file to a `Picture`.


def read_image(
    path: str | os.PathLike[str], keywords: KeywordMap, *, saturation_dn: float | None = None
) -> Picture:
    """Read a picture, told by content: FITS (also gzipped), VICAR, PDS3 with attached or detached label.

    Parameters
    ----------
    path : path-like
        Image file, or its detached PDS3 label.
    keywords
        Which header keywords hold time, exposure and pointing.
    saturation_dn
        Pixels at or above this value count as saturated.

    Raises
    ------
    ImageError
        One line with the file's name, what is wrong and what to do: missing, empty, truncated or damaged
        file, unknown format, no picture, a cube, no usable pixel, another mission's picture, no time, bad
        exposure.

    Notes
    -----
    Warnings of the libraries below do not escape; they end in ``Picture.messages``.
    """
    file = Path(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = file_bytes(file)
        pixels, source = read_stored(file, data, keywords)
        digest = hashlib.sha256(data if pixels == file else pixels.read_bytes()).hexdigest()
        picture = picture_from_stored(pixels, digest, source, keywords, saturation_dn)
    return replace(picture, messages=(*picture.messages, *_remarks(caught)))


def _remarks(caught: Iterable[warnings.WarningMessage]) -> tuple[str, ...]:
    texts = (" ".join(str(warning.message).split()) for warning in caught)
    return tuple(dict.fromkeys(f"remark while reading: {text}" for text in texts))
