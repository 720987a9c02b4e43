"""Bodies: their states, radii, names and numbers, from the open `KernelSet`."""

from dataclasses import dataclass
from typing import Literal, get_args

import spiceypy

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.spice.explain import unknown_body
from opnav_workbench.spice.guard import Request, spice_call

__all__ = ["Correction", "State", "body_gm_km3_s2", "body_id", "body_name", "body_radii_km", "state"]

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
    target, observer : str or int
        Names or NAIF numbers.
    et : float
        Time at the observer, TDB s past J2000.
    frame : str
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
    request = Request(f"state of {target} relative to {observer}", et, (target, observer), frame)
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
    with spice_call(Request(f"radii of {body}", bodies=(body,)), needs_kernels=True):
        count, values = spiceypy.bodvcd(number, "RADII", 3)
    if count != 3 or not (values > 0).all():
        raise KernelError(
            f"BODY{number}_RADII holds {values.tolist()}, not three positive km; load a correct PCK."
        )
    return readonly(values, (3,), "radii")


def body_gm_km3_s2(body: str | int) -> float:
    """Return the gravitational parameter of a body or barycenter, km^3/s^2; 0 where no loaded PCK gives it.

    Raises
    ------
    KernelError
        The body is unknown, or its GM is no positive number.
    """
    number = body_id(body)
    with spice_call(Request(f"GM of {body}", bodies=(body,)), needs_kernels=True):
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
    with spice_call(Request(f"body {name!r}", bodies=(name,))):
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
