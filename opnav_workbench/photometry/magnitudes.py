"""Magnitudes of a camera with Vega as the standard candle: zero points, and what a star's color does.

A zero point is the magnitude of a star that gives one data number per second. A catalog gives V and B - V; a camera
without filter sees another band. With the color c = B - V

    m = V + s (c - c0) + q (c^2 - c0^2),

where c0 is the color of the stars for which the camera's zero point holds (Vega's, 0, for a computed one).

s and q come from synthetic photometry of "stars" of 3000 to 20000 K: Vega's spectrum times the ratio of two black
bodies. Such a star has the colors of a real one that is 10 % hotter, but the relation between its two colors is that of
real stars: the Sun's spectrum lies within 0.04 mag of it for the cameras at hand. Real stars also scatter by their
lines and bands; the sigma holds the misfit of the formula, that of the Sun, and no less than 0.02 mag.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry.bandpass import JOHNSON_B, VEGA_V_MAG, Bandpass, johnson_magnitude
from opnav_workbench.photometry.spectra import SUN, VEGA, Spectrum, blackbody

__all__ = [
    "SUN_B_V",
    "SUN_V_MAG",
    "ColorResponse",
    "color_response",
    "electron_rate",
    "instrument_magnitude",
    "synthetic_magnitude",
    "zero_point_mag",
]


# ---- Zero points: the magnitude that gives a camera one data number per second.

SUN_V_MAG = -26.75  # at 1 au: Colina, Bohlin & Castelli (1996); +- 0.01
SUN_B_V = 0.65  # +- 0.01: Ramirez et al. (2012), doi 10.1088/0004-637X/752/1/5


def electron_rate(
    bandpass: Bandpass, aperture_m: float, obscuration: float = 0.0, spectrum: Spectrum = VEGA
) -> float:
    """Return the electrons per second that a source gives.

    Parameters
    ----------
    aperture_m
        Diameter of the entrance pupil.
    obscuration
        Share of its area that is obscured.
    spectrum
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
    aperture_m
        Diameter of the entrance pupil.
    obscuration
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


# ---- What a star's color does to its magnitude in a camera.

VEGA_TEMPERATURE_K = 9550.0  # Castelli & Kurucz (1994)
TEMPERATURES_K = (3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5800.0, 6500.0, 7500.0, 9550.0, 13000.0, 20000.0)
MEAN_B_V, SCATTER_B_V = 0.75, 0.45  # of stars of V 6 to 12 in the Tycho-2 catalog's bands, all over the sky
UNKNOWN_SIGMA_MAG = 0.1  # of a magnitude or a color whose error a catalog does not give
MIN_SIGMA_MAG = 0.02  # no parabola through the colors of real stars is better than this
COLOR_RANGE = (-0.4, 2.0)  # beyond, the color of the end is taken


@dataclass(frozen=True, slots=True)
class ColorResponse:
    """Instrument magnitude minus V, as a parabola in B - V.

    Attributes
    ----------
    slope_mag_per_bv
        At B - V = 0; negative for a camera that is redder than V.
    sigma_mag
        One-sigma scatter of single stars about it.
    reference_b_v
        Color for which the instrument magnitude is V.
    curvature_mag_per_bv2
        0: a straight line.
    """

    slope_mag_per_bv: float
    sigma_mag: float
    reference_b_v: float = 0.0
    curvature_mag_per_bv2: float = 0.0

    def offset(self, b_v: ArrayLike) -> FloatArray:
        """Return instrument magnitude minus V at colors (...)."""
        color = np.clip(np.asarray(b_v, dtype=np.float64), *COLOR_RANGE)
        change = color - self.reference_b_v
        both = color + self.reference_b_v
        return np.asarray(change * (self.slope_mag_per_bv + self.curvature_mag_per_bv2 * both))

    def slope_at(self, b_v: ArrayLike) -> FloatArray:
        """Return d(instrument magnitude)/d(B - V) at colors (...)."""
        color = np.clip(np.asarray(b_v, dtype=np.float64), *COLOR_RANGE)
        return np.asarray(self.slope_mag_per_bv + 2.0 * self.curvature_mag_per_bv2 * color)


