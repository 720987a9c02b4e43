"""Spectra as photon fluxes at the telescope: photons / (s m^2 nm) against nm."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry.standard_tables import FIRST_NM, STEP_NM, SUN_1E18, VEGA_1E7

__all__ = ["SUN", "VEGA", "Spectrum", "blackbody", "checked_curve"]

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


def _standard(table: tuple[float, ...], unit: float) -> Spectrum:
    wavelength = FIRST_NM + STEP_NM * np.arange(len(table), dtype=np.float64)
    return Spectrum(wavelength, unit * np.array(table, dtype=np.float64))


VEGA = _standard(VEGA_1E7, 1e7)
SUN = _standard(SUN_1E18, 1e18)
