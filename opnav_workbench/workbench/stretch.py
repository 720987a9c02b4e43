"""How DN become shades: stretches, limits and colour maps, as the page applies them (static/stretch.js), and PNGs.

Flow   DN -> (DN - low)/(high - low), clipped to 0..1 -> stretch -> contrast and bias -> colour map
Habit  the names and constants of SAOImage DS9: log with 1000, asinh with 10, contrast and bias by right drag

PNGs are made of small cutouts (gray, or blue-white-orange for residuals) and of the whole picture, reduced, for front
ends without a live kernel.
"""

import io
from collections.abc import Callable
from types import MappingProxyType

import numpy as np
from astropy.visualization import ZScaleInterval
from bokeh import palettes
from numpy.typing import ArrayLike
from PIL import Image

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.workbench.sent_arrays import block_means

__all__ = [
    "COLORMAPS",
    "DEFAULT_LIMITS",
    "LIMITS",
    "STRETCHES",
    "gray_png",
    "limits_of",
    "picture_png",
    "residual_png",
    "shades",
    "thumbnail_png",
]


# ---- Stretches, limits and colour maps.

LOG_STEEPNESS = 1000.0
ASINH_STEEPNESS = 10.0

STRETCHES: MappingProxyType[str, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {
        "linear": lambda t: t,
        "asinh": lambda t: np.arcsinh(ASINH_STEEPNESS * t) / np.arcsinh(ASINH_STEEPNESS),
        "log": lambda t: np.log1p(LOG_STEEPNESS * t) / np.log1p(LOG_STEEPNESS),
        "sqrt": np.sqrt,
    }
)
# Name shown, and the share of pixels between the limits; None for those that are found otherwise.
PERCENTILES = MappingProxyType({"99.9 %": 99.9, "99.5 %": 99.5, "99 %": 99.0, "95 %": 95.0})
LIMITS = ("sky", "zscale", "min-max", *PERCENTILES, "manual")
DEFAULT_LIMITS = "sky"
ZSCALE_SAMPLES = 4000
# "sky": noise as dark grain, faint stars bright; a body that fills more than a few pixels keeps its shades.
SKY_SIGMAS = (-1.5, 30.0)
SKY_PERCENTILE = 99.7
# Percentiles of more pixels are taken of every k-th: to a thousandth of a sigma the same, and quick at 4096 x 4096.
MOST_SAMPLED = 1_500_000
ZSCALE_LEAST = 5  # pixels; astropy fits a line through them
SIGMAS_1_TO_99 = 4.65  # between the percentiles of a normal distribution


def _heat() -> list[str]:
    """Black, red, yellow, white, as DS9's ``heat``."""
    level = np.linspace(0.0, 3.0, 256)[:, None] - np.arange(3.0)
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in np.rint(255.0 * np.clip(level, 0.0, 1.0)).astype(int)]


COLORMAPS = MappingProxyType(
    {
        "gray": list(palettes.Greys256),
        "heat": _heat(),
        "viridis": list(palettes.Viridis256),
        "cividis": list(palettes.Cividis256),
        "inferno": list(palettes.Inferno256),
    }
)


