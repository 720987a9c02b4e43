"""Saturated stars measured by what is not saturated: the flanks and wings of their images.

The core's pixels are left out, and with them what charge has spilled into: the pixels above and below the core, and
where the core is far longer than wide, all of its columns. What remains is fitted with a profile whose wings are free,

    light(q) = (1 + q (2^(1/b) - 1) / (2 ln 2))^-b,   q = squared distance in units of the PSF's sigmas,

a Gaussian for large b, with the power-law wings of real optics for small b; b, scale and ellipticity are estimated
beside flux, center and background. No real image is of this family, so that every pixel's light is believed to a
fraction f only, the one that makes chi-square what it is expected to be. Structure in the wings is as wide as the core
of the PSF: errors of f are shared by as many pixels as the core has, which widens the covariance that f gives.

Where no profile describes the flanks (an undersampled PSF, a few pixels only) the middle of the clipped light remains:
light above the level at which the core is cut off counts as that level, and a round image stays round.

Reference: Moffat (1969), A&A 3, 455 (the profile).
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation, find_objects, label

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, gauss_legendre
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.psf import covariance_from_shape
from opnav_workbench.robust import moment_excess
from opnav_workbench.stars.boxes import check_image, check_points
from opnav_workbench.stars.levenberg_marquardt import BatchSolution, ModelEvaluation, solve_batched
from opnav_workbench.stars.results import NoiseModel, ShapePrior

__all__ = ["WingCenters", "fit_wings"]

# ---- What a saturated star's unsaturated pixels tell.


@dataclass(frozen=True, slots=True, eq=False)
class WingCenters:
    """Centers of n saturated stars; nan where their pixels tell none."""

    pixel_line: FloatArray  # (n, 2)
    covariance_px2: FloatArray  # (n, 2, 2)
    flux_dn: FloatArray  # (n,) with the core as extrapolated, or a lower limit: the clipped light
    flux_sigma_dn: FloatArray  # (n,)
    model_error: (
        FloatArray  # (n,) f, the fraction to which the profile describes the light; 0.3 for clipped light
    )

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def measured(self) -> BoolArray:
        """True where there is a center; (n,)."""
        return np.asarray(np.isfinite(self.pixel_line).all(axis=1))

    def take(self, rows: IntArray | BoolArray) -> "WingCenters":
        """Return some of them."""
        return WingCenters(*(getattr(self, field.name)[rows] for field in fields(self)))


ABOVE_AND_BELOW = np.array([[0, 1, 0], [0, 1, 0], [0, 1, 0]], bool)
CORE_REACH_PX = 3.0  # a saturated core this near to the place where a star is expected is that star's
# A core longer than this times its width, and this, has bled along its columns
BLEEDING_RATIO, BLEEDING_PX = 1.3, 2.0
WING_CORES, WING_SIGMAS = 2.0, 5.0  # half the box, in radii of the core and sigmas of the PSF
MAX_HALF_PX = 40
MIN_LIT_PIXELS = 6  # that show the star at 3 sigmas of the noise: three times what a center and a flux need
MIN_MODEL_ERROR, MAX_MODEL_ERROR = 0.02, 0.3  # no PSF is known better; beyond, the profile is not this star's
FOREIGN_SIGMAS = 5.0  # light that the star does not explain: cosmic rays, neighbors
ROUNDS = 5  # of weights, model error and foreign light; they settle within three
# A saturated pixel that the fit expects below this part of its value is not saturated by the star.
CORE_PART = 0.4
UNDERSAMPLED_PX = 0.7  # below, three nodes do not integrate the flank of the profile over a pixel
WING_ASYMMETRY = 0.01  # of the radius at which a star is measured: by so much coma shifts wings against cores
MAX_SIGMA_PX = 1.0  # a center worse than this tells less than the places of other stars

# The middle of clipped light: on real stars of an undersampled camera (New Horizons LORRI 4x4; scaled up to 1.5 to 20 times
# saturation) it is off by 0.06 px for one saturated pixel to 0.2 px for five, an axis.
CLIPPED_RIM_PX, CLIPPED_ROUNDS = 1.5, 3
CLIPPED_SIGMA_PX, CLIPPED_PART = 0.06, 0.12
MIN_FLANK = 0.15  # of the level, outside the core: the sharpest PSF has more

# Free beside flux and background: center, log scale, e1, e2, log of the exponent.
PRIOR_SIGMA_LOG_SCALE = 0.4  # wings need not belong to the Gaussian that describes the core
PRIOR_SIGMA_ELLIPTICITY = 0.1
LOG_EXPONENT, SIGMA_LOG_EXPONENT = float(np.log(4.0)), 1.2
LOG_EXPONENT_RANGE = (float(np.log(1.1)), float(np.log(60.0)))
N_PARAMETERS = 8  # flux, pixel, line, log scale, e1, e2, log exponent, level
FLUX, PIXEL, LINE, SCALE, E1, E2, EXPONENT, LEVEL = range(N_PARAMETERS)
MAX_STEPS, MAX_LAST_STEPS = 30, 100  # of one fit; what has not converged goes on in the next round


def fit_wings(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    saturated: ArrayLike,
    start_pixel_line: ArrayLike,
    prior: ShapePrior,
    *,
    noise_model: NoiseModel | None = None,
    neighbors_px: ArrayLike = (),
) -> WingCenters:
    """Measure saturated stars by their unsaturated pixels.

    Parameters
    ----------
    image_dn, noise_dn, bad, saturated, noise_model
        As in `fit_gaussian`; the values of saturated pixels are lower limits of their light.
    start_pixel_line : (n, 2) array_like
        Where the stars are expected; each is the nearest saturated core within 3 px of its edge.
    prior
        What is known of the PSF.
    neighbors_px : (k, 2) array_like
        Places of other stars, whose light is left out.

    Returns
    -------
    WingCenters
        nan for stars without a saturated core, without enough light around it, or whose core is brighter than their
        wings allow (a hot pixel, a cosmic ray, a column that another star has filled).

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape.
    """
    raw = np.asarray(image_dn, dtype=float)
    pixels = check_image(raw, noise_dn, bad, saturated)
    places, others = check_points(start_pixel_line), check_points(neighbors_px, "neighbors_px")
    cores = _Cores(pixels.saturated)
    columns_lost = _bled_columns(cores)
    ends_lost = columns_lost | binary_dilation(pixels.saturated, ABOVE_AND_BELOW)
    fits = []
    for place in places:
        # Beside a small core the pixels of its ends are half of what there is.
        boxes = (
            _cut(raw, pixels.noise_dn, cores, lost, place, others, prior)
            for lost in (ends_lost, columns_lost)
        )
        fits.append(_measured(boxes, prior, noise_model))
    columns = (np.array([fit[k] for fit in fits]) for k in range(5))
    center, covariance, flux, flux_sigma, error = columns
    n = len(fits)
    return WingCenters(center.reshape(n, 2), covariance.reshape(n, 2, 2), flux, flux_sigma, error)


Fit = tuple[FloatArray, FloatArray, float, float, float]
NO_FIT: Fit = (np.full(2, np.nan), np.full((2, 2), np.nan), np.nan, np.nan, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class _Box:
    """One star: the middle of its core, and the pixels around it, each as (m,)."""

    middle: FloatArray  # (2,)
    radius_px: float  # of the core, as wide as it is without what has bled
    pixel: FloatArray
    line: FloatArray
    data: FloatArray
    noise: FloatArray  # infinite where unusable
    core: BoolArray  # the star's saturated pixels


class _Cores:
    """The picture's saturated pixels, those that touch counted as one core."""

    def __init__(self, saturated: BoolArray) -> None:
        self.numbers = np.asarray(label(saturated, structure=np.ones((3, 3)))[0], np.int64)  # 0 elsewhere
        self.regions = find_objects(self.numbers)
        self._line, self._pixel = np.nonzero(self.numbers)

    def nearest(self, place: FloatArray) -> int:
        """Return the number of the core nearest to a place; 0 where none is near."""
        if len(self._line) == 0:
            return 0
        distance = np.hypot(self._pixel - place[0], self._line - place[1])
        nearest = int(distance.argmin())
        if distance[nearest] > CORE_REACH_PX:
            return 0
        return int(self.numbers[self._line[nearest], self._pixel[nearest]])

    def middle_and_radius(self, number: int) -> tuple[FloatArray, float]:
        """Return the middle (2,) of a core, and half its shorter side."""
        region = self.regions[number - 1]
        line, pixel = np.nonzero(self.numbers[region] == number)
        middle = np.array([(pixel + region[1].start).mean(), (line + region[0].start).mean()])
        return middle, 0.5 * (min(np.ptp(line), np.ptp(pixel)) + 1.0)


