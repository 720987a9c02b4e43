"""Weighted least squares of rendered bodies to a picture: Gauss-Newton with few renderings.

All linear parameters (brightness scales, level) are solved with each step. Weights are 1 / variance of the noise, the
shot noise that of the model: shot noise of the data would pull the fit to pixels that happen to be dark. Each step's
derivatives are those of the rendered light itself, so that three renderings usually do.
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodycenters.cutout import Cutout
from opnav_workbench.bodycenters.hit_pixels import find_hit_pixels
from opnav_workbench.bodycenters.normal_equations import inverse, normal_matrix, projected, solved_for
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.scene_light import SceneLight, SceneState, light_up, range_derivatives

__all__ = ["SceneFit", "fit_scene", "solve_brightness"]

MAX_RENDERINGS = 12
CONVERGED_PX = 0.01  # a step this small leaves an error of second order, 1e-4 px
MAX_STEP_PX = 2.0  # linear in the center no farther than the PSF and the limb's curvature allow
MAX_STEP_LOG = 0.25
MAX_LOG_RANGE = 1.2  # a factor of 3.3
FRESH_PX = 0.15  # derivatives that were taken farther away than this are taken anew
GROWTH = 1.01  # chi-squared may grow so much in a step: the weights change with the model


@dataclass(frozen=True, slots=True, eq=False)
class SceneFit:
    """Bodies fitted to a picture.

    Attributes
    ----------
    state : SceneState
        The solution.
    light : SceneLight
        Rendered at the last step but one; the last step is below `CONVERGED_PX`.
    model_dn : (n_line, n_pixel) array
        All bodies at the solution, without the level.
    residual_dn, weight : (n_line, n_pixel) arrays
        Data minus model and level; 1 / variance, 0 for pixels not used.
    columns : (p, n_line, n_pixel) array
        Derivatives of the model with respect to the parameters, see `scene_light`.
    information : (p, p) array
        Normal matrix.
    hits : (n_line, n_pixel) array of bool
        Pixels left out because their light is not that of a body.
    steps_px : tuple of (n, 2) arrays
    converged : bool
    chi2 : float
        Weighted square of the residuals.
    own_gain : (2 n, n_line, n_pixel) array or None
        Change of the centers per DN in each pixel, of another estimator than least squares.
    """

    state: SceneState
    light: SceneLight
    model_dn: FloatArray
    residual_dn: FloatArray
    weight: FloatArray
    columns: FloatArray
    information: FloatArray
    hits: BoolArray
    steps_px: tuple[FloatArray, ...]
    converged: bool
    chi2: float
    own_gain: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (p, p) of the parameters from the noise of the pixels."""
        return inverse(self.information)

    @property
    def gain(self) -> FloatArray:
        """Change of centers and ranges (2 n + k, n_line, n_pixel) per DN in each pixel."""
        if self.own_gain is not None:
            return self.own_gain
        rows = len(self.columns) - len(self.state.names) - 1
        return np.tensordot(self.covariance[:rows], self.columns * self.weight, axes=1)

    @property
    def noise_covariance(self) -> FloatArray:
        """Covariance (2 n + k, 2 n + k) of centers and ranges from the noise of the pixels."""
        if self.own_gain is None:
            rows = len(self.columns) - len(self.state.names) - 1
            return self.covariance[:rows, :rows]
        variance = np.where(self.weight > 0.0, 1.0 / np.where(self.weight > 0.0, self.weight, 1.0), 0.0)
        return symmetric(np.einsum("plm,lm,qlm->pq", self.own_gain, variance, self.own_gain))

    @property
    def degrees_of_freedom(self) -> int:
        """Pixels used less parameters."""
        return max(int(np.count_nonzero(self.weight)) - len(self.information), 1)


