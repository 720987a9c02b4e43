"""What every reader hands over: planes and header of one file, before masks and time are made of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.errors import ImageError
from opnav_workbench.image.frame import HeaderValue

__all__ = ["Source", "counted", "image_error", "plain", "truncated"]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Arrays of one file as stored (image, error, quality), header values, and remarks."""

    image: NDArray[Any]
    header: dict[str, HeaderValue]
    error: NDArray[Any] | None = None
    quality: NDArray[Any] | None = None
    messages: tuple[str, ...] = ()


def image_error(name: str, text: str) -> ImageError:
    """Return an `ImageError` of one line that begins with the file's name."""
    return ImageError(" ".join(f"{name}: {text}".split()))


def truncated(name: str, what: str, present: int, needed: int) -> ImageError:
    """Return the error of a file that ends too early."""
    return image_error(
        name, f"truncated: {what} has {present} of {needed} bytes; copy or download the file again."
    )


def plain(value: Any) -> HeaderValue | None:
    """Return a header value as a plain Python value; lists become text, what has no value becomes None."""
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(str(v) for v in value)
    return None if value is None else str(value)


def counted(count: int, noun: str) -> str:
    """Return a number with its noun.

    Examples
    --------
    >>> counted(1, "pixel"), counted(2, "pixel")
    ('1 pixel', '2 pixels')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"
