"""Errors that pictures have in common, beside those that each has for itself: of centers, and of the stars behind them.

What a centerfinder cannot know of a surface (its scattering law, its size, how its light falls off toward the terminator) is
much the same in every picture of an approach, and of its neighbors too; what it cannot know of a mottled one turns with the
body. Both are in the covariance of a center beyond its noise, M = C - N. Nobody knows which share s of it is common, and one
picture cannot tell whether its surface is as kind, or as bad, as the covariance allows for: errors are z times as large.

    error of a center = noise (N) + z (own error ((1 - s) M) + sqrt(s) M^(1/2) e),   e (east, north) of all, unit sigma

With s = 0 many pictures of one surface would seem to average an error that they share; with s = 1 they would seem to cancel
it. The measurements tell: each share and size is given weight by the likelihood of all residuals under it, and the estimate
is the mean over them, its covariance that within them and between them. Few pictures tell little, and leave z near 1.

Pictures of an approach show the same stars, and a star that is not where its catalog has it turns all their attitudes
alike. That is most of what is unknown of an attitude where centers are good and motions or parallaxes are not. Taken for the
pictures' own errors it seems to average in what they agree on (a B-plane's point), and to scatter in how they differ (an
arrival).

    error of an attitude = own + sum over stars B e,   B (3, 2) of star and picture, e of the star in all, unit sigma

Reference: Hoeting et al. (1999), Statistical Science 14, 382, doi:10.1214/ss/1009212519 (model averaging).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.estimation.batch import REJECT_SIGMAS, Estimate, Residual, estimate
from opnav_workbench.estimation.measurements import Dynamics, measurements_of
from opnav_workbench.estimation.parameters import APriori, parameter_count, relative_state
from opnav_workbench.estimation.sequential import FilterEstimate, FilterResidual, filter_estimate
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.estimation.stochastic import ModelParameter
from opnav_workbench.observables import Observable

__all__ = ["CommonErrorEstimate", "estimate_with_common_errors"]

SHARES = np.arange(0.1, 1.0, 0.2)  # middles of equal parts: every share is as likely beforehand
# Sizes of errors over what a centerfinder states, and how likely they are beforehand: normal in the logarithm, for sigmas of
# what nobody has seen are believed to a factor of two.
DOUBLINGS = np.arange(-2.0, 2.5)
SIZES, SIZE_COSTS = 2.0**DOUBLINGS, DOUBLINGS**2
NO_TURNS: Mapping[str, Mapping[str, FloatArray]] = MappingProxyType({})
LEAST_SHARED = (
    1e-3  # of the largest: what combinations of stars' errors move centers by less are the pictures' own
)


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrorEstimate:
    """An estimate over all shares and sizes of errors beyond noise; arrays are read-only.

    Attributes
    ----------
    independent
        The batch's estimate as if no error were common: outliers, fit, and what the pictures determine.
    filtered
        The filter's as if no error were common, where one was asked for; the batch is of what it uses.
    correction, covariance : (n,), (n, n) arrays
        Of the batch's parameters.
    after : (k,) arrays
        Observed minus computed with this correction, of `independent.residuals`, px or km.
    shares, sizes, weights : (m,) arrays
        Of the errors beyond noise, what is common; how large they are over what is stated; how likely the measurements make
        that.
    steps
        Of a filter, the groups' parameters as known after each picture, ahead: image, et, correction and covariance.
    """

    independent: Estimate
    filtered: FilterEstimate | None
    correction: FloatArray
    covariance: FloatArray
    after: tuple[FloatArray, ...]
    shares: FloatArray
    sizes: FloatArray
    weights: FloatArray
    steps: tuple[tuple[str, float, FloatArray, FloatArray], ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def share(self) -> float:
        """Return the expected share."""
        return float(self.shares @ self.weights)

    @property
    def size(self) -> float:
        """Return the expected size, of its logarithm."""
        return float(np.exp(np.log(self.sizes) @ self.weights))

    def relative_state(self, body: str = "") -> tuple[FloatArray, FloatArray]:
        """Return the correction (6,) of the spacecraft's state relative to a body, and its covariance (6, 6)."""
        return relative_state(self.independent.groups, self.correction, self.covariance, body)


