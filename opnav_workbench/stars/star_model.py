"""The model that is fitted to the pixels: the image of a point, and stars made of it on a level or a plane, in many boxes.

The image is an elliptical Gaussian of unknown shape, with three parameters (log scale, e1, e2) and a prior on them, or
a known PSF (empirical, Moffat, trailed), which has none; its derivatives with respect to the center are its own.

The parameters of a box are flux, pixel and line of each of its k stars, the shape that they share, and the background:
3 k + n_shape + 1 or 3 columns. For a single Gaussian star the columns are FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL,
SLOPE_PIXEL, SLOPE_LINE.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.psf import Psf, TrailedPsf, box_values, covering_boxes, ellipse_from_shape
from opnav_workbench.psf.integrals import box_parts
from opnav_workbench.stars.boxes import Boxes
from opnav_workbench.stars.levenberg_marquardt import ModelEvaluation
from opnav_workbench.stars.results import NoiseModel, ShapePrior

__all__ = ["FLUX", "LINE", "PIXEL", "GaussianProfile", "KnownProfile", "StarModel", "StarProfile"]


# ---- What a fit takes a star to look like: an elliptical Gaussian of unknown shape, or a known PSF.

MAX_ELLIPTICITY = 0.65  # of e1 and e2 each: |e| < 0.92, an axis ratio of 5; longer trails take a TrailedPsf
MIN_SCALE_PX = 0.12  # below this a star is one pixel whatever its sigma
SCALE_RANGE_SIGMAS = 5.0  # how far from its prior the log scale may go
# A fitted scale this fraction of the PSF's is a cosmic ray, where the PSF is wide enough to tell.
COSMIC_RAY_SCALE = 0.5
RESOLVED_SIGMA_PX = 0.6


class StarProfile(Protocol):
    """The image of a point as a function of its center and of n_shape parameters that all stars have."""

    @property
    def mean(self) -> FloatArray:
        """Expected shape parameters, (n_shape,)."""
        ...

    @property
    def information(self) -> FloatArray:
        """Inverse variances of what is known of them, (n_shape,)."""
        ...

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the shape parameters, (n_shape,) each."""
        ...

    @property
    def core_px(self) -> float:
        """Sigma of the core of the expected image."""
        ...

    @property
    def reach_px(self) -> float:
        """Largest sigma of the expected image: that along its trail."""
        ...

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares (n, size, size) of points with the expected shape."""
        ...

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares (n, size, size) and derivatives: along pixel, along line, with each shape parameter."""
        ...

    def errors(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray | None:
        """Independent one-sigma errors (n, size, size, r) of the shares that all stars have in common; None without."""
        ...

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Ellipses (n, 3) of shapes (n, n_shape): sigma_major_px, sigma_minor_px, angle_rad."""
        ...

    def core(self, shape: FloatArray) -> FloatArray:
        """Sigma of the core of shapes (n, n_shape); (n,)."""
        ...

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """True where a fitted shape (n, n_shape) is that of no star."""
        ...


@dataclass(frozen=True, slots=True)
class GaussianProfile:
    """An elliptical Gaussian, its shape estimated with a prior."""

    prior: ShapePrior

    @property
    def mean(self) -> FloatArray:
        """Log scale, e1, e2."""
        return self.prior.mean

    @property
    def information(self) -> FloatArray:
        """Inverse variances of log scale, e1, e2."""
        return self.prior.information

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of log scale, e1, e2."""
        prior, reach = self.prior, SCALE_RANGE_SIGMAS * self.prior.sigma_log_scale
        limit = max(MAX_ELLIPTICITY, float(np.abs(prior.ellipticity).max()))
        least = max(prior.log_scale - reach, min(np.log(MIN_SCALE_PX), prior.log_scale))
        return np.array([least, -limit, -limit]), np.array([prior.log_scale + min(reach, 2.0), limit, limit])

    @property
    def core_px(self) -> float:
        """Root mean square of the sigmas along the axes."""
        return self.prior.sigma_px

    @property
    def reach_px(self) -> float:
        """Sigma along the major axis."""
        return self.prior.shape.sigma_major_px

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares with the shape of the prior's mean."""
        shares = box_values(center, np.broadcast_to(self.prior.mean, (len(center), 3)), first, size)
        correction = self.prior.correction
        return shares if correction is None else shares + correction.evaluate(center, first, size)[0]

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares and derivatives."""
        parts = box_parts(center, shape, first, size)
        if self.prior.correction is not None:
            added = self.prior.correction.evaluate(center, first, size)
            parts = parts[0] + added[0], parts[1] + added[1], parts[2] + added[2], *parts[3:]
        return parts

    def errors(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray | None:
        """Errors of a correction that was learned."""
        correction = self.prior.correction
        return None if correction is None else correction.errors(center, first, size)

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Ellipses of the fitted shapes."""
        return ellipse_from_shape(shape[:, 0], shape[:, 1], shape[:, 2])

    def core(self, shape: FloatArray) -> FloatArray:
        """Fitted scales."""
        return np.exp(shape[:, 0])

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """True where the scale is far below the PSF's."""
        sharp = shape[:, 0] < self.prior.log_scale + np.log(COSMIC_RAY_SCALE)
        return np.asarray(sharp & (self.prior.sigma_px >= RESOLVED_SIGMA_PX))


@dataclass(frozen=True, slots=True, eq=False)
class KnownProfile:
    """A PSF taken as it is."""

    psf: Psf
    _ellipse: FloatArray = field(init=False, repr=False)
    core_px: float = field(init=False)  # of a round Gaussian of the same noise area

    def __post_init__(self) -> None:
        if isinstance(self.psf, TrailedPsf):
            object.__setattr__(self, "psf", self.psf.tabulated())
        box = _centered_box(self.psf)
        object.__setattr__(self, "_ellipse", _moment_ellipse(box))
        object.__setattr__(self, "core_px", _core_sigma(box))

    @property
    def mean(self) -> FloatArray:
        """Nothing."""
        return np.zeros(0)

    @property
    def information(self) -> FloatArray:
        """Nothing."""
        return np.zeros(0)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Nothing."""
        return np.zeros(0), np.zeros(0)

    @property
    def reach_px(self) -> float:
        """Half the width of the noise area along the longer axis: wings hardly count."""
        return self.core_px * float(np.sqrt(self._ellipse[0] / self._ellipse[1]))

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares."""
        return self.psf.box(center, np.asarray(first, np.int64), size)

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares and derivatives."""
        del shape
        psf = self.psf.gradient(center, np.asarray(first, np.int64), size)
        return psf.value, psf.d_pixel, psf.d_line

    def errors(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray | None:  # noqa: ARG002
        """None: the PSF is given."""
        return None

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Second moments of the PSF, the same for all."""
        return np.broadcast_to(self._ellipse, (len(shape), 3))

    def core(self, shape: FloatArray) -> FloatArray:
        """The same for all."""
        return np.full(len(shape), self.core_px)

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """Nowhere: the shape is given."""
        return np.zeros(len(shape), bool)


def _centered_box(psf: Psf) -> FloatArray:
    place = np.zeros((1, 2))
    first, size = covering_boxes(psf, place)
    return np.asarray(psf.box(place, first, size)[0])


def _moment_ellipse(box: FloatArray) -> FloatArray:
    """Ellipse of the second moments, pixel integration taken out."""
    weight = box / box.sum()
    middle = (len(box) - 1) / 2.0
    line, pixel = np.indices(box.shape) - middle
    pixel, line = pixel - np.sum(weight * pixel), line - np.sum(weight * line)
    uu, uv, vv = (float(np.sum(weight * product)) for product in (pixel**2, pixel * line, line**2))
    value, vector = np.linalg.eigh(np.array([[uu, uv], [uv, vv]]) - PIXEL_VARIANCE_PX2 * np.eye(2))
    sigma = np.sqrt(np.maximum(value, MIN_SCALE_PX**2))
    return np.array([sigma[1], sigma[0], np.arctan2(vector[1, 1], vector[0, 1])])


def _core_sigma(box: FloatArray) -> float:
    """Sigma of a round Gaussian with the same noise area 4 pi (sigma^2 + 1/12): wings hardly count."""
    area = box.sum() ** 2 / np.sum(box**2)
    return float(np.sqrt(max(area / (4.0 * np.pi) - PIXEL_VARIANCE_PX2, MIN_SCALE_PX**2)))


# ---- The model that is fitted: one star or several neighbors on a level or a plane, in many boxes.

FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL, SLOPE_PIXEL, SLOPE_LINE = range(9)
PER_STAR = 3  # flux, pixel, line
RIDGE = 1e-12  # of the linear start: two stars in one pixel share its light


@dataclass(frozen=True, slots=True, eq=False)
class StarModel:
    """Stars plus background in every box; called by the solver with the boxes it still works on."""

    profile: StarProfile
    members: int  # stars in each box
    first: FloatArray  # (g, 2)
    data: FloatArray  # (g, m)
    variance: FloatArray  # (g, m) infinite where unusable
    basis: FloatArray  # (b, m) level, and slopes about the middle of the box
    size: int
    gain: float  # e/DN, infinite without shot noise
    # Fluxes and background are solved at every trial place. Of two close images only flux times distance is well known:
    # along that valley steps in all parameters at once creep.
    light_solved: bool = False

    @classmethod
    def of(
        cls, boxes: Boxes, noise: NoiseModel | None, profile: StarProfile, background: str, members: int = 1
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

    def __call__(self, index: IntArray, p: FloatArray) -> ModelEvaluation:
        """Return residuals, weights and Jacobian of the boxes `index` (g,) at parameters `p` (g, q)."""
        value, *derivatives = self._shares(index, p)
        chosen = self._with_solved_light(index, p, value) if self.light_solved else None
        p = p if chosen is None else chosen
        star, jacobian = self._stars(p, value, derivatives)
        residual = self.data[index] - star - p[:, self.background_columns] @ self.basis
        return ModelEvaluation(residual, 1.0 / self._variance(index, star), jacobian, chosen)

    def _variance(self, index: IntArray, star: FloatArray) -> FloatArray:
        variance = self.variance[index]
        return variance + np.maximum(star, 0.0) / self.gain if np.isfinite(self.gain) else variance

    def _with_solved_light(self, index: IntArray, p: FloatArray, value: FloatArray) -> FloatArray:
        """Return parameters with the fluxes and background that fit best, where these are stars: none is negative."""
        k = self.members
        columns = [
            *range(*self.flux_columns.indices(p.shape[1])),
            *range(*self.background_columns.indices(p.shape[1])),
        ]
        basis = np.broadcast_to(self.basis, (len(p), *self.basis.shape))
        design = np.concatenate([value, basis], axis=1)
        weighted = design / self._variance(index, _summed(p[:, self.flux_columns, None] * value))[:, None]
        normal = np.matmul(weighted, np.swapaxes(design, 1, 2))
        right = np.matmul(weighted, self.data[index][:, :, None])[:, :, 0]
        solved = _solve_linear(normal, right, np.ones(right.shape, bool))
        out = p.copy()
        out[:, columns] = np.where(np.all(solved[:, :k] > 0.0, axis=1, keepdims=True), solved, p[:, columns])
        return out

    def _shares(self, index: IntArray, p: FloatArray) -> list[FloatArray]:
        """Shares of each star (g, k, m) and their derivatives."""
        g, k, m = len(p), self.members, self.size**2
        shape = p[:, self.shape_columns]
        center = p[:, self.center_columns.ravel()].reshape(g * k, 2)
        shapes, firsts = (a if k == 1 else np.repeat(a, k, axis=0) for a in (shape, self.first[index]))
        return [a.reshape(g, k, m) for a in self.profile.evaluate(center, shapes, firsts, self.size)]

    def _stars(
        self, p: FloatArray, value: FloatArray, derivatives: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Light of the stars (g, m), and the Jacobian (g, q, m)."""
        g, k, m = value.shape
        flux = p[:, self.flux_columns, None]
        jacobian = np.empty((g, p.shape[1], m))
        stars = jacobian[:, : PER_STAR * k].reshape(g, k, PER_STAR, m)
        stars[:, :, FLUX] = value
        for column, derivative in zip((PIXEL, LINE), derivatives[:2], strict=True):
            np.multiply(flux, derivative, out=stars[:, :, column])
        for column, derivative in enumerate(derivatives[2:], PER_STAR * k):
            jacobian[:, column] = _summed(flux * derivative)
        jacobian[:, self.background_columns] = self.basis
        return _summed(flux * value), jacobian

    def light(self, p: FloatArray, state: ModelEvaluation) -> FloatArray:
        """Return the light of the stars (g, m) at parameters `p`, of which `state` is the evaluation."""
        unit = state.jacobian[:, self.flux_columns]
        return np.asarray(np.sum(p[:, self.flux_columns, None] * unit, axis=1))

    def psf_errors(self, p: FloatArray) -> FloatArray | None:
        """Return what one-sigma errors of the PSF make of the boxes (g, m, r) at parameters `p`; None without."""
        g, k = len(p), self.members
        center = p[:, self.center_columns.ravel()].reshape(g * k, 2)
        errors = self.profile.errors(center, np.repeat(self.first, k, axis=0), self.size)
        if errors is None:
            return None
        light = p[:, self.flux_columns].reshape(g, k, 1, 1) * errors.reshape(g, k, self.size**2, -1)
        return np.asarray(light.sum(axis=1))

    def linear_start(self, center: FloatArray) -> FloatArray:
        """Return parameters (g, q): fluxes and level solved linearly at centers (g, k, 2), expected shape."""
        g, k = center.shape[:2]
        stars = self.profile.value(center.reshape(-1, 2), np.repeat(self.first, k, axis=0), self.size)
        design = np.concatenate([stars.reshape(g, k, -1), np.ones((g, 1, self.size**2))], axis=1)
        weighted = design / self.variance[:, None, :]
        normal = np.matmul(weighted, np.swapaxes(design, 1, 2))
        right = np.matmul(weighted, self.data[:, :, None])[:, :, 0]
        solved = _solve_linear(normal, right, np.ones((g, k + 1), bool))
        if k > 1:  # a negative star would mimic a shift of its neighbor
            positive = np.hstack([solved[:, :k] > 0.0, np.ones((g, 1), bool)])
            solved = np.where(positive, _solve_linear(normal, right, positive), 0.0)
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


def _summed(stars: FloatArray) -> FloatArray:
    """Sum (g, k, m) over the stars of a group; most have one."""
    return stars[:, 0] if stars.shape[1] == 1 else np.asarray(stars.sum(axis=1))


def _solve_linear(normal: FloatArray, right: FloatArray, kept: BoolArray) -> FloatArray:
    """Solve normal equations (g, q, q) for the parameters that are kept (g, q); the others are 0."""
    diagonal = np.einsum("gii->gi", normal)
    known = kept & (diagonal > 0.0)  # without a usable pixel a star gets flux 0
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    ridge = np.where(known, RIDGE, 1.0)
    scaled = normal * scale[:, :, None] * scale[:, None, :] + ridge[:, :, None] * np.eye(normal.shape[1])
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[:, :, None])[:, :, 0])