def _bled_columns(cores: _Cores) -> BoolArray:
    """True for saturated pixels and the columns along which charge has visibly spilled."""
    lost = cores.numbers > 0
    for lines, columns in cores.regions:
        height, width = lines.stop - lines.start, columns.stop - columns.start
        if height > BLEEDING_RATIO * width + BLEEDING_PX:
            lost[:, columns] = True
        elif width > BLEEDING_RATIO * height + BLEEDING_PX:  # a detector mounted across its read-out
            lost[lines, :] = True
    return np.asarray(lost)


def _cut(
    raw: FloatArray, noise: FloatArray, cores: _Cores, lost: BoolArray, place: FloatArray, others: FloatArray,
    prior: ShapePrior,
) -> _Box | None:  # fmt: skip
    """Return the pixels around the core nearest to a place; None where there is none that a star may have."""
    number = cores.nearest(place)
    if number == 0:
        return None
    middle, radius = cores.middle_and_radius(number)
    half = min(int(np.ceil(WING_CORES * radius + WING_SIGMAS * prior.sigma_px + 1.0)), MAX_HALF_PX)
    corner = np.maximum(np.rint(middle).astype(int) - half, 0)
    window = np.s_[
        corner[1] : int(np.rint(middle[1])) + half + 1, corner[0] : int(np.rint(middle[0])) + half + 1
    ]
    rows, columns = np.indices(raw[window].shape)
    x, y = (columns + corner[0]).ravel().astype(float), (rows + corner[1]).ravel().astype(float)
    far = others[np.hypot(*(others - middle).T) > radius + 1.0] if len(others) else others
    foreign = np.zeros(x.shape, bool)
    for other in far:
        foreign |= np.hypot(x - other[0], y - other[1]) < 1.0 + 3.0 * prior.sigma_px
    usable = np.where(lost[window].ravel() | foreign, np.inf, noise[window].ravel())
    own = cores.numbers[window] == number
    if not own.any():  # the rim of a body: larger than a star's, it lies apart from its own middle
        return None
    return _Box(middle, radius, x, y, raw[window].ravel(), usable, own.ravel())


