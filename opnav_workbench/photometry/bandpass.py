"""Band passes: how many electrons a camera makes of a photon that enters its aperture; Johnson-Cousins B and V.

Source of B and V, in which catalogs give magnitudes: Bessell (1990), doi:10.1086/132749, table 2; its numbers weigh
energy, here divided by the wavelength so that they weigh photons (Bessell & Murphy 2012, doi:10.1086/664083). Vega:
V = 0.026 (Bohlin & Gilliland 2004), B - V = 0.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry.spectra import VEGA, Spectrum, checked_curve

__all__ = ["JOHNSON_B", "JOHNSON_V", "VEGA_V_MAG", "Bandpass", "johnson_magnitude"]


# ---- Band passes: how many electrons a camera makes of a photon that enters its aperture.

GRID_NM = 1.0  # integration step: rectangular steps of filters to 0.1 %
FLUX_MISSING = 1e-3  # share of a band that may lie outside the table of a spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Bandpass:
    """Electrons per photon: quantum efficiency times transmission; linear between the points, zero outside.

    Attributes
    ----------
    wavelength_nm : (n,) array
        Increasing.
    response : (n,) array

    Raises
    ------
    CameraError
        No curve, or one that is zero everywhere.

    Examples
    --------
    >>> green = Bandpass([500.0, 501.0, 600.0, 601.0], [0.0, 0.5, 0.5, 0.0])
    >>> round(green.pivot_nm, 1), round(green.peak, 2)
    (549.7, 0.5)
    """

    wavelength_nm: FloatArray
    response: FloatArray

    def __post_init__(self) -> None:
        wavelength, response = checked_curve("band pass", self.wavelength_nm, self.response)
        if not response.max() > 0.0:
            raise CameraError("band pass: the response is zero everywhere; give electrons per photon.")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "response", response)
        freeze_arrays(self)

    @classmethod
    def product(cls, *parts: "Bandpass") -> "Bandpass":
        """Return the band pass of several parts in a row, such as a filter, a telescope and a detector's QE.

        Examples
        --------
        >>> glass = Bandpass([400.0, 500.0, 900.0], [0.0, 1.0, 1.0])
        >>> float(Bandpass.product(glass, Bandpass([300.0, 700.0, 701.0], [0.6, 0.6, 0.0])).at(450.0))
        0.3
        """
        low = max(part.wavelength_nm[0] for part in parts)
        high = min(part.wavelength_nm[-1] for part in parts)
        if not low < high:
            raise CameraError(
                f"band passes do not overlap: the last one starts at {low:g} nm, one ends at {high:g}."
            )
        grid = np.unique(
            np.concatenate([np.arange(low, high, GRID_NM), *(p.wavelength_nm for p in parts), [high]])
        )
        grid = grid[(grid >= low) & (grid <= high)]
        return cls(grid, reduce(np.multiply, (part.at(grid) for part in parts)))

    @property
    def peak(self) -> float:
        """Highest response."""
        return float(self.response.max())

    def scaled_to(self, peak: float) -> "Bandpass":
        """Return the same shape with another peak."""
        return Bandpass(self.wavelength_nm, self.response * (peak / self.peak))

    def at(self, wavelength_nm: FloatArray | float) -> FloatArray:
        """Return the response at wavelengths (...)."""
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, self.response, left=0.0, right=0.0))

    @property
    def pivot_nm(self) -> float:
        """Pivot wavelength, where a flux per wavelength and one per frequency mean the same source.

        sqrt(int R l dl / int R / l dl) with the response R per photon: Koornneef et al. (1986).
        """
        grid = self._grid(self.wavelength_nm)
        response = self.at(grid)
        return float(np.sqrt(np.trapezoid(response * grid, grid) / np.trapezoid(response / grid, grid)))

    def photon_rate(self, spectrum: Spectrum) -> float:
        """Return electrons per second and square meter of aperture: the integral of flux times response.

        Raises
        ------
        CameraError
            The spectrum does not cover the band.
        """
        grid = self._grid(np.concatenate([self.wavelength_nm, spectrum.wavelength_nm]))
        response = self.at(grid)
        seen = (grid >= spectrum.wavelength_nm[0]) & (grid <= spectrum.wavelength_nm[-1])
        missing = 1.0 - np.trapezoid(np.where(seen, response, 0.0), grid) / np.trapezoid(response, grid)
        if missing > FLUX_MISSING:
            raise CameraError(
                f"{missing:.1%} of the band pass lies outside the spectrum, {spectrum.wavelength_nm[0]:g} to "
                f"{spectrum.wavelength_nm[-1]:g} nm; cut the band pass there or give a longer spectrum."
            )
        return float(np.trapezoid(np.where(seen, response * spectrum.at(grid), 0.0), grid))

    def _grid(self, points: FloatArray) -> FloatArray:
        """Grid over the band that holds all given points inside it."""
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        grid = np.concatenate([np.arange(low, high, GRID_NM), points, [low, high]])
        return np.unique(grid[(grid >= low) & (grid <= high)])


# ---- The Johnson-Cousins B and V bands, in which catalogs give magnitudes.

VEGA_V_MAG = 0.026  # +- 0.008, Bohlin & Gilliland (2004)

# fmt: off
B_ENERGY = (  # 360 to 560 nm by 10
    0.0, 0.030, 0.134, 0.567, 0.920, 0.978, 1.0, 0.978, 0.935, 0.853, 0.740, 0.640, 0.536, 0.424, 0.325, 0.235, 0.150,
    0.095, 0.043, 0.009, 0.0)
V_ENERGY = (  # 470 to 700 nm by 10
    0.0, 0.030, 0.163, 0.458, 0.780, 0.967, 1.0, 0.973, 0.898, 0.792, 0.684, 0.574, 0.461, 0.359, 0.270, 0.197, 0.135,
    0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0.0)
# fmt: on


def _johnson_band(first_nm: float, energy: tuple[float, ...]) -> Bandpass:
    wavelength = first_nm + 10.0 * np.arange(len(energy), dtype=np.float64)
    photon = np.array(energy, dtype=np.float64) / wavelength
    return Bandpass(wavelength, photon / photon.max())


JOHNSON_B = _johnson_band(360.0, B_ENERGY)
JOHNSON_V = _johnson_band(470.0, V_ENERGY)


def johnson_magnitude(spectrum: Spectrum, band: Bandpass = JOHNSON_V) -> float:
    """Return the Johnson magnitude of a spectrum in a band; Vega's is 0.026 in every one.

    Examples
    --------
    >>> from opnav_workbench.photometry import SUN
    >>> round(johnson_magnitude(SUN), 2)
    -26.75
    >>> round(johnson_magnitude(SUN, JOHNSON_B) - johnson_magnitude(SUN), 2)
    0.65
    """
    return float(VEGA_V_MAG - 2.5 * np.log10(band.photon_rate(spectrum) / band.photon_rate(VEGA)))
