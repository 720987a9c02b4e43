"""Observables in files, written and read back: ECSV, CSV, JSON; and from a ``result.json`` alone.

ECSV   an astropy table with units and descriptions; an empty text is written as "-", which ECSV could not tell from a
       masked value
CSV    a header of comments that says what each column is, then plain comma-separated values. Comment lines begin with
       ``#`` (pandas: ``read_csv(file, comment="#")``); numbers read back to the bit; an empty cell is an unknown value
JSON   one object each, arrays as lists, null for what is not known, and the fields explained
result.json   what it holds of observables, for when the table beside it is lost: no partials but those of the position, no
       sky covariances

Files are written whole or not at all.
"""

import csv
import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.files import given_cell, plain_cell, text_of, write_json, write_text
from opnav_workbench.files import read_json as json_mapping
from opnav_workbench.format_versions import FORMAT_KEY, as_of_today
from opnav_workbench.observables.columns import (
    ALWAYS_ARRAYS,
    COLUMNS,
    FIELDS,
    ExportColumn,
    row_of,
    rows_to_observables,
)
from opnav_workbench.observables.ecsv_writer import ecsv_of
from opnav_workbench.observables.explanation import Origin, explanation, explanation_lines, origins_of_table
from opnav_workbench.observables.observable import Observable

if TYPE_CHECKING:
    from astropy.table import QTable

__all__ = [
    "csv_text",
    "ecsv_text",
    "observables_dict",
    "observables_of_result",
    "observables_table",
    "read_csv",
    "read_ecsv",
    "read_json",
    "read_result",
    "read_with_origins",
    "table_observables",
    "write_csv",
    "write_ecsv",
    "write_observables_json",
]


# ---- Observables as an astropy table with units and descriptions, and as an ECSV file.

ECSV_NO_TEXT = "-"  # ECSV cannot tell an empty text from a masked value


def observables_table(observables: Sequence[Observable], origins: Sequence[Origin] = ()) -> "QTable":
    """Return observables as a table: one row each, every column with description and, for numbers, unit.

    Unknown numbers are nan. An empty text is written as "-": ECSV cannot tell it from a masked value. The table's metadata
    say what a stranger must know of it (`explanation`), with the `origins` of the observables.

    Examples
    --------
    >>> observables_table([]).colnames[:4]
    ['image', 'utc', 'et', 'body']
    """
    from astropy import units as u  # noqa: PLC0415 (with tables a fifth of a short command; few need one)
    from astropy.table import QTable  # noqa: PLC0415

    rows, table = [row_of(o) for o in observables], QTable()
    for column in COLUMNS:
        values = [row[column.name] for row in rows]
        if column.unit is None:
            table[column.name] = np.array([text or ECSV_NO_TEXT for text in values], dtype=str)
        else:
            table[column.name] = u.Quantity(np.array(values, dtype=float), u.Unit(column.unit))
        table[column.name].info.description = column.description
    table.meta.update(_encodable(explanation(origins)))
    return table


def table_observables(table: "QTable", source: str = "table") -> tuple[Observable, ...]:
    """Return the observables of a table as `observables_table` makes it.

    Parameters
    ----------
    source
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
    try:
        factors = [(column, _ecsv_factor(table, column)) for column in known]
        rows = [{c.name: _ecsv_cell(row[c.name], c.unit, factor) for c, factor in factors} for row in table]
    except (ValueError, TypeError) as error:  # another unit, a text for a number
        raise SessionError(f"{source}: {error}. Export the observables again.") from error
    return rows_to_observables(rows, source)


def _ecsv_factor(table: "QTable", column: ExportColumn) -> float:
    """Return what makes a column's numbers those of our unit."""
    from astropy import units as u  # noqa: PLC0415 (as in `observables_table`)

    unit = getattr(table[column.name], "unit", None)
    if column.unit is None or unit is None:
        return 1.0
    return float(unit.to(u.Unit(column.unit)))


def _ecsv_cell(value: Any, unit: str | None, factor: float) -> Any:
    if unit is not None:
        return float(getattr(value, "value", value)) * factor  # of a quantity, or plain
    return "" if str(value) == ECSV_NO_TEXT else str(value)


def write_ecsv(observables: Sequence[Observable], path: str | Path, origins: Sequence[Origin] = ()) -> None:
    """Write what `observables_table` holds as ECSV, whole or not at all."""
    write_text(path, ecsv_text(observables, origins))


def ecsv_text(observables: Sequence[Observable], origins: Sequence[Origin] = ()) -> str:
    """Return `observables_table` as ECSV text.

    Examples
    --------
    >>> ecsv_text([]).splitlines()[0]
    '# %ECSV 1.0'
    """
    rows = (
        {name: ECSV_NO_TEXT if value == "" else value for name, value in row_of(observable).items()}
        for observable in observables
    )
    return ecsv_of(COLUMNS, rows, _encodable(explanation(origins)))


