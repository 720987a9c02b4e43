"""Plain FITS files read without astropy, which takes a sixth of a second to load and gives the same of them.

Plain are files whose cards are of the standard's fixed form and whose images are stored as they are, or as unsigned
integers: what cameras and pipelines write, nearly always. All else is left to astropy: compressed images, scaled or blank
pixels, random groups, strings with quotes in them, hierarchical, record-valued and lower-case keywords, complex numbers,
cards that break the standard, files that are cut or followed by something else.

Source: FITS Standard 4.0, sections 3.3, 4.1, 4.2, 4.4 and 7.1; numbers as of `astropy.io.fits`.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.fits_layout import CARD_BYTES, FitsHeader, fits_headers
from opnav_workbench.image.header import HeaderValue

__all__ = ["PlainHdu", "PlainHdus", "plain_hdus"]

COMMENTARY = frozenset({"", "COMMENT", "HISTORY"})
CARD = re.compile(
    r"(?P<keyword>[A-Z0-9_-]{1,8}) *= *"
    r"(?:'(?P<text>[^']*)'|(?P<logical>[TF])|(?P<whole>[+-]?\d+)"
    r"|(?P<number>[+-]?(?:\d+\.\d*|\.\d+|\d+(?=[ED]))(?:[ED][+-]?\d+)?)|) *(?:/.*)?"
)
CONTINUED = re.compile(r"CONTINUE  +'(?P<text>[^']*)' *(?:/.*)?")
VALUE_COLUMN = 8  # of the sign of equality
RECORD_VALUED = re.compile(
    r"[A-Za-z_][\w.]*: +[-+.\dEeDd]+ *"
)  # a number in a text, which astropy takes for one
EXTENSIONS = ("IMAGE", "TABLE", "BINTABLE")


class _NotPlainError(Exception):
    """astropy shall read this file."""


@dataclass(frozen=True, slots=True)
class PlainHdu:
    """One header and its data, with the names that astropy gives them.

    Attributes
    ----------
    name
        EXTNAME, empty for an extension without; that of the first is PRIMARY then.
    is_image
        It may hold pixels.
    header
        Values by keyword, of equals the first, without comments and without keywords that have no value.
    shape
        Lines first; empty where there are no data.
    stored
        Its bytes.
    repeated
        What keywords say that stand there again, with another value.
    """

    name: str
    is_image: bool
    header: dict[str, HeaderValue]
    shape: tuple[int, ...]
    stored: bytes
    repeated: Mapping[str, HeaderValue] = field(default_factory=dict)

    @property
    def data(self) -> NDArray[Any] | None:
        """The pixels in the type that they are stored in, read-only; None where there are none."""
        if not self.shape:
            return None
        bits = int(self.header["BITPIX"])
        kind = "u1" if bits == 8 else f">{'i' if bits > 0 else 'f'}{abs(bits) // 8}"
        pixels = np.frombuffer(self.stored, kind).reshape(self.shape)
        if not self.header.get("BZERO", 0):
            return pixels
        unsigned = pixels.astype(f"u{bits // 8}")
        unsigned -= np.uint64(1 << (bits - 1)).astype(unsigned.dtype)  # modulo 2^bits, as adding it
        return unsigned


class PlainHdus(tuple[PlainHdu, ...]):
    """All of a file, in its order."""

    __slots__ = ()

    def index_of(self, wanted: str | int) -> int:
        """Return the index of the first extension of a name, whose case does not count; a number is one.

        Raises
        ------
        KeyError
            There is none.
        """
        if isinstance(wanted, int):
            return wanted
        name = wanted.strip().upper()
        for index, hdu in enumerate(self):
            if hdu.name.strip().upper() == name or (name == "PRIMARY" and index == 0):
                return index
        raise KeyError(wanted)


def plain_hdus(data: bytes) -> PlainHdus | None:
    """Return what a FITS file holds where it is plain throughout; None where astropy shall read it.

    Parameters
    ----------
    data
        Of a file that `opnav_workbench.fits_layout.check_fits_layout` has passed.
    """
    try:
        return PlainHdus(_hdus(data))
    except _NotPlainError:
        return None


def _hdus(data: bytes) -> Iterator[PlainHdu]:
    end = 0
    for index, header in enumerate(fits_headers(data)):
        text = data[header.start : header.data_start].decode("latin-1")
        size = header.data_bytes()
        end = header.data_start + size
        _require(len(text) == header.data_start - header.start and end <= len(data))
        repeated: dict[str, HeaderValue] = {}
        values = _values(text, repeated)
        yield replace(_hdu(index, values, header, data[header.data_start : end]), repeated=repeated)
        end = header.behind
    _require(len(data) == end > 0)  # else something follows that is no header, or the last block is short


def _hdu(index: int, values: dict[str, HeaderValue], header: FitsHeader, stored: bytes) -> PlainHdu:
    kind = next(iter(values.items()), None)
    is_image = index == 0 or kind == ("XTENSION", "IMAGE")
    _require(kind == ("SIMPLE", True) if index == 0 else kind in {("XTENSION", name) for name in EXTENSIONS})
    name = values.get("EXTNAME", "" if index else "PRIMARY")
    shape = tuple(reversed(header.axes()))
    if is_image:
        bits = int(values["BITPIX"])
        offset = float(1 << (bits - 1)) if bits in (16, 32, 64) else 0.0
        _require(values.get("BSCALE", 1) == 1 and values.get("BZERO", 0) in (0, offset))
        _require(0 not in shape and not {"BLANK", "GROUPS"} & values.keys())
        _require(values.get("PCOUNT", 0) == 0 and values.get("GCOUNT", 1) == 1)
    _require(isinstance(name, str) and not values.get("ZIMAGE"))
    return PlainHdu(str(name), is_image, values, shape, stored)


def _values(text: str, repeated: dict[str, HeaderValue]) -> dict[str, HeaderValue]:
    """Return the values of a header by keyword; of equal keywords the first, what another one says goes to `repeated`."""
    values: dict[str, HeaderValue] = {}
    for card, *more in _cards(text):
        if card[:VALUE_COLUMN].rstrip() in COMMENTARY:
            _require(not more)
            continue
        match = CARD.fullmatch(card)
        _require(match is not None and card[VALUE_COLUMN : VALUE_COLUMN + 2] == "= ")
        assert match is not None
        value = _joined([_value(match), *map(_continuation, more)]) if more else _value(match)
        if value is not None and values.setdefault(match["keyword"], value) != value:
            repeated[match["keyword"]] = value
    return values


def _cards(text: str) -> list[list[str]]:
    """Return the cards of a header up to its end, each with those that continue it."""
    cards: list[list[str]] = []
    for start in range(0, len(text), CARD_BYTES):
        card = text[start : start + CARD_BYTES]
        _require(card.isascii() and card.isprintable())
        if card.rstrip() == "END":
            _require(not text[start + CARD_BYTES :].strip(" "))
            return cards
        if card.startswith("CONTINUE"):
            _require(bool(cards))
            cards[-1].append(card)
        else:
            cards.append([card])
    raise _NotPlainError


def _value(card: re.Match[str]) -> HeaderValue | None:
    if card["text"] is not None:
        _require(RECORD_VALUED.fullmatch(card["text"]) is None)
        return card["text"].rstrip()
    if card["logical"]:
        return card["logical"] == "T"
    if card["whole"]:
        return int(card["whole"])
    return float(card["number"].replace("D", "E")) if card["number"] else None


def _continuation(card: str) -> str:
    match = CONTINUED.fullmatch(card)
    _require(match is not None)
    assert match is not None
    return match["text"].rstrip()


def _joined(pieces: Sequence[HeaderValue | None]) -> str:
    """Return the text of a card and of those that continue it; an ampersand says that more follows."""
    _require(isinstance(pieces[0], str))
    return "".join(str(piece).removesuffix("&") for piece in pieces).rstrip()


def _require(plain: bool) -> None:
    if not plain:
        raise _NotPlainError
