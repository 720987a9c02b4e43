"""Where the limb is, roughly: brightness along its normals compared with the rendered limb, and the outline moved there.

Flow   outline -> brightness along normals -> lag with the most of the model's rise in it -> motion of the outline
Frame  (pixel, line); lags are positive outward
Units  px, DN

A limb point is where the picture rises from the dark of the sky as the rendered limb does. What a crater, a star or a cosmic
ray offers instead is left to the fit of the outline, whose weights fall off with the residual (Cauchy) as the width
that counts as near is narrowed.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodycenters.limb_points_pieces import LimbPieces
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.silhouette import Outline

__all__ = ["LimbLags", "Template", "limb_lags", "limb_template", "outline_motion", "stretched"]

STEP_PX = 0.5
MIN_RISE = 0.05  # of the model's highest rise: less is unlit limb
SIGNIFICANT_SIGMAS = 5.0
SKY_SHARE = 0.4  # of the rise: brighter is no sky, nor the halo of a fouled lens
NARROWINGS = 7  # times that the width which counts as near is halved
NEAREST_PX = 0.5
FEWEST_LAGS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """The rendered brightness across each piece of limb: (n, k) at `STEP_PX` from inside to outside."""

    model_dn: FloatArray
    lit: BoolArray  # (n,)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def at(self, own_angle_rad: FloatArray, angle_rad: FloatArray) -> "Template":
        """Return the template for pieces at other angles (m,): of each the nearest of its own."""
        apart = np.abs(np.angle(np.exp(1j * (angle_rad[:, None] - own_angle_rad[None, :]))))
        nearest = np.argmin(apart, axis=1)
        return Template(self.model_dn[nearest], self.lit[nearest])


@dataclass(frozen=True, slots=True, eq=False)
class LimbLags:
    """Where each of n normals crosses the limb; nan where nothing like it was found."""

    lag_px: FloatArray
    rise: FloatArray  # data over model

    def __post_init__(self) -> None:
        freeze_arrays(self)


def limb_template(
    pieces: LimbPieces, model_dn: FloatArray, window: tuple[int, int, int, int], reach: float
) -> Template:
    """Sample a rendered body across its limb."""
    k = int(np.ceil(reach / STEP_PX))
    profile = _sampled(model_dn, pieces, STEP_PX * np.arange(-k, k + 1, dtype=np.float64), window)
    rise = np.nan_to_num(np.ptp(profile, axis=1))  # nan: off the detector
    return Template(profile, rise > MIN_RISE * max(float(rise.max()), np.finfo(float).tiny))


def limb_lags(picture: BodyPicture, pieces: LimbPieces, template: Template, search_px: float) -> LimbLags:
    """Look for the limb within `search_px` of where the pieces expect it.

    Parameters
    ----------
    picture : BodyPicture
    pieces : LimbPieces
    template : Template
        Of the same pieces; its lit ones are looked for.
    search_px : float
    """
    k = template.model_dn.shape[1] // 2
    m = int(np.ceil(search_px / STEP_PX))
    rows = np.flatnonzero(template.lit)
    lag, rise = np.full(len(pieces), np.nan), np.full(len(pieces), np.nan)
    if len(rows) == 0:
        return LimbLags(lag, rise)
    unusable = picture.bad | ~np.isfinite(picture.signal_dn)
    at = STEP_PX * np.arange(-m - k, m + k + 1, dtype=np.float64)
    size = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    signal = _sampled(np.where(unusable, 0.0, picture.signal_dn), pieces, at, size, rows)
    if unusable.any():
        signal[_sampled(unusable.astype(float), pieces, at, size, rows) > 0.0] = np.nan
    noise = _sampled(np.asarray(picture.noise_dn), pieces, np.zeros(1), size, rows)[:, 0]
    windows = np.lib.stride_tricks.sliding_window_view(signal, 2 * k + 1, axis=1)
    explained, height, outside = _regression(windows, template.model_dn[rows])
    rise_dn = np.ptp(template.model_dn[rows], axis=1)[:, None] * height
    seen = (height > 0.0) & (explained > SIGNIFICANT_SIGMAS**2 * (STEP_PX**-1.0) * noise[:, None] ** 2)
    seen &= outside < SKY_SHARE * rise_dn + SIGNIFICANT_SIGMAS * noise[:, None]
    score = np.where(seen, explained, -np.inf)
    best = np.argmax(score, axis=1)
    found = np.isfinite(score[np.arange(len(rows)), best])
    chosen = rows[found]
    lag[chosen] = (best[found] - m) * STEP_PX + _between(score, best)[found] * STEP_PX
    rise[chosen] = height[np.arange(len(rows)), best][found]
    return LimbLags(lag, rise)


def _sampled(
    values: FloatArray,
    pieces: LimbPieces,
    at_px: FloatArray,
    window: tuple[int, int, int, int],
    rows: IntArray | None = None,
) -> FloatArray:
    """Return values (n, k) along the normals; nan off the window."""
    point, normal = pieces.point_px, pieces.normal
    if rows is not None:
        point, normal = point[rows], normal[rows]
    places = point[:, None, :] + at_px[None, :, None] * normal[:, None, :] - np.array(window[:2])
    return np.asarray(
        map_coordinates(values, [places[..., 1], places[..., 0]], order=1, mode="constant", cval=np.nan)
    )


def _regression(windows: FloatArray, model: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the model explains, its height, and the data's level outside, each (n, lags)."""
    centered = model - np.nanmean(model, axis=1, keepdims=True)
    centered = np.nan_to_num(centered)
    square = np.einsum("nk,nk->n", centered, centered)[:, None]
    with np.errstate(invalid="ignore"):
        product = np.einsum("nlk,nk->nl", windows, centered)
        height = product / square
        outer = windows[..., -(model.shape[1] // 4 + 1) :].mean(axis=-1)
    lost = ~np.isfinite(product)
    return (
        np.where(lost, -np.inf, product * np.where(lost, 0.0, height)),
        np.where(lost, 0.0, height),
        np.where(lost, np.inf, outer),
    )


def _between(score: FloatArray, best: IntArray) -> FloatArray:
    """Return the vertex of the parabola through each best score and its neighbours, in steps, within +-0.5."""
    rows, last = np.arange(len(score)), score.shape[1] - 1
    left, right = (
        score[rows, np.maximum(best - 1, 0)],
        score[rows, np.minimum(best + 1, last)],
    )
    middle = score[rows, best]
    with np.errstate(invalid="ignore"):
        bend = left - 2.0 * middle + right
        vertex = 0.5 * (left - right) / bend
    return np.where(np.isfinite(vertex) & (bend < 0.0), np.clip(vertex, -0.5, 0.5), 0.0)


def stretched(pieces: LimbPieces, center_px: FloatArray) -> FloatArray:
    """Return the shift of n limb points with the center's pixel and line and with the logarithm of the range, (n, 3)."""
    away = np.einsum("ij,ij->i", pieces.normal, pieces.point_px - center_px)
    return np.column_stack([pieces.normal, -away])


def outline_motion(
    lags: LimbLags, pieces: LimbPieces, outline: Outline, search_px: float, *, solve_range: bool
) -> tuple[FloatArray, BoolArray]:
    """Return the motion (3,) of center (px) and log range that brings the outline to the lags, and which follow it.

    The motion is nan where too few lags were found.
    """
    found = np.isfinite(lags.lag_px)
    design = stretched(pieces, outline.center_px)[found]
    lag = lags.lag_px[found]
    columns = 3 if solve_range else 2
    motion = np.zeros(3)
    if len(lag) < FEWEST_LAGS:
        return np.full(3, np.nan), np.zeros(len(pieces), dtype=bool)
    width = search_px
    for _ in range(NARROWINGS):
        for _ in range(2):
            residual = lag - design @ motion
            weight = 1.0 / (1.0 + (residual / width) ** 2)
            root = np.sqrt(weight)[:, None]
            motion[:columns] = np.linalg.lstsq(root * design[:, :columns], root[:, 0] * lag, rcond=None)[0]
        width = max(0.5 * width, NEAREST_PX)
    follow = np.zeros(len(pieces), dtype=bool)
    follow[found] = np.abs(lag - design @ motion) <= max(4.0 * NEAREST_PX, 0.03 * outline.diameter_px)
    return motion, follow
