"""Trajectories of a scenario as SPK segments, each kind by its own means.

Bodies come before the spacecraft, and each in the order of the file: what a propagated trajectory refers to stands
before it, or in the planetary ephemeris.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.spice.epochs import AU_KM, DAY_S, J2000_JD, et_from_tdb, utc_to_et
from opnav_workbench.spice.excerpts import SpkExcerpt, excerpts
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.kernels import KernelSet
from opnav_workbench.spice.planets import PLANETS, planet_ephemeris
from opnav_workbench.spice.propagated import propagated_arcs
from opnav_workbench.spice.sampling import MAX_STATES, sampled
from opnav_workbench.spice.scenario import Scenario
from opnav_workbench.spice.scenario_trajectories import (
    ElementsOrbit,
    EphemerisExcerpt,
    KeplerOrbit,
    ModelOrbit,
    PropagatedOrbit,
    StateFile,
    StateTable,
    Trajectory,
)
from opnav_workbench.spice.trajectory_tables import read_states, table_states
from opnav_workbench.spice.two_body import conic, conic_states
from opnav_workbench.spice.writing import SpkSegment, write_spk

__all__ = ["Segment", "Workplace", "et_from_tdb", "spk_segments", "utc_to_et"]

# Light from the Sun to the edge of the planets takes 5 h, and interpolation is best away from a table's ends.
MARGIN_S = DAY_S
LONGEST_STEP_S = {13: 4.0 * DAY_S, 9: DAY_S}  # to begin with; what is too long is halved

Segment = SpkSegment | SpkExcerpt
States = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Workplace:
    """Where a scenario's kernels are made."""

    folder: Path  # of the scenario: files that it names stand there
    kernels: tuple[Path, ...]  # LSK and the other text kernels that exist already
    scratch: Path  # takes files that nobody needs afterwards


def spk_segments(scenario: Scenario, place: Workplace) -> list[tuple[int, Segment]]:
    """Return every trajectory of a scenario as segments, each with the trajectory's place in the file.

    Raises
    ------
    MissionError
        A trajectory that cannot be made; the message names it.
    """
    numbers = range(len(scenario.trajectories))
    of_spacecraft = [
        scenario.body_id(scenario.trajectories[i].target) == scenario.spacecraft.id for i in numbers
    ]
    done: list[tuple[int, Segment]] = []
    for i in sorted(numbers, key=lambda i: of_spacecraft[i]):
        with _naming_field(scenario, i), _ephemerides(scenario.trajectories[i], place, [s for _, s in done]):
            done += [(i, s) for s in _segments(scenario, scenario.trajectories[i], place)]
    return done


@contextlib.contextmanager
def _naming_field(scenario: Scenario, index: int) -> Iterator[None]:
    target = scenario.trajectories[index].target
    try:
        yield
    except (ValueError, KernelError, MissionError) as error:
        reason = str(error).rstrip(".")
        raise MissionError(f"scenario: trajectories.{index} ({target}): {reason}.") from error


@contextlib.contextmanager
def _ephemerides(trajectory: Trajectory, place: Workplace, done: Sequence[Segment]) -> Iterator[None]:
    """Load the text kernels and, for what needs it, the planets and the trajectories made so far."""
    files = list(place.kernels)
    excerpt = isinstance(trajectory, EphemerisExcerpt) and trajectory.center is None  # copied, not computed
    if isinstance(trajectory, PropagatedOrbit | ElementsOrbit | EphemerisExcerpt) and not excerpt:
        files.append(planet_ephemeris())
        if done:
            files.append(place.scratch / "made_so_far.bsp")
            write_spk(files[-1], done)
    if isinstance(trajectory, EphemerisExcerpt) and trajectory.file is not None and not excerpt:
        files.append(_spk_file(trajectory, place))
    with KernelSet(files):
        yield


