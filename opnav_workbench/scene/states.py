"""The two ends of a line of sight as values: the spacecraft that observes, and the targets it sees.

The observer's state with respect to the solar-system barycenter comes from kernels or from the image header; targets are
solar-system bodies through SPICE, where their light left them, or stars through their astrometry.

Frame  J2000
Units  km, km/s, rad
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.catalog import StarTable
from opnav_workbench.constants import SOLAR_SYSTEM_BARYCENTER_ID, SUN_ID
from opnav_workbench.errors import KernelError
from opnav_workbench.image import Picture, barycentric_from_heliocentric, unknown_velocity_sigma_km_s
from opnav_workbench.kernels import body_attitude, body_radii_km, state
from opnav_workbench.targets import TargetState, star_target

__all__ = [
    "Observer",
    "body_target",
    "observer_from_header",
    "observer_from_kernels",
    "star_target_at",
]


# ---- Where the spacecraft is and how fast it moves, with respect to the solar-system barycenter.


@dataclass(frozen=True, slots=True, eq=False)
class Observer:
    """The spacecraft's barycentric state: what aberration and parallax need.

    Attributes
    ----------
    position_km, velocity_km_s : (3,) arrays
        With respect to the solar-system barycenter, J2000.
    source
        "kernels", "header" or "unknown", for the record.
    velocity_sigma_km_s
        Of each axis, where the velocity is not known; 0 where it is.
    """

    position_km: FloatArray
    velocity_km_s: FloatArray
    source: str
    velocity_sigma_km_s: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self, in_file_order=True)


def observer_from_kernels(spacecraft: int, et: float) -> Observer:
    """Read the spacecraft's barycentric state from the active `KernelSet`.

    Raises
    ------
    KernelError
        No kernel set is active, or its SPKs do not cover the spacecraft at `et`.
    """
    geometric = state(spacecraft, et, SOLAR_SYSTEM_BARYCENTER_ID)
    return Observer(geometric.position_km, geometric.velocity_km_s, "kernels")


def observer_from_header(picture: Picture, et: float) -> Observer:
    """Take the spacecraft's state from the image header (Sun vector there, Sun about the barycenter from ERFA).

    What the header does not say is at rest, or at the barycenter, with the sigma of a velocity that may be any.
    """
    geometry = picture.header_geometry
    if geometry is None or geometry.spacecraft_from_sun_km is None:
        return Observer(np.zeros(3), np.zeros(3), "unknown", unknown_velocity_sigma_km_s())
    place = np.asarray(geometry.spacecraft_from_sun_km)
    told, sigma = geometry.spacecraft_velocity_km_s, geometry.velocity_sigma_km_s
    if told is None:
        told, sigma = np.zeros(3), unknown_velocity_sigma_km_s(float(np.linalg.norm(place)))
    position, velocity = barycentric_from_heliocentric(place, np.asarray(told), et)
    return Observer(position, velocity, "header", sigma)


# ---- Targets as the spacecraft sees them: solar-system bodies through SPICE, stars through their astrometry.


def body_target(name: str, spacecraft: int, et: float) -> TargetState:
    """Return a solar-system body's state from the active `KernelSet`: where it was when the light left (``CN``).

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
        velocity_km_s=_if_known(lambda: state(name, emitted, SOLAR_SYSTEM_BARYCENTER_ID).velocity_km_s),
    )


def _sun_km(name: str, et: float) -> FloatArray | None:
    """Return where the light that falls on a body came from; where the Sun is, if the SPKs do not reach back so far."""
    lit = _if_known(lambda: state(SUN_ID, et, name, correction="CN").position_km)
    return lit if lit is not None else _if_known(lambda: state(SUN_ID, et, name).position_km)


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
