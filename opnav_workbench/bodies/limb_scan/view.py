"""What scans show: data, and the light of the fitted disk with its derivatives, on the same points.

Flow   shape of the disk -> pixels about its outline, with the columns of the likelihood -> data and light sampled along the
       scans
Units  DN; derivatives per px, per unit of each share
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.disk.columns import (
    ALBEDO,
    CENTER,
    FIGURE,
    SHADED,
    SHADING,
    SHARED,
    SHARES,
    STRAY,
    DiskShape,
    Unknown,
    columns_dn,
    disk_columns,
)
from opnav_workbench.bodies.disk.limb_cells import depth_edges, limb_pixels, piece_angles
from opnav_workbench.bodies.disk.measurement import MeasuredDisk
from opnav_workbench.bodies.limb_scan.fan import ScanFan, ScanSampler, lay_fan
from opnav_workbench.bodies.silhouette import TURN, Outline

__all__ = ["COMMON", "LAG_PX", "LOOK", "OUTLINE", "ScanView", "piece_shares", "view_scans"]

OUTLINE = [*CENTER, *FIGURE]  # what moves the limb, and what changes the look of all scans:
LOOK = [Unknown.BRIGHTNESS, *SHARES, *SHADING, Unknown.BLUR, *STRAY]
COMMON = [*OUTLINE, *LOOK]
MARGIN_PX = 3.0  # of pixels beyond the samples: what the interpolation needs
LAG_PX = 5.0  # to each side: what an analyst looks at


@dataclass(frozen=True, slots=True, eq=False)
class ScanView:
    """n scans with w samples each.

    Attributes
    ----------
    outline
        About which the scans were laid.
    window : (int, int, int, int)
        Pixels that the scans rest on.
    data, model : (n, w) arrays
        The model's albedo is that of the disk as a whole, and it has no background.
    limb : (n, w) array
        Change of the model per px that the limb lies farther out.
    common : (n, w, p) array
        Change with each of `COMMON`.
    parts : (n, w, k) array
        Light of an albedo that is concentrated at each of k arcs from the limb.
    variance : (n, w) array
        Of noise.
    cell : (n, w) array of int
        Depth in steps over which the albedo's grain is one.
    blocked : (n, w) array of bool
    data_plane, model_plane, variance_plane, use : (n_line, n_pixel) arrays
        Of the window; the model is 0 away from the limb.
    """

    outline: Outline
    fan: ScanFan
    sampler: ScanSampler
    window: tuple[int, int, int, int]
    data: FloatArray
    model: FloatArray
    limb: FloatArray
    common: FloatArray
    parts: FloatArray
    variance: FloatArray
    cell: IntArray
    blocked: BoolArray
    data_plane: FloatArray
    model_plane: FloatArray
    variance_plane: FloatArray
    use: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def piece_shares(angle_rad: FloatArray, pieces: int) -> FloatArray:
    """Return the shares (n, j) that pieces of limb have in what is interpolated at angles (n,)."""
    place = np.mod(angle_rad - piece_angles(pieces)[0], TURN) * (pieces / TURN)
    below = np.floor(place).astype(np.int64)
    out, rows = np.zeros((len(angle_rad), pieces)), np.arange(len(angle_rad))
    out[rows, below % pieces] = 1.0 - (place - below)
    out[rows, (below + 1) % pieces] += place - below
    return out


def view_scans(disk: MeasuredDisk, shape: DiskShape, n_scans: int) -> ScanView:
    """Lay scans about a shape that is near the fitted one, and sample data and light along them."""
    fit, pixels = disk.fit, disk.pixels
    outline = fit.made.outline(shape, rough=False)
    fan = lay_fan(outline, n_scans, fit.reach_px)
    window = _window(disk, outline, fit.reach_px[1] + LAG_PX + MARGIN_PX)
    pixel, line, n_pixel, n_line = window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    places, columns = _strip_columns(disk, shape)
    sampler = ScanSampler(fan.places(fan.distances()), window)

    def plane(values: FloatArray) -> FloatArray:
        out = np.zeros((n_line, n_pixel))
        out[places[0] - line, places[1] - pixel] = values
        return out

    model_plane = plane(columns[0])
    sampled = [sampler.sample(plane(column)) for column in columns]
    variance = pixels.variance_dn2(model_plane, part)
    edges = depth_edges(*fit.reach_px, float(np.max(disk.picture.psf.sigma_px)))
    return ScanView(
        outline=outline,
        fan=fan,
        sampler=sampler,
        window=window,
        data=sampler.sample(pixels.data_dn[part]),
        model=sampled[0],
        limb=sampled[1],
        common=np.stack(sampled[2 : 2 + len(COMMON)], axis=-1),
        parts=np.stack(sampled[2 + len(COMMON) :], axis=-1),
        variance=np.maximum(sampler.sample(variance), 0.5 * float(np.median(variance))),
        cell=np.searchsorted(edges, fan.depth_px),
        blocked=sampler.blocked(pixels.use[part]),
        data_plane=pixels.data_dn[part],
        model_plane=model_plane,
        variance_plane=variance,
        use=pixels.use[part],
    )


def _window(disk: MeasuredDisk, outline: Outline, outward_px: float) -> tuple[int, int, int, int]:
    size = np.array([disk.picture.camera.n_pixel, disk.picture.camera.n_line])
    reach, center = outline.reach_px + outward_px, outline.center_px
    first = np.clip(np.floor(center - reach[:2]), 0, size - 1).astype(int)
    last = np.clip(np.ceil(center + reach[2:]), first, size - 1).astype(int)
    return int(first[0]), int(first[1]), int(last[0] - first[0] + 1), int(last[1] - first[1] + 1)


def _strip_columns(disk: MeasuredDisk, shape: DiskShape) -> tuple[tuple[IntArray, IntArray], FloatArray]:
    """Return line and pixel (m,) of the strip; light, its changes with limb and `COMMON`, its parts (2 + p + k, m)."""
    fit = disk.fit
    outline = fit.made.outline(shape, rough=False)
    near = limb_pixels(outline, disk.pixels.use.shape, *(reach + MARGIN_PX for reach in fit.reach_px))
    columns = disk_columns(fit.made, shape, outline, near, on_slopes=fit.prior.on_slopes)
    here = replace(fit, pixels=near, columns=columns)
    light, dn = here.even_dn(), columns_dn(columns, fit.brightness_dn, here.lit_dn)
    dn[FIGURE[1:]] += dn[SHADED]
    return near.index, np.concatenate([light[None], dn[SHARED][None], dn[COMMON], dn[ALBEDO]])
