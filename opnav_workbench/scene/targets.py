"""Targets as the spacecraft sees them: solar-system bodies through SPICE, stars through their astrometry."""

from collections.abc import Callable

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState, star_target
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import KernelError
from opnav_workbench.scene.observer import Observer
from opnav_workbench.spice import body_attitude, body_radii_km, state

__all__ = ["body_target", "star_target_at"]

SUN = 10
SOLAR_SYSTEM_BARYCENTER = 0


def body_target(name: str, spacecraft: int, et: float) -> TargetState:
    """Return a solar-system body's state from the active `KernelSet`, light time removed by iteration (``CN``).

    Radii and orientation are each taken where a PCK has them; a body without radii is a point.

    Raises
    ------
    KernelError
        The ephemeris of the body or the spacecraft does not cover `et`.
    """
    seen = state(name, et, spacecraft, correction="CN")
    emitted = et - seen.light_time_s
    return TargetState(
        name=name,
        position_km=seen.position_km,
        radii_km=_if_known(lambda: body_radii_km(name)),
        body_from_j2000=_if_known(lambda: body_attitude(name, emitted)),
        sun_position_km=_sun_km(name, emitted),
        velocity_km_s=_if_known(lambda: state(name, emitted, SOLAR_SYSTEM_BARYCENTER).velocity_km_s),
    )


def _sun_km(name: str, et: float) -> FloatArray | None:
    """Return where the light that falls on a body came from; where the Sun is, if the SPKs do not reach back so far."""
    lit = _if_known(lambda: state(SUN, et, name, correction="CN").position_km)
    return lit if lit is not None else _if_known(lambda: state(SUN, et, name).position_km)


def _if_known(value: Callable[[], FloatArray]) -> FloatArray | None:
    """Return what the kernels say, None where they say nothing."""
    try:
        return value()
    except KernelError:
        return None


def star_target_at(name: str, stars: StarTable, row: int, et: float, observer: Observer) -> TargetState:
    """Return catalog row `row` of `stars` as a target: at its distance, moved to `et`, seen from the observer."""
    star = stars.take(np.array([row]))
    direction = star.directions(et, observer.position_km)[0]
    sky = star.sky_covariance(et, observer.position_km)[0]
    return star_target(
        name, direction, float(star.parallax_rad[0]), covariance_rad2=sky, magnitude=float(star.mag[0])
    )
