"""What every reader hands over: planes and header of one file, before masks and time are made of them; and rasters in bytes.

A raster is lines of samples in a run of bytes, as PDS labels, VICAR, ISIS cubes and raw files describe it; its size and the
bytes that there are are checked before any array is made.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.image.file_bytes import check_size, image_error, truncated_error
from opnav_workbench.image.header import HeaderValue, KeywordMap, header_number

__all__ = [
    "FORMATS",
    "BandOrder",
    "Raster",
    "StoredPicture",
    "from_vax",
    "full_scale",
    "header_value",
    "holds_constants",
    "linear",
    "read_raster",
]

FORMATS = "FITS, VICAR, PDS3, PDS4, ISIS cube, PNG, TIFF or JPEG"
BandOrder: TypeAlias = Literal["BSQ", "BIL", "BIP"]
BITS = re.compile(r"(?:0x|16#)([0-9a-f]{1,16})#?", re.IGNORECASE)  # of a number, as PDS4 and PDS3 write them
MOST_LINE_BYTES = 1 << 24  # of prefixes and suffixes too: a line of a hundred thousand samples has less


@dataclass(frozen=True, slots=True, eq=False)
class StoredPicture:
    """Arrays of one file as stored, header values, and remarks.

    Attributes
    ----------
    image : (n_line, n_pixel) or (n_channel, n_line, n_pixel) array
    error, quality : array or None
        Planes of the picture's size.
    messages
        Remarks on the file.
    saturated : (n_line, n_pixel) array of bool or None
        Pixels that the format itself marks as more than it can hold.
    channels
        Names of the channels; empty: they are called 1, 2, 3.
    keywords
        Which keywords hold what, where it is not as the mission says: a sidecar may tell more than its missions' headers.
    repeated
        Words that the header has twice, with what it says the other time.
    """

    image: NDArray[Any]
    header: dict[str, HeaderValue]
    error: NDArray[Any] | None = None
    quality: NDArray[Any] | None = None
    messages: tuple[str, ...] = ()
    saturated: BoolArray | None = None
    channels: tuple[str, ...] = ()
    keywords: KeywordMap | None = None
    repeated: Mapping[str, HeaderValue] = field(default_factory=dict)


def header_value(value: Any) -> HeaderValue | None:
    """Return a header value as a plain Python value; lists become text, what has no value becomes None."""
    if isinstance(value, np.generic):
        return header_value(value.item())
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(str(v) for v in value)
    return None if value is None else str(value)


def full_scale(image: NDArray[Any]) -> BoolArray | None:
    """Return which pixels hold the highest value of their whole-number type; None of other types."""
    if image.dtype.kind not in "iu":
        return None
    return np.asarray(image == np.iinfo(image.dtype).max)


def holds_constants(stored: NDArray[Any], constants: Iterable[HeaderValue | None]) -> BoolArray:
    """Return which samples hold any of a label's special constants; None stands for those that it does not have."""
    out = np.zeros(stored.shape, dtype=bool)
    for constant in constants:
        if constant is not None:
            out |= _holds(stored, constant)
    return out


def _holds(stored: NDArray[Any], constant: HeaderValue) -> BoolArray:
    """Return which samples hold a constant: a number, or the bits of one (0xFF7FFFFB, 16#FF7FFFFB#)."""
    bits = BITS.fullmatch(str(constant).strip())
    number = header_number(constant)
    if bits is not None and len(bits[1]) <= 2 * stored.dtype.itemsize:
        unsigned = stored.dtype.newbyteorder("=").str[1:].replace("f", "u").replace("i", "u")
        native = np.ascontiguousarray(stored, stored.dtype.newbyteorder("="))
        return np.asarray(native.view(unsigned) == np.array(int(bits[1], 16), unsigned))
    return np.zeros(stored.shape, dtype=bool) if number is None else np.asarray(stored == number)


