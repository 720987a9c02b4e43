"""Observables as an astropy table with units and descriptions, and as an ECSV file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.observables.columns import COLUMNS
from opnav_workbench.observables.observable import Observable
from opnav_workbench.observables.rows import row_of, rows_to_observables

__all__ = ["observables_table", "read_ecsv", "table_observables", "write_ecsv"]

NO_TEXT = "-"  # ECSV cannot tell an empty text from a masked value


def observables_table(observables: Sequence[Observable]) -> QTable:
    """Return observables as a table: one row each, every column with description and, for numbers, unit.

    Unknown numbers are nan. An empty text is written as "-": ECSV cannot tell it from a masked value.

    Examples
    --------
    >>> observables_table([]).colnames[:4]
    ['image', 'utc', 'et', 'body']
    """
    rows, table = [row_of(o) for o in observables], QTable()
    for column in COLUMNS:
        values = [row[column.name] for row in rows]
        if column.unit is None:
            table[column.name] = np.array([text or NO_TEXT for text in values], dtype=str)
        else:
            table[column.name] = u.Quantity(np.array(values, dtype=float), column.unit)
        table[column.name].info.description = column.description
    return table


def table_observables(table: QTable, source: str = "table") -> tuple[Observable, ...]:
    """Return the observables of a table as `observables_table` makes it.

    Parameters
    ----------
    table : QTable
    source : str
        Its file, for messages.

    Raises
    ------
    SessionError
        See `rows_to_observables`.

    Examples
    --------
    >>> table_observables(observables_table([]))
    ()
    """
    known = [column for column in COLUMNS if column.name in table.colnames]
    rows = ({column.name: _cell(row[column.name], column.unit) for column in known} for row in table)
    return rows_to_observables(rows, source)


def _cell(value: Any, unit: Any) -> Any:
    if unit is not None:
        return float(value.to_value(unit)) if isinstance(value, u.Quantity) else float(value)
    return "" if str(value) == NO_TEXT else str(value)


def write_ecsv(observables: Sequence[Observable], path: str | Path) -> None:
    """Write `observables_table` as ECSV, whole or not at all."""
    with atomic_path(path) as temporary:
        observables_table(observables).write(temporary, format="ascii.ecsv", overwrite=True)


def read_ecsv(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_ecsv` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    try:
        table = QTable.read(path, format="ascii.ecsv")
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
    ) as error:  # what astropy raises of a bad header
        reason = " ".join(str(error).split())
        raise SessionError(
            f"no observables can be read from {path}: {reason}. Give an ECSV file of observables."
        ) from error
    return table_observables(table, str(path))
