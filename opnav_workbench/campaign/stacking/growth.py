"""How the signal-to-noise ratio grows with the pictures of a stack: as the root of their number, if all is well."""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.campaign.stacking.centers import fit_flux
from opnav_workbench.campaign.stacking.combining import Stacked, average
from opnav_workbench.errors import CenterfindingError

__all__ = ["Growth", "snr_growth"]


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """Flux of a point at one place in stacks of the first pictures; arrays (k,) are read-only.

    Attributes
    ----------
    pictures : array of int
    flux_dn, flux_sigma_dn : array
    """

    pictures: IntArray
    flux_dn: FloatArray
    flux_sigma_dn: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def snr(self) -> FloatArray:
        """Flux over its sigma (k,)."""
        return np.asarray(self.flux_dn / self.flux_sigma_dn)


def snr_growth(stacked: Stacked, pixel_line: FloatArray) -> Growth:
    """Return the flux at a place of the reference camera in stacks of 1, 2, 4 ... pictures, and of all.

    Raises
    ------
    CenterfindingError
        A stack whose star field was subtracted: its templates are made of all pictures.
    """
    if stacked.subtractions is not None:
        raise CenterfindingError("a subtracted stack has no part: its templates are made of all pictures.")
    total = len(stacked.frames)
    counts = [*(2**i for i in range(total.bit_length()) if 2**i < total), total]
    fluxes = [fit_flux(_first(stacked, count), pixel_line) for count in counts]
    flux, sigma = np.array(fluxes).T
    return Growth(np.array(counts), flux, sigma)


def _first(stacked: Stacked, count: int) -> Stacked:
    weights = stacked.weights[:count] / stacked.weights[:count].sum()
    frames, response = stacked.frames[:count], stacked.response[:count]
    image, noise, pictures = average(frames, stacked.grid, weights, response)
    return replace(
        stacked, frames=frames, raw=stacked.raw[:count], weights=weights, response=response,
        image_dn=image, noise_dn=noise, count=pictures,
    )  # fmt: skip