def linear(
    name: str, stored: NDArray[Any], scale: HeaderValue | None, zero: HeaderValue | None, label: str
) -> FloatArray:
    """Return stored values times a label's scale (None: 1), plus its zero (None: 0).

    Parameters
    ----------
    name, label
        The file, its kind of label and that label's two words, for messages.

    Raises
    ------
    ImageError
        One of the two is no number.
    """
    factor = header_number(1.0 if scale is None else scale)
    added = header_number(0.0 if zero is None else zero)
    if factor is None or added is None:
        raise image_error(name, f"{label} is no number; check the label.")
    return stored.astype(np.float64) * factor + added


@dataclass(frozen=True, slots=True)
class Raster:
    """Where the samples of a picture are in a run of bytes.

    Attributes
    ----------
    order : {"BSQ", "BIL", "BIP"}
        Whole bands one after the other; the bands of a line; the bands of a sample.
    offset
        Bytes before the first line.
    prefix, suffix
        Bytes before and after the samples of each line (of each band's line, unless the bands of a sample are together).
    """

    lines: int
    samples: int
    dtype: np.dtype[Any]
    bands: int = 1
    order: BandOrder = "BSQ"
    offset: int = 0
    prefix: int = 0
    suffix: int = 0

    @property
    def line_bytes(self) -> int:
        """Bytes of one line's samples."""
        return self.samples * self.dtype.itemsize * (self.bands if self.order == "BIP" else 1)

    @property
    def records(self) -> int:
        """How many lines are stored, those of all bands counted."""
        return self.lines * (1 if self.order == "BIP" else self.bands)


def read_raster(name: str, data: bytes, raster: Raster, what: str = "the image") -> NDArray[Any]:
    """Return the samples (n_line, n_pixel), or (n_band, n_line, n_pixel) of more than one band.

    Parameters
    ----------
    name, what
        The file and its part, for messages.

    Raises
    ------
    ImageError
        It holds more pixels than memory is meant for, or the file ends too early.
    """
    check_size(name, raster.lines * raster.samples * raster.bands)
    width = raster.prefix + raster.line_bytes + raster.suffix
    if width > MOST_LINE_BYTES:
        raise image_error(name, f"has lines of {width} bytes, more than {MOST_LINE_BYTES}; check the label.")
    needed, present = raster.records * width, max(len(data) - raster.offset, 0)
    if present < needed:
        raise truncated_error(name, what, present, needed)
    rows = np.frombuffer(data, np.uint8, needed, raster.offset).reshape(raster.records, width)
    samples = np.ascontiguousarray(rows[:, raster.prefix : width - raster.suffix]).view(raster.dtype)
    return _banded(samples, raster)


def _banded(samples: NDArray[Any], raster: Raster) -> NDArray[Any]:
    if raster.bands == 1:
        return samples
    if raster.order == "BSQ":
        return samples.reshape(raster.bands, raster.lines, raster.samples)
    if raster.order == "BIL":
        return samples.reshape(raster.lines, raster.bands, raster.samples).swapaxes(0, 1)
    return np.moveaxis(samples.reshape(raster.lines, raster.samples, raster.bands), 2, 0)


def from_vax(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Return VAX F_floating numbers, read as little-endian words of 32 bits, as floats; its unused patterns are 0 or nan."""
    words = np.ascontiguousarray(samples).view("<u4")
    bits = (words << np.uint32(16)) | (words >> np.uint32(16))
    exponent = ((bits >> np.uint32(23)) & np.uint32(0xFF)).astype(np.int32)
    fraction = 1.0 + (bits & np.uint32(0x7FFFFF)).astype(np.float64) / 2.0**23
    sign = np.where(bits >> np.uint32(31), -1.0, 1.0)
    values = np.ldexp(sign * fraction, exponent - 129)
    reserved = np.where(bits >> np.uint32(31), np.nan, 0.0)
    return np.where(exponent == 0, reserved, values).astype(np.float32)
