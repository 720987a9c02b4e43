"""The effective PSF of a picture: what its stars together say of the light's distribution beyond a Gaussian.

An undersampled star falls on four or five pixels, which tell its flux, place and level, and hardly its shape: taken for
a Gaussian, its center errs with the sub-pixel phase, and no residual shows it. The stars of a picture share one PSF and
fall at different phases; all of them together determine a correction to the Gaussian (`psf.correction`), linear in
its modes. Every star's own flux, center, level and shape, which scatters as the stars tell, are eliminated from the normal
equations, so that the correction has its true covariance, and the variance of each layer of modes (MacKay 1992).
Where the catalog's places are known they help: a shift, turn and scale of all of them are free.

Without them the modes that move all stars of a phase alike are known by nothing but the prior, and the covariance says so.
What a Gaussian fit calls center and flux, in the mean over all phases, stays: modes that would change it are taken out.

References: Anderson & King (2000), doi:10.1086/316632; MacKay (1992), doi:10.1162/neco.1992.4.3.415.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.psf import PsfCorrection, PsfEvidence, box_integrals
from opnav_workbench.psf.correction import (
    PRIOR_AMPLITUDES,
    mode_layers,
    mode_products,
    mode_shares,
    phases_of_a_pixel,
    round_and_other,
)
from opnav_workbench.stars.boxes import Pixels, box_corners, cut_at
from opnav_workbench.stars.group_fit import FitSettings
from opnav_workbench.stars.results import NoiseModel, ShapePrior, StarCenters

__all__ = ["ExpectedPlaces", "learn_correction", "prior_correction", "unknown_correction"]

PRIOR_COUNT = 1.0  # modes that this is worth beside the group's own: a PSF without rings shall say so
MOST_VARIANCE = (
    36.0  # of the prior's: what no star tells, such as light all over a box, would grow without end
)
PASSES = (
    6  # of the linear problem about the centers that the one before found; the last moves them by 1e-3 px
)
VARIANCE_STEPS = 3  # of the layers' variances in a pass
FULL_INVERSE = 32  # rows below which halving a triangular matrix takes longer than it saves
MAX_STEP_PX = 0.3
JUDGED_FROM = 3  # pass from which places worse than stated count for less: before, a wrong PSF scatters them
MISFIT_SIGMAS = 3.0  # of all stars together
PHASE_ERROR_PX = 0.1  # of centers by a wrong PSF
STRANGE_MISFIT = (
    3.0  # times what the PSF usually leaves of a star's light over: double stars, hits, saturation
)
PLACE_FLOOR_PX = 0.03  # of expected places: the camera's distortion is rarely known better
MAX_PLACE_SIGMAS = 4.0  # a star farther from its place than this has another motion, or is another star
FLAT = 1e-12  # prior information of what is free
# Of log scale and ellipticity from star to star, all alike likely: from what no star can show to more than colors make.
# A few are odd: close pairs.
SHAPE_SCATTERS = (0.001, 0.0015, 0.0022, 0.0033, 0.005, 0.0075, 0.011, 0.016, 0.024)
ODD_SHAPE, ODD_SHARE = 0.1, 0.05
# Fewer stars, which teach the PSF as well, are taken for too alike: ten in real LORRI frames made 0.4 arcsec of 0.3.
FEWEST_ALIKE = 20
FLUX, PIXEL, LINE, SCALE, E1, E2, LEVEL = range(7)
CENTER = slice(PIXEL, SCALE)


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedPlaces:
    """Where the catalog's stars are expected, up to a common shift, turn and scale.

    Attributes
    ----------
    pixel_line : (n, 2) array
    sigma_px : (n,) array
        Of each place, along each axis; infinite where nothing is known.
    """

    pixel_line: FloatArray
    sigma_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def take(self, rows: IntArray) -> Self:
        """Return some of them."""
        return replace(self, pixel_line=self.pixel_line[rows], sigma_px=self.sigma_px[rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations of every star's own parameters (n, 7), and of what all share (k,)."""

    own: FloatArray  # (n, 7, 7)
    mixed: FloatArray  # (n, 7, k)
    shared: FloatArray  # (k, k)
    own_right: FloatArray  # (n, 7)
    shared_right: FloatArray  # (k,)

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """Return matrix (k, k) and right-hand side (k,) of what is shared, the stars' own parameters eliminated."""
        k = len(self.shared)
        solved = np.linalg.solve(self.own, np.concatenate([self.mixed, self.own_right[:, :, None]], axis=2))
        flat = self.mixed.reshape(-1, k).T @ solved.reshape(-1, k + 1)
        return self.shared - flat[:, :k], self.shared_right - flat[:, k]

    def own_steps(self, shared: FloatArray) -> FloatArray:
        """Return the stars' own parameters (n, 7) for given shared ones."""
        right = self.own_right - self.mixed @ shared
        return np.asarray(np.linalg.solve(self.own, right[:, :, None])[:, :, 0])

    def with_places(self, centers: FloatArray, places: ExpectedPlaces, *, judged: bool) -> "_Normal":
        """Add the expected places, and their common shift, turn and scale behind the shared parameters."""
        n, _, k = self.mixed.shape
        basis = _similarity(places.pixel_line)
        offset = places.pixel_line - centers
        weight = _place_weights(offset, basis, places.sigma_px, judged=judged)
        own, mixed = self.own.copy(), np.concatenate([self.mixed, np.zeros((n, 7, 4))], axis=2)
        right = self.own_right.copy()
        own[:, [PIXEL, LINE], [PIXEL, LINE]] += weight[:, None]
        mixed[:, CENTER, k:] = -weight[:, None, None] * basis
        right[:, CENTER] += weight[:, None] * offset
        shared = np.zeros((k + 4, k + 4))
        shared[:k, :k] = self.shared
        shared[k:, k:] = np.einsum("n,nai,naj->ij", weight, basis, basis) + FLAT * np.eye(4)
        moved = -np.einsum("n,nai,na->i", weight, basis, offset)
        return _Normal(own, mixed, shared, right, np.concatenate([self.shared_right, moved]))


