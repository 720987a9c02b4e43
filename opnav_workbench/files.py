"""Files: written whole or not at all, and never outside the folder they belong to."""

import codecs
import contextlib
import hashlib
import json
import math
import os
import secrets
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.paths import exists, is_file, is_folder, regular_size

__all__ = [
    "atomic_path",
    "decoded",
    "digest",
    "files_named",
    "fitting_name",
    "given_cell",
    "inside",
    "is_utf16",
    "json_text",
    "json_value",
    "make_folder",
    "plain_cell",
    "plain_values",
    "read_json",
    "sha256_of",
    "text_of",
    "write_json",
    "write_text",
]

HASH_CHUNK_BYTES = 1 << 20
LONGEST_NAME_BYTES, NAME_DIGITS = 255, 8  # of a file or folder; of a digest in a name that was cut
LONGEST_WHOLE = 40  # digits; twice those of a 64-bit number
LARGEST_TEXT_BYTES = 256 << 20  # a result with a hundred thousand stars has 60 MB


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str], mode: int = 0o666) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it over `path` when the block ends well.

    Parameters
    ----------
    path
        The file to be.
    mode
        Who may read and write it, from its first moment on, as far as the umask lets them.

    Raises
    ------
    SessionError
        The folder cannot be written (read-only, disk full), or a device has that name; what stood there stays as it was.
    """
    final = Path(path)
    temporary: Path | None = None
    if exists(final) and not is_file(final) and not is_folder(final):
        raise SessionError(f"cannot write {final}: it is a pipe or device, no file; give a file's name.")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        name = final.with_name(f".{final.stem}-{secrets.token_hex(4)}{final.suffix}")
        os.close(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))
        temporary = name
        yield temporary
        temporary.replace(final)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SessionError(
            f"cannot write {final}: {reason}. Free some space or choose another folder; "
            "an older file of that name is unchanged."
        ) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder that files can be written into, and return it.

    Raises
    ------
    SessionError
        It cannot be made, or not written into.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        reason = error.strerror or str(error)
        raise SessionError(f"cannot write into {folder}: {reason}. Choose another folder.") from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` as UTF-8, whole or not at all; bytes of a file's name that are no UTF-8 as JSON escapes them."""
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="backslashreplace") as stream,
    ):
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())


def json_text(data: Mapping[str, Any]) -> str:
    """Return `data` as JSON; arrays become lists and every non-finite number becomes null.

    Examples
    --------
    >>> print(json_text({"sigma": float("nan"), "center": np.array([1.0, 2.0])}))
    {
      "sigma": null,
      "center": [
        1.0,
        2.0
      ]
    }
    """
    return json.dumps(plain_values(data), indent=2, allow_nan=False, ensure_ascii=False)


def write_json(path: str | os.PathLike[str], data: Mapping[str, Any]) -> None:
    """Write `data` as JSON (see `json_text`), whole or not at all."""
    write_text(path, json_text(data) + "\n")


FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r")  # with these a spreadsheet begins to calculate


def plain_cell(text: str) -> str:
    """Return a text for a CSV cell, led by an apostrophe where a spreadsheet would take it for a formula.

    Examples
    --------
    >>> plain_cell("=1+1.fit"), plain_cell("-98"), plain_cell("lor_1.fit")
    ("'=1+1.fit", '-98', 'lor_1.fit')
    """
    formula = text.startswith(FORMULA_SIGNS) and not _is_number(text)
    return f"'{text}" if formula or text.startswith("'") else text


def given_cell(cell: Any) -> Any:
    """Return what `plain_cell` was given."""
    return cell[1:] if isinstance(cell, str) and cell.startswith("'") else cell


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_json(path: str | os.PathLike[str], advice: str) -> dict[str, Any]:
    """Return the mapping that a JSON file holds; NaN and Infinity, which JSON does not know, become None.

    Raises
    ------
    SessionError
        The file is missing or damaged, or holds something else: what is wrong with it, then `advice`.
    """
    try:
        data = json_value(text_of(path))
    except (OSError, ValueError) as error:
        raise SessionError(f"{path} cannot be read ({error}); {advice}") from error
    if not isinstance(data, dict):
        raise SessionError(f"{path} cannot be read (it holds no mapping); {advice}")
    return data


