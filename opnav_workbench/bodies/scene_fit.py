"""Weighted least squares of rendered bodies to a picture, with what is not known of them: Gauss-Newton, few renderings.

Parameters   of each body those of `PARAMETERS`, then the logarithm of the PSF's width and a level under all:

             pixel, line      center
             size             logarithm of the size over the a priori one
             stretch, shear   strain of its image: (stretch x + shear y, shear x - stretch y)
             depth, tilts     strain along the line of sight z: (tilt_x z, tilt_y z, depth z + tilt_x x + tilt_y y)
             law              share of another scattering law: Lambert's becomes Lommel and Seeliger's at 1
             scale            brightness, data over model

Priors       Size, strains, law and PSF are known to some uncertainty, which is part of the fit: where the pixels tell more
             they are solved, where they do not their uncertainty is in the center's covariance.
Derivatives  A body's light is rendered with its slopes J, DN per px of motion. An image that is strained by E about its
             center changes by (E x) . J, less what the PSF, which is not strained, would gain by it: its covariance times
             the second derivatives. What changes the shading, and slopes where bodies hide each other, are differences.
Patterns     Albedo that the model lacks leaves residuals that neighbours share. Their autocovariance, relative to the
             light, is taken from the residuals; pixels are weighed with it, and it enters the covariance as it is.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.ndimage import correlate1d

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies.picture import BodyPicture, displaced_model, sunlight_electrons
from opnav_workbench.bodies.subarray import Cutout, find_hit_pixels
from opnav_workbench.render import (
    AlbedoMap,
    BodyModel,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    RenderedBody,
    render_moving,
)
from opnav_workbench.render.scattering import AdjustedLaw

__all__ = ["PARAMETERS", "Pattern", "SceneFit", "SceneState", "fit_scene"]

Window = tuple[int, int, int, int]

PARAMETERS = ("pixel", "line", "size", "stretch", "shear", "depth", "tilt_x", "tilt_y", "law", "scale")
SIZE, STRETCH, DEPTH, LAW, SCALE, COUNT = 2, 3, 5, 8, 9, 10
LAW_SIGMA = 0.5  # a law between Lambert's and Lommel and Seeliger's; one with parameters of its own was fitted to the body
FITTED_LAW_SIGMA = 0.1
PSF_SIGMA = 0.1
FIXED = 1e-9  # sigma of what is not solved for
PIXEL_VARIANCE = 1.0 / 12.0  # what the pixel's own width adds to the PSF's


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Bodies (n, 10), see `PARAMETERS`, and what they have in common."""

    names: tuple[str, ...]
    bodies: FloatArray
    psf: float = 0.0
    level_dn: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def at(cls, names: tuple[str, ...], centers_px: FloatArray, sizes: FloatArray) -> "SceneState":
        """Return bodies at places (n, 2), of sizes (n,) over the a priori ones."""
        n = len(names)
        return cls(
            names, np.column_stack([centers_px, np.log(sizes), np.zeros((n, LAW + 1 - STRETCH)), np.ones(n)])
        )

    @property
    def vector(self) -> FloatArray:
        """All parameters (10 n + 2,)."""
        return np.concatenate([self.bodies.ravel(), [self.psf, self.level_dn]])

    def moved(self, change: FloatArray) -> "SceneState":
        """Return the state with a change (10 n + 2,) of all parameters."""
        bodies = self.bodies + change[:-2].reshape(-1, COUNT)
        return replace(
            self, bodies=bodies, psf=self.psf + float(change[-2]), level_dn=self.level_dn + float(change[-1])
        )


def prior_sigmas(picture: BodyPicture, names: tuple[str, ...], solved: BoolArray) -> FloatArray:
    """Return how well the parameters (10 n + 2,) are known; sizes of bodies whose range is `solved` (n,) are not."""
    rows = []
    for name, free in zip(names, solved, strict=True):
        model = picture.model(name)
        size, axes = np.inf if free else model.figure.size_sigma, model.figure.axes_sigma
        depth = axes if _strainable(model) else 0.0
        stand_in = isinstance(model.law, Lambert | LommelSeeliger | LunarLambert)
        rows.append(
            [
                np.inf,
                np.inf,
                size,
                axes,
                axes,
                depth,
                depth,
                depth,
                LAW_SIGMA if stand_in else FITTED_LAW_SIGMA,
            ]
        )
        if model.is_point:
            rows[-1][SIZE:] = [0.0] * (LAW + 1 - SIZE)
        rows[-1].append(np.inf)
    return np.asarray(np.maximum(np.concatenate([np.ravel(rows), [PSF_SIGMA, np.inf]]), FIXED))


