"""Observables between their ECSV file, the archive's rows, and a table with units again; no column is lost.

The runs of a night share their header, and reading it (YAML) takes longer than all else: it is read once for all of them.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable, Table

from opnav_workbench.errors import SessionError

__all__ = ["ObservableColumn", "observables_of", "read_observables"]

HEADERS = 16  # kept: as many versions of the program as one is likely to meet at once
NO_TEXT = "-"


@dataclass(frozen=True, slots=True)
class ObservableColumn:
    """A column of an observables file: its name, unit and description; `unit` None for text."""

    name: str
    unit: str | None
    description: str


def read_observables(path: Path) -> tuple[tuple[ObservableColumn, ...], list[dict[str, Any]]]:
    """Read an observables file as its columns and one mapping a row; unknown numbers are None.

    Raises
    ------
    SessionError
        The file is no ECSV table of observables.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        head = list(takewhile(lambda line: line.startswith("#"), lines))
        body = lines[len(head) :]
        columns, delimiter = _header("\n".join([*head, body[0]]))
        rows = list(csv.reader(body[1:], delimiter=delimiter, strict=True))
        convert = [_text if column.unit is None else _number for column in columns]
        cells = [_cells(columns, convert, row) for row in rows]
        assert all(isinstance(cell[name], str) for cell in cells for name in ("body", "method"))
    except Exception as error:  # a damaged file leads astropy's reader to whatever it may
        raise SessionError(f"{path.name} is damaged ({error!r:.120}); process the picture again") from error
    return columns, cells


@lru_cache(maxsize=HEADERS)
def _header(text: str) -> tuple[tuple[ObservableColumn, ...], str]:
    table = Table.read(text, format="ascii.ecsv")
    return tuple(_column(table, name) for name in table.colnames), "," if "delimiter: ','" in text else " "


def _column(table: Table, name: str) -> ObservableColumn:
    column = table[name]
    text = column.dtype.kind in "US"
    unit = None if text else ("" if column.unit is None else column.unit.to_string())
    return ObservableColumn(name, unit, column.info.description or "")


def _cells(
    columns: Sequence[ObservableColumn], convert: Sequence[Callable[[str], Any]], row: Sequence[str]
) -> dict[str, Any]:
    return {column.name: read(value) for column, read, value in zip(columns, convert, row, strict=True)}


def _text(value: str) -> str:
    return value or NO_TEXT


def _number(value: str) -> float | None:
    number = float(value or "nan")
    return number if np.isfinite(number) else None


def observables_of(columns: Sequence[ObservableColumn], cells: Sequence[Mapping[str, Any]]) -> QTable:
    """Return rows as the table that `opnav_workbench.observables.observables_table` makes."""
    table = QTable()
    for column in columns:
        values = [cell.get(column.name) for cell in cells]
        if column.unit is None:
            table[column.name] = np.array([NO_TEXT if v is None else str(v) for v in values], dtype=str)
        else:
            numbers = np.array([np.nan if v is None else v for v in values], dtype=float)
            table[column.name] = u.Quantity(numbers, u.Unit(column.unit))
        table[column.name].info.description = column.description
    return table