def _measured(boxes: Iterable[_Box | None], prior: ShapePrior, noise_model: NoiseModel | None) -> Fit:
    """Return the first fit that describes its box; where none does, the middle of the last one's clipped light."""
    box: _Box | None = None
    for box in boxes:
        found = _fit_one(box, prior, noise_model)
        if np.isfinite(found[0]).all():
            return found
    return _clipped_middle(box)


def _fit_one(box: _Box | None, prior: ShapePrior, noise_model: NoiseModel | None) -> Fit:
    if box is None or np.isfinite(box.noise).sum() < 2 * N_PARAMETERS:
        return NO_FIT
    model = _WingModel(box, noise_model, prior.sigma_px)
    solution = _solved(model, box, prior)
    p = solution.parameters[0]
    light = model.light(p)
    lit = np.isfinite(box.noise) & (light > 3.0 * box.noise)
    core = box.core & (light > 0.9 * light[box.core].max(initial=0.0))
    expected = bool(core.any()) and light[core].max() >= CORE_PART * box.data[core].max()
    covariance = _covariance(solution, model, light, prior)
    covariance = covariance + (WING_ASYMMETRY * max(box.radius_px, prior.sigma_px)) ** 2 * np.eye(2)
    good = (
        solution.determined[0] and model.error < MAX_MODEL_ERROR
        and lit.sum() >= MIN_LIT_PIXELS and expected
        and np.linalg.eigvalsh(covariance)[-1] < MAX_SIGMA_PX**2
    )  # fmt: skip
    if not good:
        return NO_FIT
    norm = _full_light(p)
    sigma = float(np.sqrt(solution.covariance[0, FLUX, FLUX]))
    return p[[PIXEL, LINE]], covariance, float(p[FLUX] * norm), sigma * norm, model.error


def _clipped_middle(box: _Box | None) -> Fit:
    """Middle of the light around the core, no pixel counted above the level at which the core is cut off."""
    if box is None:
        return NO_FIT
    level = float(np.median(box.data[box.core]))
    usable = box.core | np.isfinite(box.noise)
    light = np.where(usable, np.clip(box.data, 0.0, level), 0.0)
    radius = float(np.sqrt(box.core.sum() / np.pi)) + CLIPPED_RIM_PX
    middle = box.middle
    for _ in range(CLIPPED_ROUNDS):
        distance = np.hypot(box.pixel - middle[0], box.line - middle[1])
        weight = light * np.clip(radius + 0.5 - distance, 0.0, 1.0)
        if not weight.sum() > 0.0:  # nothing about a core that lies apart from its own middle
            return NO_FIT
        middle = np.array([weight @ box.pixel, weight @ box.line]) / weight.sum()
    flank = float(np.sum(weight[~box.core]))
    spoiled = np.any(~usable & (distance < radius))
    if spoiled or flank < MIN_FLANK * level:  # a hot pixel and a cosmic ray have no flanks
        return NO_FIT
    extent = np.array([np.ptp(box.pixel[box.core]), np.ptp(box.line[box.core])]) + 1.0
    bled = extent > BLEEDING_RATIO * extent.min() + BLEEDING_PX
    sigma = np.where(bled, extent / np.sqrt(12.0), np.hypot(CLIPPED_SIGMA_PX, CLIPPED_PART * 0.5 * extent))
    if sigma.max() >= MAX_SIGMA_PX:
        return NO_FIT
    noise = float(np.sqrt(np.sum(box.noise[np.isfinite(box.noise) & (weight > 0.0)] ** 2)))
    return middle, np.diag(sigma**2), float(weight.sum()), max(noise, flank / 100.0), MAX_MODEL_ERROR