def estimate_with_common_errors(
    observables: Sequence[Observable],
    noise_covariances_px2: Sequence[FloatArray | None],
    parameters: Sequence[str] = ("target_position",),
    *,
    epoch_et: float | None = None,
    a_priori: APriori | None = None,
    target_transition: Transition = straight_line,
    spacecraft_transition: Transition = straight_line,
    statuses: Sequence[str] = ("ok",),
    reject_sigmas: float = REJECT_SIGMAS,
    filter_options: Mapping[str, Any] | None = None,
    star_turns_rad: Mapping[str, Mapping[str, FloatArray]] = NO_TURNS,
) -> CommonErrorEstimate:
    """Estimate corrections of states from centers whose errors beyond noise may be common.

    Parameters
    ----------
    observables
        As in `estimate`, of an approach: the Sun hardly moves about the body.
    noise_covariances_px2
        Of each center, that of the noise alone (``noise_covariance_px2`` of ``result.json``); None: all of its own.
    parameters, epoch_et, a_priori, target_transition, spacecraft_transition, statuses, reject_sigmas
        As in `estimate`.
    filter_options
        Further options of `filter_estimate` (``accelerations``, ``consider`` and so on): the filter takes the batch's place.
        None: the batch.
    star_turns_rad : mapping of image to mapping of star to (3, 2) array
        How far a sigma of each star's catalog errors turns the attitude of each image (``turn_by_catalog_rad`` of
        ``result.json``); a part of its attitude covariance. Nothing told: no attitudes are taken to err alike.

    Raises
    ------
    EstimationError
        See `estimate` and `filter_estimate`.
    """
    asked: dict[str, Any] = {
        "a_priori": a_priori,
        "target_transition": target_transition,
        "spacecraft_transition": spacecraft_transition,
    }
    sure: dict[str, Any] = asked | {
        "epoch_et": epoch_et,
        "statuses": statuses,
        "reject_sigmas": reject_sigmas,
    }
    filtered: FilterEstimate | None = None
    if filter_options is None:
        independent = estimate(observables, parameters, **sure)
        kept, roots = _kept(observables, noise_covariances_px2, independent.residuals)
    else:
        filtered = filter_estimate(observables, parameters, **sure, **filter_options)
        kept, roots = _kept(observables, noise_covariances_px2, filtered.residuals)
        independent = estimate(kept, parameters, epoch_et=filtered.epoch_et, reject_sigmas=np.inf, **asked)
    dynamics = Dynamics(independent.epoch_et, target_transition, spacecraft_transition)
    turns = _shared_turns(kept, star_turns_rad)
    if filter_options is None:
        mixed = _batches(kept, roots, turns, independent, dynamics)
    else:
        options = {"epoch_et": independent.epoch_et, **asked, **filter_options}
        mixed = _filters(kept, roots, turns, parameters, options)
    correction, covariance = mixed.moments()
    return CommonErrorEstimate(
        independent=independent,
        filtered=filtered,
        correction=correction,
        covariance=covariance,
        after=_residuals(observables, independent, dynamics, correction),
        shares=SHARE_OF_EACH.copy(),
        sizes=SIZE_OF_EACH.copy(),
        weights=mixed.weights,
        steps=mixed.steps,
    )


def _kept(
    observables: Sequence[Observable],
    noise: Sequence[FloatArray | None],
    residuals: Sequence[Residual] | Sequence[FilterResidual],
) -> tuple[list[Observable], list[FloatArray]]:
    """Return what was used, and the root (2, 2) px of each center's covariance beyond noise, about east and north."""
    used = {(r.image, r.body, r.kind) for r in residuals if r.used}
    kept, roots = [], []
    for o, of_noise in zip(observables, noise, strict=True):
        if (o.image, o.name, "center") not in used:
            continue
        ranged = (o.image, o.name, "range") in used
        measured_km = o.measured_range_km if ranged else float("nan")
        kept.append(replace(o, status="ok", measured_range_km=measured_km))
        roots.append(_model_root(o, of_noise))
    return kept, roots


