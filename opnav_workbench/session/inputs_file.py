"""Inputs of a session as plain values, and back: whole, and what a step added to them."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.bodies import TargetState
from opnav_workbench.catalog import StarTable
from opnav_workbench.scene import Observer
from opnav_workbench.session.state import Inputs

__all__ = ["inputs_added", "inputs_dict", "inputs_from", "with_added"]


def inputs_dict(inputs: Inputs) -> dict[str, Any]:
    """Return inputs as plain values."""
    return {
        "et": inputs.et,
        "utc": inputs.utc,
        "observer": _columns(inputs.observer),
        "a_priori_camera_from_j2000": inputs.a_priori_camera_from_j2000,
        "attitude_source": inputs.attitude_source,
        "stars": _columns(inputs.stars),
        "wide_stars": None if inputs.wide_stars is None else _columns(inputs.wide_stars),
        "targets": {name: _columns(target) for name, target in inputs.targets.items()},
        "shapes": dict(inputs.shapes),
    }


def _columns(instance: Any) -> dict[str, Any]:
    return {field.name: getattr(instance, field.name) for field in fields(instance)}


def inputs_from(data: Mapping[str, Any]) -> Inputs:
    """Return inputs from plain values."""
    return Inputs(
        et=float(data["et"]),
        utc=data["utc"],
        observer=_rebuild(Observer, data["observer"]),
        a_priori_camera_from_j2000=np.array(data["a_priori_camera_from_j2000"], dtype=np.float64),
        attitude_source=data["attitude_source"],
        stars=_star_table(data["stars"]),
        targets=MappingProxyType({n: _rebuild(TargetState, t) for n, t in data["targets"].items()}),
        wide_stars=None if data.get("wide_stars") is None else _star_table(data["wide_stars"]),
        shapes=_paths(data.get("shapes", {})),
    )


def _rebuild(cls: type[Any], values: Mapping[str, Any]) -> Any:
    arrays = {k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in values.items()}
    return cls(**arrays)


def _star_table(columns: Mapping[str, Any]) -> StarTable:
    """Rebuild the catalog rows; null stands for a number that is not known."""
    text = {"id", "band"}
    arrays: dict[str, Any] = {
        name: np.array(values) if name in text else np.array(values, dtype=np.float64)
        for name, values in columns.items()
        if name != "motion_known"
    }
    arrays["sigma"] = arrays["sigma"].reshape(-1, 5)  # with no star at all, JSON has forgotten the five
    return StarTable(**arrays, motion_known=np.array(columns["motion_known"], dtype=bool))


def inputs_added(before: Inputs | None, inputs: Inputs) -> dict[str, Any]:
    """Return as plain values what `inputs` hold that `before` does not: targets, and the stars of a wide search."""
    known = {} if before is None else before.targets
    targets = {name: _columns(target) for name, target in inputs.targets.items() if name not in known}
    added: dict[str, Any] = {"targets": targets} if targets else {}
    shapes = {name: path for name, path in inputs.shapes.items() if name in targets}
    added |= {"shapes": shapes} if shapes else {}
    if inputs.wide_stars is not None and (before is None or before.wide_stars is None):
        added["wide_stars"] = _columns(inputs.wide_stars)
    return added


def with_added(inputs: Inputs, added: Mapping[str, Any]) -> Inputs:
    """Return inputs with what `inputs_added` told of a later step."""
    targets = {name: _rebuild(TargetState, target) for name, target in added.get("targets", {}).items()}
    wide = added.get("wide_stars")
    return replace(
        inputs,
        targets=MappingProxyType({**inputs.targets, **targets}),
        wide_stars=inputs.wide_stars if wide is None else _star_table(wide),
        shapes=MappingProxyType({**inputs.shapes, **_paths(added.get("shapes", {}))}),
    )


def _paths(values: Mapping[str, str]) -> MappingProxyType[str, Path]:
    return MappingProxyType({name: Path(path) for name, path in values.items()})