def _strainable(model: BodyModel) -> bool:
    """Whether the model can be drawn strained: shapes and what is mapped on an ellipsoid are not."""
    return not (model.is_point or model.shape is not None or isinstance(model.albedo, AlbedoMap))


# ---- The light of a scene's bodies, and how it changes with every parameter.

DIFFERENCE_PX = 0.1  # of slopes, where bodies hide each other
STEP, STEP_PX = 0.05, 0.1  # of differences, at most
EXACT_RADIUS_PX = (
    20.0  # smaller bodies show shading and limb in the same pixels: all of their derivatives are differences
)
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # derivatives of fourth order from samples a pixel apart
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
MAX_STRAIN = 0.5
LAW_LIMITS = -1.2, 1.2  # a little beyond from one law to the other


def strained_model(picture: BodyPicture, name: str, body: FloatArray) -> BodyModel:
    """Return a body's model with the parameters of `body` (10,); maps and shapes are not strained."""
    model = displaced_model(picture, name, body[:2], float(np.exp(-body[SIZE])))
    if model.is_point:
        return model
    model = replace(model, law=AdjustedLaw(model.law, float(np.clip(body[LAW], *LAW_LIMITS))))
    if not _strainable(model):
        return model
    target = model.target
    slopes = picture.camera.unproject_jacobian(body[None, :2])[0].T @ picture.camera_from_j2000
    x, y = slopes / np.linalg.norm(slopes, axis=1)[:, None]
    triad = np.stack([x, y, np.cross(x, y)])
    a, b, depth, tilt_x, tilt_y = np.clip(body[STRETCH:LAW], -MAX_STRAIN, MAX_STRAIN)
    strain = np.eye(3) + np.array([[a, b, tilt_x], [b, -a, tilt_y], [tilt_x, tilt_y, depth]])
    axes = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
    radii = np.asarray(target.radii_km, dtype=np.float64)
    turned, radii, _ = np.linalg.svd(triad.T @ strain @ triad @ (axes.T * radii))
    turned[:, 2] *= np.linalg.det(turned)
    return replace(model, target=replace(target, radii_km=radii, body_from_j2000=turned.T))


def _rendered(
    picture: BodyPicture, window: Window, state: SceneState, *, derivatives: bool = False
) -> tuple[FloatArray, FloatArray, tuple[RenderedBody, ...]]:
    """Return the light (n, ...) of the bodies and its slopes (n, 2 or 0, ...) at unit scale."""
    moving = render_moving(
        [strained_model(picture, *body) for body in zip(state.names, state.bodies, strict=True)],
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
        derivatives=derivatives,
    )
    light = np.stack([body.electrons for body in moving]) / picture.gain_e_per_dn
    slopes = np.stack([body.slopes for body in moving]) / picture.gain_e_per_dn
    return light, slopes, tuple(body.body for body in moving)


@dataclass(frozen=True, slots=True, eq=False)
class _Derivatives:
    """Of the model at a state with respect to all parameters (p, n_line, n_pixel)."""

    at: SceneState
    radius_px: FloatArray  # (n,), at least 1
    columns: FloatArray
    rough: bool  # without what changes the shading: enough to come near


