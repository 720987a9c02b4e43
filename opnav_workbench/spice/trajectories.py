"""Trajectories of a scenario as SPK segments: tables, Kepler orbits, Sun and Earth from a series."""

import math
from datetime import UTC, datetime

import erfa
import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import MissionError
from opnav_workbench.spice.guard import spice_call
from opnav_workbench.spice.scenario import Scenario
from opnav_workbench.spice.scenario_trajectories import KeplerOrbit, ModelOrbit, StateTable
from opnav_workbench.spice.time import et_from_utc
from opnav_workbench.spice.writing import SpkSegment

__all__ = ["et_from_tdb", "spk_segments", "utc_to_et"]

AU_KM = 149597870.7  # IAU 2012
DAY_S = 86400.0
J2000_JD = 2451545.0
J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
# Light from the Sun to the edge of the planets takes 5 h, and interpolation is best away from a table's ends.
MARGIN_S = DAY_S
MODEL_STEP_S = DAY_S  # the fastest term, Earth about the Earth-Moon barycenter, takes a month
STEPS_PER_TURN = 64  # Hermite, six states: 1e-9 of the periapsis for circles, 1e-6 at eccentricity 0.7
LONGEST_STEP_S = DAY_S
MAX_STATES = 200_000  # 11 MB


def et_from_tdb(moment: datetime) -> float:
    """Return seconds past J2000 of a TDB calendar time; exact to its microsecond.

    Examples
    --------
    >>> et_from_tdb(datetime(2000, 1, 2, 12))
    86400.0
    """
    return (moment.replace(tzinfo=UTC) - J2000).total_seconds()


def utc_to_et(moment: datetime) -> float:
    """Return seconds past J2000 TDB of a UTC calendar time; needs an active `KernelSet` with an LSK."""
    return et_from_utc(moment.isoformat())


def spk_segments(scenario: Scenario) -> list[SpkSegment]:
    """Return every trajectory of a scenario, in its order; needs an active `KernelSet` with an LSK.

    Raises
    ------
    MissionError
        An orbit whose table would be too long.
    KernelError
        States that make no segment.
    """
    return [_segment(scenario, i) for i in range(len(scenario.trajectories))]


def _segment(scenario: Scenario, index: int) -> SpkSegment:
    trajectory = scenario.trajectories[index]
    target, center = (scenario.body_id(b) for b in (trajectory.target, trajectory.center))
    match trajectory:
        case StateTable():
            et, states = _tabulated(trajectory)
        case KeplerOrbit():
            et = _grid(scenario, _kepler_step(trajectory), f"trajectories.{index}.step_s")
            states = _kepler_states(trajectory, et)
        case ModelOrbit():
            et = _grid(scenario, MODEL_STEP_S, f"trajectories.{index}")
            states = _model_states(trajectory, et)
    return SpkSegment(target, center, et, states, trajectory.frame)


def _tabulated(table: StateTable) -> tuple[FloatArray, FloatArray]:
    to_et = et_from_tdb if table.time_scale == "TDB" else utc_to_et
    return np.array([to_et(row[0]) for row in table.rows]), np.array([row[1:] for row in table.rows])


def _grid(scenario: Scenario, step_s: float, field: str) -> FloatArray:
    start, end = utc_to_et(scenario.span.start) - MARGIN_S, utc_to_et(scenario.span.end) + MARGIN_S
    n = math.ceil((end - start) / step_s) + 1
    if n > MAX_STATES:
        raise MissionError(f"{field}: a table of {n} states, the limit is {MAX_STATES}; take longer steps.")
    return np.asarray(start + step_s * np.arange(n), np.float64)


def _kepler_step(orbit: KeplerOrbit) -> float:
    """Return the given step, or a fraction of the turn at periapsis speed."""
    if orbit.step_s is not None:
        return orbit.step_s
    # Angular speed at periapsis: sqrt(GM (1 + e) / q^3).
    fastest = math.sqrt(orbit.gm_km3_s2 * (1.0 + orbit.eccentricity) / orbit.periapsis_km**3)
    return min(2.0 * math.pi / fastest / STEPS_PER_TURN, LONGEST_STEP_S)


def _kepler_states(orbit: KeplerOrbit, et: FloatArray) -> FloatArray:
    angles = (orbit.inclination_deg, orbit.node_deg, orbit.argument_deg, orbit.mean_anomaly_deg)
    elements = [
        orbit.periapsis_km,
        orbit.eccentricity,
        *np.radians(angles),
        et_from_tdb(orbit.epoch),
        orbit.gm_km3_s2,
    ]
    with spice_call("Kepler orbit"):
        return np.array([spiceypy.conics(elements, t) for t in et])


def _model_states(orbit: ModelOrbit, et: FloatArray) -> FloatArray:
    heliocentric, barycentric = erfa.epv00(J2000_JD, et / DAY_S)
    earth, sun = barycentric, np.empty(barycentric.shape, barycentric.dtype)
    sun["p"], sun["v"] = earth["p"] - heliocentric["p"], earth["v"] - heliocentric["v"]
    chosen = sun if orbit.target == 10 else earth  # NAIF's ids
    return np.hstack([chosen["p"] * AU_KM, chosen["v"] * (AU_KM / DAY_S)])
