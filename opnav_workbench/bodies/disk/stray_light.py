"""The light of a disk that a PSF may spread in wings and in a halo, beside what is known of it.

Flow   light of the disk about its limb -> plane of pixels -> spread by wings, by a halo -> changes of the tables
Frame  tables as `opnav_workbench.bodies.disk.limb_light.LimbLight` has them

Both fall off as exp(-r / scale), and many such make up a PSF's wings. They are as wide as small disks, and patches beside
a place shine on it too: so they are spread over the plane, and not along rays.

Outside of the limb that is the light of the surface as the last solution has it. Inside it is that of the model's even
one: a surface that has been fitted to the pixels would explain them a second time, sharper or smoother than it is.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.silhouette import TURN

__all__ = ["stray_light"]

STRAY_PX = (1.6, 6.5)  # scales of wings and halo
REACH = 5.0  # scales, beyond which a plane may begin anew
# Pixels of the plane: so many along the largest radius, and how wide they may be.
ALONG_RADIUS, APART_PX = 150.0, (1.0, 2.0)
LIMB_WIDTHS = 2.0  # of the PSF, over which light of the model gives way to that of the solution


def stray_light(
    even: NDArray[np.floating],
    surface: NDArray[np.floating],
    limb_px: FloatArray,
    first_px: float,
    step_px: float,
    width_px: float,
) -> NDArray[np.floating]:
    """Return the changes (2, t, n) of light with the shares of it that go to wings and to a halo.

    Parameters
    ----------
    even, surface : (t, n) arrays
        Light of the model in t directions and at n depths, and that of the surface as it has been found.
    limb_px : (t,) array
        Radius of the outline.
    first_px, step_px
        Depth of the first column, and from each to the next.
    width_px
        Sigma of the PSF.
    """
    depth: FloatArray = first_px + step_px * np.arange(float(even.shape[1]))
    outside = np.clip(0.5 + depth / (LIMB_WIDTHS * width_px), 0.0, 1.0)
    own = _spread(even, limb_px, depth)
    return np.asarray(own + outside * (_spread(surface, limb_px, depth) - own) - even)


def _spread(light: NDArray[np.floating], limb_px: FloatArray, depth_px: FloatArray) -> NDArray[np.floating]:
    """Return light (t, n) as wings and as a halo have it (2, t, n); deeper than it is known it goes on as it is."""
    t, n = light.shape
    farthest = float(limb_px.max() + depth_px[-1])
    apart = float(np.clip(farthest / ALONG_RADIUS, *APART_PX))
    half = int(np.ceil(farthest / apart))
    at = apart * np.arange(-half, half + 1.0)
    reach, around = np.hypot(at, at[:, None]), np.arange(t + 1)
    plane = np.where(reach < limb_px.min(), light[:, 0].mean(), 0.0)
    beyond = float(limb_px.min() + depth_px[0]) - REACH * max(STRAY_PX)
    line, pixel = np.nonzero(reach > beyond)  # deeper in there is nothing that reaches the tables
    angle = np.mod(np.arctan2(at[line], at[pixel]), TURN) * (t / TURN)
    limb = np.interp(angle, around, np.append(limb_px, limb_px[0]))
    column = (reach[line, pixel] - limb - depth_px[0]) / (depth_px[1] - depth_px[0])
    found = ndimage.map_coordinates(light[around % t], [angle, np.clip(column, 0.0, n - 1.0)], order=1)
    plane[line, pixel] = np.where(column > n - 1.0, 0.0, found)

    size = fft.next_fast_len(len(at) + int(REACH * max(STRAY_PX) / apart), real=True)
    wave = TURN * np.hypot(fft.fftfreq(size, apart)[:, None], fft.rfftfreq(size, apart))
    spectrum = fft.rfft2(plane, (size, size))
    away = np.maximum(limb_px[:, None] + depth_px, 0.0) / apart
    turned = TURN / t * np.arange(t)[:, None]
    places = [half + away * np.sin(turned), half + away * np.cos(turned)]
    spread = (fft.irfft2(spectrum * (1.0 + (wave * scale) ** 2) ** -1.5, (size, size)) for scale in STRAY_PX)
    return np.stack([ndimage.map_coordinates(each, places, order=1) for each in spread])
