"""What changes at random from picture to picture: accelerations, pointing, biases of centers; and constants of the model.

Each is exponentially correlated with a time constant, or white, or constant:

    p(t + h) = m p(t) + noise,   m = exp(-h / tau),   variance of the noise sigma^2 (1 - m^2)

and keeps its sigma at all times. What an acceleration leaves in the state over a step h comes from p, its integral and the
integral of that, P1 and P2, whose joint noise is a positive sum over the step and so has a square root without subtraction:

    correction at the epoch += W(s) p(s) ds,   W linear over the step: W0 P1 + W1 (h P1 - P2)

with W = d(state at the epoch)/d(velocity at s). A step over which W bends is divided.

References: Bierman (1977), Factorization Methods for Discrete Sequential Estimation, chapter VII (pseudo-epoch state);
Singer (1970), IEEE Trans. AES-6, 473, doi:10.1109/TAES.1970.310128 (the correlated acceleration).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, gauss_legendre
from opnav_workbench.camera import Camera
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.state_transition import Transition, propagate_two_body
from opnav_workbench.geometry.differences import jacobian_by_differences
from opnav_workbench.observables import Observable

__all__ = [
    "Acceleration",
    "CenterBias",
    "ModelParameter",
    "Pointing",
    "acceleration_increments",
    "decay_and_noise",
    "epoch_weights",
    "focal_length",
    "gravity",
    "step_times",
]

MOVERS = ("spacecraft", "target")
PIXEL_STEP_SHARE = 1e-4  # of the focal length, for its differences
GM_STEP_SHARE = 1e-3


@dataclass(frozen=True, slots=True)
class Acceleration:
    """A stochastic acceleration, the same along x, y and z of J2000 or with a sigma for each.

    Attributes
    ----------
    sigma_km_s2
        One, or three.
    correlation_s
        Time constant of an exponentially correlated acceleration; inf for a constant one.
    hold_s
        In its stead for a white one: the time for which each value is held. Only sigma^2 times this counts: the spectral
        density, km^2/s^3.
    mover : {"spacecraft", "target"}
        Its position and velocity have to be among the parameters.
    from_et, to_et
        When it acts, TDB seconds past J2000. For a noise that changes, give one acceleration an interval.
    """

    sigma_km_s2: float | tuple[float, float, float]
    correlation_s: float = 0.0
    hold_s: float = 0.0
    mover: str = "spacecraft"
    from_et: float = -np.inf
    to_et: float = np.inf

    def __post_init__(self) -> None:
        if self.mover not in MOVERS:
            raise EstimationError(f"acceleration of {self.mover!r}; give one of {', '.join(MOVERS)}.")
        if not (self.sigmas > 0.0).all() or not np.isfinite(self.sigmas).all():
            raise EstimationError(
                f"acceleration with sigma {self.sigma_km_s2} km/s^2; give one or three greater than zero."
            )
        if (self.correlation_s > 0.0) == (self.hold_s > 0.0) or not np.isfinite(self.hold_s):
            raise EstimationError(
                f"acceleration with correlation_s {self.correlation_s:g} and hold_s {self.hold_s:g}; give one of them "
                "greater than zero: correlation_s for a correlated one, hold_s for a white one."
            )
        if not self.from_et < self.to_et:
            raise EstimationError(f"acceleration from {self.from_et:g} to {self.to_et:g}; it never acts.")

    @property
    def sigmas(self) -> FloatArray:
        """Return the sigmas of the three axes."""
        return np.broadcast_to(np.asarray(self.sigma_km_s2, float), 3).copy()

    @property
    def white(self) -> bool:
        """Whether it has no memory, and no parameters of its own."""
        return self.hold_s > 0.0

    def acts(self, start_et: float, end_et: float) -> bool:
        """Whether it acts in an interval."""
        return self.from_et < end_et and self.to_et > start_et


@dataclass(frozen=True, slots=True)
class Pointing:
    """Errors of the solved attitudes beyond their covariance: rotations about the camera frame's axes.

    Attributes
    ----------
    sigma_rad
        One, or one an axis.
    correlation_s
        0: each picture has its own. inf: all have the same, a misalignment.
    """

    sigma_rad: float | tuple[float, float, float]
    correlation_s: float = 0.0

    def __post_init__(self) -> None:
        _check_sigma("pointing", self.sigmas, self.correlation_s)

    @property
    def sigmas(self) -> FloatArray:
        """Return the sigmas of the three axes."""
        return np.broadcast_to(np.asarray(self.sigma_rad, float), 3).copy()

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of its parameters."""
        return tuple(f"pointing {axis}" for axis in "xyz")

    @property
    def unit(self) -> str:
        """Return the unit of its parameters."""
        return "rad"

    def partials(self, o: Observable) -> FloatArray:
        """Return d(computed pixel, line)/d(parameters), (2, 3)."""
        if o.partials_px_per_rad is None:
            raise EstimationError(f"{o.name} in {o.image} has no partials_px_per_rad; process it again.")
        return o.partials_px_per_rad


