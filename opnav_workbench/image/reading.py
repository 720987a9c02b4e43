"""From a file to a `Frame`: which format, which planes, which time; every failure is one `ImageError` line.

Flow    bytes -> FITS, VICAR or PDS3 reader -> `Source` -> masks, time, pointing -> `Frame`
"""

import gzip
import hashlib
import os
import warnings
import zlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from opnav_workbench.image.assembly import frame_from_source
from opnav_workbench.image.fits import is_fits, read_fits
from opnav_workbench.image.frame import Frame
from opnav_workbench.image.keywords import KeywordMap
from opnav_workbench.image.pds import image_pointer, is_pds3, parse_label, read_raw
from opnav_workbench.image.source import Source, image_error
from opnav_workbench.image.vicar_file import is_vicar, read_vicar

__all__ = ["read_image"]

GZIP_START = b"\x1f\x8b"
SHOWN_BYTES = 24


def read_image(
    path: str | os.PathLike[str], keywords: KeywordMap, *, saturation_dn: float | None = None
) -> Frame:
    """Read a picture, told by content: FITS (also gzipped), VICAR, PDS3 with attached or detached label.

    Parameters
    ----------
    path : path-like
        Image file, or its detached PDS3 label.
    keywords : KeywordMap
        Which header keywords hold time, exposure and pointing.
    saturation_dn : float, optional
        Pixels at or above this value count as saturated.

    Returns
    -------
    Frame

    Raises
    ------
    ImageError
        One line with the file's name, what is wrong and what to do: missing, empty, truncated or damaged
        file, unknown format, no picture, a cube, no usable pixel, another mission's frame, no time, bad
        exposure.

    Notes
    -----
    Warnings of the libraries below do not escape; they end in ``Frame.messages``.
    """
    file = Path(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = _bytes_of(file)
        pixels, source = _read(file, data, keywords)
        digest = hashlib.sha256(data if pixels == file else pixels.read_bytes()).hexdigest()
        frame = frame_from_source(pixels, digest, source, keywords, saturation_dn)
    return replace(frame, messages=(*frame.messages, *_remarks(caught)))


def _bytes_of(file: Path) -> bytes:
    if file.is_dir():
        raise image_error(str(file), "is a folder; give an image file in it.")
    try:
        data = file.read_bytes()
    except FileNotFoundError as error:
        raise image_error(str(file), "no such file; check the name and the folder.") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise image_error(str(file), f"cannot be read: {reason}; check the permissions.") from error
    if not data:
        raise image_error(str(file), "is empty (0 bytes); copy or download it again.")
    return data


def _read(file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, Source]:
    """Return the file that holds the pixels, and its planes."""
    if is_pds3(data):
        return _read_pds(file, data, keywords)
    return file, _read_pixels(file, data, keywords)


def _read_pixels(file: Path, data: bytes, keywords: KeywordMap) -> Source:
    plain = _unzipped(file.name, data) if data.startswith(GZIP_START) else data
    if is_fits(plain):
        return read_fits(file.name, plain, keywords)
    if is_vicar(data):
        return read_vicar(file.name, file, data)
    raise image_error(
        file.name,
        f"is not a FITS, VICAR or PDS3 file: it begins with {plain[:SHOWN_BYTES]!r}; give an image file.",
    )


def _read_pds(label_file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, Source]:
    label = parse_label(data)
    pointer = image_pointer(label_file.name, label)
    if pointer.file is None:
        return label_file, read_raw(label_file.name, data, pointer.offset_bytes, label)
    pixels = _beside(label_file, pointer.file)
    content = _bytes_of(pixels)
    if is_fits(content) or is_vicar(content) or content.startswith(GZIP_START):
        source = _read_pixels(pixels, content, keywords)
        return pixels, replace(source, header=label.values | source.header)
    return pixels, read_raw(pixels.name, content, pointer.offset_bytes, label)


def _beside(label_file: Path, name: str) -> Path:
    """Return the file that a label names, in any case: labels are in capitals, archives often not."""
    for candidate in sorted(label_file.parent.iterdir()):
        if candidate.name.lower() == name.lower():
            return candidate
    raise image_error(
        label_file.name, f"the label names {name}, which is not beside it; put both into one folder."
    )


def _unzipped(name: str, data: bytes) -> bytes:
    try:
        return gzip.decompress(data)
    except (EOFError, OSError, zlib.error) as error:
        raise image_error(name, f"damaged gzip file ({error}); copy or download it again.") from error


def _remarks(caught: Iterable[warnings.WarningMessage]) -> tuple[str, ...]:
    texts = (" ".join(str(warning.message).split()) for warning in caught)
    return tuple(dict.fromkeys(f"remark while reading: {text}" for text in texts))
