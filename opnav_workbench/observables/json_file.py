"""Observables as JSON: one object each, arrays as lists, null for what is not known, and the fields explained."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_json
from opnav_workbench.observables.columns import FIELDS
from opnav_workbench.observables.observable import Observable
from opnav_workbench.observables.rows import ALWAYS
from opnav_workbench.observables.text import CONVENTIONS

__all__ = ["observables_dict", "read_json", "write_observables_json"]

FORMAT, SCHEMA = "opnav_workbench observables", 1
KINDS = get_type_hints(Observable)
SHAPES = {field.name: field.shape for field in FIELDS}


def observables_dict(observables: Sequence[Observable]) -> dict[str, Any]:
    """Return observables as plain values with a header that explains them.

    Examples
    --------
    >>> observables_dict([])["fields"]["observed_px"]["unit"]
    'pix'
    """
    return {
        "format": FORMAT,
        "schema": SCHEMA,
        "conventions": list(CONVENTIONS),
        "fields": {
            field.name: {
                "unit": None if field.unit is None else field.unit.to_string(),
                "shape": list(field.shape),
                "description": field.description,
            }
            for field in FIELDS
        },
        "observables": [{f.name: getattr(o, f.name) for f in fields(Observable)} for o in observables],
    }


def write_observables_json(observables: Sequence[Observable], path: str | Path) -> None:
    """Write observables as JSON, whole or not at all."""
    write_json(path, observables_dict(observables))


def read_json(path: str | Path) -> tuple[Observable, ...]:
    """Read observables that `write_observables_json` wrote.

    Raises
    ------
    SessionError
        The file cannot be read, or holds something else.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SessionError(
            f"no observables can be read from {path}: {error}. Give a JSON file of observables."
        ) from error
    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("schema") != SCHEMA:
        raise SessionError(
            f"{path} holds no observables of schema {SCHEMA}; give a file that opnav export --format json wrote."
        )
    try:
        return tuple(Observable(**_values(item)) for item in data["observables"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{path} is damaged ({error!r}); export the observables again.") from error


def _values(item: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _value(name, value) for name, value in item.items()}


def _value(name: str, value: Any) -> Any:
    if name == "messages":
        return tuple(value)
    if name == "center_cross_px2":
        return {other: np.array(cross, float) for other, cross in value.items()}
    if KINDS[name] is float:
        return np.nan if value is None else float(value)
    return (
        _array(name, value) if FloatArray in (KINDS[name], *getattr(KINDS[name], "__args__", ())) else value
    )


def _array(name: str, value: Any) -> Any:
    if value is None:
        return np.full(SHAPES[name], np.nan) if name in ALWAYS else None
    return np.array(value, dtype=np.float64).reshape(SHAPES[name])
