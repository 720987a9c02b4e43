"""The fields of cameras into camera files, which `opnav_workbench.camera.camera_file` reads."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from opnav_workbench.camera.camera_file import DETECTOR, LENS_NAMES, NAMES, OPTICS, ZERO_POINT
from opnav_workbench.camera.distortion import Distortion, ForwardSipDistortion, SipDistortion
from opnav_workbench.errors import CameraError
from opnav_workbench.files import plain_values, write_text
from opnav_workbench.psf import GaussianPsf

__all__ = ["write_camera_yaml", "yaml_document"]


class _OneLine(dict[str, Any]):
    """A mapping that is written in one line."""


class _Dumper(yaml.SafeDumper):
    """Lists of numbers in one line, mappings and lists of mappings as blocks."""


_Dumper.add_representer(
    list,
    lambda d, data: d.represent_sequence(
        "tag:yaml.org,2002:seq", data, flow_style=not (data and isinstance(data[0], dict))
    ),
)
_Dumper.add_representer(
    _OneLine, lambda d, data: d.represent_mapping("tag:yaml.org,2002:map", data.items(), flow_style=True)
)
_Dumper.add_representer(
    float, lambda d, number: d.represent_scalar("tag:yaml.org,2002:float", _float_text(float(number)))
)


def _float_text(number: float) -> str:
    """A float's shortest text, with the point that YAML 1.1 wants in an exponent's mantissa."""
    text = repr(number)
    mantissa, mark, exponent = text.partition("e")
    return text if not mark or "." in mantissa else f"{mantissa}.0e{exponent}"


def write_camera_yaml(camera: Mapping[str, Any], path: Path, heading: str = "") -> None:
    """Write the fields of a `Camera` as a camera file, with a comment of one or more lines on top.

    Raises
    ------
    CameraError
        Its point spread function stands in a file of its own.
    """
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    write_text(path, comment + yaml_document(_camera_mapping(camera)))


def yaml_document(content: dict[str, Any]) -> str:
    """Return plain values as a YAML document for people: in the order given, lists of numbers in one line."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=118, allow_unicode=True)


def _camera_mapping(camera: Mapping[str, Any]) -> dict[str, Any]:
    """What a camera file says of a camera, as plain values."""
    described = {
        **{name: camera[name] for name in NAMES},
        "origins": [_OneLine(asdict(origin)) for origin in camera["origins"]],
        "optics": _optics(camera),
        "detector": _detector(camera),
        "psf": _psf(camera),
        "photometry": _photometry(camera),
        "attitude_sigma": asdict(camera["attitude_sigma"]),
    }
    return {name: value for name, value in described.items() if value not in ("", []) or name == "source"}


def _optics(camera: Mapping[str, Any]) -> Any:
    told = {name: camera[name] for name in OPTICS} | {"distortion": _distortion(camera["distortion"])}
    return plain_values(told)


def _distortion(model: Distortion) -> dict[str, Any]:
    name = LENS_NAMES.get(type(model))
    if name is None:
        raise CameraError(f"a {type(model).__name__} cannot be written into a camera file.")
    if isinstance(model, SipDistortion | ForwardSipDistortion):
        polynomials = zip(model.KEYWORDS, (model.f, model.g), strict=True)
        return {"model": name} | {keyword.lower(): _powers(c) for keyword, c in polynomials}
    terms = {f.name: (getattr(model, f.name), f.default) for f in fields(model) if f.name != "focal_mm"}  # type: ignore[arg-type]
    return {"model": name} | {
        n: v for n, (v, usual) in terms.items() if isinstance(v, np.ndarray) or v != usual
    }


def _powers(coefficients: Any) -> dict[str, float]:
    """SIP coefficients by ``p_q``; a polynomial without terms keeps one zero."""
    named = {f"{p}_{q}": float(coefficients[p, q]) for p, q in zip(*np.nonzero(coefficients), strict=True)}
    return named or {"1_0": 0.0}


def _detector(camera: Mapping[str, Any]) -> Any:
    limits = camera["exposure_limits"]
    exposures = {} if limits is None else {"exposure_min_s": limits.min_s, "exposure_max_s": limits.max_s}
    rows = {} if camera["rows"] is None else {"rows": asdict(camera["rows"])}
    marks = camera["reseau"]
    reseau = {} if marks is None else {"reseau": {"marks_px": marks.marks_px, "ideal_mm": marks.ideal_mm}}
    return plain_values({name: camera[name] for name in DETECTOR} | exposures | rows | reseau)


def _psf(camera: Mapping[str, Any]) -> dict[str, Any]:
    width, shape = asdict(camera["psf"]), camera["psf_shape"]
    if camera["effective_psf"] is not None:
        raise CameraError(f"{camera['name']}: an effective PSF cannot be written into a camera file.")
    if shape is None:
        return width
    if not isinstance(shape, GaussianPsf):
        raise CameraError(f"{camera['name']}: a {type(shape).__name__} cannot be written into a camera file.")
    return width | {
        "model": {
            "model": "gaussian",
            "sigma_major_px": shape.sigma_major_px,
            "sigma_minor_px": shape.sigma_minor_px,
            "angle_deg": float(np.degrees(shape.angle_rad)),
        }
    }


def _photometry(camera: Mapping[str, Any]) -> Any:
    curve, color = camera["bandpass"], camera["color_response"]
    described = {
        **{name: camera[name] for name in ZERO_POINT},
        "bandpass": None if curve is None else asdict(curve),
        "color": None if color is None else asdict(color),
    }
    return plain_values(described)
