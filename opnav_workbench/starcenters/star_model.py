"""The model that is fitted: one star or several neighbors on a level or a plane, in many boxes.

The parameters of a box are flux, pixel and line of each of its k stars, the shape that they share, and the
background: 3 k + n_shape + 1 or 3 columns. For a single Gaussian star the columns are FLUX, PIXEL, LINE, SCALE,
E1, E2, LEVEL, SLOPE_PIXEL, SLOPE_LINE.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.starcenters.boxes import Boxes
from opnav_workbench.starcenters.levenberg import Evaluation
from opnav_workbench.starcenters.profiles import Profile
from opnav_workbench.starcenters.results import NoiseModel

__all__ = ["E1", "E2", "FLUX", "LEVEL", "LINE", "PIXEL", "SCALE", "SLOPE_LINE", "SLOPE_PIXEL", "StarModel"]

FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL, SLOPE_PIXEL, SLOPE_LINE = range(9)
PER_STAR = 3  # flux, pixel, line
RIDGE = 1e-12  # of the linear start: two stars in one pixel share its light


@dataclass(frozen=True, slots=True, eq=False)
class StarModel:
    """Stars plus background in every box; called by the solver with the boxes it still works on."""

    profile: Profile
    members: int  # stars in each box
    first: FloatArray  # (g, 2)
    data: FloatArray  # (g, m)
    variance: FloatArray  # (g, m) infinite where unusable
    basis: FloatArray  # (b, m) level, and slopes about the middle of the box
    size: int
    gain: float  # e/DN, infinite without shot noise

    @classmethod
    def of(
        cls, boxes: Boxes, noise: NoiseModel | None, profile: Profile, background: str, members: int = 1
    ) -> "StarModel":
        """Return the model of the given boxes with `members` stars each on a "level" or a "plane"."""
        n, size = len(boxes.first), boxes.size
        line, pixel = np.indices((size, size), dtype=float).reshape(2, -1) - (size - 1) / 2
        basis = np.stack([np.ones(size * size), pixel, line])[: 1 if background == "level" else 3]
        gain = np.inf if noise is None else noise.gain_e_per_dn
        data, variance = (a.reshape(n, size * size) for a in (boxes.data_dn, boxes.variance_dn2))
        return cls(profile, members, boxes.first.astype(float), data, variance, basis, size, gain)

    @property
    def flux_columns(self) -> slice:
        """Columns of the fluxes."""
        return slice(FLUX, PER_STAR * self.members, PER_STAR)

    @property
    def shape_columns(self) -> slice:
        """Columns of the shape."""
        return slice(PER_STAR * self.members, PER_STAR * self.members + len(self.profile.mean))

    @property
    def background_columns(self) -> slice:
        """Columns of the background."""
        return slice(self.shape_columns.stop, self.shape_columns.stop + len(self.basis))

    @property
    def center_columns(self) -> IntArray:
        """Columns of pixel and line of each star, (members, 2)."""
        return np.asarray(PER_STAR * np.arange(self.members)[:, None] + np.array([PIXEL, LINE]))

    def __call__(self, index: IntArray, p: FloatArray) -> Evaluation:
        """Return residuals, weights and Jacobian of the boxes `index` (g,) at parameters `p` (g, q)."""
        star, jacobian = self._stars(index, p)
        residual = self.data[index] - star - p[:, self.background_columns] @ self.basis
        variance = self.variance[index]
        if np.isfinite(self.gain):
            variance = variance + np.maximum(star, 0.0) / self.gain
        return Evaluation(residual, 1.0 / variance, jacobian)

    def _stars(self, index: IntArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light of the stars (g, m), and the Jacobian (g, q, m)."""
        g, k, m = len(p), self.members, self.size**2
        shape = p[:, self.shape_columns]
        center = p[:, self.center_columns.ravel()].reshape(g * k, 2)
        shapes, firsts = (a if k == 1 else np.repeat(a, k, axis=0) for a in (shape, self.first[index]))
        value, *derivatives = (
            a.reshape(g, k, m) for a in self.profile.evaluate(center, shapes, firsts, self.size)
        )
        flux = p[:, self.flux_columns, None]
        jacobian = np.empty((g, p.shape[1], m))
        stars = jacobian[:, : PER_STAR * k].reshape(g, k, PER_STAR, m)
        stars[:, :, FLUX] = value
        for column, derivative in zip((PIXEL, LINE), derivatives[:2], strict=True):
            np.multiply(flux, derivative, out=stars[:, :, column])
        for column, derivative in enumerate(derivatives[2:], PER_STAR * k):
            jacobian[:, column] = np.sum(flux * derivative, axis=1)
        jacobian[:, self.background_columns] = self.basis
        return np.sum(flux * value, axis=1), jacobian

    def light(self, p: FloatArray, state: Evaluation) -> FloatArray:
        """Return the light of the stars (g, m) at parameters `p`, of which `state` is the evaluation."""
        unit = state.jacobian[:, self.flux_columns]
        return np.asarray(np.sum(p[:, self.flux_columns, None] * unit, axis=1))

    def linear_start(self, center: FloatArray) -> FloatArray:
        """Return parameters (g, q): fluxes and level solved linearly at centers (g, k, 2), expected shape."""
        g, k = center.shape[:2]
        stars = self.profile.value(center.reshape(-1, 2), np.repeat(self.first, k, axis=0), self.size)
        design = np.concatenate([stars.reshape(g, k, -1), np.ones((g, 1, self.size**2))], axis=1)
        weighted = design / self.variance[:, None, :]
        normal = np.matmul(weighted, np.swapaxes(design, 1, 2))
        right = np.matmul(weighted, self.data[:, :, None])[:, :, 0]
        solved = _solved(normal, right, np.ones((g, k + 1), bool))
        if k > 1:  # a negative star would mimic a shift of its neighbor
            positive = np.hstack([solved[:, :k] > 0.0, np.ones((g, 1), bool)])
            solved = np.where(positive, _solved(normal, right, positive), 0.0)
        p = np.zeros((g, self.background_columns.stop))
        p[:, self.flux_columns] = solved[:, :k]
        p[:, self.center_columns.ravel()] = center.reshape(g, 2 * k)
        p[:, self.shape_columns] = self.profile.mean
        p[:, self.background_columns.start] = solved[:, k]
        return p

    def background_at(self, center: FloatArray, p: FloatArray) -> FloatArray:
        """Return the background (DN) at centers (g, k, 2); (g, k)."""
        offset = center - self.first[:, None] - (self.size - 1) / 2
        basis = np.concatenate([np.ones((*center.shape[:2], 1)), offset], axis=2)[:, :, : len(self.basis)]
        return np.asarray(np.sum(basis * p[:, None, self.background_columns], axis=2))


def _solved(normal: FloatArray, right: FloatArray, kept: BoolArray) -> FloatArray:
    """Solve normal equations (g, q, q) for the parameters that are kept (g, q); the others are 0."""
    diagonal = np.einsum("gii->gi", normal)
    known = kept & (diagonal > 0.0)  # without a usable pixel a star gets flux 0
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    ridge = np.where(known, RIDGE, 1.0)
    scaled = normal * scale[:, :, None] * scale[:, None, :] + ridge[:, :, None] * np.eye(normal.shape[1])
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[:, :, None])[:, :, 0])
