"""Labels in ODL or PVL, as PDS3 files and ISIS cubes have them: their values, and where the picture is, in one pass.

What is opened and never closed (a bracket, a quote, a comment) is looked for once, not once a line, so that no label
takes longer than its length. Numbers have as many digits as measured things have; longer ones are text.

Source: PDS Standards Reference 3.8, chapters 12 (ODL), 14 (pointers) and 16 (SFDU wrappers); CCSDS 641.0-B-2 (PVL).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from opnav_workbench.image.file_bytes import image_error
from opnav_workbench.image.header import OF_UNIT, HeaderValue, header_number

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
    rb"(?:\s|/\*[^*]*\*/|\xef\xbb\xbf)*"
    rb"((CCSD|NJPL)[0-9A-Z]{8,}\s*=\s*SFDU_LABEL|(CCSD\w+\s[^\n]*\n\s*)?(PDS|ODL)_VERSION_ID\s*=)",
    re.IGNORECASE,
)
LABEL_LIMIT_BYTES = 1 << 20  # the longest labels in the archives have some 100 kB
# What comes next in a label: a comment, its end, what closes an object or group (which may have no value), or a name.
NEXT = re.compile(
    r"(?P<comment>/\*)|^[ \t]*(?:(?P<end>END)[ \t]*;?[ \t]*(?:$|/\*)|(?P<close>END_(?:OBJECT|GROUP))[ \t]*;?[ \t]*$"
    r"|(?P<name>\^?[A-Za-z][\w:]*)[ \t]*=[ \t]*)",
    re.MULTILINE | re.IGNORECASE,
)
EMPTY_LINE = re.compile(r"[ \t]*\n\s*")
VALUE_END = re.compile(r"\n|/\*|\Z")
LISTS = {"(": ")", "{": "}"}
LIST_SIGN = re.compile(r"""\"[^"]*\"|'[^'\n]*'|[(){}]""")
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
UNIT = re.compile(r"[ \t]*<[^<>\n]*>")
QUOTED_SYMBOL = re.compile(r"'[^'\r\n]*'")  # which a line's end does not interrupt
POINTER = re.compile(
    r"""(?:(?P<quote>["'])(?P<quoted>[^"']+)(?P=quote)|(?P<bare>[A-Za-z_][\w.-]*))?[\s,]*(?P<at>\d+)?\s*(?P<bytes><BYTES>)?""",
    re.IGNORECASE,
)
BASED = re.compile(
    r"(?P<base>\d{1,2})#(?P<digits>[+-]?[0-9A-Za-z]{1,16})#"
)  # a whole number of ODL in another base
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
    """Return the values of a PDS3 label; lists become text, the first of equals counts.

    A unit stands under the value's name and `OF_UNIT`.
    """
    values: dict[str, HeaderValue] = {}
    image: dict[str, HeaderValue] = {}
    pointers: dict[str, str] = {}
    for item in label_items(data):
        if item.name.startswith("^"):
            pointers.setdefault(item.name[1:], item.text)
        else:
            inside = image if item.inside[-1:] == ("IMAGE",) else values
            if item.name not in inside:
                inside[item.name] = label_value(item.text)
                unit = _unit_at_end(item.text)
                inside |= {item.name + OF_UNIT: unit} if unit else {}
    return PdsLabel(values, image, pointers)


@dataclass(frozen=True, slots=True)
class LabelItem:
    """One assignment of a label: the objects and groups it stands in, its name, all in capitals, and its value's text."""

    inside: tuple[str, ...]
    name: str
    text: str


def label_items(data: bytes) -> Iterator[LabelItem]:
    """Yield the assignments of a label up to its END, without those that open and close objects and groups."""
    text = data[:LABEL_LIMIT_BYTES].decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    inside: tuple[str, ...] = ()
    for name, value in _assignments(text):
        if name in ("OBJECT", "GROUP", "BEGIN_OBJECT", "BEGIN_GROUP"):
            inside = (*inside, value.strip("\"'").upper())[:DEEPEST]
        elif name in ("END_OBJECT", "END_GROUP"):
            inside = inside[:-1]
        else:
            yield LabelItem(inside, name, value)


