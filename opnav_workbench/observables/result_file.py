"""Observables from a ``result.json`` alone: what it holds of them, when the table beside it is lost."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.observables.observable import Observable

__all__ = ["observables_of_result", "read_result"]

NUMBERS = (
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
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SessionError(
            f"no result can be read from {path}: {error}. Give a file of opnav process."
        ) from error
    if not isinstance(data, dict) or "bodies" not in data or "pointing" not in data:
        raise SessionError(f"{path} is no result of opnav process (no bodies or pointing in it).")
    return data


def observables_of_result(result: Mapping[str, Any], source: str = "result.json") -> tuple[Observable, ...]:
    """Return the observables of a result; what it does not hold (other partials, sky covariances) is unknown.

    Parameters
    ----------
    result : mapping
        The content of ``result.json``.
    source : str
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
        return tuple(_observable(result, body) for body in result["bodies"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{source} is damaged ({error!r}); process the picture again.") from error


def _observable(result: Mapping[str, Any], body: Mapping[str, Any]) -> Observable:
    unknown = np.full((2, 2), np.nan)
    observed = _array(body["observed"], (2,))
    predicted = _array(body["predicted"], (2,))
    residual = None if observed is None or predicted is None else observed - predicted
    place = np.full(2, np.nan)
    covariance = _array(body["covariance_px2"], (2, 2))
    numbers: dict[str, Any] = {name: _number(body.get(name)) for name in NUMBERS}
    total = _array(body.get("covariance_with_pointing_px2"), (2, 2))
    return Observable(
        image=str(result["image"]),
        utc=str(result["utc"]),
        et=float(result["et"]),
        name=str(body["name"]),
        method=str(body["method"]),
        status=str(body["status"]),
        reference_body=str(body.get("reference_body", "")),
        a_priori_px=place if (a_priori := _array(body["a_priori"], (2,))) is None else a_priori,
        predicted_px=place if predicted is None else predicted,
        observed_px=observed,
        residual_px=residual,
        covariance_px2=unknown if covariance is None else covariance,
        total_covariance_px2=unknown if total is None else total,
        partials_px_per_km=_array(body.get("partials_px_per_km"), (2, 3)),
        partials_px_per_rad=None,
        residual_arcsec=_array(body.get("residual_arcsec"), (2,)),
        messages=tuple(body.get("messages") or ()),
        center_cross_px2={n: np.array(c, float) for n, c in (body.get("joint_covariance_px2") or {}).items()},
        attitude_covariance_rad2=_array((result["pointing"] or {}).get("covariance_rad2"), (3, 3)),
        **numbers,
    )


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)


def _array(value: Any, shape: tuple[int, ...]) -> FloatArray | None:
    """None and null elements are unknown; an array of nothing else is none."""
    if value is None:
        return None
    array = np.array(value, dtype=np.float64).reshape(shape)
    return None if np.isnan(array).all() else array
