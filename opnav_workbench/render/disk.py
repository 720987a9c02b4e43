"""A resolved body in the picture: which pixels to look along, what they see, and that light spread by the PSF.

Flow   outline -> window -> samples of radiance, pixels divided at edges -> light per pixel and cell -> PSF -> picture

A pixel left whole is a square with a mean and two slopes of brightness, and is spread by FFT; its three kernels are
averages of the PSF over all places in the pixel, for the slopes weighted by the distance from its middle. A divided
pixel's cells are sources at their middles, spread cell by cell; that widens them by the cell's own second moment, which a
three-point correction of the kernel takes out again (and, for the pixel left whole, puts in).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import angle_between, apparent_direction
from opnav_workbench.psf import Psf, add_boxes
from opnav_workbench.render.body import BodyModel, IntegratedLight, PlacedBody
from opnav_workbench.render.grid import PixelGrid, Window, pixel_grid
from opnav_workbench.render.maps import AlbedoMap
from opnav_workbench.render.sampling import (
    PATTERNED_SURFACE,
    PLATED_SURFACE,
    SMOOTH_SURFACE,
    Fineness,
    sample_pixels,
)
from opnav_workbench.scene import BodyPrediction, Observer, predict_body
from opnav_workbench.targets import TargetState

__all__ = ["CameraView", "add_disk"]


# ---- Light on the focal plane spread by the PSF: whole pixels by FFT, divided pixels cell by cell.

BOXES_AT_ONCE = 20_000  # 20 000 boxes of 13 x 13 pixels: 27 MB
SHIFT_STEP_PX = 0.05  # of derivatives: good to 0.5 % for a PSF of sigma 0.3 px, and far above rounding
CELLS_OF_WHOLE = 8  # cells along a pixel that the kernel of a uniform pixel is averaged over


def add_spread_light(
    pictures: FloatArray,
    first: tuple[int, int],
    whole: FloatArray,
    divided: IntArray,
    cells: FloatArray,
    psf: Psf,
    shift_px: FloatArray,
) -> None:
    """Add the light of a window to `pictures` in place; what falls off their edges is lost.

    Parameters
    ----------
    pictures : (1 or 3, n_line, n_pixel) array
        The light; with three pictures also its derivatives as all of it moves along pixel and along line, px^-1.
    first : (int, int)
        (pixel, line) of the window's first pixel, in the pictures.
    whole : (3, m_line, m_pixel) array
        Light of whole pixels, and its slopes along pixel and line.
    divided : (n,) array of int
        Flat indices into `whole` of the divided pixels.
    cells : (n, s, s) array
        Their light, [line, pixel].
    shift_px : (2,) array
        By which all of it is moved, (pixel, line).
    """
    if whole.any():
        _add_whole(pictures, first, whole, psf, shift_px)
    if len(divided) == 0:
        return
    kernels = _moving_kernels(len(pictures), psf, shift_px, cells.shape[1], -1.0)
    size = kernels.shape[-1]
    line, pixel = np.divmod(divided, whole.shape[2])
    corner = np.stack([pixel + first[0], line + first[1]], axis=-1) - size // 2
    flat = kernels.reshape(len(kernels), -1, size * size)
    for begin in range(0, len(divided), BOXES_AT_ONCE):
        part = slice(begin, begin + BOXES_AT_ONCE)
        light = cells[part].reshape(-1, flat.shape[1])
        for picture, kernel in zip(pictures, flat, strict=True):
            add_boxes(picture, (light @ kernel).reshape(-1, size, size), corner[part])


def _add_whole(
    pictures: FloatArray, first: tuple[int, int], whole: FloatArray, psf: Psf, shift_px: FloatArray
) -> None:
    cells = _moving_kernels(len(pictures), psf, shift_px, CELLS_OF_WHOLE, +1.0)
    at = (np.arange(CELLS_OF_WHOLE) + 0.5) / CELLS_OF_WHOLE - 0.5
    kernels = np.stack([cells, cells * at[:, None, None], cells * at[:, None, None, None]], axis=1)
    kernels = kernels.mean(axis=(2, 3))
    reach = kernels.shape[-1] // 2
    size = [n + 2 * reach for n in whole.shape[1:]]
    good = [fft.next_fast_len(n, real=True) for n in size]
    light = fft.rfft2(whole, good)
    pixel, line = first[0] - reach, first[1] - reach
    for picture, kernel in zip(pictures, kernels, strict=True):
        spectrum = np.einsum("kij,kij->ij", light, fft.rfft2(kernel, good))
        spread = fft.irfft2(spectrum, good)[: size[0], : size[1]]
        into = picture[max(line, 0) : line + size[0], max(pixel, 0) : pixel + size[1]]
        top, left = max(-line, 0), max(-pixel, 0)
        into += spread[top : top + into.shape[0], left : left + into.shape[1]]


def _moving_kernels(count: int, psf: Psf, shift_px: FloatArray, cells: int, width_sign: float) -> FloatArray:
    """Return `_cell_kernels` (1, s, s, k, k), or with `count` 3 their derivatives with respect to the shift as well."""
    if count == 1:
        return _cell_kernels(psf, shift_px, cells, width_sign)[None]
    steps = SHIFT_STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    moved = [_cell_kernels(psf, shift_px + step, cells, width_sign) for step in steps]
    size = max(kernel.shape[-1] for kernel in moved)
    pads = [(size - kernel.shape[-1]) // 2 for kernel in moved]
    here, right, left, down, up = (
        np.pad(kernel, ((0, 0), (0, 0), (n, n), (n, n))) for kernel, n in zip(moved, pads, strict=True)
    )
    return np.stack([here, (right - left) / (2.0 * SHIFT_STEP_PX), (down - up) / (2.0 * SHIFT_STEP_PX)])


def _cell_kernels(psf: Psf, shift_px: FloatArray, cells: int, width_sign: float) -> FloatArray:
    """Return the shares (s, s, k, k) in whole pixels of the light of each cell of a pixel, which lies in the middle."""
    # Second differences of a kernel, over 24, are the effect of a cell's own width.
    fine = np.pad(psf.kernel(cells, shift_px), 1)
    bend = sum(np.roll(fine, k, axis) for k in (1, -1) for axis in (0, 1)) - 4.0 * fine
    lines = _summed_by_pixel(fine + width_sign / 24.0 * bend, cells)  # [cell, pixel, kernel element]
    both = _summed_by_pixel(np.moveaxis(lines, 2, 0), cells)  # [pixel cell, pixel, line cell, line]
    return np.ascontiguousarray(both.transpose(2, 0, 3, 1))


def _summed_by_pixel(fine: FloatArray, cells: int) -> FloatArray:
    """Return sums (s, k, ...) over whole pixels of a kernel (n, ...) about each of the s cells of the middle pixel."""
    n = len(fine)
    pixels = -(-(n // 2) // cells)  # whole pixels that the kernel reaches to each side
    out = np.empty((cells, 2 * pixels + 1, *fine.shape[1:]))
    for cell in range(cells):
        padded = np.zeros(((2 * pixels + 1) * cells, *fine.shape[1:]))
        start = pixels * cells + cell - n // 2
        padded[start : start + n] = fine
        out[cell] = padded.reshape(2 * pixels + 1, cells, *fine.shape[1:]).sum(axis=1)
    return out


# ---- A resolved body in the picture.

LIMB_MARGIN_PX = (
    2  # around the outline that predict_body draws with 180 points: its chords miss 2e-4 of the radius
)
VIEW_MARGIN = 1.1  # of the half diagonal: pixels beside the detector that the PSF carries light from


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
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
    view: CameraView,
    psf: Psf,
    prediction: BodyPrediction,
    light: IntegratedLight,
    scale: float,
    *,
    everywhere: bool,
    own_light: float,
) -> None:
    """Add a resolved body's light to `pictures` in place: `scale` electrons per unit of I/F times sunlight times sr.

    `pictures` (1 or 3, n_line, n_pixel) are those of `opnav_workbench.render.disk.add_spread_light`.
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
        for other in body.occulters:
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


def _outline_px(body: PlacedBody, prediction: BodyPrediction, view: CameraView) -> FloatArray:
    """Return points (n, 2) px around all that the body may cover."""
    if body.model.shape is None:
        return prediction.limb_px
    sphere = replace(body.model.target, radii_km=np.full(3, body.surface.bounding_km))
    return view.predict(sphere).limb_px


def _covered(outline: FloatArray, view: CameraView, margin: int) -> tuple[Window | None, bool]:
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
