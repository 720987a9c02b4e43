"""VICAR pictures through the `vicar` library; the length is checked first, so that a short file is named so.

Source: Deen (1992), "The VICAR File Format", JPL.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opnav_workbench.image.frame import HeaderValue
from opnav_workbench.image.source import Source, image_error, plain, truncated

__all__ = ["is_vicar", "read_vicar"]

LABEL_SIZE = re.compile(rb"LBLSIZE=\s*(\d+)")


def is_vicar(data: bytes) -> bool:
    """Tell from the first bytes whether this is a VICAR file."""
    return LABEL_SIZE.match(data) is not None


def read_vicar(name: str, path: Path, data: bytes) -> Source:
    """Read the picture and label of a VICAR file; `data` are the file's bytes.

    Raises
    ------
    ImageError
        The file is truncated or malformed.
    """
    # It brings the clients of cloud stores along, half a second that other formats shall not wait for.
    import vicar  # noqa: PLC0415

    _check_length(name, data)
    try:
        picture: Any = vicar.VicarImage.from_file(path, strict=False)
        return Source(picture.array, _header(picture.as_dict()))
    except Exception as error:  # the library lets its parser's own errors through
        raise image_error(name, f"damaged VICAR file ({error}); copy or download it again.") from error


def _check_length(name: str, data: bytes) -> None:
    match = LABEL_SIZE.match(data)
    label_size = int(match[1]) if match else 0
    label = data[:label_size]
    if len(label) < label_size:
        raise truncated(name, "the VICAR label", len(label), label_size)
    records = _number(label, b"NLB") + _number(label, b"NL") * max(_number(label, b"NB"), 1)
    needed = records * _number(label, b"RECSIZE")
    if len(data) - label_size < needed:
        raise truncated(name, "the VICAR data section", len(data) - label_size, needed)


def _number(label: bytes, item: bytes) -> int:
    match = re.search(rb"\b" + item + rb"=\s*(\d+)", label)
    return int(match[1]) if match else 0


def _header(label: Mapping[Any, Any]) -> dict[str, HeaderValue]:
    """Return label items by name; of repeated ones, which the library numbers, the first."""
    values: dict[str, HeaderValue] = {}
    for key, item in label.items():
        value = plain(item)
        if value is not None:
            values.setdefault(key if isinstance(key, str) else key[0], value)
    return values
