"""Errors of centers that all pictures have in common, beside those that each has for itself.

What a centerfinder cannot know of a surface (its scattering law, its size, how its light falls off toward the terminator) is
much the same in every picture of an approach, and of its neighbors too; what it cannot know of a mottled one turns with the
body. Both are in the covariance of a center beyond its noise, M = C - N, and nobody knows which share of it is common:

    error of a center = noise (N) + own error ((1 - s) M) + sqrt(s) M^(1/2) e,   e the same (east, north) for all, unit sigma

With s = 0 many pictures of one surface would seem to average an error that they share; with s = 1 they would seem to cancel
it. The measurements tell: each share is given weight by the likelihood of all residuals under it, and the estimate is the
mean over the shares, its covariance that within them and between them.

Reference: Hoeting et al. (1999), Statistical Science 14, 382, doi:10.1214/ss/1009212519 (model averaging).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.estimation.batch import REJECT_SIGMAS, Estimate, Residual, estimate
from opnav_workbench.estimation.measurements import Dynamics, measurements_of
from opnav_workbench.estimation.parameters import APriori, parameter_count, relative_state
from opnav_workbench.estimation.sequential import FilterEstimate, FilterResidual, filter_estimate
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.estimation.stochastic import ModelParameter
from opnav_workbench.observables import Observable, joint_covariance_px2

__all__ = ["CommonErrorEstimate", "estimate_with_common_errors"]

SHARES = np.arange(0.05, 1.0, 0.1)  # middles of ten equal parts: every share is as likely beforehand


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrorEstimate:
    """An estimate over all shares of common error; arrays are read-only.

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
    shares, weights : (m,) arrays
        Of the errors beyond noise, what is common; and how likely the measurements make it.
    """

    independent: Estimate
    filtered: FilterEstimate | None
    correction: FloatArray
    covariance: FloatArray
    after: tuple[FloatArray, ...]
    shares: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def share(self) -> float:
        """Return the expected share."""
        return float(self.shares @ self.weights)

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
    options = dict(filter_options or {})
    model = tuple(options.pop("model", ()))
    solved = []
    for share in SHARES:
        shared = [_with_own_errors(o, root, float(share)) for o, root in zip(kept, roots, strict=True)]
        found = filter_estimate(
            shared,
            parameters,
            epoch_et=independent.epoch_et,
            model=(*model, *_common_errors(shared, roots, float(share))),
            reject_sigmas=np.inf,
            **asked,
            **options,
        )
        solved.append((found, _minus_two_log_likelihood(found, shared)))
    dynamics = Dynamics(independent.epoch_et, target_transition, spacecraft_transition)
    return _averaged(observables, independent, filtered, dynamics, solved)


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


def _with_own_errors(o: Observable, root: FloatArray, share: float) -> Observable:
    common = share * root @ root.T
    return replace(
        o,
        covariance_px2=symmetric(o.covariance_px2 - common),
        total_covariance_px2=symmetric(o.total_covariance_px2 - common),
    )


def _common_errors(
    observables: Sequence[Observable], roots: Sequence[FloatArray], share: float
) -> tuple[ModelParameter, ...]:
    moved = {(o.image, o.name): np.sqrt(share) * root for o, root in zip(observables, roots, strict=True)}

    def along(axis: int) -> Callable[[Observable], FloatArray]:
        return lambda o: moved[o.image, o.name][:, axis]

    return tuple(
        ModelParameter(f"common error {name}", 1.0, "sigma", pixels=along(axis))
        for axis, name in enumerate(("east", "north"))
    )


def _minus_two_log_likelihood(found: FilterEstimate, observables: Sequence[Observable]) -> float:
    """Of the measurements, parameters and noises integrated over; but for what all shares have in common.

    Considered parameters count as what they are believed to be.
    """
    of_measurements = np.linalg.slogdet(joint_covariance_px2(observables))[1]
    return float(found.chi2 + of_measurements + found.log_information)


def _averaged(
    observables: Sequence[Observable],
    independent: Estimate,
    filtered: FilterEstimate | None,
    dynamics: Dynamics,
    solved: Sequence[tuple[FilterEstimate, float]],
) -> CommonErrorEstimate:
    n = parameter_count(independent.groups)
    unlikely = np.array([value for _, value in solved])
    weights = np.exp(-0.5 * (unlikely - unlikely.min()))
    weights /= weights.sum()
    corrections = np.array([found.correction[:n] for found, _ in solved])
    mean = weights @ corrections
    within = np.einsum("k,kij->ij", weights, np.array([found.covariance[:n, :n] for found, _ in solved]))
    between = (corrections - mean).T @ (weights[:, None] * (corrections - mean))
    return CommonErrorEstimate(
        independent=independent,
        filtered=filtered,
        correction=mean,
        covariance=symmetric(within + between),
        after=_residuals(observables, independent, dynamics, mean),
        shares=SHARES.copy(),
        weights=weights,
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
