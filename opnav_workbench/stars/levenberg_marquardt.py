"""Levenberg-Marquardt for many small problems at once: no loop over the problems.

Each of n problems fits q parameters to m data with Gaussian weights and a Gaussian prior on each parameter, within
bounds: the cost is sum w (d - f(p))^2 + sum I (p - p0)^2. Weights may depend on the parameters (shot noise of the
model); they are held through a step and renewed after it, so that the solution satisfies the quasi-likelihood
equations J' W(p) (d - f) = 0, which are unbiased, unlike those with weights taken from the data.

References: Nocedal & Wright (2006), Numerical Optimization, chapter 10.3; Nelder & Pregibon (1987),
doi:10.1093/biomet/74.2.221.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, symmetric

__all__ = ["BatchSolution", "ModelEvaluation", "solve_batched"]

START_DAMPING = 1e-2
DAMPING_DOWN, DAMPING_UP = 0.1, 8.0
# After a refused step: in a curved valley a tenth of the damping is refused again and again, and each second step is lost.
CAREFUL_DOWN, CAREFUL_STEPS = 0.5, 2
MAX_ITERATIONS = 200  # ten are usual; large residuals (real optics) converge linearly and take some tens
MAX_DAMPING = 1e10  # a step this short changes nothing that a float64 can hold
# Expected decrease of the cost at which a fit has converged: a step of 3e-3 sigma, which is still taken.
CONVERGED_DECREASE = 1e-5
# Smallest eigenvalue of the normal matrix, scaled to unit diagonal, that still determines all parameters.
MIN_EIGENVALUE = 1e-11


@dataclass(frozen=True, slots=True, eq=False)
class ModelEvaluation:
    """A model at given parameters: residual and weight (k, m), Jacobian of the model (k, q, m).

    `parameters` (k, q) where the model chose some better itself: those it is linear in, for the others as given.
    """

    residual: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    parameters: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BatchSolution:
    """Fitted parameters (n, q), covariance (n, q, q), chi2 of the data (n,), and how the fits ended (n,)."""

    parameters: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    converged: BoolArray
    at_bound: BoolArray  # (n, q)
    determined: BoolArray
    iterations: IntArray
    final: ModelEvaluation  # at the fitted parameters


# Evaluates the problems `index` (k,) at parameters (k, q).
BatchModel = Callable[[IntArray, FloatArray], ModelEvaluation]


def solve_batched(
    model: BatchModel,
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    prior_mean: FloatArray,
    prior_information: FloatArray,
    max_iterations: int = MAX_ITERATIONS,
    hopeless: Callable[[FloatArray], BoolArray] | None = None,
) -> BatchSolution:
    """Minimize the cost of every problem.

    Parameters
    ----------
    model : callable
        Evaluates some of the problems; see `Model`.
    start, lower, upper : (n, q) array
        First guess and bounds.
    prior_mean, prior_information : (n, q) array
        Center and inverse variance of the prior on each parameter; 0 for none.
    max_iterations
        Trial steps per problem.
    hopeless : callable
        Tells of parameters (k, q) that nobody will use what comes of them: such a problem ends, not converged.
    """
    n = len(start)
    p = np.clip(start, lower, upper)
    damping, careful = np.full(n, START_DAMPING), np.zeros(n, np.int64)
    converged, iterations = np.zeros(n, bool), np.zeros(n, np.int64)
    active = np.arange(n)
    state = model(active, p)
    final = ModelEvaluation(*(np.array(a) for a in (state.residual, state.weight, state.jacobian)))
    for _ in range(max_iterations):
        if active.size == 0:
            break
        i = active
        here = p[i]
        normal, gradient = _normal_equations(state, here, prior_mean[i], prior_information[i])
        free = ~(((here <= lower[i]) & (gradient < 0.0)) | ((here >= upper[i]) & (gradient > 0.0)))
        step = _damped_step(normal, gradient, free, damping[i])
        trial = np.clip(here + step, lower[i], upper[i])
        step = trial - here
        ahead = model(i, trial)
        trial = trial if ahead.parameters is None else ahead.parameters
        before = _cost(state.residual, state.weight, here, prior_mean[i], prior_information[i])
        after = _cost(ahead.residual, state.weight, trial, prior_mean[i], prior_information[i])
        better = after <= before
        expected = np.abs(np.sum(step * gradient * free, axis=1))
        done = (expected < CONVERGED_DECREASE) & (damping[i] <= START_DAMPING)
        stuck = damping[i] > MAX_DAMPING

        p[i[better]] = trial[better]
        state = _choose(better, ahead, state)
        down = np.where(careful[i] > 0, CAREFUL_DOWN, DAMPING_DOWN)
        damping[i] *= np.where(better, down, DAMPING_UP)
        careful[i] = np.where(better, np.maximum(careful[i] - 1, 0), CAREFUL_STEPS)
        # A tiny rejected step means that rounding, not the model, decides: that is convergence too.
        converged[i] = done
        iterations[i] += 1
        ended = done | stuck
        if hopeless is not None:
            ended |= hopeless(p[i])
        if ended.any():
            _store(final, i[ended], _take(state, ended))
            active, state = i[~ended], _take(state, ~ended)
    _store(final, active, state)
    covariance, determined = _invert(_information(final) + _diagonal(prior_information))
    chi2 = np.sum(final.weight * final.residual**2, axis=1)
    at_bound = (p <= lower) | (p >= upper)
    return BatchSolution(p, covariance, chi2, converged, at_bound, determined, iterations, final)


def _store(final: ModelEvaluation, index: IntArray, state: ModelEvaluation) -> None:
    final.residual[index], final.weight[index], final.jacobian[index] = (
        state.residual, state.weight, state.jacobian
    )  # fmt: skip


def _information(state: ModelEvaluation) -> FloatArray:
    return np.asarray(np.matmul(state.jacobian * state.weight[:, None, :], np.swapaxes(state.jacobian, 1, 2)))


def _normal_equations(
    state: ModelEvaluation, p: FloatArray, mean: FloatArray, information: FloatArray
) -> tuple[FloatArray, FloatArray]:
    gradient = np.matmul(state.jacobian, (state.weight * state.residual)[:, :, None])[:, :, 0]
    return _information(state) + _diagonal(information), gradient + information * (mean - p)


def _damped_step(
    normal: FloatArray, gradient: FloatArray, free: BoolArray, damping: FloatArray
) -> FloatArray:
    """Solve in units of each parameter's own sigma, so that the damping acts on all parameters alike."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), np.finfo(float).tiny))
    scale = np.where(free & np.isfinite(scale) & (scale < 1e100), scale, 0.0)
    scaled = normal * scale[:, :, None] * scale[:, None, :]
    ridge = np.where(scale > 0.0, damping[:, None] + 1e-12, 1.0)
    return scale * np.linalg.solve(scaled + _diagonal(ridge), (scale * gradient)[:, :, None])[:, :, 0]


