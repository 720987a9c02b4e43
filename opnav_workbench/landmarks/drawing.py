"""Maplets drawn as a picture would see them: shading, shadows, what hides what, and the PSF.

Flow   heights -> radiance of samples -> finer samples -> cells of half a pixel -> PSF and pixel -> templates

All samples of a maplet are thrown onto the cells of its window with the area that they cover there; radiance over area is
the mean of what a cell shows, wherever samples fall. What the maplet does not cover, or hides, is known by the area that is
missing. A template can be read at any shift: cells are splined, and hold the PSF and the pixel's own width.

Frame  maplets' own axes for light; (pixel, line) for templates
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft, ndimage
from scipy.interpolate import CubicSpline

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import unit
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.landmarks.prediction import (
    WholeBody,
    body_axes,
    landmark_places,
    pixel_size_km,
)
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel, Lambert, LommelSeeliger, ScatteringLaw

__all__ = ["Templates", "draw_templates"]

CELLS = 2  # a pixel, each way: half a pixel is 0.9 sigma of the narrowest PSF with its pixel
SLOPE_STEP_PX = 0.55  # at most, between samples whose differences are slopes: a PSF sees detail of a pixel
STEP_CELLS = 0.8  # between finer samples: bilinear shares then leave no cell empty
EDGE_PX = 2  # of a window, beside the PSF's reach: what a template may be shifted by
AT_ONCE = 16  # maplets: their finer samples stay in the cache
LEAST_COVERED = 0.97  # of a pixel's light that comes from the maplet
LEAST_SHARE = 0.02
# The outermost pixels of what is covered are left out: a template's shift reads from beside them.
EDGE_OF_COVER = np.ones((1, 3, 3), dtype=bool)
SHADE_STRIDE = 4  # samples between those that the whole body is asked for
FLAT_TANGENT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Templates:
    """How n landmarks should look; arrays are read-only.

    Attributes
    ----------
    first : (n, 2) array of int
        (pixel, line) of the first pixel of each window.
    offset_px : (n, 2) array
        Where the landmark stands in its window, from the first pixel's center.
    size
        Pixels along a window's side.
    covered : (n, size, size) array of bool
        Pixels whose light is the maplet's.
    laws
        Names of the scattering laws they are drawn with: the body's, and one that shades slopes otherwise.
    share
        Of the second law in what `at` gives.
    """

    first: IntArray
    offset_px: FloatArray
    size: int
    covered: BoolArray
    spline: FloatArray  # (n, 2, cells, cells) coefficients by law
    margin: int  # pixels that the cells reach beyond the window
    laws: tuple[str, str]
    share: float = 0.0
    mixed: FloatArray = field(init=False, repr=False)  # (n, cells, cells) coefficients with that share

    def __post_init__(self) -> None:
        mixed = self.spline[:, 0]
        if self.share != 0.0:
            mixed = (1.0 - self.share) * mixed + self.share * self.spline[:, 1]
        object.__setattr__(self, "mixed", mixed)
        freeze_arrays(self)

    def with_share(self, share: float) -> "Templates":
        """Return the same templates with another share of the second law."""
        return replace(self, share=share)

    def __len__(self) -> int:
        return len(self.first)

    def at(self, row: int, shift_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a template (size, size) moved by (pixel, line), and its derivatives with that."""
        along, down = self._taps(shift_px)
        lines, by_line = (down.read(self.mixed[row], weight) for weight in (down.weight, down.slope))
        template, by_pixel = (along.read(lines.T, weight).T for weight in (along.weight, along.slope))
        return template, by_pixel, along.read(by_line.T, along.weight).T

    def drawn(self, row: int, shift_px: FloatArray) -> FloatArray:
        """Return a template (size, size) moved by (pixel, line), without derivatives: less than half of the work."""
        along, down = self._taps(shift_px)
        return along.read(down.read(self.mixed[row], down.weight).T, along.weight).T

    def by_law(self, row: int, shift_px: FloatArray) -> FloatArray:
        """Return a template (2, size, size) moved by (pixel, line), as each of the laws has it."""
        along, down = self._taps(shift_px)
        planes = (along.read(down.read(spline, down.weight).T, along.weight).T for spline in self.spline[row])
        return np.stack(list(planes))

    def _taps(self, shift_px: FloatArray) -> tuple["_Taps", "_Taps"]:
        """Return what reads along pixels, and down lines."""
        along, down = (
            _Taps.at(self.size, self.margin, self.spline.shape[-1], float(shift)) for shift in shift_px
        )
        return along, down


