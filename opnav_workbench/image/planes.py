"""From stored arrays to picture, error and masks of one shape, in DN that are proportional to light.

Values that a spacecraft squeezed into fewer bits before sending them are expanded by the mission's table, special pixels
(below -1e30 DN: ISIS, PDS) and infinities become masked, dark columns are cut off, and saturation comes from the quality
plane, the camera's limit and the digitizer's bits. Rectangles of one value never arrived, and are masked. An error plane
is made positive everywhere.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import counted
from opnav_workbench.image.file_bytes import check_size, image_error
from opnav_workbench.image.formats.stored import StoredPicture
from opnav_workbench.image.header import Header, KeywordMap, header_number
from opnav_workbench.image.masks import QUALITY_TABLES, read_quality

__all__ = ["expanded", "make_planes"]


# ---- Values that a spacecraft squeezed into fewer bits before sending them, by a table.


def expanded(
    name: str, image: FloatArray, header: Header, keywords: KeywordMap
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return a picture in DN that are proportional to light, and a remark where its values were squeezed.

    Raises
    ------
    ImageError
        Values that the table does not have.
    """
    how = keywords.value(header, "expansion_keyword")
    table = None if how is None else keywords.expansion.get(str(how))
    if table is None:
        return image, ()
    values = np.asarray(table, dtype=np.float64)
    stored = np.nan_to_num(image)
    if stored.min() < 0.0 or stored.max() > len(values) - 1 or not np.array_equal(stored, np.rint(stored)):
        raise image_error(
            name,
            f"{keywords.expansion_keyword} is {how}, whose table has values 0 to {len(values) - 1}, but pixels hold "
            f"{stored.min():g} to {stored.max():g}; it seems expanded already: correct the header.",
        )
    remark = f"values expanded from {len(values)} steps to {values[-1]:g} DN ({keywords.expansion_keyword} = {how})"
    return np.where(np.isnan(image), np.nan, values[stored.astype(np.int64)]), (remark,)


# ---- From stored arrays to picture, error and masks of one shape.

# DN: special pixels of ISIS and of PDS products (-1E+32, -3.4E+38) lie below this, detectors never do.
LOWEST_VALUE_DN = -1e30
LARGEST_BITS = 32


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """Picture (0 where it has no value), positive error, masks, all (n_line, n_pixel), and remarks."""

    image_dn: FloatArray
    error_dn: FloatArray | None
    bad: BoolArray
    saturated: BoolArray
    messages: tuple[str, ...]


# How programs that save pictures of color cameras name the filters over the pixels.
MOSAIC_KEYWORDS = ("BAYERPAT", "BAYRPAT", "COLORTYP")
MOSAIC = re.compile("[RGB]{4}")


def _mosaic(header: Header) -> tuple[str, ...]:
    """Return a remark on a picture whose pixels see different colors, none of others."""
    for keyword in MOSAIC_KEYWORDS:
        pattern = str(header.get(keyword, "")).strip().upper()
        if MOSAIC.fullmatch(pattern):
            told = (
                f"neighboring pixels lie under different color filters ({keyword} = {pattern}) and are read as gray: "
                "centers follow the filters, by more than their sigmas tell; save one color's pixels as a picture, or "
                "interpolate it to all pixels"
            )
            return (told,)
    return ()


