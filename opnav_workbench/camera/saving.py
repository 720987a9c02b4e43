"""Cameras into camera files, which `opnav_workbench.camera.camera_file` reads."""

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from opnav_workbench.camera.distortion import (
    BrownDistortion,
    Distortion,
    ForwardSipDistortion,
    LegendreDistortion,
    NoDistortion,
    OwenDistortion,
    SipDistortion,
)
from opnav_workbench.camera.lens_models import (
    CahvorDistortion,
    FisheyeDistortion,
    RadialDistortion,
    RationalDistortion,
    TaylorDistortion,
)
from opnav_workbench.errors import CameraError
from opnav_workbench.files import atomic_path
from opnav_workbench.psf import GaussianPsf

if TYPE_CHECKING:
    from opnav_workbench.camera.model import Camera

__all__ = ["camera_mapping", "write_camera_yaml", "yaml_document"]

MODEL_NAMES: dict[type[Distortion], str] = {
    NoDistortion: "none",
    OwenDistortion: "owen",
    BrownDistortion: "brown",
    LegendreDistortion: "legendre",
    RadialDistortion: "radial",
    TaylorDistortion: "taylor",
    RationalDistortion: "rational",
    FisheyeDistortion: "fisheye",
    CahvorDistortion: "cahvor",
}
DETECTOR = (
    "bits", "gain_e_per_dn", "read_noise_dn", "saturation_dn", "bias_dn", "full_well_e", "dark_current_e_s",
    "frame_transfer_s", "prnu", "hot_pixel_fraction", "dead_pixel_fraction",
)  # fmt: skip


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


def write_camera_yaml(camera: "Camera", path: Path, heading: str = "") -> None:
    """Write a camera file, with a comment of one or more lines on top."""
    text = yaml_document(camera_mapping(camera))
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    with atomic_path(path) as temporary:
        temporary.write_text(comment + text, encoding="utf-8")


def yaml_document(content: dict[str, Any]) -> str:
    """Return plain values as a YAML document for people: in the order given, lists of numbers in one line."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=118, allow_unicode=True)


def camera_mapping(camera: "Camera") -> dict[str, Any]:
    """Return what a camera file says of a camera, as plain values.

    Raises
    ------
    CameraError
        Its point spread function stands in a file of its own.
    """
    described = {
        "name": camera.name,
        "frame": camera.frame,
        "instrument_id": camera.instrument_id,
        "source": camera.source,
        "confirmed_by": camera.confirmed_by,
        "origins": [_OneLine(field=o.field, how=o.how, text=o.text) for o in camera.origins],
        "optics": _optics(camera),
        "detector": _detector(camera),
        "psf": _psf(camera),
        "photometry": _photometry(camera),
        "attitude_sigma": {
            "cross_px": camera.attitude_sigma.cross_px,
            "twist_deg": camera.attitude_sigma.twist_deg,
        },
    }
    return {name: value for name, value in described.items() if value not in ("", [])}


def _optics(camera: "Camera") -> dict[str, Any]:
    return _plain(
        {
            "focal_length_mm": camera.focal_length_mm,
            "aperture_m": camera.aperture_m,
            "obscuration": camera.obscuration,
            "pixel_from_mm": camera.pixel_from_mm,
            "focal_from_camera": camera.focal_from_camera,
            "distortion": _distortion(camera.distortion),
        }
    )


def _distortion(model: Distortion) -> dict[str, Any]:
    if isinstance(model, SipDistortion | ForwardSipDistortion):
        names = ("ap", "bp") if isinstance(model, SipDistortion) else ("a", "b")
        kind = "sip" if isinstance(model, SipDistortion) else "sip_forward"
        return {"model": kind} | {n: _powers(c) for n, c in zip(names, (model.f, model.g), strict=True)}
    name = MODEL_NAMES.get(type(model))
    if name is None:
        raise CameraError(f"a {type(model).__name__} cannot be written into a camera file.")
    terms = {f.name: (getattr(model, f.name), f.default) for f in fields(model) if f.name != "focal_mm"}  # type: ignore[arg-type]
    return {"model": name} | {
        n: v for n, (v, usual) in terms.items() if isinstance(v, np.ndarray) or v != usual
    }


def _powers(coefficients: Any) -> dict[str, float]:
    """SIP coefficients by ``p_q``; a polynomial without terms keeps one zero."""
    named = {f"{p}_{q}": float(coefficients[p, q]) for p, q in zip(*np.nonzero(coefficients), strict=True)}
    return named or {"1_0": 0.0}


def _detector(camera: "Camera") -> dict[str, Any]:
    limits = camera.exposure_limits
    exposures = {} if limits is None else {"exposure_min_s": limits.min_s, "exposure_max_s": limits.max_s}
    return _plain(
        {
            "n_pixel": camera.n_pixel,
            "n_line": camera.n_line,
            "center_pixel_line": camera.center_pixel_line,
            **{name: getattr(camera, name) for name in DETECTOR},
            **exposures,
        }
    )


def _psf(camera: "Camera") -> dict[str, Any]:
    width = {"sigma_px": camera.psf.sigma_px, "sigma_sigma_px": camera.psf.sigma_sigma_px}
    shape = camera.psf_shape
    if shape is None:
        return width
    if not isinstance(shape, GaussianPsf):
        raise CameraError(f"{camera.name}: a {type(shape).__name__} cannot be written into a camera file.")
    return width | {
        "model": {
            "model": "gaussian",
            "sigma_major_px": shape.sigma_major_px,
            "sigma_minor_px": shape.sigma_minor_px,
            "angle_deg": float(np.degrees(shape.angle_rad)),
        }
    }


def _photometry(camera: "Camera") -> dict[str, Any]:
    told: dict[str, Any] = {
        "zero_point_mag": camera.zero_point_mag,
        "zero_point_b_v": camera.zero_point_b_v,
        "bandpass": None,
        "color": None,
    }
    if camera.bandpass is not None:
        told["bandpass"] = {
            "wavelength_nm": camera.bandpass.wavelength_nm,
            "response": camera.bandpass.response,
        }
    color = camera.color_response
    if color is not None:
        told["color"] = {
            "slope_mag_per_bv": color.slope_mag_per_bv,
            "sigma_mag": color.sigma_mag,
            "reference_b_v": color.reference_b_v,
            "curvature_mag_per_bv2": color.curvature_mag_per_bv2,
        }
    return _plain(told)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Arrays and numpy numbers as lists and numbers."""
    return {name: _plain_value(value) for name, value in values.items()}


def _plain_value(value: Any) -> Any:
    if isinstance(value, dict):
        return _plain(value)
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain_value(item) for item in np.asarray(value).tolist()]
    return value.item() if isinstance(value, np.generic) else value