@dataclass(frozen=True, slots=True, eq=False)
class _Taps:
    """What reads every pixel of an axis from cubic spline coefficients at a shift: the same four weights for all."""

    first: int
    stop: int  # beyond the first tap's last cell
    weight: tuple[float, float, float, float]
    slope: tuple[float, float, float, float]  # derivative of the weights with the shift, px^-1

    @classmethod
    def at(cls, size: int, margin: int, cells: int, shift_px: float) -> "_Taps":
        """Return those of a shift; no template is moved by more than its margin."""
        place = CELLS * (margin - shift_px)
        begin = math.floor(place)
        t, span = place - begin, CELLS * (size - 1) + 1
        u = 1.0 - t
        first = min(max(begin - 1, 0), cells - span - 3)
        weight = (u**3 / 6.0, 0.5 * t**3 - t**2 + 2.0 / 3.0, 0.5 * u**3 - u**2 + 2.0 / 3.0, t**3 / 6.0)
        slope = (0.5 * u**2, 2.0 * t - 1.5 * t**2, 1.5 * u**2 - 2.0 * u, -0.5 * t**2)
        return cls(first, first + span, weight, tuple(CELLS * s for s in slope))  # type: ignore[arg-type]

    def read(self, coefficients: FloatArray, weight: tuple[float, float, float, float]) -> FloatArray:
        """Return values (size, ...) of coefficients (cells, ...)."""
        out = weight[0] * coefficients[self.first : self.stop : CELLS]
        for k in (1, 2, 3):
            out += weight[k] * coefficients[self.first + k : self.stop + k : CELLS]
        return np.asarray(out)


def draw_templates(
    maplets: Maplets,
    model: BodyModel,
    whole: WholeBody | None,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
    psf: Psf,
    size: int,
) -> Templates:
    """Draw maplets that are in the camera's sight.

    Parameters
    ----------
    model
        The body, see `opnav_workbench.landmarks.predict_landmarks`; its law is used, the albedo is the maplets' own.
    whole
        The body's surface, of this model or of one nearby; None: nothing else hides or shades.
    size
        Pixels along a window's side, odd.
    """
    scene = _Scene(model, whole, camera, camera_from_j2000, velocity_km_s, psf)
    parts = [
        _draw(maplets.take(slice(begin, begin + AT_ONCE)), scene, size)
        for begin in range(0, len(maplets), AT_ONCE)
    ]
    first, offset, covered, spline = (np.concatenate(p) for p in zip(*parts, strict=True))
    names = (type(model.law).__name__, type(_other(model.law)).__name__)
    return Templates(first, offset, size, covered, spline, _margin(psf), names)


def _other(law: ScatteringLaw) -> ScatteringLaw:
    """Return the law at the other end: dark bodies shade like Lommel-Seeliger, bright ones like Lambert."""
    return LommelSeeliger() if isinstance(law, Lambert) else Lambert()


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    model: BodyModel
    whole: WholeBody | None
    camera: Camera
    camera_from_j2000: FloatArray
    velocity_km_s: FloatArray
    psf: Psf


def _margin(psf: Psf) -> int:
    return int(np.ceil(psf.half_size_px)) + EDGE_PX


