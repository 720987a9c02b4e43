"""The light of a scene's bodies at trial places, and how it changes with every parameter of a fit.

Parameters of a scene of n bodies, in this order: centers (pixel 0, line 0, pixel 1, ...), logarithms of the range over
the a priori one (where sizes are solved for), brightness scales, and one level under all.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.model_picture import placed_models, sunlight_electrons
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.render import MovingBody, render_moving

__all__ = ["SceneLight", "SceneState", "light_up", "range_derivatives"]

CENTER_STEP_PX = 0.1  # of numeric derivatives, where bodies hide each other
EDGE_STEP_PX = 0.1  # by which a change of range moves a limb


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Where the bodies of a scene are, how large and how bright.

    Attributes
    ----------
    names : tuple of str
    centers_px : (n, 2) array
    log_range : (n,) array
        Logarithm of range over the a priori one.
    scales : (n,) array
        Brightness, data over model.
    level_dn : float
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

    def at(self, index: int, center_px: FloatArray, log_range: float) -> "SceneState":
        """Return the state with one body somewhere else."""
        centers, ranges = self.centers_px.copy(), self.log_range.copy()
        centers[index], ranges[index] = center_px, log_range
        return replace(self, centers_px=centers, log_range=ranges)


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


def light_up(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    state: SceneState,
    *,
    derivatives: bool = True,
) -> SceneLight:
    """Render the bodies of a state, alone in the scene, with their derivatives."""
    moving = _rendered(picture, window, state, derivatives=derivatives)
    gain = picture.gain_e_per_dn
    each = np.stack([body.electrons for body in moving]) / gain
    occulted = np.array([body.body.occulted_fraction for body in moving])
    d_center = np.concatenate(
        [(scale / gain) * body.slopes for scale, body in zip(state.scales, moving, strict=True)]
    )
    if derivatives and len(moving) > 1 and np.any(occulted > 0.0):
        d_center = _numeric(picture, window, state, np.tensordot(state.scales, each, axes=1))
    return SceneLight(
        each=each,
        d_center=d_center,
        flux_dn=np.array([body.body.flux_e for body in moving]) / gain,
        occulted=occulted,
        diameter_px=np.array([body.body.diameter_px for body in moving]),
    )


def _rendered(
    picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState, *, derivatives: bool
) -> tuple[MovingBody, ...]:
    models = {
        model.target.name: model
        for model in placed_models(picture, state.places, state.range_scales, state.names)
    }
    return render_moving(
        [models[name] for name in state.names],
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
        derivatives=derivatives,
    )


def _total(picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState) -> FloatArray:
    bodies = _rendered(picture, window, state, derivatives=False)
    light = sum(scale * body.electrons for scale, body in zip(state.scales, bodies, strict=True))
    return np.asarray(light / picture.gain_e_per_dn)


def _numeric(
    picture: BodyPicture, window: tuple[int, int, int, int], state: SceneState, here: FloatArray
) -> FloatArray:
    """Differences of the light of all bodies, `here` (n_line, n_pixel), with respect to their centers (2 n, ...)."""
    n, still = len(state.names), np.zeros(len(state.names))
    steps = CENTER_STEP_PX * np.eye(2 * n).reshape(-1, n, 2)
    moved = [_total(picture, window, state.moved(step, still)) for step in steps]
    return np.stack([(there - here) / CENTER_STEP_PX for there in moved])


def range_derivatives(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    state: SceneState,
    light: SceneLight,
    wanted: BoolArray,
) -> FloatArray:
    """Return differences of the light of all bodies with respect to the logarithm of range, for those wanted (k, ...)."""
    n = len(state.names)
    here, out = light.total(state.scales), []
    for index in np.flatnonzero(wanted):
        step = EDGE_STEP_PX / max(0.5 * float(light.diameter_px[index]), 1.0)
        change = np.where(np.arange(n) == index, step, 0.0)
        out.append((_total(picture, window, state.moved(np.zeros((n, 2)), change)) - here) / step)
    return np.reshape(out, (-1, *here.shape))