def _solved(model: "_WingModel", box: _Box, prior: ShapePrior) -> BatchSolution:
    """Fit, weigh by what was fitted, estimate how well it fits, leave out foreign light; and again."""
    mean, information = np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS)
    mean[[SCALE, E1, E2, EXPONENT]] = [*prior.mean, LOG_EXPONENT]
    sigmas = [PRIOR_SIGMA_LOG_SCALE, PRIOR_SIGMA_ELLIPTICITY, PRIOR_SIGMA_ELLIPTICITY, SIGMA_LOG_EXPONENT]
    information[[SCALE, E1, E2, EXPONENT]] = np.array(sigmas) ** -2.0
    lower, upper = np.full(N_PARAMETERS, -np.inf), np.full(N_PARAMETERS, np.inf)
    reach = np.array([box.radius_px, max(box.radius_px, 0.5 * np.ptp(box.line[box.core]))]) + CORE_REACH_PX
    lower[[PIXEL, LINE]], upper[[PIXEL, LINE]] = box.middle - reach, box.middle + reach
    lower[[E1, E2]], upper[[E1, E2]] = -0.5, 0.5
    lower[EXPONENT], upper[EXPONENT] = LOG_EXPONENT_RANGE
    lower[FLUX] = 0.0
    p = model.start(mean)

    def fitted(start: FloatArray, steps: int) -> BatchSolution:
        return solve_batched(
            model, start[None], lower[None], upper[None], mean[None], information[None], steps
        )

    for _ in range(ROUNDS):
        model.weigh(p)
        solution = fitted(p, MAX_STEPS)
        p = solution.parameters[0]
        model.judge(p)
    model.weigh(p)
    return fitted(p, MAX_LAST_STEPS)


