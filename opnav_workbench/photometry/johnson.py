"""The Johnson-Cousins B and V bands, in which catalogs give magnitudes.

Source: Bessell (1990), doi 10.1086/132749, table 2; its numbers weigh energy, here divided by the wavelength so that
they weigh photons (Bessell & Murphy 2012, doi 10.1086/664083). Vega: V = 0.026 (Bohlin & Gilliland 2004), B - V = 0.
"""

import numpy as np

from opnav_workbench.photometry.bandpass import Bandpass
from opnav_workbench.photometry.spectra import VEGA, Spectrum

__all__ = ["JOHNSON_B", "JOHNSON_V", "VEGA_V_MAG", "johnson_magnitude"]

VEGA_V_MAG = 0.026  # +- 0.008, Bohlin & Gilliland (2004)

# fmt: off
B_ENERGY = (  # 360 to 560 nm by 10
    0.0, 0.030, 0.134, 0.567, 0.920, 0.978, 1.0, 0.978, 0.935, 0.853, 0.740, 0.640, 0.536, 0.424, 0.325, 0.235, 0.150,
    0.095, 0.043, 0.009, 0.0)
V_ENERGY = (  # 470 to 700 nm by 10
    0.0, 0.030, 0.163, 0.458, 0.780, 0.967, 1.0, 0.973, 0.898, 0.792, 0.684, 0.574, 0.461, 0.359, 0.270, 0.197, 0.135,
    0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0.0)
# fmt: on


def _band(first_nm: float, energy: tuple[float, ...]) -> Bandpass:
    wavelength = first_nm + 10.0 * np.arange(len(energy), dtype=np.float64)
    photon = np.array(energy, dtype=np.float64) / wavelength
    return Bandpass(wavelength, photon / photon.max())


JOHNSON_B = _band(360.0, B_ENERGY)
JOHNSON_V = _band(470.0, V_ENERGY)


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
