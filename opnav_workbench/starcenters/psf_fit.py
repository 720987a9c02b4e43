"""Least squares with a PSF taken as it is: empirical, with wings, or smeared along a trail.

Flow   image, noise, first centers, a `Psf` -> here -> pointing

Estimated are flux and center of each star, and its background. The PSF's derivatives are its own, so a template
from bright stars (`psf.EmpiricalPsf`) serves as well as a trail known from the attitude (`psf.TrailedPsf`), whose
stars are found at the middle of the exposure.

Reference: Anderson & King (2000), doi 10.1086/316632.
"""

from typing import Literal

from numpy.typing import ArrayLike

from opnav_workbench.psf import Psf
from opnav_workbench.starcenters.boxes import check_image, check_points
from opnav_workbench.starcenters.fitting import fit_profile
from opnav_workbench.starcenters.least_squares import SEARCH_RADIUS_PX, checked_settings, default_box_px
from opnav_workbench.starcenters.profiles import KnownProfile
from opnav_workbench.starcenters.results import NoiseModel, StarCenters

__all__ = ["METHOD", "fit_psf"]

METHOD = "psf_fit"


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
    psf : Psf
        Image of a point. A center is the place of the point as the PSF defines it.
    box_px : int, optional
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
        METHOD,
        joint=joint,
        mask_hits=mask_hits,
        inflate_misfit=inflate_misfit,
    )
