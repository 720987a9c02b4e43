"""Picture files of any format: FITS (also gzipped), VICAR and PDS3, told by their content and read into one form.

Flow    bytes -> which format -> length checked -> `StoredPicture`: arrays as stored, header values, remarks

Every plane is checked for its full length before it is read, so that a file that ends too early is named as such; every
failure is one `ImageError` line with the file's name.

FITS     image, error and quality planes, which the mission's keywords name; data are big-endian. Source: FITS Standard 4.0.
PDS3     the raw pictures that labels describe: the IMAGE object and its sample types. Source: PDS Standards Reference 3.8.
VICAR    through the `vicar` library, imported on first use (it brings the clients of cloud stores along, half a second).
         Source: Deen (1992), "The VICAR File Format", JPL.
"""

import contextlib
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from astropy.io import fits
from astropy.io.fits.card import Undefined
from numpy.typing import NDArray

from opnav_workbench.fits_layout import FITS_MALFORMED, FitsLayoutError, check_fits_layout
from opnav_workbench.image.file_bytes import (
    GZIP_START,
    check_size,
    file_bytes,
    image_error,
    truncated_error,
    unpacked,
)
from opnav_workbench.image.header import HeaderValue, KeywordMap, header_number
from opnav_workbench.image.pds_label import (
    PdsLabel,
    image_pointer,
    is_pds3,
    label_integer,
    parse_pds_label,
)
from opnav_workbench.supervised import TrialError, tried

__all__ = ["StoredPicture", "read_stored"]


# ---- What every reader hands over: planes and header of one file, before masks and time are made of them.


@dataclass(frozen=True, slots=True, eq=False)
class StoredPicture:
    """Arrays of one file as stored (image, error, quality), header values, and remarks."""

    image: NDArray[Any]
    header: dict[str, HeaderValue]
    error: NDArray[Any] | None = None
    quality: NDArray[Any] | None = None
    messages: tuple[str, ...] = ()


def header_value(value: Any) -> HeaderValue | None:
    """Return a header value as a plain Python value; lists become text, what has no value becomes None."""
    if isinstance(value, np.generic):
        return header_value(value.item())
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(str(v) for v in value)
    return None if value is None else str(value)


# ---- FITS pictures: image, error and quality planes, each checked for its full length before it is read.

Extension: TypeAlias = str | int
FITS_BLOCK_BYTES = 2880  # the last block of a file may be short
FITS_COMMENTARY = frozenset({"", "COMMENT", "HISTORY", "END", "CONTINUE"})


def is_fits(data: bytes) -> bool:
    """Tell from the first bytes whether this is a FITS file."""
    return data.startswith(b"SIMPLE  =")


def read_fits(name: str, data: bytes, keywords: KeywordMap) -> StoredPicture:
    """Read the planes that `keywords` names from the bytes of a FITS file.

    Raises
    ------
    ImageError
        The file is truncated or malformed, or has no picture.
    """
    try:
        with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
            for index, hdu in enumerate(hdus):
                _check_fits_length(name, len(data), hdu, index)
            return _fits_planes(name, hdus, keywords)
    except FITS_MALFORMED as error:
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
    picture = _picture_extension(name, hdus, keywords.image_extension)
    messages: list[str] = []
    header = _fits_header(hdus[0].header, messages)
    if picture:
        header |= _fits_header(hdus[picture].header, messages)
    planes: dict[str, Any] = {}
    for what, wanted in (("error", keywords.error_extension), ("quality", keywords.quality_extension)):
        index = None if wanted is None else _find_extension(hdus, wanted)
        planes[what] = None if index is None else hdus[index].data
        if wanted is not None and planes[what] is None:
            messages.append(
                f"no {what} plane: FITS extension {wanted!r} is not an image of {_extension_names(hdus)}"
            )
    return StoredPicture(hdus[picture].data, header, **planes, messages=tuple(messages))


def _picture_extension(name: str, hdus: Any, wanted: Extension | None) -> int:
    """Return the index of the picture: the one named, else the first extension with lines and pixels."""
    if wanted is not None:
        index = _find_extension(hdus, wanted)
        if index is None:
            raise image_error(
                name, f"no picture in a FITS extension {wanted!r}; there are {_extension_names(hdus)}."
            )
        return index
    for index, hdu in enumerate(hdus):
        if hdu.is_image and len(hdu.shape) >= 2:
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


