"""Attitudes of a pointing plan: the camera held on targets or a fixed direction, with patterns about them.

Entry point
    window_attitudes(scenario, window) -> AttitudeHistory    one window of the plan, predicted

`joined_histories` makes one history of the windows, `flown_attitudes` adds the attitude error.

Frames  ``camera_from_j2000``; places on the detector are counted in pixels of the boresight's scale, without
        distortion: a plan does not need more.

SPICE differences positions about the solar-system barycenter at two epochs, one light time apart; epoch and positions
are rounded, and the direction of a near target jumps by that. So directions to targets become Chebyshev series: a
least-squares series through more points than it has terms runs through the middle of the jumps, and differences of
attitudes are rates and not noise.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.constants import SOLAR_SYSTEM_BARYCENTER_ID
from opnav_workbench.geometry.aiming import aim, turn_across
from opnav_workbench.geometry.rotations import unit, unit_from_radec
from opnav_workbench.kernels.making.attitude_history import (
    AttitudeHistory,
    AttitudeLaw,
    adaptive_epochs,
    even_epochs,
    rates_of,
)
from opnav_workbench.kernels.making.scenario import Mosaic, OffsetList, PointingWindow, Scan, Scenario
from opnav_workbench.kernels.states import state
from opnav_workbench.kernels.time import et_from_utc_datetime

__all__ = ["window_attitudes"]


# ---- Directions to a target over time as Chebyshev series.

DEGREE = 15
POINTS = 33  # twice as many as terms: rounding averages out, and an even miss shows
LONGEST_S = 14400.0  # a moon's swing about its planet, of a day or more, cannot hide between points
SHORTEST_S = 0.1  # nothing real turns within less


def smooth_track(
    directions: Callable[[FloatArray], FloatArray], start: float, end: float, tolerance_rad: float
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of epochs (n,) that gives vectors (n, 3) along `directions`, smoothly.

    Parameters
    ----------
    directions
        Epochs (n,) to unit vectors (n, 3), smooth but for rounding.
    start, end
        Epochs between which it is asked.
    tolerance_rad
        Largest miss of the series; where rounding is larger, the shortest series that are tried stand.

    Examples
    --------
    >>> def circling(et):
    ...     return np.stack([np.cos(et / 1000.0), np.sin(et / 1000.0), 0.0 * et], axis=1)
    >>> track = smooth_track(circling, 0.0, 5000.0, 1e-12)
    >>> et = np.linspace(0.0, 5000.0, 777)
    >>> bool(np.abs(track(et) - circling(et)).max() < 2e-12)
    True
    """
    nodes = np.cos(np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    fit = np.linalg.pinv(chebyshev.chebvander(nodes, DEGREE))
    done: list[tuple[float, float, FloatArray]] = []
    count = max(1, int(np.ceil((end - start) / LONGEST_S)))
    edges = np.linspace(start, end, count + 1)
    waiting = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    while waiting:
        a, b = waiting.pop()
        values = directions(0.5 * (a + b) + 0.5 * (b - a) * nodes)
        terms = fit @ values
        miss = np.abs(chebyshev.chebval(nodes, terms).T - values).max()
        if miss <= tolerance_rad or b - a < 2.0 * SHORTEST_S:
            done.append((a, b, terms))
        else:
            waiting += [(a, 0.5 * (a + b)), (0.5 * (a + b), b)]
    return _series(sorted(done, key=lambda piece: piece[0]))


def _series(pieces: list[tuple[float, float, FloatArray]]) -> Callable[[FloatArray], FloatArray]:
    starts, ends = (np.array([piece[i] for piece in pieces]) for i in (0, 1))
    terms = np.stack([piece[2] for piece in pieces])  # (n, DEGREE + 1, 3)

    def evaluate(et: FloatArray) -> FloatArray:
        row = np.clip(np.searchsorted(starts, et, side="right") - 1, 0, len(starts) - 1)
        x = ((2.0 * et - starts[row] - ends[row]) / (ends[row] - starts[row]))[:, None]
        after, here = np.zeros((len(et), 3)), np.zeros((len(et), 3))
        for k in range(DEGREE, 0, -1):  # Clenshaw's recurrence
            here, after = terms[row, k] + 2.0 * x * here - after, here
        return np.asarray(terms[row, 0] + x * here - after)

    return evaluate


# ---- Attitudes of a pointing plan: the camera held on targets or a fixed direction, with patterns about them.

SLEW_TOLERANCE_RAD = 1e-6  # no picture is taken while the camera slews; far below a pixel of any camera
TRACK_TOLERANCE_RAD = 1e-11  # of a target's direction: a hundredth of what is asked between attitudes


@dataclass(frozen=True, slots=True, eq=False)
class SmoothInterval:
    """A part of a window in which the motion is smooth, and how closely it is followed."""

    start: float  # et
    end: float
    tolerance_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class DwellSequence:
    """Places held one after the other: at ``times[2 i]`` place i is reached, at ``times[2 i + 1]`` left."""

    times: FloatArray  # (2 n,) et
    angles_rad: FloatArray  # (n, 2) turn of the boresight's sky along pixel and line

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def angles_at(self, et: FloatArray) -> FloatArray:
        """Return the turns (m, 2) at epochs (m,); slews start and end at rest."""
        row = np.clip(np.searchsorted(self.times, et, side="right") - 1, 0, len(self.times) - 1)
        place, slewing = row // 2, (row % 2 == 1) & (row < len(self.times) - 1)
        after = np.where(slewing, place + 1, place)
        length = np.where(
            slewing, self.times[np.minimum(row + 1, len(self.times) - 1)] - self.times[row], 1.0
        )
        part = np.where(slewing, rest_to_rest((et - self.times[row]) / length), 0.0)[:, None]
        return np.asarray((1.0 - part) * self.angles_rad[place] + part * self.angles_rad[after])


def rest_to_rest(part: FloatArray) -> FloatArray:
    """Return how much of a slew is done at a part (0 to 1) of its time: rates and accelerations vanish at both ends.

    The quintic ``10 u^3 - 15 u^4 + 6 u^5`` (minimum jerk; Flash & Hogan 1985, doi:10.1523/JNEUROSCI.05-07-01688.1985).

    Examples
    --------
    >>> rest_to_rest(np.array([0.0, 0.5, 1.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(part, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 + u * (6.0 * u - 15.0)))


def window_attitudes(scenario: Scenario, window: PointingWindow) -> AttitudeHistory:
    """Return the predicted attitudes of one window of a pointing plan.

    Needs an active `KernelSet` with the scenario's LSK and SPK. Targets are taken where they appear, with
    light time and stellar aberration.

    Raises
    ------
    KernelError
        A target's state is not covered.
    ValueError
        No attitude fulfils the plan (an offset at the celestial pole), or it moves too fast for its tolerance.
    """
    start, end = et_from_utc_datetime(window.start), et_from_utc_datetime(window.end)
    law = _law(scenario, window, start, end)
    parts = [
        even_epochs(s.start, s.end, window.step_s)
        if window.step_s is not None
        else adaptive_epochs(law, s.start, s.end, s.tolerance_rad)
        for s in _smooth_intervals(scenario, window, start, end)
    ]
    # Where a slew meets a dwell, the dwell's own rate is the right one: a difference across would see the slew.
    inner = [part if i % 2 == 0 else part[1:-1] for i, part in enumerate(parts)]
    rates = [r if i % 2 == 0 else r[1:-1] for i, r in enumerate(rates_of(law, part) for part in parts)]
    et = np.concatenate(inner)
    return AttitudeHistory(et, law(et), np.concatenate(rates), np.array([0])).widened()


def _law(scenario: Scenario, window: PointingWindow, start: float, end: float) -> AttitudeLaw:
    """Return the attitude as a function of time: the aim, then the pattern's turn about the camera's own axes."""
    camera = scenario.pointed_instrument
    focal, scale = np.array(camera.focal_from_camera), camera.pixel_scale_rad
    twist, offset = math.radians(window.twist_deg), np.multiply(window.offset_px, scale)
    directions = _directions(scenario, window, start, end)

    def aimed(et: FloatArray) -> FloatArray:
        return np.broadcast_to(aim(directions(et), twist, focal, offset), (len(et), 3, 3))

    if window.scan is not None:
        first, axis = _scan(window.scan, twist, focal, scale)
        rate = math.radians(window.scan.rate_deg_s)
        return lambda et: turn_across(rate * (et - start)[:, None] * axis, focal) @ first @ aimed(et)
    if window.dwells is not None:
        dwelling = _dwell_sequence(window.dwells, scenario, start)
        return lambda et: turn_across(dwelling.angles_at(et), focal) @ aimed(et)
    return aimed


def _scan(scan: Scan, twist: float, focal: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return the turn to the scan's start (3, 3), and the direction (2,) in which what is aimed at then moves."""
    first = turn_across(_angles(np.multiply(scan.start_px, scale)), focal)
    if scan.direction is not None:
        return first, unit([*scan.direction, 0.0])[:2]
    assert scan.position_angle_deg is not None
    angle = math.radians(scan.position_angle_deg) - twist
    handedness = float(np.sign(np.linalg.det(focal)))
    # Where the boresight goes on the sky, what it looked at stays behind.
    return first, -np.array([handedness * math.sin(angle), math.cos(angle)])


def _dwell_sequence(dwells: Mosaic | OffsetList, scenario: Scenario, start: float) -> DwellSequence:
    camera = scenario.pointed_instrument
    places = np.array(list(dwells.places_px(camera.n_pixel, camera.n_line)), float)
    reached = start + np.arange(len(places)) * (dwells.dwell_s + dwells.slew_s)
    times = np.stack([reached, reached + dwells.dwell_s], axis=1).ravel()
    return DwellSequence(times, _angles(places * camera.pixel_scale_rad))


def _angles(tangents: FloatArray) -> FloatArray:
    """Return angles (..., 2) along pixel and line of places given by their tangents."""
    radius = np.linalg.norm(tangents, axis=-1, keepdims=True)
    return np.asarray(
        tangents * np.where(radius > 0.0, np.arctan(radius) / np.where(radius > 0.0, radius, 1.0), 1.0)
    )


def _smooth_intervals(
    scenario: Scenario, window: PointingWindow, start: float, end: float
) -> list[SmoothInterval]:
    """Cut a window where a slew starts or ends."""
    still = window.tolerance_rad
    if window.dwells is None:
        return [SmoothInterval(start, end, still)]
    times = _dwell_sequence(window.dwells, scenario, start).times
    edges = np.append(times[:-1], end)  # the last place is held to the end
    slew = max(still, SLEW_TOLERANCE_RAD)
    return [
        SmoothInterval(a, b, still if i % 2 == 0 else slew)
        for i, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    ]


def _directions(
    scenario: Scenario, window: PointingWindow, start: float, end: float
) -> Callable[[FloatArray], FloatArray]:
    """Return the J2000 directions to aim at as a function of time; (3,) of a fixed one."""
    if window.ra_deg is not None and window.dec_deg is not None:
        fixed = unit_from_radec(math.radians(window.ra_deg), math.radians(window.dec_deg))
        return lambda _: fixed
    bodies = [scenario.body_id(b) for b in window.track]

    def seen(et: FloatArray) -> FloatArray:
        return np.array([_mean_direction(bodies, scenario.spacecraft.id, t) for t in et.tolist()])

    return smooth_track(
        seen, start, end, max(TRACK_TOLERANCE_RAD, _rounding_rad(scenario, bodies, start, end))
    )


def _mean_direction(bodies: list[int], observer: int, et: float) -> FloatArray:
    seen = [state(body, et, observer, "J2000", "CN+S").position_km for body in bodies]
    return unit(np.sum(unit(seen), axis=0))


def _rounding_rad(scenario: Scenario, bodies: list[int], start: float, end: float) -> float:
    """Return how far rounding in SPICE's light times moves the targets' directions, at most."""
    noise = 0.0
    for body, t in product(bodies, (start, 0.5 * (start + end), end)):
        seen, there = state(body, t, scenario.spacecraft.id), state(body, t, SOLAR_SYSTEM_BARYCENTER_ID)
        speed, far = (float(np.linalg.norm(v)) for v in (there.velocity_km_s, there.position_km))
        rounded_km = float(np.spacing(abs(t))) * speed + 2.0 * float(np.spacing(far))
        noise = max(noise, rounded_km / float(np.linalg.norm(seen.position_km)))
    return noise