def _draw(maplets: Maplets, scene: _Scene, size: int) -> tuple[IntArray, FloatArray, BoolArray, FloatArray]:
    maplets = _smoothly_finer(maplets, _steps_below(maplets, scene, CELLS * SLOPE_STEP_PX))
    where = (scene.model.target, scene.camera, scene.camera_from_j2000, scene.velocity_km_s)
    middle = landmark_places(maplets.place_km, *where)
    first = np.rint(middle).astype(np.int64) - size // 2
    radiance = _radiance(maplets, scene)
    places = landmark_places(maplets.points_km(), *where)
    margin = _margin(scene.psf)
    cells = CELLS * (size + 2 * margin)
    # Cell k of a window is the place first - margin - 1/2 + (k + 1/2) / CELLS.
    at = CELLS * (places - (first - margin - 0.5)[:, None, None, :]) - 0.5
    light, area = _thrown(at, radiance, cells, _steps_below(maplets, scene, STEP_CELLS))
    known = area > 0.5
    mean = np.where(known[:, None], light / np.where(known, area, 1.0)[:, None], 0.0)
    spread = _through_psf(
        np.concatenate([mean, known[:, None].astype(np.float64)], axis=1), scene.psf, middle
    )
    share = spread[:, -1:]
    # Beside what is covered the mean goes on as far as the PSF reaches: a cliff there would ring in the spline.
    picture = np.where(share > LEAST_SHARE, spread[:, :-1] / np.maximum(share, LEAST_SHARE), 0.0)
    pixels = slice(CELLS * (margin - EDGE_PX), CELLS * (margin + size + EDGE_PX), CELLS)
    covered = ndimage.binary_erosion(share[:, 0, pixels, pixels] > LEAST_COVERED, EDGE_OF_COVER)
    covered = covered[:, EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX]
    spline = ndimage.spline_filter1d(ndimage.spline_filter1d(picture, 3, axis=2), 3, axis=3)
    return first, middle - first, covered, spline


def _steps_below(maplets: Maplets, scene: _Scene, cells: float) -> int:
    """Return by how much samples are to be divided, so that their steps are below a number of cells."""
    turn = body_axes(scene.model.target)
    to_camera = np.linalg.norm(-turn @ scene.model.target.position_km - maplets.place_km, axis=1)
    step_cells = CELLS * maplets.scale_km / pixel_size_km(scene.camera, to_camera)
    return max(1, int(np.ceil(float(step_cells.max(initial=0.0)) / cells)))


def _smoothly_finer(maplets: Maplets, parts: int) -> Maplets:
    """Return maplets whose samples are divided by cubic splines: slopes between two samples, and not across three."""
    if parts == 1:
        return maplets
    known = np.isfinite(maplets.heights_km)
    rows = _spline_between(maplets.samples, parts)
    heights = rows @ np.where(known, maplets.heights_km, 0.0) @ rows.T
    linear = _linear_rows(maplets.samples, parts)
    whole = linear @ known.astype(np.float64) @ linear.T > 1.0 - 1e-9
    albedo = np.maximum(rows @ maplets.albedo @ rows.T, 0.0)
    return Maplets(
        maplets.body, maplets.id, maplets.place_km, maplets.axes, maplets.scale_km / parts,
        np.where(whole, heights, np.nan), albedo, maplets.sigma_km, maplets.source,
    )  # fmt: skip


def _spline_between(m: int, parts: int) -> FloatArray:
    """Return what interpolates m samples by a cubic spline at (parts (m - 1) + 1) places, (places, m)."""
    return np.asarray(CubicSpline(np.arange(m), np.eye(m))(np.arange(parts * (m - 1) + 1) / parts))


# ---- Light of samples.


def _radiance(maplets: Maplets, scene: _Scene) -> FloatArray:
    """Return I/F of the samples by law (n, 2, m, m); nan where nothing is known or the sample cannot be seen."""
    target = scene.model.target
    turn = body_axes(target)
    assert target.sun_position_km is not None
    to_camera = _local(maplets, -turn @ target.position_km)
    to_sun = _local(maplets, turn @ target.sun_position_km)
    slopes = np.gradient(maplets.heights_km, axis=(1, 2))
    north, east = (slope / maplets.scale_km[:, None, None] for slope in slopes)
    length = np.sqrt(1.0 + north * north + east * east)
    cos_i, cos_e = (
        (d[:, 2, None, None] - d[:, 0, None, None] * east - d[:, 1, None, None] * north) / length
        for d in (to_sun, to_camera)
    )
    phase = np.arccos(np.clip(np.sum(to_sun * to_camera, axis=1), -1.0, 1.0))[:, None, None]
    laws = (scene.model.law, _other(scene.model.law))
    angles = (np.nan_to_num(cos_i), np.nan_to_num(cos_e), phase)
    shine = np.stack([law.reflectance(*angles) * maplets.albedo for law in laws], axis=1)
    hidden, dark = _whole_body(maplets, scene, to_camera, to_sun)
    heights = np.nan_to_num(maplets.heights_km)
    for row in range(len(maplets)):
        shine[row][:, dark[row] | _under_terrain(heights[row], maplets.scale_km[row], to_sun[row])] = 0.0
        hidden[row] |= _under_terrain(heights[row], maplets.scale_km[row], to_camera[row])
    unseen = hidden | ~np.isfinite(cos_e) | ~(cos_e > 0.0)
    return np.asarray(np.where(unseen[:, None], np.nan, shine))