def fit_scene(
    picture: BodyPicture,
    cutout: Cutout,
    start: SceneState,
    *,
    solve_range: BoolArray | None = None,
    reject_hits: bool = True,
) -> SceneFit:
    """Fit the bodies of `start` to the pixels of a cutout.

    Parameters
    ----------
    picture : BodyPicture
    cutout : Cutout
    start : SceneState
        Centers good to about the width of the PSF; its scales and level do not matter.
    solve_range : (n,) array of bool, optional
        Bodies whose range is solved for from their size.
    reject_hits : bool
        Leave out pixels whose light is not that of the bodies (see `find_hit_pixels`), and fit again.
    """
    wanted = np.zeros(len(start.names), dtype=bool) if solve_range is None else np.asarray(solve_range, bool)
    task = _Task(picture, cutout, wanted)
    first = _descend(
        task, _linearised(task, replace(start, scales=np.ones(len(start.names))), _no_hits(cutout))
    )
    hits = find_hit_pixels(first.residual_dn, first.weight) if reject_hits else _no_hits(cutout)
    if not hits.any():
        return first
    again = _linearised(task, first.state, hits)
    second = _descend(task, again)
    return replace(second, steps_px=first.steps_px + second.steps_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    picture: BodyPicture
    cutout: Cutout
    wanted: BoolArray  # (n,) ranges to solve for

    @property
    def count(self) -> int:
        return int(self.wanted.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The model and its derivatives at a state, with scales and level already solved for."""

    state: SceneState
    light: SceneLight
    columns: FloatArray
    weight: FloatArray
    residual: FloatArray
    hits: BoolArray
    derived_at: FloatArray  # (n, 2) centers that the derivatives belong to

    @property
    def chi2(self) -> float:
        return float(np.sum(self.weight * self.residual**2))

    @property
    def degrees(self) -> float:
        return max(float(np.count_nonzero(self.weight)), 1.0)


def _no_hits(cutout: Cutout) -> BoolArray:
    return np.zeros(cutout.use.shape, dtype=bool)


def _linearised(task: _Task, state: SceneState, hits: BoolArray, known: _Linear | None = None) -> _Linear:
    """Render a state, solve for its scales and level, and take the derivatives: those `known`, if they are near enough."""
    near = known is not None and float(np.abs(state.centers_px - known.derived_at).max()) < FRESH_PX
    light = light_up(task.picture, task.cutout.window, state, derivatives=not near)
    before = state.scales
    state, weight = solve_brightness(task.cutout, state, light.each, hits)
    n = len(state.names)
    if known is not None and near:
        ratio = np.concatenate([np.repeat(_ratio(state.scales, known.state.scales), 2), np.ones(task.count)])
        changing, derived_at = known.columns[: 2 * n + task.count] * ratio[:, None, None], known.derived_at
    else:
        moving = light.d_center * np.repeat(_ratio(state.scales, before), 2)[:, None, None]
        sizes = range_derivatives(task.picture, task.cutout.window, state, light, task.wanted)
        changing, derived_at = np.concatenate([moving, sizes]), state.centers_px
    residual = task.cutout.data_dn - light.total(state.scales) - state.level_dn
    columns = np.concatenate([changing, light.each, np.ones((1, *weight.shape))])
    return _Linear(state, light, columns, weight, residual, hits, derived_at)


def _ratio(new: FloatArray, old: FloatArray) -> FloatArray:
    return new / np.where(old == 0.0, 1.0, old)


def solve_brightness(
    cutout: Cutout, state: SceneState, each: FloatArray, hits: BoolArray
) -> tuple[SceneState, FloatArray]:
    """Return the state with scales and level solved for, and the weights of the pixels under such a model."""
    expected: FloatArray | float = 0.0
    for _ in range(2):
        weight = np.where(hits, 0.0, cutout.weight(expected))
        design = np.concatenate([each, np.ones((1, *weight.shape))])
        solved = solved_for(normal_matrix(design, weight), projected(design, weight, cutout.data_dn))
        expected = np.tensordot(solved[:-1], each, axes=1)
    weight = np.where(hits, 0.0, cutout.weight(expected))
    return replace(state, scales=solved[:-1], level_dn=float(solved[-1])), weight


def _descend(task: _Task, linear: _Linear) -> SceneFit:
    """Step until the steps are small; a step that makes the fit worse is halved."""
    steps: list[FloatArray] = []
    for _ in range(MAX_RENDERINGS):
        change = _step(linear, task)
        small = _length(change, linear, task) < CONVERGED_PX
        state = _stepped(linear.state, change, task)
        steps.append(state.centers_px - linear.state.centers_px)
        if small:
            return _finished(linear, change, state, tuple(steps), converged=True)
        previous, linear = linear, _linearised(task, state, linear.hits, linear)
        if linear.chi2 / linear.degrees > GROWTH * previous.chi2 / previous.degrees:
            steps[-1] = 0.5 * steps[-1]
            linear = _linearised(task, _between(previous.state, state), previous.hits, previous)
    return _finished(linear, np.zeros(len(linear.columns)), linear.state, tuple(steps), converged=False)


def _step(linear: _Linear, task: _Task) -> FloatArray:
    """Return the change of all parameters, those of centers and ranges within limits."""
    change = solved_for(
        normal_matrix(linear.columns, linear.weight),
        projected(linear.columns, linear.weight, linear.residual),
    )
    n, k = len(linear.state.names), task.count
    centers = change[: 2 * n].reshape(n, 2)
    longest = float(np.sqrt(np.max(np.sum(centers**2, axis=1))))
    largest = float(np.abs(change[2 * n : 2 * n + k]).max(initial=0.0))
    return change * min(1.0, MAX_STEP_PX / max(longest, 1e-300), MAX_STEP_LOG / max(largest, 1e-300))


def _length(change: FloatArray, linear: _Linear, task: _Task) -> float:
    """Return how far a step moves centers and limbs, px."""
    n, k = len(linear.state.names), task.count
    limbs = change[2 * n : 2 * n + k] * 0.5 * linear.light.diameter_px[task.wanted]
    return float(np.abs(np.concatenate([change[: 2 * n], limbs])).max())


def _stepped(state: SceneState, change: FloatArray, task: _Task) -> SceneState:
    n, k = len(state.names), task.count
    log_range = np.zeros(n)
    log_range[task.wanted] = change[2 * n : 2 * n + k]
    limited = np.clip(state.log_range + log_range, -MAX_LOG_RANGE, MAX_LOG_RANGE) - state.log_range
    moved = state.moved(change[: 2 * n].reshape(n, 2), limited)
    scales = state.scales + change[2 * n + k : 3 * n + k]
    return replace(moved, scales=scales, level_dn=state.level_dn + float(change[-1]))


def _between(a: SceneState, b: SceneState) -> SceneState:
    return replace(
        b,
        centers_px=0.5 * (a.centers_px + b.centers_px),
        log_range=0.5 * (a.log_range + b.log_range),
        scales=0.5 * (a.scales + b.scales),
    )


def _finished(
    linear: _Linear, change: FloatArray, state: SceneState, steps: tuple[FloatArray, ...], *, converged: bool
) -> SceneFit:
    """Carry the last, small step through the linear model instead of rendering once more."""
    difference = np.tensordot(change, linear.columns, axes=1)
    residual = linear.residual - difference
    model = linear.light.total(linear.state.scales) + difference - float(change[-1])
    return SceneFit(
        state=state,
        light=linear.light,
        model_dn=model,
        residual_dn=residual,
        weight=linear.weight,
        columns=linear.columns,
        information=normal_matrix(linear.columns, linear.weight),
        hits=linear.hits,
        steps_px=steps,
        converged=converged,
        chi2=float(np.sum(linear.weight * residual**2)),
    )
