"""The files of a new mission: mission, camera, and a scenario of star fields that can be simulated at once."""

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera, Origin
from opnav_workbench.camera.saving import yaml_document
from opnav_workbench.constants import HOUR_S, RAD_PER_DEG, SUN_ID, SUN_RADIUS_KM
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.geometry import matrix_from_quaternion, pointing_angles
from opnav_workbench.photometry import Bandpass

__all__ = ["Craft", "Place", "able_to_simulate", "write_camera", "write_mission", "write_scenario"]

PLEIADES_DEG = (56.75, 24.12)  # of a scenario without a picture: bright stars enough for any field
WITHOUT_PICTURE = {  # what simulated pictures carry, where no picture says what headers hold
    "exposure_s": "EXPTIME",
    "utc": "DATE-AVG",
    "quaternion": ["QUAT0", "QUAT1", "QUAT2", "QUAT3"],
    "quaternion_sense": "j2000_to_camera",
    "sun_position": ["SUNPOSX", "SUNPOSY", "SUNPOSZ"],
    "sun_velocity": ["SUNVELX", "SUNVELY", "SUNVELZ"],
    "target": "OBJECT",
    "instrument": "INSTRUME",
}
SUN = {
    "name": "SUN",
    "id": SUN_ID,
    "source": "IAU WGCCRE 2015; GM of DE440",
    "radii_km": [SUN_RADIUS_KM] * 3,
    "gm_km3_s2": 132712440041.27942,
}
SPAN_S = 1800
SCAN_SHARE = 0.6  # of a scan's lines, before and after its middle
GUESSED_F_NUMBER, GUESSED_PEAK, GUESSED_BITS = 4.0, 0.3, 12


@dataclass(frozen=True, slots=True)
class Craft:
    """A spacecraft's names and numbers."""

    mission: str
    name: str
    number: int
    bus_frame: str
    bus_number: int


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """When and where a picture was taken, and how the camera stood; invented where there is no picture."""

    utc: str
    exposure_s: float
    position_km: FloatArray  # from the solar-system barycenter, J2000
    velocity_km_s: FloatArray
    quaternion: FloatArray | None = None  # camera from J2000


def able_to_simulate(camera: Camera) -> Camera:
    """Return the camera with guesses for what simulation needs and nobody has told, each of them marked."""
    told: dict[str, Any] = {}
    if camera.aperture_m is None:
        told["aperture_m"] = camera.focal_length_mm / GUESSED_F_NUMBER / 1000.0
    if camera.zero_point_mag is None and camera.bandpass is None:
        edges = np.array([430.0, 450.0, 900.0, 920.0])
        told["bandpass"] = Bandpass(edges, np.array([0.0, 1.0, 1.0, 0.0])).scaled_to(GUESSED_PEAK)
    usual = {
        "bits": GUESSED_BITS, "gain_e_per_dn": 20.0, "read_noise_dn": 1.0, "saturation_dn": 2.0**GUESSED_BITS - 96.0,
        "bias_dn": 80.0, "full_well_e": 8.0e4, "dark_current_e_s": 1.0, "prnu": 0.01,
    }  # fmt: skip
    told |= {name: value for name, value in usual.items() if getattr(camera, name) is None}
    if not told:
        return camera
    lens = f" at F/{GUESSED_F_NUMBER:g}" if "aperture_m" in told else ""
    text = f"{', '.join(told)}: as of a usual CCD{lens}"
    return replace(
        camera, **told, origins=(*camera.origins, Origin("what it makes of light", "guessed", text))
    )


def write_camera(folder: Path, stem: str, camera: Camera, heading: str) -> Path:
    """Write ``cameras/STEM.yaml``."""
    path = make_folder(folder / "cameras") / f"{stem}.yaml"
    camera.to_yaml(path, heading)
    return path


def write_mission(
    folder: Path,
    craft: Craft,
    stem: str,
    keywords: dict[str, Any] | None,
    match: dict[str, Any],
    heading: str,
    lines: str = "",
) -> Path:
    """Write ``mission.yaml``; without `keywords`, those of simulated pictures. `lines` tells how many a scan has."""
    entry: dict[str, Any] = {"file": f"cameras/{stem}.yaml", "match": match}
    if lines:
        entry["readout"] = {"n_line": lines}
    content = {
        "name": craft.mission,
        "spacecraft": {"name": craft.name, "id": craft.number},
        "clock_id": craft.number,
        "bus_frame": craft.bus_frame,
        "reference_body": "SUN",
        "default_targets": [],
        "cameras": [entry],
        "keywords": WITHOUT_PICTURE if keywords is None else keywords,
    }
    path = make_folder(folder) / "mission.yaml"
    write_text(path, f"# {heading}\n{yaml_document(content)}")
    return path


