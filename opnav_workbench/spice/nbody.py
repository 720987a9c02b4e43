"""Orbits under the gravity of Sun, planets and Moon, integrated with DOP853; smaller forces as options.

Frame   J2000 axes, origin at the center body (not rotating, but falling with it)
Units   km, km/s, s

    a = sum_i gm_i (r_i - r) / |r_i - r|^3  -  a_center(t)
        + gm/(c^2 d^3) ((4 gm/d - v.v) d + 4 (d.v) v)          relativity, d and v relative to the Sun
        + p (au/d)^2 d/|d|  +  A2 (au/d)^2 t                     light, and the transverse (Yarkovsky) force

With the origin at the center, an orbit about a planet or an asteroid keeps its digits. What moves a planet moves the
orbit along: `a_center` is what its ephemeris says.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I (DOP853); Moyer, DPTRAJ-ODP (2000), eq. 4-26
with the Sun alone; Marsden et al. (1973), doi:10.1086/111402 (A2).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import spiceypy
from numpy.typing import ArrayLike
from scipy.integrate import DOP853, OdeSolution

from opnav_workbench.arrays import FloatArray
from opnav_workbench.spice.epochs import AU_KM
from opnav_workbench.spice.explain import time_text
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.planets import EPHEMERIS_NAMES, PLANETS, SUN, PointMass

__all__ = ["ForceModel", "Impulse", "OrbitArc", "propagate"]

SPEED_OF_LIGHT_KM_S = 299792.458
SOLAR_SYSTEM_BARYCENTER = 0
# A power of two: adding it to an epoch of this century rounds nothing, so that the difference of velocities is clean.
STENCIL_S = 128.0
ABSOLUTE_KM = 1e-8  # below it a position needs no digits; keeps steps long where a component passes zero
ABSOLUTE_KM_S = 1e-14
MAX_STEPS = 100_000
CHORD_SLACK = 0.5  # of a step's length: how far its path may lie beside the straight line
LOOKS_A_STEP = 16  # at the distance to a body that a step might touch


@dataclass(frozen=True, slots=True)
class Impulse:
    """A sudden change of velocity."""

    et: float
    delta_v_km_s: tuple[float, float, float]  # J2000


@dataclass(frozen=True, slots=True)
class ForceModel:
    """What moves a body about `center`; positions of the point masses come from the loaded SPKs."""

    center: int
    masses: tuple[PointMass, ...] = PLANETS
    relativity: bool = True
    radiation_km_s2: float = 0.0  # at 1 au, away from the Sun
    transverse_km_s2: float = 0.0  # at 1 au, along the motion
    tolerance: float = 1e-13  # relative, of one step

    def acceleration(self, et: float, state: FloatArray) -> FloatArray:
        """Return the acceleration (3,), km/s^2, in a state (6,); needs the bodies' SPKs."""
        places = np.array([spiceypy.spkgps(m.body, et, "J2000", self.center)[0] for m in self.masses])
        sun = spiceypy.spkgeo(SUN, et, "J2000", self.center)[0]
        total = self._pull(places, state[:3]) + self._of_sun(state - sun)
        return np.asarray(total - self._of_center(et, places, sun))

    def _pull(self, places: FloatArray, position: FloatArray) -> FloatArray:
        """Gravity at a position (3,) of masses at places (n, 3); none of a mass at that very place."""
        away = places.reshape(-1, 3) - position
        distance = np.sqrt(np.einsum("ij,ij->i", away, away))
        gm = np.array([m.gm_km3_s2 for m in self.masses])
        return np.asarray(np.divide(gm, distance**3, out=np.zeros_like(gm), where=distance > 0.0) @ away)

    def _of_center(self, et: float, places: FloatArray, sun: FloatArray) -> FloatArray:
        """Acceleration of the origin.

        Of a body of the planetary ephemeris, the five-point derivative of its velocity. Tables of states have jumps
        in their derivatives, which would break the integration's steps: other bodies move as their gravity says.
        """
        if self.center == SOLAR_SYSTEM_BARYCENTER:
            return np.zeros(3)
        if self.center in EPHEMERIS_NAMES.values():
            v = [spiceypy.spkssb(self.center, et + k * STENCIL_S, "J2000")[3:] for k in (-2, -1, 1, 2)]
            return np.asarray((v[0] - 8.0 * v[1] + 8.0 * v[2] - v[3]) / (12.0 * STENCIL_S))
        total = self._pull(places, np.zeros(3))
        return total + _schwarzschild(-sun) if self.relativity else total

    def _of_sun(self, relative: FloatArray) -> FloatArray:
        """Small forces in a state (6,) relative to the Sun."""
        total = _schwarzschild(relative) if self.relativity else np.zeros(3)
        if self.radiation_km_s2 or self.transverse_km_s2:
            position, velocity = relative[:3], relative[3:]
            distance = np.linalg.norm(position)
            outward = position / distance
            across = velocity - (velocity @ outward) * outward
            total = total + (AU_KM / distance) ** 2 * (
                self.radiation_km_s2 * outward + self.transverse_km_s2 * across / np.linalg.norm(across)
            )
        return np.asarray(total)


