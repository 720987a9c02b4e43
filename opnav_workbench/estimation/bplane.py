"""The B-plane of a flyby: where the incoming asymptote would pierce the plane through the body across it; an estimate there.

S  unit vector along the incoming asymptote
T  S x pole / |S x pole|, in the B-plane and in the plane that the pole stands on
R  S x T, completes S, T, R
B  from the body to where the asymptote pierces the plane; B.T and B.R are what a target point is given in

Times of arrival, after the state's epoch: of closest approach; and linearised (LTOF), when the spacecraft would cross the
B-plane had it moved on along the asymptote. On a hyperbola a = GM / v_inf^2, e = sqrt(1 + (B/a)^2) and

    linearised = periapsis - (GM / v_inf^3) ln e,

so that, unlike the time of periapsis, it does not depend on the miss distance. Without gravity (GM = 0) the flyby is a
straight line, and both times are -(r.S) / v. `map_to_b_plane` says where an estimate puts the flyby, when, and how sure.

Reference: Kizner (1961), Planetary and Space Science 7, 125, doi:10.1016/0032-0633(61)90293-8.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.constants import OBLIQUITY_J2000_RAD
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry.differences import jacobian_by_differences

__all__ = [
    "BPlane",
    "BPlaneSolution",
    "ErrorEllipse",
    "RelativeState",
    "b_plane",
    "b_plane_partials",
    "error_ellipse",
    "map_to_b_plane",
]


# ---- The B-plane of a flyby: where the incoming asymptote would pierce the plane through the body across it.

POLES = {
    "ecliptic": (0.0, -np.sin(OBLIQUITY_J2000_RAD), np.cos(OBLIQUITY_J2000_RAD)),
    "j2000": (0.0, 0.0, 1.0),
}
PARALLEL_SINE = 1e-8  # sine of the angle between asymptote and pole below which T has no direction
STEP_SHARE = 1e-4  # longest step of the differences, as a share of distance and speed


@dataclass(frozen=True, slots=True, eq=False)
class BPlane:
    """A flyby in its B-plane; arrays are read-only.

    Attributes
    ----------
    s, t, r : (3,) arrays
        Axes, J2000.
    b_km : (3,) array
        Body to asymptote, J2000.
    closest_km
        Distance of closest approach (periapsis).
    closest_s, linearized_s
        Times of closest approach and of crossing the B-plane along the asymptote, after the state's epoch.
    eccentricity
        inf for a straight line.
    """

    s: FloatArray
    t: FloatArray
    r: FloatArray
    b_km: FloatArray
    v_infinity_km_s: float
    closest_km: float
    closest_s: float
    linearized_s: float
    eccentricity: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def b_dot_t_km(self) -> float:
        """Return B.T."""
        return float(self.b_km @ self.t)

    @property
    def b_dot_r_km(self) -> float:
        """Return B.R."""
        return float(self.b_km @ self.r)

    def in_axes_of(self, other: "BPlane") -> FloatArray:
        """Return (B.T, B.R, linearised time), km and s, with the axes of another flyby."""
        return np.array([self.b_km @ other.t, self.b_km @ other.r, self.linearized_s])


def b_plane(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    gm_km3_s2: float = 0.0,
    pole: str | ArrayLike = "ecliptic",
) -> BPlane:
    """Return the B-plane of a flyby.

    Parameters
    ----------
    position_km, velocity_km_s : (3,) array_like
        Spacecraft relative to the body, J2000, geometric, at one epoch.
    gm_km3_s2
        Of the body; zero for a straight line.
    pole : {"ecliptic", "j2000"} or (3,) array_like
        Reference pole, J2000.

    Raises
    ------
    EstimationError
        A bound or radial orbit, an asymptote along the pole, or values that are not finite.

    Examples
    --------
    >>> flyby = b_plane([-1e6, 0.0, 5000.0], [10.0, 0.0, 0.0], pole="j2000")
    >>> round(flyby.b_dot_t_km), round(flyby.b_dot_r_km), flyby.linearized_s
    (0, -5000, 100000.0)
    """
    position, velocity = np.asarray(position_km, float), np.asarray(velocity_km_s, float)
    _check_flyby(position, velocity, gm_km3_s2)
    found = (
        _straight_flyby(position, velocity)
        if gm_km3_s2 == 0.0
        else _hyperbolic_flyby(position, velocity, gm_km3_s2)
    )
    t, r = _t_and_r_axes(found["s"], pole)
    return BPlane(t=t, r=r, **found)


def b_plane_partials(
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    gm_km3_s2: float = 0.0,
    pole: str | ArrayLike = "ecliptic",
) -> FloatArray:
    """Return d(B.T, B.R, linearised time)/d(position, velocity), (3, 6), with the axes held fixed; arguments as `b_plane`.

    Examples
    --------
    >>> partials = b_plane_partials([-1e6, 0.0, 5000.0], [10.0, 0.0, 0.0], pole="j2000")
    >>> print(partials[2].round(6) + 0.0)  # a kilometer ahead is a tenth of a second earlier
    [-1.e-01  0.e+00  0.e+00 -1.e+04  0.e+00 -5.e+01]
    """
    state = np.concatenate([np.asarray(position_km, float), np.asarray(velocity_km_s, float)])
    nominal = b_plane(state[:3], state[3:], gm_km3_s2, pole)
    steps = STEP_SHARE * np.repeat([np.linalg.norm(state[:3]), np.linalg.norm(state[3:])], 3)
    return jacobian_by_differences(
        lambda x: b_plane(x[:3], x[3:], gm_km3_s2, pole).in_axes_of(nominal), state, steps
    )


def _check_flyby(position: FloatArray, velocity: FloatArray, gm_km3_s2: float) -> None:
    values = np.concatenate([position, velocity])
    if values.shape != (6,) or not np.isfinite(values).all() or not velocity.any() or not gm_km3_s2 >= 0.0:
        raise EstimationError(
            f"no flyby with position {position.tolist()} km, velocity {velocity.tolist()} km/s and "
            f"GM {gm_km3_s2:g} km^3/s^2."
        )


def _straight_flyby(position: FloatArray, velocity: FloatArray) -> dict[str, Any]:
    speed = float(np.linalg.norm(velocity))
    s = velocity / speed
    along = float(position @ s)
    b = position - along * s
    return {
        "s": s,
        "b_km": b,
        "v_infinity_km_s": speed,
        "closest_km": float(np.linalg.norm(b)),
        "closest_s": -along / speed,
        "linearized_s": -along / speed,
        "eccentricity": np.inf,
    }


def _hyperbolic_flyby(position: FloatArray, velocity: FloatArray, gm: float) -> dict[str, Any]:
    distance, momentum = float(np.linalg.norm(position)), np.cross(position, velocity)
    energy = float(velocity @ velocity) - 2.0 * gm / distance  # v_inf^2
    h = float(np.linalg.norm(momentum))
    if not energy > 0.0 or h == 0.0:
        raise EstimationError(
            f"no flyby: v_inf^2 is {energy:.6g} km^2/s^2 and the angular momentum {h:.6g} km^2/s; a B-plane needs an "
            "open orbit that misses the center."
        )
    speed = float(np.sqrt(energy))
    a = gm / energy
    toward = np.cross(velocity, momentum) / gm - position / distance
    e = float(np.linalg.norm(toward))
    p = toward / e
    q = np.cross(momentum / h, p)
    s = p / e + np.sqrt(e * e - 1.0) / e * q
    rate = speed / a  # mean motion
    e_sinh = float(position @ velocity) / np.sqrt(gm * a)
    closest = -(e_sinh - float(np.arcsinh(e_sinh / e))) / rate
    return {
        "s": s,
        "b_km": h / speed * np.cross(s, momentum / h),
        "v_infinity_km_s": speed,
        "closest_km": a * (e - 1.0),
        "closest_s": closest,
        "linearized_s": closest - float(np.log(e)) / rate,
        "eccentricity": e,
    }


def _t_and_r_axes(s: FloatArray, pole: str | ArrayLike) -> tuple[FloatArray, FloatArray]:
    if isinstance(pole, str) and pole not in POLES:
        raise EstimationError(f"unknown pole {pole!r}; choose one of {', '.join(POLES)}, or give a vector.")
    vector = np.asarray(POLES[pole] if isinstance(pole, str) else pole, float)
    t = np.cross(s, vector)
    length = float(np.linalg.norm(t))
    if vector.shape != (3,) or not length > PARALLEL_SINE * float(np.linalg.norm(vector)):
        raise EstimationError(
            f"the asymptote {s.round(6).tolist()} lies along the pole {vector.tolist()}; choose another pole."
        )
    t = t / length
    return t, np.cross(s, t)


# ---- An estimate in the B-plane: where the flyby goes, when, and how sure that is.


@dataclass(frozen=True, slots=True)
class ErrorEllipse:
    """One-sigma ellipse of (B.T, B.R).

    Attributes
    ----------
    angle_rad
        Of the major axis, from T toward R, 0 to pi.
    """

    semi_major_km: float
    semi_minor_km: float
    angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class BPlaneSolution:
    """An estimate mapped to the B-plane; arrays are read-only.

    Attributes
    ----------
    a_priori, corrected
        Of the trajectory before and after the correction.
    values_before, values_after : (3,) arrays
        B.T, B.R (km) and linearised time of flight (s after the epoch), both with the axes of `a_priori`.
    covariance : (3, 3) array
        Of `values_after`: km^2, km s, s^2.
    """

    a_priori: BPlane
    corrected: BPlane
    values_before: FloatArray
    values_after: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def shift(self) -> FloatArray:
        """Return what the correction moved: (B.T, B.R, time), km and s."""
        return np.asarray(self.values_after - self.values_before)

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations of B.T, B.R (km) and time (s)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def ellipse(self) -> ErrorEllipse:
        """Return the one-sigma ellipse of (B.T, B.R)."""
        return error_ellipse(self.covariance[:2, :2])


def error_ellipse(covariance_km2: ArrayLike) -> ErrorEllipse:
    """Return the one-sigma ellipse of a covariance (2, 2) km^2 of (B.T, B.R).

    Examples
    --------
    >>> ellipse = error_ellipse([[4.0, 0.0], [0.0, 9.0]])
    >>> ellipse.semi_major_km, ellipse.semi_minor_km, round(float(np.degrees(ellipse.angle_rad)), 6)
    (3.0, 2.0, 90.0)
    """
    values, vectors = np.linalg.eigh(symmetric(np.asarray(covariance_km2, float)))
    minor, major = (float(np.sqrt(max(v, 0.0))) for v in values)
    return ErrorEllipse(major, minor, float(np.arctan2(vectors[1, 1], vectors[0, 1]) % np.pi))


class RelativeState(Protocol):
    """What corrects the spacecraft's state relative to a body: an `Estimate`, a `FilterEstimate`, or one of your own."""

    def relative_state(self, body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the correction (6,), km and km/s at the epoch, J2000, and its covariance (6, 6)."""


def map_to_b_plane(
    estimate: RelativeState,
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    gm_km3_s2: float = 0.0,
    *,
    pole: str | ArrayLike = "ecliptic",
    body: str = "",
) -> BPlaneSolution:
    """Map an estimate's correction to the B-plane.

    Parameters
    ----------
    estimate
        Of the batch or of the filter.
    position_km, velocity_km_s : (3,) array_like
        A priori spacecraft relative to the body at the estimate's epoch, J2000, geometric.
    gm_km3_s2, pole
        As in `b_plane`.
    body
        The body that the state is relative to, where the estimate corrects bodies one by one; empty for the system.

    Raises
    ------
    EstimationError
        See `b_plane`.
    """
    state = np.concatenate([np.asarray(position_km, float), np.asarray(velocity_km_s, float)])
    correction, covariance = estimate.relative_state(body)
    moved = state + correction
    before = b_plane(state[:3], state[3:], gm_km3_s2, pole)
    after = b_plane(moved[:3], moved[3:], gm_km3_s2, pole)
    partials = b_plane_partials(moved[:3], moved[3:], gm_km3_s2, pole)
    return BPlaneSolution(
        a_priori=before,
        corrected=after,
        values_before=before.in_axes_of(before),
        values_after=after.in_axes_of(before),
        covariance=symmetric(partials @ covariance @ partials.T),
    )
