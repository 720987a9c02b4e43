"""An observable as one row of plain values, and back.

An unknown number is nan, and an array that is not there is nan throughout.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.observables.columns import FIELDS, Column, Field
from opnav_workbench.observables.observable import Observable

__all__ = ["ALWAYS", "row_of", "rows_to_observables"]

# Without these there is no observable; any other column may be missing from a file.
NEEDED = ("image", "et", "body", "status", "pixel_c", "line_c")
# Arrays that are always there, with nan where nothing is known; the others are None then.
ALWAYS = frozenset({"a_priori_px", "predicted_px", "covariance_px2", "total_covariance_px2"})


def row_of(observable: Observable) -> dict[str, Any]:
    """Return an observable as column name to text or float (nan where nothing is known)."""
    row: dict[str, Any] = {}
    for field in FIELDS:
        value = _plain(field, getattr(observable, field.name))
        for column in field.columns:
            row[column.name] = value if column.unit is None else _element(column, value)
    return row


def _plain(field: Field, value: Any) -> Any:
    if field.name == "messages":
        return "; ".join(message.replace("; ", ", ") for message in value)
    if field.name == "center_cross_px2":
        return json.dumps({name: cross.tolist() for name, cross in value.items()}) if value else ""
    return value


def _element(column: Column, value: Any) -> float:
    number = np.nan if value is None else float(np.asarray(value, float)[column.index])
    return float(np.sqrt(number)) if column.sigma else number


def rows_to_observables(rows: Iterable[Mapping[str, Any]], source: str) -> tuple[Observable, ...]:
    """Return the observables of rows as `row_of` makes them.

    Parameters
    ----------
    rows : iterable of mapping
    source : str
        The file, for messages.

    Raises
    ------
    SessionError
        A column that an observable needs is missing, or a value is not of its kind.
    """
    made = []
    for number, row in enumerate(rows):
        missing = [name for name in NEEDED if name not in row]
        if missing:
            raise SessionError(
                f"{source} holds no observables: it has no column {', '.join(missing)}. Give a file that "
                "opnav process or opnav export wrote."
            )
        try:
            made.append(Observable(**{field.name: _value(field, row) for field in FIELDS}))
        except (ValueError, TypeError, IndexError) as error:
            raise SessionError(f"{source}, row {number}: {error}. Export the observables again.") from error
    return tuple(made)


def _value(field: Field, row: Mapping[str, Any]) -> Any:
    if field.unit is None:
        return _from_text(field, str(row.get(field.columns[0].name, "") or ""))
    numbers = [_number_in(row, column) for column in field.columns]
    if not field.shape:
        return numbers[0]
    if all(np.isnan(numbers)) and field.name not in ALWAYS:
        return None
    array = np.full(field.shape, np.nan)
    for column, number in zip(field.columns, numbers, strict=True):
        array[column.index] = number**2 if column.sigma else number
        if len(field.columns) < array.size:  # a covariance: what is below the diagonal is not written
            array[column.index[::-1]] = array[column.index]
    return array


def _number_in(row: Mapping[str, Any], column: Column) -> float:
    value = row.get(column.name, np.nan)
    if value is None or value == "":
        return np.nan
    return float(value)


def _from_text(field: Field, text: str) -> Any:
    if field.name == "messages":
        return tuple(text.split("; ")) if text else ()
    if field.name == "center_cross_px2":
        return {name: np.array(cross) for name, cross in json.loads(text).items()} if text else {}
    return text
