"""FITS headers looked at before a library believes them: what they announce is bounded and fits into the file.

A reader of FITS loops over as many axes as NAXIS says, seeks to where NAXISn and PCOUNT point and allocates what a
compressed image claims to be; one wrong number makes it run for hours or take all memory. So the structural cards of
every header are read here first, in one pass over the bytes, whatever their alignment.

Source: FITS Standard 4.0, sections 3.1, 4.4.1, 7.1 and 10.
"""

import math
import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

__all__ = [
    "CARD_BYTES",
    "MOST_PIXELS",
    "FitsHeader",
    "FitsLayoutError",
    "check_fits_layout",
    "fits_headers",
    "fits_malformed",
]

BLOCK_BYTES, CARD_BYTES = 2880, 80
MOST_AXES = MOST_FIELDS = 999  # by the standard
MOST_PIXELS = 1 << 26  # 8192 x 8192 of one plane: no camera that navigates has more
MOST_PICTURE_AXES = 3  # of a compressed image: a plane, or a cube of them
MOST_HEADERS = 1000  # pictures have three, mosaics some hundred
MOST_CARDS = 50_000  # of one header; the longest processing histories have a few thousand
BITS = (8, 16, 32, 64, -32, -64)
END = b"END".ljust(8)
# A card of eight blanks is a comment; of fewer, a library may forgive the misalignment.
STRUCTURE = re.compile(
    rb"\s{0,7}(BITPIX|NAXIS\d*|PCOUNT|GCOUNT|GROUPS|TFIELDS|ZIMAGE|ZBITPIX|ZNAXIS\d*|ZTILE\d+)\s*=([^/]*)",
    re.IGNORECASE,
)
LOGICAL = ("GROUPS", "ZIMAGE")


