"""Spectra as photon fluxes at the telescope, photons / (s m^2 nm) against nm: Vega, the Sun, black bodies.

Vega and the Sun are tables from 300 to 1100 nm, averaged over steps of 10 nm. They are made from the spectra of the
CALSPEC library of the Space Telescope Science Institute, as the package pyphot 2.1 has them:

Vega  STIS distribution of Bohlin & Gilliland (2004), doi:10.1086/420715 (arXiv astro-ph/0403712), scaled by 0.9933 to
      3.44e-9 erg/cm2/s/A (962 photons/cm2/s/A) at 555.6 nm: Bohlin, Gordon & Tremblay (2014), doi:10.1086/677655. It
      takes the place of Hayes (1985), IAU Symp. 111, 225, whose Balmer and Paschen lines it corrects. V = 0.026.
Sun   sun_reference_stis_001 (Colina, Bohlin & Castelli 1996, doi:10.1086/118016; Neckel & Labs 1984 from 410 to 870
      nm), at 1 au: 176 erg/cm2/s/A at 607.6 nm. With this Vega it gives V = -26.75 and B - V = 0.65.

Averages of the original's linear interpolation, so that a band as wide as a camera's is integrated to 0.1 %.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError

__all__ = ["SUN", "VEGA", "Spectrum", "blackbody", "checked_curve"]


# ---- Photon fluxes of Vega and the Sun, 300 to 1100 nm, averaged over steps of 10 nm.

FIRST_NM, STEP_NM = 300.0, 10.0  # middles of the steps

# fmt: off
VEGA_1E7 = (  # photons / (s m^2 nm), in units of 1e7
    5.49, 5.459, 5.415, 5.469, 5.484, 5.513, 5.521, 5.915, 9.481, 14.34, 14.84, 14.15, 16.39, 13.65, 14.38,
    14.43, 13.89, 13.4, 12.36, 10.62, 11.87, 11.44, 10.93, 10.53, 10.15, 9.808, 9.473, 9.152, 8.842, 8.532,
    8.254, 7.984, 7.715, 7.473, 7.223, 6.814, 6.046, 6.579, 6.392, 6.203, 6.019, 5.838, 5.672, 5.511,
    5.354, 5.2, 5.062, 4.92, 4.773, 4.65, 4.528, 4.415, 4.29, 4.198, 4.081, 3.908, 3.867, 3.793, 3.94,
    3.833, 3.671, 4.013, 3.541, 3.775, 3.787, 3.433, 3.364, 3.521, 3.444, 3.349, 3.067, 2.949, 3.119,
    3.052, 2.981, 2.908, 2.843, 2.759, 2.703, 2.409, 2.461,
)
SUN_1E18 = (  # photons / (s m^2 nm) at 1 au, in units of 1e18
    0.7973, 1.011, 1.176, 1.65, 1.629, 1.753, 1.753, 2.146, 2.087, 2.115, 3.079, 3.564, 3.652, 3.453,
    4.066, 4.53, 4.737, 4.726, 4.911, 4.673, 4.846, 4.951, 4.77, 5.013, 5.097, 5.199, 5.2, 5.297, 5.394,
    5.307, 5.353, 5.334, 5.296, 5.292, 5.286, 5.218, 5.066, 5.179, 5.124, 5.065, 4.977, 4.973, 4.883,
    4.893, 4.799, 4.801, 4.761, 4.669, 4.669, 4.636, 4.591, 4.543, 4.483, 4.452, 4.412, 4.235, 4.262,
    4.138, 4.154, 4.118, 4.057, 3.976, 3.911, 3.938, 3.88, 3.834, 3.815, 3.769, 3.745, 3.708, 3.677, 3.609,
    3.58, 3.561, 3.512, 3.475, 3.429, 3.354, 3.305, 3.245, 3.194,
)


# ---- Spectra as photon fluxes at the telescope: photons / (s m^2 nm) against nm.

SECOND_RADIATION_NM_K = 1.438776877e7  # h c / k


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A photon flux between its first and last wavelength, linear between the points; unknown outside.

    Attributes
    ----------
    wavelength_nm : (n,) array
        Increasing.
    photons_s_m2_nm : (n,) array

    Raises
    ------
    CameraError
        Fewer than two points, wavelengths that do not increase, or a flux that is negative or not finite.

    Examples
    --------
    >>> round(float(VEGA.at(555.6)) / 1e5)  # photons / (s cm^2 Angstrom)
    962
    """

    wavelength_nm: FloatArray
    photons_s_m2_nm: FloatArray

    def __post_init__(self) -> None:
        wavelength, flux = checked_curve("spectrum", self.wavelength_nm, self.photons_s_m2_nm)
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "photons_s_m2_nm", flux)
        freeze_arrays(self)

    def at(self, wavelength_nm: FloatArray | float) -> FloatArray:
        """Return the photon flux at wavelengths (...); that of the nearest end outside the table."""
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, self.photons_s_m2_nm))

    def times(self, factor: FloatArray | float) -> "Spectrum":
        """Return the spectrum multiplied by a factor: one number, or one for each of its points."""
        return Spectrum(self.wavelength_nm, self.photons_s_m2_nm * factor)


def blackbody(temperature_k: float, wavelength_nm: FloatArray) -> Spectrum:
    """Return the shape of a black body's photon flux (Planck's law), 1 at 550 nm.

    Examples
    --------
    >>> blackbody(5772.0, np.array([450.0, 550.0, 900.0])).photons_s_m2_nm.round(3)
    array([0.809, 1.   , 0.858])
    """
    if not 0.0 < temperature_k < np.inf:
        raise CameraError(f"black body of {temperature_k} K; give a positive temperature.")
    scale = SECOND_RADIATION_NM_K / temperature_k

    def photons(at_nm: FloatArray | float) -> FloatArray:
        return np.asarray(1.0 / (np.asarray(at_nm) ** 4 * np.expm1(scale / np.asarray(at_nm))))

    return Spectrum(wavelength_nm, photons(wavelength_nm) / photons(550.0))


def checked_curve(what: str, wavelength_nm: object, values: object) -> tuple[FloatArray, FloatArray]:
    """Return wavelengths and values as arrays (n,).

    Raises
    ------
    CameraError
        Not two or more points of increasing wavelength with values that are finite and not negative.
    """
    try:
        x, y = (np.array(a, dtype=np.float64) for a in (wavelength_nm, values))
    except (TypeError, ValueError) as error:
        raise CameraError(f"{what}: {error}; give wavelengths in nm and values, one for each.") from error
    if x.ndim != 1 or len(x) < 2 or x.shape != y.shape:
        raise CameraError(f"{what}: {x.shape} wavelengths and {y.shape} values; give n >= 2 of each.")
    if not np.isfinite(x).all() or not (np.diff(x) > 0.0).all() or x[0] <= 0.0:
        raise CameraError(
            f"{what}: wavelengths must be positive and increase, in nm; they start {x[:4].tolist()}."
        )
    if not np.isfinite(y).all() or np.any(y < 0.0):
        raise CameraError(f"{what}: values down to {np.nanmin(y):.3g}; give finite ones, not negative.")
    return x, y


def _standard_spectrum(table: tuple[float, ...], unit: float) -> Spectrum:
    wavelength = FIRST_NM + STEP_NM * np.arange(len(table), dtype=np.float64)
    return Spectrum(wavelength, unit * np.array(table, dtype=np.float64))


VEGA = _standard_spectrum(VEGA_1E7, 1e7)
SUN = _standard_spectrum(SUN_1E18, 1e18)