@dataclass(frozen=True, slots=True)
class CenterBias:
    """Errors of centers that the bodies' covariances do not have: of a surface, say, that looks much the same next time.

    Attributes
    ----------
    sigma_px
        Along pixel and line.
    correlation_s
        0: each picture has its own. inf: all have the same.
    body
        The one body whose centers it moves; empty: all bodies of a picture by the same.
    """

    sigma_px: float
    correlation_s: float = 0.0
    body: str = ""

    def __post_init__(self) -> None:
        _check_sigma("bias of centers", self.sigmas, self.correlation_s)

    @property
    def sigmas(self) -> FloatArray:
        """Return the sigmas along pixel and line."""
        return np.full(2, float(self.sigma_px))

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of its parameters."""
        whose = f"bias:{self.body}" if self.body else "bias"
        return f"{whose} pixel", f"{whose} line"

    @property
    def unit(self) -> str:
        """Return the unit of its parameters."""
        return "px"

    def partials(self, o: Observable) -> FloatArray:
        """Return d(computed pixel, line)/d(parameters), (2, 2)."""
        return np.eye(2) * float(not self.body or self.body.casefold() == o.name.casefold())


def _check_sigma(what: str, sigmas: FloatArray, correlation_s: float) -> None:
    if not (sigmas > 0.0).all() or not np.isfinite(sigmas).all() or not correlation_s >= 0.0:
        raise EstimationError(
            f"{what} with sigma {sigmas.tolist()} and correlation_s {correlation_s:g}; give sigmas greater than zero, "
            "and a time constant of zero (each picture its own) or more."
        )


# ---- Constants of the model.


@dataclass(frozen=True, slots=True)
class ModelParameter:
    """A constant that the observables depend on: of the camera, of a force, of whatever has partials.

    Attributes
    ----------
    name, unit
    sigma
        A priori; the a priori value is zero: it is a correction.
    pixels : callable, optional
        ``observable -> (2,)``: d(computed pixel, line)/d(parameter).
    trajectory : callable, optional
        ``(epoch_et, et) -> (6,)``: d(spacecraft's position, velocity at et)/d(parameter), state at the epoch held.
    """

    name: str
    sigma: float
    unit: str = ""
    pixels: Callable[[Observable], ArrayLike] | None = None
    trajectory: Callable[[float, float], ArrayLike] | None = None

    def __post_init__(self) -> None:
        if not (self.sigma > 0.0 and np.isfinite(self.sigma)):
            raise EstimationError(
                f"{self.name} with a priori sigma {self.sigma:g}; give one greater than zero."
            )
        if self.pixels is None and self.trajectory is None:
            raise EstimationError(f"{self.name} moves nothing; give its partials.")


def focal_length(camera: Camera, sigma: float) -> ModelParameter:
    """Return the relative error of a camera's focal length, true over believed minus one.

    A body moves away from the camera's middle. Where stars are spread evenly about the middle they hold the pointing there;
    where they are not, their own mean error shifts the body as well, which this leaves out.

    Parameters
    ----------
    sigma
        A priori, as a share.
    """
    middle = np.asarray(camera.project(camera.boresight), float)
    return ModelParameter("focal_length", sigma, "", pixels=lambda o: _place(o) - middle)


def _place(o: Observable) -> FloatArray:
    return np.asarray(o.predicted_px if o.observed_px is None else o.observed_px, float)


def gravity(state: ArrayLike, gm_km3_s2: float, sigma_km3_s2: float, name: str = "gm") -> ModelParameter:
    """Return the error of a central body's GM, on two-body motion as `kepler` has it.

    Parameters
    ----------
    state : (6,) array_like
        Reference position (km) and velocity (km/s) at the epoch, relative to the central body, J2000.
    gm_km3_s2, sigma_km3_s2
        Of the central body, and its a priori sigma.
    """
    reference = np.asarray(state, float)
    steps = np.array([GM_STEP_SHARE * gm_km3_s2])

    def trajectory(epoch_et: float, et: float) -> FloatArray:
        moved = jacobian_by_differences(
            lambda gm: propagate_two_body(reference, float(gm[0]), et - epoch_et),
            np.array([gm_km3_s2]),
            steps,
        )
        return np.asarray(moved[:, 0])

    return ModelParameter(name, sigma_km3_s2, "km^3/s^2", trajectory=trajectory)


# ---- A step in time: what decays, what is new, and what an acceleration leaves in the state.

# Beyond so many time constants the start of a step is forgotten (e^-40), and what is left is a polynomial.
FORGOTTEN = 40.0
NODES = 24  # exact to rounding for exponentials over pieces of FORGOTTEN / PIECES time constants
PIECES = 8
BENDING = 1e-3  # of its size, by which W may leave its chord over a step: the noise is not known better
MOST_HALVINGS = 8


def decay_and_noise(correlation_s: float, duration_s: float) -> tuple[float, float]:
    """Return m and the noise's share of sigma, sqrt(1 - m^2), of an exponentially correlated parameter.

    Examples
    --------
    >>> decay_and_noise(0.0, 5.0), decay_and_noise(np.inf, 5.0)
    ((0.0, 1.0), (1.0, 0.0))
    """
    if correlation_s == 0.0:
        return 0.0, 1.0
    share = duration_s / correlation_s
    return float(np.exp(-share)), float(np.sqrt(-np.expm1(-2.0 * share)))


def step_times(start_et: float, end_et: float, weights: Callable[[float], FloatArray]) -> list[float]:
    """Return times from start to end, both included, between which W(et) (6, 3) is straight."""

    def divided(a: float, b: float, wa: FloatArray, wb: FloatArray, left: int) -> list[float]:
        middle = 0.5 * (a + b)
        wm = weights(middle)
        bent = np.abs(wm - 0.5 * (wa + wb))
        size = np.maximum(np.abs(wa), np.abs(wb))
        limits = BENDING * np.repeat([size[:3].max(), size[3:].max()], 3)[:, None]
        if left == 0 or (bent <= limits).all():
            return [b]
        return divided(a, middle, wa, wm, left - 1) + divided(middle, b, wm, wb, left - 1)

    if not end_et > start_et:
        return [start_et, end_et]
    return [
        start_et,
        *divided(start_et, end_et, weights(start_et), weights(end_et), MOST_HALVINGS),
    ]


def acceleration_increments(
    acceleration: Acceleration, duration_s: float, at_start: FloatArray, at_end: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what an acceleration leaves in the state at the epoch over a step.

    Parameters
    ----------
    at_start, at_end : (6, 3) arrays
        W at the two ends of the step; linear between.

    Returns
    -------
    by_p : (6, 3) array
        Of the acceleration at the start; zero for a white one.
    by_p_noise : (6, 3) array
        Of the unit noises that the acceleration itself receives; zero for a white one.
    by_noise : (6, 6) array
        Of further unit noises.
    """
    p1, p2, root = _integrals(acceleration, duration_s)
    slope = (at_end - at_start) / duration_s if duration_s > 0.0 else np.zeros_like(at_start)

    def left(first: float, second: float) -> FloatArray:
        return at_start * first + slope * (duration_s * first - second)

    sigmas = acceleration.sigmas
    by_noise = np.column_stack([left(root[1, k], root[2, k]) * sigmas for k in (1, 2)])
    return left(p1, p2), left(root[1, 0], root[2, 0]) * sigmas, by_noise


def _integrals(acceleration: Acceleration, duration_s: float) -> tuple[float, float, FloatArray]:
    """P1 and P2 of a unit acceleration, and the root (3, 3), lower triangular, of the noise of (p, P1, P2) at unit sigma."""
    h = duration_s
    if acceleration.white:
        root = np.zeros((3, 3))
        root[1:, 1:] = np.sqrt(acceleration.hold_s * h) * np.array([[1.0, 0.0], [h / 2.0, h / np.sqrt(12.0)]])
        return 0.0, 0.0, root
    tau = acceleration.correlation_s
    if not np.isfinite(tau):
        return h, 0.5 * h * h, np.zeros((3, 3))
    response = _response(np.array([h / tau]))[:, 0] * np.array([1.0, tau, tau * tau])
    return (
        float(response[1]),
        float(response[2]),
        _noise_root(h / tau) * np.array([1.0, tau, tau * tau])[:, None],
    )


def _response(u: FloatArray) -> FloatArray:
    """(p, P1, P2) (3, k) that a unit acceleration leaves after u time constants."""
    return np.array([np.exp(-u), -np.expm1(-u), u + np.expm1(-u)])


def _noise_root(steps: float) -> FloatArray:
    """Root (3, 3), lower triangular, of the covariance of (p, P1, P2) after so many time constants: a sum of squares."""
    near = min(steps, FORGOTTEN)
    edges = np.concatenate([np.linspace(0.0, near, PIECES + 1), [steps] if steps > near else []])
    nodes, weights = gauss_legendre(NODES)
    half = 0.5 * np.diff(edges)[:, None]
    u = (edges[:-1, None] + half * (1.0 + nodes)).ravel()
    rows = _response(u) * np.sqrt(2.0 * (half * weights).ravel())
    root = np.asarray(np.linalg.qr(rows.T, mode="r")).T
    return np.asarray(root * np.where(np.diag(root) < 0.0, -1.0, 1.0))


def epoch_weights(transition: Transition, epoch_et: float) -> Callable[[float], FloatArray]:
    """Return W: ``et -> (6, 3)``, d(state at the epoch)/d(velocity at et)."""
    return lambda et: np.asarray(np.linalg.inv(transition(epoch_et, et))[:, 3:])
