"""FITS pictures: image, error and quality planes, which the mission's keywords name; data are big-endian.

Every plane is checked for its full length before it is read. Source: FITS Standard 4.0.
"""

import io
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from opnav_workbench.fits_layout import FitsLayoutError, check_fits_layout, fits_malformed
from opnav_workbench.image.file_bytes import image_error, truncated_error
from opnav_workbench.image.formats.plain_fits import PlainHdu, plain_hdus
from opnav_workbench.image.formats.stored import StoredPicture, header_value
from opnav_workbench.image.header import HeaderValue, KeywordMap
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.supervised import TrialError, tried

if TYPE_CHECKING:
    from astropy.io import fits
else:  # plain files need none of it
    fits = module_on_demand("astropy.io.fits")

__all__ = ["is_fits", "read_fits"]

Extension: TypeAlias = str | int
FITS_BLOCK_BYTES = 2880  # the last block of a file may be short
FITS_COMMENTARY = frozenset({"", "COMMENT", "HISTORY", "END", "CONTINUE"})


def is_fits(data: bytes) -> bool:
    """Tell from the first bytes whether this is a FITS file."""
    return data.startswith(b"SIMPLE  =")


def read_fits(file: Path, data: bytes, keywords: KeywordMap) -> StoredPicture:
    """Read the planes that `keywords` names from the bytes of a FITS file, unpacked where they were gzipped.

    Raises
    ------
    ImageError
        The file is truncated or malformed, or has no picture.
    """
    name = file.name
    if has_compressed_images(name, data):
        _try_decompressing(file)
    elif (plain := plain_hdus(data)) is not None:
        return _fits_planes(name, plain, keywords)
    try:
        with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
            for index, hdu in enumerate(hdus):
                _check_fits_length(name, len(data), hdu, index)
            return _fits_planes(name, hdus, keywords)
    except fits_malformed() as error:
        raise image_error(
            name, f"damaged FITS file ({type(error).__name__}: {error}); copy or download it again."
        ) from error


def has_compressed_images(name: str, data: bytes) -> bool:
    """Look at the headers of a FITS file before a library does, and tell whether it has compressed images.

    Raises
    ------
    ImageError
        They announce what cannot be.
    """
    try:
        return check_fits_layout(data)
    except FitsLayoutError as error:
        raise image_error(name, str(error)) from error


def _try_decompressing(file: Path) -> None:
    """Decompress in a process that may end: compiled code does it, and trusts the stream."""
    try:
        tried("image/picture_trial.py:try_fits", str(file))
    except TrialError as error:
        raise image_error(
            file.name, f"its compressed image cannot be unpacked: {error}; copy or download it again."
        ) from error


def _check_fits_length(name: str, available: int, hdu: Any, index: int) -> None:
    """Refuse a short data section, of which astropy would only warn."""
    start, size = hdu.fileinfo()["datLoc"], hdu.size
    if isinstance(hdu, fits.CompImageHDU):  # whose size is that of the picture, not of what is stored
        size = max(hdu.fileinfo()["datSpan"] - FITS_BLOCK_BYTES + 1, 0)
    if start + size > available:
        what = f"extension {index} ({hdu.name})" if index else "the data section"
        raise truncated_error(name, what, max(available - start, 0), size)


def _fits_planes(name: str, hdus: Any, keywords: KeywordMap) -> StoredPicture:
    beside = {
        what: None if wanted is None else _find_extension(hdus, wanted)
        for what, wanted in (("error", keywords.error_extension), ("quality", keywords.quality_extension))
    }
    picture = _picture_extension(name, hdus, keywords.image_extension, set(beside.values()))
    messages: list[str] = []
    repeated: dict[str, HeaderValue] = {}
    header = _header_of(hdus[0], messages, repeated)
    if picture:
        header |= _header_of(hdus[picture], messages, repeated)
    planes: dict[str, Any] = {}
    for what, index in beside.items():
        wanted = getattr(keywords, f"{what}_extension")
        planes[what] = None if index is None else hdus[index].data
        if wanted is not None and planes[what] is None:
            messages.append(
                f"no {what} plane: FITS extension {wanted!r} is not an image of {_extension_names(hdus)}"
            )
    return StoredPicture(hdus[picture].data, header, **planes, messages=tuple(messages), repeated=repeated)


def _picture_extension(name: str, hdus: Any, wanted: Extension | None, others: Collection[int | None]) -> int:
    """Return the index of the picture: the one named, else the first with lines and pixels that is none of `others`."""
    if wanted is not None:
        index = _find_extension(hdus, wanted)
        if index is None:
            raise image_error(
                name, f"no picture in a FITS extension {wanted!r}; there are {_extension_names(hdus)}."
            )
        return index
    for index, hdu in enumerate(hdus):
        if hdu.is_image and len(hdu.shape) >= 2 and index not in others:
            return index
    raise image_error(
        name,
        f"no two-dimensional picture among its extensions {_extension_names(hdus)}; choose an image file.",
    )


def _find_extension(hdus: Any, wanted: Extension) -> int | None:
    """Return the index of an image extension by name or index, None where there is none."""
    try:
        index = int(hdus.index_of(wanted))
    except KeyError:
        return None
    return index if 0 <= index < len(hdus) and hdus[index].is_image else None


def _extension_names(hdus: Any) -> str:
    return ", ".join(f"{index} {hdu.name!r}" for index, hdu in enumerate(hdus))


def _header_of(hdu: Any, messages: list[str], repeated: dict[str, HeaderValue]) -> dict[str, HeaderValue]:
    """Return a FITS header as plain values, without comments and undefined cards; of equals the first.

    What one that stands there again says otherwise goes to `repeated`.
    """
    if isinstance(hdu, PlainHdu):
        repeated.update(hdu.repeated)
        return dict(hdu.header)
    values: dict[str, HeaderValue] = {}
    for card in hdu.header.cards:
        if card.keyword in FITS_COMMENTARY:
            continue
        try:
            value = None if isinstance(card.value, fits.card.Undefined) else header_value(card.value)
        except fits.VerifyError:
            messages.append(f"header card {card.keyword} breaks the FITS standard and is left out")
            continue
        if value is not None and values.setdefault(card.keyword, value) != value:
            repeated[card.keyword] = value
    return values
