"""PDS4 pictures: arrays in a file of their own, which an XML label describes.

Labels have no document type, and no entities of their own: one that has is refused before anything of it is read.

Source: PDS4 Information Model, 1.21: Array_2D_Image and Array_3D_Image, Element_Array, Special_Constants.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np

from opnav_workbench.files import is_utf16
from opnav_workbench.image.file_bytes import image_error
from opnav_workbench.image.formats.stored import Raster, StoredPicture, holds_constants, linear, read_raster
from opnav_workbench.image.header import OF_UNIT, HeaderValue
from opnav_workbench.image.pds_label import label_integer, label_value

__all__ = ["Pds4Label", "is_pds4", "pds4_label", "read_pds4"]

LARGEST_LABEL_BYTES = 1 << 22
LONGEST_PREAMBLE_BYTES = 1 << 16  # before the root element: declarations, schemas, comments
ROOT = re.compile(rb"<(?:[\w.-]+:)?Product_")
DEEPEST = 40  # elements within elements; labels have twelve
MOST_ELEMENTS = 100_000
ARRAYS = ("ARRAY_2D_IMAGE", "ARRAY_3D_IMAGE", "ARRAY_2D", "ARRAY_3D", "ARRAY_3D_SPECTRUM")
DATA_TYPES = {
    "UnsignedByte": "u1", "SignedByte": "i1",
    "UnsignedMSB2": ">u2", "UnsignedMSB4": ">u4", "SignedMSB2": ">i2", "SignedMSB4": ">i4",
    "UnsignedLSB2": "<u2", "UnsignedLSB4": "<u4", "SignedLSB2": "<i2", "SignedLSB4": "<i4",
    "UnsignedMSB8": ">u8", "SignedMSB8": ">i8", "UnsignedLSB8": "<u8", "SignedLSB8": "<i8",
    "IEEE754MSBSingle": ">f4", "IEEE754MSBDouble": ">f8", "IEEE754LSBSingle": "<f4", "IEEE754LSBDouble": "<f8",
}  # fmt: skip
MISSING = (
    "MISSING_CONSTANT",
    "INVALID_CONSTANT",
    "NOT_APPLICABLE_CONSTANT",
    "UNKNOWN_CONSTANT",
    "ERROR_CONSTANT",
)
SATURATED = ("SATURATED_CONSTANT", "HIGH_INSTRUMENT_SATURATION", "HIGH_REPRESENTATION_SATURATION")


@dataclass(slots=True)
class _Element:
    """An element of a label: its name without name space, in capitals; its text; what stands in it."""

    name: str
    text: str = ""
    unit: str = ""
    inside: "list[_Element]" = field(default_factory=list)

    def all(self, *names: str) -> "Iterator[_Element]":
        """Yield the elements of these names in it, at any depth."""
        for element in self.inside:
            if element.name in names:
                yield element
            yield from element.all(*names)

    def value(self, name: str) -> HeaderValue | None:
        """Return the value of the first element of a name in it."""
        found = next(self.all(name), None)
        return None if found is None else label_value(found.text)


@dataclass(frozen=True, slots=True, eq=False)
class Pds4Label:
    """What a label says: its values, the file of the picture, and the element of its array."""

    values: dict[str, HeaderValue]
    file: str
    array: _Element


def is_pds4(data: bytes) -> bool:
    """Tell from the first bytes whether this is a PDS4 label."""
    start = data[:LONGEST_PREAMBLE_BYTES]
    if is_utf16(data):
        start = start.decode("utf-16", errors="ignore").encode()
    start = start.lstrip(b"\xef\xbb\xbf \t\r\n")
    return start.startswith(b"<") and ROOT.search(start) is not None


def pds4_label(name: str, data: bytes) -> Pds4Label:
    """Return what a label says of its picture.

    Raises
    ------
    ImageError
        It is no XML as labels are, or describes no picture.
    """
    root = _parsed(name, data)
    for area in root.all("FILE_AREA_OBSERVATIONAL"):
        array = next(area.all(*ARRAYS), None)
        file = next(area.all("FILE_NAME"), None)
        if array is not None and file is not None:
            return Pds4Label(_values(root), file.text, array)
    raise image_error(name, "PDS4 label without an Array_2D_Image in a file; give the label of an image.")


def _parsed(name: str, data: bytes) -> _Element:
    if len(data) > LARGEST_LABEL_BYTES:
        raise image_error(name, f"PDS4 label of {len(data)} bytes, more than {LARGEST_LABEL_BYTES}.")
    open_elements = [_Element("")]
    count = 0

    def refuse(*_: Any) -> None:
        raise image_error(name, "PDS4 label with a document type or entities of its own; remove them.")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS or len(open_elements) > DEEPEST:
            raise image_error(
                name, "PDS4 label with more elements than a label has; give the label of an image."
            )
        element = _Element(tag.rpartition(":")[2].upper(), unit=attributes.get("unit", ""))
        open_elements[-1].inside.append(element)
        open_elements.append(element)

    def end(_: str) -> None:
        element = open_elements.pop()
        element.text = element.text.strip()

    def text(characters: str) -> None:
        open_elements[-1].text += characters

    parser = expat.ParserCreate("utf-16" if is_utf16(data) else None)  # whatever it says that it has
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise image_error(name, f"damaged PDS4 label ({error}); copy or download it again.") from error
    except (ValueError, LookupError) as error:  # an encoding that nobody knows
        raise image_error(name, f"PDS4 label in an encoding that is not read ({error}).") from error
    return open_elements[0]


def _values(root: _Element) -> dict[str, HeaderValue]:
    """Return the values of a label: by name, and by ``AREA.NAME`` with the element they stand in; the first of equals.

    A unit stands under the name and `OF_UNIT`.
    """
    values: dict[str, HeaderValue] = {}

    def add(element: _Element) -> None:
        for inner in element.inside:
            if not inner.inside and inner.text:
                value = label_value(inner.text)
                for name in (inner.name, f"{element.name}.{inner.name}"):
                    if name not in values:
                        values[name] = value
                        values.update({name + OF_UNIT: inner.unit} if inner.unit else {})
            add(inner)

    add(root)
    return values


def read_pds4(name: str, label: Pds4Label, data: bytes) -> StoredPicture:
    """Read the array that a label describes.

    Parameters
    ----------
    data
        Of the file that the label names.

    Raises
    ------
    ImageError
        The label lacks what is needed, or the file is truncated.
    """
    array = label.array
    kind = str(array.value("DATA_TYPE"))
    if kind not in DATA_TYPES:
        known = ", ".join(DATA_TYPES)
        raise image_error(name, f"PDS4 array of data_type {kind!r} is not read; of types there are {known}.")
    sizes, order = _axes(name, array)
    offset = _whole(name, array, "OFFSET", 0)
    raster = Raster(
        sizes[-2], sizes[-1], np.dtype(DATA_TYPES[kind]), sizes[0] if len(sizes) == 3 else 1, offset=offset
    )
    stored = read_raster(name, data, raster)
    if order is not None:  # of one band, the raster has two axes left
        stored = np.ascontiguousarray(stored.reshape(sizes).transpose(order))
        stored = stored[0] if stored.ndim == 3 and len(stored) == 1 else stored
    scale, zero = array.value("SCALING_FACTOR"), array.value("VALUE_OFFSET")
    image = linear(name, stored, scale, zero, "PDS4 label whose scaling_factor or value_offset")
    image[holds_constants(stored, map(array.value, MISSING))] = np.nan
    saturated = holds_constants(stored, map(array.value, SATURATED))
    return StoredPicture(image, label.values, saturated=saturated)


LINE, SAMPLE = "line", "sample"


def _axes(name: str, array: _Element) -> tuple[list[int], list[int] | None]:
    """Return the sizes of an array's axes, slowest first, and how to bring them into the order band, line, sample.

    The second is None where they are so, or where their names do not tell.
    """
    axes = {
        _whole(name, axis, "SEQUENCE_NUMBER", 1): (
            _whole(name, axis, "ELEMENTS", 1),
            str(axis.value("AXIS_NAME") or "").strip().lower(),
        )
        for axis in array.all("AXIS_ARRAY")
    }
    found = [axes[number] for number in sorted(axes)]
    fastest = str(array.value("AXIS_INDEX_ORDER") or "Last Index Fastest")
    if len(found) not in (2, 3) or fastest.split(maxsplit=1)[0].lower() not in ("last", "first"):
        raise image_error(
            name, f"PDS4 array of {len(found)} axes, {fastest!r}, is no picture; check the label."
        )
    found = found if fastest.lower().startswith("last") else found[::-1]
    sizes, names = [size for size, _ in found], [axis for _, axis in found]
    if LINE not in names or SAMPLE not in names:
        return sizes, None
    bands = [i for i, axis in enumerate(names) if axis not in (LINE, SAMPLE)]
    order = [*bands, names.index(LINE), names.index(SAMPLE)]
    return sizes, None if order == sorted(order) or len(order) != len(sizes) else order


def _whole(name: str, element: _Element, key: str, least: int) -> int:
    value = element.value(key)
    return label_integer(name, {} if value is None else {key: value}, key, least=least)