def learn_correction(
    pixels: Pixels,
    stars: StarCenters,
    rows: IntArray,
    psf: ShapePrior,
    settings: FitSettings,
    places: ExpectedPlaces | None = None,
    kept: PsfEvidence | None = None,
) -> PsfCorrection:
    """Return what the stars `rows` say of the PSF beyond the Gaussian `psf`, by whose sigmas their shapes may differ.

    Parameters
    ----------
    pixels
        The picture.
    stars, rows
        From a fit with a Gaussian, and those of them (m,) that are isolated and well exposed.
    settings
        Of that fit: size of the boxes, noise.
    places
        Where the catalog has the same stars, where that is known.
    kept
        What other pictures say of the same PSF; their Gaussian is `psf`, too.
    """
    known = np.column_stack([stars.flux_dn, stars.pixel_line, stars.background_dn])[rows]
    places = None if places is None else places.take(rows)
    usual = _UsualModes.about(psf, settings.size)
    layers, variance = mode_layers(), _prior_variance()
    correction = PsfCorrection(psf.sigma_px, np.zeros(len(layers)), np.zeros((len(layers), 0)))
    if kept is not None:
        correction = prior_correction(psf, settings.size, kept)
    for step in range(PASSES):
        learned = step > 0 or kept is not None
        normal = _normal_equations(pixels, known, psf, correction, usual, settings, learned)
        if places is not None:
            normal = normal.with_places(known[:, 1:3], places, judged=step >= JUDGED_FROM)
        matrix, right = normal.reduced()
        own_matrix, own_right, back = _without_places(matrix, right, len(layers))
        own = PsfEvidence(own_matrix, own_right)
        known_of_it = own if kept is None else PsfEvidence.total([own, kept])
        amplitudes, root, variance = _modes_with_variances(known_of_it, variance)
        shared = np.concatenate([amplitudes, back(amplitudes)])
        # One PSF for all stars: do they differ?
        if len(rows) >= FEWEST_ALIKE and psf.sigma_log_scale <= SHAPE_SCATTERS[-1]:
            scatter = _shape_scatter(normal, shared, psf)
            psf = replace(psf, sigma_log_scale=scatter, sigma_ellipticity=scatter)
        correction = PsfCorrection(
            psf.sigma_px, usual.of(amplitudes), usual.of(root), own, len(rows), psf.sigma_log_scale
        )
        known = known + _limited(normal.own_steps(shared))
    return correction


