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
    surface: NDArray[np.floating] | None,
    limb_px: FloatArray,
    angle_rad: FloatArray,
    depth_px: FloatArray,
    width_px: float,
) -> NDArray[np.floating]:
    """Return the changes (2, t, n) of light with the shares of it that go to wings and to a halo.

    Parameters
    ----------
    even, surface : (t, n) arrays
        Light of the model, and that of the surface as it has been found; None: it is even.
    limb_px, angle_rad : (t,) arrays
        Radius of the outline in directions all around.
    depth_px : (n,) array
        In even steps.
    width_px
        Sigma of the PSF.
    """
    spread, *patched = _spread([even] if surface is None else [even, surface], limb_px, angle_rad, depth_px)
    outside = np.clip(0.5 + depth_px / (LIMB_WIDTHS * width_px), 0.0, 1.0)
    for found in patched:
        spread = spread + outside * (found - spread)
    return spread - even


def _spread(
    lights: list[NDArray[np.floating]], limb_px: FloatArray, angle_rad: FloatArray, depth_px: FloatArray
) -> list[NDArray[np.floating]]:
    """Return each of the lights (t, n) as wings and as a halo have it (2, t, n).

    Deeper than it is known it goes on as it is.
    """
    t, n = len(angle_rad), len(depth_px)
    farthest = float(limb_px.max() + depth_px[-1])
    apart = float(np.clip(farthest / ALONG_RADIUS, *APART_PX))
    half = int(np.ceil(farthest / apart))
    at = apart * np.arange(-half, half + 1.0)
    reach, around = np.hypot(at, at[:, None]), np.arange(t + 1)
    beyond = float(limb_px.min() + depth_px[0]) - REACH * max(STRAY_PX)
    line, pixel = np.nonzero(reach > beyond)  # deeper in there is nothing that reaches the tables
    angle = np.mod(np.arctan2(at[line], at[pixel]), TURN) * (t / TURN)
    limb = np.interp(angle, around, np.append(limb_px, limb_px[0]))
    column = (reach[line, pixel] - limb - depth_px[0]) / (depth_px[1] - depth_px[0])
    sources = [angle, np.clip(column, 0.0, n - 1.0)]

    size = fft.next_fast_len(len(at) + int(REACH * max(STRAY_PX) / apart), real=True)
    wave = TURN * np.hypot(fft.fftfreq(size, apart)[:, None], fft.rfftfreq(size, apart))
    spreads = [((1.0 + (wave * scale) ** 2) ** -1.5).astype(np.float32) for scale in STRAY_PX]
    away = np.maximum(limb_px[:, None] + depth_px, 0.0) / apart
    places = [half + away * np.sin(angle_rad)[:, None], half + away * np.cos(angle_rad)[:, None]]
    out: list[NDArray[np.floating]] = []
    for light in lights:
        plane = np.where(reach < limb_px.min(), light[:, 0].mean(), 0.0).astype(np.float32)
        found = ndimage.map_coordinates(light[around % t], sources, order=1)
        plane[line, pixel] = np.where(column > n - 1.0, 0.0, found)
        spectrum = fft.rfft2(plane, (size, size))
        planes = (fft.irfft2(spectrum * spread, (size, size)) for spread in spreads)
        out.append(np.stack([ndimage.map_coordinates(each, places, order=1) for each in planes]))
    return out
