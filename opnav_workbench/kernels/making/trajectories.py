"""Trajectories of a scenario as SPK segments, each kind by its own means.

Bodies come before the spacecraft, and each in the order of the file: what a propagated trajectory refers to stands
before it, or in the planetary ephemeris. A known motion is tabulated with as many states as SPICE needs to give it back
to a quarter of a metre: intervals are halved where SPICE, reading the table, misses the motion at their middle.
"""

import contextlib
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import AU_KM, DAY_S, J2000_JD
from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.kernels.calls import SpiceRequest, spice_call
from opnav_workbench.kernels.loading import LoadedKernels, kernel_files
from opnav_workbench.kernels.making.forces import PLANETS, planet_ephemeris
from opnav_workbench.kernels.making.orbits import conic_elements, conic_states, propagated_arcs
from opnav_workbench.kernels.making.scenario import (
    ElementsOrbit,
    EphemerisExcerpt,
    KeplerOrbit,
    ModelOrbit,
    PropagatedOrbit,
    Scenario,
    StateFile,
    StateTable,
    Trajectory,
)
from opnav_workbench.kernels.making.state_tables import read_states, table_states
from opnav_workbench.kernels.time import et_from_utc_datetime
from opnav_workbench.kernels.writing import WINDOW_STATES, SpkExcerpt, SpkSegment, spk_excerpts, write_spk
from opnav_workbench.paths import is_file

__all__ = ["BuildFolders", "spk_segments"]


# ---- Tables of states from a known motion: as many as SPICE needs to give it back to a quarter of a metre.

# At the middle of an interval, where an interpolation is worst or nearly so; 1 m is promised anywhere.
LARGEST_ERROR_KM = 2.5e-4
RELATIVE_ERROR = 2.5e-7  # of the distance from the center: orbits about a small body are small themselves
MAX_STATES = 200_000  # 11 MB
MAX_ROUNDS = 40  # halving a day this often leaves less than a microsecond

States = Callable[[FloatArray], FloatArray]


def sampled_segment(
    states: States,
    span_et: tuple[float, float],
    segment: Callable[[FloatArray, FloatArray], SpkSegment],
    longest_step_s: float,
) -> SpkSegment:
    """Return a segment whose interpolation keeps to a motion.

    Parameters
    ----------
    states : callable
        Epochs (n,), in order, to states (n, 6), km and km/s.
    span_et : (start, end)
        What the segment covers.
    segment
        Makes a segment of epochs (n,) and states (n, 6).
    longest_step_s
        To begin with.

    Raises
    ------
    ValueError
        The motion is too rough for a table of `MAX_STATES`.
    """
    start, end = span_et
    n_steps = max(math.ceil((end - start) / longest_step_s), WINDOW_STATES - 1)
    et = np.linspace(start, end, min(n_steps, MAX_STATES) + 1)
    for _ in range(MAX_ROUNDS):
        if len(et) > MAX_STATES:
            break
        table = segment(et, states(et))
        middle = 0.5 * (et[1:] + et[:-1])
        truth = states(middle)
        error_km = np.linalg.norm(read_back(table, middle)[:, :3] - truth[:, :3], axis=1)
        rough = error_km > np.minimum(LARGEST_ERROR_KM, RELATIVE_ERROR * np.linalg.norm(truth[:, :3], axis=1))
        if not rough.any():
            return table
        et = np.sort(np.concatenate([et, middle[rough]]))
    raise ValueError(
        f"a table of {MAX_STATES} states does not follow this motion to {LARGEST_ERROR_KM * 1e3} m"
    )


def read_back(segment: SpkSegment, et: FloatArray) -> FloatArray:
    """Return the states (n, 6) that SPICE makes of a segment at epochs (n,), in the segment's frame."""
    with tempfile.TemporaryDirectory() as folder, spice_call(f"reading back body {segment.target}"):
        path = Path(folder, "segment.bsp")
        write_spk(path, [segment])
        handle = spiceypy.spklef(str(path))
        try:
            rows = [spiceypy.spkgeo(segment.target, t, segment.frame, segment.center)[0] for t in et]
        finally:
            spiceypy.spkuef(handle)
    return np.array(rows)


# ---- Trajectories of a scenario as SPK segments, each kind by its own means.

# Light from the Sun to the edge of the planets takes 5 h, and interpolation is best away from a table's ends.
MARGIN_S = DAY_S
LONGEST_STEP_S = {13: 4.0 * DAY_S, 9: DAY_S}  # to begin with; what is too long is halved

SpkPiece = SpkSegment | SpkExcerpt


@dataclass(frozen=True, slots=True)
class BuildFolders:
    """Where a scenario's kernels are made."""

    folder: Path  # of the scenario: files that it names stand there
    kernels: tuple[Path, ...]  # LSK and the other text kernels that exist already
    scratch: Path  # takes files that nobody needs afterwards


def spk_segments(scenario: Scenario, place: BuildFolders) -> list[tuple[int, SpkPiece]]:
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
    done: list[tuple[int, SpkPiece]] = []
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
def _ephemerides(trajectory: Trajectory, place: BuildFolders, done: Sequence[SpkPiece]) -> Iterator[None]:
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
    with LoadedKernels(kernel_files(files)):
        yield


def _segments(scenario: Scenario, trajectory: Trajectory, place: BuildFolders) -> Sequence[SpkPiece]:
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
            elements = conic_elements(trajectory, PLANETS[0].gm_km3_s2)
            return [_sampled(scenario, trajectory, span, lambda et: conic_states(elements, et))]
        case EphemerisExcerpt(center=None):
            source = planet_ephemeris() if trajectory.file is None else _spk_file(trajectory, place)
            return spk_excerpts(source, scenario.body_id(trajectory.target), *span)
        case EphemerisExcerpt():
            return [_sampled(scenario, trajectory, span, _ephemeris(scenario, trajectory))]
        case _:
            return [
                _sampled(scenario, trajectory, (arc.start_et, arc.end_et), arc.states, frame="J2000")
                for arc in propagated_arcs(scenario, trajectory, span)
            ]


def _span(scenario: Scenario, trajectory: Trajectory) -> tuple[float, float]:
    start = (
        et_from_utc_datetime(scenario.span.start) - MARGIN_S
        if trajectory.start is None
        else et_from_utc_datetime(trajectory.start)
    )
    end = (
        et_from_utc_datetime(scenario.span.end) + MARGIN_S
        if trajectory.end is None
        else et_from_utc_datetime(trajectory.end)
    )
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
    first = et[0] if trajectory.start is None else max(et[0], et_from_utc_datetime(trajectory.start))
    last = et[-1] if trajectory.end is None else min(et[-1], et_from_utc_datetime(trajectory.end))
    return _segment(scenario, trajectory, et, states, (float(first), float(last)))


def _sampled(
    scenario: Scenario,
    trajectory: Trajectory,
    span: tuple[float, float],
    states: States,
    frame: str | None = None,
) -> SpkSegment:
    return sampled_segment(
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
    elements = conic_elements(orbit, orbit.gm_km3_s2)
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
        with spice_call(SpiceRequest("ephemeris", float(et[0]), (target, center))):
            return np.array([spiceypy.spkgeo(target, t, trajectory.frame, center)[0] for t in et])

    return states


def _spk_file(trajectory: EphemerisExcerpt, place: BuildFolders) -> Path:
    path = place.folder / str(trajectory.file)  # a full path stays what it is
    if not is_file(path):
        raise MissionError(f"file: {path} is not there; give an SPK beside the scenario or a full path")
    return path
