"""Paths that others name, asked about without surprise: too long, with a NUL, links in a circle, pipes, devices.

What cannot be a path is no file: the caller's own message tells it, as for any other that is not there. (`pathlib` asks so
itself from Python 3.14 on.)
"""

import os
import stat
from pathlib import Path

__all__ = ["exists", "is_file", "is_folder", "is_text", "regular_size"]


def is_file(path: str | os.PathLike[str]) -> bool:
    r"""Tell whether a file stands there.

    Examples
    --------
    >>> is_file("a" * 5000), is_file("a\0b")
    (False, False)
    """
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Tell whether a folder stands there."""
    return os.path.isdir(path)  # noqa: PTH112


def exists(path: str | os.PathLike[str]) -> bool:
    """Tell whether anything stands there."""
    return os.path.exists(path)  # noqa: PTH110


def is_text(path: str | os.PathLike[str]) -> bool:
    r"""Tell whether a path can be written down: all its bytes are UTF-8.

    Examples
    --------
    >>> is_text("run/\u00e9"), is_text("run/\udc97")
    (True, False)
    """
    return not any("\ud800" <= letter <= "\udfff" for letter in os.fspath(path))


def regular_size(path: str | os.PathLike[str]) -> int:
    """Return the bytes of a file that can be read to its end.

    Raises
    ------
    OSError
        There is none, or it is a folder, a pipe, which would block, or a device, which may never end.
    """
    try:
        status = Path(path).stat()
    except ValueError as error:
        raise FileNotFoundError(2, "a name with a NUL", str(path)) from error
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(21, "it is a folder, no file", str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(22, "it is a pipe or device, no file", str(path))
    return status.st_size