def make_planes(
    name: str, source: StoredPicture, header: Header, keywords: KeywordMap, saturation_dn: float | None
) -> Planes:
    """Make native float64 planes and masks of what a file holds.

    Raises
    ------
    ImageError
        No picture, a cube, planes of different sizes, or no usable pixel.
    """
    stored, full = _chosen_channel(name, source, keywords)
    image, remarks = expanded(name, _single_plane(name, stored), header, keywords)
    error = _fitting_plane(name, source.error, "error", image.shape)
    quality = _fitting_plane(name, source.quality, "quality", image.shape)
    shape = image.shape
    messages = [*source.messages, *remarks, *_mosaic(header)]
    dark = keywords.dark_columns.get(image.shape[1], 0)
    if 0 < dark < image.shape[1]:
        image = image[:, :-dark]
        error, quality = (None if plane is None else plane[:, :-dark] for plane in (error, quality))
        messages.append(f"{counted(dark, 'dark column')} at the right end cut off")
    bad, saturated = _masks(image, quality, keywords, messages)
    if full is not None and full.shape == shape:
        saturated |= full[:, : saturated.shape[1]]
    for limit in _saturation_limits(header, keywords, saturation_dn):
        saturated |= image >= limit
    lost = lost_areas(np.where(bad | saturated, np.nan, image))
    if count := int(np.count_nonzero(lost)):
        messages.append(
            f"{counted(count, 'pixel')} of one value, in areas that lines and pixels bound, masked: lost"
        )
        bad |= lost
    _check_usable(name, image, bad, messages)
    error = None if error is None else _positive(error, image, bad, messages)
    return Planes(np.where(np.isnan(image), 0.0, image), error, bad, saturated, tuple(messages))


def _chosen_channel(
    name: str, source: StoredPicture, keywords: KeywordMap
) -> tuple[NDArray[Any], BoolArray | None]:
    """Return the channel that the mission names of a picture of several, and which of its pixels are saturated."""
    data = source.image
    if keywords.channel is None or data.ndim != 3 or data.shape[0] == 1:
        return data, source.saturated
    names = [*source.channels] or [str(number + 1) for number in range(data.shape[0])]
    wanted = str(keywords.channel).strip().casefold()
    for number, channel in enumerate(names):
        if wanted in (channel.casefold(), str(number + 1)):
            return data[number], None if source.saturated is None else source.saturated[number]
    raise image_error(
        name,
        f"has no channel {keywords.channel!r}; its channels are {', '.join(names)} (mission file, keywords: channel).",
    )


def _single_plane(name: str, data: NDArray[Any]) -> FloatArray:
    """Return a picture with nan for special values; a cube of one plane is squeezed."""
    check_size(name, data.size)
    values = np.array(data, dtype=np.float64)
    while values.ndim > 2 and values.shape[0] == 1:
        values = values[0]
    if values.ndim > 2:
        sizes = " x ".join(str(n) for n in values.shape)
        raise image_error(
            name,
            f"holds a cube of {sizes}, not one picture; name its channel in the mission file (keywords: channel: 1, or "
            "green), or save the plane to be measured as a file of its own.",
        )
    if values.ndim < 2 or values.size == 0:
        raise image_error(name, f"holds data of shape {values.shape}, no picture; choose an image file.")
    values[~(values > LOWEST_VALUE_DN) | np.isinf(values)] = np.nan
    return values


def _fitting_plane(
    name: str, data: NDArray[Any] | None, what: str, shape: tuple[int, ...]
) -> FloatArray | None:
    if data is None:
        return None
    plane = _single_plane(name, data)
    if plane.shape != shape:
        raise image_error(
            name, f"the {what} plane has shape {plane.shape}, the picture {shape}; give the file as archived."
        )
    return plane


def _masks(
    image: FloatArray, quality: FloatArray | None, keywords: KeywordMap, messages: list[str]
) -> tuple[BoolArray, BoolArray]:
    bad = np.isnan(image)
    if count := int(np.count_nonzero(bad)):
        messages.append(f"{counted(count, 'pixel')} without a value masked")
    bad[0, : keywords.housekeeping_pixels] = True
    if quality is None:
        return bad, np.zeros(bad.shape, bool)
    flagged, saturated, remarks = read_quality(np.nan_to_num(quality), QUALITY_TABLES[keywords.quality_table])
    messages += remarks
    return bad | flagged, saturated


def _saturation_limits(header: Header, keywords: KeywordMap, saturation_dn: float | None) -> Iterator[float]:
    if saturation_dn is not None:
        yield saturation_dn
    bits = header_number(keywords.value(header, "bits"))
    if bits is not None and 1 <= bits <= LARGEST_BITS:
        yield 2.0 ** int(bits) - 1.0