def write_scenario(
    folder: Path, craft: Craft, stem: str, camera: Camera, place: Place, catalog: str = "bundled"
) -> Path:
    """Write ``star_fields.yaml`` (kernels) and ``pictures/star_fields.yaml``, and return the second."""
    middle = datetime.fromisoformat(place.utc.rstrip("Z"))
    write_text(folder / "star_fields.yaml", yaml_document(_kernels(craft, camera, place, middle)))
    ra, dec = PLEIADES_DEG
    aim: dict[str, Any] = {"source": "fixed", "ra_deg": ra, "dec_deg": dec}
    if place.quaternion is not None:
        aim = {"source": "fixed", "quaternion_camera_from_j2000": [float(q) for q in place.quaternion]}
    picture = {
        "name": "star_field", "utc": middle.isoformat(), "camera": stem, "exposure_s": place.exposure_s, "targets": [],
    }  # fmt: skip
    content = {
        "description": f"Stars with {camera.name}",
        "mission": "../mission.yaml",
        "kernels": "../star_fields.yaml",
        "catalog": catalog,
        "magnitude_limit": 11.0,
        "seed": 1,
        "attitude": {"motion": {"from_kernels": True}} if camera.scans else {"predicted": aim},
        "pictures": [picture],
    }
    path = make_folder(folder / "pictures") / "star_fields.yaml"
    write_text(path, yaml_document(content))
    return path


def _kernels(craft: Craft, camera: Camera, place: Place, middle: datetime) -> dict[str, Any]:
    """A kernel scenario: the spacecraft on a straight line, the camera along the bus."""
    start, end = (middle + timedelta(seconds=s) for s in (-SPAN_S, SPAN_S))
    span = {"start": start.isoformat(), "end": end.isoformat()}
    frames = []
    if camera.frame != craft.bus_frame:
        turned = {"name": camera.frame, "id": camera.instrument_id, "relative_to": craft.bus_frame}
        frames.append({**turned, "matrix": np.eye(3).tolist()})
    return {
        "mission": craft.mission,
        "name": "star_fields",
        "description": f"{craft.name}: invented motion, mounting and clock, for simulated star fields",
        "span": span,
        "spacecraft": {
            "name": craft.name,
            "id": craft.number,
            "frame": {"name": craft.bus_frame, "id": craft.bus_number},
        },
        "clock": {"id": craft.number, "start": (start - timedelta(days=1)).isoformat()},
        "frames": frames,
        "instruments": [_instrument(craft, camera)],
        "bodies": [SUN],
        "pointing": {
            "instrument": _instrument_name(craft),
            "windows": [_window(camera, place, middle, span)],
        },
        "trajectories": [{"kind": "ephemeris", "target": "SUN"}, _straight_line(craft, place, middle)],
    }


def _window(camera: Camera, place: Place, middle: datetime, span: dict[str, str]) -> dict[str, Any]:
    """Where the camera looks: at one place, or along a scan of a pixel a line that has it in its middle."""
    ra, dec = PLEIADES_DEG
    if camera.rows is None or not camera.rows.scans:
        return {**span, "ra_deg": ra, "dec_deg": dec}
    twist = 0.0
    if place.quaternion is not None:
        angles = pointing_angles(matrix_from_quaternion(place.quaternion), camera.focal_from_camera)
        ra, dec, twist = (angle / RAD_PER_DEG for angle in angles)
    half_lines, line_s = SCAN_SHARE * camera.n_line, abs(camera.rows.line_time_s)
    start, end = (middle + timedelta(seconds=sign * half_lines * line_s) for sign in (-1.0, 1.0))
    way = float(
        np.sign(camera.rows.line_time_s)
    )  # a later line is one further on: the sky comes toward the lower lines
    scan = {
        "rate_deg_s": camera.pixel_scale_rad / line_s / RAD_PER_DEG,
        "direction": [0.0, -way],
        "start_px": [0.0, way * half_lines],
    }
    aim = {"ra_deg": float(ra), "dec_deg": float(dec), "twist_deg": float(twist)}
    return {"start": start.isoformat(), "end": end.isoformat(), **aim, "scan": scan}


def _instrument_name(craft: Craft) -> str:
    return f"{craft.mission.upper()}_CAMERA"


def _instrument(craft: Craft, camera: Camera) -> dict[str, Any]:
    return {
        "name": _instrument_name(craft),
        "id": camera.instrument_id,
        "frame": camera.frame,
        "focal_length_mm": camera.focal_length_mm,
        "pixel_size_um": 1e3 / float(np.sqrt(abs(np.linalg.det(camera.pixel_from_mm)))),
        "n_pixel": camera.n_pixel,
        "n_line": camera.n_line,
        "focal_from_camera": camera.focal_from_camera.tolist(),
    }


def _straight_line(craft: Craft, place: Place, middle: datetime) -> dict[str, Any]:
    """The spacecraft's way, an hour beyond the span on both sides."""
    rows = []
    for passed_s in (-SPAN_S - HOUR_S, SPAN_S + HOUR_S):
        at = place.position_km + place.velocity_km_s * passed_s
        when = middle + timedelta(seconds=passed_s)
        rows.append([when.isoformat(), *at.tolist(), *place.velocity_km_s.tolist()])
    return {"kind": "states", "target": craft.name, "center": 0, "source": "a straight line", "rows": rows}
