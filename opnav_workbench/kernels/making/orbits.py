"""Orbits of a scenario from elements or one state: unperturbed conics, and arcs integrated with forces and maneuvers.

A conic is a periapsis distance, eccentricity and angles (CSPICE ``conics``: universal variables, so ellipse, parabola
and hyperbola alike). An integrated orbit takes initial state, perturbers, light pressure and maneuvers as the file says
them, and gives its ballistic pieces in J2000.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import AU_KM, DAY_S, SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_KM_S, SUN_ID
from opnav_workbench.errors import MissionError
from opnav_workbench.kernels.calls import spice_call
from opnav_workbench.kernels.making.forces import PLANETS, ForceModel, PointMass
from opnav_workbench.kernels.making.nbody import Impulse, OrbitArc, propagate
from opnav_workbench.kernels.making.scenario import (
    ElementsOrbit,
    Epoch,
    Forces,
    KeplerOrbit,
    PropagatedOrbit,
    Scenario,
)
from opnav_workbench.kernels.time import et_from_jd, et_from_tdb_datetime, et_from_utc_datetime

__all__ = ["conic_elements", "conic_states", "epoch_et", "propagated_arcs"]


# ---- Unperturbed orbits: states from periapsis distance, eccentricity and angles.


def epoch_et(epoch: Epoch) -> float:
    """Return seconds past J2000 of an epoch given as TDB calendar time or Julian date."""
    return et_from_jd(epoch) if isinstance(epoch, float) else et_from_tdb_datetime(epoch)


def conic_elements(orbit: KeplerOrbit | ElementsOrbit, gm_km3_s2: float) -> list[float]:
    """Return SPICE's eight elements: km, rad, s, km^3/s^2."""
    et = epoch_et(orbit.epoch)
    if isinstance(orbit, KeplerOrbit):
        periapsis_km, anomaly = orbit.periapsis_km, math.radians(orbit.mean_anomaly_deg)
    else:
        periapsis_km = _perihelion_km(orbit)
        if orbit.mean_anomaly_deg is not None:
            anomaly = math.radians(orbit.mean_anomaly_deg)
        else:
            assert orbit.perihelion_time is not None  # the scenario has looked
            anomaly = _mean_motion(periapsis_km, orbit.eccentricity, gm_km3_s2) * (
                et - epoch_et(orbit.perihelion_time)
            )
    angles = (orbit.inclination_deg, orbit.node_deg, orbit.argument_deg)
    return [periapsis_km, orbit.eccentricity, *np.radians(angles), anomaly, et, gm_km3_s2]


def conic_states(elements: list[float], et: FloatArray) -> FloatArray:
    """Return states (n, 6), km and km/s, of an unperturbed orbit at epochs (n,)."""
    with spice_call("two-body orbit"):
        return np.array([spiceypy.conics(elements, t) for t in et])


def _perihelion_km(orbit: ElementsOrbit) -> float:
    if orbit.perihelion_au is not None:
        return orbit.perihelion_au * AU_KM
    assert orbit.semi_major_axis_au is not None  # the scenario has looked
    return orbit.semi_major_axis_au * (1.0 - orbit.eccentricity) * AU_KM


def _mean_motion(periapsis_km: float, eccentricity: float, gm_km3_s2: float) -> float:
    """Return what SPICE's mean anomaly grows by, rad/s; on a parabola it counts with twice the periapsis cubed."""
    axis_km = 2.0 ** (1 / 3) * periapsis_km if eccentricity == 1.0 else periapsis_km / abs(1.0 - eccentricity)
    return math.sqrt(gm_km3_s2 / axis_km**3)


# ---- Propagated trajectories of a scenario: initial state and forces as the file says them, for `nbody`.

