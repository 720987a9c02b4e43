"""An empirical PSF stacked from the bright stars of many frames.

Flow   frames -> Gaussian fits -> frames that share one shape -> cells -> centers with these cells -> cells again
Units  px, DN; cells of 1/oversampling px

The cells are the difference from the mean Gaussian, so that few or noisy stars leave that; how smooth the difference
must be is what explains stars best that were not in the stack. Gaussian centers of an undersampled PSF err with the
sub-pixel phase, and cells stacked on them are blurred by it. The cells themselves give better centers, whose common
shift is taken out: the PSF's own origin stays where Gaussian fits put it in the mean over all phases, so that both
methods measure the same point. Idea: Anderson & King (2000), doi 10.1086/316632.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.calibration.psf_frames import PsfFrame, gaussian_of, moments, same_shape
from opnav_workbench.calibration.results import PsfCalibration
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, Psf
from opnav_workbench.psf.extraction import cells_from_stars
from opnav_workbench.starcenters import ShapePrior, StarCenters, default_box_px, fit_gaussian, fit_psf

__all__ = ["stack_psf"]

CELLS_PER_FWHM = 4.0  # keep shares good to 4e-4 (see `EmpiricalPsf`)
FWHM_PER_SIGMA = 2.3548
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
    frames: Sequence[PsfFrame],
    prior: ShapePrior,
    *,
    oversampling: int | None = None,
    half_size_px: float | None = None,
) -> PsfCalibration:
    """Stack the stars of many frames to an oversampled PSF.

    Parameters
    ----------
    frames : sequence of PsfFrame
    prior : ShapePrior
        The PSF as it is known, for the first centers.
    oversampling : int, optional
        Cells a pixel; by default four to the width at half maximum, or as many as the stars can fill.
    half_size_px : float, optional
        Half the side of the template.

    Raises
    ------
    CameraError
        Too few stars to fill the cells.
    """
    gaussian = [_gaussian(frame, prior) for frame in frames]
    used, messages = same_shape(frames, gaussian)
    chosen = [frame for frame, take in zip(frames, used, strict=True) if take]
    fits = [fit for fit, take in zip(gaussian, used, strict=True) if take]
    starts = [_Stars(fit.pixel_line, _trusted_flux(fit)) for fit in fits]
    n_stars = sum(stars.count for stars in starts)
    cells, note = _oversampling(n_stars, prior.sigma_px, oversampling)
    half = _half_size(prior.sigma_px) if half_size_px is None else half_size_px
    stack = _Stack(chosen, _mean_gaussian(fits), cells, half, default_box_px(prior.sigma_px))
    smoothness, held_out = _best_smoothness(stack, starts)
    psf, stars = stack.iterate(starts, smoothness)
    return _result(stack, psf, fits, stars, smoothness, held_out, used, (*messages, *note))


@dataclass(frozen=True, slots=True, eq=False)
class _Stars:
    """Centers (n, 2) of one frame's stars, and fluxes (n,), nan for those that do not count."""

    pixel_line: FloatArray
    flux_dn: FloatArray

    @property
    def count(self) -> int:
        return int(np.isfinite(self.flux_dn).sum())

    def only(self, keep: BoolArray) -> "_Stars":
        return _Stars(self.pixel_line, np.where(keep, self.flux_dn, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """All frames one below the other, with masked rows between, so that one least squares serves them all."""

    frames: Sequence[PsfFrame]
    base: GaussianPsf
    oversampling: int
    half_size_px: float
    box_px: int
    _image: FloatArray = field(init=False)
    _bad: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        gap = ((0, self._gap), (0, 0))
        image = np.concatenate([np.pad(frame.signal_dn, gap) for frame in self.frames])
        bad = np.concatenate([np.pad(frame.bad, gap, constant_values=True) for frame in self.frames])
        object.__setattr__(self, "_image", image)
        object.__setattr__(self, "_bad", bad)

    @property
    def _gap(self) -> int:
        return int(np.ceil(self.half_size_px)) + 2

    def cells(self, stars: Sequence[_Stars], smoothness: float) -> EmpiricalPsf:
        """Return the PSF of stars whose centers and fluxes are known."""
        lines = np.cumsum([0, *(len(frame.signal_dn) + self._gap for frame in self.frames[:-1])])
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

    def _weights(self, stars: Sequence[_Stars]) -> list[FloatArray]:
        """Inverse errors of the pixels of stars: noise, and a part of their light, so that no star outweighs many."""
        noise = [float(np.median(frame.noise_dn)) for frame in self.frames]
        return [1.0 / np.hypot(sigma, LIGHT_ERROR * s.flux_dn) for sigma, s in zip(noise, stars, strict=True)]

    def fit(self, psf: Psf, stars: Sequence[_Stars]) -> list[StarCenters]:
        """Fit the stars with a PSF; a PSF still wrong leaves residuals at bright stars that are no hits."""
        return [
            fit_psf(
                frame.signal_dn,
                frame.noise_dn,
                frame.bad,
                s.pixel_line,
                psf,
                box_px=self.box_px,
                noise_model=frame.noise_model,
                joint=False,
                mask_hits=False,
            )
            for frame, s in zip(self.frames, stars, strict=True)
        ]

    def iterate(
        self, stars: Sequence[_Stars], smoothness: float, passes: int = PASSES
    ) -> tuple[EmpiricalPsf, list[_Stars]]:
        """Return the PSF after improving centers with it, and the stars as they then are."""
        now = list(stars)
        for _ in range(passes):
            fits = self.fit(self.cells(now, smoothness), now)
            now = _improved(now, fits)
        return self.cells(now, smoothness), now


def _improved(before: Sequence[_Stars], fits: Sequence[StarCenters]) -> list[_Stars]:
    """New centers without their common shift, new fluxes; stars unlike the others no longer count."""
    known = [np.isfinite(s.flux_dn) & fit.usable for s, fit in zip(before, fits, strict=True)]
    shifts = [(fit.pixel_line - s.pixel_line)[ok] for s, fit, ok in zip(before, fits, known, strict=True)]
    shift = np.median(np.concatenate(shifts), axis=0)
    odd = _unlike_others(fits, known)
    return [
        _Stars(
            np.where(ok[:, None], fit.pixel_line - shift, s.pixel_line),
            np.where(ok & ~strange, fit.flux_dn, np.nan),
        )
        for s, fit, ok, strange in zip(before, fits, known, odd, strict=True)
    ]


def _unlike_others(fits: Sequence[StarCenters], known: Sequence[BoolArray]) -> list[BoolArray]:
    """Stars that fit worse than others by noise and by share of their light: either alone tells bright from faint."""
    measures = []
    for of_star in (_chi2, _share):
        median = np.median(np.concatenate([of_star(f)[ok] for f, ok in zip(fits, known, strict=True)]))
        measures.append([of_star(fit) > MAX_MISFIT * median for fit in fits])
    return [worse & larger for worse, larger in zip(*measures, strict=True)]


def _best_smoothness(stack: _Stack, stars: Sequence[_Stars]) -> tuple[float, float]:
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
    stars: Sequence[_Stars],
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
        used_frames=used,
        messages=messages,
    )


def _oversampling(n_stars: int, sigma_px: float, wanted: int | None) -> tuple[int, tuple[str, ...]]:
    most = int(np.sqrt(n_stars / STARS_PER_CELL))
    width = FWHM_PER_SIGMA * np.sqrt(sigma_px**2 + 1.0 / 12.0)
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


def _gaussian(frame: PsfFrame, prior: ShapePrior) -> StarCenters:
    return fit_gaussian(
        frame.signal_dn,
        frame.noise_dn,
        frame.bad,
        frame.pixel_line,
        prior,
        noise_model=frame.noise_model,
        joint=False,
        mask_hits=False,
    )


def _trusted_flux(fit: StarCenters) -> FloatArray:
    return np.where(fit.usable & (fit.flux_dn > 0.0), fit.flux_dn, np.nan)


def _mean_gaussian(fits: Sequence[StarCenters]) -> GaussianPsf:
    """The Gaussian of the median second moments of all stars."""
    return gaussian_of(np.median(np.concatenate([moments(fit) for fit in fits]), axis=0))


def _chi2(fit: StarCenters) -> FloatArray:
    return np.where(np.isfinite(fit.chi2_reduced), fit.chi2_reduced, np.inf)


def _share(fit: StarCenters) -> FloatArray:
    """Root of the summed squares of a star's residual image over its flux."""
    if fit.images is None:
        return np.full(len(fit), np.inf)
    squares = np.nansum(fit.images.residual_dn**2, axis=(1, 2))
    return np.where(fit.flux_dn > 0.0, np.sqrt(squares) / fit.flux_dn, np.inf)
