"""One body drawn: its regime, its light, and how that changes as the body moves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import Psf, add_sources
from opnav_workbench.render.body import BodyModel, PlacedBody
from opnav_workbench.render.convolution import SHIFT_STEP_PX
from opnav_workbench.render.disk import View, add_disk
from opnav_workbench.render.grid import Window
from opnav_workbench.render.light import body_light

__all__ = ["RenderedBody", "Stage", "draw", "set_stage"]

Regime = Literal["point", "small", "disk"]

SMALL_FROM_PX, DISK_FROM_PX = 1.0, 4.0  # diameters; AAS 13-443, "Simulating Target Bodies in OpNav Images"
OWN_LIGHT_TO_PX = 6.0  # from 4 to 6 px the scaling to the body's light fades out


@dataclass(frozen=True, slots=True, eq=False)
class RenderedBody:
    """What is true about one body in the picture.

    Attributes
    ----------
    name : str
    center_px : (2,) array
        Projected center of figure, (pixel, line); nan behind the camera.
    light_px : (2,) array
        Center of the light that reaches the focal plane, before the PSF; nan where none does.
    flux_e : float
        Electrons of that light, on and off the detector.
    diameter_px : float
        Of the circle with the area of the projected limb.
    occulted_fraction : float
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
class Stage:
    """Bodies placed before a camera; points have no place of their own."""

    view: View
    models: tuple[BodyModel, ...]
    psfs: tuple[Psf, ...]
    placed: dict[int, PlacedBody]


def set_stage(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    psf: Psf | Sequence[Psf],
    window: Window | None,
) -> Stage:
    """Place bodies before a camera; see `opnav_workbench.render.render_bodies`."""
    view = View(
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
        body.meet_others(list(placed.values()))
    return Stage(replace(view, placed=tuple(placed.values())), tuple(models), each_psf, placed)


def draw(stage: Stage, index: int, pictures: FloatArray, sunlight_e: float) -> RenderedBody:
    """Add the light of a body to `pictures` (1 or 3, n_line, n_pixel) in place.

    With three pictures, the second and third gain its derivatives as the body moves along pixel and along line.
    """
    psf = stage.psfs[index]
    if index not in stage.placed:
        return _draw_point(pictures, stage.models[index], stage.view, psf)
    return _draw_body(pictures, stage.placed[index], stage.view, psf, sunlight_e)


def _draw_point(pictures: FloatArray, model: BodyModel, view: View, psf: Psf) -> RenderedBody:
    center = view.predict(model.target).pixel_line
    flux = float(model.flux_e or 0.0)
    ray = model.target.position_km[:, None]
    hidden = any(bool(body.blocks(ray, np.ones(1))[0]) for body in view.placed)
    if not hidden and np.isfinite(center).all():
        _add_points(pictures, view, psf, center[None], np.array([flux]), center)
    gone = 1.0 if hidden else 0.0
    return RenderedBody(model.target.name, center, center, 0.0 if hidden else flux, 0.0, gone, "point")


def _draw_body(
    pictures: FloatArray, body: PlacedBody, view: View, psf: Psf, sunlight_e: float
) -> RenderedBody:
    prediction = view.predict(_sized(body))
    light = body_light(body, view.project)
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
    pictures: FloatArray, view: View, psf: Psf, places: FloatArray, flux_e: FloatArray, center: FloatArray
) -> None:
    if not np.isfinite(center).all():
        return
    here, inside = psf.at(center), places - np.array(view.window[:2])
    add_sources(pictures[0], here, inside, flux_e)
    for picture, step in zip(pictures[1:], SHIFT_STEP_PX * np.eye(2), strict=False):
        add_sources(picture, here, inside + step, 0.5 / SHIFT_STEP_PX * flux_e)
        add_sources(picture, here, inside - step, -0.5 / SHIFT_STEP_PX * flux_e)
