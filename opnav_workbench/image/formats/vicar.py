"""VICAR pictures: labels at the file's begin and end, and the raster between them.

Source: Deen (1992), "The VICAR File Format", JPL D-4186.
"""

import re
from collections.abc import Iterator
from typing import Any, get_args

import numpy as np

from opnav_workbench.image.file_bytes import check_size, image_error, truncated_error
from opnav_workbench.image.formats.stored import BandOrder, Raster, StoredPicture, from_vax, read_raster
from opnav_workbench.image.header import OF_UNIT, HeaderValue

__all__ = ["is_vicar", "lacks_label_size", "read_vicar"]

LABEL_SIZE = re.compile(rb"LBLSIZE *= *(\d+)", re.IGNORECASE)
# Words of the system label, of which a file without LBLSIZE at its begin has some all the same.
SYSTEM_WORD = re.compile(
    rb"\b(FORMAT|TYPE|BUFSIZ|RECSIZE|ORG|NL|NS|NB|N1|N2|INTFMT|REALFMT|HOST) *= *['\d]", re.IGNORECASE
)
FEWEST_WORDS = 4
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
# Of labels from before there were other machines; the specification's
INTEGER_DEFAULT, REAL_DEFAULT = "LOW", "VAX"
DIMENSIONS = {
    "BSQ": ("N1", "N2", "N3"),
    "BIL": ("N1", "N3", "N2"),
    "BIP": ("N2", "N3", "N1"),
}  # of sample, line, band
INTEGER_ORDERS, REAL_ORDERS = {"HIGH": ">", "LOW": "<"}, {"IEEE": ">", "RIEEE": "<"}


def is_vicar(data: bytes) -> bool:
    """Tell from the first bytes whether this is a VICAR file."""
    return LABEL_SIZE.match(data) is not None


def lacks_label_size(data: bytes) -> bool:
    """Tell whether a file has words of a VICAR label, but not LBLSIZE at its begin."""
    words = {word.upper() for word in SYSTEM_WORD.findall(data[:1024])}
    return LABEL_SIZE.match(data) is None and len(words) >= FEWEST_WORDS


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
    items = _voyager_words(items) | items
    samples = read_raster(name, data, raster)
    real = _word(items, "FORMAT", "") == "REAL" and _word(items, "REALFMT", REAL_DEFAULT) == "VAX"
    return StoredPicture(
        from_vax(samples) if real else samples, items, messages=_taken_formats(items, raster)
    )


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
        name = item["name"].upper()
        if text.startswith("("):
            yield name, ", ".join(str(_value(e[0])) for e in ELEMENT.finditer(text))
        else:
            yield name, _value(text)


def _value(text: str) -> HeaderValue:
    if text.startswith("'"):
        return text[1:-1].replace("''", "'")
    if WHOLE_NUMBER.fullmatch(text):
        return int(text) if len(text) <= MOST_DIGITS else text
    return float(text.upper().replace("D", "E")) if NUMBER.fullmatch(text) else text


# Raw pictures of Voyager have lines of text for a label: what they say, in the words of the archives' labels.
VOYAGER = re.compile(
    r"VGR-(?P<craft>[12]) .*?SCET (?P<year>\d\d)\.(?P<day>\d{3}) (?P<time>\d\d:\d\d:\d\d)"
    r".*?(?P<camera>[NW])A CAMERA +EXP +(?P<ms>[\d.]+) MSEC",
    re.DOTALL,
)


def _voyager_words(items: dict[str, HeaderValue]) -> dict[str, HeaderValue]:
    """Return spacecraft, camera, time and exposure of a label of Voyager's ground system; nothing of other labels."""
    said = VOYAGER.search("\n".join(str(items.get(f"LAB{number:02d}", "")) for number in range(1, 8)))
    if said is None:
        return {}
    camera = "NARROW" if said["camera"] == "N" else "WIDE"
    return {
        "SPACECRAFT_NAME": f"VOYAGER_{said['craft']}",
        "INSTRUMENT_NAME": f"{camera}_ANGLE_CAMERA",
        "IMAGE_TIME": f"19{said['year']}-{said['day']}T{said['time']}",
        "EXPOSURE_DURATION": float(said["ms"]),
        "EXPOSURE_DURATION" + OF_UNIT: "MSEC",
    }


# ---- The raster that a label describes.


def _raster(name: str, items: dict[str, HeaderValue], label_size: int) -> Raster:
    order: Any = _word(items, "ORG", "BSQ")
    if order not in get_args(BandOrder):
        raise _damaged(name, f"ORG is {order!r}, expected {', '.join(get_args(BandOrder))}")
    # Those that are not named are the dimensions, the fastest first.
    samples_of, lines_of, bands_of = DIMENSIONS[order]
    lines, samples = (
        _whole(name, items, key if key in items else other, 1)
        for key, other in (("NL", lines_of), ("NS", samples_of))
    )
    bands = max(_whole(name, items, "NB" if "NB" in items else bands_of, 0, 1), 1)
    prefix, before = (_whole(name, items, key, 0, 0) for key in ("NBB", "NLB"))
    kind = _sample_type(name, items)
    record = _whole(
        name, items, "RECSIZE", 0, prefix + kind.itemsize * (bands if order == "BIP" else samples)
    )
    offset = label_size + before * record
    raster = Raster(lines, samples, kind, bands, order, offset, prefix)
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
    kind = _word(items, "FORMAT", "")
    integers, reals = _word(items, "INTFMT", INTEGER_DEFAULT), _word(items, "REALFMT", REAL_DEFAULT)
    if kind in INTEGERS and (order := INTEGER_ORDERS.get(integers)):
        return np.dtype(order + INTEGERS[kind])
    order = "<" if kind == "REAL" and reals == "VAX" else None
    if kind in REALS and (order := order or REAL_ORDERS.get(reals)):
        return np.dtype(order + REALS[kind])
    known = ", ".join([*INTEGERS, *REALS])
    if not kind:
        raise image_error(
            name, f"its VICAR label lacks FORMAT ({known}); write it there, or give the original."
        )
    raise image_error(
        name,
        f"its VICAR label says FORMAT {kind!r}, INTFMT {integers!r}, REALFMT {reals!r}, which is not read (of formats there "
        f"are {known}, of VAX reals no doubles); convert it to FITS.",
    )


def _taken_formats(items: dict[str, HeaderValue], raster: Raster) -> tuple[str, ...]:
    """Return the remark that the label does not say how its numbers of several bytes lie, where it does not."""
    kind = _word(items, "FORMAT", "")
    key, default = ("REALFMT", REAL_DEFAULT) if kind in REALS else ("INTFMT", INTEGER_DEFAULT)
    if key in items or raster.dtype.itemsize == 1:
        return ()
    return (f"its VICAR label has no {key}: taken as {default}, as the format says",)


def _word(items: dict[str, HeaderValue], key: str, default: str) -> str:
    return str(items.get(key, default)).strip().upper()


def _damaged(name: str, why: str) -> Exception:
    return image_error(name, f"damaged VICAR file ({why}); copy or download it again.")
