"""Sub-pixel limb points: the rendered limb fitted to the pixels of each piece of it, and which of the pieces count.

Flow   outline -> pieces of equal length, each with its pixels -> height, background and shift along the normal -> pieces
       off the detector, unlit, behind other bodies, saturated, faint or unlike the rest left out, each with its reason
Frame  (pixel, line); shift, depth and offset are positive outward
Units  px, DN

The edge model is the body itself, rendered with its scattering law and the camera's PSF: limb darkening, the curvature of
the limb and the width of a crescent are in it, so that nothing is left to bias the edge. In each piece its height and
the background are free, and local albedo does not matter. Every pixel belongs to one piece, so the errors of the points
are independent.

    data = a M(x - s n) + b        M rendered, n the outward normal, s the shift

With the shifts comes their response to a motion of the whole body (and to a change of its range), taken from the same
pixels: what a piece of limb really measures, also where it is as short as the PSF is wide.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.silhouette import TURN, Outline, Silhouette
from opnav_workbench.errors import CenterfindingError

__all__ = [
    "EdgeFit",
    "LimbPieces",
    "LimbSelection",
    "fit_edges",
    "limb_pieces",
    "limb_reach_px",
    "missing_share",
    "select_limb",
]


# ---- A limb divided into pieces of equal length, and the pixels about each.

PIECE_PX = 2.0  # as long as the PSF is wide: shorter pieces do not tell more
LEAST_PIECES, MOST_PIECES = 8, 360
PSF_REACH, RIM_PX = 3.0, 1.5  # sigmas of the PSF, and pixels beyond, to both sides of the limb


@dataclass(frozen=True, slots=True, eq=False)
class LimbPieces:
    """Pieces of limb of equal length, and the pixels about them.

    Attributes
    ----------
    angle_rad : (n,) array
        Of their middles about the center.
    point_px : (n, 2) array
        Middles on the predicted limb.
    normal : (n, 2) array
        Outward unit vectors.
    pixel, line : (m,) arrays of int
        Pixels of the picture near the limb.
    piece : (m,) array of int
        The piece that each belongs to.
    depth_px : (m,) array
        Distance from the limb, positive outward.
    complete : (n,) array of bool
        Whether the piece lies on the detector with all its pixels.
    """

    angle_rad: FloatArray
    point_px: FloatArray
    normal: FloatArray
    length_px: float
    pixel: IntArray
    line: IntArray
    piece: IntArray
    depth_px: FloatArray
    complete: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)


def limb_reach_px(picture: BodyPicture) -> float:
    """Return how far to both sides of the limb its light tells where it is, px."""
    return PSF_REACH * float(np.max(picture.psf.sigma_px)) + RIM_PX


def limb_pieces(
    outline: Outline, shape: tuple[int, ...], reach: float, offset_px: FloatArray | None = None
) -> LimbPieces:
    """Divide a limb into pieces, and the pixels within `reach` px of it among them.

    Parameters
    ----------
    shape : (int, int)
        Lines and pixels of the picture.
    offset_px : (n,) array, optional
        Where the limb of each piece really is, along its normal, if that is known; the pixels about it are taken.
    """
    stretch = np.hypot(outline.radius_px, outline.slope_px)
    travelled = np.concatenate([[0.0], np.cumsum(stretch) * TURN / len(stretch)])
    total = float(travelled[-1])
    n = int(np.clip(round(total / PIECE_PX), LEAST_PIECES, MOST_PIECES))
    grid = np.append(outline.angle_rad, np.pi)
    angle = np.interp((np.arange(n) + 0.5) * total / n, travelled, grid)
    offset = np.zeros(n) if offset_px is None else offset_px
    pixel, line = _pixels_near(outline, shape, reach + float(np.abs(offset).max()))
    away = np.stack([pixel, line], axis=-1) - outline.center_px
    at, radius = np.arctan2(away[:, 1], away[:, 0]), np.hypot(away[:, 0], away[:, 1])
    own = outline.radius(at)
    lean = own / np.interp(at, outline.angle_rad, stretch, period=TURN)
    depth = (radius - own) * lean
    piece = np.minimum((np.interp(at, grid, travelled) * n / total).astype(np.int64), n - 1)
    near = np.abs(depth - offset[piece]) <= reach
    point = outline.points(angle)
    normal = _normals(outline, angle)
    seen, size = point + offset[:, None] * normal, np.array(shape[::-1])
    whole = np.all((seen >= reach - 0.5) & (seen <= size - 0.5 - reach), axis=1)
    return LimbPieces(
        angle, point, normal, total / n,
        pixel[near], line[near], piece[near], depth[near], whole,
    )  # fmt: skip


def _pixels_near(outline: Outline, shape: tuple[int, ...], reach: float) -> tuple[IntArray, IntArray]:
    """Return (pixel, line) of the pixels in the rectangle around the limb."""
    low, high = outline.center_px - outline.reach_px[:2], outline.center_px + outline.reach_px[2:]
    first = np.clip(np.floor(low - reach), 0, None).astype(int)
    last = np.clip(np.ceil(high + reach), None, np.array(shape[::-1]) - 1).astype(int)
    last = np.maximum(last, first - 1)  # none of it on the detector
    line, pixel = np.mgrid[first[1] : last[1] + 1, first[0] : last[0] + 1]
    return pixel.ravel(), line.ravel()


def _normals(outline: Outline, angle: FloatArray) -> FloatArray:
    radius = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=TURN)
    cos, sin = np.cos(angle), np.sin(angle)
    normal = np.stack([slope * sin + radius * cos, radius * sin - slope * cos], axis=-1)
    return np.asarray(normal / np.hypot(radius, slope)[:, None])


# ---- Sub-pixel limb points: the rendered picture of the limb fitted to the pixels of each piece of it.

SHIFT_STEPS = 8
LARGEST_STEP_PX = 1.0
DONE_PX, DONE_SIGMAS = 1e-4, 0.02
HOPELESS_PX = 1.0  # pieces whose limb cannot be placed better are not waited for
LEAST_PIXELS = 6  # three parameters, and as many residuals
SINGULAR = 1e-9  # of the product of the diagonal: height and shift cannot be told apart


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFit:
    """What the pixels of n pieces of limb say.

    Attributes
    ----------
    shift_px, sigma_px : (n,) arrays
        Limb observed minus predicted, along the normal, and its noise; nan without usable pixels.
    height, height_sigma : (n,) arrays
        Data over model.
    background_dn : (n,) array
    chi2_reduced : (n,) array
    response : (n, 3) array
        Change of the shift with the center's pixel and line, and with the logarithm of the range (px).
    n_used, n_saturated, n_bad : (n,) arrays of int
        Pixels.
    peak : (n,) array
        Brightest model pixel of the piece.
    """

    shift_px: FloatArray
    sigma_px: FloatArray
    height: FloatArray
    height_sigma: FloatArray
    background_dn: FloatArray
    chi2_reduced: FloatArray
    response: FloatArray
    n_used: IntArray
    n_saturated: IntArray
    n_bad: IntArray
    peak: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def fit_edges(
    picture: BodyPicture,
    pieces: LimbPieces,
    model_dn: FloatArray,
    window: tuple[int, int, int, int],
    center_px: FloatArray,
    start_px: FloatArray,
) -> EdgeFit:
    """Fit the model's limb to the pixels of each piece.

    Parameters
    ----------
    model_dn : (n_line, n_pixel) array
        The body rendered at its predicted place, over `window`.
    window : (int, int, int, int)
        First pixel, first line, pixels, lines; it holds all pixels of the pieces.
    center_px : (2,) array
        Center of the model, from which a change of range stretches it.
    start_px : (n,) array
        Shifts to start from.
    """
    fit = _EdgeEquations(picture, pieces, model_dn, window)
    shift = np.array(start_px, dtype=np.float64)
    for _ in range(SHIFT_STEPS):
        solution, covariance, _ = fit.solve(shift)
        step = np.clip(np.nan_to_num(solution[:, 2]), -LARGEST_STEP_PX, LARGEST_STEP_PX)
        shift = shift + step
        sigma = np.sqrt(covariance[:, 2, 2])
        going = np.abs(step) > np.maximum(DONE_PX, DONE_SIGMAS * sigma)
        if not np.any(going & (sigma < HOPELESS_PX)):
            break
    return fit.result(shift, np.asarray(center_px, dtype=np.float64))


class _EdgeEquations:
    """Normal equations of all pieces at once."""

    def __init__(
        self,
        picture: BodyPicture,
        pieces: LimbPieces,
        model_dn: FloatArray,
        window: tuple[int, int, int, int],
    ) -> None:
        self.pieces, self.n = pieces, len(pieces)
        where = (pieces.line, pieces.pixel)
        signal = picture.signal_dn[where]
        self.saturated = picture.saturated[where]
        self.bad = (picture.bad[where] | ~np.isfinite(signal)) & ~self.saturated
        self.good = ~(self.saturated | self.bad)
        self.data = np.where(self.good, signal, 0.0)
        self.background_variance = picture.noise_dn[where] ** 2
        self.gain = picture.shot_gain_e_per_dn
        self.spline = spline_filter(model_dn, order=3, mode="nearest")
        # The derivatives of the spline at its nodes.
        self.slopes = [
            0.5 * (np.roll(self.spline, -1, axis) - np.roll(self.spline, 1, axis)) for axis in (1, 0)
        ]
        self.place = np.stack([pieces.line - window[1], pieces.pixel - window[0]]).astype(np.float64)
        self.peak = np.zeros(self.n)
        np.maximum.at(self.peak, pieces.piece, model_dn[tuple(self.place.astype(int))])
        self.variance = self.background_variance
        self.height = self._first_height(model_dn)

    def _first_height(self, model_dn: FloatArray) -> FloatArray:
        model = model_dn[tuple(self.place.astype(int))][self.good]
        square = float(model @ model)
        height = float(model @ self.data[self.good]) / square if square > 0.0 else 0.0
        return np.full(self.n, max(height, 0.0))

    def sums(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.pieces.piece, values, minlength=self.n), dtype=np.float64)

    def _model(self, shift: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        piece, normal = self.pieces.piece, self.pieces.normal
        moved = self.place - (shift[:, None] * normal)[piece][:, ::-1].T
        value = map_coordinates(self.spline, moved, order=3, mode="nearest", prefilter=False)
        along, down = (map_coordinates(slope, moved, order=1, mode="nearest") for slope in self.slopes)
        return value, along, down

    def solve(self, shift: FloatArray) -> tuple[FloatArray, FloatArray, tuple[FloatArray, ...]]:
        """Return height, background and step (n, 3), their covariances (n, 3, 3), and the model's pixels."""
        piece, normal = self.pieces.piece, self.pieces.normal
        value, along, down = self._model(shift)
        # Shot noise of the model, not of the data: weights that follow the noise would bias the fit.
        self.variance = self.background_variance + np.maximum(self.height[piece] * value, 0.0) / self.gain
        outward = normal[piece, 0] * along + normal[piece, 1] * down
        columns = (value, np.ones_like(value), -self.height[piece] * outward)
        weight = self.good / self.variance
        matrix = np.empty((self.n, 3, 3))
        for i in range(3):
            for j in range(i + 1):
                matrix[:, i, j] = matrix[:, j, i] = self.sums(weight * columns[i] * columns[j])
        inverse = _inverses(matrix)
        right = np.stack([self.sums(weight * column * self.data) for column in columns], axis=-1)
        solution = np.einsum("nij,nj->ni", inverse, right)
        usable = solution[:, 0] > 0.0
        self.height = np.where(usable, solution[:, 0], self.height)
        return solution, inverse, (value, along, down, weight, *columns)

    def result(self, shift: FloatArray, center: FloatArray) -> EdgeFit:
        solution, inverse, (value, along, down, weight, *columns) = self.solve(shift)
        piece = self.pieces.piece
        n_used = np.bincount(piece, self.good, minlength=self.n).astype(np.int64)
        model = solution[piece, 0] * value + solution[piece, 1] + solution[piece, 2] * columns[2]
        misfit = self.sums(weight * (self.data - model) ** 2)
        away = np.stack([self.pieces.pixel, self.pieces.line], axis=-1) - center
        motions = (-along, -down, away[:, 0] * along + away[:, 1] * down)
        height = self.height[piece]
        response = np.stack(
            [
                sum(inverse[:, 2, k] * self.sums(weight * columns[k] * height * motion) for k in range(3))
                for motion in motions
            ],
            axis=-1,
        )
        enough = (n_used >= LEAST_PIXELS) & np.isfinite(inverse[:, 2, 2])
        return EdgeFit(
            shift_px=np.where(enough, shift + solution[:, 2], np.nan),
            sigma_px=np.where(enough, np.sqrt(inverse[:, 2, 2]), np.nan),
            height=solution[:, 0],
            height_sigma=np.sqrt(inverse[:, 0, 0]),
            background_dn=solution[:, 1],
            chi2_reduced=misfit / np.maximum(n_used - 3, 1),
            response=response,
            n_used=n_used,
            n_saturated=np.bincount(piece, self.saturated, minlength=self.n).astype(np.int64),
            n_bad=np.bincount(piece, self.bad, minlength=self.n).astype(np.int64),
            peak=self.peak,
        )