def fits_malformed() -> tuple[type[Exception], ...]:
    """Return what astropy and numpy raise on files that break the standard in other ways; for an ``except``."""
    from astropy.io.fits import VerifyError  # noqa: PLC0415 (a tenth of a short command; plain files need none of it)

    return (
        OSError, TypeError, ValueError, LookupError, AttributeError, ArithmeticError, MemoryError, VerifyError,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class FitsHeader:
    """The structural cards of one header.

    Attributes
    ----------
    what
        Which one it is, for messages.
    start, data_start
        Where it and its data begin in the file.
    cards
        By keyword.
    """

    what: str
    start: int
    data_start: int
    cards: dict[str, int] = field(default_factory=dict)

    def axes(self, prefix: str = "NAXIS") -> list[int]:
        """Return the lengths of its axes, pixels first."""
        count = self.cards.get(prefix, 0)
        return [self.cards[f"{prefix}{i}"] for i in range(1, count + 1)]

    def data_bytes(self) -> int:
        """Return how many bytes its data take, without what fills the last block."""
        axes = self.axes()
        if not axes:
            return 0
        if axes[0] == 0 and self.cards.get("GROUPS"):  # random groups: the first axis is a mark
            axes = axes[1:]
        count = self.cards.get("GCOUNT", 1) * (self.cards.get("PCOUNT", 0) + math.prod(axes))
        return abs(self.cards["BITPIX"]) // 8 * count

    @property
    def behind(self) -> int:
        """Where the next header begins."""
        size = self.data_bytes()
        return self.data_start + size + -size % BLOCK_BYTES


class FitsLayoutError(ValueError):
    """A FITS file whose headers announce what cannot be; one line with a remedy."""


def check_fits_layout(data: bytes | mmap.mmap) -> bool:
    """Refuse a FITS file whose headers announce what cannot be; tell whether it has compressed images.

    Parameters
    ----------
    data
        Its bytes, unpacked.

    Raises
    ------
    FitsLayoutError
        A header without end, too many headers or cards, a structural number that is none, is given twice with two
        values or lies beyond the standard, or a compressed image of more than `MOST_PIXELS` pixels.
    """
    compressed = False
    for number, header in enumerate(fits_headers(data)):
        if number == MOST_HEADERS:
            raise FitsLayoutError(f"has more than {MOST_HEADERS} FITS headers; give the picture alone.")
        if fault := _fault(header):
            raise _damaged(header.what, fault)
        compressed |= bool(header.cards.get("ZIMAGE"))
    return compressed


def _damaged(what: str, fault: str) -> FitsLayoutError:
    return FitsLayoutError(f"damaged FITS file: {what} has {fault}; copy or download it again.")


def fits_headers(data: bytes | mmap.mmap) -> Iterator[FitsHeader]:
    """Follow the chain of headers; what comes behind the last whole one is no concern of a reader of pictures.

    Raises
    ------
    FitsLayoutError
        As `check_fits_layout`, for what concerns the chain.
    """
    start, number = 0, 0
    while start < len(data):
        end = _end_of_header(data, start)
        if end is None:
            return
        what = f"the header of extension {number}" if number else "the first header"
        header = FitsHeader(what, start, end + -end % BLOCK_BYTES)
        _read_cards(header, data[start:end])
        yield header
        start, number = header.behind, number + 1


def _end_of_header(data: bytes | mmap.mmap, start: int) -> int | None:
    """Return where a header's last card ends."""
    for count, card in enumerate(range(start, len(data), CARD_BYTES)):
        if data[card : card + len(END)].ljust(len(END)) == END:
            return card + CARD_BYTES
        if count == MOST_CARDS:
            raise FitsLayoutError(f"has a FITS header of more than {MOST_CARDS} cards; shorten its history.")
    return None


def _read_cards(found: FitsHeader, header: bytes) -> None:
    for start in range(0, len(header), CARD_BYTES):
        match = STRUCTURE.match(header[start : start + CARD_BYTES])
        if match is None:
            continue
        keyword = match[1].decode().upper()
        value = _number(keyword, match[2].strip())
        if value is None or found.cards.setdefault(keyword, value) != value:
            text = match[2].strip().decode("latin-1")
            raise _damaged(found.what, f"{keyword} = {text}, expected one whole number")
    if fault := _axes_fault(found):
        raise _damaged(found.what, fault)


def _number(keyword: str, text: bytes) -> int | None:
    if keyword in LOGICAL:
        return int(text == b"T")
    try:
        return int(text)
    except ValueError:
        return None


def _axes_fault(header: FitsHeader) -> str:
    """Say what is wrong with the numbers by which the next header is found."""
    cards = header.cards
    if fault := _bits_fault(cards, "BITPIX"):
        return fault
    for prefix, most in (("NAXIS", MOST_AXES), ("ZNAXIS", MOST_PICTURE_AXES)):
        count = cards.get(prefix, 0)
        if not 0 <= count <= most:
            return f"{prefix} = {count}, expected 0 to {most}"
        missing = [f"{prefix}{i}" for i in range(1, count + 1) if f"{prefix}{i}" not in cards]
        if missing:
            return f"{prefix} = {count} but no {missing[0]}"
    negative = [(k, v) for k, v in cards.items() if v < 0 and k not in ("BITPIX", "ZBITPIX")]
    return f"{negative[0][0]} = {negative[0][1]}, expected none below 0" if negative else ""


def _bits_fault(cards: dict[str, int], keyword: str) -> str:
    bits = cards.get(keyword)
    return "" if bits in BITS else f"{keyword} = {bits}, expected one of {', '.join(map(str, BITS))}"


def _fault(header: FitsHeader) -> str:
    """Say what else a header announces that cannot be."""
    cards = header.cards
    if cards.get("TFIELDS", 0) > MOST_FIELDS:
        return f"TFIELDS = {cards['TFIELDS']}, expected at most {MOST_FIELDS}"
    if not cards.get("ZIMAGE"):
        return ""
    if fault := _bits_fault(cards, "ZBITPIX"):
        return fault
    pixels = math.prod(header.axes("ZNAXIS"))
    if pixels > MOST_PIXELS:
        return f"a compressed image of {pixels} pixels, more than {MOST_PIXELS}"
    tiles = [(key, value) for key, value in cards.items() if key.startswith("ZTILE")]
    wrong = [(key, value) for key, value in tiles if not 1 <= value <= MOST_PIXELS]
    return f"{wrong[0][0]} = {wrong[0][1]}, expected 1 to {MOST_PIXELS}" if wrong else ""
