"""Arrays in one memory-mapped file, whole or not there.

Layout: the header (`mapped_file`, padded to `HEADER_BYTES`), then the arrays, each from a multiple of `ALIGNMENT` on.
The header says what the file was made from (`identity`), and of each array name, type, shape, place and CRC-32. What
fails a check is not there, and is made anew; it is written under another name and renamed.
"""

import contextlib
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.mapped_file import header_bytes, mapped_array, read_header

__all__ = ["read_arrays", "write_arrays"]

MAGIC = b"OPNAVIDX"
HEADER_BYTES, ALIGNMENT = 4096, 64


def write_arrays(path: Path, identity: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Write arrays; False where the folder cannot be written: they are made again by the next process."""
    table: dict[str, Any] = {}
    place = HEADER_BYTES
    for name, array in arrays.items():
        data = np.ascontiguousarray(array)
        crc = zlib.crc32(data.data) if data.size else 0
        table[name] = {"type": data.dtype.str, "shape": list(data.shape), "place": place, "crc": crc}
        place += -(-data.nbytes // ALIGNMENT) * ALIGNMENT
    header = {"identity": identity, "size": place, "arrays": table}
    with contextlib.suppress(SessionError):
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            stream.write(header_bytes(MAGIC, header, HEADER_BYTES))
            for name, array in arrays.items():
                stream.seek(table[name]["place"])
                stream.write(np.ascontiguousarray(array).data)
            stream.truncate(place)
        return True
    return False


def read_arrays(path: Path, identity: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of a whole file of this identity, memory-mapped, else None."""
    try:
        with path.open("rb") as stream:
            header = read_header(stream.read(HEADER_BYTES), MAGIC)
        if header is None or header["identity"] != dict(identity) or path.stat().st_size != header["size"]:
            return None
        arrays = {name: _mapped(path, told) for name, told in header["arrays"].items()}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    whole = all(_crc(arrays[name]) == told["crc"] for name, told in header["arrays"].items())
    return arrays if whole else None


def _mapped(path: Path, told: Mapping[str, Any]) -> NDArray[Any]:
    shape = tuple(int(n) for n in told["shape"])
    if 0 in shape:
        return np.empty(shape, np.dtype(told["type"]))
    return mapped_array(path, told["type"], int(told["place"]), shape)


def _crc(array: NDArray[Any]) -> int:
    return zlib.crc32(array.data) if array.size else 0
