"""States of a scenario's trajectories as they are given: rows of the file, or a CSV file beside it."""

import csv
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import AU_KM, DAY_S
from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.files import inside
from opnav_workbench.kernels.making.scenario import StateTable
from opnav_workbench.kernels.time import et_from_jd, et_from_tdb_datetime, et_from_utc_datetime

__all__ = ["read_states", "table_states"]

COMMENT = "#"
BODY_COLUMN = "body"
EPOCH_COLUMNS = ("tdb", "utc", "jd_tdb", "et_s")
POSITION_UNITS = {"km": 1.0, "au": AU_KM}
VELOCITY_UNITS = {"km_s": 1.0, "au_d": AU_KM / DAY_S}
LEAST_ROWS = 2


def table_states(table: StateTable) -> tuple[FloatArray, FloatArray]:
    """Return epochs (n,) and states (n, 6) of the rows in a scenario; UTC needs an active `KernelSet`."""
    to_et = et_from_tdb_datetime if table.time_scale == "TDB" else et_from_utc_datetime
    return np.array([to_et(row[0]) for row in table.rows]), np.array([row[1:] for row in table.rows])


def read_states(folder: Path, name: str, bodies: frozenset[str]) -> tuple[FloatArray, FloatArray]:
    """Read states from a CSV file.

    The first row names the columns: one epoch (``tdb`` or ``utc``, ISO calendar; ``jd_tdb``; ``et_s``), positions
    ``x_km y_km z_km`` or ``x_au y_au z_au``, velocities ``vx_km_s ...`` or ``vx_au_d ...``. A column ``body``
    tells the bodies of a common file apart; other columns are left alone. Lines that begin with ``#`` are
    comments.

    Parameters
    ----------
    folder
        Of the scenario; the file must be in it, or deeper.
    name
        The file.
    bodies
        What the body may be called in the column ``body``.

    Returns
    -------
    et : (n,) float array
    states : (n, 6) float array
        km, km/s.

    Raises
    ------
    MissionError
        The file is missing, outside the folder, or no such table; states are not in order. The message names
        the line.
    """
    try:
        path = inside(folder, name)
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"{name} cannot be read: {error}; put it beside the scenario") from error
    except SessionError as error:
        raise MissionError(str(error).rstrip(".")) from error
    et: list[float] = []
    states: list[list[float]] = []
    for where, row in _rows(name, lines):
        if BODY_COLUMN in row and row[BODY_COLUMN].strip().upper() not in bodies:
            continue
        try:
            epoch, state = _epoch(row), _state(row)
        except (ValueError, ArithmeticError) as error:
            raise MissionError(f"{where}: {error}") from error
        if not np.isfinite([epoch, *state]).all():
            raise MissionError(f"{where}: a number is not finite")
        if et and epoch <= et[-1]:
            raise MissionError(f"{where}: the epoch is not after that of the state before; sort the rows")
        et.append(epoch)
        states.append(state)
    if len(et) < LEAST_ROWS:
        raise MissionError(
            f"{name}: {len(et)} states of {' or '.join(sorted(bodies))}; two are needed at least"
        )
    return np.array(et), np.array(states)


def _rows(name: str, lines: list[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the place and the fields of every row of data, once the columns are known to be right."""
    kept = [
        (i, line) for i, line in enumerate(lines, start=1) if line.strip() and not line.startswith(COMMENT)
    ]
    columns = [c.strip().lower() for c in next(csv.reader([kept[0][1]]))] if kept else []
    epochs = [c for c in columns if c in EPOCH_COLUMNS]
    if (
        len(epochs) != 1
        or _units(columns, "", POSITION_UNITS) is None
        or _units(columns, "v", VELOCITY_UNITS) is None
    ):
        raise MissionError(
            f"{name}: columns are {', '.join(columns) or 'none'}; needed are one of {', '.join(EPOCH_COLUMNS)}, "
            "x_km y_km z_km (or x_au ...) and vx_km_s vy_km_s vz_km_s (or vx_au_d ...)"
        )
    for number, line in kept[1:]:
        fields = next(csv.reader([line]))
        if len(fields) != len(columns):
            raise MissionError(f"{name} line {number}: {len(fields)} fields, {len(columns)} columns")
        yield f"{name} line {number}", dict(zip(columns, fields, strict=True))


def _units(columns: Mapping[str, str] | list[str], prefix: str, units: Mapping[str, float]) -> str | None:
    return next((u for u in units if all(f"{prefix}{axis}_{u}" in columns for axis in "xyz")), None)


def _epoch(row: Mapping[str, str]) -> float:
    kind = next(c for c in EPOCH_COLUMNS if c in row)
    text = row[kind].strip()
    if kind == "jd_tdb":
        return et_from_jd(text)
    if kind == "et_s":
        return float(text)
    moment = datetime.fromisoformat(text)
    if kind == "tdb":
        if moment.tzinfo is not None:
            raise ValueError(f"{text}: a TDB epoch has no time zone")
        return et_from_tdb_datetime(moment)
    return et_from_utc_datetime(
        moment if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)
    )


def _state(row: Mapping[str, str]) -> list[float]:
    values = []
    for prefix, units in (("", POSITION_UNITS), ("v", VELOCITY_UNITS)):
        unit = _units(row, prefix, units)
        assert unit is not None  # `_rows` has looked
        values += [float(row[f"{prefix}{axis}_{unit}"]) * units[unit] for axis in "xyz"]
    return values
