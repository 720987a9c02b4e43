"""The workhorse: least squares of a pixel-integrated Gaussian, or of a PSF taken as it is, for all stars at once.

Flow   image, noise, first centers (matched filter, cross-correlation, prediction) -> here -> pointing
Units  DN, px; flux is the star's total over the whole plane

`fit_gaussian` estimates flux, center, log scale and ellipticity of the PSF (with a prior: in an undersampled image
they cannot be had from one star), and the background as a level or a plane. `fit_psf` estimates flux, center and
background only: the PSF is empirical, has wings, or is a trail known from the attitude, whose stars are found at the
middle of the exposure. Pixels are weighted by the expected noise.

References: Jackman & Dumont (2013), AAS 13-443, "The Non-Linear Least Squares Estimator"; for a PSF from bright stars
Anderson & King (2000), doi:10.1086/316632.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import Psf
from opnav_workbench.stars.boxes import check_image, check_points
from opnav_workbench.stars.group_fit import FitSettings
from opnav_workbench.stars.picture_fit import fit_profile
from opnav_workbench.stars.results import NoiseModel, ShapePrior, StarCenters
from opnav_workbench.stars.star_model import GaussianProfile, KnownProfile

__all__ = ["checked_settings", "default_box_px", "fit_gaussian", "fit_psf"]


# ---- The workhorse: least squares of a pixel-integrated elliptical Gaussian, all stars at once.

BACKGROUNDS = ("level", "plane")
GAUSSIAN_METHOD = "least_squares"
SEARCH_RADIUS_PX = 3.0  # matched filters and pointing solutions come closer than this


def default_box_px(sigma_px: float) -> int:
    """Return the odd box size that holds a star of `sigma_px` to 4 sigma and a rim of background.

    Examples
    --------
    >>> default_box_px(0.35), default_box_px(1.5)
    (7, 15)
    """
    return 2 * int(np.ceil(4.0 * sigma_px + 1.0)) + 1


def fit_gaussian(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    start_pixel_line: ArrayLike,
    prior: ShapePrior,
    *,
    box_px: int | None = None,
    background: Literal["level", "plane"] = "level",
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    psf_error: float = 0.0,
    search_radius_px: float = SEARCH_RADIUS_PX,
    inflate_misfit: bool = True,
    joint: bool = True,
    mask_hits: bool = True,
) -> StarCenters:
    """Fit a pixel-integrated elliptical Gaussian to every star, in one batched Levenberg-Marquardt.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image; its background may be in it or not.
    noise_dn : (n_line, n_pixel) array_like or float
        Expected 1-sigma noise of the pixels.
    bad, saturated : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    start_pixel_line : (n, 2) array_like
        First guess (pixel, line), good to `search_radius_px` along each axis.
    prior
        What is known of the PSF.
    box_px
        Side of the box around each star, odd; by default 4 sigma and a rim.
    background
        What is estimated beside the star.
    noise_model
        With it, the shot noise of the fitted star is added to `noise_dn`, which then must not hold it
        already.
    psf_error
        Relative error of the Gaussian as a model of the PSF. The covariance allows for that fraction of the
        star in each pixel (see `estimate_psf_error`); the weights stay those of the noise, so that the
        centers do not depend on it.
    search_radius_px
        The brightest point of the search area starts the fit; the center stays within it, along each axis.
    inflate_misfit
        Scale the covariance of center and shape by the reduced chi-square (less what `psf_error` explains)
        where that is significantly above 1 (see `misfit_factor`).
    joint
        Fit stars that lie in each other's boxes together, with one background and shape. They are searched as
        a pattern, so their starts must be good to a pixel relative to each other. A member that turns out
        fainter than SNR 4 is taken out, and its neighbors are fitted without it.
    mask_hits
        Leave out pixels with light that no listed star explains (see `find_hits`), and fit again.

    Returns
    -------
    StarCenters
        Covariance is the inverse of the normal matrix, prior included, shape and background marginalized;
        flux sigma and signal-to-noise ratio tell of the noise alone.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, a box too small, an unknown background.

    Examples
    --------
    >>> from opnav_workbench.psf import pixel_gaussian
    >>> line, pixel = np.indices((12, 12)).reshape(2, 1, -1)
    >>> prior = ShapePrior.round_psf(0.8)
    >>> star = pixel_gaussian(np.array([[5.3, 6.1]]), prior.mean[None], pixel, line).value
    >>> fit = fit_gaussian(1000.0 * star.reshape(12, 12), 1.0, None, [[5.0, 6.0]], prior)
    >>> fit.pixel_line.round(3).tolist()
    [[5.3, 6.1]]
    """
    size = default_box_px(prior.sigma_px) if box_px is None else box_px
    settings = checked_settings(size, background, noise_model, psf_error, search_radius_px)
    return fit_profile(
        check_image(image_dn, noise_dn, bad, saturated),
        check_points(start_pixel_line),
        GaussianProfile(prior),
        settings,
        GAUSSIAN_METHOD,
        joint=joint,
        mask_hits=mask_hits,
        inflate_misfit=inflate_misfit,
    )


def checked_settings(
    size: int,
    background: Literal["level", "plane"],
    noise_model: NoiseModel | None,
    psf_error: float,
    search_radius_px: float,
) -> FitSettings:
    """Return the settings of a fit.

    Raises
    ------
    CenterfindingError
        A box too small or even, an unknown background, a PSF error or search radius out of range.
    """
    if background not in BACKGROUNDS:
        raise CenterfindingError(f"background must be one of {', '.join(BACKGROUNDS)}, got {background!r}.")
    if size < 3 or size % 2 == 0:
        raise CenterfindingError(f"box_px must be odd and at least 3, got {size}.")
    if not (0.0 <= psf_error < 1.0 and 0.0 <= search_radius_px < np.inf):
        raise CenterfindingError(
            f"psf_error must be in [0, 1) and search_radius_px >= 0, got {psf_error} and {search_radius_px}."
        )
    return FitSettings(size, background, noise_model, psf_error, search_radius_px)


# ---- Least squares with a PSF taken as it is: empirical, with wings, or smeared along a trail.

PSF_METHOD = "psf_fit"


def fit_psf(
    image_dn: ArrayLike,
    noise_dn: ArrayLike,
    bad: ArrayLike | None,
    start_pixel_line: ArrayLike,
    psf: Psf,
    *,
    box_px: int | None = None,
    background: Literal["level", "plane"] = "level",
    saturated: ArrayLike | None = None,
    noise_model: NoiseModel | None = None,
    psf_error: float = 0.0,
    search_radius_px: float = SEARCH_RADIUS_PX,
    inflate_misfit: bool = True,
    joint: bool = True,
    mask_hits: bool = True,
) -> StarCenters:
    """Fit a given PSF to every star, all at once.

    Parameters
    ----------
    image_dn, noise_dn, bad, start_pixel_line, background, saturated, noise_model, psf_error, search_radius_px,
    inflate_misfit, joint, mask_hits
        As in `fit_gaussian`.
    psf
        Image of a point. A center is the place of the point as the PSF defines it.
    box_px
        Side of the box around each star, odd; by default 4 sigma of the core and half the trail on each side.

    Returns
    -------
    StarCenters
        As of `fit_gaussian`; `shape` holds the second moments of the PSF.

    Raises
    ------
    CenterfindingError
        As in `fit_gaussian`.

    Examples
    --------
    >>> from opnav_workbench.psf import MoffatPsf
    >>> psf = MoffatPsf(fwhm_px=2.0, beta=3.0)
    >>> image = 1000.0 * psf.box([[14.3, 15.1]], [[0, 0]], 30)[0]
    >>> fit_psf(image, 1.0, None, [[14.0, 15.0]], psf).pixel_line.round(3).tolist()
    [[14.3, 15.1]]
    """
    profile = KnownProfile(psf)
    size = default_box_px(profile.reach_px) if box_px is None else box_px
    return fit_profile(
        check_image(image_dn, noise_dn, bad, saturated),
        check_points(start_pixel_line),
        profile,
        checked_settings(size, background, noise_model, psf_error, search_radius_px),
        PSF_METHOD,
        joint=joint,
        mask_hits=mask_hits,
        inflate_misfit=inflate_misfit,
    )