def _inverses(matrix: FloatArray) -> FloatArray:
    """Return the inverses of normal matrices (n, 3, 3); nan where they are singular."""
    scale = np.sqrt(np.einsum("nii->ni", matrix))
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = matrix / (scale[:, :, None] * scale[:, None, :])
    singular = ~(np.linalg.det(unit) > SINGULAR)
    unit[singular] = np.eye(3)
    inverse = np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None, :])
    inverse[singular] = np.nan
    return np.asarray(inverse)


# ---- Which pieces of limb count, and why the others do not.

LIT_SHARE = 0.2  # of the brightest piece: darker ones lie at the terminator, where relief makes the edge
LEAST_HEIGHT_SNR = 5.0
LEAST_HEIGHT = 0.15  # of the median: no surface has a tenth of its own albedo all along a piece of limb
LARGEST_SIGMA_PX = 0.5
SKY_SHARE = 0.5  # of the limb's brightness: what is brighter outside is no sky, however wide the halo of a fouled lens
CHI2_RATIO = 6.0  # over that of the other pieces, or over 1
NO_LIMB_SEEN, FAINTER = "nothing like a limb stands out there", "far fainter than the rest of the limb"

MarkPieces = Callable[[BoolArray, str, str | list[str]], None]


@dataclass(frozen=True, slots=True, eq=False)
class LimbSelection:
    """Status (n,) and reason (n,) of pieces of limb, see `LimbEllipse`, and what befell them."""

    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    usable: BoolArray
    hidden: BoolArray
    saturated: BoolArray
    missing: BoolArray  # lit limb in the model, none in the picture

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def with_outliers(
        self, used: BoolArray, residual_px: FloatArray, sigma_px: FloatArray
    ) -> "LimbSelection":
        """Return the selection with those usable pieces rejected that the fit left out."""
        status, reason = self.status.copy(), self.reason.copy()
        for row in np.flatnonzero(self.usable & ~used):
            status[row] = "rejected"
            many = residual_px[row] / sigma_px[row]
            reason[row] = (
                f"it lies {residual_px[row]:+.2f} px from the limb of the others ({many:+.0f} sigma)"
            )
        return replace(self, status=status, reason=reason, usable=self.usable & used)


