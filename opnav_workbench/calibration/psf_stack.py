"""An empirical PSF stacked from the bright stars of many pictures.

Flow   pictures -> Gaussian fits -> pictures that share one shape -> cells -> centers with these cells -> cells again
Units  px, DN; cells of 1/oversampling px

The cells are the difference from the mean Gaussian, so that few or noisy stars leave that; how smooth the difference
must be is what explains stars best that were not in the stack. Gaussian centers of an undersampled PSF err with the
sub-pixel phase, and cells stacked on them are blurred by it. The cells themselves give better centers, whose common
shift is taken out: the PSF's own origin stays where Gaussian fits put it in the mean over all phases, so that both
methods measure the same point. Pictures whose stars have another shape (smear, focus) are left out: a stack of both would
fit neither to better than the Gaussian does. Idea: Anderson & King (2000), doi 10.1086/316632.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.constants import FWHM_PER_SIGMA, PIXEL_VARIANCE_PX2
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, Psf
from opnav_workbench.psf.empirical import cells_from_stars
from opnav_workbench.stars import NoiseModel, ShapePrior, StarCenters, default_box_px, fit_gaussian, fit_psf

__all__ = ["PsfCalibration", "PsfPicture", "stack_psf"]


# ---- Pictures for a PSF stack, and which of them show stars of one shape.

# Second moments, pixel included, that differ by more than this part are those of another smear or focus: a stack of both
# would fit neither to better than the Gaussian does.
SHAPE_TOLERANCE = 0.2
MIN_SIGMA_PX = 0.15  # below this a Gaussian is one pixel, whatever its sigma


@dataclass(frozen=True, slots=True, eq=False)
class PsfPicture:
    """One picture and its bright, isolated stars; arrays are read-only.

    Attributes
    ----------
    signal_dn, noise_dn : (n_line, n_pixel) arrays
        Picture without background, and its 1-sigma noise without the stars' own.
    bad : (n_line, n_pixel) array of bool
        Pixels to leave out, also saturated ones.
    pixel_line : (n, 2) array
        First centers, good to a pixel.
    noise_model
        For the stars' shot noise.
    """

    name: str
    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    pixel_line: FloatArray
    noise_model: NoiseModel | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def shape_moments(fit: StarCenters) -> FloatArray:
    """Return second moments (n, 3) px^2 of fitted shapes: along pixel, mixed, along line; usable stars only."""
    major2, minor2, angle = fit.shape[:, 0] ** 2, fit.shape[:, 1] ** 2, fit.shape[:, 2]
    mean, half = 0.5 * (major2 + minor2), 0.5 * (major2 - minor2)
    even, odd = half * np.cos(2.0 * angle), half * np.sin(2.0 * angle)
    return np.stack([mean + even, odd, mean - even], axis=1)[fit.usable]


def gaussian_of_moments(second_moments: FloatArray) -> GaussianPsf:
    """Return the Gaussian of second moments (3,)."""
    along, mixed, across = second_moments
    values, axes = np.linalg.eigh(np.array([[along, mixed], [mixed, across]]))
    minor, major = np.sqrt(np.maximum(values, MIN_SIGMA_PX**2))
    return GaussianPsf(float(major), float(minor), float(np.arctan2(axes[1, 1], axes[0, 1])))


def frames_of_one_shape(
    pictures: Sequence[PsfPicture], fits: Sequence[StarCenters]
) -> tuple[BoolArray, tuple[str, ...]]:
    """Return which pictures (m,) have stars of the commonest shape, and a word on each of the others."""
    of_picture = [shape_moments(fit) for fit in fits]
    common = np.median(np.concatenate(of_picture), axis=0) if sum(map(len, of_picture)) else np.zeros(3)
    size = 0.5 * (common[0] + common[2]) + PIXEL_VARIANCE_PX2
    used, words = np.zeros(len(pictures), dtype=bool), []
    for i, (picture, own) in enumerate(zip(pictures, of_picture, strict=True)):
        if not len(own):
            words.append(f"{picture.name}: no bright star, left out")
            continue
        shape = np.median(own, axis=0)
        used[i] = bool(np.abs(shape - common).max() <= SHAPE_TOLERANCE * size)
        if not used[i]:
            mine = gaussian_of_moments(shape)
            words.append(
                f"{picture.name}: its stars are of another shape "
                f"({mine.sigma_major_px:.2f} x {mine.sigma_minor_px:.2f} px), smeared perhaps; left out"
            )
    return used, tuple(words)


# ---- What calibrations hold; arrays are read-only.


@dataclass(frozen=True, slots=True, eq=False)
class PsfCalibration:
    """An empirical PSF and how much better than a Gaussian it explains its stars.

    Attributes
    ----------
    smoothness
        Weight of the cells' second differences that explained other stars best.
    gaussian_chi2, empirical_chi2 : (n_stars,) arrays
        Reduced chi-squared of the stars' images, fitted with their mean Gaussian and with the new PSF.
    held_out_chi2
        Median of the latter for stars that were left out of the stack.
    moved_px
        Root mean square shift between Gaussian and empirical centers, per coordinate.
    used_pictures : (m,) array of bool
        False for pictures whose stars have another shape.
    """

    psf: EmpiricalPsf
    n_stars: int
    smoothness: float
    gaussian_chi2: FloatArray
    empirical_chi2: FloatArray
    held_out_chi2: float
    moved_px: float
    used_pictures: BoolArray
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- An empirical PSF stacked from the bright stars of many pictures.

CELLS_PER_FWHM = 4.0  # keep shares good to 4e-4 (see `EmpiricalPsf`)
STARS_PER_CELL = 4.0  # of a pixel: phases are random, so cells would stay empty with fewer
MIN_OVERSAMPLING, MAX_OVERSAMPLING = 2, 8  # one cell a pixel is a picture of one phase
SMOOTHNESS = (1e-3, 1e-2, 1e-1, 1.0)  # of which the best is taken
FOLDS = 2
LIGHT_ERROR = 0.01  # of a star's light in a pixel: centers good to 0.01 px
PASSES = 3  # of cells and centers: the third changes centers by less than 0.002 px
MAX_MISFIT = 3.0  # times the median: a star that looks so different is a blend or was hit
HALF_SIZE_SIGMAS = 8.0  # a Gaussian ends at 4; the rest is room for wings
MIN_HALF_SIZE_PX, MAX_HALF_SIZE_PX = 4.0, 12.0


def stack_psf(
    pictures: Sequence[PsfPicture],
    prior: ShapePrior,
    *,
    oversampling: int | None = None,
    half_size_px: float | None = None,
) -> PsfCalibration:
    """Stack the stars of many pictures to an oversampled PSF.

    Parameters
    ----------
    prior
        The PSF as it is known, for the first centers.
    oversampling
        Cells a pixel; by default four to the width at half maximum, or as many as the stars can fill.
    half_size_px
        Half the side of the template.

    Raises
    ------
    CameraError
        Too few stars to fill the cells.
    """
    gaussian = [_gaussian_fit(picture, prior) for picture in pictures]
    used, messages = frames_of_one_shape(pictures, gaussian)
    chosen = [picture for picture, take in zip(pictures, used, strict=True) if take]
    fits = [fit for fit, take in zip(gaussian, used, strict=True) if take]
    starts = [_PictureStars(fit.pixel_line, _trusted_flux(fit)) for fit in fits]
    n_stars = sum(stars.count for stars in starts)
    cells, note = _oversampling(n_stars, prior.sigma_px, oversampling)
    half = _half_size(prior.sigma_px) if half_size_px is None else half_size_px
    stack = _Stack(chosen, _mean_gaussian(fits), cells, half, default_box_px(prior.sigma_px))
    smoothness, held_out = _best_smoothness(stack, starts)
    psf, stars = stack.iterate(starts, smoothness)
    return _result(stack, psf, fits, stars, smoothness, held_out, used, (*messages, *note))


@dataclass(frozen=True, slots=True, eq=False)
class _PictureStars:
    """Centers (n, 2) of one picture's stars, and fluxes (n,), nan for those that do not count."""

    pixel_line: FloatArray
    flux_dn: FloatArray

    @property
    def count(self) -> int:
        return int(np.isfinite(self.flux_dn).sum())

    def only(self, keep: BoolArray) -> "_PictureStars":
        return _PictureStars(self.pixel_line, np.where(keep, self.flux_dn, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """All pictures one below the other, with masked rows between, so that one least squares serves them all."""

    pictures: Sequence[PsfPicture]
    base: GaussianPsf
    oversampling: int
    half_size_px: float
    box_px: int
    _image: FloatArray = field(init=False)
    _bad: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        gap = ((0, self._gap), (0, 0))
        image = np.concatenate([np.pad(picture.signal_dn, gap) for picture in self.pictures])
        bad = np.concatenate([np.pad(picture.bad, gap, constant_values=True) for picture in self.pictures])
        object.__setattr__(self, "_image", image)
        object.__setattr__(self, "_bad", bad)

    @property
    def _gap(self) -> int:
        return int(np.ceil(self.half_size_px)) + 2

    def cells(self, stars: Sequence[_PictureStars], smoothness: float) -> EmpiricalPsf:
        """Return the PSF of stars whose centers and fluxes are known."""
        lines = np.cumsum([0, *(len(picture.signal_dn) + self._gap for picture in self.pictures[:-1])])
        base = EmpiricalPsf(self.base.kernel(self.oversampling), self.oversampling)
        places = [s.pixel_line + np.array([0.0, line]) for s, line in zip(stars, lines, strict=True)]
        samples = cells_from_stars(
            self._image,
            self._bad,
            np.concatenate(places),
            np.concatenate([s.flux_dn for s in stars]),
            self.oversampling,
            half_size_px=self.half_size_px,
            base=base,
            smoothness=smoothness,
            weights=np.concatenate(self._weights(stars)),
        )
        return EmpiricalPsf(samples, self.oversampling)

    def _weights(self, stars: Sequence[_PictureStars]) -> list[FloatArray]:
        """Inverse errors of the pixels of stars: noise, and a part of their light, so that no star outweighs many."""
        noise = [float(np.median(picture.noise_dn)) for picture in self.pictures]
        return [1.0 / np.hypot(sigma, LIGHT_ERROR * s.flux_dn) for sigma, s in zip(noise, stars, strict=True)]

    def fit(self, psf: Psf, stars: Sequence[_PictureStars]) -> list[StarCenters]:
        """Fit the stars with a PSF; a PSF still wrong leaves residuals at bright stars that are no hits."""
        return [
            fit_psf(
                picture.signal_dn,
                picture.noise_dn,
                picture.bad,
                s.pixel_line,
                psf,
                box_px=self.box_px,
                noise_model=picture.noise_model,
                joint=False,
                mask_hits=False,
            )
            for picture, s in zip(self.pictures, stars, strict=True)
        ]

    def iterate(
        self, stars: Sequence[_PictureStars], smoothness: float, passes: int = PASSES
    ) -> tuple[EmpiricalPsf, list[_PictureStars]]:
        """Return the PSF after improving centers with it, and the stars as they then are."""
        now = list(stars)
        for _ in range(passes):
            fits = self.fit(self.cells(now, smoothness), now)
            now = _improved(now, fits)
        return self.cells(now, smoothness), now


def _improved(before: Sequence[_PictureStars], fits: Sequence[StarCenters]) -> list[_PictureStars]:
    """New centers without their common shift, new fluxes; stars unlike the others no longer count."""
    known = [np.isfinite(s.flux_dn) & fit.usable for s, fit in zip(before, fits, strict=True)]
    shifts = [(fit.pixel_line - s.pixel_line)[ok] for s, fit, ok in zip(before, fits, known, strict=True)]
    shift = np.median(np.concatenate(shifts), axis=0)
    odd = _unlike_others(fits, known)
    return [
        _PictureStars(
            np.where(ok[:, None], fit.pixel_line - shift, s.pixel_line),
            np.where(ok & ~strange, fit.flux_dn, np.nan),
        )
        for s, fit, ok, strange in zip(before, fits, known, odd, strict=True)
    ]


def _unlike_others(fits: Sequence[StarCenters], known: Sequence[BoolArray]) -> list[BoolArray]:
    """Stars that fit worse than others by noise and by share of their light: either alone tells bright from faint."""
    measures = []
    for of_star in (_chi2, _residual_share):
        median = np.median(np.concatenate([of_star(f)[ok] for f, ok in zip(fits, known, strict=True)]))
        measures.append([of_star(fit) > MAX_MISFIT * median for fit in fits])
    return [worse & larger for worse, larger in zip(*measures, strict=True)]


def _best_smoothness(stack: _Stack, stars: Sequence[_PictureStars]) -> tuple[float, float]:
    """Smoothness of least median chi-squared of stars that were left out, and that median."""
    rated = []
    for smoothness in SMOOTHNESS:
        left_out = []
        for fold in range(FOLDS):
            own = [np.arange(len(s.flux_dn)) % FOLDS == fold for s in stars]
            inside = [s.only(~mask) for s, mask in zip(stars, own, strict=True)]
            fits = stack.fit(stack.iterate(inside, smoothness, passes=1)[0], stars)
            left_out += [
                _chi2(fit)[mask & np.isfinite(s.flux_dn)]
                for fit, mask, s in zip(fits, own, stars, strict=True)
            ]
        rated.append((float(np.nanmedian(np.concatenate(left_out))), smoothness))
    chi2, best = min(rated)
    return best, chi2


def _result(
    stack: _Stack,
    psf: EmpiricalPsf,
    gaussian: Sequence[StarCenters],
    stars: Sequence[_PictureStars],
    smoothness: float,
    held_out: float,
    used: BoolArray,
    messages: tuple[str, ...],
) -> PsfCalibration:
    fits = stack.fit(psf, stars)
    counted = np.concatenate([np.isfinite(s.flux_dn) for s in stars])
    moved = np.concatenate([f.pixel_line - g.pixel_line for f, g in zip(fits, gaussian, strict=True)])[
        counted
    ]
    chi2 = [
        np.concatenate([_chi2(fit) for fit in done])[counted] for done in (stack.fit(stack.base, stars), fits)
    ]
    return PsfCalibration(
        psf=psf,
        n_stars=int(counted.sum()),
        smoothness=smoothness,
        gaussian_chi2=chi2[0],
        empirical_chi2=chi2[1],
        held_out_chi2=held_out,
        moved_px=float(np.sqrt(np.nanmean(moved**2))),
        used_pictures=used,
        messages=messages,
    )


def _oversampling(n_stars: int, sigma_px: float, wanted: int | None) -> tuple[int, tuple[str, ...]]:
    most = int(np.sqrt(n_stars / STARS_PER_CELL))
    width = FWHM_PER_SIGMA * np.sqrt(sigma_px**2 + PIXEL_VARIANCE_PX2)
    ideal = min(int(np.ceil(CELLS_PER_FWHM / width)), MAX_OVERSAMPLING) if wanted is None else wanted
    ideal = max(ideal, MIN_OVERSAMPLING)
    if most < MIN_OVERSAMPLING:
        raise CameraError(
            f"{n_stars} bright stars cannot fill the cells of a PSF ({STARS_PER_CELL * MIN_OVERSAMPLING**2:.0f} are "
            "needed); give more frames, or lower the least signal-to-noise ratio."
        )
    if ideal <= most:
        return ideal, ()
    return most, (f"{n_stars} stars fill {most} cells a pixel, {ideal} were wanted; more frames would help",)


def _half_size(sigma_px: float) -> float:
    return float(np.clip(HALF_SIZE_SIGMAS * sigma_px, MIN_HALF_SIZE_PX, MAX_HALF_SIZE_PX))


def _gaussian_fit(picture: PsfPicture, prior: ShapePrior) -> StarCenters:
    return fit_gaussian(
        picture.signal_dn,
        picture.noise_dn,
        picture.bad,
        picture.pixel_line,
        prior,
        noise_model=picture.noise_model,
        joint=False,
        mask_hits=False,
    )


def _trusted_flux(fit: StarCenters) -> FloatArray:
    return np.where(fit.usable & (fit.flux_dn > 0.0), fit.flux_dn, np.nan)


def _mean_gaussian(fits: Sequence[StarCenters]) -> GaussianPsf:
    """The Gaussian of the median second moments of all stars."""
    return gaussian_of_moments(np.median(np.concatenate([shape_moments(fit) for fit in fits]), axis=0))


def _chi2(fit: StarCenters) -> FloatArray:
    return np.where(np.isfinite(fit.chi2_reduced), fit.chi2_reduced, np.inf)


def _residual_share(fit: StarCenters) -> FloatArray:
    """Root of the summed squares of a star's residual image over its flux."""
    if fit.images is None:
        return np.full(len(fit), np.inf)
    squares = np.nansum(fit.images.residual_dn**2, axis=(1, 2))
    return np.where(fit.flux_dn > 0.0, np.sqrt(squares) / fit.flux_dn, np.inf)
