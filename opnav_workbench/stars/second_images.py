"""Every star seen twice: ghosts of the optics, and exposures in which the camera jumped.

The second images have the pattern of the field, so that no pattern tells them from the stars: whether a picture has any is
seen in the picture alone, by differences of places that come again and again. Of two images the brighter one is the star,
be the other its reflection or the shorter of two stops: the brighter lasted over the middle of the exposure. Where neither
is the brighter nobody can tell.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.geometry.near_places import NearPlaces, pairs_within
from opnav_workbench.stars.detection import Detections
from opnav_workbench.stars.flags import StarFlag

__all__ = ["CLEARLY_SIGMAS", "SecondImages", "fainter_by", "second_images"]

SEARCHED = 150  # brightest detections, first those as wide as stars
SAME_PX = 0.75  # of a difference of places, each good to some tenths
AROUND_PX = 10.0  # of a difference: there others tell how frequent it is by chance
MIN_APART_PX = 4.0  # nearer ones are the two sides of one image
MIN_IMAGES = 3
CHANCE = 1e-4  # of so many equal differences among detections strewn at random
FLUX_SIGMA_MAG = 0.1  # at least, of a pair's fluxes: three or four do not tell their scatter
CLEARLY_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class SecondImages:
    """Detections that are images of others, `offset_px` away.

    Attributes
    ----------
    offset_px : (2,) array
        From the brighter image to the fainter one, pixel and line.
    first, second : (k,) arrays of int
        Rows of the detections: of the brighter and the fainter image of each star, as their median says.
    fainter_mag, sigma_mag
        How much fainter the second images are in the median, and how well that is known.
    """

    offset_px: FloatArray
    first: IntArray
    second: IntArray
    fainter_mag: float
    sigma_mag: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def clear(self) -> bool:
        """Tell whether one of the two images is the brighter beyond doubt."""
        return self.fainter_mag > CLEARLY_SIGMAS * self.sigma_mag

    @property
    def words(self) -> str:
        """What is seen, in words."""
        share = 10.0 ** (-0.4 * self.fainter_mag)
        return (
            f"{len(self.first)} stars have a second image ({self.offset_px[0]:.1f}, {self.offset_px[1]:.1f}) px away, "
            f"of {share:.2g} of their light"
        )


def second_images(detections: Detections) -> SecondImages | None:
    """Find out whether the stars of a picture are seen twice, all at the same distance; None where they are not.

    Parameters
    ----------
    detections
        From `stars.detect`, brightest first; hits and stars that are seen once may be among them.

    Examples
    --------
    >>> places = np.random.default_rng(2).uniform(0.0, 1000.0, (6, 2))
    >>> both, flux = np.vstack([places, places + [8.0, -3.0]]), np.r_[np.full(6, 100.0), np.full(6, 40.0)]
    >>> twice = second_images(Detections(both, flux, *np.ones((2, 12)), np.zeros(12, int)))
    >>> twice.words, twice.clear, twice.second.tolist()
    ('6 stars have a second image (8.0, -3.0) px away, of 0.4 of their light', True, [6, 7, 8, 9, 10, 11])
    """
    places = np.asarray(detections.pixel_line, float).reshape(-1, 2)
    mag = -2.5 * np.log10(np.maximum(detections.flux_dn, np.finfo(float).tiny))
    searched = np.lexsort((mag, (detections.flags & StarFlag.COSMIC_RAY) > 0))[:SEARCHED]
    offset = _common_difference(places[searched])
    if offset is None:
        return None
    near = NearPlaces(places)
    distance, row = near.nearest(places + offset, within=SAME_PX)
    first = np.flatnonzero(np.isfinite(distance))
    second = row[first]
    saturated = (detections.flags & StarFlag.SATURATED) > 0
    middle, sigma = fainter_by(mag, saturated, first, second)
    if middle < 0.0:
        first, second = second, first
    offset = np.median(places[second] - places[first], axis=0)
    return SecondImages(offset, first, second, abs(middle), sigma)


def fainter_by(
    mag: FloatArray, saturated: BoolArray, first: IntArray, second: IntArray
) -> tuple[float, float]:
    """Return how much fainter the second images (k,) are than the first in the median, and the sigma of it, mag."""
    # Of two saturated images nobody knows which is the brighter.
    known = ~(saturated[first] & saturated[second])
    fainter = (mag[second] - mag[first])[known] if known.any() else np.zeros(1)
    sigma = np.sqrt(0.5 * np.pi / len(fainter)) * np.hypot(FLUX_SIGMA_MAG, np.std(fainter))
    return float(np.median(fainter)), float(sigma)


def _common_difference(places: FloatArray) -> FloatArray | None:
    """Return the difference (2,) that most pairs of places (n, 2) have in common, where chance makes none so frequent."""
    one, two = np.triu_indices(len(places), 1)
    one, two = np.r_[one, two], np.r_[two, one]  # which is the first nobody knows yet
    apart = places[two] - places[one]
    far = np.hypot(*apart.T) > MIN_APART_PX
    one, apart = one[far], apart[far]
    if len(apart) < MIN_IMAGES:
        return None
    middle = np.median(apart[_fullest_cell(apart)], axis=0)
    square = np.sum((apart - middle) ** 2, axis=1)
    same, around = square <= SAME_PX**2, square <= AROUND_PX**2
    # As many as there are by chance: of those strewn over the picture, or around here where false ones crowd.
    area = float(np.prod(np.ptp(places, axis=0)))
    density = len(apart) / max(area, 1.0), (np.sum(around) - np.sum(same)) / (np.pi * AROUND_PX**2)
    by_chance = np.pi * SAME_PX**2 * max(density)
    count = _places_apart(places[one[same]])
    if count < MIN_IMAGES or len(apart) * gammainc(float(count), by_chance) > CHANCE:
        return None
    return np.asarray(np.median(apart[same], axis=0), float)


def _places_apart(places: FloatArray) -> int:
    """Count places (n, 2), those near each other as one: the maxima of one image are no witnesses of their own."""
    alone = np.ones(len(places), bool)
    near = pairs_within(places, AROUND_PX)
    for first, second in near[np.lexsort(near.T[::-1])]:
        alone[second] &= not alone[first]
    return int(alone.sum())


def _fullest_cell(points: FloatArray) -> BoolArray:
    """Tell which points (n, 2) lie in the fullest of cells twice `SAME_PX` wide; cells overlap by half."""
    best = np.zeros(len(points), bool)
    for start in np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]]):
        cell = np.floor(points / (2.0 * SAME_PX) + start).astype(np.int64)
        key = cell[:, 0] * (np.ptp(cell[:, 1]) + 1) + cell[:, 1]
        known, count = np.unique(key, return_counts=True)
        fullest = key == known[np.argmax(count)]
        best = fullest if fullest.sum() > best.sum() else best
    return best