def select_limb(
    picture: BodyPicture, silhouette: Silhouette, pieces: LimbPieces, edges: EdgeFit, reach: float
) -> LimbSelection:
    """Judge pieces of limb by what their pixels say."""
    n = len(pieces)
    status = np.full(n, "used", dtype="<U10")
    reason = np.full(n, "", dtype="<U96")
    hidden, by = _occulted_pieces(picture, silhouette.name, pieces, reach)
    lit = edges.peak >= LIT_SHARE * max(float(edges.peak.max()), np.finfo(float).tiny)

    def mark(which: BoolArray, selection: str, why: str | list[str]) -> None:
        rows = np.flatnonzero(which & (status == "used"))
        status[rows] = selection
        reason[rows] = why if isinstance(why, str) else [why[row] for row in rows]

    mark(~pieces.complete, "not_chosen", "off the detector")
    mark(~lit, "not_chosen", "no light there: beyond the terminator")
    mark(hidden, "rejected", by)
    mark(edges.n_saturated > 0, "rejected", "saturated")
    mark(~np.isfinite(edges.sigma_px), "rejected", "too few good pixels")
    with np.errstate(invalid="ignore", divide="ignore"):
        snr = edges.height / edges.height_sigma
        mark(~(snr >= LEAST_HEIGHT_SNR), "rejected", NO_LIMB_SEEN)
        mark(~(edges.sigma_px <= LARGEST_SIGMA_PX), "rejected", "too faint to place the limb")
    _mark_outlying(edges, status, mark)
    seen = lit & pieces.complete
    missing = seen & ((reason == NO_LIMB_SEEN) | (reason == FAINTER))
    return LimbSelection(
        status, reason, status == "used", hidden & lit, (edges.n_saturated > 0) & seen, missing
    )