class _WingModel:
    """The profile on a level, for `solve_batched` with one problem; weights are renewed between fits."""

    def __init__(self, box: _Box, noise_model: NoiseModel | None, sigma_px: float) -> None:
        self.box, self.gain = box, np.inf if noise_model is None else noise_model.gain_e_per_dn
        self.usable = np.isfinite(box.noise)
        self.error = 0.2
        self.variance = np.where(self.usable, box.noise, 1.0) ** 2
        nodes, weights = gauss_legendre(5 if sigma_px < UNDERSAMPLED_PX else 3)
        self._u, self._v = (a.ravel() for a in np.meshgrid(0.5 * nodes, 0.5 * nodes))
        self._share = 0.25 * np.outer(weights, weights).ravel()

    def start(self, mean: FloatArray) -> FloatArray:
        """Return first parameters: flux and level by linear least squares at the middle of the core."""
        p = mean.copy()
        p[[PIXEL, LINE]], p[FLUX] = self.box.middle, 1.0
        design = np.column_stack([self.light(p), np.ones_like(self.variance)])[self.usable]
        scale = 1.0 / (self.box.noise[self.usable] + 0.2 * np.abs(self.box.data[self.usable]))
        found = np.linalg.lstsq(design * scale[:, None], self.box.data[self.usable] * scale, rcond=None)[0]
        p[FLUX], p[LEVEL] = max(found[0], 1.0), found[1]
        return p

    def light(self, p: FloatArray) -> FloatArray:
        """Star's light in each pixel (m,)."""
        return np.asarray(p[FLUX] * self._profile(p)[0] @ self._share)

    def _profile(self, p: FloatArray) -> tuple[FloatArray, ...]:
        """Profile at the nodes of each pixel (m, k), with q, its stretch, and the offsets from the center."""
        x = self.box.pixel[:, None] + self._u - p[PIXEL]
        y = self.box.line[:, None] + self._v - p[LINE]
        uu, uv, vv = covariance_from_shape(p[SCALE], p[E1], p[E2])
        q = (vv * x**2 - 2.0 * uv * x * y + uu * y**2) / (uu * vv - uv**2)
        widened = 1.0 + q * _stretch(np.exp(p[EXPONENT]))
        return np.exp(-np.exp(p[EXPONENT]) * np.log(widened)), q, widened, x, y

    def weigh(self, p: FloatArray) -> None:
        """Renew the variances by the light that is expected at `p`."""
        light = np.maximum(self.light(p), 0.0)
        noise = np.where(self.usable, self.box.noise, 1.0)
        self.variance = noise**2 + light / self.gain + (self.error * light) ** 2

    def judge(self, p: FloatArray) -> None:
        """Estimate the model error, and leave out pixels with light that is not the star's."""
        light = np.maximum(self.light(p), 0.0)
        residual = self.box.data - light - p[LEVEL]
        self.usable = self.usable & (residual < FOREIGN_SIGMAS * np.sqrt(self.variance))
        noise = (self.box.noise**2 + light / self.gain)[self.usable]
        square, bright = residual[self.usable] ** 2, light[self.usable] ** 2
        freedom = self.usable.sum() - N_PARAMETERS

        def surplus(error: float) -> float:
            return float(np.sum(square / (noise + error**2 * bright)) - freedom)

        bounded = surplus(MAX_MODEL_ERROR) < 0.0
        self.error = max(moment_excess(surplus, 1e-4), MIN_MODEL_ERROR) if bounded else MAX_MODEL_ERROR

    def __call__(self, index: IntArray, p: FloatArray) -> ModelEvaluation:
        """See `BatchModel`."""
        del index
        here = p[0]
        jacobian = self._jacobian(here)
        weight = np.where(self.usable, 1.0 / self.variance, 0.0)
        residual = self.box.data - here[FLUX] * jacobian[FLUX] - here[LEVEL]
        return ModelEvaluation(np.where(self.usable, residual, 0.0)[None], weight[None], jacobian[None])

    def _jacobian(self, p: FloatArray) -> FloatArray:
        """Derivatives (8, m) of the light in each pixel with respect to the parameters."""
        profile, q, widened, x, y = self._profile(p)
        exponent = np.exp(p[EXPONENT])
        stretch, root = _stretch(exponent), 2.0 ** (1.0 / exponent)
        slope = -p[FLUX] * exponent * stretch * profile / widened  # d(light) / dq
        uu, uv, vv = covariance_from_shape(p[SCALE], p[E1], p[E2])
        det, scale2 = uu * vv - uv**2, np.exp(2.0 * p[SCALE])
        round_part = 1.0 - p[E1] ** 2 - p[E2] ** 2
        log_slope = q * root / (2.0 * widened) - exponent * np.log(widened)
        return np.stack([
            profile @ self._share,
            (-2.0 * slope * (vv * x - uv * y) / det) @ self._share,
            (-2.0 * slope * (uu * y - uv * x) / det) @ self._share,
            (-2.0 * slope * q) @ self._share,
            (slope * ((y**2 - x**2) / scale2 + 2.0 * p[E1] * q) / round_part) @ self._share,
            (slope * (-2.0 * x * y / scale2 + 2.0 * p[E2] * q) / round_part) @ self._share,
            (p[FLUX] * profile * log_slope) @ self._share,
            np.ones(len(x)),
        ])  # fmt: skip


def _stretch(exponent: float) -> float:
    """Factor on q that gives profiles of all exponents the full width at half maximum of the Gaussian."""
    return float(np.expm1(np.log(2.0) / exponent) / (2.0 * np.log(2.0)))


def _covariance(
    solution: BatchSolution, model: _WingModel, light: FloatArray, prior: ShapePrior
) -> FloatArray:
    """Covariance (2, 2) of the center; errors of the model are shared by as many pixels as the PSF's core has."""
    final = solution.final
    gain = solution.covariance[0] @ (final.jacobian[0] * final.weight[0])
    shared = 4.0 * np.pi * (prior.sigma_px**2 + PIXEL_VARIANCE_PX2) - 1.0
    added = (gain * (shared * (model.error * light) ** 2)) @ gain.T
    center = np.ix_([PIXEL, LINE], [PIXEL, LINE])
    return np.asarray(solution.covariance[0][center] + max(shared, 0.0) / shared * added[center])


def _full_light(p: FloatArray) -> float:
    """Integral of the profile over the plane, for a height of 1."""
    uu, uv, vv = covariance_from_shape(p[SCALE], p[E1], p[E2])
    exponent = np.exp(p[EXPONENT])
    return float(np.pi * np.sqrt(uu * vv - uv**2) / (_stretch(exponent) * (exponent - 1.0)))
