"""PDS3 labels, attached or detached, and the raw pictures that they describe.

Source: PDS Standards Reference 3.8: data object pointers, ODL, the IMAGE object and its sample types.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.image.frame import HeaderValue
from opnav_workbench.image.keywords import number
from opnav_workbench.image.source import Source, image_error, truncated

__all__ = ["Label", "Pointer", "image_pointer", "is_pds3", "parse_label", "read_raw"]

LABEL_START = re.compile(rb"\s*(CCSD\w+\s[^\n]*\n\s*)?(PDS_VERSION_ID|ODL_VERSION_ID)\s*=")
LABEL_LIMIT_BYTES = 1 << 20  # the longest labels in the archives have some 100 kB
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
ASSIGNMENT = re.compile(
    r"^[ \t]*(?P<name>\^?[A-Za-z][\w:]*)[ \t]*=\s*"
    r'(?P<value>"[^"]*"|\([^)]*\)|\{[^}]*\}|[^\r\n]*)',
    re.MULTILINE,
)
END = re.compile(r"^[ \t]*END[ \t]*\r?$", re.MULTILINE)
UNIT = re.compile(r"\s*<[^>]*>\s*$")
POINTER = re.compile(r'(?:"(?P<file>[^"]+)")?[\s,]*(?P<at>\d+)?\s*(?P<bytes><BYTES>)?', re.IGNORECASE)
BYTE_ORDERS = {"MSB": ">", "SUN": ">", "MAC": ">", "LSB": "<", "PC": "<", "VAX": "<"}
SAMPLE_TYPE = re.compile(
    r"(?:(?P<maker>MSB|SUN|MAC|LSB|PC|VAX|IEEE)_)?(?P<unsigned>UNSIGNED_)?(?P<kind>INTEGER|REAL|FLOAT)"
)


@dataclass(frozen=True, slots=True)
class Pointer:
    """Where a label says the data are: a file beside it (None: the same) and a byte offset."""

    file: str | None
    offset_bytes: int


@dataclass(frozen=True, slots=True)
class Label:
    """A PDS3 label: its values, those inside ``OBJECT = IMAGE``, and the text of ``^IMAGE``."""

    values: dict[str, HeaderValue]
    image: dict[str, HeaderValue]
    pointer: str


def is_pds3(data: bytes) -> bool:
    """Tell from the first bytes whether this is a PDS3 label, alone or before its data."""
    return LABEL_START.match(data[:1024]) is not None


def parse_label(data: bytes) -> Label:
    """Return the values of a PDS3 label; units are dropped, lists become text, the first of equals counts."""
    text = data[:LABEL_LIMIT_BYTES].decode("latin-1")
    end = END.search(text)
    text = COMMENT.sub("", text[: end.start()] if end else text)
    values: dict[str, HeaderValue] = {}
    image: dict[str, HeaderValue] = {}
    inside: list[str] = []
    pointer = ""
    for match in ASSIGNMENT.finditer(text):
        name, value = match["name"].upper(), match["value"].strip()
        if name in ("OBJECT", "GROUP"):
            inside.append(value.upper())
        elif name in ("END_OBJECT", "END_GROUP"):
            inside = inside[:-1]
        elif name == "^IMAGE":
            pointer = pointer or value
        else:
            (image if inside[-1:] == ["IMAGE"] else values).setdefault(name, _value(value))
    return Label(values, image, pointer)


def _value(text: str) -> HeaderValue:
    bare = UNIT.sub("", text)
    for kind in (int, float):
        try:
            return kind(bare)
        except ValueError:
            continue
    if bare[:1] in "({":
        return ", ".join(part.strip().strip('"') for part in bare.strip("(){}").split(","))
    return " ".join(bare.strip("\"'").split())


def image_pointer(name: str, label: Label) -> Pointer:
    """Return where ``^IMAGE`` points to.

    Raises
    ------
    ImageError
        The label points to no image.
    """
    found = POINTER.match(label.pointer.strip(" ()\t"))
    if found is None or not (found["file"] or found["at"]):
        raise image_error(
            name, "PDS3 label without a pointer ^IMAGE to a picture; give the label or file of an image."
        )
    position = int(found["at"] or 1) - 1
    in_records = position > 0 and not found["bytes"]
    unit = _whole(name, label.values, "RECORD_BYTES", least=1) if in_records else 1
    return Pointer(Path(found["file"]).name if found["file"] else None, position * unit)


def read_raw(name: str, data: bytes, offset: int, label: Label) -> Source:
    """Read an uncompressed raw picture.

    Raises
    ------
    ImageError
        The label lacks what is needed, describes a cube or a type that is not read, or the file is truncated.
    """
    image = label.image
    lines, samples = (_whole(name, image, key, least=1) for key in ("LINES", "LINE_SAMPLES"))
    if (bands := _whole(name, image, "BANDS", 1)) != 1:
        raise image_error(name, f"holds a cube of {bands} bands, not one picture; save one band alone.")
    dtype = _sample_type(name, image)
    prefix, suffix = (_whole(name, image, key, 0) for key in ("LINE_PREFIX_BYTES", "LINE_SUFFIX_BYTES"))
    width = prefix + samples * dtype.itemsize + suffix
    present = max(len(data) - offset, 0)
    if present < lines * width:
        raise truncated(name, "the image", present, lines * width)
    rows = np.frombuffer(data, np.uint8, lines * width, offset).reshape(lines, width)
    pixels = np.ascontiguousarray(rows[:, prefix : width - suffix]).view(dtype).astype(np.float64)
    scale, zero = number(image.get("SCALING_FACTOR", 1.0)), number(image.get("OFFSET", 0.0))
    if scale is None or zero is None:
        raise image_error(name, "PDS3 label whose SCALING_FACTOR or OFFSET is no number; check the label.")
    return Source(pixels * scale + zero, dict(label.values))


def _whole(
    name: str, values: dict[str, HeaderValue], key: str, default: int | None = None, least: int = 0
) -> int:
    value = values.get(key, default)
    if not isinstance(value, int) or value < least:
        raise image_error(
            name, f"PDS3 label with {key} = {value!r}, expected a whole number from {least}; check the label."
        )
    return value


def _sample_type(name: str, image: dict[str, HeaderValue]) -> np.dtype[Any]:
    text, bits = str(image.get("SAMPLE_TYPE", "")).upper(), _whole(name, image, "SAMPLE_BITS")
    match = SAMPLE_TYPE.fullmatch(text)
    real = match is not None and match["kind"] != "INTEGER"
    readable = bits in ((32, 64) if real else (8, 16, 32))
    if match is None or not readable or (real and match["maker"] == "VAX"):
        raise image_error(
            name, f"PDS3 image of SAMPLE_TYPE {text!r} with {bits} bits is not read; convert it to FITS."
        )
    letter = "f" if real else "u" if match["unsigned"] else "i"
    return np.dtype(f"{BYTE_ORDERS.get(match['maker'], '>')}{letter}{bits // 8}")