def _schwarzschild(relative: FloatArray) -> FloatArray:
    """Return the relativistic acceleration (3,) in a state (6,) relative to the Sun."""
    position, velocity = relative[:3], relative[3:]
    distance = float(np.linalg.norm(position))
    gm = PLANETS[0].gm_km3_s2
    inward = (4.0 * gm / distance - velocity @ velocity) * position + 4.0 * (position @ velocity) * velocity
    return np.asarray(gm / (SPEED_OF_LIGHT_KM_S**2 * distance**3) * inward)


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
    et : float
        Epoch of the state, TDB s past J2000; inside the span or not.
    span : (start, end)
        Wanted epochs.
    forces : ForceModel
    impulses : sequence of Impulse
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


def _integrated(
    state: FloatArray, et: float, stop: float, forces: ForceModel
) -> tuple[OrbitArc, FloatArray]:
    """Integrate without impulses; time counts from `et`, where it has more digits."""

    def slope(after_s: float, y: FloatArray) -> FloatArray:
        with spice_call(Request("positions of the perturbing bodies", et + after_s, (SUN,))):
            return np.concatenate([y[3:], forces.acceleration(et + after_s, y)])

    absolute = [ABSOLUTE_KM] * 3 + [ABSOLUTE_KM_S] * 3
    solver = DOP853(slope, 0.0, state, stop - et, rtol=forces.tolerance, atol=absolute)
    times, curves = [0.0], []
    away = [_away(forces, et, state)]
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed" or len(times) > MAX_STEPS:
            reason = message or f"more than {MAX_STEPS} steps"
            raise ValueError(f"the integration fails at {_when(et + solver.t)}: {reason}")
        curves.append(solver.dense_output())
        times.append(solver.t)
        away = [away[-1], _away(forces, et + solver.t, solver.y)]
        _require_no_impact(forces, et, times[-2:], curves[-1], away)
    if not np.isfinite(solver.y).all():
        raise ValueError(f"the integration fails at {_when(et + solver.t)}: the state is not finite")
    solution = OdeSolution(times, curves)

    def states(at: FloatArray) -> FloatArray:
        return np.asarray(solution(at - et).T) if len(at) else np.empty((0, 6))

    return OrbitArc(min(et, stop), max(et, stop), states), solver.y


def _away(forces: ForceModel, et: float, state: FloatArray) -> FloatArray:
    """Return the vectors (n, 3) from the body to the masses."""
    with spice_call(Request("positions of the perturbing bodies", et, (SUN,))):
        places = [spiceypy.spkgps(m.body, et, "J2000", forces.center)[0] for m in forces.masses]
    return np.asarray(places).reshape(-1, 3) - state[:3]


def _require_no_impact(
    forces: ForceModel, et: float, step: list[float], curve: Callable[[float], FloatArray], away: list[FloatArray]
) -> None:
    """Look closer at masses that the step, nearly straight, might touch."""
    radii = np.array([m.radius_km for m in forces.masses])
    chord = away[1] - away[0]
    length = np.linalg.norm(chord, axis=-1)
    along = -np.einsum("ij,ij->i", away[0], chord) / np.maximum(length, ABSOLUTE_KM) ** 2
    nearest = np.linalg.norm(away[0] + np.clip(along, 0.0, 1.0)[:, None] * chord, axis=-1)
    for i in np.flatnonzero(nearest < radii + CHORD_SLACK * length):
        for after_s in np.linspace(*step, LOOKS_A_STEP):
            distance = float(np.linalg.norm(_away(forces, et + after_s, curve(after_s))[i]))
            if distance < radii[i]:
                raise ValueError(
                    f"the orbit runs into body {forces.masses[i].body}: {distance:.6g} km from its center at "
                    f"{_when(et + after_s)}, its radius is {radii[i]:g} km"
                )


def _when(et: float) -> str:
    with spice_call("time"):
        return time_text(et)
