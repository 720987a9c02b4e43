"""Photometry with Vega as the standard candle: from spectra and band passes to electrons and magnitudes.

Come in by `Bandpass` and `Spectrum`; `zero_point_mag` and `color_response` say what a camera makes of a star.

``bandpass``
    What a camera sees of a spectrum; the B and V bands of catalogs.
``magnitudes``
    Zero points, synthetic magnitudes, and what a star's color does to its magnitude.
``spectra``
    Photon fluxes: Vega, the Sun, black bodies.
"""

from opnav_workbench.photometry.bandpass import JOHNSON_B, JOHNSON_V, VEGA_V_MAG, Bandpass, johnson_magnitude
from opnav_workbench.photometry.magnitudes import (
    SUN_B_V,
    SUN_V_MAG,
    ColorResponse,
    color_response,
    electron_rate,
    instrument_magnitude,
    synthetic_magnitude,
    zero_point_mag,
)
from opnav_workbench.photometry.spectra import SUN, VEGA, Spectrum, blackbody

__all__ = [
    "JOHNSON_B",
    "JOHNSON_V",
    "SUN",
    "SUN_B_V",
    "SUN_V_MAG",
    "VEGA",
    "VEGA_V_MAG",
    "Bandpass",
    "ColorResponse",
    "Spectrum",
    "blackbody",
    "color_response",
    "electron_rate",
    "instrument_magnitude",
    "johnson_magnitude",
    "synthetic_magnitude",
    "zero_point_mag",
]
