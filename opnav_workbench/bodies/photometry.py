"""How bright a body is, and how far its light lies from its center of figure.

Both follow from disk-integrated scattering by a sphere; they serve bodies too small to show a disk.
"""

import numpy as np

from opnav_workbench.geometry import AU_KM

__all__ = ["center_of_light_radii", "linear_phase_magnitude"]


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
    distance = 5.0 * np.log10(sun_km * range_km / AU_KM**2)
    return float(absolute_mag + distance + slope_mag_deg * np.degrees(phase_rad))


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
