"""Where the limb of an overexposed body lies, by the light that falls off beside it.

Half of a brightness that was cut off lies too far out, the farther the brighter the body is there, and a surface is bright
here and dark there. But blurred light falls off the steeper, in proportion, the farther out it is seen: between the level
at which the picture saturates and a share of it a ray tells both, how bright the limb is and where.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Flanks", "hidden_limbs", "limb_flanks", "outermost_fall"]

REACHED, LOW = 0.8, 0.06  # shares of the level that light is read between
# Where light has come down to `REACHED`, in widths outside of the limb; brighter than a thousand times the level is nothing.
PLACES = np.linspace(-0.5, 3.0, 36)
TRUE_SHARE = 0.05  # of the light along a ray: it is interpolated, and no limb is a plain step
SKY = (4.0, 6.0)  # widths, from there: light that goes on is not the limb's
BESIDE = 1.5  # widths between half of the light and the level: farther in, what is cut off is a patch and not the limb


class Flanks(NamedTuple):
    """Limbs along n rays: depth (n,), nan where nothing is told, and its sigma (n,)."""

    depth_px: FloatArray
    sigma_px: FloatArray


def hidden_limbs(
    profile: FloatArray, depth_px: FloatArray, level: float, half_px: FloatArray, sigma_px: float
) -> BoolArray:
    """Tell along which rays (n, m) light reaches a level just behind where it is half of what it is (n,)."""
    edge, _, found = _level_reached(profile, depth_px, level)
    return np.asarray(found & (np.nan_to_num(half_px, nan=-np.inf) - edge < BESIDE * sigma_px))


def limb_flanks(
    profile: FloatArray,
    valid: BoolArray,
    depth_px: FloatArray,
    level: float,
    sigma_px: float,
    noise: float,
    shot: float,
) -> Flanks:
    """Return the limbs beside light that is cut off.

    Parameters
    ----------
    profile, valid : (n, m) arrays
        Light along rays, and which of it is known.
    depth_px : (m,) array
        Evenly spaced, outward.
    level
        At which the light is cut off.
    sigma_px
        Width that a step of light has.
    noise, shot
        Of the light: standard deviation in the dark; variance over brightness.
    """
    step = float(depth_px[1] - depth_px[0])
    edge, first, found = _level_reached(profile, depth_px, level)
    at = first[:, None] + np.arange(int(np.ceil(SKY[1] * sigma_px / step)) + 2)
    inside = at < profile.shape[1]
    at = np.minimum(at, profile.shape[1] - 1)
    rows = np.arange(len(profile))[:, None]
    light, usable = profile[rows, at], valid[rows, at] & inside
    away = (depth_px[at] - edge[:, None]) / sigma_px
    sky = usable & (away > SKY[0]) & (away < SKY[1])
    light = light - (np.sum(light * sky, axis=1) / np.maximum(sky.sum(axis=1), 1))[:, None]
    used = usable & (away > 0.0) & (away < SKY[0]) & (light > LOW * level)
    variance = np.finfo(float).tiny + noise**2 + shot * np.maximum(light, 0.0) + (TRUE_SHARE * light) ** 2
    # Samples of an interpolation closer than a width are one measurement.
    weight = np.where(used, min(step / sigma_px, 1.0) / variance, 0.0)
    shape = ndtr(-(away + PLACES[:, None, None]))
    power = np.maximum(np.einsum("nm,tnm->tn", weight, shape**2), np.finfo(float).tiny)
    bright = np.einsum("nm,tnm->tn", weight * light, shape) / power
    cost = np.sum(weight * light**2, axis=1) - bright**2 * power
    share = np.exp(-0.5 * (cost - cost.min(axis=0)))
    share /= share.sum(axis=0)
    mean = PLACES @ share
    sigma = np.sqrt(np.maximum(PLACES**2 @ share - mean**2, 0.0))
    found &= used.any(axis=1)
    return Flanks(np.where(found, edge - mean * sigma_px, np.nan), sigma * sigma_px)


def _level_reached(
    profile: FloatArray, depth_px: FloatArray, level: float
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Return where profiles (n, m) come down to `REACHED` of a level, outermost; the next sample; if they do."""
    wanted = np.full(len(profile), REACHED * level)
    over = profile > wanted[:, None]
    edge, last = outermost_fall(profile, depth_px, over, wanted)
    return edge, last + 1, np.asarray(over.any(axis=1))


def outermost_fall(
    profile: FloatArray, depth_px: FloatArray, over: BoolArray, wanted: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return where profiles (n, m) come down to a value (n,) after the last sample that is `over` it, and that sample."""
    m, rows = profile.shape[1], np.arange(len(profile))
    last = np.clip(m - 1 - over[:, ::-1].argmax(axis=1), 0, m - 2)
    top, below = profile[rows, last], profile[rows, last + 1]
    part = np.clip((top - wanted) / np.maximum(top - below, 1e-12), 0.0, 1.0)
    return depth_px[last] + part * float(depth_px[1] - depth_px[0]), last
