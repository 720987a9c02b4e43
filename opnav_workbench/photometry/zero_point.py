"""Zero points: the magnitude that gives a camera one data number per second, with Vega as the standard candle."""

import numpy as np

from opnav_workbench.errors import CameraError
from opnav_workbench.photometry.bandpass import Bandpass
from opnav_workbench.photometry.johnson import VEGA_V_MAG, johnson_magnitude
from opnav_workbench.photometry.spectra import VEGA, Spectrum

__all__ = [
    "SUN_B_V",
    "SUN_V_MAG",
    "VEGA_V_MAG",
    "electron_rate",
    "synthetic_magnitude",
    "zero_point_mag",
]

SUN_V_MAG = -26.75  # at 1 au: Colina, Bohlin & Castelli (1996); +- 0.01
SUN_B_V = 0.65  # +- 0.01: Ramirez et al. (2012), doi 10.1088/0004-637X/752/1/5


def electron_rate(
    bandpass: Bandpass, aperture_m: float, obscuration: float = 0.0, spectrum: Spectrum = VEGA
) -> float:
    """Return the electrons per second that a source gives.

    Parameters
    ----------
    bandpass : Bandpass
    aperture_m : float
        Diameter of the entrance pupil.
    obscuration : float
        Share of its area that is obscured.
    spectrum : Spectrum
        Vega by default.

    Raises
    ------
    CameraError
        An aperture that is not positive, or an obscuration outside 0..1.
    """
    if not 0.0 < aperture_m < np.inf or not 0.0 <= obscuration < 1.0:
        raise CameraError(
            f"aperture of {aperture_m} m with {obscuration} of its area obscured; give a positive diameter and a "
            "share from 0 to below 1."
        )
    area_m2 = np.pi / 4.0 * aperture_m**2 * (1.0 - obscuration)
    return float(area_m2 * bandpass.photon_rate(spectrum))


def zero_point_mag(
    bandpass: Bandpass, aperture_m: float, gain_e_per_dn: float, obscuration: float = 0.0
) -> float:
    """Return the magnitude of a star of Vega's color that gives 1 DN/s.

    Parameters
    ----------
    bandpass : Bandpass
    aperture_m : float
        Diameter of the entrance pupil.
    gain_e_per_dn : float
    obscuration : float
        Share of the pupil's area that is obscured.

    Raises
    ------
    CameraError
        A value no camera can have.

    Examples
    --------
    >>> flat = Bandpass([400.0, 401.0, 899.0, 900.0], [0.0, 0.3, 0.3, 0.0])
    >>> round(zero_point_mag(flat, 0.1, 10.0), 2)
    17.45
    """
    if not 0.0 < gain_e_per_dn < np.inf:
        raise CameraError(f"gain is {gain_e_per_dn} e/DN; give a positive number.")
    rate = electron_rate(bandpass, aperture_m, obscuration)
    return float(VEGA_V_MAG + 2.5 * np.log10(rate / gain_e_per_dn))


def synthetic_magnitude(bandpass: Bandpass, spectrum: Spectrum) -> float:
    """Return a source's magnitude in the camera's own band, in which Vega has 0.026."""
    return johnson_magnitude(spectrum, bandpass)
