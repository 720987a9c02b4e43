"""A camera file with some values replaced; its other lines and comments stay as they are."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from opnav_workbench.calibration.camera_fit import CameraCalibration
from opnav_workbench.camera import BrownDistortion, Camera, Distortion, OwenDistortion
from opnav_workbench.errors import CameraError
from opnav_workbench.files import atomic_path
from opnav_workbench.yaml_nodes import compose, plain_value

__all__ = ["Edit", "camera_edits", "edited", "write_camera_file"]

FieldPath = tuple[str, ...]
DIGITS = 12  # significant digits of a number: far beyond any sigma


@dataclass(frozen=True, slots=True)
class Edit:
    """A new value of a field, None to remove it, and a comment for its line."""

    value: Any
    comment: str = ""


def write_camera_file(source: Path, target: Path, edits: Mapping[FieldPath, Edit], heading: str) -> Camera:
    """Write a copy of a camera file with some values replaced, and return the camera that it describes.

    Parameters
    ----------
    source, target
        They may be the same file.
    edits : mapping of field (names from the outside in) to Edit
    heading
        A comment that goes to the top.

    Raises
    ------
    CameraError
        The file cannot be read, or would describe no camera; nothing is written then.
    """
    try:
        text = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CameraError(f"camera file {source} cannot be read: {error}.") from error
    for place, edit in edits.items():
        text = edited(text, place, edit)
    with atomic_path(target) as temporary:
        temporary.write_text(f"# {heading}\n{text}", encoding="utf-8")
        return Camera.from_yaml(temporary)


def camera_edits(result: CameraCalibration, distortion: str = "keep") -> dict[FieldPath, Edit]:
    """Return the edits that put a calibration into the file of the camera it started from.

    Parameters
    ----------
    distortion : {"keep", "none", "owen", "brown"}
        Another model replaces the one of the file with all its terms.
    """
    comments = {
        name: "not determined" if np.isinf(sigma) else f"sigma {sigma:.2g}"
        for name, sigma in zip(result.names, result.sigmas, strict=True)
    }
    camera, edits = result.camera, dict[FieldPath, Edit]()
    if "focal_length_mm" in comments:
        edits["optics", "focal_length_mm"] = Edit(camera.focal_length_mm, comments["focal_length_mm"])
    if {"center_pixel", "center_line"} & set(comments):
        note = ", ".join(f"{n}: {comments[n]}" for n in ("center_pixel", "center_line") if n in comments)
        edits["detector", "center_pixel_line"] = Edit(camera.center_pixel_line.tolist(), note)
    if "line_scale" in comments:
        edits["optics", "pixel_from_mm"] = Edit(camera.pixel_from_mm.tolist(), comments["line_scale"])
    mounting = [f"{name}: {comments[name]}" for name in result.names if name.startswith("mounting")]
    if mounting:
        edits["optics", "focal_from_camera"] = Edit(camera.focal_from_camera.tolist(), ", ".join(mounting))
    if distortion != "keep":
        edits["optics", "distortion"] = Edit({"model": distortion} | _terms(camera.distortion))
        return edits
    for name, value in zip(result.names, result.values, strict=True):
        if hasattr(camera.distortion, name):
            edits["optics", "distortion", name] = Edit(float(value), comments[name])
    return edits


def _terms(distortion: Distortion) -> dict[str, float]:
    """The terms of a distortion model that are not zero."""
    if not isinstance(distortion, OwenDistortion | BrownDistortion):
        return {}
    values = {field.name: float(getattr(distortion, field.name)) for field in fields(distortion)}
    return {name: value for name, value in values.items() if value != 0.0 and name != "focal_mm"}


def edited(text: str, place: FieldPath, edit: Edit) -> str:
    r"""Return YAML text with one field replaced, added or removed.

    Raises
    ------
    CameraError
        The part of the file that should hold the field is not there.

    Examples
    --------
    >>> print(edited("optics:\n  focal_mm: 1.0  # drawing\n", ("optics", "focal_mm"), Edit(2.5, "sigma 0.1")), end="")
    optics:
      focal_mm: 2.5  # sigma 0.1
    """
    parent = _node(text, place[:-1])
    if not isinstance(parent, yaml.MappingNode):
        raise CameraError(f"camera file: {'.'.join(place[:-1])} is missing, so {place[-1]} cannot be set.")
    if parent.flow_style:
        content = {
            **plain_value(compose(text[parent.start_mark.index : parent.end_mark.index])),
            place[-1]: edit.value,
        }
        kept = {key: value for key, value in content.items() if value is not None}
        return text[: parent.start_mark.index] + _flow(kept) + text[parent.end_mark.index :]
    for key, value in parent.value:
        if key.value == place[-1]:
            return _replaced(text, key, value, edit)
    return text if edit.value is None else _added(text, parent, place[-1], edit)


def _node(text: str, place: FieldPath) -> yaml.Node | None:
    node = compose(text)
    for name in place:
        children = node.value if isinstance(node, yaml.MappingNode) else []
        node = next((value for key, value in children if key.value == name), None)
    return node


def _replaced(text: str, key: yaml.Node, value: yaml.Node, edit: Edit) -> str:
    end = text.find("\n", _last_index(value))
    tail = text[end:] if end >= 0 else ""
    if edit.value is None:
        return text[: text.rfind("\n", 0, key.start_mark.index) + 1] + tail.removeprefix("\n")
    return f"{text[: key.end_mark.index]}: {_flow(edit.value)}{_comment(edit)}{tail}"


def _added(text: str, parent: yaml.MappingNode, name: str, edit: Edit) -> str:
    end = text.find("\n", _last_index(parent))
    head, tail = (text, "") if end < 0 else (text[:end], text[end:])
    indent = " " * parent.value[0][0].start_mark.column
    return f"{head}\n{indent}{name}: {_flow(edit.value)}{_comment(edit)}{tail}"


def _last_index(node: yaml.Node) -> int:
    """Where the text of a node ends; a block's own mark lies behind the comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _last_index(last[1] if isinstance(node, yaml.MappingNode) else last)
    return int(node.end_mark.index)


def _comment(edit: Edit) -> str:
    return f"  # {edit.comment}" if edit.comment else ""


def _flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    return (
        yaml.safe_dump(_rounded(value), default_flow_style=True, width=10**6, sort_keys=False)
        .split("\n...")[0]
        .strip()
    )


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
