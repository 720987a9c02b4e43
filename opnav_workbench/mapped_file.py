"""Files of arrays that are mapped into memory, each with a header that says what it holds and whether it is whole.

Layout of the header: 8 bytes that name the kind of file, length and CRC-32 of what follows (two little-endian u4), JSON.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["header_bytes", "mapped_array", "read_header"]

PREFIX = struct.Struct("<8sII")


def header_bytes(magic: bytes, header: Mapping[str, Any], room: int) -> bytes:
    """Return a header as it stands at the start of a file.

    Raises
    ------
    OSError
        It is longer than `room`.
    """
    text = json.dumps(header, allow_nan=False).encode()
    if len(text) > room - PREFIX.size:
        raise OSError(f"header of {len(text)} bytes is larger than {room}")
    return PREFIX.pack(magic, len(text), zlib.crc32(text)) + text


def read_header(start: bytes, magic: bytes) -> dict[str, Any] | None:
    """Return the header that a file's first bytes hold, else None.

    Examples
    --------
    >>> start = header_bytes(b"OPNAVTST", {"n": 3}, room=64)
    >>> read_header(start, b"OPNAVTST"), read_header(start[:-1], b"OPNAVTST"), read_header(start, b"OPNAVOLD")
    ({'n': 3}, None, None)
    """
    if len(start) < PREFIX.size:
        return None
    found, length, crc = PREFIX.unpack_from(start)
    text = start[PREFIX.size : PREFIX.size + length]
    return json.loads(text) if found == magic and zlib.crc32(text) == crc else None


def mapped_array(path: Path, dtype: DTypeLike, place: int, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array that begins at byte `place` of a file, read as it is used.

    Raises
    ------
    OSError, ValueError
        The file is too short.
    """
    # A plain view: every element of a memmap object would cost a microsecond more.
    return np.memmap(path, dtype, mode="r", offset=place, shape=shape).view(np.ndarray)