def _segments(scenario: Scenario, trajectory: Trajectory, place: Workplace) -> Sequence[Segment]:
    span = _span(scenario, trajectory)
    match trajectory:
        case StateTable():
            return [_table(scenario, trajectory, *table_states(trajectory))]
        case StateFile():
            names = scenario.names_of(scenario.body_id(trajectory.target))
            return [_table(scenario, trajectory, *read_states(place.folder, trajectory.file, names))]
        case KeplerOrbit(step_s=step_s) if step_s is not None:
            et = _grid(span, step_s)
            return [_segment(scenario, trajectory, et, _kepler(trajectory)(et), span)]
        case KeplerOrbit():
            return [_sampled(scenario, trajectory, span, _kepler(trajectory))]
        case ModelOrbit():
            return [_sampled(scenario, trajectory, span, _model(trajectory))]
        case ElementsOrbit(propagation="two_body"):
            elements = conic(trajectory, PLANETS[0].gm_km3_s2)
            return [_sampled(scenario, trajectory, span, lambda et: conic_states(elements, et))]
        case EphemerisExcerpt(center=None):
            source = planet_ephemeris() if trajectory.file is None else _spk_file(trajectory, place)
            return excerpts(source, scenario.body_id(trajectory.target), *span)
        case EphemerisExcerpt():
            return [_sampled(scenario, trajectory, span, _ephemeris(scenario, trajectory))]
        case _:
            return [
                _sampled(scenario, trajectory, (arc.start_et, arc.end_et), arc.states, frame="J2000")
                for arc in propagated_arcs(scenario, trajectory, span)
            ]


def _span(scenario: Scenario, trajectory: Trajectory) -> tuple[float, float]:
    start = (
        utc_to_et(scenario.span.start) - MARGIN_S if trajectory.start is None else utc_to_et(trajectory.start)
    )
    end = utc_to_et(scenario.span.end) + MARGIN_S if trajectory.end is None else utc_to_et(trajectory.end)
    if end <= start:
        raise MissionError("start and end leave nothing of the scenario's span")
    return start, end


def _segment(
    scenario: Scenario,
    trajectory: Trajectory,
    et: FloatArray,
    states: FloatArray,
    span: tuple[float, float] | None = None,
    frame: str | None = None,
) -> SpkSegment:
    target = scenario.body_id(trajectory.target)
    assert trajectory.center is not None  # excerpts are no tables
    return SpkSegment(
        target,
        scenario.body_id(trajectory.center),
        et,
        states,
        frame or trajectory.frame,
        "hermite" if trajectory.spk_type == 13 else "lagrange",
        span,
    )


def _table(scenario: Scenario, trajectory: Trajectory, et: FloatArray, states: FloatArray) -> SpkSegment:
    """Return a table as it is, serving the part between `start` and `end`."""
    first = et[0] if trajectory.start is None else max(et[0], utc_to_et(trajectory.start))
    last = et[-1] if trajectory.end is None else min(et[-1], utc_to_et(trajectory.end))
    return _segment(scenario, trajectory, et, states, (float(first), float(last)))


def _sampled(
    scenario: Scenario,
    trajectory: Trajectory,
    span: tuple[float, float],
    states: States,
    frame: str | None = None,
) -> SpkSegment:
    return sampled(
        states,
        span,
        lambda et, table: _segment(scenario, trajectory, et, table, frame=frame),
        LONGEST_STEP_S[trajectory.spk_type],
    )


def _grid(span: tuple[float, float], step_s: float) -> FloatArray:
    n = math.ceil((span[1] - span[0]) / step_s) + 1
    if n > MAX_STATES:
        raise MissionError(f"step_s: a table of {n} states, the limit is {MAX_STATES}; take longer steps")
    return np.asarray(span[0] + step_s * np.arange(n), np.float64)


def _kepler(orbit: KeplerOrbit) -> States:
    elements = conic(orbit, orbit.gm_km3_s2)
    return lambda et: conic_states(elements, et)


def _model(orbit: ModelOrbit) -> States:
    """Return the Sun's or the Earth's motion by the series of `erfa.epv00`."""

    def states(et: FloatArray) -> FloatArray:
        heliocentric, earth = erfa.epv00(J2000_JD, et / DAY_S)
        sign = 1.0 if orbit.target == 10 else 0.0  # NAIF's ids
        position, velocity = (earth[k] - sign * heliocentric[k] for k in "pv")
        return np.hstack([position * AU_KM, velocity * (AU_KM / DAY_S)])

    return states


def _ephemeris(scenario: Scenario, trajectory: EphemerisExcerpt) -> States:
    assert trajectory.center is not None  # else it is cut out
    target, center = scenario.body_id(trajectory.target), scenario.body_id(trajectory.center)

    def states(et: FloatArray) -> FloatArray:
        with spice_call(Request("ephemeris", float(et[0]), (target, center))):
            return np.array([spiceypy.spkgeo(target, t, trajectory.frame, center)[0] for t in et])

    return states


def _spk_file(trajectory: EphemerisExcerpt, place: Workplace) -> Path:
    path = place.folder / str(trajectory.file)  # a full path stays what it is
    if not path.is_file():
        raise MissionError(f"file: {path} is not there; give an SPK beside the scenario or a full path")
    return path
