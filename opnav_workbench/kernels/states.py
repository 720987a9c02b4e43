"""Bodies as the open kernels know them: states, sizes, masses, names, orientation, and points on their ellipsoids.

States are km and km/s; times are TDB s past J2000 at the observer; attitudes are ``body_from_j2000``. The points below
the observer and below the Sun lie on the line to the body's center (CSPICE ``INTERCEPT/ELLIPSOID``), in planetocentric
longitude toward east and latitude.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.calls import SpiceRequest, spice_call, unknown_body
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "State",
    "SurfacePoint",
    "body_attitude",
    "body_frame",
    "body_gm_km3_s2",
    "body_id",
    "body_name",
    "body_periodic_terms",
    "body_radii_km",
    "state",
    "sub_observer_point",
    "sub_solar_point",
    "two_body_state",
]


# ---- Bodies: their states, radii, names and numbers, from the open `KernelSet`.

Correction = Literal["NONE", "LT", "CN", "LT+S", "CN+S"]
LARGEST_ID = 2**31 - 1  # SPICE's integers; a larger one would wrap around


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Position and velocity of a target relative to an observer."""

    position_km: FloatArray  # (3,) observer to target
    velocity_km_s: FloatArray  # (3,)
    light_time_s: float  # one way, target to observer

    def __post_init__(self) -> None:
        freeze_arrays(self)


def state(
    target: str | int, et: float, observer: str | int, frame: str = "J2000", correction: Correction = "NONE"
) -> State:
    """Return the state of a target relative to an observer.

    Parameters
    ----------
    target, observer
        Names or NAIF numbers.
    et
        Time at the observer, TDB s past J2000.
    frame
        Frame of the result.
    correction : {"NONE", "LT", "CN", "LT+S", "CN+S"}
        Light time (LT one iteration, CN converged) and stellar aberration (S), for light received at `et`.

    Raises
    ------
    KernelError
        A body or the frame is unknown, or no loaded SPK covers the bodies then.

    Notes
    -----
    CSPICE ``spkezr``. Light-time corrections need both bodies relative to the solar system barycenter.
    """
    if correction not in get_args(Correction):
        raise KernelError(
            f"aberration correction {correction!r} is unknown; use {', '.join(get_args(Correction))}."
        )
    request = SpiceRequest(f"state of {target} relative to {observer}", et, (target, observer), frame)
    with spice_call(request, needs_kernels=True):
        values, light_time_s = spiceypy.spkezr(str(target), et, frame, correction, str(observer))
    return State(values[:3], values[3:], float(light_time_s))


def body_radii_km(body: str | int) -> FloatArray:
    """Return the semi-axes of a body along its x, y, z, km, shape (3,).

    Raises
    ------
    KernelError
        The body is unknown, or no loaded PCK gives its three radii.
    """
    number = body_id(body)
    with spice_call(SpiceRequest(f"radii of {body}", bodies=(body,)), needs_kernels=True):
        count, values = spiceypy.bodvcd(number, "RADII", 3)
    if count != 3 or not (values > 0).all():
        raise KernelError(
            f"BODY{number}_RADII holds {values.tolist()}, not three positive km; load a correct PCK."
        )
    return readonly(values, (3,), "radii")


def body_periodic_terms(body: str | int) -> dict[str, int]:
    """Return how many periodic terms the loaded PCKs give pole and prime meridian of a body, by the variable's name.

    A kernel that replaces the rotation must replace these, too: SPICE adds them to whatever pole it finds.

    Raises
    ------
    KernelError
        The body is unknown.
    """
    number, found = body_id(body), {}
    with spice_call(SpiceRequest(f"periodic terms of {body}", bodies=(body,)), needs_kernels=True):
        for item in ("NUT_PREC_RA", "NUT_PREC_DEC", "NUT_PREC_PM"):
            if spiceypy.bodfnd(number, item):
                found[f"BODY{number}_{item}"] = int(spiceypy.bodvcd(number, item, MOST_PERIODIC_TERMS)[0])
    return found


def body_gm_km3_s2(body: str | int) -> float:
    """Return the gravitational parameter of a body or barycenter, km^3/s^2; 0 where no loaded PCK gives it.

    Raises
    ------
    KernelError
        The body is unknown, or its GM is no positive number.
    """
    number = body_id(body)
    with spice_call(SpiceRequest(f"GM of {body}", bodies=(body,)), needs_kernels=True):
        if not spiceypy.bodfnd(number, "GM"):
            return 0.0
        count, values = spiceypy.bodvcd(number, "GM", 1)
    if count != 1 or not values[0] > 0:
        raise KernelError(
            f"BODY{number}_GM holds {values.tolist()}, not a positive km^3/s^2; load a correct PCK."
        )
    return float(values[0])


