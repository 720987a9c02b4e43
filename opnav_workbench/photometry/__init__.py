"""Photometry with Vega as the standard candle: from spectra and band passes to electrons and magnitudes.

spectra     photon fluxes: Vega, the Sun, black bodies     standard_tables   the published numbers
bandpass    what a camera sees of a spectrum               zero_point        magnitudes of a camera
johnson     the B and V bands of catalogs                  color             what a star's color does to its magnitude
"""

from opnav_workbench.photometry.bandpass import Bandpass
from opnav_workbench.photometry.color import ColorResponse, color_response, instrument_magnitude
from opnav_workbench.photometry.johnson import JOHNSON_B, JOHNSON_V, johnson_magnitude
from opnav_workbench.photometry.spectra import SUN, VEGA, Spectrum, blackbody
from opnav_workbench.photometry.zero_point import (
    SUN_B_V,
    SUN_V_MAG,
    VEGA_V_MAG,
    electron_rate,
    synthetic_magnitude,
    zero_point_mag,
)

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
