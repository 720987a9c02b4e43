"""How well a star's center can be known at all: the Cramer-Rao bound of a pixel-integrated PSF.

With the model f(p) in each pixel, the Fisher information is sum over pixels of

    J J' I(v),   I(v) = 1 / v + (r^2 / v)^2 / (2 v^2),   v = r^2 + star / gain

The first term holds what the mean of a pixel tells. The second holds what its scatter tells: it grows with the star's
light too, though only the part that read and background noise r let through carries anything new (pure photon counts
say it all by their mean). It is exact to second order in 1 / v and matters below some ten electrons of noise: at 45 e
it adds 2.5e-4.

References: Winick (1986), doi:10.1364/JOSAA.3.001809; Ober, Ram & Ward (2004), doi:10.1016/S0006-3495(04)74193-4.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import Psf
from opnav_workbench.stars.boxes import check_points
from opnav_workbench.stars.least_squares import checked_settings
from opnav_workbench.stars.results import NoiseModel, ShapePrior
from opnav_workbench.stars.star_model import GaussianProfile, KnownProfile, StarProfile

__all__ = ["CenterBound", "cramer_rao", "flux_at_snr"]

FLUX_STEPS = 20  # of the fixed point for the flux: each gains a factor of two and more
PHASES = 8  # sub-pixel phases along each axis whose mean counts as the signal-to-noise ratio


@dataclass(frozen=True, slots=True, eq=False)
class CenterBound:
    """Smallest covariance that an unbiased estimate of flux, center, shape and background can have."""

    covariance: (
        FloatArray  # (n, q, q): flux, pixel, line, free shape (0 or 3), level, and slopes with a plane
    )
    flux_dn: FloatArray  # (n,)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def center_covariance_px2(self) -> FloatArray:
        """Of pixel and line, all else estimated too; (n, 2, 2)."""
        return self.covariance[:, 1:3, 1:3]

    @property
    def sigma_px(self) -> FloatArray:
        """1-sigma of pixel and line; (n, 2)."""
        return np.sqrt(np.diagonal(self.center_covariance_px2, axis1=1, axis2=2))

    @property
    def snr(self) -> FloatArray:
        """Flux over its sigma; (n,)."""
        return self.flux_dn / np.sqrt(self.covariance[:, 0, 0])


def cramer_rao(
    center_px: ArrayLike,
    flux_dn: ArrayLike,
    psf: Psf | ShapePrior,
    noise_dn: float,
    *,
    box_px: int,
    noise_model: NoiseModel | None = None,
    background: Literal["level", "plane", "none"] = "level",
) -> CenterBound:
    """Return the Cramer-Rao bound of isolated stars.

    Parameters
    ----------
    center_px : (n, 2) array_like
        True places (pixel, line); only their sub-pixel phases matter.
    flux_dn : float or (n,) array_like
        True fluxes.
    psf
        A PSF: the shape is known, and free are flux, pixel, line and background. A prior: free are also log
        scale, e1 and e2 of a Gaussian with the prior's mean, and the prior's information is added to that of the
        data (with it the bound is that of the posterior, averaged over the prior).
    noise_dn
        1-sigma noise of a pixel without the star: read noise, dark current, sky.
    box_px
        Side of the box of pixels that are used, odd, centered on the pixel that holds the star.
    noise_model
        Its gain adds the star's shot noise.
    background
        What is free beside the star; "none" for a background that is known.

    Raises
    ------
    CenterfindingError
        A box or noise that is not usable, or centers of the wrong shape.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> bound = cramer_rao([[20.0, 20.0]], 1000.0, GaussianPsf(1.0, 1.0), 3.0, box_px=11)
    >>> bound.sigma_px.round(4).tolist(), bound.snr.round(1).tolist()
    ([[0.0163, 0.0163]], [85.1])
    """
    centers = check_points(center_px, "center_px")
    flux = np.broadcast_to(np.asarray(flux_dn, float), len(centers))
    checked_settings(box_px, "level" if background == "none" else background, noise_model, 0.0, 0.0)
    if not 0.0 < noise_dn < np.inf:
        raise CenterfindingError(f"noise_dn must be positive, got {noise_dn}.")
    profile = GaussianProfile(psf) if isinstance(psf, ShapePrior) else KnownProfile(psf)
    jacobian, light = _jacobian(centers, flux, profile, box_px, background)
    known = _information_of_pixels(light, noise_dn, noise_model)
    information = np.matmul(jacobian * known[:, None, :], np.swapaxes(jacobian, 1, 2))
    shape = 3 + np.arange(len(profile.mean))
    information[:, shape, shape] += profile.information
    return CenterBound(np.linalg.inv(information), flux)


def flux_at_snr(
    snr: float,
    psf: Psf | ShapePrior,
    noise_dn: float,
    *,
    box_px: int,
    noise_model: NoiseModel | None = None,
    background: Literal["level", "plane", "none"] = "level",
) -> float:
    """Return the flux (DN) whose bound has this signal-to-noise ratio, in the mean over sub-pixel phases.

    Parameters
    ----------
    snr
        Flux over its sigma, all free parameters estimated.
    psf, noise_dn, box_px, noise_model, background
        As in `cramer_rao`.

    Raises
    ------
    CenterfindingError
        An SNR that is not positive, or as in `cramer_rao`.
    """
    if not 0.0 < snr < np.inf:
        raise CenterfindingError(f"snr must be positive, got {snr}.")
    line, pixel = np.indices((PHASES, PHASES)).reshape(2, -1)
    phases = (np.column_stack([pixel, line]) + 0.5) / PHASES - 0.5
    flux = snr * noise_dn
    for _ in range(FLUX_STEPS):
        bound = cramer_rao(
            phases, flux, psf, noise_dn, box_px=box_px, noise_model=noise_model, background=background
        )
        flux *= snr / float(bound.snr.mean())
    return float(flux)


def _jacobian(
    centers: FloatArray, flux: FloatArray, profile: StarProfile, size: int, background: str
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the pixels (n, q, m), and the light of the star in them (n, m)."""
    n = len(centers)
    first = np.rint(centers) - size // 2
    shape = np.broadcast_to(profile.mean, (n, len(profile.mean)))
    value, *derivatives = (a.reshape(n, -1) for a in profile.evaluate(centers, shape, first, size))
    line, pixel = np.indices((size, size), dtype=float).reshape(2, -1) - size // 2
    basis = [np.ones_like(pixel), pixel, line][: {"none": 0, "level": 1, "plane": 3}[background]]
    columns = [
        value,
        *(flux[:, None] * d for d in derivatives),
        *(np.broadcast_to(b, value.shape) for b in basis),
    ]
    return np.stack(columns, axis=1), flux[:, None] * value


def _information_of_pixels(light: FloatArray, noise_dn: float, noise_model: NoiseModel | None) -> FloatArray:
    """Information on the mean of each pixel, DN^-2."""
    if noise_model is None:
        return np.full(light.shape, noise_dn**-2.0)
    gain = noise_model.gain_e_per_dn
    read = (noise_dn * gain) ** 2  # e^2
    variance = read + np.maximum(light, 0.0) * gain
    return np.asarray(gain**2 * (1.0 / variance + 0.5 * (read / variance) ** 2 / variance**2))
