"""Bodies on the focal plane: from their models to electrons per pixel, with what is true about each.

Flow   models -> surfaces before the camera -> radiance along rays -> pixels, divided at edges -> PSF -> electrons
Frame  J2000; (pixel, line) on the detector
Units  km, rad, px, electrons

A ray has the body's true direction: distortion and stellar aberration are undone for every pixel, so that a body lies
where `opnav_workbench.scene.predict_body` puts it. Bodies hide each other and cast shadows on each other.

regime  diameter   how
point   < 1 px     four points that have the light, the center of light and the second moments of the disk
small   1..4 px    every pixel divided: 4 x 4 cells, edges 32 x 32 (AAS 13-443: 5 x 5); light and center are the body's
disk    > 4 px     pixels divided where limb, terminator, shadow or pattern ask for it

The light itself (flux, center, moments) is integrated over the surface, independent of the pixels, so that it does not
change from regime to regime.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, readonly
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.psf import Psf, add_sources
from opnav_workbench.render.body import BodyModel, PlacedBody, integrate_light
from opnav_workbench.render.disk import SHIFT_STEP_PX, CameraView, add_disk
from opnav_workbench.render.grid import Window
from opnav_workbench.targets import TargetState

__all__ = ["MovingBody", "RenderedBody", "Rendering", "render_bodies", "render_moving", "render_touched"]


# ---- One body drawn: its regime, its light, and how that changes as the body moves.

Regime = Literal["point", "small", "disk"]

SMALL_FROM_PX, DISK_FROM_PX = 1.0, 4.0  # diameters; AAS 13-443, "Simulating Target Bodies in OpNav Images"
OWN_LIGHT_TO_PX = 6.0  # from 4 to 6 px the scaling to the body's light fades out


@dataclass(frozen=True, slots=True, eq=False)
class RenderedBody:
    """What is true about one body in the picture.

    Attributes
    ----------
    center_px : (2,) array
        Projected center of figure, (pixel, line); nan behind the camera.
    light_px : (2,) array
        Center of the light that reaches the focal plane, before the PSF; nan where none does.
    flux_e
        Electrons of that light, on and off the detector.
    diameter_px
        Of the circle with the area of the projected limb.
    occulted_fraction
        Share of the body's light that other bodies hide.
    regime : {"point", "small", "disk"}
    """

    name: str
    center_px: FloatArray
    light_px: FloatArray
    flux_e: float
    diameter_px: float
    occulted_fraction: float
    regime: Regime

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedScene:
    """Bodies placed before a camera; points have no place of their own."""

    view: CameraView
    models: tuple[BodyModel, ...]
    psfs: tuple[Psf, ...]
    placed: dict[int, PlacedBody]

    def may_change(self, one: int, other: int) -> bool:
        """Tell whether a body may hide or shade another; of points, it may whatever lies where."""
        if one not in self.placed:
            return False
        return other not in self.placed or self.placed[one].touches(self.placed[other])


def place_scene(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    psf: Psf | Sequence[Psf],
    window: Window | None,
) -> PlacedScene:
    """Place bodies before a camera; see `opnav_workbench.render.render_bodies`."""
    view = CameraView(
        camera,
        readonly(camera_from_j2000, (3, 3), "camera_from_j2000"),
        readonly(observer_velocity_km_s, (3,), "observer_velocity_km_s"),
        (0, 0, camera.n_pixel, camera.n_line) if window is None else window,
    )
    if min(view.window[2:]) < 1:
        raise CameraError(f"window {view.window} is empty; give first pixel, first line, pixels, lines.")
    each_psf = tuple(psf) if isinstance(psf, Sequence) else (psf,) * len(models)
    placed = {
        i: PlacedBody(model, camera.pixel_scale_rad) for i, model in enumerate(models) if not model.is_point
    }
    for body in placed.values():
        body.note_occulters(list(placed.values()))
    return PlacedScene(replace(view, placed=tuple(placed.values())), tuple(models), each_psf, placed)


def draw_body_light(stage: PlacedScene, index: int, pictures: FloatArray, sunlight_e: float) -> RenderedBody:
    """Add the light of a body to `pictures` (1 or 3, n_line, n_pixel) in place.

    With three pictures, the second and third gain its derivatives as the body moves along pixel and along line.
    """
    psf = stage.psfs[index]
    if index not in stage.placed:
        return _draw_point(pictures, stage.models[index], stage.view, psf)
    return _draw_extended(pictures, stage.placed[index], stage.view, psf, sunlight_e)


def _draw_point(pictures: FloatArray, model: BodyModel, view: CameraView, psf: Psf) -> RenderedBody:
    center = view.predict(model.target).pixel_line
    flux = float(model.flux_e or 0.0)
    ray = model.target.position_km[:, None]
    hidden = any(bool(body.blocks(ray, np.ones(1))[0]) for body in view.placed)
    if not hidden and np.isfinite(center).all():
        _add_points(pictures, view, psf, center[None], np.array([flux]), center)
    gone = 1.0 if hidden else 0.0
    return RenderedBody(model.target.name, center, center, 0.0 if hidden else flux, 0.0, gone, "point")


def _draw_extended(
    pictures: FloatArray, body: PlacedBody, view: CameraView, psf: Psf, sunlight_e: float
) -> RenderedBody:
    prediction = view.predict(_sized(body))
    light = integrate_light(body, view.project)
    given = body.model.flux_e
    if given is None:
        scale = sunlight_e / np.pi
    else:
        scale = given / light.total if light.total > 0.0 else 0.0
    diameter = prediction.diameter_px
    if not np.isfinite(diameter):  # the limb leaves what the camera model covers
        diameter = 2.0 * body.angular_radius_rad / view.camera.pixel_scale_rad
    regime: Regime = "point" if diameter < SMALL_FROM_PX else "small" if diameter < DISK_FROM_PX else "disk"
    if regime == "point":
        _add_points(pictures, view, psf, *light.four_points(scale), light.center_px)
    elif light.total > 0.0 and view.may_show(body):
        own_light = float(np.clip((OWN_LIGHT_TO_PX - diameter) / (OWN_LIGHT_TO_PX - DISK_FROM_PX), 0.0, 1.0))
        everywhere = regime == "small" or body.finely_patterned
        add_disk(
            pictures, body, view, psf, prediction, light, scale, everywhere=everywhere, own_light=own_light
        )
    return RenderedBody(
        body.model.target.name, prediction.pixel_line, light.center_px, scale * light.seen, diameter,
        light.occulted_fraction, regime,
    )  # fmt: skip


def _sized(body: PlacedBody) -> TargetState:
    """Return the target with the extent of its shape, which its center, diameter and outline are predicted from."""
    model = body.model
    if model.shape is None:
        return model.target
    return replace(model.target, radii_km=model.shape.radii_km)


def _add_points(
    pictures: FloatArray,
    view: CameraView,
    psf: Psf,
    places: FloatArray,
    flux_e: FloatArray,
    center: FloatArray,
) -> None:
    if not np.isfinite(center).all():
        return
    here, inside = psf.at(center), places - np.array(view.window[:2])
    add_sources(pictures[0], here, inside, flux_e)
    for picture, step in zip(pictures[1:], SHIFT_STEP_PX * np.eye(2), strict=False):
        add_sources(picture, here, inside + step, 0.5 / SHIFT_STEP_PX * flux_e)
        add_sources(picture, here, inside - step, -0.5 / SHIFT_STEP_PX * flux_e)


# ---- Bodies on the focal plane: from their models to electrons per pixel, with what is true about each.


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """Electrons of all bodies on the focal plane, and what is true about each body.

    Attributes
    ----------
    electrons : (n_line, n_pixel) array
        Over the window.
    window : (int, int, int, int)
        First pixel, first line, pixels, lines.
    bodies
        In the order of the models.
    """

    electrons: FloatArray
    window: Window
    bodies: tuple[RenderedBody, ...]
    _view: "CameraView"

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def occults(self, directions: ArrayLike) -> BoolArray:
        """Tell which stars hide behind a body.

        Parameters
        ----------
        directions : (n, 3) array_like
            Apparent directions (stellar aberration applied), J2000, as `scene.predict_stars` gives them.
        """
        apparent = np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        rays = geometric_direction(apparent, self._view.velocity_km_s).T
        hidden = np.zeros(rays.shape[1], dtype=bool)
        for body in self._view.placed:
            toward = body.position_km / np.linalg.norm(body.position_km)
            near = np.flatnonzero(toward @ rays >= np.cos(min(1.01 * body.angular_radius_rad, np.pi)))
            hidden[near] |= body.blocks(rays[:, near], np.full(len(near), np.inf))
        return hidden


@dataclass(frozen=True, slots=True, eq=False)
class MovingBody:
    """One body's electrons over a window, and their derivatives as it moves without turning.

    Attributes
    ----------
    electrons : (n_line, n_pixel) array
    slopes : (2, n_line, n_pixel) array
        Electrons per px of motion along pixel and along line; (0, ...) where none were asked for.
    """

    electrons: FloatArray
    slopes: FloatArray
    body: RenderedBody

    def __post_init__(self) -> None:
        freeze_arrays(self)


def render_bodies(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
    window: Window | None = None,
) -> Rendering:
    """Render bodies: the noiseless light that each pixel collects.

    Parameters
    ----------
    camera_from_j2000 : (3, 3) array_like
    observer_velocity_km_s : (3,) array_like
        With respect to the solar-system barycenter, J2000; zero switches stellar aberration off.
    psf : Psf, or one for each model
        Taken at each body's center (`Psf.at`).
    sunlight_e
        Electrons that the Sun at 1 au would give as a point (``camera.sunlight_e(exposure_s)``). A pixel of solid angle
        w that sees a reflectance I/F at r au collects ``sunlight_e / r^2 * I/F * w / pi``.
    window : (int, int, int, int), optional
        First pixel, first line, pixels and lines to render; the whole detector if not given.

    Returns
    -------
    Rendering
        The same inputs give the same bits.

    Raises
    ------
    CameraError
        An empty window, or a camera inside a body.

    Examples
    --------
    Charon, 40 px wide at half phase, before a pinhole camera.

    >>> from opnav_workbench.psf import GaussianPsf
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> from opnav_workbench.targets import TargetState
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> charon = TargetState("CHARON", [0, 0, 3.03e6], radii_km=[606.0] * 3, sun_position_km=[4.9e9, 0, 0])
    >>> rendering = render_bodies(
    ...     [BodyModel(charon, albedo=0.4)], camera, np.eye(3), np.zeros(3), psf=GaussianPsf(0.8, 0.8), sunlight_e=1e15
    ... )
    >>> body = rendering.bodies[0]
    >>> body.regime, body.center_px.tolist(), body.light_px.round(2).tolist()
    ('disk', [511.5, 511.5], [523.28, 511.5])
    >>> round(float(rendering.electrons.sum() / body.flux_e), 4)
    1.0

    Notes
    -----
    Pixels of bodies are exact to 0.1 % of the peak. Radiance is taken at each pixel's geometric direction; the change of
    brightness with the observer's motion (2 v/c, 1e-4) is left out.
    """
    stage = place_scene(models, camera, camera_from_j2000, observer_velocity_km_s, psf, window)
    picture = np.zeros((stage.view.window[3], stage.view.window[2]))
    bodies = tuple(draw_body_light(stage, i, picture[None], sunlight_e) for i in range(len(stage.models)))
    np.maximum(picture, 0.0, out=picture)  # rounding of the FFT
    return Rendering(picture, stage.view.window, bodies, stage.view)


def render_one(
    models: Sequence[BodyModel],
    index: int,
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
) -> Rendering:
    """Render the light of one body alone, hidden and shaded by the others; its `occults` tells what this body hides.

    Parameters are those of `render_bodies`, with the body's index among the models.
    """
    stage = place_scene(models, camera, camera_from_j2000, observer_velocity_km_s, psf, None)
    picture = np.zeros((stage.view.window[3], stage.view.window[2]))
    body = draw_body_light(stage, index, picture[None], sunlight_e)
    own = (stage.placed[index],) if index in stage.placed else ()
    return Rendering(np.maximum(picture, 0.0), stage.view.window, (body,), replace(stage.view, placed=own))


def render_moving(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
    window: Window | None = None,
    derivatives: bool = True,
) -> tuple["MovingBody", ...]:
    """Render bodies each by itself, and how their light changes as they move.

    Parameters are those of `render_bodies`; `derivatives` tells whether derivatives are wanted. A body's light still
    lacks what others hide or shade. Each surface is looked at once; its light is then spread with the PSF and with the
    PSF's derivatives, so that this takes about twice the time of `render_bodies`.

    Returns
    -------
    tuple of MovingBody
        In the order of the models.
    """
    stage = place_scene(models, camera, camera_from_j2000, observer_velocity_km_s, psf, window)
    return tuple(
        _moving_body(stage, index, sunlight_e, derivatives=derivatives) for index in range(len(stage.models))
    )


def render_touched(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
    window: Window | None = None,
    moved: int,
) -> Mapping[int, "MovingBody"]:
    """Render, by index, a body that was moved and those whose light it may change: what it hides or shades.

    Parameters are those of `render_bodies`; the rest of the scene looks as it did before the body moved. Light alone,
    without derivatives.
    """
    stage = place_scene(models, camera, camera_from_j2000, observer_velocity_km_s, psf, window)
    return {
        index: _moving_body(stage, index, sunlight_e, derivatives=False)
        for index in range(len(stage.models))
        if index == moved or stage.may_change(moved, index)
    }


def _moving_body(stage: PlacedScene, index: int, sunlight_e: float, *, derivatives: bool) -> MovingBody:
    pictures = np.zeros((3 if derivatives else 1, stage.view.window[3], stage.view.window[2]))
    body = draw_body_light(stage, index, pictures, sunlight_e)
    return MovingBody(np.maximum(pictures[0], 0.0), pictures[1:], body)
