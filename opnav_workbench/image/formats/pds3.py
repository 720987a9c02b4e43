"""PDS3 pictures: labels before their data or in a file beside it, raw rasters, and the compressed pictures of Voyager.

Source: PDS Standards Reference 3.8; its data object definitions for IMAGE.
"""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from opnav_workbench.image.file_bytes import image_error
from opnav_workbench.image.formats.huffman import ENCODING, read_first_differences
from opnav_workbench.image.formats.stored import (
    BandOrder,
    Raster,
    StoredPicture,
    from_vax,
    full_scale,
    holds_constants,
    linear,
    read_raster,
)
from opnav_workbench.image.header import HeaderValue, KeywordMap
from opnav_workbench.image.pds_label import PdsLabel, is_pds3, label_integer

__all__ = [
    "is_variable_length",
    "read_pds_raw",
    "read_variable_length",
    "variable_length_label",
]

BYTE_ORDERS = {"MSB": ">", "SUN": ">", "MAC": ">", "LSB": "<", "PC": "<", "VAX": "<"}
SAMPLE_TYPE = re.compile(
    r"(?:(?P<maker>MSB|SUN|MAC|LSB|PC|VAX|IEEE)_)?(?P<unsigned>UNSIGNED_)?(?P<kind>INTEGER|REAL|FLOAT)"
)
MISSING = (
    "MISSING_CONSTANT",
    "MISSING",
    "INVALID_CONSTANT",
    "NOT_APPLICABLE_CONSTANT",
    "UNKNOWN_CONSTANT",
    "CORE_NULL",
)
STORAGE: dict[str, BandOrder] = {
    "BAND_SEQUENTIAL": "BSQ",
    "LINE_INTERLEAVED": "BIL",
    "SAMPLE_INTERLEAVED": "BIP",
}


# ---- Rasters.


def read_pds_raw(name: str, data: bytes, offset: int, label: PdsLabel, keywords: KeywordMap) -> StoredPicture:
    """Read an uncompressed raw picture.

    Raises
    ------
    ImageError
        The label lacks what is needed, describes a cube without a channel chosen or a type that is not read, or the file
        is truncated.
    """
    image = label.image
    encoding = str(image.get("ENCODING_TYPE", "N/A")).upper()
    if encoding not in ("N/A", "NONE", ""):
        raise image_error(name, f"PDS3 image of ENCODING_TYPE {encoding!r} is not read; decompress it first.")
    bands = label_integer(name, image, "BANDS", 1, 1)
    if bands > 1 and keywords.channel is None:
        raise image_error(
            name,
            f"holds a cube of {bands} bands, not one picture; name one in the mission file (keywords: channel: 1), or "
            "save one band alone.",
        )
    lines, line_samples = (label_integer(name, image, key, least=1) for key in ("LINES", "LINE_SAMPLES"))
    prefix, suffix = (
        label_integer(name, image, key, 0) for key in ("LINE_PREFIX_BYTES", "LINE_SUFFIX_BYTES")
    )
    order = _storage(name, image)
    raster = Raster(lines, line_samples, _sample_type(name, image), bands, order, offset, prefix, suffix)
    samples = read_raster(name, data, raster)
    if _is_vax_real(image):
        samples = from_vax(samples)
    scale, zero = image.get("SCALING_FACTOR"), image.get("OFFSET")
    values = linear(name, samples, scale, zero, "PDS3 label whose SCALING_FACTOR or OFFSET")
    values[holds_constants(samples, map(image.get, MISSING))] = np.nan
    return StoredPicture(values, dict(label.values))


def _storage(name: str, image: dict[str, HeaderValue]) -> BandOrder:
    text = str(image.get("BAND_STORAGE_TYPE", "BAND_SEQUENTIAL")).upper().replace(" ", "_")
    if text not in STORAGE:
        raise image_error(name, f"PDS3 image of BAND_STORAGE_TYPE {text!r} is not read; check the label.")
    return STORAGE[text]


