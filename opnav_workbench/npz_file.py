"""Npz files that others wrote: whole, of arrays alone, and no larger unpacked than was meant; else one word why not."""

import tokenize
import zipfile
import zlib
from collections.abc import Collection
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.paths import regular_size

__all__ = ["NpzDamage", "read_npz"]

SINGLE_ARRAY = b"\x93NUMPY"
LARGEST_BYTES = 1 << 32  # thirty million stars with all columns
# What zipfile, zlib and numpy's reader raise on damage; the last where a header claims more than memory.
DAMAGE = (ValueError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, OverflowError, LookupError, TypeError,
          SyntaxError, tokenize.TokenError, MemoryError)  # fmt: skip


class NpzDamage(ValueError):  # noqa: N818  what it is; readers make an error of their own of it
    """A file is no whole npz file of arrays; the text says why."""


def read_npz(
    path: str | PathLike[str], known: Collection[str] | None = None, largest_bytes: int = LARGEST_BYTES
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz file by name.

    Parameters
    ----------
    known
        Others are left unread; None: none is.
    largest_bytes
        Of all that it unpacks to.

    Raises
    ------
    NpzDamage
        It is none, holds Python objects, is damaged, or unpacks to too much.
    OSError
        There is no such file, or it cannot be read: a folder, a pipe, a device.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(Path(folder) / "a.npz", mag=[1.0, 2.0], other=[0])
    ...     read_npz(Path(folder) / "a.npz", {"mag"})
    {'mag': array([1., 2.])}
    """
    regular_size(path)
    with Path(path).open("rb") as stream:  # numpy leaves a file open that turns out to be no archive
        _check_archive(stream, largest_bytes)
        try:
            with np.load(stream, allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files if known is None or name in known}
        except ValueError as error:
            if "allow_pickle" in str(error):
                raise NpzDamage(
                    "it holds Python objects; store numbers, and text as numpy strings"
                ) from error
            raise NpzDamage(f"it is damaged ({error})") from error
        except DAMAGE as error:
            raise NpzDamage(f"it is damaged ({type(error).__name__}: {error})") from error


def _check_archive(stream: BinaryIO, largest_bytes: int) -> None:
    """Refuse early what numpy would take for something else, a pickle too."""
    if stream.read(len(SINGLE_ARRAY)) == SINGLE_ARRAY:
        raise NpzDamage("it holds a single array, not an npz archive")
    try:
        with zipfile.ZipFile(stream) as archive:
            size = sum(member.file_size for member in archive.infolist())
    except DAMAGE as error:
        raise NpzDamage("it is not a whole npz file") from error
    if size > largest_bytes:
        raise NpzDamage(f"it unpacks to {size} bytes, more than {largest_bytes}")
    stream.seek(0)