def color_response(bandpass: Bandpass, reference_b_v: float = 0.0) -> ColorResponse:
    """Return the color response of a band pass by synthetic photometry.

    Parameters
    ----------
    reference_b_v
        Color of the stars for which the camera's zero point holds; 0 for a computed one.

    Examples
    --------
    >>> from opnav_workbench.photometry import JOHNSON_V
    >>> response = color_response(JOHNSON_V)
    >>> abs(response.slope_mag_per_bv), response.sigma_mag
    (0.0, 0.02)
    """
    stars = [_synthetic_star(t) for t in TEMPERATURES_K]
    v, b_v, m = np.array([_v_color_and_magnitude(bandpass, star) for star in [*stars, SUN]]).T
    powers, offset = np.stack([b_v, b_v**2], axis=-1), m - v
    line = slice(0, len(stars))
    slope, curvature = np.linalg.lstsq(powers[line], offset[line])[0]
    misfit = offset - powers @ np.array([slope, curvature])
    sigma = float(np.sqrt(np.mean(misfit[line] ** 2) + misfit[-1] ** 2 + MIN_SIGMA_MAG**2))
    return ColorResponse(round(float(slope), 4), round(sigma, 4), reference_b_v, round(float(curvature), 4))


def instrument_magnitude(
    v_mag: ArrayLike, v_sigma: ArrayLike, b_v: ArrayLike, b_v_sigma: ArrayLike, response: ColorResponse
) -> tuple[FloatArray, FloatArray]:
    """Return magnitudes in a camera's band and their one-sigma errors.

    Parameters
    ----------
    v_mag, v_sigma : (n,) array_like
        Johnson V; an unknown error (nan) counts as 0.1 mag.
    b_v, b_v_sigma : (n,) array_like
        Johnson B - V; an unknown color (nan) counts as 0.75 +- 0.45, that of the stars of all-sky catalogs.

    Returns
    -------
    mag, sigma : (n,) arrays
        nan where V is.

    Examples
    --------
    >>> mag, sigma = instrument_magnitude([9.0, 9.0], 0.02, [1.0, np.nan], 0.03, ColorResponse(-0.2, 0.03))
    >>> mag.round(2).tolist(), sigma.round(2).tolist()
    ([8.8, 8.85], [0.04, 0.1])
    """
    v, dv, color, dcolor = np.broadcast_arrays(
        *(np.asarray(a, dtype=np.float64) for a in (v_mag, v_sigma, b_v, b_v_sigma))
    )
    known = np.isfinite(color)
    color_sigma = np.where(known, np.where(np.isfinite(dcolor), dcolor, UNKNOWN_SIGMA_MAG), SCATTER_B_V)
    v_error = np.where(np.isfinite(dv), dv, UNKNOWN_SIGMA_MAG)
    color = np.where(known, color, MEAN_B_V)
    mag = v + response.offset(color)
    sigma = np.sqrt(v_error**2 + (response.slope_at(color) * color_sigma) ** 2 + response.sigma_mag**2)
    return mag, np.where(np.isfinite(v), sigma, np.nan)


def _synthetic_star(temperature_k: float) -> Spectrum:
    grid = VEGA.wavelength_nm
    ratio = (
        blackbody(temperature_k, grid).photons_s_m2_nm / blackbody(VEGA_TEMPERATURE_K, grid).photons_s_m2_nm
    )
    return VEGA.times(ratio)


def _v_color_and_magnitude(bandpass: Bandpass, spectrum: Spectrum) -> tuple[float, float, float]:
    """Return V, B - V and the magnitude in the band."""
    v = johnson_magnitude(spectrum)
    return v, johnson_magnitude(spectrum, JOHNSON_B) - v, synthetic_magnitude(bandpass, spectrum)