def _differentiated(
    problem: "_Problem",
    state: SceneState,
    light: FloatArray,
    slopes: FloatArray,
    radius_px: FloatArray,
    *,
    differences: bool,
    rough: bool,
) -> _Derivatives:
    """Return the derivatives; `light` and `slopes` are those of the state."""
    picture, window = problem.picture, problem.cutout.window
    if differences:
        slopes = _slope_differences(picture, window, state)
    psf_variance = np.square(picture.psf.sigma_px) * np.ones(2)
    wide_x, wide_y = psf_variance + PIXEL_VARIANCE
    line, pixel = np.ogrid[: light.shape[1], : light.shape[2]]
    parts, psf = [], np.zeros(light.shape[1:])
    for row, (along, down), plain in zip(
        state.bodies, state.bodies[:, SCALE, None, None, None] * slopes, light, strict=True
    ):
        x, y = pixel + window[0] - row[0], line + window[1] - row[1]
        yy, xx = (row[SCALE] * correlate1d(plain, SECOND, axis, mode="nearest") for axis in (0, 1))
        xy = -correlate1d(along, FIRST, 0, mode="nearest")
        parts += [
            along,
            down,
            x * along + y * down - wide_x * xx - wide_y * yy,
            x * along - y * down - wide_x * xx + wide_y * yy,
            y * along + x * down - (wide_x + wide_y) * xy,
            *np.zeros((SCALE - DEPTH, *psf.shape)),
            plain,
        ]
        psf += psf_variance[0] * xx + psf_variance[1] * yy
    columns = np.stack([*parts, psf, np.ones_like(psf)])
    free = problem.prior_sigma[:-2].reshape(-1, COUNT) > FIXED
    small = radius_px.max() < EXACT_RADIUS_PX and bool(free[:, DEPTH].all())
    for k in () if rough else range(SIZE if small else DEPTH, SCALE):
        if not free[:, k].any():
            continue
        bodies, step = state.bodies.copy(), np.minimum(STEP, STEP_PX / radius_px)
        step = np.where(bodies[:, k] > 0.0, -step, step)
        bodies[:, k] += step
        there, _, _ = _rendered(picture, window, replace(state, bodies=bodies))
        columns[k:-2:COUNT] = (state.bodies[:, SCALE] / step)[:, None, None] * (there - light)
    return _Derivatives(state, radius_px, columns, rough)


def _slope_differences(picture: BodyPicture, window: Window, state: SceneState) -> FloatArray:
    """Return differences (n, 2, ...) of the light of all bodies as one of them moves, over its scale."""

    def total(index: int, axis: int, step: float) -> FloatArray:
        bodies = state.bodies.copy()
        bodies[index, axis] += step
        light, _, _ = _rendered(picture, window, replace(state, bodies=bodies))
        return np.asarray(np.tensordot(bodies[:, SCALE] / bodies[index, SCALE], light, axes=1))

    steps = 0.5 * DIFFERENCE_PX, -0.5 * DIFFERENCE_PX
    ahead, behind = (
        np.stack([[total(i, axis, step) for axis in (0, 1)] for i in range(len(state.names))])
        for step in steps
    )
    return np.asarray((ahead - behind) / DIFFERENCE_PX)


# ---- What the residuals share: a pattern that the model lacks.

LIT_SHARE = 0.1  # of the peak: pixels that show a surface, not its blurred edge
SIGNIFICANT = 4.0  # sigmas of chi-squared
DRAWS, CORRECTIONS = 4, 3  # of random patterns


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Autocovariance of what a model lacks, relative to its light, over the distance in whole px.

    Attributes
    ----------
    autocovariance : (k,) array
        Down to where it has fallen to nothing.
    """

    autocovariance: FloatArray

    @property
    def contrast(self) -> float:
        """Standard deviation."""
        return float(np.sqrt(self.autocovariance[0]))

    @property
    def area_px2(self) -> float:
        """Pixels that share one value."""
        distance = np.arange(1, len(self.autocovariance))
        shares = self.autocovariance[1:] / self.autocovariance[0]
        return 1.0 + float(2.0 * np.pi * (distance @ shares))

    def _spectrum(self, shape: tuple[int, ...]) -> tuple[list[int], FloatArray]:
        good = [fft.next_fast_len(n + len(self.autocovariance), real=True) for n in shape]
        values = np.append(self.autocovariance, 0.0)
        kernel = np.interp(_distances(good), np.arange(len(values)), values)
        spectrum = np.maximum(fft.rfft2(kernel).real, 0.0)
        return good, spectrum * (values[0] / fft.irfft2(spectrum, good)[0, 0])

    def joined(self, images: FloatArray) -> FloatArray:
        """Return the products (q, q) of images (q, n_line, n_pixel) with each other through the autocovariance."""
        good, kernel = self._spectrum(images.shape[1:])
        spectra = fft.rfft2(images, good)
        double = np.full(spectra.shape[-1], 2.0)  # the half of the spectrum that rfft2 leaves out
        double[0] = 1.0
        if good[1] % 2 == 0:
            double[-1] = 1.0
        flat = spectra.reshape(len(images), -1)
        return symmetric((np.conj(flat) @ (flat * (kernel * double).ravel() / np.prod(good)).T).real)

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Return a random field of such an autocovariance."""
        good, kernel = self._spectrum(shape)
        field = fft.irfft2(fft.rfft2(rng.normal(size=good)) * np.sqrt(kernel), good)
        return np.asarray(field[: shape[0], : shape[1]])