def _mark_outlying(edges: EdgeFit, status: NDArray[np.str_], mark: MarkPieces) -> None:
    """Reject pieces that are unlike the rest."""
    left = status == "used"
    if not left.any():
        return
    typical = float(np.median(edges.height[left]))
    mark(edges.height < LEAST_HEIGHT * typical, "rejected", FAINTER)
    bright = edges.background_dn > SKY_SHARE * edges.height * edges.peak
    mark(bright, "rejected", "bright outside: not the limb, or something beside it")
    usual = max(float(np.median(edges.chi2_reduced[left])), 1.0)
    why = [f"its light is not that of a limb (chi-squared {c:.1f})" for c in edges.chi2_reduced]
    mark(edges.chi2_reduced > CHI2_RATIO * usual, "rejected", why)


def _occulted_pieces(
    picture: BodyPicture, name: str, pieces: LimbPieces, reach: float
) -> tuple[BoolArray, list[str]]:
    """Tell which points of limb lie behind or beside another body, and whose."""
    hidden, by = np.zeros(len(pieces), dtype=bool), [""] * len(pieces)
    for model in picture.models:
        other = model.target.name
        if other == name or model.is_point:
            continue
        try:
            outline = Silhouette(picture, other).at(picture.center_px(other))
        except CenterfindingError:
            continue  # it is not before the camera
        away = pieces.point_px - outline.center_px
        near = np.hypot(*away.T) <= outline.radius(np.arctan2(away[:, 1], away[:, 0])) + reach
        for row in np.flatnonzero(near & ~hidden):
            by[row] = f"{other} stands there"
        hidden |= near
    return hidden, by


def missing_share(selection: LimbSelection) -> float:
    """Return the share of the model's lit limb, as far as it lies on the detector, that the picture does not show."""
    return float(selection.missing.sum() / max(int((selection.missing | selection.usable).sum()), 1))