def _fits_header(header: Any, messages: list[str]) -> dict[str, HeaderValue]:
    """Return a FITS header as plain values, without comments and undefined cards; of equals the first."""
    values: dict[str, HeaderValue] = {}
    for card in header.cards:
        if card.keyword in FITS_COMMENTARY:
            continue
        try:
            value = None if isinstance(card.value, Undefined) else header_value(card.value)
        except fits.VerifyError:
            messages.append(f"header card {card.keyword} breaks the FITS standard and is left out")
            continue
        if value is not None:
            values.setdefault(card.keyword, value)
    return values


# ---- The raw pictures that PDS3 labels describe.

PDS_BYTE_ORDERS = {"MSB": ">", "SUN": ">", "MAC": ">", "LSB": "<", "PC": "<", "VAX": "<"}
PDS_SAMPLE_TYPE = re.compile(
    r"(?:(?P<maker>MSB|SUN|MAC|LSB|PC|VAX|IEEE)_)?(?P<unsigned>UNSIGNED_)?(?P<kind>INTEGER|REAL|FLOAT)"
)


def read_pds_raw(name: str, data: bytes, offset: int, label: PdsLabel) -> StoredPicture:
    """Read an uncompressed raw picture.

    Raises
    ------
    ImageError
        The label lacks what is needed, describes a cube or a type that is not read, or the file is truncated.
    """
    image = label.image
    lines, samples = (label_integer(name, image, key, least=1) for key in ("LINES", "LINE_SAMPLES"))
    if (bands := label_integer(name, image, "BANDS", 1)) != 1:
        raise image_error(name, f"holds a cube of {bands} bands, not one picture; save one band alone.")
    check_size(name, lines * samples)
    dtype = _sample_type(name, image)
    prefix, suffix = (
        label_integer(name, image, key, 0) for key in ("LINE_PREFIX_BYTES", "LINE_SUFFIX_BYTES")
    )
    width = prefix + samples * dtype.itemsize + suffix
    present = max(len(data) - offset, 0)
    if present < lines * width:
        raise truncated_error(name, "the image", present, lines * width)
    rows = np.frombuffer(data, np.uint8, lines * width, offset).reshape(lines, width)
    pixels = np.ascontiguousarray(rows[:, prefix : width - suffix]).view(dtype).astype(np.float64)
    scale, zero = header_number(image.get("SCALING_FACTOR", 1.0)), header_number(image.get("OFFSET", 0.0))
    if scale is None or zero is None:
        raise image_error(name, "PDS3 label whose SCALING_FACTOR or OFFSET is no number; check the label.")
    return StoredPicture(pixels * scale + zero, dict(label.values))


def _sample_type(name: str, image: dict[str, HeaderValue]) -> np.dtype[Any]:
    text, bits = str(image.get("SAMPLE_TYPE", "")).upper(), label_integer(name, image, "SAMPLE_BITS")
    match = PDS_SAMPLE_TYPE.fullmatch(text)
    real = match is not None and match["kind"] != "INTEGER"
    readable = bits in ((32, 64) if real else (8, 16, 32))
    if match is None or not readable or (real and match["maker"] == "VAX"):
        raise image_error(
            name, f"PDS3 image of SAMPLE_TYPE {text!r} with {bits} bits is not read; convert it to FITS."
        )
    letter = "f" if real else "u" if match["unsigned"] else "i"
    return np.dtype(f"{PDS_BYTE_ORDERS.get(match['maker'], '>')}{letter}{bits // 8}")


# ---- VICAR pictures through the `vicar` library.

VICAR_LABEL_SIZE = re.compile(rb"LBLSIZE=\s*(\d+)")
VICAR_LABEL_LIMIT_BYTES = 1 << 17  # labels with their history have some 10 kB, and the parser takes its time
VICAR_LATER_LABEL = re.compile(
    rb"LBLSIZE *= *(\d+)"
)  # an end-of-file label; pixels that read so do not exist
MOST_DIGITS = 12  # of any size that a label states


def is_vicar(data: bytes) -> bool:
    """Tell from the first bytes whether this is a VICAR file."""
    return VICAR_LABEL_SIZE.match(data) is not None


