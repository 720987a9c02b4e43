"""How strong a body must stand out of the noise to be one."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

__all__ = ["FALSE_ALARM", "detection_snr"]

FALSE_ALARM = 0.01  # one search area in a hundred may hold noise that looks like a body


def detection_snr(search_radius_px: float, sigma_px: float) -> float:
    """Return the SNR that noise alone exceeds, somewhere in a circular search area, with `FALSE_ALARM`.

    The expected Euler characteristic of a Gaussian random field above a level; white noise filtered with a
    Gaussian of `sigma_px` has gradients of variance 1 / (2 sigma^2).

    Reference: Adler (1981), The Geometry of Random Fields; Worsley (1996), doi:10.2307/1427576.

    Examples
    --------
    >>> [round(detection_snr(radius, 0.7), 1) for radius in (3.0, 30.0)]
    [3.7, 4.8]
    """
    radius = search_radius_px / (np.sqrt(2.0) * sigma_px)

    def surplus(level: float) -> float:
        density = np.exp(-0.5 * level**2)
        area = np.pi * radius**2 * level * density / (2.0 * np.pi) ** 1.5
        rim = np.pi * radius * density / (2.0 * np.pi)
        return float(area + rim + ndtr(-level) - FALSE_ALARM)

    return float(brentq(surplus, 1.0, 10.0))
