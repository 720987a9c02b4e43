"""Orbits integrated numerically (DOP853) from one state, forward and backward, with sudden changes of velocity.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed. (1993), section II.10.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853, OdeSolution

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import SUN_ID
from opnav_workbench.kernels.calls import SpiceRequest, spice_call, time_words
from opnav_workbench.kernels.making.forces import ForceModel

__all__ = ["Impulse", "OrbitArc", "propagate"]

# Below these a state needs no digits; keeps steps long where a component passes zero.
ABSOLUTE = np.array([1e-8] * 3 + [1e-14] * 3)  # km, km/s
MAX_STEPS = 100_000
CHORD_SLACK = 0.5  # of a step's length: how far its path may lie beside the straight line
LOOKS_A_STEP = 16  # at the distance to a body that a step might touch
RUNNING, FAILED = "running", "failed"  # scipy's words


@dataclass(frozen=True, slots=True)
class Impulse:
    """A sudden change of velocity."""

    et: float
    delta_v_km_s: tuple[float, float, float]  # J2000


@dataclass(frozen=True, slots=True)
class OrbitArc:
    """A piece of an orbit between two sudden changes."""

    start_et: float
    end_et: float
    states: Callable[[FloatArray], FloatArray]  # epochs (n,) within the piece to states (n, 6), km and km/s


def propagate(
    state: ArrayLike,
    et: float,
    span: tuple[float, float],
    forces: ForceModel,
    impulses: Sequence[Impulse] = (),
) -> tuple[OrbitArc, ...]:
    """Integrate an orbit from one state over a span, forward and backward.

    Parameters
    ----------
    state : (6,) array_like
        Position and velocity relative to ``forces.center``, J2000, km and km/s, at `et`.
    et
        Epoch of the state, TDB s past J2000; inside the span or not.
    span : (start, end)
        Wanted epochs.
    impulses
        In order of time. At its own epoch, the state is that before an impulse.

    Returns
    -------
    tuple of OrbitArc
        In order of time, cut at the impulses inside the span.

    Raises
    ------
    ValueError
        The orbit runs into a body, or the integration fails.
    KernelError
        A body's position is not covered.
    """
    epochs = [i.et for i in impulses]
    after = int(np.searchsorted(epochs, et, "left"))  # impulses before this one lie in the past
    forward = _pieces(np.asarray(state, float), et, span[1], impulses[after:], forces, 1.0)
    backward = _pieces(np.asarray(state, float), et, span[0], impulses[:after][::-1], forces, -1.0)
    return _within(span, [*backward[::-1], *forward], epochs)


def _pieces(
    state: FloatArray, et: float, last: float, impulses: Sequence[Impulse], forces: ForceModel, sign: float
) -> list[OrbitArc]:
    """Return the pieces from `et` to `last` in one direction of time."""
    pieces: list[OrbitArc] = []
    for impulse in impulses:
        if sign * (impulse.et - last) >= 0.0:
            break
        if impulse.et != et:
            piece, state = _integrated(state, et, impulse.et, forces)
            pieces.append(piece)
        et = impulse.et
        state = state + np.concatenate([np.zeros(3), sign * np.asarray(impulse.delta_v_km_s)])
    if sign * (last - et) > 0.0:
        pieces.append(_integrated(state, et, last, forces)[0])
    return pieces


def _within(span: tuple[float, float], pieces: list[OrbitArc], cuts: list[float]) -> tuple[OrbitArc, ...]:
    """Cut pieces to the span, and join the two around the initial epoch."""
    joined: list[OrbitArc] = []
    for piece in pieces:
        start, end = max(piece.start_et, span[0]), min(piece.end_et, span[1])
        if end <= start:
            continue
        if joined and joined[-1].end_et == start and start not in cuts:
            before = joined.pop()
            joined.append(OrbitArc(before.start_et, end, _either(before.states, piece.states, start)))
        else:
            joined.append(OrbitArc(start, end, piece.states))
    return tuple(joined)


def _either(
    before: Callable[[FloatArray], FloatArray], after: Callable[[FloatArray], FloatArray], cut: float
) -> Callable[[FloatArray], FloatArray]:
    def states(et: FloatArray) -> FloatArray:
        early = et < cut
        return np.concatenate([before(et[early]), after(et[~early])])  # epochs come in order

    return states


def _integrated(state: FloatArray, et: float, stop: float, forces: ForceModel) -> tuple[OrbitArc, FloatArray]:
    """Integrate without impulses; time counts from `et`, where it has more digits."""

    def slope(after_s: float, y: FloatArray) -> FloatArray:
        with spice_call(SpiceRequest("positions of the perturbing bodies", et + after_s, (SUN_ID,))):
            return np.concatenate([y[3:], forces.acceleration(et + after_s, y)])

    tolerances: dict[str, Any] = {"rtol": forces.tolerance, "atol": ABSOLUTE}  # the stubs know no array here
    solver: Any = DOP853(slope, 0.0, state, stop - et, **tolerances)
    times, curves = [0.0], []
    away = [_away(forces, et, state)]
    while solver.status == RUNNING:
        message = solver.step()
        if solver.status == FAILED or len(times) > MAX_STEPS:
            reason = message or f"more than {MAX_STEPS} steps"
            raise ValueError(f"the integration fails at {time_words(et + solver.t)}: {reason}")
        curves.append(solver.dense_output())
        times.append(solver.t)
        away = [away[-1], _away(forces, et + solver.t, solver.y)]
        _require_no_impact(forces, et, times[-2:], curves[-1], away)
    if not np.isfinite(solver.y).all():
        raise ValueError(f"the integration fails at {time_words(et + solver.t)}: the state is not finite")
    solution = OdeSolution(times, curves)

    def states(at: FloatArray) -> FloatArray:
        return np.asarray(solution(at - et).T) if len(at) else np.empty((0, 6))

    return OrbitArc(min(et, stop), max(et, stop), states), solver.y


def _away(forces: ForceModel, et: float, state: FloatArray) -> FloatArray:
    """Return the vectors (n, 3) from the body to the masses."""
    with spice_call(SpiceRequest("positions of the perturbing bodies", et, (SUN_ID,))):
        return np.asarray(forces.mass_positions(et) - state[:3])


def _require_no_impact(
    forces: ForceModel,
    et: float,
    step: list[float],
    curve: Callable[[float], FloatArray],
    away: list[FloatArray],
) -> None:
    """Look closer at masses that the step, nearly straight, might touch."""
    radii = np.array([m.radius_km for m in forces.masses])
    chord = away[1] - away[0]
    length = np.linalg.norm(chord, axis=-1)
    along = -np.einsum("ij,ij->i", away[0], chord) / np.maximum(length, ABSOLUTE[0]) ** 2
    nearest = np.linalg.norm(away[0] + np.clip(along, 0.0, 1.0)[:, None] * chord, axis=-1)
    for i in np.flatnonzero(nearest < radii + CHORD_SLACK * length):
        for after_s in np.linspace(step[0], step[1], LOOKS_A_STEP):
            distance = float(np.linalg.norm(_away(forces, et + after_s, curve(after_s))[i]))
            if distance < radii[i]:
                raise ValueError(
                    f"the orbit runs into body {forces.masses[i].body}: {distance:.6g} km from its center at "
                    f"{time_words(et + after_s)}, its radius is {radii[i]:g} km"
                )
