"""The effective PSF of an undersampled camera from the stars of many pictures; see `opnav_workbench.psf.effective`.

Flow   pictures -> the Gaussian that most of them agree on -> what each says of its correction -> again, about what was found
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EffectivePsf, PsfEvidence
from opnav_workbench.stars import ExpectedPlaces, NoiseModel, ShapePrior, evidence_of_stars, fit_stars

__all__ = ["MAX_EFFECTIVE_SIGMA_PX", "TeachingPicture", "learn_effective_psf"]

MAX_EFFECTIVE_SIGMA_PX = 0.6  # of wider PSFs every star shows its shape by itself
ROUNDS = 2  # the second is about the PSF that the first one found: its centers no longer err with the phase


@dataclass(frozen=True, slots=True, eq=False)
class TeachingPicture:
    """One picture and its stars; arrays are read-only.

    Attributes
    ----------
    sha256
        Of its file: no picture counts twice.
    signal_dn, noise_dn : (n_line, n_pixel) arrays
        Picture without background, and its 1-sigma noise without the stars' own.
    bad, saturated : (n_line, n_pixel) arrays of bool
    pixel_line : (n, 2) array
        First centers of the stars, good to a pixel.
    places : ExpectedPlaces
        Where the catalog has them.
    noise_model
        For the stars' shot noise.
    """

    sha256: str
    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    saturated: BoolArray
    pixel_line: FloatArray
    places: ExpectedPlaces
    noise_model: NoiseModel | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def learn_effective_psf(
    pictures: Sequence[TeachingPicture], prior: ShapePrior, kept: EffectivePsf | None = None
) -> EffectivePsf:
    """Return what the stars of pictures say of the PSF that they share, beside what others said before.

    Parameters
    ----------
    prior
        The camera's PSF as it is known beforehand.
    kept
        From earlier pictures; those among `pictures` that it has already do not count again.

    Raises
    ------
    CameraError
        No picture has stars enough, or the PSF is so wide that each star shows it.

    Notes
    -----
    Anderson & King (2000), doi:10.1086/316632, with a covariance.
    """
    new = [picture for picture in pictures if kept is None or picture.sha256 not in kept.pictures]
    if kept is not None:
        return kept.with_pictures(_taught(new, kept.log_scale, kept.ellipticity, kept.for_a_picture()))
    log_scale, ellipticity = _common_shape(new, prior)
    found, evidence = None, None
    for _ in range(ROUNDS):
        taught = _taught(new, log_scale, ellipticity, evidence)
        if not taught:
            raise CameraError(
                "no picture has three bright stars that stand alone; give pictures of richer fields."
            )
        found = EffectivePsf.of_pictures(log_scale, ellipticity, taught)
        evidence = found.for_a_picture()
    assert found is not None
    return found


def _common_shape(pictures: Sequence[TeachingPicture], prior: ShapePrior) -> tuple[float, FloatArray]:
    """Return the Gaussian's log scale and ellipticity (2,) that most of the pictures' stars agree on."""
    shapes = [_own_shape(picture, prior) for picture in pictures]
    log_scale, *ellipticity = np.median(np.stack([*shapes] or [prior.mean]), axis=0)
    sigma = float(np.exp(log_scale))
    if sigma > MAX_EFFECTIVE_SIGMA_PX:
        raise CameraError(
            f"the stars' PSF has a sigma of {sigma:.2f} px: only below {MAX_EFFECTIVE_SIGMA_PX} px does it need to be "
            "learned from many pictures."
        )
    return float(log_scale), np.array(ellipticity)


def _own_shape(picture: TeachingPicture, prior: ShapePrior) -> FloatArray:
    """Log scale and ellipticity (3,) that the stars of a picture agree on."""
    _, psf = fit_stars(
        picture.signal_dn, picture.noise_dn, picture.bad, picture.pixel_line, prior,
        saturated=picture.saturated, noise_model=picture.noise_model,
    )  # fmt: skip
    return psf.mean


def _taught(
    pictures: Sequence[TeachingPicture],
    log_scale: float,
    ellipticity: FloatArray,
    known: PsfEvidence | None,
) -> dict[str, tuple[PsfEvidence, int]]:
    """What each picture says, and how many of its stars, by its SHA-256; about the PSF as far as it is known."""
    told = {}
    for picture in pictures:
        found = evidence_of_stars(
            picture.signal_dn, picture.noise_dn, picture.bad, picture.pixel_line, log_scale, ellipticity,
            saturated=picture.saturated, noise_model=picture.noise_model, places=picture.places, kept=known,
        )  # fmt: skip
        if found is not None:
            told[picture.sha256] = found
    return told
