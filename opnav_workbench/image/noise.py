"""Noise of every pixel: what the sky shows, and what the detector must have at least."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import ImageError
from opnav_workbench.image.background import Background

__all__ = ["pixel_noise"]


def pixel_noise(
    background: Background,
    read_noise_dn: float | None,
    gain_e_per_dn: float | None,
    *,
    bias_dn: float = 0.0,
    signal_dn: ArrayLike | None = None,
) -> FloatArray:
    """Combine the measured noise of the background with the detector's read and shot noise.

    ``variance = max(measured^2, read^2 + (level - bias) / gain) + signal / gain``: the measurement holds read
    noise and the sky's shot noise already, so it is raised to the model, not added to it. It exceeds the
    model where faint stars or pattern noise add to it, and falls below in smoothed pictures.

    Parameters
    ----------
    background : Background
    read_noise_dn, gain_e_per_dn : float or None
        Of the camera; None or nan where they are unknown, and that part of the model is left out.
    bias_dn : float
        Electronic offset still contained in the level, which has no shot noise.
    signal_dn : (n_line, n_pixel) array_like, optional
        Model of stars and bodies above the level. Not the picture itself: its noise would steer the weights.

    Returns
    -------
    (n_line, n_pixel) array
        One standard deviation, DN.

    Raises
    ------
    ImageError
        A negative read noise, or a gain that is not positive.

    Examples
    --------
    >>> sky = Background(np.full((2, 2), 44.0), np.full((2, 2), 1.0))
    >>> float(pixel_noise(sky, read_noise_dn=1.1, gain_e_per_dn=22.0)[0, 0]) == (1.1**2 + 2.0) ** 0.5
    True
    """
    read = _known(read_noise_dn, 0.0)
    gain = _known(gain_e_per_dn, np.inf)
    if read < 0.0 or gain <= 0.0:
        raise ImageError(
            f"read noise {read:g} DN and gain {gain:g} e/DN: expected at least 0 and more than 0."
        )
    model = read**2 + np.maximum(background.level_dn - bias_dn, 0.0) / gain
    variance = np.maximum(background.noise_dn**2, model)
    if signal_dn is not None:
        variance = variance + np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0) / gain
    return np.asarray(np.sqrt(variance))


def _known(value: float | None, otherwise: float) -> float:
    return otherwise if value is None or np.isnan(value) else float(value)
