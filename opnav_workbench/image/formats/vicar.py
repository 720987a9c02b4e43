"""VICAR pictures: labels at the file's begin and end, and the raster between them.

Source: Deen (1992), "The VICAR File Format", JPL D-4186.
"""

import re
from collections.abc import Iterator
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.image.file_bytes import check_size, image_error, truncated_error
from opnav_workbench.image.formats.stored import BandOrder, Raster, StoredPicture, read_raster
from opnav_workbench.image.header import HeaderValue

__all__ = ["is_vicar", "read_vicar"]

LABEL_SIZE = re.compile(rb"LBLSIZE *= *(\d+)")
LABEL_LIMIT_BYTES = 1 << 17  # labels with their history have some 10 kB
ITEM = re.compile(
    r"(?P<name>\w+) *= *(?P<value>'(?:[^']|'')*'|\((?:'(?:[^']|'')*'|[^')])*\)|[^\s'(]+)", re.ASCII
)
ELEMENT = re.compile(r"'((?:[^']|'')*)'|([^\s,'()]+)")
MOST_DIGITS = 12  # of any size that a label states
WHOLE_NUMBER = re.compile(r"[+-]?\d+")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d{1,3})?")
INTEGERS = {"BYTE": "u1", "HALF": "i2", "WORD": "i2", "FULL": "i4", "LONG": "i4"}
REALS = {"REAL": "f4", "DOUB": "f8"}
INTEGER_ORDERS, REAL_ORDERS = {"HIGH": ">", "LOW": "<"}, {"IEEE": ">", "RIEEE": "<"}


def is_vicar(data: bytes) -> bool:
    """Tell from the first bytes whether this is a VICAR file."""
    return LABEL_SIZE.match(data) is not None


def read_vicar(name: str, data: bytes) -> StoredPicture:
    """Read the picture and label of a VICAR file.

    Raises
    ------
    ImageError
        The file is truncated or malformed.
    """
    size, first = _label_at(name, data, 0)
    items: dict[str, HeaderValue] = {}
    _add(items, first)
    raster = _raster(name, items, size)
    check_size(name, raster.lines * raster.samples * raster.bands)
    end = raster.offset + raster.records * (raster.prefix + raster.line_bytes)
    if len(data) < end:
        raise truncated_error(name, "the VICAR data section", max(len(data) - size, 0), end - size)
    if items.get("EOL") == 1:
        _add(items, _label_at(name, data, end)[1])
    samples = read_raster(name, data, raster)
    real = items.get("FORMAT") == "REAL" and items.get("REALFMT") == "VAX"
    return StoredPicture(_from_vax(samples) if real else samples, items)


# ---- Labels.


def _label_at(name: str, data: bytes, start: int) -> tuple[int, str]:
    """Return size and text of the label that begins at a byte."""
    match = LABEL_SIZE.match(data, start)
    if match is None:
        raise _damaged(name, f"no label where one should be, at byte {start}")
    if len(match[1]) > MOST_DIGITS:
        raise _damaged(name, f"LBLSIZE of {len(match[1])} digits")
    if int(match[1]) > LABEL_LIMIT_BYTES:
        raise image_error(
            name, f"has a VICAR label of more than {LABEL_LIMIT_BYTES} bytes; shorten its history."
        )
    size = int(match[1])
    label = data[start : start + size]
    if len(label) < size:
        raise truncated_error(name, "the VICAR label", len(label), size)
    return size, label.partition(b"\0")[0].decode("latin-1")


def _add(items: dict[str, HeaderValue], label: str) -> None:
    """Add the items of a label; of repeated ones, as of tasks, the first counts."""
    for name, value in _items(label):
        items.setdefault(name, value)


def _items(label: str) -> Iterator[tuple[str, HeaderValue]]:
    for item in ITEM.finditer(label):
        text = item["value"]
        if text.startswith("("):
            yield item["name"], ", ".join(str(_value(e[0])) for e in ELEMENT.finditer(text))
        else:
            yield item["name"], _value(text)


def _value(text: str) -> HeaderValue:
    if text.startswith("'"):
        return text[1:-1].replace("''", "'")
    if WHOLE_NUMBER.fullmatch(text):
        return int(text) if len(text) <= MOST_DIGITS else text
    return float(text.upper().replace("D", "E")) if NUMBER.fullmatch(text) else text


# ---- The raster that a label describes.


def _raster(name: str, items: dict[str, HeaderValue], label_size: int) -> Raster:
    lines, samples = (_whole(name, items, key, 1) for key in ("NL", "NS"))
    bands = max(_whole(name, items, "NB", 0, 1), 1)
    record, prefix, before = (_whole(name, items, key, 0, 0) for key in ("RECSIZE", "NBB", "NLB"))
    order: Any = items.get("ORG", "BSQ")
    if order not in get_args(BandOrder):
        raise _damaged(name, f"ORG is {order!r}, expected {', '.join(get_args(BandOrder))}")
    offset = label_size + before * record
    raster = Raster(lines, samples, _sample_type(name, items), bands, order, offset, prefix)
    if order == "BIP":  # whose records are the bands of a sample
        if prefix or record != bands * raster.dtype.itemsize:
            raise _damaged(name, f"RECSIZE = {record} and NBB = {prefix} do not fit ORG = BIP")
    elif record != prefix + raster.line_bytes:
        raise _damaged(name, f"RECSIZE = {record}, but its lines have {prefix} and {raster.line_bytes} bytes")
    return raster


def _whole(name: str, items: dict[str, HeaderValue], key: str, least: int, default: int | None = None) -> int:
    value = items.get(key, default)
    if isinstance(value, str) and value.isdigit():
        raise _damaged(name, f"{key} of {len(value)} digits")
    if not isinstance(value, int) or not least <= value < 10**MOST_DIGITS:
        raise _damaged(name, f"{key} is {value!r}, expected a whole number from {least}")
    return value


def _sample_type(name: str, items: dict[str, HeaderValue]) -> np.dtype[Any]:
    kind = str(items.get("FORMAT", ""))
    if kind in INTEGERS and (order := INTEGER_ORDERS.get(str(items.get("INTFMT", "HIGH")))):
        return np.dtype(order + INTEGERS[kind])
    order = "<" if kind == "REAL" and items.get("REALFMT") == "VAX" else None
    if kind in REALS and (order := order or REAL_ORDERS.get(str(items.get("REALFMT", "IEEE")))):
        return np.dtype(order + REALS[kind])
    kinds = ", ".join([*INTEGERS, *REALS])
    stated = f"FORMAT {kind!r}, INTFMT {items.get('INTFMT')!r}, REALFMT {items.get('REALFMT')!r}"
    raise _damaged(name, f"{stated} is not read; of formats there are {kinds}")


def _from_vax(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Return VAX F_floating numbers, read as little-endian words of 32 bits, as floats; its unused patterns are 0 or nan."""
    words = np.ascontiguousarray(samples).view("<u4")
    bits = (words << np.uint32(16)) | (words >> np.uint32(16))
    exponent = ((bits >> np.uint32(23)) & np.uint32(0xFF)).astype(np.int32)
    fraction = 1.0 + (bits & np.uint32(0x7FFFFF)).astype(np.float64) / 2.0**23
    sign = np.where(bits >> np.uint32(31), -1.0, 1.0)
    values = np.ldexp(sign * fraction, exponent - 129)
    reserved = np.where(bits >> np.uint32(31), np.nan, 0.0)
    return np.where(exponent == 0, reserved, values).astype(np.float32)


def _damaged(name: str, why: str) -> Exception:
    return image_error(name, f"damaged VICAR file ({why}); copy or download it again.")
