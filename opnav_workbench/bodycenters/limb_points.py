"""Sub-pixel limb points: the rendered picture of the limb fitted to the pixels of each piece of it.

Flow   outline -> pieces of limb, each with its pixels -> height, background and shift along the normal -> points
Frame  (pixel, line); a shift is positive outward
Units  px, DN

The edge model is the body itself, rendered with its scattering law and the camera's PSF: limb darkening, the curvature of
the limb and the width of a crescent are in it, so that nothing is left to bias the edge. In each piece its height and
the background are free, and local albedo does not matter. Every pixel belongs to one piece, so the errors of the points
are independent.

    data = a M(x - s n) + b        M rendered, n the outward normal, s the shift

With the shifts comes their response to a motion of the whole body (and to a change of its range), taken from the same
pixels: what a piece of limb really measures, also where it is as short as the PSF is wide.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodycenters.limb_points_pieces import LimbPieces
from opnav_workbench.bodycenters.picture import BodyPicture

__all__ = ["EdgeFit", "fit_edges"]

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
    picture : BodyPicture
    pieces : LimbPieces
    model_dn : (n_line, n_pixel) array
        The body rendered at its predicted place, over `window`.
    window : (int, int, int, int)
        First pixel, first line, pixels, lines; it holds all pixels of the pieces.
    center_px : (2,) array
        Center of the model, from which a change of range stretches it.
    start_px : (n,) array
        Shifts to start from.
    """
    fit = _Fit(picture, pieces, model_dn, window)
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


class _Fit:
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
        self.gain = np.inf if picture.noise_model is None else picture.gain_e_per_dn
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