def limits_of(image_dn: FloatArray, usable: BoolArray | None = None) -> dict[str, tuple[float, float]]:
    """Return low and high of every automatic choice of `LIMITS`, DN.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    usable : (n_line, n_pixel) array of bool, optional
        Pixels to look at; not-finite ones never count.

    Examples
    --------
    >>> limits = limits_of(np.arange(10001.0).reshape(1, -1))
    >>> limits["min-max"], limits["99 %"]
    ((0.0, 10000.0), (50.0, 9950.0))
    """
    good = np.isfinite(image_dn) if usable is None else usable & np.isfinite(image_dn)
    values = image_dn[good] if good.any() else np.zeros(1)
    ends = (values.min(), values.max())
    values = values[:: max(1, len(values) // MOST_SAMPLED)]
    tails = [50.0 + side * 0.5 * share for share in PERCENTILES.values() for side in (-1.0, 1.0)]
    cuts = np.percentile(values, tails).reshape(-1, 2)
    pairs = {"sky": _sky(values), "zscale": _zscale(values), "min-max": ends}
    pairs |= {name: tuple(cut) for name, cut in zip(PERCENTILES, cuts, strict=True)}
    return {name: _apart(float(low), float(high)) for name, (low, high) in pairs.items()}


def _sky(values: FloatArray) -> tuple[float, float]:
    middle, bright, low, high = np.percentile(values, (50.0, SKY_PERCENTILE, 1.0, 99.0))
    sigma = MAD_TO_SIGMA * np.median(np.abs(values - middle))
    if sigma == 0.0:  # noise below the digital step: most pixels share one value
        sigma = (high - low) / SIGMAS_1_TO_99
    return middle + SKY_SIGMAS[0] * sigma, max(middle + SKY_SIGMAS[1] * sigma, bright)


def _zscale(values: FloatArray) -> tuple[float, float]:
    if len(values) < ZSCALE_LEAST:
        return values.min(), values.max()
    low, high = ZScaleInterval(n_samples=ZSCALE_SAMPLES).get_limits(values)
    return float(low), float(high)


def _apart(low: float, high: float) -> tuple[float, float]:
    """Keep limits of a flat picture apart, so that it is shown as one mid shade."""
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def shades(
    image_dn: ArrayLike,
    low: float,
    high: float,
    stretch: str = "asinh",
    *,
    contrast: float = 1.0,
    bias: float = 0.5,
) -> FloatArray:
    """Return the place of each pixel in the colour map, 0..1.

    Examples
    --------
    >>> shades([0.0, 25.0, 100.0, 200.0], 0.0, 100.0, "sqrt")
    array([0. , 0.5, 1. , 1. ])
    """
    share = np.clip((np.asarray(image_dn, float) - low) / (high - low), 0.0, 1.0)
    return np.asarray(np.clip((STRETCHES[stretch](share) - bias) * contrast + 0.5, 0.0, 1.0))


# ---- PNGs of small cutouts: gray, or blue-white-orange for residuals.

RESIDUAL_SIGMAS = 5.0  # full color of the residual picture
MASKED_GRAY = (128, 128, 128)
# Residual pictures run from blue through white to orange, which color-blind readers can tell apart.
BELOW, ABOVE = (33, 102, 172), (214, 96, 0)


def gray_png(image_dn: FloatArray, low_dn: float, high_dn: float, stretch: str = "asinh") -> bytes:
    """Return a picture (n_line, n_pixel) in one of `STRETCHES` as PNG; not-finite pixels are mid-gray."""
    shown = np.isfinite(image_dn)
    high_dn = high_dn if high_dn > low_dn else low_dn + 1.0
    value = shades(np.where(shown, image_dn, low_dn), low_dn, high_dn, stretch)
    gray = np.where(shown, np.rint(255.0 * value), MASKED_GRAY[0]).astype(np.uint8)
    return _quick_png(Image.fromarray(gray))


def residual_png(residual_dn: FloatArray, full_dn: float) -> bytes:
    """Return a residual picture as PNG: white is zero, blue below, orange above; masked pixels are gray."""
    shown = np.isfinite(residual_dn)
    share = np.clip(np.where(shown, residual_dn, 0.0) / max(full_dn, 1e-12), -1.0, 1.0)[..., None]
    ends = np.where(share < 0.0, np.array(BELOW), np.array(ABOVE))
    color = np.where(shown[..., None], 255.0 + np.abs(share) * (ends - 255.0), np.array(MASKED_GRAY))
    return _quick_png(Image.fromarray(np.rint(color).astype(np.uint8)))


def _quick_png(picture: Image.Image) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=False, compress_level=1)
    return stream.getvalue()


# ---- The whole picture, reduced, for front ends without a live kernel.

STILL_LONGEST_PX = 360  # with 16 shades a noisy picture stays below 50 kB, half of what a notebook may weigh
STILL_SHADES = 16


def picture_png(image_dn: FloatArray, low_dn: float, high_dn: float) -> bytes:
    """Return a picture (n_line, n_pixel) as a small gray PNG, reduced and with few shades so that notebooks stay small."""
    n_line, n_pixel = image_dn.shape
    factor = max(1, -(-max(n_line, n_pixel) // STILL_LONGEST_PX))
    shade = np.rint(shades(block_means(image_dn, factor), low_dn, high_dn) * (STILL_SHADES - 1)).astype(
        np.uint8
    )
    picture = Image.fromarray(shade, mode="P")
    picture.putpalette(
        [round(255 * level / (STILL_SHADES - 1)) for level in range(STILL_SHADES) for _ in "rgb"]
    )
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True, bits=4)
    return stream.getvalue()


THUMBNAIL_PX = 44  # of its longer side


def thumbnail_png(image_dn: FloatArray) -> bytes:
    """Return a picture (n_line, n_pixel) as a tiny gray PNG: blocks by their brightest pixel, so that no star is lost."""
    factor = max(1, -(-max(image_dn.shape) // THUMBNAIL_PX))
    padded = np.pad(image_dn, [(0, -size % factor) for size in image_dn.shape], mode="edge")
    height, width = (size // factor for size in padded.shape)
    blocks = np.nan_to_num(padded.reshape(height, factor, width, factor).max(axis=(1, 3)))
    low, high = np.percentile(blocks, (5.0, 99.5))
    return gray_png(blocks, float(low), float(high))
