"""Observables as CSV: a header of comments that says what each column is, then plain comma-separated values.

Comment lines begin with ``#`` (pandas: ``read_csv(file, comment="#")``). Numbers are written so that they read back to the
bit; an empty cell is an unknown value.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_text
from opnav_workbench.observables.columns import COLUMNS, Column
from opnav_workbench.observables.observable import Observable
from opnav_workbench.observables.rows import row_of, rows_to_observables

__all__ = ["CONVENTIONS", "csv_text", "read_csv", "write_csv"]

CONVENTIONS = (
    "pixel is horizontal, line vertical; both 0-based, an integer is a pixel's center",
    "observed minus computed; computed with the solved pointing, center of figure",
    "vectors and directions: J2000 as in SPICE (ICRF axes); times: TDB seconds past J2000, and UTC",
    "ra, dec: stellar aberration removed, light time not: from the spacecraft to where the light left the body",
    "apparent_ra, apparent_dec: as seen, stellar aberration not removed",
    "partials: bodies are held fixed among each other, so those of any body are of its own place",
)


def csv_text(observables: Sequence[Observable]) -> str:
    """Return observables as CSV text.

    Examples
    --------
    >>> print(csv_text([]).splitlines()[0])
    # Optical navigation observables of opnav_workbench
    """
    stream = io.StringIO()
    stream.write("# Optical navigation observables of opnav_workbench\n")
    stream.writelines(f"# {line}\n" for line in CONVENTIONS)
    stream.writelines(f"# {_about(column)}\n" for column in COLUMNS)
    writer = csv.DictWriter(stream, [column.name for column in COLUMNS], lineterminator="\n")
    writer.writeheader()
    for observable in observables:
        writer.writerow({name: _cell(value) for name, value in row_of(observable).items()})
    return stream.getvalue()


def _about(column: Column) -> str:
    unit = "text" if column.unit is None else column.unit.to_string() or "1"
    return f"{column.name} [{unit}] {column.description}"


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return " ".join(value.split())  # one line a row
    return "" if np.isnan(value) else repr(float(value))


def write_csv(observables: Sequence[Observable], path: str | Path) -> None:
    """Write observables as CSV, whole or not at all."""
    write_text(path, csv_text(observables))


def read_csv(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_csv` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SessionError(
            f"no observables can be read from {path}: {error}. Give a CSV file of observables."
        ) from error
    lines = text.splitlines()
    start = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    rows = csv.DictReader(lines[start:], restkey="", strict=True)
    if rows.fieldnames is None or "pixel_c" not in rows.fieldnames:
        raise SessionError(f"{path} is no table of observables; give a CSV file that opnav export wrote.")
    try:
        return rows_to_observables(list(rows), str(path))
    except csv.Error as error:
        raise SessionError(f"{path} is damaged ({error}); export the observables again.") from error
