"""Center of a body by cross-correlation of its rendered picture with the data.

Flow   place, disk (`opnav_workbench.bodies.detection`) -> render at the place -> 3 x 3 lags about it -> paraboloid's peak,
       against that of the model with itself -> render there -> ... until the peak stands still

A paraboloid through 3 x 3 samples is not the correlation's peak: it is off by up to 0.1 px, and by an amount that depends
on where between the pixels the body lies. The model correlated with itself, with the same weights and the same missing
pixels, is off just as much; the difference of the two has no bias, and vanishes at the solution.

Reference: Jackman & Dumont (2013), AAS 13-443, "Cross-Correlation Target Centerfinding".
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, symmetric
from opnav_workbench.bodies.detection import (
    DetectedScene,
    SearchRequest,
    detect_bodies,
    fit_figures,
    fit_pixels,
    start_state,
)
from opnav_workbench.bodies.fit_report import report_fitted_bodies, without_pixels
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter
from opnav_workbench.bodies.scene_fit import (
    SceneFit,
    SceneLight,
    SceneState,
    light_scene,
    solve_brightness,
    turns_back,
)
from opnav_workbench.bodies.subarray import Cutout, find_hit_pixels
from opnav_workbench.stars.peaks import paraboloid_peak
from opnav_workbench.threads import one_thread

__all__ = ["find_cross_correlation"]

METHOD = "cross_correlation"
CONVERGED_PX = 0.01  # the step is calibrated: what is left after it is of second order
MAX_RENDERINGS = 10
PROBE_PX = 0.01  # of numeric derivatives of the peak
FRESH_SLOPES_PX = 0.3  # derivatives rendered farther away than this are rendered anew
MIN_RESPONSE = 0.05  # of the peak to a shift, as a determinant: below, the paraboloid says nothing
MIN_PIXELS = 10
LAGS = [(line, pixel) for line in (-1, 0, 1) for pixel in (-1, 0, 1)]


@one_thread()
def find_cross_correlation(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    search_radius_px: float | None = None,
    known_surface: bool = False,
) -> BodyCenter:
    """Find a body's center of figure by correlation with its model.

    Bodies that touch it are rendered along, at their likely places; pixels of the others are left out.

    Parameters
    ----------
    circle
        Where an analyst sees the body.
    search_radius_px, known_surface
        As of `find_least_squares`.

    Returns
    -------
    BodyCenter
        `detail` is a `ModelFit`; covariance as in `find_least_squares`, of this estimator: it weighs the limb less sharply
        than least squares do.

    Raises
    ------
    CenterfindingError
        The body is not in the scene.
    """
    picture.model(name)
    circles = {} if circle is None else {name: circle}
    known = (name,) if known_surface else ()
    detected = detect_bodies(picture, (name,), SearchRequest(METHOD, circles, search_radius_px, known))
    if name in detected.missed:
        return detected.missed[name]
    cutout = fit_pixels(detected)
    if cutout is None or np.count_nonzero(cutout.use) < MIN_PIXELS:
        return without_pixels(name, METHOD)
    scene, fit = fit_figures(detected, partial(_iterate, cutout))
    centers, _ = report_fitted_bodies(cutout, scene, fit, METHOD, np.zeros(len(fit.state.names), bool))
    return centers[name]


@dataclass(frozen=True, slots=True, eq=False)
class _Correlation:
    """The model about its place, and its correlation with pictures at the 3 x 3 lags."""

    weight: FloatArray
    centered: FloatArray  # (9, n_line, n_pixel) weighted model at each lag, its weighted mean taken out, of unit power

    @classmethod
    def of(cls, light: FloatArray, weight: FloatArray) -> "_Correlation":
        padded = np.pad(light, 1, mode="edge")
        n_line, n_pixel = light.shape
        # The model moved by a lag shows at x what it had at x - lag.
        moved = np.stack([padded[1 - a : 1 - a + n_line, 1 - b : 1 - b + n_pixel] for a, b in LAGS])
        moved -= (np.tensordot(moved, weight, axes=2) / weight.sum())[:, None, None]
        power = np.einsum("klm,lm,klm->k", moved, weight, moved)
        moved *= weight / np.sqrt(np.maximum(power, 1e-300))[:, None, None]
        return cls(weight, moved)

    def peak(self, data: FloatArray) -> FloatArray:
        """Return the offset (2,) of the paraboloid's peak from lag zero."""
        return _offset(np.tensordot(self.centered, data, axes=2))

    def response(self, light: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return by how much (2, 2) the peak moves as the model's picture does."""
        own = np.tensordot(self.centered, light, axes=2)
        steps = [np.tensordot(self.centered, slope, axes=2) for slope in slopes]
        columns = [
            (_offset(own + PROBE_PX * step) - _offset(own - PROBE_PX * step)) / (2.0 * PROBE_PX)
            for step in steps
        ]
        return np.stack(columns, axis=1)

    def gain(self, light: FloatArray) -> FloatArray:
        """Return the change (2, n_line, n_pixel) of the peak per DN in each pixel, for data like `light`."""
        own = np.tensordot(self.centered, light, axes=2)
        probe = 1e-4 * float(np.abs(own).max())
        change = [
            (_offset(own + probe * unit) - _offset(own - probe * unit)) / (2.0 * probe) for unit in np.eye(9)
        ]
        return np.tensordot(np.stack(change, axis=1), self.centered, axes=1)


def _offset(samples: FloatArray) -> FloatArray:
    return np.asarray(paraboloid_peak(samples.reshape(1, 3, 3))[0][0])


def _iterate(cutout: Cutout, detected: DetectedScene) -> SceneFit:
    """Render and correlate until the peak stands still; look for hits once it does."""
    state = start_state(detected)
    names = state.names
    hits = np.zeros(cutout.use.shape, dtype=bool)
    slopes = np.empty((0, *cutout.use.shape))
    steps: list[FloatArray] = []
    searched, share = False, 1.0
    for _ in range(MAX_RENDERINGS):
        fresh = not steps or float(np.abs(steps[-1][0]).max()) > FRESH_SLOPES_PX
        light = light_scene(
            detected.picture, cutout.window, replace(state, scales=np.ones(len(names))), derivatives=fresh
        )
        slopes = light.d_center if fresh else slopes
        state, weight = solve_brightness(cutout, state, light.each, hits)
        step, correlation, response = _peak_step(cutout, state, light, slopes[:2], weight)
        if steps and turns_back(step, steps[-1][0]):
            share *= 0.5
        change = share * np.tile(step, (len(names), 1))  # bodies that touch it move along
        steps.append(change)
        still = float(np.abs(step).max()) < CONVERGED_PX
        fit = _as_fit(cutout, state, light, slopes, weight, hits, change, correlation, response)
        state = state.moved(change, np.zeros(len(names)))
        if still and searched:
            break
        if still:
            hits, searched = find_hit_pixels(fit.residual_dn, weight), True
            if not hits.any():
                break
    return replace(fit, steps_px=tuple(steps), converged=still)


def _peak_step(
    cutout: Cutout, state: SceneState, light: SceneLight, slopes: FloatArray, weight: FloatArray
) -> tuple[FloatArray, _Correlation, FloatArray]:
    """Return how far (2,) the body lies from where its model was rendered."""
    own = light.each[0]
    others = np.tensordot(state.scales[1:], light.each[1:], axes=1) if len(light.each) > 1 else 0.0
    correlation = _Correlation.of(own, weight)
    response = correlation.response(own, slopes)
    if not abs(np.linalg.det(response)) > MIN_RESPONSE:
        response = np.eye(2)
    offset = correlation.peak(cutout.data_dn - others) - correlation.peak(own)
    step = np.asarray(np.linalg.solve(response, offset), dtype=np.float64)
    return np.asarray(step / max(1.0, float(np.abs(step).max()))), correlation, response


def _as_fit(
    cutout: Cutout,
    state: SceneState,
    light: SceneLight,
    slopes: FloatArray,
    weight: FloatArray,
    hits: BoolArray,
    change: FloatArray,
    correlation: _Correlation,
    response: FloatArray,
) -> SceneFit:
    """Return the solution in the form of a fit, with this estimator's own gain."""
    moving = slopes * np.repeat(state.scales, 2)[:, None, None]
    columns = np.concatenate([moving, light.each, np.ones((1, *weight.shape))])
    model = light.total(state.scales) + np.tensordot(change.ravel(), moving, axes=1)
    residual = cutout.data_dn - model - state.level_dn
    flat = columns.reshape(len(columns), -1)
    own = np.linalg.solve(response, correlation.gain(light.each[0]).reshape(2, -1)) / state.scales[0]
    gain = np.zeros((2 * len(state.names), *weight.shape))
    gain[:2] = own.reshape(2, *weight.shape)
    return SceneFit(
        state=state.moved(change, np.zeros(len(state.names))),
        light=light,
        model_dn=model,
        residual_dn=residual,
        weight=weight,
        columns=columns,
        information=symmetric((flat * weight.ravel()) @ flat.T),
        hits=hits,
        steps_px=(),
        converged=False,
        chi2=float(np.sum(weight * residual**2)),
        own_gain=gain,
    )