def _encodable(value: Any) -> Any:
    """Return plain values whose texts are UTF-8: names of files may have other bytes."""
    if isinstance(value, dict):
        return {_encodable(key): _encodable(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_encodable(item) for item in value]
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def read_ecsv(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_ecsv` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    return table_observables(_read_table(path), str(path))


def _read_table(path: str | Path) -> "QTable":
    from astropy.table import QTable  # noqa: PLC0415 (a tenth of a short command; few need a table)

    try:
        lines = text_of(path).splitlines()
        with warnings.catch_warnings():  # of units and kinds of columns: what is needed is checked below
            warnings.simplefilter("ignore")
            table = QTable.read(lines, format="ascii.ecsv")
    except Exception as error:  # astropy raises whatever a bad header leads it to
        reason = " ".join(str(error).split())
        raise SessionError(
            f"no observables can be read from {path}: {reason}. Give an ECSV file of observables."
        ) from error
    if FORMAT_KEY in table.meta:  # tables of version 0 said nothing of themselves
        as_of_today("observables", table.meta, str(path), SessionError)
    return table


# ---- Observables as CSV.


def csv_text(observables: Sequence[Observable], origins: Sequence[Origin] = ()) -> str:
    """Return observables as CSV text.

    Examples
    --------
    >>> print(csv_text([]).splitlines()[0])
    # Optical navigation observables of opnav_workbench
    """
    stream = io.StringIO()
    stream.write("# Optical navigation observables of opnav_workbench\n")
    stream.writelines(f"# {' '.join(line.split())}\n" for line in explanation_lines(origins))
    stream.writelines(f"# {_column_comment(column)}\n" for column in COLUMNS)
    writer = csv.DictWriter(stream, [column.name for column in COLUMNS], lineterminator="\n")
    writer.writeheader()
    for observable in observables:
        writer.writerow({name: _csv_cell(value) for name, value in row_of(observable).items()})
    return stream.getvalue()


def _column_comment(column: ExportColumn) -> str:
    unit = "text" if column.unit is None else column.unit or "1"
    return f"{column.name} [{unit}] {column.description}"


def _csv_cell(value: Any) -> str:
    if isinstance(value, str):
        return plain_cell(" ".join(value.split()))  # one line a row
    return "" if np.isnan(value) else repr(float(value))


def write_csv(observables: Sequence[Observable], path: str | Path, origins: Sequence[Origin] = ()) -> None:
    """Write observables as CSV, whole or not at all."""
    write_text(path, csv_text(observables, origins))


def read_csv(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_csv` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    try:
        text = text_of(path)
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
        given = [{name: given_cell(cell) for name, cell in row.items()} for row in rows]
        return rows_to_observables(given, str(path))
    except csv.Error as error:
        raise SessionError(f"{path} is damaged ({error}); export the observables again.") from error


# ---- Observables as JSON.

JSON_FORMAT = "opnav_workbench observables"
FIELD_TYPES = get_type_hints(Observable)
FIELD_SHAPES = {field.name: field.shape for field in FIELDS}


def observables_dict(observables: Sequence[Observable], origins: Sequence[Origin] = ()) -> dict[str, Any]:
    """Return observables as plain values with a header that explains them.

    Examples
    --------
    >>> observables_dict([])["fields"]["observed_px"]["unit"]
    'pix'
    """
    return {
        "format": JSON_FORMAT,
        **explanation(origins),
        "fields": {
            field.name: {
                "unit": field.unit,
                "shape": list(field.shape),
                "description": field.description,
            }
            for field in FIELDS
        },
        "observables": [{f.name: getattr(o, f.name) for f in fields(Observable)} for o in observables],
    }


def write_observables_json(
    observables: Sequence[Observable], path: str | Path, origins: Sequence[Origin] = ()
) -> None:
    """Write observables as JSON, whole or not at all."""
    write_json(path, observables_dict(observables, origins))


def read_json(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_observables_json` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    return _observables_in(_read_content(path), path)


def _read_content(path: str | Path) -> dict[str, Any]:
    data = json_mapping(path, "give a JSON file of observables.")
    if data.get("format") != JSON_FORMAT:
        raise SessionError(f"{path} holds no observables; give a file that opnav export --format json wrote.")
    return as_of_today("observables", data, str(path), SessionError)


def _observables_in(data: Mapping[str, Any], path: str | Path) -> tuple[Observable, ...]:
    try:
        return tuple(Observable(**_json_values(item)) for item in data["observables"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{path} is damaged ({error!r}); export the observables again.") from error


def _json_values(item: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an observable; a field that a later version added is let be, as `format_version` promises."""
    return {name: _json_value(name, value) for name, value in item.items() if name in FIELD_TYPES}


def _json_value(name: str, value: Any) -> Any:
    if name == "messages":
        return tuple(value)
    if name == "center_cross_px2":
        return {other: np.array(cross, float) for other, cross in value.items()}
    if FIELD_TYPES[name] is float:
        return np.nan if value is None else float(value)
    return (
        _json_array(name, value)
        if FloatArray in (FIELD_TYPES[name], *getattr(FIELD_TYPES[name], "__args__", ()))
        else value
    )


def _json_array(name: str, value: Any) -> Any:
    if value is None:
        return np.full(FIELD_SHAPES[name], np.nan) if name in ALWAYS_ARRAYS else None
    return np.array(value, dtype=np.float64).reshape(FIELD_SHAPES[name])


# ---- Observables and how they came about.


def read_with_origins(path: str | Path) -> tuple[tuple[Observable, ...], tuple[Origin, ...]]:
    """Read observables, and how they came about as the file tells it; empty where it does not, as in every CSV.

    Parameters
    ----------
    path
        Read as ECSV or JSON if it ends so, else as CSV.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    ending = Path(path).suffix
    if ending == ".ecsv":
        table = _read_table(path)
        observables, told = table_observables(table, str(path)), table.meta
    elif ending == ".json":
        told = _read_content(path)
        observables = _observables_in(told, path)
    else:
        return read_csv(path), ()
    return observables, origins_of_table(told, dict.fromkeys(o.image for o in observables))


# ---- Observables from a ``result.json`` alone: what it holds of them, when the table beside it is lost.

RESULT_NUMBERS = (
    "diameter_px",
    "measured_diameter_px",
    "diameter_sigma_px",
    "range_km",
    "measured_range_km",
    "range_sigma_km",
    "ra_deg",
    "dec_deg",
    "apparent_ra_deg",
    "apparent_dec_deg",
    "snr",
)


def read_result(path: str | Path) -> dict[str, Any]:
    """Read a ``result.json``.

    Raises
    ------
    SessionError
        The file cannot be read, or is no result.
    """
    data = json_mapping(path, "give a result of opnav process.")
    if "bodies" not in data or "pointing" not in data:
        raise SessionError(f"{path} is no result of opnav process (no bodies or pointing in it).")
    return as_of_today("result", data, str(path), SessionError)


def observables_of_result(result: Mapping[str, Any], source: str = "result.json") -> tuple[Observable, ...]:
    """Return the observables of a result; what it does not hold (other partials, sky covariances) is unknown.

    Parameters
    ----------
    result
        The content of ``result.json``.
    source
        For messages.

    Raises
    ------
    SessionError
        The result is damaged.

    Examples
    --------
    >>> observables_of_result({"bodies": [], "pointing": None})
    ()
    """
    try:
        return tuple(_observable_of_body(result, body) for body in result["bodies"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{source} is damaged ({error!r}); process the picture again.") from error


def _observable_of_body(result: Mapping[str, Any], body: Mapping[str, Any]) -> Observable:
    unknown = np.full((2, 2), np.nan)
    observed = _result_array(body["observed"], (2,))
    predicted = _result_array(body["predicted"], (2,))
    residual = None if observed is None or predicted is None else observed - predicted
    place = np.full(2, np.nan)
    covariance = _result_array(body["covariance_px2"], (2, 2))
    numbers: dict[str, Any] = {name: _result_number(body.get(name)) for name in RESULT_NUMBERS}
    total = _result_array(body.get("covariance_with_pointing_px2"), (2, 2))
    return Observable(
        image=str(result["image"]),
        utc=str(result["utc"]),
        et=float(result["et"]),
        name=str(body["name"]),
        method=str(body["method"]),
        status=str(body["status"]),
        reference_body=str(body.get("reference_body", "")),
        a_priori_px=place if (a_priori := _result_array(body["a_priori"], (2,))) is None else a_priori,
        predicted_px=place if predicted is None else predicted,
        observed_px=observed,
        residual_px=residual,
        covariance_px2=unknown if covariance is None else covariance,
        total_covariance_px2=unknown if total is None else total,
        partials_px_per_km=_result_array(body.get("partials_px_per_km"), (2, 3)),
        partials_px_per_rad=None,
        residual_arcsec=_result_array(body.get("residual_arcsec"), (2,)),
        messages=tuple(body.get("messages") or ()),
        center_cross_px2={n: np.array(c, float) for n, c in (body.get("joint_covariance_px2") or {}).items()},
        attitude_covariance_rad2=_result_array((result["pointing"] or {}).get("covariance_rad2"), (3, 3)),
        **numbers,
    )


def _result_number(value: Any) -> float:
    return np.nan if value is None else float(value)


def _result_array(value: Any, shape: tuple[int, ...]) -> FloatArray | None:
    """None and null elements are unknown; an array of nothing else is none."""
    if value is None:
        return None
    array = np.array(value, dtype=np.float64).reshape(shape)
    return None if np.isnan(array).all() else array
