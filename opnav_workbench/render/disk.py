"""A resolved body in the picture: which pixels to look along, what they see, and that light through the PSF."""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import angle_between, apparent_direction
from opnav_workbench.psf import Psf
from opnav_workbench.render.body import BodyModel, PlacedBody
from opnav_workbench.render.convolution import add_spread_light
from opnav_workbench.render.grid import PixelGrid, Window, pixel_grid
from opnav_workbench.render.light import BodyLight
from opnav_workbench.render.maps import AlbedoMap
from opnav_workbench.render.sampling import (
    PATTERNED_SURFACE,
    PLATED_SURFACE,
    SMOOTH_SURFACE,
    Fineness,
    sample_pixels,
)
from opnav_workbench.scene import BodyPrediction, Observer, predict_body

__all__ = ["View", "add_disk"]

LIMB_MARGIN_PX = (
    2  # around the outline that predict_body draws with 180 points: its chords miss 2e-4 of the radius
)
VIEW_MARGIN = 1.1  # of the half diagonal: pixels beside the detector that the PSF carries light from


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Camera, attitude and velocity that a picture is taken with, and the bodies before it."""

    camera: Camera
    camera_from_j2000: FloatArray
    velocity_km_s: FloatArray
    window: Window
    placed: tuple[PlacedBody, ...] = ()

    def predict(self, target: TargetState) -> BodyPrediction:
        """Return where a target lies."""
        observer = Observer(
            np.zeros(3), self.velocity_km_s, "rendering"
        )  # predict_body uses the velocity alone
        return predict_body(target, observer, self.camera, self.camera_from_j2000)

    def project(self, rays: FloatArray) -> FloatArray:
        """Return where geometric J2000 rays (3, n) fall, (n, 2) px."""
        apparent = apparent_direction(rays.T, self.velocity_km_s)
        return self.camera.project(apparent @ self.camera_from_j2000.T)

    def may_show(self, body: PlacedBody) -> bool:
        """Tell whether a body may reach into the picture."""
        boresight = self.camera.boresight @ self.camera_from_j2000
        reach = VIEW_MARGIN * self.camera.half_diagonal_rad + body.angular_radius_rad
        return bool(angle_between(boresight, body.position_km) < reach)

    def grid(self, window: Window) -> PixelGrid:
        """Return the directions of a window's pixels."""
        return pixel_grid(self.camera, self.camera_from_j2000, self.velocity_km_s, window)

    def bordered(self, margin: int) -> Window:
        """Return the picture's window with a border, or without where the camera model does not reach so far."""
        pixel, line, n_pixel, n_line = self.window
        wide = (pixel - margin, line - margin, n_pixel + 2 * margin, n_line + 2 * margin)
        corners = np.array(wide[:2]) - 0.5 + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * np.array(wide[2:])
        return wide if np.isfinite(self.camera.unproject(corners)).all() else self.window


def add_disk(
    pictures: FloatArray,
    body: PlacedBody,
    view: View,
    psf: Psf,
    prediction: BodyPrediction,
    light: BodyLight,
    scale: float,
    *,
    everywhere: bool,
    own_light: float,
) -> None:
    """Add a resolved body's light to `pictures` in place: `scale` electrons per unit of I/F times sunlight times sr.

    `pictures` (1 or 3, n_line, n_pixel) are those of `opnav_workbench.render.convolution.add_spread_light`.
    With `everywhere` every pixel of the body is divided. `own_light`, 0..1, is how far the pixels' sum and center are
    brought to those of the body's light as a whole: cells of 1/32 px hold the light of a thin crescent of 4 px to 2 % and
    0.02 px only.
    """
    here = psf.at(prediction.pixel_line) if np.isfinite(prediction.pixel_line).all() else psf
    window, whole_body = _covered(_outline_px(body, prediction, view), view, int(np.ceil(here.half_size_px)))
    if window is None:
        return
    grid = view.grid(window)

    def near_edge(rays: FloatArray, reach_rad: float) -> BoolArray:
        near = body.surface.crossed_by_limb(body.to_body(rays), reach_rad)
        for other in body.hidden_by:
            near |= other.surface.crossed_by_limb(other.to_body(rays), reach_rad)
        return near

    samples = sample_pixels(grid, body.radiance, near_edge, _fineness(body.model), everywhere=everywhere)
    per_pixel = scale * grid.solid_angle
    whole = samples.whole * per_pixel
    per_cell = per_pixel.ravel()[samples.divided] / np.prod(samples.cells.shape[1:])
    cells = samples.cells * per_cell[:, None, None]
    shift = np.zeros(2)
    found = float(whole[0].sum() + cells.sum())
    if whole_body and found > 0.0:
        correction = 1.0 + own_light * (scale * light.seen / found - 1.0)
        whole, cells = whole * correction, cells * correction
        shift = own_light * (light.center_px - _center_px(window, whole, samples.divided, cells))
    first = (window[0] - view.window[0], window[1] - view.window[1])
    add_spread_light(pictures, first, whole, samples.divided, cells, here, shift)


def _center_px(window: Window, whole: FloatArray, divided: IntArray, cells: FloatArray) -> FloatArray:
    """Return the center of light (2,), (pixel, line), of what `add_spread_light` takes."""
    line, pixel = np.divmod(divided, window[2])
    at = (np.arange(cells.shape[1]) + 0.5) / cells.shape[1] - 0.5
    each, total = cells.sum(axis=(1, 2)), whole[0].sum() + cells.sum()
    # A slope of one over a pixel moves its center by 1/12 px.
    along = whole[0].sum(axis=0) @ np.arange(window[2]) + whole[1].sum() / 12.0
    down = whole[0].sum(axis=1) @ np.arange(window[3]) + whole[2].sum() / 12.0
    along += pixel @ each + cells.sum(axis=(0, 1)) @ at
    down += line @ each + cells.sum(axis=(0, 2)) @ at
    return np.asarray(np.array(window[:2]) + np.array([along, down]) / total)


def _fineness(model: BodyModel) -> Fineness:
    if model.shape is not None:
        return PLATED_SURFACE
    return PATTERNED_SURFACE if isinstance(model.albedo, AlbedoMap) else SMOOTH_SURFACE


def _outline_px(body: PlacedBody, prediction: BodyPrediction, view: View) -> FloatArray:
    """Return points (n, 2) px around all that the body may cover."""
    if body.model.shape is None:
        return prediction.limb_px
    sphere = replace(body.model.target, radii_km=np.full(3, body.surface.bounding_km))
    return view.predict(sphere).limb_px


def _covered(outline: FloatArray, view: View, margin: int) -> tuple[Window | None, bool]:
    """Return the part of the picture that the body may cover, and whether that holds the whole body.

    Light that falls up to `margin` pixels off the picture reaches into it through the PSF. Where the outline leaves what
    the camera model covers, all of the picture is taken.
    """
    wide = view.bordered(margin)
    if not np.isfinite(outline).all():
        return wide, False
    low, high = np.array(wide[:2]), np.array(wide[:2]) + np.array(wide[2:]) - 1
    begin = np.floor(outline.min(axis=0)).astype(int) - LIMB_MARGIN_PX
    end = np.ceil(outline.max(axis=0)).astype(int) + LIMB_MARGIN_PX
    first, last = np.maximum(begin, low), np.minimum(end, high)
    if np.any(last < first):
        return None, False
    size = last - first + 1
    held = bool(np.all(first == begin) and np.all(last == end))
    return (int(first[0]), int(first[1]), int(size[0]), int(size[1])), held
