"""Labels in ODL or PVL, as PDS3 files and ISIS cubes have them: their values, and where the picture is, in one pass.

What is opened and never closed (a bracket, a quote, a comment) is looked for once, not once a line, so that no label
takes longer than its length. Numbers have as many digits as measured things have; longer ones are text.

Source: PDS Standards Reference 3.8, chapters 12 (ODL), 14 (pointers) and 16 (SFDU wrappers); CCSDS 641.0-B-2 (PVL).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from opnav_workbench.image.file_bytes import image_error
from opnav_workbench.image.header import HeaderValue

__all__ = [
    "LabelItem",
    "PdsLabel",
    "PdsPointer",
    "image_pointer",
    "is_pds3",
    "label_integer",
    "label_items",
    "label_value",
    "parse_pds_label",
]

# A label may begin with a wrapper of CCSDS, and older ones have nothing else that tells them.
LABEL_START = re.compile(
    rb"\s*(CCSD[0-9A-Z]{8,}\s*=\s*SFDU_LABEL|(CCSD\w+\s[^\n]*\n\s*)?(PDS|ODL)_VERSION_ID\s*=)"
)
LABEL_LIMIT_BYTES = 1 << 20  # the longest labels in the archives have some 100 kB
LABEL_END = re.compile(r"^[ \t]*END[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)
# What closes an object or group may stand without a value.
ASSIGNMENT = re.compile(
    r"^[ \t]*(?:(?P<close>END_(?:OBJECT|GROUP))[ \t\r]*$|(?P<name>\^?[A-Za-z][\w:]*)[ \t]*=\s*)",
    re.MULTILINE | re.IGNORECASE,
)
LINE_END = re.compile(r"[\r\n]|\Z")
CLOSERS = {'"': '"', "(": ")", "{": "}"}
QUOTED_SYMBOL = re.compile(r"'[^'\r\n]*'")  # which a line's end does not interrupt
POINTER = re.compile(
    r"""(?:(?P<quote>["'])(?P<quoted>[^"']+)(?P=quote)|(?P<bare>[A-Za-z_][\w.-]*))?[\s,]*(?P<at>\d+)?\s*(?P<bytes><BYTES>)?""",
    re.IGNORECASE,
)
MOST_DIGITS = 18  # of a whole number: eight bytes hold it
DEEPEST = 20  # objects within objects; labels have three


@dataclass(frozen=True, slots=True)
class PdsPointer:
    """Where a label says the data are: a file beside it (None: the same) and a byte offset."""

    file: str | None
    offset_bytes: int


@dataclass(frozen=True, slots=True)
class PdsLabel:
    """A PDS3 label: its values, those inside ``OBJECT = IMAGE``, and the texts of its pointers."""

    values: dict[str, HeaderValue]
    image: dict[str, HeaderValue]
    pointers: dict[str, str]


def is_pds3(data: bytes) -> bool:
    """Tell from the first bytes whether this is a PDS3 label, alone or before its data."""
    return LABEL_START.match(data[:1024]) is not None


def parse_pds_label(data: bytes) -> PdsLabel:
    """Return the values of a PDS3 label; units are dropped, lists become text, the first of equals counts."""
    values: dict[str, HeaderValue] = {}
    image: dict[str, HeaderValue] = {}
    pointers: dict[str, str] = {}
    for item in label_items(data):
        if item.name.startswith("^"):
            pointers.setdefault(item.name[1:], item.text)
        else:
            inside = image if item.inside[-1:] == ("IMAGE",) else values
            inside.setdefault(item.name, label_value(item.text))
    return PdsLabel(values, image, pointers)


@dataclass(frozen=True, slots=True)
class LabelItem:
    """One assignment of a label: the objects and groups it stands in, its name, all in capitals, and its value's text."""

    inside: tuple[str, ...]
    name: str
    text: str


def label_items(data: bytes) -> Iterator[LabelItem]:
    """Yield the assignments of a label up to its END, without those that open and close objects and groups."""
    text = data[:LABEL_LIMIT_BYTES].decode("latin-1")
    end = LABEL_END.search(text)
    inside: tuple[str, ...] = ()
    for name, value in _assignments(_without_comments(text[: end.start()] if end else text)):
        if name in ("OBJECT", "GROUP", "BEGIN_OBJECT", "BEGIN_GROUP"):
            inside = (*inside, value.upper())[:DEEPEST]
        elif name in ("END_OBJECT", "END_GROUP"):
            inside = inside[:-1]
        else:
            yield LabelItem(inside, name, value)


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
        if head["close"]:
            yield head["close"].upper(), ""
            position = begin
            continue
        closer = CLOSERS.get(text[begin : begin + 1])
        symbol = QUOTED_SYMBOL.match(text, begin)
        if symbol is not None:
            position = symbol.end()
        elif closer is not None and begin < last[closer]:
            position = text.index(closer, begin + 1) + 1
        else:
            position = LINE_END.search(text, begin).start()  # type: ignore[union-attr]  # \Z is always found
        yield head["name"].upper(), text[begin:position].strip()


def label_value(text: str) -> HeaderValue:
    """Return what the text of a value stands for: a number, or text without quotes, units and line ends."""
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
        return ", ".join(part.strip().strip("\"'") for part in bare.strip("(){}").split(","))
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
    found = POINTER.match(label.pointers.get("IMAGE", "").strip(" ()\t"))
    file = None if found is None else found["quoted"] or found["bare"]
    if found is None or not (file or found["at"]) or len(found["at"] or "") > MOST_DIGITS:
        raise image_error(
            name, "PDS3 label without a pointer ^IMAGE to a picture; give the label or file of an image."
        )
    position = int(found["at"] or 1) - 1
    in_records = position > 0 and not found["bytes"]
    unit = label_integer(name, label.values, "RECORD_BYTES", least=1) if in_records else 1
    return PdsPointer(file, max(position, 0) * unit)


def label_integer(
    name: str, values: Mapping[str, HeaderValue], key: str, default: int | None = None, least: int = 0
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
            name, f"label with {key} = {value!r}, expected a whole number from {least}; check the label."
        )
    return value