def _check_usable(name: str, image: FloatArray, bad: BoolArray, messages: list[str]) -> None:
    usable = image[~bad]
    if usable.size == 0:
        reason = "has no finite value" if np.isnan(image).all() else "is marked as bad"
        raise image_error(name, f"every one of its {bad.size} pixels {reason}; leave this picture out.")
    if usable.min() == usable.max():
        messages.append(f"every usable pixel holds the value {usable[0]:g}: an empty or lost picture")


# ---- Parts of a picture that never arrived, and were filled with one value.

LOST_SIDE_PX = 8  # smaller ones are left: a star's box survives them, and noise of few steps makes such
# Of their bounding box: what telemetry loses ends along lines and pixels, a dark sky beside a body does not.
LOST_FILL = 0.998
MOSTLY = 0.5  # of its lines and columns; a dead column that runs into it is none of it
QUIET_SHARE = 0.5  # of pixels that equal their neighbors: where more do, it is the sky that has no noise


def lost_areas(image_dn: FloatArray) -> BoolArray:
    """Return the pixels (n_line, n_pixel) of rectangles that hold one and the same value, in a picture with noise.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
        nan where a pixel is masked already.

    Examples
    --------
    >>> image = np.random.default_rng(1).normal(20.0, 2.0, (64, 64))
    >>> image[10:30, 20:40] = 0.0
    >>> int(lost_areas(image).sum())
    400
    """
    same = np.zeros(image_dn.shape, bool)
    same[1:, 1:] = (image_dn[1:, 1:] == image_dn[1:, :-1]) & (image_dn[1:, 1:] == image_dn[:-1, 1:])
    lost = np.zeros(image_dn.shape, bool)
    if np.count_nonzero(same) < (LOST_SIDE_PX - 1) ** 2:
        return lost
    areas, _ = ndimage.label(same)
    size = np.bincount(areas.ravel())
    large = np.flatnonzero(size >= (LOST_SIDE_PX - 1) ** 2)
    large = large[large > 0]
    if large.size == 0:
        return lost  # of a hundred thousand small ones no box is needed
    rank = np.zeros(len(size), np.int32)
    rank[large] = np.arange(1, large.size + 1)
    for number, box in zip(large, ndimage.find_objects(rank[areas]), strict=True):
        first, last = _rectangle(areas[box] == number)
        sides = last - first
        if sides.min() >= LOST_SIDE_PX - 1:
            line, pixel = first[0] + box[0].start, first[1] + box[1].start
            lost[line - 1 : line + sides[0], pixel - 1 : pixel + sides[1]] = True
    quiet = np.count_nonzero(same & ~lost) > QUIET_SHARE * np.count_nonzero(~lost)
    return np.zeros_like(lost) if quiet or lost.all() else lost


def _rectangle(area: BoolArray) -> tuple[IntArray, IntArray]:
    """Return first and last (line, pixel) of the rectangle that an area is but for what adjoins it; empty if it is none."""
    spans = [np.flatnonzero(area.mean(axis=axis) > MOSTLY) for axis in (1, 0)]
    if min(len(span) for span in spans) == 0:
        return np.zeros(2, np.int64), np.zeros(2, np.int64)
    first, last = (np.array([span[end] for span in spans]) for end in (0, -1))
    inner = area[first[0] : last[0] + 1, first[1] : last[1] + 1]
    return first, last + 1 if inner.mean() >= LOST_FILL else first


def _positive(error: FloatArray, image: FloatArray, bad: BoolArray, messages: list[str]) -> FloatArray | None:
    """Return a positive error everywhere: the LORRI pipeline writes 0 where the signal is negative.

    The replacement is the typical error of the fainter half of the picture, where such pixels belong.
    """
    known = np.isfinite(error) & (error > 0.0)
    good = known & ~bad
    if not good.any():
        messages.append("error plane dropped: it holds no positive value")
        return None
    typical = float(np.median(error[good & (image <= np.median(image[good]))]))
    if count := int(np.count_nonzero(~known)):
        messages.append(f"error plane: {counted(count, 'value')} not positive, replaced by {typical:.3g} DN")
    return np.where(known, error, typical)
