"""FITS pictures: image, error and quality planes, each checked for its full length before it is read.

Source: FITS Standard 4.0. The data of a FITS file are big-endian; what leaves here is native float64.
"""

import io
from typing import Any, TypeAlias

import numpy as np
from astropy.io import fits
from astropy.io.fits.card import Undefined
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.image.frame import HeaderValue
from opnav_workbench.image.keywords import KeywordMap
from opnav_workbench.image.source import Source, image_error, plain, single_plane, truncated

__all__ = ["is_fits", "read_fits"]

Extension: TypeAlias = str | int
COMMENTARY = frozenset({"", "COMMENT", "HISTORY", "END", "CONTINUE"})
# What astropy raises on files that break the standard.
MALFORMED = (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, MemoryError, fits.VerifyError)


def is_fits(data: bytes) -> bool:
    """Tell from the first bytes whether this is a FITS file."""
    return data.startswith(b"SIMPLE  =")


def read_fits(name: str, data: bytes, keywords: KeywordMap) -> Source:
    """Read the planes that `keywords` names from the bytes of a FITS file.

    Raises
    ------
    ImageError
        The file is truncated or malformed, or has no picture or a plane of another size than the picture.
    """
    try:
        with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
            return _read_planes(name, data, hdus, keywords)
    except MALFORMED as error:
        if len(data) % BLOCK:
            ...
        raise image_error(name, f"damaged FITS file ({error}); copy or download it again.") from error


def _read_planes(name: str, data: bytes, hdus: Any, keywords: KeywordMap) -> Source:
    picture = _picture(name, hdus, keywords.image_extension)
    image = single_plane(name, _values(name, data, hdus[picture], "the image"))
    header = _header(hdus[0].header) | _header(hdus[picture].header)
    messages: list[str] = []
    planes = {}
    for what, wanted in (("error", keywords.error_extension), ("quality", keywords.quality_extension)):
        planes[what] = _plane(name, data, hdus, wanted, what, image.shape, messages)
    quality = planes["quality"]
    return Source(image, header, planes["error"], None if quality is None else _whole(quality), tuple(messages))
