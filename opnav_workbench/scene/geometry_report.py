"""The geometry of an epoch: times, states, attitude, and each body as the camera sees it.

"ET, UTC, spacecraft state with respect to any body or frame origin, body state, spacecraft attitude quaternion,
camera-to-inertial matrix, and the camera boresight vector and twist angle" (AAS 13-443), and what an analyst asks next.
Angles are in degrees here: a person reads them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy.table import QTable

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import pointing_angles, quaternion_from_matrix
from opnav_workbench.scene import geometry_text
from opnav_workbench.scene.body_geometry import SUN, BodyGeometry, View, body_geometry
from opnav_workbench.scene.observer import observer_from_kernels
from opnav_workbench.spice import body_id, body_name, camera_attitude, sclk_from_et, state, utc_from_et

__all__ = ["CameraPointing", "GeometryReport", "geometry_report"]

UTC_DECIMALS = 3


@dataclass(frozen=True, slots=True, eq=False)
class CameraPointing:
    """A camera's attitude at an epoch.

    Attributes
    ----------
    camera, frame : str
        Name and SPICE frame.
    camera_from_j2000 : (3, 3) array
        ``v_camera = camera_from_j2000 @ v_j2000``.
    quaternion_camera_from_j2000 : (4,) array
        The same as a SPICE quaternion, scalar first.
    ra_deg, dec_deg, twist_deg : float
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
    et : float
        TDB s past J2000.
    utc : str
    sclk : str or None
        Reading of the spacecraft clock.
    spacecraft : str
    center : str
        Body that the states refer to.
    frame : str
        Frame of the states.
    spacecraft_km, spacecraft_km_s : (3,) arrays
        Geometric state of the spacecraft relative to the center.
    pointing : CameraPointing or None
    bodies : tuple of BodyGeometry
    notes : tuple of str
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
        return geometry_text.table(self)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON; what is not known is None."""
        return geometry_text.plain(self)

    def text(self) -> str:
        """Return everything as text, one column per body."""
        return geometry_text.text(self)

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
    et : float
        Time at the spacecraft, TDB s past J2000.
    spacecraft : str or int
        SPICE name or NAIF number.
    bodies : sequence of str
        SPICE names.
    camera : Camera, optional
        For attitude, sizes and places on the detector. Where no CK covers `et`, sizes are those of a body in the
        middle of the field, places are nan, and a note says why.
    clock_id : int, optional
        Spacecraft clock; none: no clock reading.
    center : str
        Body that states refer to.
    frame : str
        SPICE frame of the states.

    Raises
    ------
    KernelError
        No kernels are open, a name is unknown, or spacecraft, center or a body have no ephemeris at `et`.

    Examples
    --------
    >>> from opnav_workbench.mission import load_mission
    >>> from opnav_workbench.spice import KernelSet, et_from_utc
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
    view = View(
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
