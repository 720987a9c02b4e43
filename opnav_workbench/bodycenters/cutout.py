"""The pixels of a window that a body is fitted to."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.picture import BodyPicture

__all__ = ["Cutout", "cut_out"]


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """Data of a window.

    Attributes
    ----------
    window : (int, int, int, int)
    data_dn : (n_line, n_pixel) array
        0 where a pixel is not used.
    noise_dn : (n_line, n_pixel) array
        Without the bodies' own shot noise.
    use, saturated : (n_line, n_pixel) arrays of bool
    gain_e_per_dn : float
        Infinite where the shot noise is not known.
    """

    window: tuple[int, int, int, int]
    data_dn: FloatArray
    noise_dn: FloatArray
    use: BoolArray
    saturated: BoolArray
    gain_e_per_dn: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def weight(self, light_dn: FloatArray | float = 0.0) -> FloatArray:
        """Return 1 / variance of pixels that hold a body's light; 0 for those not used."""
        variance = self.noise_dn**2 + np.maximum(light_dn, 0.0) / self.gain_e_per_dn
        return np.where(self.use, 1.0 / variance, 0.0)


def cut_out(
    picture: BodyPicture, window: tuple[int, int, int, int], *, keep_saturated: bool = False
) -> Cutout:
    """Cut a window, which lies on the detector, out of a picture.

    With `keep_saturated` saturated pixels are used as they are: good enough to see where a body lies.
    """
    pixel, line, n_pixel, n_line = window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    data, noise = picture.signal_dn[part], picture.noise_dn[part]
    saturated = picture.saturated[part]
    sound = np.isfinite(data) & np.isfinite(noise) & (noise > 0.0)
    use = sound & ((~picture.bad[part] | saturated) if keep_saturated else ~(picture.bad[part] | saturated))
    gain = np.inf if picture.noise_model is None else picture.noise_model.gain_e_per_dn
    return Cutout(window, np.where(use, data, 0.0), np.where(sound, noise, 1.0), use, saturated, gain)