def _cost(
    residual: FloatArray, weight: FloatArray, p: FloatArray, mean: FloatArray, information: FloatArray
) -> FloatArray:
    return np.asarray((weight * residual**2).sum(axis=1) + (information * (p - mean) ** 2).sum(axis=1))


def _choose(better: BoolArray, ahead: ModelEvaluation, behind: ModelEvaluation) -> ModelEvaluation:
    if better.all():
        return ahead
    row = better[:, None]
    return ModelEvaluation(
        np.where(row, ahead.residual, behind.residual),
        np.where(row, ahead.weight, behind.weight),
        np.where(row[:, :, None], ahead.jacobian, behind.jacobian),
    )


def _take(state: ModelEvaluation, rows: BoolArray) -> ModelEvaluation:
    return ModelEvaluation(state.residual[rows], state.weight[rows], state.jacobian[rows])


def _diagonal(values: FloatArray) -> FloatArray:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _invert(normal: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Invert the normal matrices; where one is singular, the result is nan and the problem undetermined."""
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    whole = np.asarray(np.isfinite(normal).all(axis=(1, 2)) & (diagonal > 0.0).all(axis=1))
    normal = np.where(whole[:, None, None], normal, np.eye(normal.shape[1]))
    scale = 1.0 / np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    scaled = normal * scale[:, :, None] * scale[:, None, :]
    value, vector = np.linalg.eigh(symmetric(scaled))
    determined = whole & (value[:, 0] > MIN_EIGENVALUE)
    inverse = np.matmul(vector / np.maximum(value, MIN_EIGENVALUE)[:, None, :], np.swapaxes(vector, 1, 2))
    covariance = symmetric(inverse * scale[:, :, None] * scale[:, None, :])
    covariance[~determined] = np.nan
    return covariance, determined
