"""Batch least squares over many observables: corrections of target and spacecraft states, outliers, and what comes out.

Gauss-Newton on whitened residuals with a priori knowledge as further rows:

    minimise |L^-1 r(x)|^2 + |L0^-1 x|^2,   R = L L' (bodies of a picture share its pointing error),  P0 = L0 L0'

Outliers are told by what remains of a measurement after the fit, over the scatter that the fit predicts for it. A
measurement in use pulls the solution toward itself, so its residual scatters less than the measurement, by R - H P H'; one
that is not in use scatters more, by R + H P H'.

It closes rehearsals and shows what pictures determine. It is no orbit determination program: no dynamics but the state
transition that is given, no stochastic accelerations, no radio data.

Reference: Tapley, Schutz & Born (2004), Statistical Orbit Determination, section 4.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtrc

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.directions import ParameterDirection, directions_of, is_determined, scales_of
from opnav_workbench.estimation.measurements import Dynamics, Measurements, measurements_of
from opnav_workbench.estimation.parameters import (
    APriori,
    ParameterGroup,
    parse_groups,
    prior_rows,
    relative_state,
)
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.observables import Observable
from opnav_workbench.robust import equal_sigmas

__all__ = ["Estimate", "Residual", "estimate", "observability"]


# ---- Outliers: what remains of a measurement after the fit, over the scatter that the fit predicts for it.

# A measurement that alone determines a parameter has no residual left to judge it by.
LEAST_FREEDOM = 1e-6  # of the measurement's own variance


@dataclass(frozen=True, slots=True, eq=False)
class PostfitResidual:
    """What remains of one center (two rows) or range (one row)."""

    kind: str
    number: int
    rows: IntArray
    used: bool
    residual: FloatArray
    sigmas: float
    reason: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


def postfit_residual(
    kind: str,
    number: int,
    rows: IntArray,
    used: bool,
    residuals: FloatArray,
    covariance: FloatArray,
    mapped: FloatArray,
) -> PostfitResidual:
    """Judge one measurement.

    Parameters
    ----------
    kind, number, rows, used
        Copied into the result; `rows` of the following.
    residuals : (k,) array
    covariance, mapped : (k, k) arrays
        Of the measurements, R; and of their computed values by the solution, H P H'.
    """
    block = np.ix_(rows, rows)
    residual, own = residuals[rows], covariance[block]
    predicted = symmetric(own - mapped[block] if used else own + mapped[block])
    size = _normal_sigmas(residual, predicted, own)
    unit = "px" if kind == "center" else "km"
    words = ", ".join(f"{r:.3g}" for r in residual)
    return PostfitResidual(
        kind, number, rows, used, residual, size, f"{size:.1f} sigma off after the fit ({words} {unit})"
    )


def _normal_sigmas(residual: FloatArray, predicted: FloatArray, own: FloatArray) -> float:
    """Return the sigmas of a normal error that is as improbable; zero where no freedom is left."""
    values, vectors = np.linalg.eigh(predicted)
    free = values > LEAST_FREEDOM * float(np.trace(own))
    if not free.any():
        return 0.0
    return equal_sigmas(float(np.sum((vectors.T @ residual)[free] ** 2 / values[free])), int(free.sum()))


def worst_outlier(scatters: Sequence[PostfitResidual], reject_sigmas: float) -> PostfitResidual | None:
    """Return the measurement in use that is farthest off, if that is too far."""
    used = [scatter for scatter in scatters if scatter.used]
    farthest = max(used, key=lambda s: s.sigmas, default=None)
    return farthest if farthest is not None and farthest.sigmas > reject_sigmas else None


# ---- What a batch estimate says; arrays are read-only.


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """One measured center or range, before and after.

    Attributes
    ----------
    image, body, kind
        `kind` is "center" or "range".
    before, after : (2,) or (1,) array
        Observed minus computed, px or km.
    covariance : (2, 2) or (1, 1) array
        Of the measurement, pointing included, px^2 or km^2.
    sigmas
        Size of what remains over its predicted scatter: of a center the sigma of equal probability.
    reason
        Why it was not used.
    """

    image: str
    body: str
    kind: str
    et: float
    before: FloatArray
    after: FloatArray
    covariance: FloatArray
    sigmas: float
    used: bool
    reason: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A batch least-squares estimate.

    Attributes
    ----------
    epoch_et
        Time of the corrected states, TDB seconds past J2000.
    correction : (n,) array
        True minus ephemeris, km, km/s or dimensionless; J2000. A range scale is measured over true range, minus one.
    covariance : (n, n) array
        Its covariance, by the measurements' own (a priori included).
    a_priori_rows : (k, n) array
        A priori knowledge, whitened.
    residuals
        Of every observable with a center, in their order; ranges last.
    left_out
        Observables without a usable center, with their status.
    chi2_before, chi2_after
        Of the used measurements; after with the a priori's share.
    iterations : tuple of (n,) arrays
        Corrections after each pass.
    directions
        What the measurements alone determine, best first.
    """

    groups: tuple[ParameterGroup, ...]
    epoch_et: float
    correction: FloatArray
    covariance: FloatArray
    a_priori_rows: FloatArray
    residuals: tuple[Residual, ...]
    left_out: tuple[str, ...]
    chi2_before: float
    chi2_after: float
    degrees_of_freedom: int
    probability: float
    iterations: tuple[FloatArray, ...]
    converged: bool
    directions: tuple[ParameterDirection, ...]
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(label for group in self.groups for label in group.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the units of the parameters."""
        return tuple(group.unit for group in self.groups for _ in range(group.size))

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """Return the correlation coefficients (n, n)."""
        return np.asarray(self.covariance / np.outer(self.sigma, self.sigma))

    def group(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the correction (k,) and covariance (k, k) of one group.

        Raises
        ------
        EstimationError
            It was not estimated.
        """
        for group in self.groups:
            if group.name == name:
                c = group.columns
                return self.correction[c], self.covariance[c, c]
        raise EstimationError(
            f"{name!r} was not estimated; there are {', '.join(g.name for g in self.groups)}."
        )

    def relative_state(self, body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the correction (6,) of the spacecraft's state relative to a body at the epoch, and its covariance (6, 6).

        Parameters
        ----------
        body
            An observed body; empty for the system as a whole.
        """
        return relative_state(self.groups, self.correction, self.covariance, body)


# ---- Batch least squares over many observables: corrections of target and spacecraft states.

REJECT_SIGMAS = 4.5  # one good center in 150 000 is lost
MAX_ITERATIONS = 20
CONVERGED_SIGMAS = 1e-6  # of the last step; quadratic convergence leaves 1e-12
# Share of the measurements; with more the sigmas or the model are wrong, not the outliers
MOST_REJECTED = 1.0 / 3.0


@dataclass(slots=True)
class _Problem:
    """The whole batch: measurements, what is known before, and which measurements are in use."""

    observables: Sequence[Observable]
    groups: tuple[ParameterGroup, ...]
    dynamics: Dynamics
    measured: Measurements
    prior: FloatArray  # (k, n) whitened
    centers: BoolArray
    ranges: BoolArray
    reasons: dict[tuple[str, int], str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Solution:
    correction: FloatArray
    covariance: FloatArray
    iterations: tuple[FloatArray, ...]
    converged: bool


def estimate(
    observables: Sequence[Observable],
    parameters: Sequence[str] = ("target_position",),
    *,
    epoch_et: float | None = None,
    a_priori: APriori | None = None,
    target_transition: Transition = straight_line,
    spacecraft_transition: Transition = straight_line,
    statuses: Sequence[str] = ("ok",),
    reject_sigmas: float = REJECT_SIGMAS,
) -> Estimate:
    """Estimate corrections of states from observables.

    Parameters
    ----------
    observables
        Of any bodies and pictures; one method a body and picture.
    parameters
        Of ``target_position, target_velocity, spacecraft_position, spacecraft_velocity, range_scale``; with
        ``:BODY`` (``target_position:CHARON``) of one body only, else of all observed bodies together, as a barycenter
        moves them. Pictures see the spacecraft relative to the target: positions of both need a priori sigmas.
    epoch_et
        Of the corrected states; default the last observable.
    a_priori : mapping or (n, n) array, optional
        By parameter name a sigma (km, km/s, share), three sigmas, or a (3, 3) covariance; or the covariance of all. The a
        priori correction is zero.
    target_transition, spacecraft_transition : callable
        ``(epoch_et, et) -> (6, 6)``: `straight_line`, `kepler`, or your own program's.
    statuses
        Observables of other statuses are left out.
    reject_sigmas
        A center or range that remains farther off than this is an outlier; inf for none.

    Raises
    ------
    EstimationError
        No usable observable, an unknown parameter, parameters that nothing determines, or too many outliers.

    Examples
    --------
    ``result = estimate(observables, ["target_position"], a_priori={"target_position": 10000.0})``, then
    ``result.group("target_position")`` and ``[d.words for d in result.directions]``.

    >>> estimate([])
    Traceback (most recent call last):
    ...
    opnav_workbench.errors.EstimationError: none of 0 observables has a center with status ok; nothing to estimate from.
    """
    transitions = target_transition, spacecraft_transition
    problem, left_out = _problem(observables, parameters, epoch_et, a_priori, transitions, statuses)
    solution = _solve(problem)
    while (outlier := worst_outlier(_postfit_residuals(problem, solution), reject_sigmas)) is not None:
        _reject(problem, outlier, reject_sigmas)
        solution = _solve(problem)
    return _estimate(problem, solution, left_out)


def observability(
    observables: Sequence[Observable],
    parameters: Sequence[str] = ("target_position",),
    *,
    epoch_et: float | None = None,
    a_priori: APriori | None = None,
    target_transition: Transition = straight_line,
    spacecraft_transition: Transition = straight_line,
    statuses: Sequence[str] = ("ok",),
) -> tuple[ParameterDirection, ...]:
    """Return what the pictures alone determine of the parameters, best first; arguments as `estimate`.

    The a priori sigmas serve as units only. Directions that nothing determines are no error here.

    Raises
    ------
    EstimationError
        No usable observable, or an unknown parameter.
    """
    transitions = target_transition, spacecraft_transition
    problem, _ = _problem(observables, parameters, epoch_et, a_priori, transitions, statuses)
    return _directions(problem, np.zeros(problem.prior.shape[1]))


def usable_observables(
    observables: Sequence[Observable], groups: Sequence[ParameterGroup], statuses: Sequence[str]
) -> tuple[list[Observable], tuple[str, ...]]:
    """Return what can be estimated from, and what is left out, in words.

    Raises
    ------
    EstimationError
        Nothing is usable, or a parameter is of a body that nobody has seen.
    """
    usable = [o for o in observables if o.has_residual and o.status in statuses]
    if not usable:
        raise EstimationError(
            f"none of {len(observables)} observables has a center with status {' or '.join(statuses)}; nothing to "
            "estimate from."
        )
    names = {o.name.casefold() for o in usable}
    absent = [g.name for g in groups if g.body and g.body.casefold() not in names]
    if absent:
        raise EstimationError(f"{', '.join(absent)}: no observable of that body.")
    kept = {id(o) for o in usable}
    return usable, tuple(f"{o.name} in {o.image}: {_why_left(o)}" for o in observables if id(o) not in kept)


def _why_left(o: Observable) -> str:
    if o.observed_px is None or o.has_residual:
        return o.status
    return (
        "no ephemeris tells where it should be"
        if o.has_direction
        else "the attitude of its picture is unknown"
    )


def _problem(
    observables: Sequence[Observable],
    parameters: Sequence[str],
    epoch_et: float | None,
    a_priori: APriori | None,
    transitions: tuple[Transition, Transition],
    statuses: Sequence[str],
) -> tuple[_Problem, tuple[str, ...]]:
    groups = parse_groups(parameters)
    usable, left_out = usable_observables(observables, groups, statuses)
    dynamics = Dynamics(max(o.et for o in usable) if epoch_et is None else epoch_et, *transitions)
    measured = measurements_of(usable, groups, dynamics)
    everything = np.ones(len(usable), bool), np.ones(len(measured.range_of), bool)
    return _Problem(usable, groups, dynamics, measured, prior_rows(groups, a_priori), *everything), left_out


def _whitened_measurements(problem: _Problem, correction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals and Jacobian of the measurements in use."""
    residual, jacobian = problem.measured.evaluate(correction)
    rows = problem.measured.rows_of(problem.centers, problem.ranges)
    factor = np.linalg.cholesky(problem.measured.covariance[np.ix_(rows, rows)])
    both = np.linalg.solve(factor, np.column_stack([residual[rows], jacobian[rows]]))
    return both[:, 0], both[:, 1:]


def _solve(problem: _Problem) -> _Solution:
    n = problem.prior.shape[1]
    correction = np.zeros(n)
    iterations: list[FloatArray] = []
    covariance, converged = np.full((n, n), np.nan), False
    while not converged and len(iterations) < MAX_ITERATIONS:
        residual, jacobian = _whitened_measurements(problem, correction)
        rows = np.concatenate([jacobian, problem.prior])
        right = np.concatenate([residual, -problem.prior @ correction])
        scale = np.linalg.norm(rows, axis=0)
        _require_determined(problem, rows, correction)
        step, *_ = np.linalg.lstsq(rows / scale, right, rcond=None)
        step = step / scale
        correction = correction + step
        iterations.append(correction)
        converged = float(np.linalg.norm(rows @ step)) < CONVERGED_SIGMAS
        inverse = np.linalg.inv(np.linalg.qr(rows / scale, mode="r")) / scale[:, None]
        covariance = symmetric(inverse @ inverse.T)
    return _Solution(correction, covariance, tuple(iterations), converged)


def _require_determined(problem: _Problem, rows: FloatArray, correction: FloatArray) -> None:
    """Refuse parameters that neither measurements nor a priori sigmas determine."""
    if is_determined(rows * _parameter_scales(problem)):
        return
    loose = [d for d in _directions(problem, correction, rows) if not d.determined]
    raise EstimationError(
        f"the pictures do not determine {len(loose)} of {rows.shape[1]} parameters: "
        f"{loose[0].words.split(':')[0]}; give a priori sigmas or estimate less."
    )


def _parameter_scales(problem: _Problem) -> FloatArray:
    times = [o.et for o in problem.observables] + [problem.dynamics.epoch_et]
    return scales_of(problem.groups, max(times) - min(times), problem.prior)


def _directions(
    problem: _Problem, correction: FloatArray, rows: FloatArray | None = None
) -> tuple[ParameterDirection, ...]:
    sight = problem.measured.observed.mean(axis=0)
    whitened = _whitened_measurements(problem, correction)[1] if rows is None else rows
    return directions_of(whitened, problem.groups, _parameter_scales(problem), sight / np.linalg.norm(sight))


def _postfit_residuals(problem: _Problem, solution: _Solution) -> tuple[PostfitResidual, ...]:
    residual, jacobian = problem.measured.evaluate(solution.correction)
    mapped = jacobian @ solution.covariance @ jacobian.T
    units = [("center", i, np.array([2 * i, 2 * i + 1]), bool(u)) for i, u in enumerate(problem.centers)]
    first = 2 * len(problem.centers)
    units += [("range", j, np.array([first + j]), bool(u)) for j, u in enumerate(problem.ranges)]
    return tuple(
        postfit_residual(kind, number, rows, used, residual, problem.measured.covariance, mapped)
        for kind, number, rows, used in units
    )


def require_few_rejected(rejected: int, total: int, reject_sigmas: float) -> None:
    """Refuse to go on when outliers are no exception any more."""
    if rejected > MOST_REJECTED * total:
        raise EstimationError(
            f"{rejected} of {total} measurements are more than {reject_sigmas:g} sigma off: the sigmas or the "
            "parameters do not fit the pictures; estimate more, or look at the centers."
        )


def _reject(problem: _Problem, outlier: PostfitResidual, reject_sigmas: float) -> None:
    mask = problem.centers if outlier.kind == "center" else problem.ranges
    mask[outlier.number] = False
    rejected = int((~problem.centers).sum() + (~problem.ranges).sum())
    total = len(problem.centers) + len(problem.ranges)
    require_few_rejected(rejected, total, reject_sigmas)
    problem.reasons[outlier.kind, outlier.number] = outlier.reason


def _estimate(problem: _Problem, solution: _Solution, left_out: tuple[str, ...]) -> Estimate:
    before = _whitened_measurements(problem, np.zeros_like(solution.correction))[0]
    after, jacobian = _whitened_measurements(problem, solution.correction)
    known = problem.prior @ solution.correction
    total = float(after @ after + known @ known)
    freedom = len(after) + len(problem.prior) - len(solution.correction)
    messages = () if solution.converged else (f"not converged after {MAX_ITERATIONS} iterations",)
    return Estimate(
        groups=problem.groups,
        epoch_et=problem.dynamics.epoch_et,
        correction=solution.correction,
        covariance=solution.covariance,
        a_priori_rows=problem.prior,
        residuals=_residuals(problem, solution),
        left_out=left_out,
        chi2_before=float(before @ before),
        chi2_after=total,
        degrees_of_freedom=freedom,
        probability=float(chdtrc(freedom, total)) if freedom > 0 else float("nan"),
        iterations=solution.iterations,
        converged=solution.converged,
        directions=_directions(problem, solution.correction, jacobian),
        messages=messages,
    )


def _residuals(problem: _Problem, solution: _Solution) -> tuple[Residual, ...]:
    before = problem.measured.residuals(np.zeros_like(solution.correction))
    made = []
    for scatter in _postfit_residuals(problem, solution):
        of = scatter.number if scatter.kind == "center" else int(problem.measured.range_of[scatter.number])
        o, rows = problem.observables[of], scatter.rows
        made.append(
            Residual(
                image=o.image,
                body=o.name,
                kind=scatter.kind,
                et=o.et,
                before=before[rows],
                after=scatter.residual,
                covariance=problem.measured.covariance[np.ix_(rows, rows)],
                sigmas=scatter.sigmas,
                used=scatter.used,
                reason=problem.reasons.get((scatter.kind, scatter.number), ""),
            )
        )
    return tuple(made)
