"""FITS pictures: image, error and quality planes, each checked for its full length before it is read.

Source: FITS Standard 4.0. The data of a FITS file are big-endian; `Frame` makes native float64 of them.
"""

import io
from typing import Any, TypeAlias

from astropy.io import fits
from astropy.io.fits.card import Undefined

from opnav_workbench.image.frame import HeaderValue
from opnav_workbench.image.keywords import KeywordMap
from opnav_workbench.image.source import Source, image_error, plain, truncated

__all__ = ["is_fits", "read_fits"]

Extension: TypeAlias = str | int
COMMENTARY = frozenset({"", "COMMENT", "HISTORY", "END", "CONTINUE"})
# What astropy raises on files that break the standard.
MALFORMED = (
    OSError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    MemoryError,
    fits.VerifyError,
)


def is_fits(data: bytes) -> bool:
    """Tell from the first bytes whether this is a FITS file."""
    return data.startswith(b"SIMPLE  =")


def read_fits(name: str, data: bytes, keywords: KeywordMap) -> Source:
    """Read the planes that `keywords` names from the bytes of a FITS file.

    Raises
    ------
    ImageError
        The file is truncated or malformed, or has no picture.
    """
    try:
        with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
            for index, hdu in enumerate(hdus):
                _check_length(name, len(data), hdu, index)
            return _read_planes(name, hdus, keywords)
    except MALFORMED as error:
        raise image_error(
            name, f"damaged FITS file ({type(error).__name__}: {error}); copy or download it again."
        ) from error


def _check_length(name: str, available: int, hdu: Any, index: int) -> None:
    """Refuse a short data section, of which astropy would only warn."""
    start, size = hdu.fileinfo()["datLoc"], hdu.size
    if start + size > available:
        what = f"extension {index} ({hdu.name})" if index else "the data section"
        raise truncated(name, what, max(available - start, 0), size)


def _read_planes(name: str, hdus: Any, keywords: KeywordMap) -> Source:
    picture = _picture(name, hdus, keywords.image_extension)
    messages: list[str] = []
    header = _header(hdus[0].header, messages)
    if picture:
        header |= _header(hdus[picture].header, messages)
    planes: dict[str, Any] = {}
    for what, wanted in (("error", keywords.error_extension), ("quality", keywords.quality_extension)):
        index = None if wanted is None else _find(hdus, wanted)
        planes[what] = None if index is None else hdus[index].data
        if wanted is not None and planes[what] is None:
            messages.append(f"no {what} plane: FITS extension {wanted!r} is not an image of {_names(hdus)}")
    return Source(hdus[picture].data, header, **planes, messages=tuple(messages))


def _picture(name: str, hdus: Any, wanted: Extension | None) -> int:
    """Return the index of the picture: the one named, else the first extension with lines and pixels."""
    if wanted is not None:
        index = _find(hdus, wanted)
        if index is None:
            raise image_error(name, f"no picture in a FITS extension {wanted!r}; there are {_names(hdus)}.")
        return index
    for index, hdu in enumerate(hdus):
        if hdu.is_image and len(hdu.shape) >= 2:
            return index
    raise image_error(
        name, f"no two-dimensional picture among its extensions {_names(hdus)}; choose an image file."
    )


def _find(hdus: Any, wanted: Extension) -> int | None:
    """Return the index of an image extension by name or index, None where there is none."""
    try:
        index = int(hdus.index_of(wanted))
    except KeyError:
        return None
    return index if 0 <= index < len(hdus) and hdus[index].is_image else None


def _names(hdus: Any) -> str:
    return ", ".join(f"{index} {hdu.name!r}" for index, hdu in enumerate(hdus))


def _header(header: Any, messages: list[str]) -> dict[str, HeaderValue]:
    """Return a FITS header as plain values, without comments and undefined cards; of equals the first."""
    values: dict[str, HeaderValue] = {}
    for card in header.cards:
        if card.keyword in COMMENTARY:
            continue
        try:
            value = None if isinstance(card.value, Undefined) else plain(card.value)
        except fits.VerifyError:
            messages.append(f"header card {card.keyword} breaks the FITS standard and is left out")
            continue
        if value is not None:
            values.setdefault(card.keyword, value)
    return values
