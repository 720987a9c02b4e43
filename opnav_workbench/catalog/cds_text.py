"""Text catalogs with fixed columns, as the CDS distributes them: rows of one length, blanks where nothing is known.

Files are plain or .gz, lines end with LF or CRLF; they are read in portions. Columns are counted from 0, the last
one excluded.
"""

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.errors import CatalogError
from opnav_workbench.paths import exists, is_folder

__all__ = ["TextRows", "read_rows", "source_files"]

ROWS_AT_ONCE = 100_000  # 20 MB of Tycho-2


class TextRows:
    """Rows of one length; columns are asked for by their bytes, counted from 0, the last one excluded."""

    __slots__ = ("_rows",)

    def __init__(self, rows: NDArray[np.uint8]) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def numbers(self, first: int, last: int) -> FloatArray:
        """Return the numbers (n,) of a column, nan where it is blank.

        Raises
        ------
        ValueError
            A field holds something else than a number.
        """
        return np.where(self.blank(first, last), b"nan", self.text(first, last)).astype(np.float64)

    def integers(self, first: int, last: int) -> NDArray[np.int64]:
        """Return the integers (n,) of a column, 0 where it is blank."""
        return np.where(self.blank(first, last), b"0", self.text(first, last)).astype(np.int64)

    def text(self, first: int, last: int) -> NDArray[np.bytes_]:
        """Return the characters (n,) of a column."""
        field: NDArray[Any] = np.ascontiguousarray(self._rows[:, first:last])
        return field.view(f"S{last - first}").ravel()

    def blank(self, first: int, last: int) -> BoolArray:
        """Return where a column has blanks only (n,)."""
        return np.asarray(np.all(self._rows[:, first:last] == ord(" "), axis=1))


def read_rows(path: Path, characters: int, remedy: str) -> Iterator[tuple[TextRows, float]]:
    """Yield the rows of a text file, plain or .gz, in portions, with the fraction of the file read so far.

    Parameters
    ----------
    path
        The file.
    characters
        Length of a row without its line end, which is LF or CRLF (told from the first row).
    remedy
        What to do about a bad file, for the error message.

    Raises
    ------
    CatalogError
        The file is missing, its compression ends early, or it is not made of such rows.
    """
    length, rest = 0, b""
    try:
        size = path.stat().st_size
        with path.open("rb") as raw:
            stream: Any = gzip.open(raw) if path.suffix == ".gz" else raw  # noqa: SIM115 - raw is closed
            while content := stream.read(ROWS_AT_ONCE * (characters + 2)):
                content, length = rest + content, length or _row_length(path, content, characters, remedy)
                whole = len(content) // length * length
                rest = content[whole:]
                yield (
                    TextRows(_checked_rows(path, content[:whole], length, characters, remedy)),
                    raw.tell() / size,
                )
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise CatalogError(f"{path} ends within its compressed data ({error}); {remedy}") from error
    except OSError as error:
        raise CatalogError(f"cannot read {path}: {error.strerror or error}; {remedy}") from error
    if not length:
        raise CatalogError(f"{path} is empty; {remedy}")
    rest = rest.rstrip(b"\r\n\x1a")  # the last row may lack its line end; ^Z ended files of early tools
    if rest:
        if len(rest) != characters:
            raise CatalogError(f"{path} ends within a row ({len(rest)} of {characters} characters); {remedy}")
        yield TextRows(np.frombuffer(rest, dtype=np.uint8)[None, :]), 1.0


def _row_length(path: Path, content: bytes, characters: int, remedy: str) -> int:
    end = content.find(b"\n")
    first = content[:end].removesuffix(b"\r") if end >= 0 else content
    if len(first) != characters:
        raise CatalogError(f"{path} has a first row of {len(first)} characters, not {characters}; {remedy}")
    return end + 1 if end >= 0 else len(content)


def _checked_rows(path: Path, content: bytes, length: int, characters: int, remedy: str) -> NDArray[np.uint8]:
    rows = np.frombuffer(content, dtype=np.uint8).reshape(-1, length)
    bad = np.any(rows[:, :characters] == ord("\n"), axis=1) | (rows[:, -1] != ord("\n"))
    if length > characters and np.any(bad):
        raise CatalogError(
            f"{path}: row {int(np.argmax(bad)) + 1} of a portion is not {characters} characters long; {remedy}"
        )
    return rows


def source_files(folder: Path, names: list[str], what: str, remedy: str) -> list[Path]:
    """Return those of the named files that stand in a folder, each plain or else as .gz.

    Raises
    ------
    CatalogError
        The folder is missing, is none, is empty, or holds none of the files.
    """
    if not exists(folder):
        raise CatalogError(f"the folder {folder} does not exist; {remedy}")
    if not is_folder(folder):
        raise CatalogError(f"{folder} is a file, not the folder of {what}; {remedy}")
    present = {entry.name.lower(): entry for entry in folder.iterdir()}
    found = [present.get(name, present.get(f"{name}.gz")) for name in names]
    files = [file for file in found if file is not None]
    if not files:
        state = "is empty" if not present else f"holds none of the files of {what}"
        raise CatalogError(f"the folder {folder} {state}; {remedy}")
    return files
