"""A geometry report as a table, as plain values, and as text that a person reads."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.arrays import FloatArray
from opnav_workbench.scene.body_geometry import BodyGeometry
from opnav_workbench.spice import SurfacePoint

if TYPE_CHECKING:
    from opnav_workbench.scene.geometry_report import CameraPointing, GeometryReport

__all__ = ["plain", "table", "text"]

# Column, field of `BodyGeometry`, unit, description.
COLUMNS = (
    ("name", "name", None, "body"),
    ("id", "id", None, "NAIF number"),
    ("range", "range_km", u.km, "spacecraft to body, when the received light left it"),
    ("light_time", "light_time_s", u.s, "one way"),
    ("diameter", "diameter_px", u.pix, "diameter of the circle with the area of the projected limb"),
    ("pixel", "pixel", u.pix, "predicted center, horizontal, 0-based"),
    ("line", "line", u.pix, "predicted center, vertical, 0-based"),
    ("on_detector", "on_detector", None, "the center falls on the detector"),
    ("phase", "phase_deg", u.deg, "Sun - body - spacecraft"),
    ("elongation", "elongation_deg", u.deg, "apparent angle from the Sun"),
    ("sun_distance", "sun_distance_km", u.km, "Sun to body"),
    ("ra", "ra_deg", u.deg, "apparent right ascension, J2000, with light time and stellar aberration"),
    ("dec", "dec_deg", u.deg, "apparent declination, J2000, with light time and stellar aberration"),
    ("spacecraft_position", "spacecraft_km", u.km, "geometric, of the spacecraft relative to the body"),
    (
        "spacecraft_velocity",
        "spacecraft_km_s",
        u.km / u.s,
        "geometric, of the spacecraft relative to the body",
    ),
    ("body_position", "body_km", u.km, "geometric, of the body relative to the center"),
    ("body_velocity", "body_km_s", u.km / u.s, "geometric, of the body relative to the center"),
)
# Column, field, angle, description.
POINTS = (
    (
        "sub_observer_lon",
        "sub_observer",
        "lon_deg",
        "planetocentric longitude, toward east, of the disk's middle",
    ),
    ("sub_observer_lat", "sub_observer", "lat_deg", "planetocentric latitude of the disk's middle"),
    (
        "sub_solar_lon",
        "sub_solar",
        "lon_deg",
        "planetocentric longitude, toward east, of the point below the Sun",
    ),
    ("sub_solar_lat", "sub_solar", "lat_deg", "planetocentric latitude of the point below the Sun"),
)
MISSING = "-"


def table(report: "GeometryReport") -> QTable:
    """Return a row per body; see `GeometryReport.table`."""
    out = QTable(meta={key: value for key, value in plain(report).items() if key != "bodies"})
    for column, field, unit, description in COLUMNS:
        values = [getattr(body, field) for body in report.bodies]
        out[column] = values if unit is None else np.array(values, float) * unit
        out[column].info.description = description
    for column, field, angle, description in POINTS:
        out[column] = np.array([_angle(getattr(body, field), angle) for body in report.bodies], float) * u.deg
        out[column].info.description = description
    return out


def _angle(point: SurfacePoint | None, name: str) -> float:
    return np.nan if point is None else float(getattr(point, name))


def plain(report: "GeometryReport") -> dict[str, Any]:
    """Return the report as mappings, lists, numbers and text; nan becomes None."""
    return dict(_plain(report))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        parts = {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
        if hasattr(value, "j2000_from_camera"):
            parts["j2000_from_camera"] = _plain(value.j2000_from_camera)
        return parts
    if isinstance(value, np.ndarray | tuple | list):
        return [_plain(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return value


def text(report: "GeometryReport") -> str:
    """Return the report as text; see `GeometryReport.text`."""
    parts = [_times(report), _state(report)]
    if report.pointing is not None:
        parts.append(_attitude(report.pointing))
    if report.bodies:
        parts.append(_bodies(report))
    parts += [f"note: {note}" for note in report.notes]
    return "\n\n".join(parts)


def _times(r: "GeometryReport") -> str:
    rows = {"UTC": r.utc, "ET": f"{r.et:.6f} s past J2000 TDB", "SCLK": r.sclk or MISSING}
    return _block(f"Geometry of {r.spacecraft}", rows)


def _state(r: "GeometryReport") -> str:
    rows = {
        "position, km": _vector(r.spacecraft_km, "18.6f"),
        "velocity, km/s": _vector(r.spacecraft_km_s, "18.9f"),
        "distance, km": f"{np.linalg.norm(r.spacecraft_km):18.6f}",
        "speed, km/s": f"{np.linalg.norm(r.spacecraft_km_s):18.9f}",
    }
    return _block(f"State relative to {r.center}, {r.frame}", rows)


def _attitude(p: "CameraPointing") -> str:
    rows = {
        "boresight RA, Dec": f"{p.ra_deg:.7f}, {p.dec_deg:+.7f} deg (J2000)",
        "twist": f"{p.twist_deg:.7f} deg, position angle of increasing line",
        "quaternion": _vector(p.quaternion_camera_from_j2000, "13.10f") + "  camera from J2000",
        "camera to J2000": _vector(p.j2000_from_camera[0], "13.10f"),
        " ": _vector(p.j2000_from_camera[1], "13.10f"),
        "  ": _vector(p.j2000_from_camera[2], "13.10f"),
    }
    return _block(f"Attitude of {p.camera} ({p.frame})", rows)


def _block(title: str, rows: Mapping[str, str]) -> str:
    width = max(len(label) for label in rows)
    return "\n".join([title, *(f"  {label:<{width}}  {value}" for label, value in rows.items())])


def _vector(values: FloatArray, style: str) -> str:
    return " ".join(format(float(v), style) for v in values)


ROWS: tuple[tuple[str, Callable[[BodyGeometry], str]], ...] = (
    ("range, km", lambda b: _number(b.range_km, ".3f")),
    ("light time, s", lambda b: _number(b.light_time_s, ".6f")),
    ("diameter, px", lambda b: _number(b.diameter_px, ".3f")),
    ("pixel", lambda b: _number(b.pixel, ".3f")),
    ("line", lambda b: _number(b.line, ".3f")),
    ("on detector", lambda b: MISSING if not np.isfinite(b.pixel) else "yes" if b.on_detector else "no"),
    ("phase, deg", lambda b: _number(b.phase_deg, ".4f")),
    ("Sun elongation, deg", lambda b: _number(b.elongation_deg, ".4f")),
    ("from the Sun, km", lambda b: _number(b.sun_distance_km, ".0f")),
    ("apparent RA, deg", lambda b: _number(b.ra_deg, ".6f")),
    ("apparent Dec, deg", lambda b: _number(b.dec_deg, "+.6f")),
    ("sub-observer lon, deg E", lambda b: _number(_angle(b.sub_observer, "lon_deg"), ".3f")),
    ("sub-observer lat, deg", lambda b: _number(_angle(b.sub_observer, "lat_deg"), "+.3f")),
    ("sub-solar lon, deg E", lambda b: _number(_angle(b.sub_solar, "lon_deg"), ".3f")),
    ("sub-solar lat, deg", lambda b: _number(_angle(b.sub_solar, "lat_deg"), "+.3f")),
    *(
        (f"spacecraft {axis}, km", lambda b, i=i: _number(b.spacecraft_km[i], ".3f"))
        for i, axis in enumerate("xyz")
    ),
    *(
        (f"spacecraft v{axis}, km/s", lambda b, i=i: _number(b.spacecraft_km_s[i], ".6f"))
        for i, axis in enumerate("xyz")
    ),
)


def _number(value: float, style: str) -> str:
    return format(float(value), style) if np.isfinite(value) else MISSING


def _bodies(r: "GeometryReport") -> str:
    """Return one column per body: many quantities, few bodies."""
    grid = [
        ["", *(b.name for b in r.bodies)],
        *([label, *(show(b) for b in r.bodies)] for label, show in ROWS),
    ]
    widths = [max(len(row[i]) for row in grid) for i in range(len(grid[0]))]
    lines = [
        "  "
        + "  ".join(
            [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in grid
    ]
    return "\n".join([f"Bodies; spacecraft relative to each, {r.frame}", *lines])