def _is_vax_real(image: dict[str, HeaderValue]) -> bool:
    return str(image.get("SAMPLE_TYPE", "")).upper().replace(" ", "_") in ("VAX_REAL", "VAX_FLOAT")


def _sample_type(name: str, image: dict[str, HeaderValue]) -> np.dtype[Any]:
    text, bits = (
        str(image.get("SAMPLE_TYPE", "")).upper().replace(" ", "_"),
        label_integer(name, image, "SAMPLE_BITS"),
    )
    match = SAMPLE_TYPE.fullmatch(text)
    real = match is not None and match["kind"] != "INTEGER"
    readable = bits in (((32,) if match["maker"] == "VAX" else (32, 64)) if match and real else (8, 16, 32))
    if match is None or not readable:
        raise image_error(
            name, f"PDS3 image of SAMPLE_TYPE {text!r} with {bits} bits is not read; convert it to FITS."
        )
    letter = "f" if real else "u" if match["unsigned"] else "i"
    return np.dtype(f"{BYTE_ORDERS.get(match['maker'], '>')}{letter}{bits // 8}")


# ---- Files of records of variable length, each led by its length: the volumes of Voyager.

LONGEST_RECORD = 1 << 13  # bytes; Voyager's have 836, and VMS allows 32767
MOST_RECORDS = 20_000


def is_variable_length(data: bytes) -> bool:
    """Tell from the first bytes whether these are records led by their length, the first of which begins a PDS label."""
    return (
        data[1:2] < b"\x20" and is_pds3(data[2:1024]) and int.from_bytes(data[:2], "little") < LONGEST_RECORD
    )


def _records(data: bytes) -> Iterator[bytes]:
    position = 0
    for _ in range(MOST_RECORDS):
        length = int.from_bytes(data[position : position + 2], "little")
        record = data[position + 2 : position + 2 + length]
        if position + 2 > len(data) or len(record) < length:
            return
        yield record
        position += 2 + length + length % 2


def variable_length_label(data: bytes) -> bytes:
    """Return the label's lines as text of lines."""
    lines = []
    for record in _records(data):
        lines.append(record.rstrip())
        if lines[-1].strip() == b"END":
            break
    return b"\r\n".join(lines)


def read_variable_length(name: str, data: bytes, label: PdsLabel) -> StoredPicture:
    """Read a compressed picture of Voyager's volumes: a record a line, each a chain of differences in Huffman's code.

    Raises
    ------
    ImageError
        It is compressed otherwise, or truncated.
    """
    image = label.image
    encoding = str(image.get("ENCODING_TYPE", "")).upper()
    if encoding != ENCODING:
        raise image_error(
            name,
            f"PDS3 image of ENCODING_TYPE {encoding!r} in records of variable length is not read; decompress it first."
            if encoding
            else "its label names no ENCODING_TYPE, or ends before it; copy or download the file again.",
        )
    lines, samples = (label_integer(name, image, key, least=1) for key in ("LINES", "LINE_SAMPLES"))
    suffix = label_integer(name, image, "LINE_SUFFIX_BYTES", 0)
    first, histogram = (
        label_integer(name, _pointed(label), key, least=1) - 1 for key in ("IMAGE", "ENCODING_HISTOGRAM")
    )
    records = list(_records(data))
    pixels = read_first_differences(
        name, records[histogram:first], records[first : first + lines], samples + suffix
    )
    if len(pixels) < lines:
        raise image_error(
            name, f"truncated: the image has {len(pixels)} of {lines} lines; copy or download the file again."
        )
    image_dn = pixels[:, :samples]
    return StoredPicture(image_dn, dict(label.values), saturated=full_scale(image_dn))


def _pointed(label: PdsLabel) -> dict[str, HeaderValue]:
    """Return the records, counted from 1, to which the label points."""
    return {name: int(text) for name, text in label.pointers.items() if text.isdigit() and len(text) < 9}
