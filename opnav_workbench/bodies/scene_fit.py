"""Weighted least squares of rendered bodies to a picture: Gauss-Newton with few renderings.

Parameters of a scene of n bodies, in this order: centers (pixel 0, line 0, pixel 1, ...), logarithms of the range over
the a priori one (where sizes are solved for), brightness scales, and one level under all.

Flow   state -> light of each body and its derivatives (`light_scene`) -> scales and level -> step -> ... -> `SceneFit`

All linear parameters (brightness scales, level) are solved with each step. Weights are 1 / variance of the noise, the
shot noise that of the model: shot noise of the data would pull the fit to pixels that happen to be dark. Each step's
derivatives are those of the rendered light itself, so that three renderings usually do; where bodies hide each other they
are differences. Normal equations are scaled to a unit diagonal.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies.picture import BodyPicture, placed_models, sunlight_electrons
from opnav_workbench.bodies.subarray import Cutout, find_hit_pixels
from opnav_workbench.camera import Camera
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel, render_moving, render_touched

__all__ = [
    "SceneFit",
    "SceneLight",
    "SceneState",
    "fit_scene",
    "light_scene",
    "solve_brightness",
    "turns_back",
]


# ---- The light of a scene's bodies at trial places, and how it changes with every parameter of a fit.

CENTER_STEP_PX = 0.1  # of numeric derivatives, where bodies hide each other
EDGE_STEP_PX = 0.1  # by which a change of range moves a limb


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Where the bodies of a scene are, how large and how bright.

    Attributes
    ----------
    centers_px : (n, 2) array
    log_range : (n,) array
        Logarithm of range over the a priori one.
    scales : (n,) array
        Brightness, data over model.
    """

    names: tuple[str, ...]
    centers_px: FloatArray
    log_range: FloatArray
    scales: FloatArray
    level_dn: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def places(self) -> Mapping[str, FloatArray]:
        """Centers by name."""
        return dict(zip(self.names, self.centers_px, strict=True))

    @property
    def range_scales(self) -> Mapping[str, float]:
        """Range over the a priori one by name."""
        return dict(zip(self.names, np.exp(self.log_range).tolist(), strict=True))

    def moved(self, centers: FloatArray, log_range: FloatArray) -> "SceneState":
        """Return the state with its bodies moved by (n, 2) px and (n,)."""
        return replace(self, centers_px=self.centers_px + centers, log_range=self.log_range + log_range)


@dataclass(frozen=True, slots=True, eq=False)
class SceneLight:
    """Light of each body at unit scale, and what moving them changes in the sum of all at their scales.

    Attributes
    ----------
    each : (n, n_line, n_pixel) array
        DN.
    d_center : (2 n, n_line, n_pixel) array
        DN / px; (0, ...) where it was not asked for.
    flux_dn : (n,) array
        Light of each body at unit scale, on and off the window.
    occulted : (n,) array
        Share of each body's light that others hide.
    diameter_px : (n,) array
    """

    each: FloatArray
    d_center: FloatArray
    flux_dn: FloatArray
    occulted: FloatArray
    diameter_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def total(self, scales: FloatArray) -> FloatArray:
        """Return the light of all bodies, DN."""
        return np.asarray(np.tensordot(scales, self.each, axes=1))


def light_scene(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    state: SceneState,
    *,
    derivatives: bool = True,
) -> SceneLight:
    """Render the bodies of a state, alone in the scene, with their derivatives."""
    moving = render_moving(**_scene(picture, window, state), derivatives=derivatives)
    gain = picture.gain_e_per_dn
    each = np.stack([body.electrons for body in moving]) / gain
    occulted = np.array([body.body.occulted_fraction for body in moving])
    d_center = np.concatenate(
        [(scale / gain) * body.slopes for scale, body in zip(state.scales, moving, strict=True)]
    )
    if derivatives and len(moving) > 1 and np.any(occulted > 0.0):
        d_center = _center_differences(picture, window, state, each)
    return SceneLight(
        each=each,
        d_center=d_center,
        flux_dn=np.array([body.body.flux_e for body in moving]) / gain,
        occulted=occulted,
        diameter_px=np.array([body.body.diameter_px for body in moving]),
    )


