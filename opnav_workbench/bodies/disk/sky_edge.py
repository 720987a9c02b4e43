"""Where the sky about a disk ends: an outline that asks each pixel by itself, whatever is painted on the body.

A likelihood that gives a limb an albedo may take the edge of a dark patch for the limb, and then explains the rest badly.
Here every pixel is either sky, or body with any albedo at all: light where the model has sky is as unlikely as the noise
makes it, while no light where it has body is hardly doubted.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.limb_cells import angle_and_depth, limb_pixels
from opnav_workbench.bodies.disk.limb_light import LimbLight
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["outline_by_sky", "surprise"]

REACH_SHARE = 0.25  # of the radius, to each side of the fitted outline
MOST_PIXELS = 2000
BEGUN_SHARES = (-0.05, 0.0, 0.05)  # of the radius: sizes to begin with
STEP_SHARE, CLOSE_PX, CLOSE_COST, MOST_CALLS = 0.03, 0.1, 1.0, 120
ALBEDOS = (0.2, 0.4, 0.7)  # relative scatter from pixel to pixel; the likeliest counts
MOST_SIGMAS = 5.0  # that a pixel counts for: what a star or a hit may do


def outline_by_sky(
    pixels: Cutout, outline: Outline, light: LimbLight, brightness_dn: float
) -> tuple[FloatArray, float]:
    """Return center (2,) and growth (logarithm of the size) of the likeliest outline of the same shape as one."""
    radius = 0.5 * outline.diameter_px
    reach = REACH_SHARE * radius
    line, pixel = limb_pixels(outline, pixels.use.shape, reach, reach).index
    usable = np.flatnonzero(pixels.use[line, pixel])
    index = line, pixel = tuple(at[usable[:: -(-len(usable) // MOST_PIXELS) or 1]] for at in (line, pixel))
    data, x, y = pixels.data_dn[index], pixel.astype(np.float64), line.astype(np.float64)

    def cost(step: FloatArray) -> float:
        if max(float(np.hypot(step[0], step[1])), abs(float(step[2]))) > reach:
            return np.inf  # no pixels are asked for there
        moved = Outline(
            outline.center_px + step[:2], outline.angle_rad, outline.radius_px * (1.0 + step[2] / radius)
        )
        angle, depth = angle_and_depth(moved, x, y)
        model = brightness_dn * light.at(angle, np.maximum(depth, light.first_px), 1)[0]
        variance = pixels.variance_dn2(model, index)
        square, wide = (data - model) ** 2 / variance, model**2 / variance
        return surprise(square, wide, ALBEDOS)

    tried = [_descended(cost, share * radius, STEP_SHARE * radius) for share in BEGUN_SHARES]
    found = min(tried, key=lambda each: float(each.fun)).x
    return np.asarray(outline.center_px + found[:2]), float(np.log1p(found[2] / radius))


def surprise(square: FloatArray, wide: FloatArray, scatters: Iterable[float]) -> float:
    """Return minus twice the logarithm of a likelihood of pixels (n,), each by itself, but for a constant of theirs.

    `square` holds their residuals and `wide` their light, both squared and over the variance of their noise; of the
    scatters that albedo may have from pixel to pixel, relative, the likeliest counts.
    """

    def of(scatter: float) -> float:
        whole = 1.0 + scatter**2 * wide
        return float(np.sum(np.minimum(square / whole, MOST_SIGMAS**2) + np.log(whole)))

    return min(of(scatter) for scatter in scatters)


def _descended(cost: Callable[[FloatArray], float], grown_px: float, step_px: float) -> OptimizeResult:
    """Return to which step of center and radius (3,), px, a simplex descends from a radius larger by `grown_px`."""
    begin = np.array([0.0, 0.0, grown_px])
    corners = begin + step_px * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return minimize(
        cost,
        begin,
        method="Nelder-Mead",
        options={"initial_simplex": corners, "xatol": CLOSE_PX, "fatol": CLOSE_COST, "maxfev": MOST_CALLS},
    )
