"""Targets as the spacecraft sees them: solar-system bodies through SPICE, stars through their astrometry."""

import numpy as np

from opnav_workbench.bodies import TargetState, star_target
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import KernelError
from opnav_workbench.scene.observer import Observer
from opnav_workbench.spice import body_attitude, body_radii_km, state

__all__ = ["body_target", "star_target_at"]

SUN = 10


def body_target(name: str, spacecraft: int, et: float) -> TargetState:
    """Return a solar-system body's state from the active `KernelSet`, light time removed by iteration (``CN``).

    Radii and orientation are taken where a PCK has them; a body without them is a point.

    Raises
    ------
    KernelError
        The ephemeris of the body or the spacecraft does not cover `et`.
    """
    seen = state(name, et, spacecraft, correction="CN")
    emitted = et - seen.light_time_s
    try:
        radii = body_radii_km(name)
        attitude = body_attitude(name, emitted)
    except KernelError:
        radii, attitude = None, None
    try:
        sun = state(SUN, emitted, name).position_km
    except KernelError:
        sun = None
    return TargetState(
        name=name,
        position_km=seen.position_km,
        radii_km=radii,
        body_from_j2000=attitude,
        sun_position_km=sun,
    )


def star_target_at(name: str, stars: StarTable, row: int, et: float, observer: Observer) -> TargetState:
    """Return catalog row `row` of `stars` as a target: at its distance, moved to `et`, seen from the observer."""
    star = stars.take(np.array([row]))
    direction = star.directions(et, observer.position_km)[0]
    sky = star.sky_covariance(et, observer.position_km)[0]
    return star_target(
        name, direction, float(star.parallax_rad[0]), covariance_rad2=sky, magnitude=float(star.mag[0])
    )
