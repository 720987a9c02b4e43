"""The model that is fitted: a pixel-integrated elliptical Gaussian on a level or a plane, in many boxes."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.psf import box_integrals
from opnav_workbench.starcenters.boxes import Boxes
from opnav_workbench.starcenters.levenberg import Evaluation
from opnav_workbench.starcenters.results import NoiseModel, ShapePrior

__all__ = ["E1", "E2", "FLUX", "LEVEL", "LINE", "PIXEL", "SCALE", "SLOPE_LINE", "SLOPE_PIXEL", "StarModel"]

# Columns of the parameters; slopes are there with a plane only.
FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL, SLOPE_PIXEL, SLOPE_LINE = range(9)


@dataclass(frozen=True, slots=True, eq=False)
class StarModel:
    """Star plus background in every box; called by the solver with the boxes it still works on."""

    first: FloatArray  # (n, 2)
    data: FloatArray  # (n, m)
    variance: FloatArray  # (n, m) infinite where unusable
    basis: FloatArray  # (b, m) level, and slopes about the middle of the box
    size: int
    gain: float  # e/DN, infinite without shot noise

    @classmethod
    def of(cls, boxes: Boxes, noise: NoiseModel | None, parameters: int) -> "StarModel":
        """Return the model of the given boxes with a level (7 parameters) or a plane (9)."""
        n, size = len(boxes.first), boxes.size
        line, pixel = np.indices((size, size), dtype=float).reshape(2, -1) - (size - 1) / 2
        basis = np.stack([np.ones(size * size), pixel, line])[: parameters - LEVEL]
        gain = np.inf if noise is None else noise.gain_e_per_dn
        data, variance = (a.reshape(n, size * size) for a in (boxes.data_dn, boxes.variance_dn2))
        return cls(boxes.first.astype(float), data, variance, basis, size, gain)

    def __call__(self, index: IntArray, p: FloatArray) -> Evaluation:
        """Return residuals, weights and Jacobian of the boxes `index` (k,) at parameters `p` (k, q)."""
        psf = box_integrals(p[:, PIXEL : LINE + 1], p[:, SCALE : E2 + 1], self.first[index], self.size)
        k, flux = len(p), p[:, FLUX, None]
        jacobian = np.empty((k, p.shape[1], self.size**2))
        jacobian[:, FLUX] = psf.value.reshape(k, self.size**2)
        derivatives = (psf.d_pixel, psf.d_line, psf.d_log_scale, psf.d_e1, psf.d_e2)
        for column, derivative in zip((PIXEL, LINE, SCALE, E1, E2), derivatives, strict=True):
            np.multiply(flux, derivative.reshape(k, self.size**2), out=jacobian[:, column])
        jacobian[:, LEVEL:] = self.basis
        star = flux * jacobian[:, FLUX]
        residual = self.data[index] - star - p[:, LEVEL:] @ self.basis
        variance = self.variance[index]
        if np.isfinite(self.gain):
            variance = variance + np.maximum(star, 0.0) / self.gain
        return Evaluation(residual, 1.0 / variance, jacobian)

    def linear_start(self, center: FloatArray, prior: ShapePrior) -> FloatArray:
        """Return parameters: flux and background level solved linearly at `center` and the prior's shape."""
        n = len(center)
        shape = np.broadcast_to(prior.mean, (n, 3))
        psf = box_integrals(center, shape, self.first, self.size).value.reshape(n, self.size**2)
        w = 1.0 / self.variance
        s, st, stt = np.sum(w, 1), np.sum(w * psf, 1), np.sum(w * psf**2, 1)
        sd, std = np.sum(w * self.data, 1), np.sum(w * psf * self.data, 1)
        det = s * stt - st**2
        solvable = det > 1e-12 * s * stt
        det = np.where(solvable, det, 1.0)
        p = np.zeros((n, LEVEL + len(self.basis)))
        p[:, FLUX] = np.where(solvable, (s * std - st * sd) / det, 0.0)
        p[:, LEVEL] = np.where(solvable, (stt * sd - st * std) / det, 0.0)
        p[:, PIXEL : LINE + 1] = center
        p[:, SCALE : E2 + 1] = shape
        return p

    def with_psf_error(
        self, p: FloatArray, covariance: FloatArray, error: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the covariance with the PSF model's error V propagated through the fit, and its chi2.

        With C the inverse normal matrix, parameters follow the data by C J'W, so V adds C J'W V WJ C.
        """
        state = self(np.arange(len(p)), p)
        psf_variance = (error * p[:, FLUX, None] * state.jacobian[:, FLUX]) ** 2
        gain = np.matmul(covariance, state.jacobian * state.weight[:, None, :])
        added = np.matmul(gain * psf_variance[:, None, :], np.swapaxes(gain, 1, 2))
        return covariance + added, np.sum(state.weight * psf_variance, axis=1)

    def background_at(self, center: FloatArray, p: FloatArray) -> FloatArray:
        """Return the background (DN) at `center`; (n,)."""
        offset = center - self.first - (self.size - 1) / 2
        basis = np.column_stack([np.ones(len(p)), offset])[:, : len(self.basis)]
        return np.asarray(np.sum(basis * p[:, LEVEL:], axis=1))
