"""One body at an epoch: where it is, how it is lit, and how the camera sees it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import angle_between, camera_from_j2000, radec_from_unit
from opnav_workbench.kernels import SurfacePoint, body_id, state, sub_observer_point, sub_solar_point
from opnav_workbench.scene.prediction import BodyPrediction, predict_body
from opnav_workbench.scene.states import Observer, body_target
from opnav_workbench.targets import TargetState

__all__ = ["SUN", "BodyGeometry", "Viewpoint", "body_geometry"]

SUN = "SUN"


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """From where, when and how bodies are looked at.

    Attributes
    ----------
    spacecraft
        NAIF number.
    camera_from_j2000 : (3, 3) array or None
        None: the attitude is not known.
    center, frame
        What geometric states refer to.
    """

    spacecraft: int
    et: float
    observer: Observer
    camera: Camera | None
    camera_from_j2000: FloatArray | None
    center: str
    frame: str


@dataclass(frozen=True, slots=True, eq=False)
class BodyGeometry:
    """A body at an epoch; what the kernels or the missing camera do not give is nan or None.

    Attributes
    ----------
    id
        NAIF number.
    spacecraft_km, spacecraft_km_s : (3,) arrays
        Geometric state of the spacecraft relative to the body, in the report's frame.
    body_km, body_km_s : (3,) arrays
        Geometric state of the body relative to the report's center, in the report's frame.
    range_km, light_time_s
        From the spacecraft to where the light that it receives left the body.
    ra_deg, dec_deg
        Apparent J2000 direction: light time and stellar aberration.
    phase_deg
        Sun - body - spacecraft.
    elongation_deg
        Apparent angle from the Sun.
    sun_distance_km
        Of the body.
    diameter_px
        Diameter of the circle with the area of the projected limb.
    pixel, line
        Predicted place of the center.
    sub_observer, sub_solar
        Planetocentric.
    """

    name: str
    id: int
    spacecraft_km: FloatArray
    spacecraft_km_s: FloatArray
    body_km: FloatArray
    body_km_s: FloatArray
    range_km: float
    light_time_s: float
    ra_deg: float
    dec_deg: float
    phase_deg: float
    elongation_deg: float
    sun_distance_km: float
    diameter_px: float
    pixel: float
    line: float
    on_detector: bool
    sub_observer: SurfacePoint | None
    sub_solar: SurfacePoint | None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def body_geometry(name: str, view: Viewpoint) -> BodyGeometry:
    """Return the geometry of a body.

    Raises
    ------
    KernelError
        The body is unknown, or it or the Sun has no ephemeris then.
    """
    et, craft = view.et, view.spacecraft
    target, apparent = body_target(name, craft, et), state(name, et, craft, correction="CN+S")
    sun = state(SUN, et, craft, correction="CN+S").position_km
    relative, there = state(craft, et, name, view.frame), state(name, et, view.center, view.frame)
    ra, dec = (float(np.degrees(a)) for a in radec_from_unit(apparent.position_km))
    lit = target.sun_position_km
    seen = _seen(target, apparent.position_km, view)
    pixel, line = (np.nan, np.nan) if seen is None or view.camera_from_j2000 is None else seen.pixel_line
    return BodyGeometry(
        name=name,
        id=body_id(name),
        spacecraft_km=relative.position_km,
        spacecraft_km_s=relative.velocity_km_s,
        body_km=there.position_km,
        body_km_s=there.velocity_km_s,
        range_km=float(np.linalg.norm(target.position_km)),
        light_time_s=apparent.light_time_s,
        ra_deg=ra,
        dec_deg=dec,
        phase_deg=np.nan if lit is None else _degrees_between(lit, -np.asarray(target.position_km)),
        elongation_deg=_degrees_between(sun, apparent.position_km),
        sun_distance_km=np.nan if lit is None else float(np.linalg.norm(lit)),
        diameter_px=np.nan if seen is None else seen.diameter_px,
        pixel=float(pixel),
        line=float(line),
        on_detector=bool(np.isfinite(pixel)) and seen is not None and seen.on_detector,
        sub_observer=_if_known(lambda: sub_observer_point(name, et, craft)),
        sub_solar=_if_known(lambda: sub_solar_point(name, et, craft)),
    )


def _seen(target: TargetState, direction: FloatArray, view: Viewpoint) -> BodyPrediction | None:
    """Predict the body on the detector; with no attitude known, as if the camera were held on it."""
    if view.camera is None:
        return None
    held = camera_from_j2000(*radec_from_unit(direction), 0.0, view.camera.focal_from_camera)
    attitude = held if view.camera_from_j2000 is None else view.camera_from_j2000
    return predict_body(target, view.observer, view.camera, attitude)


def _degrees_between(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(angle_between(a, b)))


def _if_known(point: Callable[[], SurfacePoint]) -> SurfacePoint | None:
    try:
        return point()
    except KernelError:
        return None
