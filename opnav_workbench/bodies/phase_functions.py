"""How the light of a whole body falls with the phase angle: 1 at full phase.

Lambert and Lommel-Seeliger are closed forms for a sphere of uniform albedo (Russell 1916, ApJ 43, 173; van Diggelen
1959); H,G is the empirical law of asteroids.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray

__all__ = ["hg_phase_function", "lambert_phase_function", "lommel_seeliger_phase_function"]

# Bowell et al. (1989), Asteroids II, 524: phi_i = W phi_small + (1 - W) phi_large.
HG_A, HG_B, HG_C = (3.332, 1.862), (0.631, 1.218), (0.986, 0.238)


def lambert_phase_function(phase_rad: ArrayLike) -> FloatArray:
    """Return the light of a Lambert sphere over that at full phase.

    Examples
    --------
    >>> lambert_phase_function(np.radians([0.0, 90.0, 180.0])).round(6) + 0.0
    array([1.     , 0.31831, 0.     ])
    """
    a = np.asarray(phase_rad, dtype=np.float64)
    return np.asarray((np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi)


def lommel_seeliger_phase_function(phase_rad: ArrayLike) -> FloatArray:
    """Return the light of a Lommel-Seeliger sphere over that at full phase, for phases below pi.

    Examples
    --------
    >>> lommel_seeliger_phase_function(np.radians([0.0, 90.0])).round(6)
    array([1.      , 0.376775])
    """
    half = np.maximum(0.5 * np.asarray(phase_rad, dtype=np.float64), 1e-12)  # the product is 0 at 0
    return np.asarray(1.0 - np.sin(half) * np.tan(half) * np.log(1.0 / np.tan(0.5 * half)))


def hg_phase_function(phase_rad: ArrayLike, g: float) -> FloatArray:
    """Return the light of a body with slope parameter G over that at full phase; valid to about 120 deg.

    Examples
    --------
    >>> (-2.5 * np.log10(hg_phase_function(np.radians([0.0, 10.0, 20.0]), 0.15))).round(3) + 0.0
    array([0.   , 0.658, 1.   ])
    """
    a = np.asarray(phase_rad, dtype=np.float64)
    half_tan, sine = np.tan(0.5 * a), np.sin(a)
    weight = np.exp(-90.56 * half_tan**2)
    phi = []
    for big_a, big_b, big_c in zip(HG_A, HG_B, HG_C, strict=True):
        small = 1.0 - big_c * sine / (0.119 + 1.341 * sine - 0.754 * sine**2)
        large = np.exp(-big_a * half_tan**big_b)
        phi.append(weight * small + (1.0 - weight) * large)
    return np.asarray((1.0 - g) * phi[0] + g * phi[1])
