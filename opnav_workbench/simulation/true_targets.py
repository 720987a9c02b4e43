"""Where spacecraft and bodies truly are, when the kernels that the navigator has are wrong by a known amount.

An offset of a barycenter moves everything that belongs to it. Light then takes longer or shorter, and the body is seen
where it was at that other time.
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.geometry import SPEED_OF_LIGHT_KM_S, unit
from opnav_workbench.scene import Observer, body_target, observer_from_kernels
from opnav_workbench.simulation.scenario_parts import BodyOffset, Perturbations
from opnav_workbench.spice import body_id, state

__all__ = ["true_observer", "true_target"]

SUN = 10
SOLAR_SYSTEM_BARYCENTER = 0
LAST_BARYCENTER = 9  # NAIF: 1..9 are the barycenters of the planets' systems
SYSTEM_SIZE = 100  # NAIF: 901..999 belong to barycenter 9


def true_observer(spacecraft: int, et: float, truth: Perturbations) -> Observer:
    """Return the spacecraft's true barycentric state.

    Raises
    ------
    KernelError
        The active kernels do not cover the spacecraft.
    """
    known = observer_from_kernels(spacecraft, et)
    offset = truth.spacecraft
    return replace(
        known,
        position_km=known.position_km + np.array(offset.position_km),
        velocity_km_s=known.velocity_km_s + np.array(offset.velocity_km_s),
    )


def true_target(name: str, spacecraft: int, et: float, truth: Perturbations) -> TargetState:
    """Return a body's true state as the spacecraft truly sees it, light time removed.

    Raises
    ------
    KernelError
        A body is unknown or not covered by the active kernels.
    """
    known = body_target(name, spacecraft, et)
    body = body_offset_km(name, et, truth.bodies)
    moved = known.position_km + body - np.array(truth.spacecraft.position_km)
    if not (body.any() or any(truth.spacecraft.position_km)):
        return known
    later_s = (np.linalg.norm(moved) - known.range_km) / SPEED_OF_LIGHT_KM_S
    moved = moved - later_s * state(name, et, SOLAR_SYSTEM_BARYCENTER).velocity_km_s
    sun = None if known.sun_position_km is None else known.sun_position_km - body
    return replace(known, position_km=moved, sun_position_km=sun)


def body_offset_km(name: str, et: float, offsets: tuple[BodyOffset, ...]) -> FloatArray:
    """Return the sum (3,) of all offsets that move a body, J2000."""
    number = body_id(name)
    moving = [offset for offset in offsets if _moves(body_id(offset.name), number)]
    return np.asarray(np.sum([np.zeros(3), *(_vector_km(offset, et) for offset in moving)], axis=0))


def _moves(moved: int, body: int) -> bool:
    return moved == body or (0 < moved <= LAST_BARYCENTER and body // SYSTEM_SIZE == moved)


def _vector_km(offset: BodyOffset, et: float) -> FloatArray:
    along_sun = np.zeros(3)
    if offset.toward_sun_km:
        along_sun = offset.toward_sun_km * unit(state(SUN, et, offset.name).position_km)
    return np.asarray(np.array(offset.offset_km) + along_sun)