class _Scene(TypedDict):
    """What a state is rendered from."""

    models: list[BodyModel]
    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    psf: Psf
    sunlight_e: float
    window: tuple[int, int, int, int]


def _scene(picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState) -> _Scene:
    models = {
        model.target.name: model
        for model in placed_models(picture, state.places, state.range_scales, state.names)
    }
    return _Scene(
        models=[models[name] for name in state.names],
        camera=picture.camera,
        camera_from_j2000=picture.camera_from_j2000,
        observer_velocity_km_s=picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
    )


def _change(
    picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState, index: int, each: FloatArray
) -> FloatArray:
    """Return by how much all light (n_line, n_pixel) differs from `each` (n, ...), now that one body has moved."""
    drawn = render_touched(**_scene(picture, window, state), moved=index)
    return np.asarray(
        sum(state.scales[k] * (body.electrons / picture.gain_e_per_dn - each[k]) for k, body in drawn.items())
    )


def _center_differences(
    picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState, each: FloatArray
) -> FloatArray:
    """Differences of the light of all bodies, `each` (n, ...), with respect to their centers (2 n, ...)."""
    n, still = len(state.names), np.zeros(len(state.names))
    steps = CENTER_STEP_PX * np.eye(2 * n).reshape(-1, n, 2)
    moved = [_change(picture, window, state.moved(step, still), k // 2, each) for k, step in enumerate(steps)]
    return np.stack(moved) / CENTER_STEP_PX


def _range_derivatives(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    state: SceneState,
    light: SceneLight,
    wanted: BoolArray,
) -> FloatArray:
    """Return differences of the light of all bodies with respect to the logarithm of range, for those wanted (k, ...)."""
    n, out = len(state.names), []
    for index in np.flatnonzero(wanted).tolist():
        step = EDGE_STEP_PX / max(0.5 * float(light.diameter_px[index]), 1.0)
        nearer = state.moved(np.zeros((n, 2)), np.where(np.arange(n) == index, step, 0.0))
        out.append(_change(picture, window, nearer, index, light.each) / step)
    return np.reshape(out, (-1, *light.each.shape[1:]))


# ---- Normal equations of pictures: columns (p, n_line, n_pixel), weights and data (n_line, n_pixel).

RIDGE = 1e-10  # of a unit diagonal: keeps a parameter that nothing depends on from becoming infinite


def normal_matrix(columns: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the information matrix (p, p)."""
    used = np.flatnonzero(weight)
    flat = columns.reshape(len(columns), -1)[:, used]
    return symmetric((flat * weight.ravel()[used]) @ flat.T)


def right_hand_side(columns: FloatArray, weight: FloatArray, data: FloatArray) -> FloatArray:
    """Return the right-hand side (p,)."""
    return np.asarray(columns.reshape(len(columns), -1) @ (weight * data).ravel())


def solve_normal(information: FloatArray, right: FloatArray) -> FloatArray:
    """Return the parameters (p,)."""
    scale, scaled = _scaled(information)
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


def inverse_normal(information: FloatArray) -> FloatArray:
    """Return the covariance (p, p)."""
    scale, scaled = _scaled(information)
    return symmetric(scale[:, None] * np.linalg.inv(scaled) * scale)


def _scaled(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scales (p,) and the matrix scaled to a unit diagonal; a parameter that nothing depends on stays 0."""
    diagonal = np.diag(information)
    known = diagonal > 0.0
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    ridge = np.where(known, RIDGE, 1.0)
    return scale, information * scale[:, None] * scale + np.diag(ridge)


# ---- Weighted least squares of rendered bodies to a picture: Gauss-Newton with few renderings.

MAX_RENDERINGS = 12
CONVERGED_PX = 0.01  # a step this small leaves an error of second order, 1e-4 px
STILL_SIGMAS = 0.1  # of the center, as the residuals scatter
MAX_STEP_PX = 2.0  # linear in the center no farther than the PSF and the limb's curvature allow
MAX_STEP_LOG = 0.25
MAX_LOG_RANGE = 1.2  # a factor of 3.3
FRESH_PX = 0.15  # derivatives that were taken farther away than this are taken anew
TURNED = 0.5  # a step back by this share of the last one: to and fro, as weights change with the model
GROWTH = 1.01  # chi-squared may grow so much in a step: the weights change with the model


@dataclass(frozen=True, slots=True, eq=False)
class SceneFit:
    """Bodies fitted to a picture.

    Attributes
    ----------
    state
        The solution.
    light
        Rendered at the last step but one; the last step is below `CONVERGED_PX`.
    model_dn : (n_line, n_pixel) array
        All bodies at the solution, without the level.
    residual_dn, weight : (n_line, n_pixel) arrays
        Data minus model and level; 1 / variance, 0 for pixels not used.
    columns : (p, n_line, n_pixel) array
        Derivatives of the model with respect to the parameters, see `light_scene`.
    information : (p, p) array
        Normal matrix.
    hits : (n_line, n_pixel) array of bool
        Pixels left out because their light is not that of a body.
    steps_px : tuple of (n, 2) arrays
    chi2
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
        return inverse_normal(self.information)

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
) -> SceneFit:
    """Fit the bodies of `start` to the pixels of a cutout.

    Parameters
    ----------
    start
        Centers good to about the width of the PSF; its scales and level do not matter.
    solve_range : (n,) array of bool, optional
        Bodies whose range is solved for from their size.

    Pixels whose light is not that of the bodies (see `find_hit_pixels`) are left out, and the rest is fitted again.
    """
    wanted = np.zeros(len(start.names), dtype=bool) if solve_range is None else np.asarray(solve_range, bool)
    problem = _SceneProblem(picture, cutout, wanted)
    first = _minimize(
        problem, _linearised(problem, replace(start, scales=np.ones(len(start.names))), _no_hits(cutout))
    )
    hits = find_hit_pixels(first.residual_dn, first.weight)
    if not hits.any():
        return first
    again = _linearised(problem, first.state, hits)
    second = _minimize(problem, again)
    return replace(second, steps_px=first.steps_px + second.steps_px)


@dataclass(frozen=True, slots=True, eq=False)
class _SceneProblem:
    picture: BodyPicture
    cutout: Cutout
    wanted: BoolArray  # (n,) ranges to solve for

    @property
    def count(self) -> int:
        return int(self.wanted.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _LinearizedScene:
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


def _linearised(
    problem: _SceneProblem, state: SceneState, hits: BoolArray, known: _LinearizedScene | None = None
) -> _LinearizedScene:
    """Render a state, solve for its scales and level, and take the derivatives: those `known`, if they are near enough."""
    near = known is not None and float(np.abs(state.centers_px - known.derived_at).max()) < FRESH_PX
    light = light_scene(problem.picture, problem.cutout.window, state, derivatives=not near)
    before = state.scales
    state, weight = solve_brightness(problem.cutout, state, light.each, hits)
    n = len(state.names)
    if known is not None and near:
        ratio = np.concatenate(
            [np.repeat(_ratio(state.scales, known.state.scales), 2), np.ones(problem.count)]
        )
        changing, derived_at = known.columns[: 2 * n + problem.count] * ratio[:, None, None], known.derived_at
    else:
        moving = light.d_center * np.repeat(_ratio(state.scales, before), 2)[:, None, None]
        sizes = _range_derivatives(problem.picture, problem.cutout.window, state, light, problem.wanted)
        changing, derived_at = np.concatenate([moving, sizes]), state.centers_px
    residual = problem.cutout.data_dn - light.total(state.scales) - state.level_dn
    columns = np.concatenate([changing, light.each, np.ones((1, *weight.shape))])
    return _LinearizedScene(state, light, columns, weight, residual, hits, derived_at)


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
        solved = solve_normal(normal_matrix(design, weight), right_hand_side(design, weight, cutout.data_dn))
        expected = np.tensordot(solved[:-1], each, axes=1)
    weight = np.where(hits, 0.0, cutout.weight(expected))
    return replace(state, scales=solved[:-1], level_dn=float(solved[-1])), weight


def _minimize(problem: _SceneProblem, linear: _LinearizedScene) -> SceneFit:
    """Step until the steps are small; one that makes the fit worse is halved; so are all from one on that turns back."""
    steps: list[FloatArray] = []
    share = 1.0
    for _ in range(MAX_RENDERINGS):
        change = _step(linear, problem)
        small = _length(change, linear, problem) < max(CONVERGED_PX, STILL_SIGMAS * _sigma_px(linear))
        if steps and turns_back(change[: steps[-1].size], steps[-1].ravel()):
            share *= 0.5
        change = change if small else share * change
        state = _stepped(linear.state, change, problem)
        steps.append(state.centers_px - linear.state.centers_px)
        if small:
            return _finished(linear, change, state, tuple(steps), converged=True)
        previous, linear = linear, _linearised(problem, state, linear.hits, linear)
        if linear.chi2 / linear.degrees > GROWTH * previous.chi2 / previous.degrees:
            steps[-1] = 0.5 * steps[-1]
            linear = _linearised(problem, _between(previous.state, state), previous.hits, previous)
    return _finished(linear, np.zeros(len(linear.columns)), linear.state, tuple(steps), converged=False)


def turns_back(step: FloatArray, last: FloatArray) -> bool:
    """Tell whether a step undoes a good part of the last one; one much longer is due to fresh derivatives."""
    before = float(last @ last)
    return float(step @ last) < -TURNED * before and float(step @ step) < before / TURNED**2


def _step(linear: _LinearizedScene, problem: _SceneProblem) -> FloatArray:
    """Return the change of all parameters, those of centers and ranges within limits."""
    change = solve_normal(
        normal_matrix(linear.columns, linear.weight),
        right_hand_side(linear.columns, linear.weight, linear.residual),
    )
    n, k = len(linear.state.names), problem.count
    centers = change[: 2 * n].reshape(n, 2)
    longest = float(np.sqrt(np.max(np.sum(centers**2, axis=1))))
    largest = float(np.abs(change[2 * n : 2 * n + k]).max(initial=0.0))
    return change * min(1.0, MAX_STEP_PX / max(longest, 1e-300), MAX_STEP_LOG / max(largest, 1e-300))


def _length(change: FloatArray, linear: _LinearizedScene, problem: _SceneProblem) -> float:
    """Return how far a step moves centers and limbs, px."""
    n, k = len(linear.state.names), problem.count
    limbs = change[2 * n : 2 * n + k] * 0.5 * linear.light.diameter_px[problem.wanted]
    return float(np.abs(np.concatenate([change[: 2 * n], limbs])).max())


def _sigma_px(linear: _LinearizedScene) -> float:
    """Return how well the centers are known, px, if the residuals are noise."""
    n = 2 * len(linear.state.names)
    variance = np.diag(inverse_normal(normal_matrix(linear.columns, linear.weight)))[:n]
    return float(np.sqrt(variance.max() * max(linear.chi2 / linear.degrees, 1.0)))


def _stepped(state: SceneState, change: FloatArray, problem: _SceneProblem) -> SceneState:
    n, k = len(state.names), problem.count
    log_range = np.zeros(n)
    log_range[problem.wanted] = change[2 * n : 2 * n + k]
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
    linear: _LinearizedScene,
    change: FloatArray,
    state: SceneState,
    steps: tuple[FloatArray, ...],
    *,
    converged: bool,
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