def _local(maplets: Maplets, place_km: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) east, north, up from the maplets to a body-fixed place."""
    return np.asarray(np.einsum("nij,nj->ni", maplets.axes, unit(place_km - maplets.place_km)))


def _whole_body(
    maplets: Maplets, scene: _Scene, to_camera: FloatArray, to_sun: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Tell which samples (n, m, m) the rest of the body hides, and which it shades.

    What a maplet covers it knows better than the body's coarser shape, whose boulders would cast second shadows there.
    """
    shape = maplets.heights_km.shape
    if scene.whole is None:
        return np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    sparse = np.arange(0, shape[1] + SHADE_STRIDE - 1, SHADE_STRIDE).clip(max=shape[1] - 1)
    points = np.nan_to_num(maplets.points_km()[:, sparse][:, :, sparse])
    at = (sparse - 0.5 * (shape[1] - 1)) * maplets.scale_km[:, None]
    free = [_within(at, maplets.half_width_km, toward).ravel() for toward in (to_camera, to_sun)]
    found = scene.whole.hides_and_shades(points.reshape(-1, 3).T, *free)
    nearest = np.rint(np.arange(shape[1]) / SHADE_STRIDE).astype(np.int64).clip(max=len(sparse) - 1)
    hidden, dark = (f.reshape(points.shape[:3])[:, nearest][:, :, nearest] for f in found)
    return hidden, dark


def _within(at_km: FloatArray, half_km: FloatArray, toward: FloatArray) -> FloatArray:
    """Return how far (n, k, k) from samples at (n, k) along either side one is above the maplet, toward (n, 3)."""
    out = np.full(
        (*at_km.shape, at_km.shape[1]), 2.0 * np.sqrt(2.0) / FLAT_TANGENT * half_km.max(initial=0.0)
    )
    for axis, along in ((0, at_km[:, None, :]), (1, at_km[:, :, None])):
        step = toward[:, axis, None, None]
        edge = np.copysign(half_km[:, None, None], step) - along
        out = np.minimum(out, edge / np.copysign(np.maximum(np.abs(step), FLAT_TANGENT), step))
    return out


def _under_terrain(heights: FloatArray, scale: float, toward: FloatArray) -> BoolArray:
    """Tell which samples (m, m) terrain of the same maplet hides from a direction (east, north, up)."""
    out = np.zeros(heights.shape, dtype=bool)
    level = float(np.hypot(toward[0], toward[1]))
    if level < FLAT_TANGENT:
        return out
    east, north, rise = toward[0] / level, toward[1] / level, scale * toward[2] / level
    steepest = np.abs(np.diff(heights, axis=0)).max() * abs(north) + np.abs(
        np.diff(heights, axis=1)
    ).max() * abs(east)
    if steepest <= rise:
        return out
    m = len(heights)
    steps = min(m, int(np.ptp(heights) / rise) + 1) if rise > 0.0 else m
    padded = np.pad(heights, m, constant_values=-np.inf)
    for step in range(1, steps + 1):
        y, x = step * north, step * east
        i, j = int(np.floor(y)), int(np.floor(x))
        v, u = y - i, x - j
        if max(abs(i), abs(j)) >= m - 1:
            break
        cut = padded[m + i : 2 * m + i + 1, m + j : 2 * m + j + 1]
        with np.errstate(invalid="ignore"):
            between = (cut[:-1, :-1] * (1 - u) + cut[:-1, 1:] * u) * (1 - v)
            between = between + (cut[1:, :-1] * (1 - u) + cut[1:, 1:] * u) * v
        out |= between > heights + step * rise
    return out


