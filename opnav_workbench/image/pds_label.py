"""PDS3 labels, attached or detached: their values and where they say the picture is, read in one pass.

What is opened and never closed (a bracket, a quote, a comment) is looked for once, not once a line, so that no label
takes longer than its length. Numbers have as many digits as measured things have; longer ones are text.

Source: PDS Standards Reference 3.8, chapters 12 (ODL) and 14 (pointers).
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.image.file_bytes import image_error
from opnav_workbench.image.header import HeaderValue

__all__ = ["PdsLabel", "PdsPointer", "image_pointer", "is_pds3", "label_integer", "parse_pds_label"]

LABEL_START = re.compile(rb"\s*(CCSD\w+\s[^\n]*\n\s*)?(PDS_VERSION_ID|ODL_VERSION_ID)\s*=")
LABEL_LIMIT_BYTES = 1 << 20  # the longest labels in the archives have some 100 kB
LABEL_END = re.compile(r"^[ \t]*END[ \t]*\r?$", re.MULTILINE)
ASSIGNMENT = re.compile(r"^[ \t]*(?P<name>\^?[A-Za-z][\w:]*)[ \t]*=\s*", re.MULTILINE)
LINE_END = re.compile(r"[\r\n]|\Z")
CLOSERS = {'"': '"', "(": ")", "{": "}"}
POINTER = re.compile(r'(?:"(?P<file>[^"]+)")?[\s,]*(?P<at>\d+)?\s*(?P<bytes><BYTES>)?', re.IGNORECASE)
MOST_DIGITS = 18  # of a whole number: eight bytes hold it


@dataclass(frozen=True, slots=True)
class PdsPointer:
    """Where a label says the data are: a file beside it (None: the same) and a byte offset."""

    file: str | None
    offset_bytes: int


@dataclass(frozen=True, slots=True)
class PdsLabel:
    """A PDS3 label: its values, those inside ``OBJECT = IMAGE``, and the text of ``^IMAGE``."""

    values: dict[str, HeaderValue]
    image: dict[str, HeaderValue]
    pointer: str


def is_pds3(data: bytes) -> bool:
    """Tell from the first bytes whether this is a PDS3 label, alone or before its data."""
    return LABEL_START.match(data[:1024]) is not None


def parse_pds_label(data: bytes) -> PdsLabel:
    """Return the values of a PDS3 label; units are dropped, lists become text, the first of equals counts."""
    text = data[:LABEL_LIMIT_BYTES].decode("latin-1")
    end = LABEL_END.search(text)
    values: dict[str, HeaderValue] = {}
    image: dict[str, HeaderValue] = {}
    inside: list[str] = []
    pointer = ""
    for name, value in _assignments(_without_comments(text[: end.start()] if end else text)):
        if name in ("OBJECT", "GROUP"):
            inside.append(value.upper())
        elif name in ("END_OBJECT", "END_GROUP"):
            inside = inside[:-1]
        elif name == "^IMAGE":
            pointer = pointer or value
        else:
            (image if inside[-1:] == ["IMAGE"] else values).setdefault(name, _value(value))
    return PdsLabel(values, image, pointer)


def _without_comments(text: str) -> str:
    kept, position = [], 0
    while (start := text.find("/*", position)) >= 0 and (end := text.find("*/", start + 2)) >= 0:
        kept.append(text[position:start])
        position = end + 2
    return "".join([*kept, text[position:]])


def _assignments(text: str) -> Iterator[tuple[str, str]]:
    """Yield names, in capitals, and the texts of their values: to the closing sign, or else to the line's end."""
    position = 0
    last = {sign: text.rfind(sign) for sign in CLOSERS.values()}
    while head := ASSIGNMENT.search(text, position):
        begin = head.end()
        closer = CLOSERS.get(text[begin : begin + 1])
        if closer is not None and begin < last[closer]:
            position = text.index(closer, begin + 1) + 1
        else:
            position = LINE_END.search(text, begin).start()  # type: ignore[union-attr]  # \Z is always found
        yield head["name"].upper(), text[begin:position].strip()


def _value(text: str) -> HeaderValue:
    bare = _without_unit(text)
    if len(bare.strip("+-")) <= MOST_DIGITS:
        try:
            return int(bare)
        except ValueError:
            pass
    try:
        return float(bare)
    except ValueError:
        pass
    if bare[:1] in ("(", "{"):
        return ", ".join(part.strip().strip('"') for part in bare.strip("(){}").split(","))
    return " ".join(bare.strip("\"'").split())


def _without_unit(text: str) -> str:
    """Return a value without the unit ``<...>`` at its end."""
    if not text.endswith(">"):
        return text
    start = text.find("<", text.rfind(">", 0, len(text) - 1) + 1)
    return text if start < 0 else text[:start].rstrip()


def image_pointer(name: str, label: PdsLabel) -> PdsPointer:
    """Return where ``^IMAGE`` points to.

    Raises
    ------
    ImageError
        The label points to no image.
    """
    found = POINTER.match(label.pointer.strip(" ()\t"))
    if found is None or not (found["file"] or found["at"]) or len(found["at"] or "") > MOST_DIGITS:
        raise image_error(
            name, "PDS3 label without a pointer ^IMAGE to a picture; give the label or file of an image."
        )
    position = int(found["at"] or 1) - 1
    in_records = position > 0 and not found["bytes"]
    unit = label_integer(name, label.values, "RECORD_BYTES", least=1) if in_records else 1
    return PdsPointer(Path(found["file"]).name if found["file"] else None, max(position, 0) * unit)


def label_integer(
    name: str, values: dict[str, HeaderValue], key: str, default: int | None = None, least: int = 0
) -> int:
    """Return a whole number of a label.

    Raises
    ------
    ImageError
        It is absent without a default, no whole number, or below `least`.
    """
    value = values.get(key, default)
    if not isinstance(value, int) or value < least:
        raise image_error(
            name, f"PDS3 label with {key} = {value!r}, expected a whole number from {least}; check the label."
        )
    return value