def _distances(shape: list[int]) -> FloatArray:
    """Return the distance of every pixel of a periodic grid from its first."""
    return np.hypot(*np.meshgrid(*(fft.fftfreq(n, 1.0 / n) for n in shape), indexing="ij"))


class _Rings:
    """Autocovariances of residuals over a body's light, averaged over rings of one distance."""

    def __init__(self, weight: FloatArray, light_dn: FloatArray) -> None:
        self.lit = (light_dn > LIT_SHARE * light_dn.max(initial=0.0)) & (weight > 0.0)
        shown = np.where(self.lit, light_dn, 0.0)
        self.shown, self.power = weight * shown, float(np.sum(weight * shown**2))
        self.good = [fft.next_fast_len(2 * n, real=True) for n in shown.shape]
        pairs = self._autocorrelation(weight * shown**2)
        self.near = pairs > 1e-3 * pairs.max()
        self.ring = np.rint(_distances(self.good)[self.near]).astype(np.int64)
        self.pairs = np.maximum(np.bincount(self.ring, pairs[self.near]), 1e-300)

    def _autocorrelation(self, plane: FloatArray) -> FloatArray:
        return np.asarray(fft.irfft2(np.abs(fft.rfft2(plane, self.good)) ** 2, self.good))

    def of(self, residual_dn: FloatArray, variance: float) -> FloatArray:
        """Return the autocovariance over the distance in px, with `variance`, from which noise is taken out, at 0."""
        found = (
            np.bincount(self.ring, self._autocorrelation(self.shown * residual_dn)[self.near]) / self.pairs
        )
        found[0] = variance
        return np.asarray(found)


def _pattern(rings: FloatArray) -> Pattern:
    ends = np.flatnonzero(rings <= 0.0)
    return Pattern(np.minimum(rings[: ends[0] if len(ends) else len(rings)], rings[0]))


def find_pattern(
    residual_dn: FloatArray, weight: FloatArray, light_dn: FloatArray, columns: FloatArray, gain: FloatArray
) -> Pattern | None:
    """Return what residuals share beyond the noise on a body's lit surface; None where they are those of the noise.

    The fit takes part of a pattern for something else. Random patterns are fitted just so, and what they lose is added.

    Parameters
    ----------
    columns, gain : (p, n_line, n_pixel) arrays
        Derivatives of the model, and change of the parameters per DN in each pixel.
    """
    rings = _Rings(weight, light_dn)
    count = int(rings.lit.sum())
    excess = float(np.sum((weight * residual_dn**2)[rings.lit])) - count
    if excess < SIGNIFICANT * np.sqrt(2.0 * max(count, 1)) or count < COUNT:
        return None
    seen = rings.of(residual_dn, excess / rings.power)
    pattern, rng = _pattern(seen), np.random.default_rng(17)
    for _ in range(CORRECTIONS):
        kept = []
        for _ in range(DRAWS):
            field = light_dn * pattern.drawn(rng, light_dn.shape)
            left = field - np.tensordot(np.tensordot(gain, field, axes=2), columns, axes=1)
            kept.append(rings.of(left, float(np.sum((weight * left**2)[rings.lit])) / rings.power))
        lost = -np.mean(kept, axis=0)
        lost[: len(pattern.autocovariance)] += pattern.autocovariance
        pattern = _pattern(seen + np.maximum(lost, 0.0))
    return pattern


