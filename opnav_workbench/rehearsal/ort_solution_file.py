"""The file of a rehearsal's solution, checked field by field: a team may write it with programs of its own."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation.parameters import parse_groups, size_of

__all__ = ["checked_numbers", "read_solution_file"]

# Shapes of arrays; n: number of parameters.
SHAPES: dict[str, tuple[int | str, ...]] = {
    "correction": ("n",),
    "sigma_before": ("n",),
    "covariance": ("n", "n"),
    "b_plane_before": (3,),
    "b_plane_after": (3,),
    "b_plane_covariance_before": (3, 3),
    "b_plane_covariance": (3, 3),
}
COVARIANCES = ("covariance", "b_plane_covariance")
NUMBERS = ("chi2_before", "chi2_after", "probability")
TEXTS = ("words", "left_out", "messages")
OPTIONAL = ("residuals", "pictures", "made_by", *TEXTS)


def checked_numbers(content: Any, what: str, name: str = "") -> None:
    """Refuse a number that is not finite, anywhere in nested values.

    Raises
    ------
    SessionError
        It is named.

    Examples
    --------
    >>> checked_numbers({"sigma": [1.0, float("nan")]}, "solution.json")
    Traceback (most recent call last):
    ...
    opnav_workbench.errors.SessionError: solution.json: sigma is nan; a solution holds finite numbers only.
    """
    if isinstance(content, Mapping):
        for key, value in content.items():
            checked_numbers(value, what, str(key))
    elif isinstance(content, np.ndarray):
        checked_numbers(content.tolist(), what, name)
    elif isinstance(content, list | tuple):
        for value in content:
            checked_numbers(value, what, name)
    elif isinstance(content, float) and not math.isfinite(content):
        raise SessionError(f"{what}: {name} is {content}; a solution holds finite numbers only.")


def read_solution_file(path: str | Path, schema: str) -> dict[str, Any]:
    """Return the fields of a solution file.

    Raises
    ------
    SessionError
        It cannot be read, is of another schema, lacks a field, or holds numbers that cannot be meant.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SessionError(f"no solution can be read from {path}: {error}. Run opnav ort solve.") from error
    if not isinstance(content, dict) or content.pop("schema", None) != schema:
        raise SessionError(f"{path} is no solution of a rehearsal (schema {schema}).")
    checked_numbers(content, str(path))
    try:
        fields = _fields(content)
    except KeyError as error:
        raise SessionError(f"{path} lacks {error.args[0]}; run opnav ort solve again.") from error
    except (TypeError, ValueError, EstimationError) as error:
        raise SessionError(f"{path}: {error}") from error
    return fields


def _fields(content: Mapping[str, Any]) -> dict[str, Any]:
    parameters = tuple(content["parameters"])
    n = size_of(parse_groups(parameters))
    fields: dict[str, Any] = {
        "parameters": parameters,
        "degrees_of_freedom": int(content["degrees_of_freedom"]),
        **{name: str(content[name]) for name in ("package", "epoch_utc", "b_plane_body")},
        **{name: float(content[name]) for name in NUMBERS},
    }
    for name, shape in SHAPES.items():
        fields[name] = _array(name, content[name], tuple(n if size == "n" else int(size) for size in shape))
    for name in OPTIONAL:
        if name in content:
            fields[name] = (
                tuple(content[name]) if isinstance(content[name], Sequence | list) else content[name]
            )
    if "made_by" in content:
        fields["made_by"] = str(content["made_by"])
    fields["disk_sigma_px"] = float(content.get("disk_sigma_px", 0.0))
    fields["residuals"] = tuple(_residual(row) for row in content.get("residuals", ()))
    return fields


def _array(name: str, value: Any, shape: tuple[int, ...]) -> Any:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; expected {shape}")
    if name in COVARIANCES and not (
        np.allclose(array, array.T, rtol=1e-9, atol=0.0) and (np.diag(array) > 0.0).all()
    ):
        raise ValueError(f"{name} is no covariance: it must be symmetric with a positive diagonal")
    return array


def _residual(row: Mapping[str, Any]) -> dict[str, Any]:
    arrays = {name: np.asarray(row[name], float) for name in ("before", "after", "covariance")}
    return dict(row) | arrays