def _assignments(text: str) -> Iterator[tuple[str, str]]:
    """Yield names, in capitals, and the texts of their values: to the closing sign, or else to the line's end."""
    position = 0
    values = _Values(text)
    while head := NEXT.search(text, position):
        if head["end"]:
            return
        if head["comment"]:
            position = values.after_comment(head.start())
        elif head["close"]:
            yield head["close"].upper(), ""
            position = head.end()
        else:
            begin, position = values.extent(head.end())
            yield head["name"].upper(), values.between(begin, position)


class _Values:
    """Where values and comments of a label end; what is never closed is looked for once."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.last = {sign: text.rfind(sign) for sign in ("*/", '"', ")", "}")}
        self.lists_close = True

    def after_comment(self, start: int) -> int:
        return self.text.index("*/", start + 2) + 2 if start + 2 <= self.last["*/"] else start + 2

    def extent(self, begin: int) -> tuple[int, int]:
        """Return where the value after an equals sign begins and ends."""
        blank = EMPTY_LINE.match(self.text, begin)
        if blank is not None:  # it stands in a line of its own, or is missing
            if NEXT.match(self.text, blank.end()) or blank.end() == len(self.text):
                return begin, begin
            begin = blank.end()
        sign = self.text[begin : begin + 1]
        end = begin
        if (symbol := QUOTED_SYMBOL.match(self.text, begin)) is not None:
            end = symbol.end()
        elif sign == '"' and begin < self.last['"']:
            end = self.text.index('"', begin + 1) + 1
        elif sign in LISTS and begin < self.last[LISTS[sign]]:
            end = self._list_end(begin, LISTS[sign])
        if end == begin:
            return begin, VALUE_END.search(self.text, begin).start()  # type: ignore[union-attr]  # \Z is always found
        unit = UNIT.match(self.text, end)
        return begin, end if unit is None else unit.end()

    def _list_end(self, begin: int, closer: str) -> int:
        """Return where a list of lists and quoted texts ends; where brackets do not match, at the first that closes."""
        depth = 0
        for sign in LIST_SIGN.finditer(self.text, begin) if self.lists_close else ():
            depth += 1 if sign[0] in LISTS else -1 if sign[0] in LISTS.values() else 0
            if depth == 0:
                return sign.end()
        self.lists_close = False
        return self.text.index(closer, begin + 1) + 1

    def between(self, begin: int, end: int) -> str:
        value = self.text[begin:end].strip()
        return COMMENT.sub("", value) if value[:1] in LISTS and "/*" in value else value


def label_value(text: str) -> HeaderValue:
    """Return what the text of a value stands for: a number, or text without quotes, units and line ends."""
    bare = _without_unit(text)
    based = BASED.fullmatch(bare)
    if based is not None and bare.startswith("10#"):  # others are bits of samples, and stay text
        bare = based["digits"]
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


def _unit_at_end(text: str) -> str:
    """Return the unit of a value, empty where it has none."""
    return text[text.rfind("<") + 1 : -1].strip() if _without_unit(text) != text else ""


def image_pointer(name: str, label: PdsLabel) -> PdsPointer:
    """Return where ``^IMAGE`` points to.

    Raises
    ------
    ImageError
        The label points to no image.
    """
    found = POINTER.match(label.pointers.get("IMAGE", "").strip(" ()\t\n"))
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
    number = header_number(value) if isinstance(value, str | float) and not isinstance(value, bool) else value
    whole = int(number) if isinstance(number, float) and number.is_integer() else number  # as 20.0, or "20"
    if isinstance(whole, bool) or not isinstance(whole, int) or whole < least:
        raise image_error(
            name, f"label with {key} = {value!r}, expected a whole number from {least}; check the label."
        )
    return whole