# ---- The fit.

MAX_STEPS = 20
FIRST_STEPS = 5  # before what the residuals share is taken into account
MODEL_ERROR = 0.005  # of the light: rendering, PSF beside its width, the detector's response
CONVERGED_PX = 0.01  # a step this small leaves an error of second order, 1e-4 px
CONVERGED_SIGMAS = 0.1
MAX_STEP_PX = 2.0  # linear no farther than the PSF and the limb's curvature allow
FRESH_PX = 0.1  # derivatives that were taken farther away than this are taken anew
GROWTH = 1.01  # chi-squared may grow so much in a step: the weights change with the model
RIDGE = 1e-10  # of a unit diagonal: keeps a parameter that nothing depends on from becoming infinite
PATTERN_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False)
class SceneFit:
    """Bodies fitted to a picture.

    Attributes
    ----------
    light
        Of the bodies (n, n_line, n_pixel) at their scales, DN, rendered at the last step but one.
    rendered
        What is told of them there.
    residual_dn : (n_line, n_pixel) array
        Data minus model and level.
    noise_weight, error_weight, weight : (n_line, n_pixel) arrays
        1 / variance of the noise, of noise and model, and of these and the pattern, with which the bodies were fitted; 0
        for pixels not used.
    columns : (p, n_line, n_pixel) array
        Derivatives of the model.
    prior_sigma : (p,) array
    hits : (n_line, n_pixel) array of bool
        Pixels left out because their light is not that of a body.
    steps : tuple of (p,) arrays
    gain : (p, n_line, n_pixel) array
        Change of the parameters per DN in each pixel.
    pull : (p, p) array
        Error of the parameters for a truth (p,) that differs from what is known of it.
    absorbed
        Share of the pattern's power that the fit took for something else.
    """

    state: SceneState
    light: FloatArray
    rendered: tuple[RenderedBody, ...]
    residual_dn: FloatArray
    noise_weight: FloatArray
    error_weight: FloatArray
    weight: FloatArray
    columns: FloatArray
    prior_sigma: FloatArray
    hits: BoolArray
    steps: tuple[FloatArray, ...]
    converged: bool
    pattern: Pattern | None
    gain: FloatArray
    pull: FloatArray
    absorbed: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def noise_covariance(self) -> FloatArray:
        """Covariance (p, p) of the parameters from the noise of the pixels alone."""
        return self._propagated(self.noise_weight)

    def _propagated(self, weight: FloatArray) -> FloatArray:
        """Return the covariance (p, p) that independent errors of the pixels, of 1 / variance, give the parameters."""
        sigma = np.where(weight > 0.0, 1.0 / np.sqrt(np.where(weight > 0.0, weight, 1.0)), 0.0)
        flat = (self.gain * sigma).reshape(len(self.gain), -1)
        return symmetric(flat @ flat.T)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (p, p) of the parameters: noise, what was not known before, and the pattern."""
        known_sigma = np.where(np.isfinite(self.prior_sigma), self.prior_sigma, 0.0)
        known = self._propagated(self.error_weight) + symmetric((self.pull * known_sigma**2) @ self.pull.T)
        if self.pattern is None:
            return known
        return known + self.pattern.joined(self.gain * self.light.sum(axis=0))

    def corrected(self, shift_px: FloatArray, gain: FloatArray) -> "SceneFit":
        """Return the fit with its first center shifted (2,) by what a gain (2, n_line, n_pixel) makes of the residuals."""
        keep = np.eye(len(self.gain))
        keep[:2] -= np.tensordot(gain, self.columns, axes=((1, 2), (1, 2)))
        total = np.tensordot(keep, self.gain, axes=1)
        total[:2] += gain
        change = np.zeros(len(self.gain))
        change[:2] = shift_px
        return replace(self, state=self.state.moved(change), gain=total, pull=keep @ self.pull)

    @property
    def model_dn(self) -> FloatArray:
        """Bodies and level."""
        return np.asarray(self.light.sum(axis=0) + self.state.level_dn + self.state.psf * self.columns[-2])

    @property
    def chi2_reduced(self) -> float:
        """Weighted square of the residuals per degree of freedom."""
        free = max(int(np.count_nonzero(self.noise_weight)) - len(self.columns), 1)
        return float(np.sum(self.noise_weight * self.residual_dn**2)) / free


def fit_scene(picture: BodyPicture, cutout: Cutout, start: SceneState, solved: BoolArray) -> SceneFit:
    """Fit the bodies of `start` to the pixels of a cutout.

    Parameters
    ----------
    start
        Centers good to about the width of the PSF; brightness and level do not matter.
    solved : (n,) array of bool
        Bodies whose size is not known, as their range is solved for.
    """
    prior = prior_sigmas(picture, start.names, solved)
    problem = _Problem(picture, cutout, prior, np.zeros(cutout.use.shape, dtype=bool), None)
    fit = _minimize(problem, problem.linearized(start, None), most=FIRST_STEPS)
    hits = find_hit_pixels(fit.residual, fit.error_weight)
    if hits.any():
        problem = replace(problem, hits=hits)
        fit = _minimize(problem, problem.linearized(fit.state, fit.derivatives), fit.steps, FIRST_STEPS)
    for _ in range(PATTERN_ROUNDS):
        columns = fit.derivatives.columns
        gain = fit.solved(problem.prior_sigma)[2].reshape(columns.shape)
        pattern = find_pattern(fit.residual, fit.error_weight, fit.light.sum(axis=0), columns, gain)
        if pattern is None and fit.converged:
            break
        problem = replace(problem, pattern=pattern)
        fit = _minimize(problem, problem.linearized(fit.state, fit.derivatives), fit.steps)
    return _finished(problem, fit)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    picture: BodyPicture
    cutout: Cutout
    prior_sigma: FloatArray
    hits: BoolArray
    pattern: Pattern | None

    def linearized(self, state: SceneState, known: _Derivatives | None) -> "_LinearScene":
        """Render a state, and take the derivatives: those `known`, if they are near enough."""
        rough, near = known is None, False
        if known is not None and not known.rough:
            near = _longest(state.vector - known.at.vector, known.radius_px) < FRESH_PX
        light, slopes, bodies = _rendered(self.picture, self.cutout.window, state, derivatives=not near)
        if known is None:
            state = self._brightened(state, light)
        if known is None or not near:
            radius = np.array([max(0.5 * body.diameter_px, 1.0) for body in bodies])
            hidden = len(bodies) > 1 and any(body.occulted_fraction > 0.0 for body in bodies)
            known = _differentiated(self, state, light, slopes, radius, differences=hidden, rough=rough)
        light = state.bodies[:, SCALE, None, None] * light
        total = light.sum(axis=0)
        noise_weight = np.where(self.hits, 0.0, self.cutout.weight(total))
        weight = error_weight = noise_weight / (1.0 + noise_weight * (MODEL_ERROR * total) ** 2)
        if self.pattern is not None:
            pattern_variance = self.pattern.area_px2 * (self.pattern.contrast * total) ** 2
            weight = error_weight / (1.0 + error_weight * pattern_variance)
        model = total + state.psf * known.columns[-2] + state.level_dn
        prior = float(np.sum((state.vector / self.prior_sigma) ** 2))
        return _LinearScene(
            state,
            light,
            bodies,
            known,
            noise_weight,
            error_weight,
            weight,
            self.cutout.data_dn - model,
            prior,
        )

    def _brightened(self, state: SceneState, light: FloatArray) -> SceneState:
        """Return the state with the brightness and level that suit the data best."""
        weight = np.where(self.hits, 0.0, self.cutout.weight()).ravel()
        design = np.concatenate([light, np.ones((1, *light.shape[1:]))]).reshape(len(light) + 1, -1)
        solved = _inverse((design * weight) @ design.T) @ (design @ (weight * self.cutout.data_dn.ravel()))
        bodies = state.bodies.copy()
        bodies[:, SCALE] = solved[:-1]
        return replace(state, bodies=bodies, level_dn=float(solved[-1]))


@dataclass(frozen=True, slots=True, eq=False)
class _LinearScene:
    """The model and its derivatives at a state."""

    state: SceneState
    light: FloatArray
    rendered: tuple[RenderedBody, ...]
    derivatives: _Derivatives
    noise_weight: FloatArray
    error_weight: FloatArray
    weight: FloatArray
    residual: FloatArray
    prior_chi2: float
    steps: tuple[FloatArray, ...] = ()
    converged: bool = False

    @property
    def cost(self) -> float:
        """Chi-squared per pixel."""
        chi2 = float(np.sum(self.weight * self.residual**2)) + self.prior_chi2
        return chi2 / max(float(np.count_nonzero(self.weight)), 1.0)

    def solved(self, prior_sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the change (p,) of the parameters, their inverse information (p, p), and the gain (p, n_pixels)."""
        columns = self.derivatives.columns.reshape(len(prior_sigma), -1)
        weighted = columns * self.weight.ravel()
        inverse = _inverse(symmetric(weighted @ columns.T) + np.diag(prior_sigma**-2.0))
        right = weighted @ self.residual.ravel() - self.state.vector / prior_sigma**2
        return inverse @ right, inverse, inverse @ weighted


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse of a matrix scaled to a unit diagonal; 0 for a parameter that nothing depends on."""
    diagonal = np.diag(information)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    scaled = information * scale[:, None] * scale + np.diag(np.where(diagonal > 0.0, RIDGE, 1.0))
    return symmetric(scale[:, None] * np.linalg.inv(scaled) * scale)


def _longest(change: FloatArray, radius_px: FloatArray) -> float:
    """Return how far a change of the parameters moves centers and limbs, px."""
    bodies = change[:-2].reshape(-1, COUNT)
    return float(
        np.abs(np.column_stack([bodies[:, :SIZE], bodies[:, SIZE:DEPTH] * radius_px[:, None]])).max()
    )


def _minimize(
    problem: _Problem, linear: _LinearScene, steps: tuple[FloatArray, ...] = (), most: int = MAX_STEPS
) -> _LinearScene:
    """Step until the steps are small; a step that makes the fit worse is halved."""
    for _ in range(most):
        change, inverse, _ = linear.solved(problem.prior_sigma)
        little = bool(np.all(np.abs(change) <= CONVERGED_SIGMAS * np.sqrt(np.diag(inverse))))
        length = _longest(change, linear.derivatives.radius_px)
        small = length < CONVERGED_PX or (little and length < FRESH_PX)
        change = change * min(1.0, MAX_STEP_PX / max(length, 1e-300))
        steps = (*steps, change)
        if small and not linear.derivatives.rough:
            return replace(linear, steps=steps, converged=True)
        previous, linear = linear, problem.linearized(linear.state.moved(change), linear.derivatives)
        if linear.cost > GROWTH * previous.cost:
            steps = (*steps[:-1], 0.5 * change)
            linear = problem.linearized(previous.state.moved(0.5 * change), previous.derivatives)
    return replace(linear, steps=steps)


def _finished(problem: _Problem, linear: _LinearScene) -> SceneFit:
    """Carry the last, small step through the linear model instead of rendering once more, and find the covariance."""
    sigma, columns = problem.prior_sigma, linear.derivatives.columns
    change, inverse, gain = linear.solved(sigma)
    if not linear.converged:
        change = np.zeros_like(change)
    gain = gain.reshape(columns.shape)
    absorbed = 0.0
    if problem.pattern is not None:
        total = linear.light.sum(axis=0)
        shares = problem.pattern.joined(columns * (linear.weight * total))
        power = problem.pattern.contrast**2 * float(np.sum(linear.weight * total**2))
        absorbed = float(np.trace(inverse @ shares)) / power
    return SceneFit(
        state=linear.state.moved(change),
        light=linear.light,
        rendered=linear.rendered,
        residual_dn=linear.residual - np.tensordot(change, columns, axes=1),
        noise_weight=linear.noise_weight,
        error_weight=linear.error_weight,
        weight=linear.weight,
        columns=columns,
        prior_sigma=sigma,
        hits=problem.hits,
        steps=linear.steps,
        converged=linear.converged,
        pattern=problem.pattern,
        gain=gain,
        pull=np.where(np.isfinite(sigma), inverse * sigma**-2.0, 0.0),
        absorbed=absorbed,
    )
