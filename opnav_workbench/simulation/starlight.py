"""Stars in a picture: points, or trails where the camera moves.

Flow    places and fluxes -> boxes of the PSF's shares, all stars at once -> added to the electrons in place
Units   px as (pixel, line), electrons
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.protocol import Psf
from opnav_workbench.psf.sources import add_sources

__all__ = ["Trails", "add_stars", "trails"]


@dataclass(frozen=True, slots=True, eq=False)
class Trails:
    """Where stars were during the exposure, in a few numbers; arrays are read-only.

    Attributes
    ----------
    middle_px : (n, 2) array
        At mid-exposure.
    mean_px : (n, 2) array
        Weighted mean: where the light's center is.
    length_px : (n,) array
        Length of the path.
    """

    middle_px: FloatArray
    mean_px: FloatArray
    length_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def trails(places_px: ArrayLike, weights: ArrayLike | None = None) -> Trails:
    """Summarise the places of stars during an exposure.

    Parameters
    ----------
    places_px : (n, 2) or (n, k, 2) array_like
        k is odd; the middle sample is at mid-exposure, and the samples stand in the middle of equal times.
    weights : (k,) array_like, optional

    Examples
    --------
    >>> trails([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]).length_px  # three thirds of the exposure
    array([3.])
    """
    places, shares = _samples(places_px, weights)
    steps = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    k = places.shape[1]
    return Trails(
        middle_px=places[:, k // 2],
        mean_px=np.einsum("nkj,k->nj", places, shares),
        length_px=steps.sum(axis=1) * (k / max(k - 1, 1)),  # half a step more at either end
    )


def add_stars(
    electrons: FloatArray,
    places_px: ArrayLike,
    flux_e: ArrayLike,
    psf: Psf,
    weights: ArrayLike | None = None,
) -> None:
    """Add stars to a picture, in place.

    Parameters
    ----------
    electrons : (n_line, n_pixel) array
    places_px : (n, 2) or (n, k, 2) array_like
        Of each star, or of each star at k times; stars beside the detector whose light reaches it count, and
        places that are not finite (behind the camera) are left out.
    flux_e : (n,) array_like
        Electrons of each star over the whole exposure.
    psf : Psf
    weights : (k,) array_like, optional
        Share of the exposure at each time; equal ones unless given.

    Raises
    ------
    CameraError
        Numbers of stars, places and weights that do not fit, or a flux that is negative or not finite.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> picture = np.zeros((20, 30))
    >>> add_stars(picture, [[[10.0, 9.0], [12.0, 9.0]]], [100.0], GaussianPsf(0.7, 0.7))
    >>> round(float(picture.sum()), 3), round(float(picture[9, 10] / picture[9, 12]), 3)
    (100.0, 1.0)
    """
    places, shares = _samples(places_px, weights)
    flux = np.asarray(flux_e, dtype=np.float64)
    if flux.shape != places.shape[:1]:
        raise CameraError(f"{len(places)} places but fluxes of shape {flux.shape}; give one flux per star.")
    if not (np.isfinite(flux) & (flux >= 0.0)).all():
        raise CameraError(
            f"{np.sum(~(flux >= 0.0) | np.isinf(flux))} stars with a flux that is negative or not finite; leave out "
            "stars without a magnitude."
        )
    add_sources(electrons, psf, places.reshape(-1, 2), (flux[:, None] * shares).ravel())


def _samples(places_px: ArrayLike, weights: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Return places (n, k, 2) and weights (k,)."""
    places = np.asarray(places_px, dtype=np.float64)
    if places.ndim == 2:
        places = places[:, None]
    if places.ndim != 3 or places.shape[-1] != 2:
        raise CameraError(f"places of shape {places.shape}; give (n, 2) or (n, k, 2) pixels and lines.")
    k = places.shape[1]
    shares = np.full(k, 1.0 / k) if weights is None else np.asarray(weights, dtype=np.float64)
    if shares.shape != (k,):
        raise CameraError(f"{k} places per star but weights of shape {shares.shape}; give one per place.")
    return places, shares
