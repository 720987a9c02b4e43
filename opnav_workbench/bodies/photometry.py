"""How bright a body is, and how far its light lies from its center of figure.

Both follow from disk-integrated scattering by a sphere; they serve bodies too small to show a disk.

The magnitude of a body is ``H + 5 log10(r D) - 2.5 log10 phi(alpha)``, with r and D its distances from Sun and
observer in au and phi one of `phase_functions` or a straight line in magnitudes.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.phase_functions import hg_phase_function, lambert_phase_function
from opnav_workbench.geometry import AU_KM
from opnav_workbench.photometry import SUN_V_MAG

__all__ = [
    "absolute_magnitude",
    "center_of_light_radii",
    "diameter_km",
    "disk_magnitude",
    "distance_magnitude",
    "hg_magnitude",
    "linear_phase_magnitude",
]

DIAMETER_KM = (
    1329.0  # of a body of albedo 1 and H = 0: by convention, for a Sun of V = -26.76 (Harris & Lagerros 2002)
)


def distance_magnitude(sun_km: float, range_km: float) -> float:
    """Return ``5 log10(r D)``: what the distances from Sun and observer add to an absolute magnitude.

    Examples
    --------
    >>> round(distance_magnitude(2.0 * AU_KM, 0.5 * AU_KM), 6)
    0.0
    """
    return float(5.0 * np.log10(sun_km / AU_KM * (range_km / AU_KM)))


def linear_phase_magnitude(
    absolute_mag: float, slope_mag_deg: float, sun_km: float, range_km: float, phase_rad: float
) -> float:
    """Apparent magnitude with a linear phase law, ``H + 5 log10(r D) + beta alpha``.

    Parameters
    ----------
    absolute_mag : float
        H: magnitude at 1 au from Sun and observer, phase 0.
    slope_mag_deg : float
        beta, mag/deg.
    sun_km, range_km : float
        Distances body - Sun and body - spacecraft.
    phase_rad : float
        Sun - body - spacecraft angle.

    Examples
    --------
    Pluto from New Horizons in April 2015:

    >>> round(linear_phase_magnitude(-0.55, 0.0294, 32.8 * AU_KM, 0.77 * AU_KM, 0.26), 2)
    6.9
    """
    return float(absolute_mag + distance_magnitude(sun_km, range_km) + slope_mag_deg * np.degrees(phase_rad))


def hg_magnitude(absolute_mag: float, g: float, sun_km: float, range_km: float, phase_rad: float) -> float:
    """Apparent magnitude in the H,G system of asteroids (Bowell et al. 1989).

    Parameters
    ----------
    absolute_mag, g : float
        H, mag, and slope parameter G.
    sun_km, range_km : float
        Distances body - Sun and body - spacecraft.
    phase_rad : float
        Sun - body - spacecraft angle, up to about 120 deg.

    Examples
    --------
    Bennu from OSIRIS-REx on 2018-08-17 (H 20.61, G -0.08), 2.2 million km away:

    >>> round(hg_magnitude(20.61, -0.08, 1.19 * AU_KM, 2.2e6, np.radians(43.0)), 1)
    14.1
    """
    fading = float(hg_phase_function(phase_rad, g))
    return absolute_mag + distance_magnitude(sun_km, range_km) - 2.5 * float(np.log10(fading))


def absolute_magnitude(geometric_albedo: float, diameter: float) -> float:
    """Return H of a body of a geometric albedo and a diameter in km.

    Examples
    --------
    >>> round(absolute_magnitude(0.52, 2376.6), 2), round(absolute_magnitude(0.044, 0.49), 2)
    (-0.55, 20.56)
    """
    return float(5.0 * np.log10(DIAMETER_KM / (diameter * np.sqrt(geometric_albedo))))


def diameter_km(absolute_mag: float, geometric_albedo: float) -> float:
    """Return the diameter of a body, ``1329 km / sqrt(p) 10^(-H/5)``.

    Examples
    --------
    >>> round(diameter_km(20.56, 0.044), 2)
    0.49
    """
    return float(DIAMETER_KM / np.sqrt(geometric_albedo) * 10.0 ** (-0.2 * absolute_mag))


def disk_magnitude(
    geometric_albedo: float,
    radius_km: float,
    sun_km: float,
    range_km: float,
    phase_rad: float,
    phase_function: Callable[[ArrayLike], FloatArray] = lambert_phase_function,
) -> float:
    """Return the V magnitude of a sphere from its albedo and size: the Sun's, reflected.

    The sphere's disk sends back ``p phi(alpha) (R / D)^2 / r^2`` of the sunlight at 1 au.

    Parameters
    ----------
    geometric_albedo : float
        Brightness at zero phase over that of a white Lambert disk of its size; 2/3 for a white Lambert sphere.
    radius_km : float
        Of a sphere; of an ellipsoid that of a disk of the area seen.
    sun_km, range_km : float
        Distances body - Sun and body - spacecraft.
    phase_rad : float
        Sun - body - spacecraft angle.
    phase_function : callable
        `lambert_phase_function` or `lommel_seeliger_phase_function`.

    Examples
    --------
    The full Moon (p 0.12):

    >>> round(disk_magnitude(0.12, 1737.4, AU_KM, 384400.0, 0.0), 1)
    -12.7
    """
    share = geometric_albedo * phase_function(phase_rad) * (radius_km / range_km * AU_KM / sun_km) ** 2
    with np.errstate(divide="ignore"):
        return float(SUN_V_MAG - 2.5 * np.log10(share))  # infinite where nothing is lit


def center_of_light_radii(phase_rad: float) -> tuple[float, float]:
    """Shift of a sphere's center of light from its center toward the Sun, in radii of the sphere, projected.

    Closed forms for Lambert and Lommel-Seeliger scattering; real surfaces lie between them.

    Parameters
    ----------
    phase_rad : float
        0 to pi.

    Returns
    -------
    shift, sigma : float
        Mean of the two laws, and half their difference as what is not known of the surface.

    Examples
    --------
    >>> [round(x, 4) for x in center_of_light_radii(np.radians(15.0))]
    [0.0938, 0.0047]
    """
    a = float(np.clip(phase_rad, 1e-9, np.pi - 1e-9))
    disk = np.sin(a) + (np.pi - a) * np.cos(a)
    lambert = 3.0 * np.pi / 16.0 * np.sin(a) * (1.0 + np.cos(a)) / disk
    dark = 1.0 - np.sin(a / 2.0) * np.tan(a / 2.0) * np.log(1.0 / np.tan(a / 4.0))
    lommel_seeliger = 2.0 / (3.0 * np.pi) * np.tan(a / 2.0) * disk / dark
    return float(0.5 * (lambert + lommel_seeliger)), float(0.5 * abs(lambert - lommel_seeliger))
