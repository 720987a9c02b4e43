"""Square-root information filter and smoother over many observables: the batch's measurements, one picture after the other.

What the batch holds fixed may change here from picture to picture: accelerations, pointing, biases of centers
(`stochastic`). What is known only so well and not to be solved for (GM, radii, focal length) is considered: the solution is
as if it were right, its covariance as it is not.

The state is the correction at the epoch that leads to the trajectory of now (Bierman's pseudo-epoch state): without
accelerations it stands still, and filter and batch are one least-squares problem. As the batch does, it iterates: every pass
of filter and smoother is linearized about the smoothed states of the one before, so that it ends at the most probable
history, whatever the measurements bend.

Outliers are told as in the batch, by what remains of them after the smoothed fit; the worst goes first, and one that fits
after others have gone is taken in again.

References: Bierman (1977), Factorization Methods for Discrete Sequential Estimation; Tapley, Schutz & Born (2004), sections
4.10, 5.10, 6.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.batch import (
    CONVERGED_SIGMAS,
    MAX_ITERATIONS,
    REJECT_SIGMAS,
    PostfitResidual,
    postfit_residual,
    require_few_rejected,
    usable_observables,
    worst_outlier,
)
from opnav_workbench.estimation.measurements import Dynamics, Measurements, measurements_of
from opnav_workbench.estimation.parameters import (
    APriori,
    ParameterGroup,
    parameter_count,
    parse_groups,
    prior_rows,
    relative_state,
    relative_state_matrix,
)
from opnav_workbench.estimation.square_root import (
    Information,
    Smoothed,
    Step,
    StepRows,
    last_smoothed,
    smooth,
    with_measurements,
    with_step,
)
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.estimation.stochastic import (
    Acceleration,
    CenterBias,
    ModelParameter,
    Pointing,
    acceleration_increments,
    decay_and_noise,
    epoch_weights,
    step_times,
)
from opnav_workbench.observables import Observable

__all__ = ["Edit", "FilterEstimate", "FilterResidual", "FilterStep", "filter_estimate"]

# Relative: a solved and a considered parameter of a given covariance that are correlated by more are refused.
UNCORRELATED = 1e-9
# A decay down to here is undone by division; a faster one forgets, and is told from the far side.
UNDONE_DECAY = 0.5


# ---- What a filter says; arrays are read-only.


@dataclass(frozen=True, slots=True, eq=False)
class FilterStep:
    """One picture in the filter: what was known before it, with it, and with all pictures.

    Attributes
    ----------
    predicted, filtered, smoothed, ahead : (n,) arrays
        The parameters, as `FilterEstimate.labels`; nan where the measurements so far do not determine them. `ahead` is the
        filtered ones with the noise until `until_et`.
    predicted_covariance, filtered_covariance, smoothed_covariance, ahead_covariance : (n, n) arrays
        Considered parameters included.
    cost
        Minus twice the logarithm of the likelihood of all measurements so far, states and noises integrated over, but for
        what a priori knowledge and noises alone make it; nan where the state is not determined. Considered parameters count
        as what they are believed to be.
    """

    image: str
    et: float
    predicted: FloatArray
    predicted_covariance: FloatArray
    filtered: FloatArray
    filtered_covariance: FloatArray
    smoothed: FloatArray
    smoothed_covariance: FloatArray
    ahead: FloatArray
    ahead_covariance: FloatArray
    cost: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class FilterResidual:
    """One measured center or range on its way through the filter.

    Attributes
    ----------
    image, body, kind
        `kind` is "center" or "range".
    a_priori, before, after, smoothed : (2,) or (1,) arrays
        Observed minus computed, px or km: with no correction; before the filter took the picture in; after; and with all
        pictures. nan where the state is not determined yet.
    covariance : (2, 2) or (1, 1) array
        Of the measurement, solved attitude included.
    before_sigmas, sigmas
        Of `before` and of `smoothed` over the scatter that the filter predicts for it.
    reason
        Why it was not used.
    """

    image: str
    body: str
    kind: str
    et: float
    a_priori: FloatArray
    before: FloatArray
    after: FloatArray
    smoothed: FloatArray
    covariance: FloatArray
    before_sigmas: float
    sigmas: float
    used: bool
    reason: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class Edit:
    """One decision on a measurement, in the order in which they fell.

    Attributes
    ----------
    action : {"left out", "taken in again"}
    """

    image: str
    body: str
    kind: str
    action: str
    sigmas: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class FilterEstimate:
    """A filtered and smoothed estimate.

    Attributes
    ----------
    groups
        Parameters as in the batch; the first of the n.
    labels, units
        Of all n parameters: groups, constants of the model, stochastic ones.
    considered
        Labels of those that are not solved for; their correction is zero, their covariance the a priori one.
    epoch_et
        Of the corrected states, TDB seconds past J2000.
    correction : (n,) array
        After the last picture (and the noise until `until_et`): true minus ephemeris at the epoch, had the trajectory of
        now been that from the epoch on. J2000.
    covariance : (n, n) array
        With what considered parameters add.
    computed_covariance : (n, n) array
        Without it; zero for the considered ones.
    sensitivity : (n, q) array
        d(correction)/d(considered parameter), true minus believed: what the solution would move by.
    steps
        One a picture, in order of time.
    residuals
        Of every observable with a center, by picture; its range after it.
    edits
        What was left out and taken in again.
    chi2
        Of the used measurements, a priori knowledge and noise, all pictures.
    iterations
        Passes of filter and smoother, over all edits.
    """

    groups: tuple[ParameterGroup, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    considered: tuple[str, ...]
    epoch_et: float
    correction: FloatArray
    covariance: FloatArray
    computed_covariance: FloatArray
    sensitivity: FloatArray
    steps: tuple[FilterStep, ...]
    residuals: tuple[FilterResidual, ...]
    edits: tuple[Edit, ...]
    left_out: tuple[str, ...]
    chi2: float
    degrees_of_freedom: int
    probability: float
    iterations: int
    converged: bool
    messages: tuple[str, ...]
    dynamics: Dynamics = field(repr=False)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations (n,), considered parameters included."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def parameter(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the correction (k,) and covariance (k, k) of a group or of a single parameter by its label.

        Raises
        ------
        EstimationError
            There is none of that name.
        """
        columns = next((np.arange(g.start, g.start + g.size) for g in self.groups if g.name == name), None)
        if columns is None and name in self.labels:
            columns = np.array([self.labels.index(name)])
        if columns is None:
            names = [*(g.name for g in self.groups), *self.labels[parameter_count(self.groups) :]]
            raise EstimationError(f"{name!r} was not estimated; there are {', '.join(names)}.")
        return self.correction[columns], self.covariance[np.ix_(columns, columns)]

    def relative_state(self, body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the correction (6,) of the spacecraft's state relative to a body, and its covariance (6, 6)."""
        return relative_state(self.groups, self.correction, self.covariance, body)

    def state_history(self, mover: str = "spacecraft", body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the smoothed correction of a state at the time of every picture, (k, 6), and its covariance (k, 6, 6).

        Parameters
        ----------
        mover : {"spacecraft", "target"}
        body
            The observed body of target parameters; empty for the system as a whole.
        """
        transition = self.dynamics.target if mover == "target" else self.dynamics.spacecraft
        of_mover = [g for g in self.groups if g.kind.startswith(f"{mover}_")]
        sign = -1.0 if mover == "target" else 1.0
        at_epoch = sign * relative_state_matrix(of_mover, len(self.correction), body)
        maps = [transition(self.epoch_et, step.et) @ at_epoch for step in self.steps]
        states = [m @ s.smoothed for m, s in zip(maps, self.steps, strict=True)]
        spreads = [m @ s.smoothed_covariance @ m.T for m, s in zip(maps, self.steps, strict=True)]
        return np.array(states), symmetric(np.array(spreads))


# ---- The parameters, and what is known of them before.


@dataclass(frozen=True, slots=True)
class _Source:
    """A stochastic parameter group among the states."""

    kind: Acceleration | Pointing | CenterBias
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """All parameters: those of the batch, constants of the model, stochastic ones. Solved are all but the considered."""

    groups: tuple[ParameterGroup, ...]
    models: tuple[ModelParameter, ...]
    accelerations: tuple[tuple[Acceleration, slice | None], ...]  # with their columns; white ones have none
    sources: tuple[_Source, ...]
    constants: int  # groups and models together
    count: int
    solved: IntArray
    considered: IntArray

    @property
    def labels(self) -> tuple[str, ...]:
        names = [label for group in self.groups for label in group.labels] + [m.name for m in self.models]
        number = 0
        for source in self.sources:
            if isinstance(source.kind, Acceleration):
                number += 1
                names += [f"{source.kind.mover}_acceleration {number} {axis}" for axis in "xyz"]
            else:
                names += list(source.kind.labels)
        return tuple(names)

    @property
    def units(self) -> tuple[str, ...]:
        units = [group.unit for group in self.groups for _ in range(group.size)] + [
            m.unit for m in self.models
        ]
        for source in self.sources:
            unit = "km/s^2" if isinstance(source.kind, Acceleration) else source.kind.unit
            units += [unit] * len(source.kind.sigmas)
        return tuple(units)

    @property
    def sigmas(self) -> FloatArray:
        """Sigmas of models and stochastic parameters, as they stand after the groups."""
        values = [np.array([m.sigma for m in self.models]), *(s.kind.sigmas for s in self.sources)]
        return np.concatenate([np.empty(0), *values])

    def mover_columns(self, mover: str) -> IntArray:
        """Columns of a mover's position and velocity, for all bodies together."""
        found: list[int] = []
        for quantity in ("position", "velocity"):
            found += [
                c for g in self.groups if g.name == f"{mover}_{quantity}" for c in range(g.start, g.start + 3)
            ]
        return np.array(found, dtype=np.int64)


def _layout(
    groups: tuple[ParameterGroup, ...],
    accelerations: Sequence[Acceleration],
    pointing: Pointing | None,
    biases: Sequence[CenterBias],
    models: Sequence[ModelParameter],
    consider: Sequence[str],
) -> _Layout:
    constants = parameter_count(groups) + len(models)
    kinds: list[Acceleration | Pointing | CenterBias] = [a for a in accelerations if not a.white]
    kinds += [] if pointing is None else [pointing]
    kinds += list(biases)
    sources, start = [], constants
    for kind in kinds:
        sources.append(_Source(kind, slice(start, start + len(kind.sigmas))))
        start += len(kind.sigmas)
    considered = _considered_columns(groups, models, consider)
    solved = np.setdiff1d(np.arange(start), considered)
    acting: list[tuple[Acceleration, slice | None]] = [(a, None) for a in accelerations if a.white]
    acting += [(s.kind, s.columns) for s in sources if isinstance(s.kind, Acceleration)]
    layout = _Layout(
        groups, tuple(models), tuple(acting), tuple(sources), constants, start, solved, considered
    )
    _check_layout(layout)
    return layout


def _considered_columns(
    groups: Sequence[ParameterGroup], models: Sequence[ModelParameter], consider: Sequence[str]
) -> IntArray:
    names = {g.name: list(range(g.start, g.start + g.size)) for g in groups}
    names |= {m.name: [parameter_count(groups) + k] for k, m in enumerate(models)}
    unknown = [name for name in consider if name not in names]
    if unknown:
        raise EstimationError(
            f"{', '.join(unknown)} cannot be considered: not among the parameters {', '.join(names)}."
        )
    return np.array([column for name in dict.fromkeys(consider) for column in names[name]], dtype=np.int64)


def _check_layout(layout: _Layout) -> None:
    if len(set(layout.labels)) < len(layout.labels):
        twice = sorted({name for name in layout.labels if layout.labels.count(name) > 1})
        raise EstimationError(f"{', '.join(twice)}: given twice.")
    if not len(layout.solved):
        raise EstimationError("all parameters are considered; nothing is left to solve for.")
    for acceleration, _ in layout.accelerations:
        columns = layout.mover_columns(acceleration.mover)
        if len(columns) < 6 or np.isin(columns, layout.considered).any():
            raise EstimationError(
                f"an acceleration of the {acceleration.mover} needs {acceleration.mover}_position and "
                f"{acceleration.mover}_velocity among the solved parameters."
            )


def _prior(layout: _Layout, a_priori: APriori | None) -> tuple[FloatArray, FloatArray]:
    """Whitened rows (k, n) of the solved parameters, and the root (q, q) of the considered ones' covariance."""
    known = prior_rows(layout.groups, a_priori)
    own = np.arange(len(layout.sigmas))
    rows = np.zeros((len(known) + len(own), layout.count))
    rows[: len(known), : known.shape[1]] = known
    rows[len(known) + own, parameter_count(layout.groups) + own] = 1.0 / layout.sigmas
    of_considered = (rows[:, layout.considered] != 0.0).any(axis=1)
    return rows[~of_considered][:, layout.solved], _considered_root(layout, rows[of_considered])


def _considered_root(layout: _Layout, rows: FloatArray) -> FloatArray:
    own = rows[:, layout.considered]
    names = ", ".join(layout.labels[c] for c in layout.considered)
    if len(own) < len(layout.considered):
        raise EstimationError(
            f"considered are {names}, and not all have an a priori sigma; give one to each."
        )
    if rows[:, layout.solved].any():
        raise EstimationError(
            f"the a priori covariance ties {names}, which are considered, to solved parameters; give their own sigmas."
        )
    return np.asarray(np.linalg.inv(own))


# ---- Pictures: residuals and partials for any state.


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """The measurements of one picture and how they depend on all parameters."""

    image: str
    et: float
    observables: tuple[Observable, ...]
    measured: Measurements
    direct: FloatArray  # (rows, n): what moves pixels without moving bodies
    constants: int
    first: int  # number of its first center among all, for names of measurements

    @property
    def units(self) -> list[tuple[str, int, IntArray]]:
        """Kind, number within the picture and rows of every measurement."""
        m = len(self.observables)
        centers = [("center", i, np.array([2 * i, 2 * i + 1])) for i in range(m)]
        return centers + [("range", j, np.array([2 * m + j])) for j in range(len(self.measured.range_of))]

    def body(self, kind: str, number: int) -> str:
        """Name of a measurement's body."""
        return self.observables[number if kind == "center" else int(self.measured.range_of[number])].name

    def evaluate(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (rows,) and d(computed)/d(parameters) (rows, n) at a state (n,)."""
        residual, jacobian = self.measured.evaluate(state[: self.constants])
        partials = self.direct.copy()
        partials[:, : self.constants] += jacobian
        return residual - self.direct @ state, partials


def _pictures(observables: Sequence[Observable], layout: _Layout, dynamics: Dynamics) -> tuple[_Picture, ...]:
    images: dict[str, list[Observable]] = {}
    for o in observables:
        images.setdefault(o.image, []).append(o)
    made, first = [], 0
    for image, members in sorted(images.items(), key=lambda item: (item[1][0].et, item[0])):
        measured = _with_models(measurements_of(members, layout.groups, dynamics), members, layout, dynamics)
        direct = _direct_partials(members, len(measured.covariance), layout)
        made.append(_Picture(image, members[0].et, tuple(members), measured, direct, layout.constants, first))
        first += len(members)
    return tuple(made)


def _with_models(
    measured: Measurements, observables: Sequence[Observable], layout: _Layout, dynamics: Dynamics
) -> Measurements:
    """Measurements that depend on constants of the model as well, as far as they move the spacecraft."""
    m = len(observables)
    moved = np.zeros((m, 6, len(layout.models)))
    for k, model in enumerate(layout.models):
        if (trajectory := model.trajectory) is not None:
            moved[:, :, k] = np.array([trajectory(dynamics.epoch_et, o.et) for o in observables], float)
    none = np.zeros((m, 3, len(layout.models)))
    return replace(
        measured,
        by_target=np.concatenate([measured.by_target, none], axis=2),
        by_spacecraft=np.concatenate([measured.by_spacecraft, moved[:, :3]], axis=2),
        by_velocity=np.concatenate([measured.by_velocity, moved[:, 3:]], axis=2),
        range_scale=np.column_stack(
            [measured.range_scale, np.zeros((len(measured.range_of), len(layout.models)))]
        ),
    )


def _direct_partials(observables: Sequence[Observable], rows: int, layout: _Layout) -> FloatArray:
    direct = np.zeros((rows, layout.count))
    start = parameter_count(layout.groups)
    for i, o in enumerate(observables):
        centers = slice(2 * i, 2 * i + 2)
        for k, model in enumerate(layout.models):
            if model.pixels is not None:
                direct[centers, start + k] = np.asarray(model.pixels(o), float)
        for source in layout.sources:
            if not isinstance(source.kind, Acceleration):
                direct[centers, source.columns] = source.kind.partials(o)
    return direct


# ---- Steps in time.


def _steps_between(layout: _Layout, dynamics: Dynamics, start_et: float, end_et: float) -> Iterator[Step]:
    """Steps from one picture to the next; several where an acceleration begins or ends, or the trajectory bends."""
    if not layout.sources and not layout.accelerations:
        return
    weights = {
        a.mover: epoch_weights(getattr(dynamics, a.mover), dynamics.epoch_et) for a, _ in layout.accelerations
    }
    edges = {start_et, end_et}
    edges |= {e for a, _ in layout.accelerations for e in (a.from_et, a.to_et) if start_et < e < end_et}
    times = sorted(edges) if end_et > start_et else [start_et, end_et]
    for of_mover in weights.values():
        pieces = [step_times(a, b, of_mover) for a, b in pairwise(times)]
        times = [times[0], *(t for piece in pieces for t in piece[1:])]
    for a, b in pairwise(times):
        values = {mover: (w(a), w(b)) for mover, w in weights.items()}
        yield _step(layout, a, b, values)


def _step(
    layout: _Layout, start_et: float, end_et: float, weights: Mapping[str, tuple[FloatArray, FloatArray]]
) -> Step:
    """One step over which the weights of accelerations are straight; see `square_root.Step`.

    Forward it is ``p' = m p + l w`` for every stochastic parameter and ``x' = x + V p + G w + H v`` for the others, with v
    the noise that an acceleration leaves in the state beside its own. Backward p is found again by division; one that decays
    fast is told from the far side, where nothing grows.
    """
    solved, n = layout.solved, len(layout.solved)
    place = {int(column): k for k, column in enumerate(solved)}
    p_columns = np.array(
        [place[c] for s in layout.sources for c in range(s.columns.start, s.columns.stop)], int
    )
    m, noise = _decays(layout, end_et - start_et)
    by_p, by_w, by_v = _increments(layout, place, start_et, end_et, weights)
    undone = m > UNDONE_DECAY
    safe_m, safe_l = np.where(undone, m, 1.0), np.where(undone, 1.0, noise)
    # p and w in terms of (u, p'), with u = w where the decay is undone and u = p where it is not.
    p_of_u, p_of_next = np.where(undone, -noise / safe_m, 1.0), np.where(undone, 1.0 / safe_m, 0.0)
    w_of_u, w_of_next = np.where(undone, 1.0, -m / safe_l), np.where(undone, 0.0, 1.0 / safe_l)
    count, extra = len(m), by_v.shape[1]
    by_noise = np.zeros((n, count + extra))
    by_next = np.eye(n)
    by_noise[:, :count] = -by_p * p_of_u - by_w * w_of_u
    by_noise[:, count:] = -by_v
    by_next[:, p_columns] -= by_p * p_of_next + by_w * w_of_next
    by_noise[p_columns, np.arange(count)] = p_of_u
    by_next[p_columns, p_columns] = p_of_next
    next_rows = np.zeros((count + extra, n))
    next_rows[np.arange(count), p_columns] = w_of_next
    return Step(by_noise, by_next, np.diag(np.concatenate([w_of_u, np.ones(extra)])), next_rows)


def _decays(layout: _Layout, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Return m and l of every stochastic parameter."""
    pairs = [
        (m, share * sigma)
        for source in layout.sources
        for m, share in [decay_and_noise(source.kind.correlation_s, duration_s)]
        for sigma in source.kind.sigmas
    ]
    table = np.array(pairs).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _increments(
    layout: _Layout,
    place: Mapping[int, int],
    start_et: float,
    end_et: float,
    weights: Mapping[str, tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """V, G (n, stochastic parameters) and H (n, further noises) of all accelerations over a step."""
    n = len(layout.solved)
    count = layout.count - layout.constants
    by_p, by_w, by_v = np.zeros((n, count)), np.zeros((n, count)), [np.zeros((n, 0))]
    for acceleration, columns in layout.accelerations:
        if not acceleration.acts(start_et, end_et):
            continue
        rows = np.array([place[int(c)] for c in layout.mover_columns(acceleration.mover)])
        v, g, h = acceleration_increments(acceleration, end_et - start_et, *weights[acceleration.mover])
        further = np.zeros((n, h.shape[1]))
        further[rows] = h
        by_v.append(further)
        if columns is not None:
            own = np.arange(columns.start - layout.constants, columns.stop - layout.constants)
            by_p[np.ix_(rows, own)], by_w[np.ix_(rows, own)] = v, g
    return by_p, by_w, np.concatenate(by_v, axis=1)


# ---- Passes of filter and smoother.


@dataclass(slots=True)
class _Problem:
    layout: _Layout
    dynamics: Dynamics
    pictures: tuple[_Picture, ...]
    prior: FloatArray  # (k, n) whitened, of the solved parameters
    considered_root: FloatArray
    steps: tuple[tuple[Step, ...], ...]  # before each picture, and after the last
    ahead: tuple[tuple[Step, ...], ...]  # from each picture until the end
    used: list[BoolArray]
    again: set[tuple[int, int]] = field(default_factory=set)
    edits: list[Edit] = field(default_factory=list)
    reasons: dict[tuple[int, int], str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _Pass:
    """One pass: what is known before and after each picture, smoothed there, and at the end."""

    before: tuple[Information, ...]
    after: tuple[Information, ...]
    smoothed: tuple[Smoothed, ...]
    costs: tuple[float, ...]
    end: Information


def _full(layout: _Layout, solved: FloatArray) -> FloatArray:
    """All parameters from the solved ones; the considered are believed right."""
    state = np.zeros(layout.count)
    state[layout.solved] = solved
    return state


def _one_pass(problem: _Problem, references: Sequence[FloatArray]) -> _Pass:
    n, q = len(problem.layout.solved), len(problem.layout.considered)
    known = Information(np.zeros((n, n)), np.zeros((n, 1 + q)))
    known = with_measurements(known, problem.prior, np.zeros((len(problem.prior), 1 + q)))
    before, after, kept = [], [], []
    for picture, used, steps, reference in zip(
        problem.pictures, problem.used, problem.steps, references, strict=False
    ):
        known, rows = _through(known, steps)
        kept.append(rows)
        before.append(known)
        known = with_measurements(known, *_whitened(problem, picture, used, reference))
        after.append(known)
    end, last = _through(known, problem.steps[-1])
    state = last_smoothed(_determined(problem, end))
    smoothed: list[Smoothed] = []
    for rows in [last, *reversed(kept[1:])]:
        for row in reversed(rows):
            state = smooth(state, row)
        smoothed.append(state)
    costs = _costs(problem, after, kept)
    return _Pass(tuple(before), tuple(after), tuple(reversed(smoothed)), costs, end)


def _costs(
    problem: _Problem, after: Sequence[Information], kept: Sequence[Sequence[StepRows]]
) -> tuple[float, ...]:
    """Return `FilterStep.cost` of every picture."""
    costs, passed = [], 0.0
    for picture, used, known, rows in zip(problem.pictures, problem.used, after, kept, strict=True):
        chosen = _rows_in_use(picture, used)
        passed += float(np.linalg.slogdet(picture.measured.covariance[np.ix_(chosen, chosen)])[1])
        passed += sum(row.log_information for row in rows)
        costs.append(passed + known.square_sum + known.log_information if known.determined else float("nan"))
    return tuple(costs)


def _rows_in_use(picture: _Picture, used: BoolArray) -> IntArray:
    chosen = [rows for (_, _, rows), u in zip(picture.units, used, strict=True) if u]
    return np.concatenate([np.empty(0, dtype=np.int64), *chosen])


def _through(known: Information, steps: Sequence[Step]) -> tuple[Information, list[StepRows]]:
    kept = []
    for step in steps:
        known, rows = with_step(known, step)
        kept.append(rows)
    return known, kept


def _determined(problem: _Problem, known: Information) -> Information:
    if not known.determined:
        names = [problem.layout.labels[c] for c in problem.layout.solved[known.loose]]
        raise EstimationError(
            f"the pictures do not determine {', '.join(names)}; give a priori sigmas or estimate less."
        )
    return known


def _whitened(
    problem: _Problem, picture: _Picture, used: BoolArray, reference: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows of solved parameters (k, n), and data with columns of considered ones (k, 1 + q), of unit noise."""
    layout = problem.layout
    residual, partials = picture.evaluate(reference)
    residual = residual + partials @ reference
    rows = _rows_in_use(picture, used)
    factor = np.linalg.cholesky(picture.measured.covariance[np.ix_(rows, rows)])
    table = np.column_stack(
        [partials[rows][:, layout.solved], residual[rows], partials[rows][:, layout.considered]]
    )
    white = np.linalg.solve(factor, table)
    n = len(layout.solved)
    return white[:, :n], white[:, n:]


def _solve(problem: _Problem) -> tuple[_Pass, tuple[FloatArray, ...], int, bool]:
    """Iterate to the most probable history; return the last pass and the states that it was linearized about."""
    references: tuple[FloatArray, ...] = tuple(np.zeros(problem.layout.count) for _ in problem.pictures)
    for iteration in range(1, MAX_ITERATIONS + 1):
        found = _one_pass(problem, references)
        states = tuple(_full(problem.layout, s.state[:, 0]) for s in found.smoothed)
        steps = [
            np.linalg.norm(np.linalg.lstsq(s.root, (new - old)[problem.layout.solved], rcond=None)[0])
            for s, new, old in zip(found.smoothed, states, references, strict=True)
        ]
        if max(steps) < CONVERGED_SIGMAS:
            return found, references, iteration, True
        references = states
    return found, references, MAX_ITERATIONS, False


# ---- The estimate.


def filter_estimate(
    observables: Sequence[Observable],
    parameters: Sequence[str] = ("target_position",),
    *,
    epoch_et: float | None = None,
    a_priori: APriori | None = None,
    target_transition: Transition = straight_line,
    spacecraft_transition: Transition = straight_line,
    accelerations: Sequence[Acceleration] = (),
    pointing: Pointing | None = None,
    biases: Sequence[CenterBias] = (),
    model: Sequence[ModelParameter] = (),
    consider: Sequence[str] = (),
    statuses: Sequence[str] = ("ok",),
    reject_sigmas: float = REJECT_SIGMAS,
    until_et: float | None = None,
) -> FilterEstimate:
    """Estimate corrections of states picture by picture, with what changes between pictures, and smooth them.

    Parameters
    ----------
    observables, parameters, epoch_et, a_priori, target_transition, spacecraft_transition, statuses, reject_sigmas
        As for the batch, `estimate`. The a priori knowledge holds when noise begins to act: at the epoch or the first
        picture, whichever is earlier.
    accelerations
        Stochastic, of spacecraft or target; those of intervals for a noise that changes.
    pointing
        Errors of attitudes beyond the solved attitudes' own covariance, which is always counted.
    biases
        Of centers, in pixel and line.
    model
        Constants to be solved for as well: `gravity`, `focal_length`, or a `ModelParameter` of your own.
    consider
        Names among `parameters` and `model` that are not solved for; their a priori sigmas count in every covariance.
    until_et
        Noise acts until then, in the result, when that is after the last picture: the encounter, for a B-plane.

    Raises
    ------
    EstimationError
        No usable observable, an unknown parameter, parameters that nothing determines, or too many outliers.

    Examples
    --------
    ``filter_estimate(observables, ["spacecraft_position", "spacecraft_velocity"], a_priori={...},
    accelerations=[Acceleration(2e-12, correlation_s=5 * 86400.0)])``; then ``result.residuals``, ``result.edits``,
    ``result.steps`` and ``map_to_b_plane(result, ...)``.

    >>> filter_estimate([])
    Traceback (most recent call last):
    ...
    opnav_workbench.errors.EstimationError: none of 0 observables has a center with status ok; nothing to estimate from.
    """
    groups = parse_groups(parameters)
    usable, left_out = usable_observables(observables, groups, statuses)
    layout = _layout(groups, accelerations, pointing, biases, model, consider)
    epoch = max(o.et for o in usable) if epoch_et is None else epoch_et
    problem = _problem(
        usable, layout, Dynamics(epoch, target_transition, spacecraft_transition), a_priori, until_et
    )
    solution = _edited(problem, reject_sigmas)
    return _result(problem, *solution, left_out)


def _problem(
    usable: Sequence[Observable],
    layout: _Layout,
    dynamics: Dynamics,
    a_priori: APriori | None,
    until_et: float | None,
) -> _Problem:
    pictures = _pictures(usable, layout, dynamics)
    prior, root = _prior(layout, a_priori)
    times = [p.et for p in pictures]
    times = [
        min(times[0], dynamics.epoch_et),
        *times,
        times[-1] if until_et is None else max(times[-1], until_et),
    ]
    steps = []
    for k, (a, b) in enumerate(pairwise(times)):
        within = 0 < k < len(pictures)  # from picture to picture what is white is new, even in no time
        steps.append(tuple(_steps_between(layout, dynamics, a, b)) if within or b > a else ())
    ahead = tuple(
        tuple(_steps_between(layout, dynamics, p.et, times[-1]))
        if until_et is not None and times[-1] > p.et
        else ()
        for p in pictures
    )
    used = [np.ones(len(p.units), bool) for p in pictures]
    return _Problem(layout, dynamics, pictures, prior, root, tuple(steps), ahead, used)


def _edited(problem: _Problem, reject_sigmas: float) -> tuple[_Pass, tuple[FloatArray, ...], int, bool]:
    """Solve, leave out the worst, take in again what fits, until nothing changes."""
    total = 0
    while True:
        found, references, iterations, converged = _solve(problem)
        total += iterations
        judged = _judged(problem, found, references)
        outlier = worst_outlier([j for _, j in judged], reject_sigmas)
        if outlier is not None:
            _leave_out(problem, next(k for k, j in judged if j is outlier), outlier, reject_sigmas)
            continue
        fitting = [
            (k, j)
            for k, j in judged
            if not j.used and j.sigmas <= reject_sigmas and (k, j.number) not in problem.again
        ]
        if not fitting:
            return found, references, total, converged
        _take_in(problem, *min(fitting, key=lambda item: item[1].sigmas))


def _judged(
    problem: _Problem, found: _Pass, references: Sequence[FloatArray]
) -> list[tuple[int, PostfitResidual]]:
    """Every measurement by what remains of it with all pictures: (picture, residual); numbers count within the picture."""
    judged = []
    for k, (picture, used, reference, smoothed) in enumerate(
        zip(problem.pictures, problem.used, references, found.smoothed, strict=True)
    ):
        state = _full(problem.layout, smoothed.state[:, 0])
        residual = picture.evaluate(state)[0]
        partials = picture.evaluate(reference)[1]
        judged += [(k, j) for j in _scatter(problem, picture, used, residual, partials, smoothed)]
    return judged


def _scatter(
    problem: _Problem,
    picture: _Picture,
    used: BoolArray,
    residual: FloatArray,
    partials: FloatArray,
    at: Smoothed,
) -> list[PostfitResidual]:
    """Residuals of a picture over what the fit predicts for them, considered parameters included.

    What is not used is held against the used centers of its picture too, whose pointing error it shares.
    """
    of_used = _rows_in_use(picture, used)
    judged = []
    for unit, ((kind, _, rows), u) in enumerate(zip(picture.units, used, strict=True)):
        others = of_used[:0] if u else of_used
        left, own, moved = _given_others(picture.measured.covariance, residual, partials, rows, others)
        solved = moved[:, problem.layout.solved]
        by_state = solved @ at.root
        by_considered = moved[:, problem.layout.considered] - solved @ at.state[:, 1:]
        further = by_considered @ problem.considered_root
        mapped = by_state @ by_state.T + (-1.0 if u else 1.0) * further @ further.T
        all_rows = np.arange(len(rows))
        scatter = postfit_residual(kind, unit, all_rows, bool(u), left, own, mapped)
        judged.append(replace(scatter, rows=rows))
    return judged


def _given_others(
    covariance: FloatArray, residual: FloatArray, partials: FloatArray, rows: IntArray, others: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residual, covariance and partials of measurements, less what errors that they share with others explain."""
    weight = np.linalg.solve(covariance[np.ix_(others, others)], covariance[np.ix_(others, rows)]).T
    left = residual[rows] - weight @ residual[others]
    own = covariance[np.ix_(rows, rows)] - weight @ covariance[np.ix_(others, rows)]
    return left, own, partials[rows] - weight @ partials[others]


def _leave_out(problem: _Problem, k: int, outlier: PostfitResidual, reject_sigmas: float) -> None:
    problem.used[k][outlier.number] = False
    rejected = sum(int((~used).sum()) for used in problem.used)
    require_few_rejected(rejected, sum(len(used) for used in problem.used), reject_sigmas)
    problem.reasons[k, outlier.number] = outlier.reason
    _note(problem, k, outlier, "left out", outlier.reason)


def _take_in(problem: _Problem, k: int, fitting: PostfitResidual) -> None:
    problem.used[k][fitting.number] = True
    problem.again.add((k, fitting.number))
    problem.reasons.pop((k, fitting.number), None)
    words = f"{fitting.sigmas:.1f} sigma off what the others say"
    _note(problem, k, fitting, "taken in again", words)


def _note(problem: _Problem, k: int, judged: PostfitResidual, action: str, words: str) -> None:
    picture = problem.pictures[k]
    kind, number, _ = picture.units[judged.number]
    problem.edits.append(Edit(picture.image, picture.body(kind, number), kind, action, judged.sigmas, words))


def _result(
    problem: _Problem,
    found: _Pass,
    references: Sequence[FloatArray],
    iterations: int,
    converged: bool,
    left_out: tuple[str, ...],
) -> FilterEstimate:
    layout = problem.layout
    correction, covariance = _known(problem, found.end)
    state, root = found.end.state(), found.end.covariance_root()
    computed = np.zeros_like(covariance)
    computed[np.ix_(layout.solved, layout.solved)] = root @ root.T
    sensitivity = np.zeros((layout.count, len(layout.considered)))
    sensitivity[layout.solved] = -state[:, 1:]
    sensitivity[layout.considered] = np.eye(len(layout.considered))
    freedom = _freedom(problem)
    chi2 = found.end.square_sum
    return FilterEstimate(
        groups=layout.groups,
        labels=layout.labels,
        units=layout.units,
        considered=tuple(layout.labels[c] for c in layout.considered),
        epoch_et=problem.dynamics.epoch_et,
        correction=correction,
        covariance=covariance,
        computed_covariance=symmetric(computed),
        sensitivity=sensitivity,
        steps=_filter_steps(problem, found),
        residuals=_filter_residuals(problem, found, references),
        edits=tuple(problem.edits),
        left_out=left_out,
        chi2=chi2,
        degrees_of_freedom=freedom,
        probability=float(chdtrc(freedom, chi2)) if freedom > 0 else float("nan"),
        iterations=iterations,
        converged=converged,
        messages=() if converged else (f"not converged after {MAX_ITERATIONS} iterations",),
        dynamics=problem.dynamics,
    )


def _freedom(problem: _Problem) -> int:
    """Rows of data and of a priori knowledge, less parameters; each noise brings one row and one unknown."""
    measured = sum(
        len(rows)
        for picture, used in zip(problem.pictures, problem.used, strict=True)
        for (_, _, rows), u in zip(picture.units, used, strict=True)
        if u
    )
    return measured + len(problem.prior) - len(problem.layout.solved)


def _known(problem: _Problem, at: Information | Smoothed) -> tuple[FloatArray, FloatArray]:
    """All parameters (n,) and their covariance (n, n), with considered ones; nan where not determined."""
    layout = problem.layout
    n = layout.count
    if isinstance(at, Information) and not at.determined:
        return np.full(n, np.nan), np.full((n, n), np.nan)
    state, root = (at.state(), at.covariance_root()) if isinstance(at, Information) else (at.state, at.root)
    columns = np.zeros((n, len(layout.solved) + len(layout.considered)))
    columns[layout.solved] = np.column_stack([root, -state[:, 1:] @ problem.considered_root])
    columns[layout.considered, len(layout.solved) :] = problem.considered_root
    return _full(layout, state[:, 0]), symmetric(columns @ columns.T)


def _filter_steps(problem: _Problem, found: _Pass) -> tuple[FilterStep, ...]:
    return tuple(
        FilterStep(
            picture.image,
            picture.et,
            *_known(problem, before),
            *_known(problem, after),
            *_known(problem, smoothed),
            *_known(problem, _through(after, steps)[0]),
            cost,
        )
        for picture, before, after, smoothed, steps, cost in zip(
            problem.pictures,
            found.before,
            found.after,
            found.smoothed,
            problem.ahead,
            found.costs,
            strict=True,
        )
    )


def _filter_residuals(
    problem: _Problem, found: _Pass, references: Sequence[FloatArray]
) -> tuple[FilterResidual, ...]:
    made: list[FilterResidual] = []
    judged = iter(_judged(problem, found, references))
    for k, (picture, reference) in enumerate(zip(problem.pictures, references, strict=True)):
        partials = picture.evaluate(reference)[1]
        a_priori = picture.evaluate(np.zeros(problem.layout.count))[0]
        smoothed = picture.evaluate(_full(problem.layout, found.smoothed[k].state[:, 0]))[0]
        before, after = (_passed(problem, picture, at[k]) for at in (found.before, found.after))
        sizes = _predicted_sizes(problem, picture, found.before[k], before, partials)
        for unit, (kind, number, rows) in enumerate(picture.units):
            _, scatter = next(judged)
            made.append(
                FilterResidual(
                    image=picture.image,
                    body=picture.body(kind, number),
                    kind=kind,
                    et=picture.et,
                    a_priori=a_priori[rows],
                    before=before[rows],
                    after=after[rows],
                    smoothed=smoothed[rows],
                    covariance=picture.measured.covariance[np.ix_(rows, rows)],
                    before_sigmas=sizes[unit],
                    sigmas=scatter.sigmas,
                    used=scatter.used,
                    reason=problem.reasons.get((k, unit), ""),
                )
            )
    return tuple(made)


def _passed(problem: _Problem, picture: _Picture, known: Information) -> FloatArray:
    """Residuals of a picture by what was known at a time; nan where that determines nothing."""
    state = _known(problem, known)[0]
    if not np.isfinite(state).all():
        return np.full(len(picture.direct), np.nan)
    return picture.evaluate(state)[0]


def _predicted_sizes(
    problem: _Problem, picture: _Picture, known: Information, residual: FloatArray, partials: FloatArray
) -> list[float]:
    """Sigmas of every measurement before it is taken in."""
    if not known.determined:
        return [float("nan")] * len(picture.units)
    at = last_smoothed(known)
    unused = np.zeros(len(picture.units), bool)
    return [s.sigmas for s in _scatter(problem, picture, unused, residual, partials, at)]
