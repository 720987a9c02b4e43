"""The pixels that a body is looked for in: the window about its expected place, and which of its pixels count.

Flow   prediction or analyst's circle -> search radius and sub-array -> data cut out, with weights -> cosmic rays and stars
       left out, told from what surrounds them
"""

from dataclasses import dataclass
from types import EllipsisType

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.constants import MAD_TO_SIGMA

__all__ = [
    "Cutout",
    "SubArray",
    "choose_subarray",
    "cut_out",
    "edge_reach",
    "find_hit_pixels",
    "left_search",
    "outline_radius_px",
    "search_radius",
]


# ---- The part of a picture in which a body is looked for.

SEARCH_SHARE = 1.2  # of the radius: a body may lie beside its prediction by as much as it is wide
MIN_SEARCH_PX = 12.0  # room for attitude and ephemeris errors that nobody announced
CIRCLE_SEARCH_SHARE = 0.5  # an analyst's circle holds most of the body
MIN_CIRCLE_SEARCH_PX = 5.0
PSF_REACH = 4.0  # sigma of the PSF around the outline, and
RIM_PX = 4.0  # a rim that shows the background


@dataclass(frozen=True, slots=True, eq=False)
class SubArray:
    """A window of the detector about a body.

    Attributes
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines; it lies on the detector, and has no pixels where the body does not.
    center_px : (2,) array
        Expected center.
    radius_px
        Expected radius: of an analyst's circle, else of the circle that holds the predicted outline.
    clipped
        Whether the detector's edge cuts the expected body.
    """

    window: tuple[int, int, int, int]
    center_px: FloatArray
    radius_px: float
    clipped: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def empty(self) -> bool:
        """Whether no pixel is left."""
        return min(self.window[2:]) < 1

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices that cut the window out of an array [line, pixel]."""
        pixel, line, n_pixel, n_line = self.window
        return slice(line, line + max(n_line, 0)), slice(pixel, pixel + max(n_pixel, 0))


def search_radius(radius_px: float, circle: Circle | None, given_px: float | None = None) -> float:
    """Return how far from its expected center a body of `radius_px` may be, px."""
    if given_px is not None:
        return max(float(given_px), 1.0)
    if circle is not None:
        return max(CIRCLE_SEARCH_SHARE * circle.radius_px, MIN_CIRCLE_SEARCH_PX)
    return max(SEARCH_SHARE * radius_px, MIN_SEARCH_PX)


def left_search(away_px: float, radius_px: float, circle: Circle | None, given_px: float | None) -> bool:
    """Tell whether a center lies farther from where it was expected than it was looked for; without a limit none does."""
    if circle is None and given_px is None:
        return False
    return away_px > search_radius(radius_px, circle, given_px) + 1.0


def outline_radius_px(picture: BodyPicture, name: str) -> float:
    """Return the radius of the circle that holds a body's predicted outline, px; 0 for a point."""
    prediction = picture.prediction(name)
    limb = prediction.limb_px - prediction.pixel_line
    return float(np.hypot(*limb.T).max()) if len(limb) and np.isfinite(limb).all() else 0.0


def edge_reach(picture: BodyPicture) -> float:
    """Return how far to each side of an edge the picture shows it, px."""
    return PSF_REACH * float(np.max(picture.psf.sigma_px)) + RIM_PX


def choose_subarray(
    picture: BodyPicture, name: str, circle: Circle | None = None, margin: float | None = None
) -> SubArray:
    """Choose the window about a body's expected place, clipped to the detector.

    Parameters
    ----------
    circle
        An analyst's; None: predicted center and size.
    margin
        Pixels around the expected outline; None: the PSF's reach and a rim of background.
    """
    if circle is None:
        center, radius = picture.center_px(name), outline_radius_px(picture, name)
    else:
        center, radius = circle.center_px, circle.radius_px
    if not np.isfinite(center).all():
        return SubArray((0, 0, 0, 0), center, radius)
    if margin is None:
        margin = edge_reach(picture)
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    first = np.clip(np.floor(center - radius - margin), 0, size).astype(int)
    last = np.clip(np.ceil(center + radius + margin), -1, size - 1).astype(int)
    clipped = bool(np.any(center - radius < -0.5) or np.any(center + radius > size - 0.5))
    n_pixel, n_line = (int(n) for n in np.maximum(last - first + 1, 0))
    return SubArray((int(first[0]), int(first[1]), n_pixel, n_line), center, radius, clipped)


