"""The geometry of an epoch as table, plain values or text: times, states, attitude, bodies as the camera sees them.

"ET, UTC, spacecraft state with respect to any body or frame origin, body state, spacecraft attitude quaternion,
camera-to-inertial matrix, and the camera boresight vector and twist angle" (AAS 13-443), and what an analyst asks next.
Angles are in degrees here: a person reads them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import pointing_angles, quaternion_from_matrix
from opnav_workbench.kernels import (
    SurfacePoint,
    body_id,
    body_name,
    camera_attitude,
    sclk_from_et,
    state,
    utc_from_et,
)
from opnav_workbench.scene.body_geometry import SUN, BodyGeometry, Viewpoint, body_geometry
from opnav_workbench.scene.states import observer_from_kernels

__all__ = ["CameraPointing", "GeometryReport", "geometry_report"]


# ---- A geometry report as a table, as plain values, and as text that a person reads.

# Column, field of `BodyGeometry`, unit, description.
TABLE_COLUMNS = (
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
TABLE_POINTS = (
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


def report_table(report: "GeometryReport") -> QTable:
    """Return a row per body; see `GeometryReport.table`."""
    out = QTable(meta={key: value for key, value in report_values(report).items() if key != "bodies"})
    for column, field, unit, description in TABLE_COLUMNS:
        values = [getattr(body, field) for body in report.bodies]
        out[column] = values if unit is None else np.array(values, float) * unit
        out[column].info.description = description
    for column, field, angle, description in TABLE_POINTS:
        out[column] = np.array([_angle(getattr(body, field), angle) for body in report.bodies], float) * u.deg
        out[column].info.description = description
    return out


def _angle(point: SurfacePoint | None, name: str) -> float:
    return np.nan if point is None else float(getattr(point, name))


def report_values(report: "GeometryReport") -> dict[str, Any]:
    """Return the report as mappings, lists, numbers and text; nan becomes None."""
    return dict(_plain_value(report))


def _plain_value(value: Any) -> Any:
    if is_dataclass(value):
        parts = {f.name: _plain_value(getattr(value, f.name)) for f in fields(value)}
        if hasattr(value, "j2000_from_camera"):
            parts["j2000_from_camera"] = _plain_value(value.j2000_from_camera)
        return parts
    if isinstance(value, np.ndarray | tuple | list):
        return [_plain_value(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return value


def report_text(report: "GeometryReport") -> str:
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


TEXT_ROWS: tuple[tuple[str, Callable[[BodyGeometry], str]], ...] = (
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
        *([label, *(show(b) for b in r.bodies)] for label, show in TEXT_ROWS),
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


# ---- The geometry of an epoch: times, states, attitude, and each body as the camera sees it.

UTC_DECIMALS = 3


@dataclass(frozen=True, slots=True, eq=False)
class CameraPointing:
    """A camera's attitude at an epoch.

    Attributes
    ----------
    camera, frame
        Name and SPICE frame.
    camera_from_j2000 : (3, 3) array
        ``v_camera = camera_from_j2000 @ v_j2000``.
    quaternion_camera_from_j2000 : (4,) array
        The same as a SPICE quaternion, scalar first.
    ra_deg, dec_deg, twist_deg
        Boresight, and position angle of increasing line, east of J2000 north.
    """

    camera: str
    frame: str
    camera_from_j2000: FloatArray
    quaternion_camera_from_j2000: FloatArray
    ra_deg: float
    dec_deg: float
    twist_deg: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def j2000_from_camera(self) -> FloatArray:
        """Camera-to-inertial matrix (3, 3)."""
        return np.asarray(self.camera_from_j2000.T)


@dataclass(frozen=True, slots=True, eq=False)
class GeometryReport:
    """All geometry of an epoch.

    Attributes
    ----------
    et
        TDB s past J2000.
    sclk
        Reading of the spacecraft clock.
    center
        Body that the states refer to.
    frame
        Frame of the states.
    spacecraft_km, spacecraft_km_s : (3,) arrays
        Geometric state of the spacecraft relative to the center.
    notes
        What could not be found, and why.
    """

    et: float
    utc: str
    sclk: str | None
    spacecraft: str
    center: str
    frame: str
    spacecraft_km: FloatArray
    spacecraft_km_s: FloatArray
    pointing: CameraPointing | None
    bodies: tuple[BodyGeometry, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def body(self, name: str) -> BodyGeometry:
        """Return one of the bodies by its name.

        Raises
        ------
        KernelError
            The report does not hold it.
        """
        for body in self.bodies:
            if body.name.upper() == name.upper():
                return body
        held = ", ".join(b.name for b in self.bodies) or "none"
        raise KernelError(f"the geometry report holds no {name!r}; it holds {held}.")

    def table(self) -> QTable:
        """Return a row per body, every column with unit and description; epoch and attitude stand in ``meta``."""
        return report_table(self)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON; what is not known is None."""
        return report_values(self)

    def text(self) -> str:
        """Return everything as text, one column per body."""
        return report_text(self)

    def __str__(self) -> str:
        return self.text()


