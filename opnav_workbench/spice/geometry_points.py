"""Points on a body's reference ellipsoid: below the observer and below the Sun."""

import math
from dataclasses import dataclass

import spiceypy

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.spice.attitude import body_frame
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.states import Correction

__all__ = ["SurfacePoint", "sub_observer_point", "sub_solar_point"]

METHOD = "INTERCEPT/ELLIPSOID"  # on the line to the body's center: what stands in the middle of its disk


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoint:
    """A point on a body.

    Attributes
    ----------
    lon_deg : float
        Planetocentric, toward east, 0 to 360.
    lat_deg : float
        Planetocentric.
    position_km : (3,) array
        From the body's center, in its own frame.
    """

    lon_deg: float
    lat_deg: float
    position_km: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def sub_observer_point(
    body: str | int, et: float, observer: str | int, correction: Correction = "CN+S"
) -> SurfacePoint:
    """Return the point in the middle of a body's disk, as light received at `et` shows it.

    Parameters
    ----------
    body, observer : str or int
        Names or NAIF numbers.
    et : float
        Time at the observer, TDB s past J2000.
    correction : {"NONE", "LT", "CN", "LT+S", "CN+S"}

    Raises
    ------
    KernelError
        Radii, orientation or ephemeris of the body are missing.

    Notes
    -----
    CSPICE ``subpnt`` with ``INTERCEPT/ELLIPSOID``.
    """
    frame = body_frame(body)
    request = Request(f"sub-observer point on {body}", et, (body, observer), frame)
    with spice_call(request, needs_kernels=True):
        point, _, _ = spiceypy.subpnt(METHOD, str(body), et, frame, correction, str(observer))
        return _surface_point(point)


def sub_solar_point(
    body: str | int, et: float, observer: str | int, correction: Correction = "CN+S"
) -> SurfacePoint:
    """Return the point of a body that has the Sun overhead, as light received at `et` shows it.

    Parameters and failures as of `sub_observer_point`; CSPICE ``subslr``.
    """
    frame = body_frame(body)
    request = Request(f"sub-solar point on {body}", et, (body, observer, "SUN"), frame)
    with spice_call(request, needs_kernels=True):
        point, _, _ = spiceypy.subslr(METHOD, str(body), et, frame, correction, str(observer))
        return _surface_point(point)


def _surface_point(point_km: FloatArray) -> SurfacePoint:
    _, lon, lat = spiceypy.reclat(point_km)
    return SurfacePoint(math.degrees(lon) % 360.0, math.degrees(lat), point_km)