# ---- The pixels of a window that a body is fitted to.

Index = EllipsisType | tuple[slice, ...] | tuple[IntArray, ...]


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
    gain_e_per_dn
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
        return np.where(self.use, 1.0 / self.variance_dn2(light_dn), 0.0)

    def variance_dn2(self, light_dn: FloatArray | float, at: Index = ...) -> FloatArray:
        """Return the variance of all pixels, or those `at` an index, that hold a body's light."""
        return np.asarray(self.noise_dn[at] ** 2 + np.maximum(light_dn, 0.0) / self.gain_e_per_dn)


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
    return Cutout(
        window,
        np.where(use, data, 0.0),
        np.where(sound, noise, 1.0),
        use,
        saturated,
        picture.shot_gain_e_per_dn,
    )


# ---- Pixels whose light is not that of the bodies: cosmic rays and stars, told from what surrounds them.

CANDIDATE_SIGMAS = 5.0
HIT_SIGMAS = 6.0  # one false alarm in 500 million pixels of pure noise
TAIL_SIGMAS = 3.0  # of pixels beside a hit
MAX_CANDIDATES = 20_000  # more than a frame's cosmic rays: the model is wrong, not the pixels
AROUND = 2  # pixels to each side: 24 neighbours, of whom a hit of up to 11 pixels cannot set the median
NEIGHBOURS = [
    (line, pixel)
    for line in range(-AROUND, AROUND + 1)
    for pixel in range(-AROUND, AROUND + 1)
    if line or pixel
]


def find_hit_pixels(residual_dn: FloatArray, weight: FloatArray) -> BoolArray:
    """Return pixels that stand out of their surroundings.

    What a model lacks (an albedo pattern, a limb that is off) makes residuals that neighbours share; a hit does not.

    Parameters
    ----------
    residual_dn, weight : (n_line, n_pixel) arrays
        Data minus model; 1 / variance, 0 for pixels that are not used.

    Examples
    --------
    >>> residual = np.zeros((9, 9))
    >>> residual[4, 5] = 8.0
    >>> int(find_hit_pixels(residual, np.ones((9, 9))).sum())
    1
    """
    in_sigmas = np.where(weight > 0.0, residual_dn * np.sqrt(weight), np.nan)
    line, pixel = np.nonzero(np.abs(np.nan_to_num(in_sigmas)) > CANDIDATE_SIGMAS)
    hits = np.zeros(weight.shape, dtype=bool)
    if not 0 < len(line) <= MAX_CANDIDATES:
        return hits
    excess = _excess(in_sigmas, line, pixel)
    hits[line, pixel] = excess > HIT_SIGMAS
    beside = binary_dilation(hits) & ~hits & (weight > 0.0)
    line, pixel = np.nonzero(beside)
    if len(line):
        hits[line, pixel] = _excess(in_sigmas, line, pixel) > TAIL_SIGMAS
    return hits


def _excess(in_sigmas: FloatArray, line: np.ndarray, pixel: np.ndarray) -> FloatArray:
    """How far pixels (n,) lie from the median of their neighbours, in units of noise and the neighbours' own scatter."""
    padded = np.pad(in_sigmas, AROUND, constant_values=np.nan)
    around = np.stack([padded[line + AROUND + a, pixel + AROUND + b] for a, b in NEIGHBOURS])
    known = np.isfinite(around)
    enough = known.sum(axis=0) >= len(NEIGHBOURS) // 3
    around = np.where(known | ~enough, np.where(enough, around, 0.0), np.nan)
    middle = np.nanmedian(around, axis=0)
    scatter = MAD_TO_SIGMA * np.nanmedian(np.abs(around - middle), axis=0)
    away = np.abs(in_sigmas[line, pixel] - middle)
    return np.asarray(np.where(enough, away / np.maximum(scatter, 1.0), 0.0))