# Solar constant over the speed of light, in kN/m^2: km/s^2 on 1 m^2 and 1 kg.
RADIATION_KPA = SOLAR_CONSTANT_W_M2 / (SPEED_OF_LIGHT_KM_S * 1e3) * 1e-3
EARTH_SYSTEM = {3, 301, 399}  # the barycenter is not a third body beside its two
# Other names of the same masses, for lists of perturbers.
SINGLE_PLANETS = (replace(PLANETS[1], body=199), replace(PLANETS[2], body=299))
EARTH_AND_MOON = PointMass(3, 403503.23562548, 6378.1366)


def propagated_arcs(
    scenario: Scenario, orbit: PropagatedOrbit | ElementsOrbit, span_et: tuple[float, float]
) -> tuple[OrbitArc, ...]:
    """Return the ballistic pieces of a propagated trajectory; states are J2000.

    Needs an active `KernelSet` with the bodies' SPKs.

    Raises
    ------
    MissionError
        A perturber's mass is not known.
    ValueError
        The orbit runs into a body, or the integration fails.
    KernelError
        A body's position is not covered.
    """
    target = scenario.body_id(orbit.target)
    center = scenario.body_id(orbit.center)
    et = epoch_et(orbit.epoch)
    j2000_from_frame = _to_j2000(orbit.frame, et)
    impulses = [
        Impulse(
            et_from_utc_datetime(m.epoch),
            tuple(_to_j2000(orbit.frame, et_from_utc_datetime(m.epoch))[:3, :3] @ m.delta_v_m_s * 1e-3),
        )
        for m in orbit.maneuvers
    ]
    state = j2000_from_frame @ _initial_state(orbit, et)
    return propagate(state, et, span_et, _force_model(scenario, orbit, target, center), impulses)


def _initial_state(orbit: PropagatedOrbit | ElementsOrbit, et: float) -> FloatArray:
    if isinstance(orbit, PropagatedOrbit):
        scale = (1.0, 1.0) if orbit.units == "km" else (AU_KM, AU_KM / DAY_S)
        return np.asarray(np.asarray(orbit.state) * np.repeat(scale, 3))
    return np.asarray(conic_states(conic_elements(orbit, PLANETS[0].gm_km3_s2), np.array([et]))[0])


def _to_j2000(frame: str, et: float) -> FloatArray:
    with spice_call(f"frame {frame}"):
        return np.asarray(spiceypy.sxform(frame, "J2000", et))


def _force_model(scenario: Scenario, forces: Forces, target: int, center: int) -> ForceModel:
    light = forces.radiation
    model = ForceModel(
        center=center,
        masses=tuple(_masses(scenario, forces, target)),
        relativity=forces.relativity and target != SUN_ID,
        transverse_km_s2=forces.transverse_au_d2 * AU_KM / DAY_S**2,
        tolerance=forces.tolerance,
    )
    if light is None:
        return model
    return replace(model, radiation_km_s2=light.reflectivity * RADIATION_KPA * light.area_m2 / light.mass_kg)


def _masses(scenario: Scenario, forces: Forces, target: int) -> Iterable[PointMass]:
    planets = {p.body: p for p in (*PLANETS, *SINGLE_PLANETS, EARTH_AND_MOON)}
    excluded = EARTH_SYSTEM if target == 3 else {target}
    if forces.perturbers is None:
        yield from (p for p in PLANETS if p.body not in excluded)
        return
    own = {b.id: b for b in scenario.bodies}
    for reference in forces.perturbers:
        body = scenario.body_id(reference)
        if body in excluded:
            continue
        known = planets.get(body)
        gm = own[body].gm_km3_s2 if body in own else None
        radii = own[body].radii_km if body in own else None
        if gm is None and known is None:
            raise MissionError(f"the perturber {reference} has no gm_km3_s2; add it to the body")
        yield PointMass(
            body,
            gm if gm is not None else known.gm_km3_s2,  # type: ignore[union-attr]  # one of the two is there
            min(radii) if radii else known.radius_km if known else 0.0,
        )