def read_vicar(name: str, path: Path, data: bytes) -> StoredPicture:
    """Read the picture and label of a VICAR file; `data` are the file's bytes.

    Raises
    ------
    ImageError
        The file is truncated or malformed.
    """
    # It brings the clients of cloud stores along, half a second that other formats shall not wait for.
    import vicar  # noqa: PLC0415

    _check_vicar_length(name, data)
    try:
        picture: Any = vicar.VicarImage.from_file(path, strict=False)
        header = _vicar_header(picture.as_dict())
    except Exception as error:  # the library lets its parser's own errors through
        raise image_error(name, f"damaged VICAR file ({error}); copy or download it again.") from error
    if picture.array is None:
        raise image_error(name, "damaged VICAR file (no lines, by its label); copy or download it again.")
    return StoredPicture(picture.array, header)


def _check_vicar_length(name: str, data: bytes) -> None:
    match = VICAR_LABEL_SIZE.match(data)
    label_size = 0 if match is None else _vicar_size(name, "LBLSIZE", match[1])
    sizes = (_vicar_size(name, "LBLSIZE", m[1]) for m in VICAR_LATER_LABEL.finditer(data))
    if max(sizes, default=label_size) > VICAR_LABEL_LIMIT_BYTES:
        raise image_error(
            name, f"has a VICAR label of more than {VICAR_LABEL_LIMIT_BYTES} bytes; shorten its history."
        )
    label = data[:label_size]
    if len(label) < label_size:
        raise truncated_error(name, "the VICAR label", len(label), label_size)
    header, lines, bands, length, samples = (
        _label_number(name, label, item) for item in ("NLB", "NL", "NB", "RECSIZE", "NS")
    )
    check_size(name, lines * samples * max(bands, 1))
    needed = (header + lines * max(bands, 1)) * length
    if len(data) - label_size < needed:
        raise truncated_error(name, "the VICAR data section", len(data) - label_size, needed)


def _vicar_size(name: str, item: str, digits: bytes) -> int:
    if len(digits) > MOST_DIGITS:
        raise image_error(
            name, f"VICAR label with {item} of {len(digits)} digits; copy or download it again."
        )
    return int(digits)


def _label_number(name: str, label: bytes, item: str) -> int:
    match = re.search(rb"\b" + item.encode() + rb"=\s*(\d+)", label)
    return _vicar_size(name, item, match[1]) if match else 0


def _vicar_header(label: Mapping[Any, Any]) -> dict[str, HeaderValue]:
    """Return label items by name; of repeated ones, which the library numbers, the first."""
    values: dict[str, HeaderValue] = {}
    for key, item in label.items():
        value = header_value(item)
        if value is not None:
            values.setdefault(key if isinstance(key, str) else key[0], value)
    return values


# ---- From a file to a `Picture`.

SHOWN_BYTES = 24


def read_stored(file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    """Return the file that holds the pixels, and its planes."""
    if is_pds3(data):
        return _read_pds(file, data, keywords)
    return file, _read_pixels(file, data, keywords)


def _read_pixels(file: Path, data: bytes, keywords: KeywordMap) -> StoredPicture:
    plain = unpacked(file.name, data) if data.startswith(GZIP_START) else data
    if is_fits(plain):
        if has_compressed_images(file.name, plain):
            _try_decompressing(file)
        return read_fits(file.name, plain, keywords)
    if is_vicar(data):
        return read_vicar(file.name, file, data)
    raise image_error(
        file.name,
        f"is not a FITS, VICAR or PDS3 file: it begins with {plain[:SHOWN_BYTES]!r}; give an image file.",
    )


def _read_pds(label_file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    label = parse_pds_label(data)
    pointer = image_pointer(label_file.name, label)
    if pointer.file is None:
        return label_file, read_pds_raw(label_file.name, data, pointer.offset_bytes, label)
    pixels = _file_of_label(label_file, pointer.file)
    content = file_bytes(pixels)
    if is_fits(content) or is_vicar(content) or content.startswith(GZIP_START):
        source = _read_pixels(pixels, content, keywords)
        return pixels, replace(source, header=label.values | source.header)
    return pixels, read_pds_raw(pixels.name, content, pointer.offset_bytes, label)


def _file_of_label(label_file: Path, name: str) -> Path:
    """Return the file that a label names, in any case: labels are in capitals, archives often not."""
    with contextlib.suppress(OSError):  # a folder that cannot be listed
        for candidate in sorted(label_file.parent.iterdir()):
            if candidate.name.lower() == name.lower():
                return candidate
    raise image_error(
        label_file.name, f"the label names {name}, which is not beside it; put both into one folder."
    )
