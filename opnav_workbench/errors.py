"""The package's errors: one root, one leaf per thing that can be wrong.

Every message says what was wrong, with the numbers, and what to do about it. What is expected in flight data
(a star not seen, a body off the detector, a saturated core) is a status on a result, never an exception.
"""

import unicodedata
from collections.abc import Sequence

__all__ = [
    "CameraError",
    "CatalogError",
    "CenterfindingError",
    "DownloadError",
    "EstimationError",
    "ImageError",
    "KernelError",
    "MissionError",
    "OpNavError",
    "PointingError",
    "SelectionPending",
    "SessionError",
    "counted",
    "plain_line",
]

LONGEST_MESSAGE = 2000  # characters; what a file repeats a thousand times is said once


class OpNavError(Exception):
    """Root of every error that this package raises on purpose; its message is one bounded line (see `plain_line`)."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*(plain_line(a) if isinstance(a, str) else a for a in arguments))


class KernelError(OpNavError):
    """A SPICE kernel, body, frame, clock or time span that is missing or unusable."""


class CameraError(OpNavError):
    """A camera description that is incomplete, or a geometry it cannot image."""


class CatalogError(OpNavError):
    """A star catalog that is missing, malformed or asked for something it does not hold."""


class ImageError(OpNavError):
    """A picture file that cannot be read or does not hold a usable picture."""


class DownloadError(OpNavError):
    """A file that cannot be fetched, or that is not the one it should be."""


class MissionError(OpNavError):
    """A mission or scenario file that is unknown or breaks its schema."""


class CenterfindingError(OpNavError):
    """A centerfinder called with input that no center can come from."""


class PointingError(OpNavError):
    """An attitude that the given stars cannot determine."""


class EstimationError(OpNavError):
    """Observables, parameters or a trajectory that no estimate or B-plane can come from."""


class SessionError(OpNavError):
    """A session step taken out of order, or a session that cannot be saved or resumed."""


class SelectionPending(SessionError):  # noqa: N818 - not a fault: an analyst's decision is still to come
    """A decision of the analyst that the next step waits for; in a notebook it is one line, without a traceback."""

    def _render_traceback_(self) -> list[str]:
        return [f"{type(self).__name__}: {self}"]


def plain_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    r"""Return text of others as one line for people: no control characters, no bytes that are no text, not too long.

    Examples
    --------
    >>> print(plain_line("night\n\x1b[31m1.fit"), plain_line("a\udcff.fit"), plain_line("0123456789", 8))
    night\n\x1b[31m1.fit a\xff.fit 01 … 89
    """
    text = _shortened(text, longest)
    if text.isprintable():
        return text
    return _shortened("".join(_printable(character) for character in text), longest)  # its escapes are longer


def _shortened(text: str, longest: int) -> str:
    kept = max((longest - 3) // 2, 1)
    return text if len(text) <= longest else f"{text[:kept]} … {text[-kept:]}"


def _printable(character: str) -> str:
    if character.isprintable() or unicodedata.category(character) == "Zs":
        return character
    if "\udc80" <= character <= "\udcff":  # a byte of a file's name that is no UTF-8
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, for messages.

    Examples
    --------
    >>> counted(1, "pixel"), counted(2, "pixel")
    ('1 pixel', '2 pixels')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"


def some_of(names: Sequence[str], most: int = 3) -> str:
    """Return the first of some names, and how many others there are, for messages.

    Examples
    --------
    >>> some_of(["a.bsp", "b.bsp"]), some_of(["a", "b", "c", "d", "e"])
    ('a.bsp, b.bsp', 'a, b, c and 2 more')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