def geometry_report(
    et: float,
    spacecraft: str | int,
    bodies: Sequence[str],
    camera: Camera | None = None,
    *,
    clock_id: int | None = None,
    center: str = SUN,
    frame: str = "J2000",
) -> GeometryReport:
    """Collect the geometry of an epoch from the active `KernelSet`.

    Parameters
    ----------
    et
        Time at the spacecraft, TDB s past J2000.
    spacecraft
        SPICE name or NAIF number.
    bodies
        SPICE names.
    camera
        For attitude, sizes and places on the detector. Where no CK covers `et`, sizes are those of a body in the
        middle of the field, places are nan, and a note says why.
    clock_id
        Spacecraft clock; none: no clock reading.
    center
        Body that states refer to.
    frame
        SPICE frame of the states.

    Raises
    ------
    KernelError
        No kernels are open, a name is unknown, or spacecraft, center or a body have no ephemeris at `et`.

    Examples
    --------
    >>> from opnav_workbench.mission import load_mission
    >>> from opnav_workbench.kernels import KernelSet, et_from_utc
    >>> camera = load_mission("new_horizons").camera_named("lorri_1x1")
    >>> with KernelSet("new_horizons/pluto_approach"):
    ...     report = geometry_report(et_from_utc("2015-07-09T04:29:00"), -98, ["PLUTO"], camera)
    >>> pluto = report.body("PLUTO")
    >>> print(f"{pluto.range_km:.3g} km, {pluto.diameter_px:.0f} px, {pluto.phase_deg:.0f} deg")
    6.32e+06 km, 76 px, 15 deg
    """
    notes: list[str] = []
    own = state(spacecraft, et, center, frame)
    pointing = _noted(notes, "no attitude", lambda: None if camera is None else _pointing(camera, et))
    sclk = _noted(notes, "no clock reading", lambda: None if clock_id is None else sclk_from_et(clock_id, et))
    attitude = None if pointing is None else pointing.camera_from_j2000
    view = Viewpoint(
        body_id(spacecraft),
        et,
        observer_from_kernels(body_id(spacecraft), et),
        camera,
        attitude,
        center,
        frame,
    )
    return GeometryReport(
        et=et,
        utc=utc_from_et(et, UTC_DECIMALS),
        sclk=sclk,
        spacecraft=body_name(body_id(spacecraft)),
        center=center,
        frame=frame,
        spacecraft_km=own.position_km,
        spacecraft_km_s=own.velocity_km_s,
        pointing=pointing,
        bodies=tuple(body_geometry(name, view) for name in bodies),
        notes=tuple(notes),
    )


def _noted(notes: list[str], what: str, value: Callable[[], Any]) -> Any:
    """Return a value that the report can do without; None and a note where the kernels do not give it."""
    try:
        return value()
    except KernelError as error:
        notes.append(f"{what}: {error}")
        return None


def _pointing(camera: Camera, et: float) -> CameraPointing:
    attitude = camera_attitude(camera.frame, et)
    angles = np.degrees(pointing_angles(attitude, camera.focal_from_camera))
    return CameraPointing(
        camera.name, camera.frame, attitude, quaternion_from_matrix(attitude), *(float(a) for a in angles)
    )