# ---- Samples thrown onto cells.


def _thrown(at: FloatArray, radiance: FloatArray, cells: int, finer: int) -> tuple[FloatArray, FloatArray]:
    """Return light (n, k, cells, cells) and area (n, cells, cells) of samples (n, k, m, m); places (n, m, m, 2) in cells."""
    n, kinds, m = radiance.shape[:3]
    fine = _linear_rows(m, finer)
    good = np.isfinite(radiance[:, 0]) & np.isfinite(at).all(axis=-1)
    x, y, whole = (
        fine @ np.where(good, plane, 0.0) @ fine.T
        for plane in (at[..., 0], at[..., 1], np.ones_like(radiance[:, 0]))
    )
    shine = fine @ np.where(good[:, None], radiance, 0.0) @ fine.T
    (x_down, x_along), (y_down, y_along) = (np.gradient(plane, axis=(1, 2)) for plane in (x, y))
    patch = np.abs(x_along * y_down - x_down * y_along)
    used = (whole > 1.0 - 1e-9) & (x > -1.0) & (y > -1.0) & (x < cells) & (y < cells)
    row = np.nonzero(used)[0]
    x, y, patch = x[used], y[used], patch[used]
    each = [shine[:, kind][used] for kind in range(kinds)]
    j, i = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = x - j, y - i
    wide = cells + 2
    place = (row * wide + i + 1) * wide + j + 1
    light, area = np.zeros((kinds, n * wide * wide)), np.zeros(n * wide * wide)
    for step, weight in ((0, (1 - u) * (1 - v)), (1, u * (1 - v)), (wide, (1 - u) * v), (wide + 1, u * v)):
        share = weight * patch
        area += np.bincount(place + step, share, len(area))
        for kind, values in enumerate(each):
            light[kind] += np.bincount(place + step, share * values, len(area))
    inner = (slice(None), slice(1, -1), slice(1, -1))
    planes = [kind.reshape(n, wide, wide)[inner] for kind in light]
    return np.stack(planes, axis=1), area.reshape(n, wide, wide)[inner]


def _linear_rows(m: int, finer: int) -> FloatArray:
    """Return what interpolates m samples linearly to finer ones, (finer (m - 1) + 1, m)."""
    place = np.arange(finer * (m - 1) + 1) / finer
    left = np.minimum(np.floor(place).astype(np.int64), m - 2)
    out = np.zeros((len(place), m))
    rows = np.arange(len(place))
    out[rows, left], out[rows, left + 1] = 1.0 - (place - left), place - left
    return out


def _through_psf(cells: FloatArray, psf: Psf, middle: FloatArray) -> FloatArray:
    """Return means of pixels that begin at each cell (n, k, cells, cells), seen through the PSF at places (n, 2) px."""
    out = np.empty_like(cells)
    kernels: dict[int, FloatArray] = {}
    for row, place in enumerate(middle):
        here = psf.at(place)
        if id(here) not in kernels:
            kernels = {id(here): _pixel_kernel(here)}
        kernel = kernels[id(here)]
        good = [fft.next_fast_len(n + len(kernel), real=True) for n in cells.shape[2:]]
        full = fft.irfft2(fft.rfft2(cells[row], good) * fft.rfft2(kernel, good), good)
        begin = (len(kernel) - CELLS + 1) // 2 + CELLS - 1
        out[row] = full[:, begin : begin + cells.shape[2], begin : begin + cells.shape[3]]
    return out


def _pixel_kernel(psf: Psf) -> FloatArray:
    """Return the PSF's kernel in cells, summed over a pixel that begins at the cell."""
    kernel = psf.kernel(CELLS)
    padded = np.pad(kernel, CELLS - 1)
    summed = sum(
        padded[i : len(padded) - CELLS + 1 + i, j : len(padded) - CELLS + 1 + j]
        for i in range(CELLS)
        for j in range(CELLS)
    )
    return np.asarray(summed) / CELLS**2