def body_id(name: str | int) -> int:
    """Return the NAIF number of a body given by name or number.

    Raises
    ------
    KernelError
        Nobody knows the name.

    Examples
    --------
    >>> body_id("Pluto"), body_id(-98), body_id("-98")
    (999, -98, -98)
    """
    with spice_call(SpiceRequest(f"body {name!r}", bodies=(name,))):
        try:
            return int(spiceypy.bods2c(str(name)))
        except spiceypy.NotFoundError as error:
            cause, remedy = unknown_body([name])
            raise KernelError(f"the body {cause}; {remedy}.") from error


def body_name(number: int) -> str:
    """Return the name of a NAIF number, or the number as text where it has none.

    Examples
    --------
    >>> body_name(901), body_name(-123456)
    ('CHARON', '-123456')
    """
    if abs(number) > LARGEST_ID:
        return str(number)
    with spice_call(f"name of body {number}"):
        return str(spiceypy.bodc2s(number))


# ---- Attitudes of cameras and of bodies, from the open `KernelSet`.


def body_attitude(body: str | int, et: float) -> FloatArray:
    """Return ``body_from_j2000``, shape (3, 3), in the body's own frame (see `body_frame`).

    Raises
    ------
    KernelError
        The body or its frame is unknown, or no loaded PCK orients it.
    """
    frame = body_frame(body)
    request = SpiceRequest(f"attitude of {body} ({frame})", et, (body,), frame)
    with spice_call(request, needs_kernels=True):
        return readonly(spiceypy.pxform("J2000", frame, et), (3, 3), "body_from_j2000")


def body_frame(body: str | int) -> str:
    """Return the body-fixed frame of a body.

    The frame that a kernel ties to it (``OBJECT_<id>_FRAME``), or SPICE's own IAU frame, or one named
    IAU_<BODY>.

    Raises
    ------
    KernelError
        The body is unknown or has no such frame.
    """
    number = body_id(body)
    fallback = f"IAU_{body_name(number)}".replace(" ", "_")
    with spice_call(SpiceRequest(f"frame of {body}", bodies=(body,)), needs_kernels=True):
        try:
            return str(spiceypy.cidfrm(number)[1])
        except spiceypy.NotFoundError as error:
            if spiceypy.namfrm(fallback):
                return fallback
            raise KernelError(
                f"{body} ({number}) has no body-fixed frame; load the FK or PCK that gives "
                f"OBJECT_{number}_FRAME or defines {fallback}."
            ) from error


# ---- Points on a body's reference ellipsoid: below the observer and below the Sun.

MOST_PERIODIC_TERMS = 100  # what SPICE's own readers take
METHOD = "INTERCEPT/ELLIPSOID"  # on the line to the body's center: what stands in the middle of its disk


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoint:
    """A point on a body.

    Attributes
    ----------
    lon_deg
        Planetocentric, toward east, 0 to 360.
    lat_deg
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
    body, observer
        Names or NAIF numbers.
    et
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
    request = SpiceRequest(f"sub-observer point on {body}", et, (body, observer), frame)
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
    request = SpiceRequest(f"sub-solar point on {body}", et, (body, observer, "SUN"), frame)
    with spice_call(request, needs_kernels=True):
        point, _, _ = spiceypy.subslr(METHOD, str(body), et, frame, correction, str(observer))
        return _surface_point(point)


def _surface_point(point_km: FloatArray) -> SurfacePoint:
    _, lon, lat = spiceypy.reclat(point_km)
    return SurfacePoint(math.degrees(lon) % 360.0, math.degrees(lat), point_km)


# ---- Unperturbed motion about one mass; no kernel is needed.


def two_body_state(values: FloatArray, gm_km3_s2: float, time_s: float) -> FloatArray:
    """Return the state (6,), km and km/s, relative to the center, a time later (CSPICE ``prop2b``).

    Raises
    ------
    KernelError
        SPICE knows no conic through the state: no mass, no velocity, or motion straight toward the center.

    Examples
    --------
    A quarter of a circle.

    >>> quarter = 0.5 * math.pi * math.sqrt(7000.0**3 / 398600.0)
    >>> later = two_body_state([7000.0, 0, 0, 0, math.sqrt(398600.0 / 7000.0), 0], 398600.0, quarter)
    >>> later[:3].round(6).tolist()
    [0.0, 7000.0, 0.0]
    """
    with spice_call("two-body motion"):
        return np.asarray(spiceypy.prop2b(gm_km3_s2, np.array(values, np.float64), time_s), np.float64)
