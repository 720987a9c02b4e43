"""Unperturbed orbits: states from periapsis distance, eccentricity and angles.

Source: CSPICE ``conics`` (universal variables: ellipse, parabola and hyperbola alike).
"""

import math

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.spice.epochs import AU_KM, et_from_jd, et_from_tdb
from opnav_workbench.spice.guard import spice_call
from opnav_workbench.spice.scenario_trajectories import ElementsOrbit, Epoch, KeplerOrbit

__all__ = ["conic", "conic_states", "epoch_et"]


def epoch_et(epoch: Epoch) -> float:
    """Return seconds past J2000 of an epoch given as TDB calendar time or Julian date."""
    return et_from_jd(epoch) if isinstance(epoch, float) else et_from_tdb(epoch)


def conic(orbit: KeplerOrbit | ElementsOrbit, gm_km3_s2: float) -> list[float]:
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