def prior_correction(psf: ShapePrior, size: int, kept: PsfEvidence) -> PsfCorrection:
    """Return the correction of the Gaussian `psf` that other pictures teach, with its covariance."""
    usual, variance = _UsualModes.about(psf, size), _prior_variance()
    for _ in range(PASSES):
        amplitudes, root, variance = _modes_with_variances(kept, variance)
    return PsfCorrection(psf.sigma_px, usual.of(amplitudes), usual.of(root))


def unknown_correction(psf: ShapePrior, size: int) -> PsfCorrection:
    """Return no correction, with the covariance of what PSFs leave of a Gaussian where no star tells."""
    sigma = np.asarray(PRIOR_AMPLITUDES)[mode_layers()]
    return PsfCorrection(psf.sigma_px, np.zeros(len(sigma)), _UsualModes.about(psf, size).of(np.diag(sigma)))


@dataclass(frozen=True, slots=True, eq=False)
class _UsualModes:
    """Projection that takes from the modes what a Gaussian fit would call a shift or more flux."""

    taken: FloatArray  # (k, 3) orthonormal

    @classmethod
    def about(cls, psf: ShapePrior, size: int) -> Self:
        """Return that about a Gaussian, for boxes of a size."""
        center = phases_of_a_pixel()
        first = np.full(center.shape, -(size // 2.0))
        gaussian = box_integrals(center, np.broadcast_to(psf.mean, (len(center), 3)), first, size)
        light = np.stack([gaussian.value, gaussian.d_pixel, gaussian.d_line])
        return cls(np.linalg.qr(mode_products(psf.sigma_px, center, first, size, light))[0])

    def of(self, values: FloatArray) -> FloatArray:
        """Return what is left of values (k, ...), one a mode."""
        return np.asarray(values - self.taken @ (self.taken.T @ values))


def _normal_equations(
    pixels: Pixels,
    known: FloatArray,
    psf: ShapePrior,
    correction: PsfCorrection,
    usual: _UsualModes,
    settings: FitSettings,
    learned: bool,
) -> _Normal:
    """Normal equations about flux, center and level (n, 4) and the correction so far; its modes are sought as a whole."""
    n, size, center = len(known), settings.size, known[:, 1:3]
    boxes = cut_at(pixels, box_corners(pixels, center, size), size)
    first = boxes.first.astype(float)
    gaussian = box_integrals(center, np.broadcast_to(psf.mean, (n, 3)), first, size)
    corrected = correction.evaluate(center, first, size)
    flux, value = known[:, :1, None], gaussian.value + corrected[0]
    derivatives = (
        gaussian.d_pixel + corrected[1], gaussian.d_line + corrected[2],
        gaussian.d_log_scale, gaussian.d_e1, gaussian.d_e2,
    )  # fmt: skip
    columns = (value, *(flux * d for d in derivatives), np.ones_like(value))
    jacobian = np.stack(columns, axis=1).reshape(n, 7, -1)
    light = (flux * value).reshape(n, -1)
    variance = boxes.variance_dn2.reshape(n, -1) + _shot_noise(light, settings.noise_model)
    residual = boxes.data_dn.reshape(n, -1) - light - known[:, 3:]
    error = _model_error(residual, light, variance)
    weight = _star_weights(residual, light, variance, error)
    variance += (error * light) ** 2 if learned else 0.0
    variance /= weight[:, None]
    residual += (flux * corrected[0]).reshape(n, -1)
    shares = mode_shares(psf.sigma_px, center, first, size).reshape(n * size**2, -1)
    modes = flux * usual.of(shares.T).T.reshape(n, size**2, -1)
    weighted = jacobian / variance[:, None]
    scatter = np.diag([FLAT, FLAT, FLAT, *psf.information, FLAT])
    root = (modes / np.sqrt(variance)[:, :, None]).reshape(n * size**2, -1)
    return _Normal(
        own=np.matmul(weighted, np.swapaxes(jacobian, 1, 2)) + scatter,
        mixed=np.matmul(weighted, modes),
        shared=root.T @ root,
        own_right=np.matmul(weighted, residual[:, :, None])[:, :, 0],
        shared_right=root.T @ (residual / np.sqrt(variance)).ravel(),
    )


def _model_error(residual: FloatArray, light: FloatArray, variance: FloatArray) -> float:
    """Part of the stars' light (n, m) that neither noise nor the PSF learned so far explains: flat field, color, blends."""
    freedom = np.isfinite(variance).sum(axis=1) - 4.0
    excess = np.sum(residual**2 / variance, axis=1) - freedom
    if (
        float(np.median(excess / np.sqrt(2.0 * np.maximum(freedom, 1.0)))) * np.sqrt(len(excess))
        < MISFIT_SIGMAS
    ):
        return 0.0
    return float(np.sqrt(np.median(np.maximum(excess, 0.0) / np.sum(light**2 / variance, axis=1))))


def _star_weights(residual: FloatArray, light: FloatArray, variance: FloatArray, error: float) -> FloatArray:
    """Weights (n,) of stars: 1, and less for those that leave far more over than noise and the usual error of the PSF."""
    freedom = np.maximum(np.isfinite(variance).sum(axis=1) - 4.0, 1.0)
    usual = freedom + error**2 * np.sum(light**2 / variance, axis=1)
    strange = np.sum(residual**2 / variance, axis=1) / usual
    return np.asarray(np.minimum(STRANGE_MISFIT**2 / np.maximum(strange, 1e-9), 1.0) ** 2)


def _shot_noise(light: FloatArray, noise: NoiseModel | None) -> FloatArray | float:
    return 0.0 if noise is None else np.maximum(light, 0.0) / noise.gain_e_per_dn


def _similarity(places: FloatArray) -> FloatArray:
    """Shift, turn and scale of places (n, 2): (n, 2, 4), of order 1."""
    offset = places - places.mean(axis=0)
    x, y = (offset / max(float(np.abs(offset).max()), 1.0)).T
    one, none = np.ones_like(x), np.zeros_like(x)
    return np.stack([np.stack([one, none, x, -y], 1), np.stack([none, one, y, x], 1)], axis=1)


def _place_weights(
    offset: FloatArray, basis: FloatArray, sigma_px: FloatArray, *, judged: bool
) -> FloatArray:
    """Weights (n,) of places that lie off by `offset` (n, 2); 0 for those that nothing brings near the others."""
    variance = sigma_px**2 + PLACE_FLOOR_PX**2
    weight, allowed = 1.0 / variance, variance + (0.0 if judged else PHASE_ERROR_PX**2)
    for _ in range(3):
        normal = np.einsum("n,nai,naj->ij", weight, basis, basis) + FLAT * np.eye(4)
        moved = basis @ np.linalg.solve(normal, np.einsum("n,nai,na->i", weight, basis, offset))
        square = np.sum((offset - moved) ** 2, axis=1) / allowed
        worse = 1.0
        if judged and np.any(weight > 0.0):
            # Of two degrees of freedom the median is 2 ln 2.
            worse = max(float(np.median(square[weight > 0.0])) / (2.0 * np.log(2.0)), 1.0)
        weight = np.where(square <= MAX_PLACE_SIGMAS**2 * worse, 1.0 / (variance * worse), 0.0)
    return np.asarray(weight)


def _without_places(matrix: FloatArray, right: FloatArray, k: int) -> tuple[FloatArray, FloatArray, "_Back"]:
    """Eliminate what stands behind the k modes; the last item tells it from the modes."""
    solved = np.asarray(
        np.linalg.solve(matrix[k:, k:], np.column_stack([matrix[k:, :k], right[k:]])), np.float64
    )
    return (
        matrix[:k, :k] - matrix[:k, k:] @ solved[:, :k],
        right[:k] - matrix[:k, k:] @ solved[:, k],
        _Back(solved),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Back:
    """From the modes to what was eliminated."""

    solved: FloatArray

    def __call__(self, amplitudes: FloatArray) -> FloatArray:
        return np.asarray(self.solved[:, -1] - self.solved[:, :-1] @ amplitudes)


def _prior_variance() -> FloatArray:
    """Return the variance of the modes of each group."""
    return np.repeat(np.square(PRIOR_AMPLITUDES), 2)


def _modes_with_variances(
    known: PsfEvidence, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Amplitudes (k,), root (k, k) of their covariance, and the variance of each group that explains them."""
    (turn, groups), prior = round_and_other(), _prior_variance()
    count = np.bincount(groups, minlength=len(prior))
    matrix, right = turn.T @ known.matrix @ turn, turn.T @ known.right
    for _ in range(VARIANCE_STEPS):
        sigma = np.sqrt(variance)[groups]
        scaled = sigma[:, None] * matrix * sigma + np.eye(len(sigma))
        lower = np.asarray(np.linalg.cholesky(scaled), np.float64)
        root = sigma[:, None] * _inverse_of_lower(lower).T
        amplitudes = root @ (root.T @ right)
        square = np.bincount(groups, amplitudes**2 + np.sum(root**2, axis=1), len(prior))
        variance = np.minimum((square + PRIOR_COUNT * prior) / (count + PRIOR_COUNT), MOST_VARIANCE * prior)
    return turn @ amplitudes, turn @ root, variance


def _inverse_of_lower(matrix: FloatArray) -> FloatArray:
    """Invert a lower triangular matrix (k, k) half by half: NumPy has no inverse but that of a full one."""
    k = len(matrix)
    if k <= FULL_INVERSE:
        return np.asarray(np.linalg.inv(matrix), np.float64)
    half = k // 2
    first, second = _inverse_of_lower(matrix[:half, :half]), _inverse_of_lower(matrix[half:, half:])
    inverse = np.zeros_like(matrix)
    inverse[:half, :half], inverse[half:, half:] = first, second
    inverse[half:, :half] = -second @ (matrix[half:, :half] @ first)
    return inverse


def _shape_scatter(normal: _Normal, shared: FloatArray, psf: ShapePrior) -> float:
    """Scatter of log scale and ellipticity from star to star that is to be expected from how these stars differ."""
    n = len(normal.own)
    right = normal.own_right - normal.mixed @ shared
    shape, rest = [SCALE, E1, E2], [FLUX, PIXEL, LINE, LEVEL]
    own = normal.own - np.diag([0.0, 0.0, 0.0, *psf.information, 0.0])
    across = own[:, rest][:, :, shape]
    known = np.concatenate([across, right[:, rest, None]], axis=2)
    solved = np.swapaxes(across, 1, 2) @ np.linalg.solve(own[:, rest][:, :, rest], known)
    value, vector = np.linalg.eigh(own[:, shape][:, :, shape] - solved[:, :, :3])
    pull = (np.swapaxes(vector, 1, 2) @ (right[:, shape] - solved[:, :, 3])[:, :, None])[:, :, 0]
    variance = np.square([*SHAPE_SCATTERS, ODD_SHAPE])[:, None, None]
    spread = 1.0 + variance * np.maximum(value, 0.0)
    told = 0.5 * np.sum(variance * pull**2 / spread - np.log(spread), axis=2)  # (scatters + 1, n)
    each = np.logaddexp(np.log1p(-ODD_SHARE) + told[:-1], np.log(ODD_SHARE) + told[-1]).reshape(-1, n)
    total = each.sum(axis=1)
    return float(np.average(SHAPE_SCATTERS, weights=np.exp(total - total.max())))


def _limited(steps: FloatArray) -> FloatArray:
    """Steps of flux, center and level (n, 4)."""
    center = np.clip(steps[:, CENTER], -MAX_STEP_PX, MAX_STEP_PX)
    return np.column_stack([steps[:, FLUX], center, steps[:, LEVEL]])