def _model_root(o: Observable, noise_px2: FloatArray | None) -> FloatArray:
    """d(pixel, line)/d(common error), (2, 2): its square is the center's covariance beyond noise."""
    if noise_px2 is None or not np.isfinite(noise_px2).all():
        return np.zeros((2, 2))
    assert o.sky_partials_px_per_rad is not None  # the batch has asked for them
    u, _, v = np.linalg.svd(o.sky_partials_px_per_rad)
    turned = u @ v  # east and north on the detector, undistorted
    values, vectors = np.linalg.eigh(
        symmetric(turned.T @ (o.covariance_px2 - np.asarray(noise_px2, float)) @ turned)
    )
    return np.asarray(turned @ (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _shared_turns(
    kept: Sequence[Observable], told: Mapping[str, Mapping[str, FloatArray]]
) -> list[FloatArray]:
    """Return how unit errors that attitudes have in common turn that of each observable, (3, k) rad.

    The k are the combinations of stars' errors that move a center: fewer than stars, and none without stars told.
    """
    stars = sorted({star for o in kept for star in told.get(o.image, {})})
    whole = np.zeros((len(kept), 3, 2 * len(stars)))
    for i, o in enumerate(kept):
        for star, turn in told.get(o.image, {}).items():
            at = 2 * stars.index(star)
            whole[i, :, at : at + 2] = turn
    moved = np.concatenate([_partials(o) @ turn for o, turn in zip(kept, whole, strict=True)])
    _, size, combined = np.linalg.svd(moved, full_matrices=False)
    telling = combined[size > LEAST_SHARED * size.max(initial=0.0)]
    return [turn @ telling.T for turn in whole]


def _partials(o: Observable) -> FloatArray:
    return np.zeros((2, 3)) if o.partials_px_per_rad is None else o.partials_px_per_rad


# ---- The same estimate under every share and size of errors beyond noise.

SHARE_OF_EACH, SIZE_OF_EACH = (grid.ravel() for grid in np.meshgrid(SHARES, SIZES, indexing="ij"))
COST_OF_EACH = np.tile(SIZE_COSTS, len(SHARES))


@dataclass(frozen=True, slots=True, eq=False)
class _Mixture:
    """Corrections (m, n) and covariances (m, n, n), each with minus twice the logarithm of its likelihood."""

    corrections: FloatArray
    covariances: FloatArray
    costs: FloatArray
    steps: tuple[tuple[str, float, FloatArray, FloatArray], ...] = ()

    @property
    def weights(self) -> FloatArray:
        costs = self.costs + COST_OF_EACH
        weights = np.exp(-0.5 * (costs - costs.min()))
        return np.asarray(weights / weights.sum())

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean (n,) and covariance (n, n), within the members and between them."""
        weights = self.weights
        mean = weights @ self.corrections
        off = self.corrections - mean
        within = np.einsum("k,kij->ij", weights, self.covariances)
        return mean, symmetric(within + off.T @ (weights[:, None] * off))


def _batches(
    kept: Sequence[Observable],
    roots: Sequence[FloatArray],
    turns: Sequence[FloatArray],
    independent: Estimate,
    dynamics: Dynamics,
) -> _Mixture:
    """Solve by generalized least squares, linearized about the batch's solution."""
    measured = measurements_of(kept, independent.groups, dynamics)
    stated = measured.covariance + _between_pictures(kept, turns, len(measured.covariance))
    residual, jacobian = measured.evaluate(independent.correction)
    loads = np.zeros((len(residual), 2))
    loads[: 2 * len(roots)] = np.concatenate(roots)
    common, own = loads @ loads.T, np.zeros_like(measured.covariance)
    for i, root in enumerate(roots):
        own[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = root @ root.T
    prior = independent.a_priori_rows
    members = []
    for share, size in zip(SHARE_OF_EACH, SIZE_OF_EACH, strict=True):
        errors = size**2 * ((1.0 - share) * own + share * common)
        factor = np.linalg.cholesky(stated - own + errors)
        white = np.linalg.solve(factor, np.column_stack([jacobian, residual]))
        rows = np.concatenate([white[:, :-1], prior])
        right = np.concatenate([white[:, -1], -prior @ independent.correction])
        members.append(_least_squares(rows, right, 2.0 * float(np.log(np.diag(factor)).sum())))
    steps, covariances, costs = zip(*members, strict=True)
    return _Mixture(independent.correction + np.array(steps), np.array(covariances), np.array(costs))


def _between_pictures(kept: Sequence[Observable], turns: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return the covariance (rows, rows) that stars in common give centers of different pictures, px^2.

    Within a picture it is in the attitude's covariance already.
    """
    added = np.zeros((rows, rows))
    if kept:
        moved = np.concatenate([_partials(o) @ turn for o, turn in zip(kept, turns, strict=True)])
        images = np.repeat([o.image for o in kept], 2)
        added[: len(moved), : len(moved)] = np.where(images[:, None] == images[None], 0.0, moved @ moved.T)
    return added


def _least_squares(
    rows: FloatArray, right: FloatArray, log_noise: float
) -> tuple[FloatArray, FloatArray, float]:
    """Step (n,), covariance (n, n), and minus twice the logarithm of the likelihood, the step integrated over."""
    scale = np.linalg.norm(rows, axis=0)
    q, r = np.linalg.qr(rows / scale)
    inverse = np.linalg.inv(r) / scale[:, None]
    fitted = q.T @ right
    log_information = 2.0 * float(np.log(np.abs(np.diag(r)) * scale).sum())
    return (
        inverse @ fitted,
        symmetric(inverse @ inverse.T),
        float(right @ right - fitted @ fitted) + log_noise + log_information,
    )


def _filters(
    kept: Sequence[Observable],
    roots: Sequence[FloatArray],
    turns: Sequence[FloatArray],
    parameters: Sequence[str],
    asked: Mapping[str, Any],
) -> _Mixture:
    """Solve in the filter, the common errors as constants that each picture's centers depend on."""
    options = dict(asked)
    model = (*options.pop("model", ()), *_turned_together(kept, turns))
    apart = [_with_own_attitude(o, turn) for o, turn in zip(kept, turns, strict=True)]
    members = []
    for share, size in zip(SHARE_OF_EACH, SIZE_OF_EACH, strict=True):
        sized = [_with_own_errors(o, root, share, size) for o, root in zip(apart, roots, strict=True)]
        common = _common_errors(sized, roots, float(np.sqrt(share) * size))
        members.append(
            filter_estimate(sized, parameters, model=(*model, *common), reject_sigmas=np.inf, **options)
        )
    n = parameter_count(members[0].groups)
    steps = []
    for passed in zip(*(member.steps for member in members), strict=True):
        so_far = _Mixture(
            np.array([step.ahead[:n] for step in passed]),
            np.array([step.ahead_covariance[:n, :n] for step in passed]),
            np.array([step.cost for step in passed]),
        )
        if np.isfinite(so_far.costs).all():
            steps.append((passed[0].image, passed[0].et, *so_far.moments()))
    return _Mixture(
        np.array([member.correction[:n] for member in members]),
        np.array([member.covariance[:n, :n] for member in members]),
        np.array([member.steps[-1].cost for member in members]),
        tuple(steps),
    )


def _with_own_errors(o: Observable, root: FloatArray, share: float, size: float) -> Observable:
    """Return an observable whose errors beyond noise are of another size, and without the common share of them."""
    less = (1.0 - size**2 * (1.0 - share)) * root @ root.T
    return replace(
        o,
        covariance_px2=symmetric(o.covariance_px2 - less),
        total_covariance_px2=symmetric(o.total_covariance_px2 - less),
    )


def _with_own_attitude(o: Observable, turn: FloatArray) -> Observable:
    """Return an observable whose attitude errs in nothing that other pictures have in common with it."""
    moved = _partials(o) @ turn
    covariance = o.attitude_covariance_rad2
    return replace(
        o,
        total_covariance_px2=symmetric(o.total_covariance_px2 - moved @ moved.T),
        attitude_covariance_rad2=None if covariance is None else symmetric(covariance - turn @ turn.T),
    )


def _turned_together(
    observables: Sequence[Observable], turns: Sequence[FloatArray]
) -> tuple[ModelParameter, ...]:
    moved = {(o.image, o.name): _partials(o) @ turn for o, turn in zip(observables, turns, strict=True)}

    def along(axis: int) -> Callable[[Observable], FloatArray]:
        return lambda o: moved[o.image, o.name][:, axis]

    count = turns[0].shape[1] if turns else 0
    return tuple(ModelParameter(f"stars {k + 1}", 1.0, "sigma", pixels=along(k)) for k in range(count))


def _common_errors(
    observables: Sequence[Observable], roots: Sequence[FloatArray], scale: float
) -> tuple[ModelParameter, ...]:
    moved = {(o.image, o.name): scale * root for o, root in zip(observables, roots, strict=True)}

    def along(axis: int) -> Callable[[Observable], FloatArray]:
        return lambda o: moved[o.image, o.name][:, axis]

    return tuple(
        ModelParameter(f"common error {name}", 1.0, "sigma", pixels=along(axis))
        for axis, name in enumerate(("east", "north"))
    )


def _residuals(
    observables: Sequence[Observable], independent: Estimate, dynamics: Dynamics, correction: FloatArray
) -> tuple[FloatArray, ...]:
    """Observed minus computed, in the order of the batch's residuals: centers, then ranges."""
    names = {(r.image, r.body) for r in independent.residuals}
    usable = [o for o in observables if (o.image, o.name) in names]
    left = measurements_of(usable, independent.groups, dynamics).residuals(correction)
    sizes = np.cumsum([len(r.after) for r in independent.residuals])[:-1]
    return tuple(np.split(left, sizes))