def text_of(path: str | os.PathLike[str]) -> str:
    """Return the text of a file that others may have written.

    Raises
    ------
    OSError
        It cannot be read, is no regular file (a pipe would block, a device never end), or larger than
        `LARGEST_TEXT_BYTES`.
    UnicodeDecodeError
        It is no UTF-8.
    """
    size = regular_size(path)
    if size > LARGEST_TEXT_BYTES:
        raise OSError(f"{size} bytes, more than {LARGEST_TEXT_BYTES}")
    return Path(path).read_text(encoding="utf-8")


def is_utf16(data: bytes) -> bool:
    """Tell by the mark at the beginning of a text whether it is in UTF-16."""
    return data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


def decoded(data: bytes, errors: str = "strict") -> str:
    """Return a text that editors may have put a mark before, which is none of its words: UTF-16, or UTF-8.

    Examples
    --------
    >>> decoded("a".encode("utf-8-sig")), decoded("a".encode("utf-16"))
    ('a', 'a')
    """
    return data.decode("utf-16" if is_utf16(data) else "utf-8-sig", errors=errors)


def json_value(text: str | bytes) -> Any:
    """Return what JSON of others stands for; NaN, Infinity and 1e400, which no double holds, are None.

    Raises
    ------
    ValueError
        It is no JSON, nested too deep, or has a whole number of more than `LONGEST_WHOLE` digits.

    Examples
    --------
    >>> json_value('{"sigma": NaN, "center": [1, 2.5]}')
    {'sigma': None, 'center': [1, 2.5]}
    """
    try:
        return json.loads(text, parse_constant=lambda _: None, parse_int=_whole, parse_float=_finite)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def _whole(digits: str) -> int:
    if len(digits) > LONGEST_WHOLE:  # no double, no count
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _finite(number: str) -> float | None:
    value = float(number)
    return value if math.isfinite(value) else None


def plain_values(value: Any) -> Any:
    """Return data as JSON can hold it: arrays become lists, every non-finite number None."""
    if isinstance(value, Mapping):
        return {str(k): plain_values(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple | set | frozenset):
        items = value.tolist() if isinstance(value, np.ndarray) else value
        return (
            [plain_values(v) for v in items]
            if not isinstance(items, float | int | str)
            else plain_values(items)
        )
    if isinstance(value, np.generic):
        return plain_values(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    summed = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while chunk := stream.read(HASH_CHUNK_BYTES):
            summed.update(chunk)
    return summed.hexdigest()


def digest(values: Any) -> str:
    """Return the SHA-256 of plain values, whatever the order of their keys, as hexadecimal digits."""
    text = json.dumps(plain_values(values), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def files_named(top: str | os.PathLike[str], *names: str) -> list[Path]:
    """Return the files of these names at or below a folder, sorted; hidden folders below it are somebody's own."""
    base = Path(top)
    found = (path for name in names for path in base.rglob(name) if path.is_file())
    return sorted(
        p for p in found if not any(part.startswith(".") for part in p.relative_to(base).parts[:-1])
    )


def fitting_name(name: str, ending: str = "") -> str:
    """Return a name with an ending, cut where a file system takes none of so many bytes; a digest keeps it one of its own.

    Examples
    --------
    >>> fitting_name("lor_1", "-carried"), fitting_name("x" * 250, "-carried")[-20:]
    ('lor_1-carried', 'xxx-086d4a1c-carried')
    """
    encoded, room = os.fsencode(name), LONGEST_NAME_BYTES - len(os.fsencode(ending))
    if len(encoded) <= room:
        return name + ending
    mark = f"-{hashlib.sha256(encoded).hexdigest()[:NAME_DIGITS]}"
    return encoded[: room - len(mark)].decode("utf-8", errors="ignore") + mark + ending


def inside(folder: str | os.PathLike[str], name: str) -> Path:
    """Return `folder`/`name`, refusing a name that would leave the folder.

    Raises
    ------
    SessionError
        `name` is absolute, climbs out of `folder`, or cannot be followed: symbolic links in a circle.
    """
    try:
        base = Path(folder).resolve()
        path = (base / name).resolve()
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            path.stat()  # since Python 3.13 `resolve` leaves links in a circle as they are
    except (OSError, RuntimeError, ValueError) as error:
        raise SessionError(
            f"{name!r} in {folder} cannot be followed: {error}; choose another folder."
        ) from error
    if not path.is_relative_to(base):
        raise SessionError(f"{name!r} points outside {base}; give a path inside that folder.")
    return path
