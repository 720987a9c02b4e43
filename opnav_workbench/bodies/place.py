"""Where a body stands in the picture, before anything is fitted: its silhouette against the sky, then its lit limb.

Flow   model -> which part of its outline is lit -> data above the sky, whatever their brightness -> correlation of the two,
       near by and over the frame -> what else may be there: other bodies, stars -> center and size that the limb's crossings
       from there agree with (`opnav_workbench.bodies.crossings`)
Frame  (pixel, line)
Units  px, DN

A surface may be bright here and dark there, the Sun may light half of it, pixels may be saturated: against the sky all
of that is the body. So the search sees one bit a pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import grey_opening, map_coordinates, maximum_filter
from skimage.measure import block_reduce

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.crossings import cross_limb, fit_crossings, radiance_profiles
from opnav_workbench.bodies.neighbours import near_bodies, without_bodies
from opnav_workbench.bodies.picture import BodyPicture, Circle, displaced_model, pixel_rays
from opnav_workbench.bodies.place_search import CorrelationPeak, brightest_point, search_place
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.bodies.spilled import without_spilled
from opnav_workbench.bodies.strained import can_be_strained, strained_picture
from opnav_workbench.bodies.subarray import edge_reach, search_radius
from opnav_workbench.render.body import PlacedBody

__all__ = ["BodyPlace", "find_place", "is_pointlike", "without_stars"]


@dataclass(frozen=True, slots=True, eq=False)
class BodyPlace:
    """Where a body was found.

    Attributes
    ----------
    center_px : (2,) array
    size_ratio
        Of its image over that of its model.
    score
        Correlation, -1..1, of what is lit with the model's lit silhouette.
    center_sigma_px
        As the scatter of the limb's crossings has it; infinite where the limb was not seen.
    strain : (2,) array
        Of the outline, as `Outline.strained`.
    seen_ratio, seen_sigma
        Size by the crossings alone, as if nothing were known of the figure but its widest bounds: what a fit that knows
        the figure itself may take from them.
    """

    center_px: FloatArray
    size_ratio: float
    score: float
    center_sigma_px: float = np.inf
    strain: FloatArray = field(default_factory=lambda: np.zeros(2))
    seen_ratio: float = 1.0
    seen_sigma: float = np.inf

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- The silhouette over the frame.

SEARCHED_RADIUS = 8.0  # of the body, in bins of the search
SIZES = (0.87, 1.0, 1.15)
LEVELS = (0.04, 0.12, 0.35)  # of the bright part of the body: what counts as lit
SKY_SIGMAS = 5.0
BRIGHT_RANK = 0.3  # of the lit pixels: as bright as this is bright
# Hits are narrower than that; brightnesses of what is as wide are tried where they are below such a share of all others.
HIT_PX, HIT_SHARE = 2, 0.5
CUT_SHARES = (1.0, 0.3, 0.1)  # of the body that may be on the detector: what is bright follows from that
LIT_SHARE = 0.02  # of the model's brightest part
KNOWN_SHARE = 0.25  # of the pixels of a bin: every other line may be missing
RING_SHARE = 0.35  # of the radius: sky about the body that must be dark
LEAST_VISIBLE = 0.04  # of the lit silhouette that must lie on the detector


# A place near the expected one is taken if it is so good, itself and beside the best, which is 1 at most
NEAR_SCORE, NEAR_SHARE = 0.75, 0.85
LEAST_SCORE = 0.4  # of a body that is there: the lowest of 270 were 0.57 (clipped and small), of stars and hits 0.1 to 0.3
# Of the light that a star or another body explains, in sigmas. A body explains more of its own than a star does, a star
# less; the smallest are alike: of 400 bodies of 1 to 2000 px all explained 0.99 of it or more.
RIVAL_SHARE = 0.97
MOST_POINTS = 4  # that may lie on a body
POINTLIKE_PX, POINTLIKE_LIT_PX = 3.0, 1.5  # a smaller body, or crescent, may be any star
SIZED_RADIUS_PX = 6.0  # smaller bodies are looked for in one size
WIDE_PX = 60.0  # no star's image is so wide


def find_place(
    picture: BodyPicture, name: str, circle: Circle | None = None, search_px: float | None = None
) -> BodyPlace | None:
    """Find where a body stands, to about half a pixel; None where nothing of its kind stands out of the sky.

    Parameters
    ----------
    circle
        An analyst's; None: predicted place and size.
    search_px
        How far from the expected place to look; None: over the whole frame, nearer places first.
    """
    predicted = 0.5 * picture.diameter_px(name)
    expected = picture.center_px(name) if circle is None else circle.center_px
    ratio = 1.0 if circle is None else circle.radius_px / predicted
    limit = search_px if circle is None or search_px is not None else search_radius(0.0, circle)
    near = search_radius(predicted * ratio, None)
    if limit is None and picture.stars_px is None and is_pointlike(picture, name):
        limit = near
    picture = without_spilled(picture, 2.0 * predicted * ratio)
    if 2.0 * predicted * ratio < BLURRED_PX:
        return _blurred_place(picture, name, ratio, expected, limit)
    close = None
    if limit is None:
        alone = _without_found(picture, name, expected, near)
        close = _silhouette_place(alone, name, ratio, expected, near)
    found = close
    if found is None or found.score < NEAR_SHARE:
        alone = _without_found(picture, name, expected, np.inf if limit is None else limit)
        found = _in_company(alone, name, ratio, expected, limit, near, close)
    if found is None or found.score < LEAST_SCORE or not _stands_out(alone, name, found, expected, near):
        reach = max(near, FAINT_SEARCH_PX) if limit is None else limit
        alone = _without_found(picture, name, expected, reach)
        found = _place_of_light(alone, name, ratio, expected, reach)
        if found is None or not _stands_out(alone, name, found, expected, near):
            return None
    return _on_limb(picture, name, found)


def is_pointlike(picture: BodyPicture, name: str) -> bool:
    """Tell whether so little of a body is lit that it may be any star."""
    phase = picture.phase_rad(name)
    lit_share = 0.5 * (1.0 + np.cos(phase)) if np.isfinite(phase) else 1.0
    diameter = picture.diameter_px(name)
    return diameter < POINTLIKE_PX or diameter * lit_share < POINTLIKE_LIT_PX


def _stands_out(picture: BodyPicture, name: str, found: BodyPlace, expected: FloatArray, near: float) -> bool:
    """Tell whether what was found is the body: nothing else is as much like it, or it is there beside what is.

    A good silhouette close to where it is expected needs no such question, unless it is as small as a star's; the less
    so the larger it is. Of a large patchy body that the frame cuts, rendered light may even be the opposite.
    """
    is_near = bool(np.hypot(*(found.center_px - expected)) <= near)
    share, at = found.size_ratio, found.center_px
    radius = 0.5 * picture.diameter_px(name) * share
    enough = NEAR_SCORE if 2.0 * radius > WIDE_PX else NEAR_SHARE
    if is_near and found.score > enough and 2.0 * radius > BLURRED_PX:
        return True
    there = [] if is_near else _others_there(picture, name)
    others = [(other, 0.5 * picture.diameter_px(other)) for other in there]
    for points in range(MOST_POINTS):
        body = _light_peak(picture, name, share, at, REFINED_PX)
        if body.snr == 0.0 and points == 0:  # of so little on the detector nothing can be said
            return True
        if body.snr < SEEN_SNR:
            return False
        rivals = [search_place(picture, other, at, own, radius + REFINED_PX).snr for other, own in others]
        if rivals and body.snr < RIVAL_SHARE * max(rivals):
            return False
        point = brightest_point(picture, at, radius + REFINED_PX)
        if body.snr > RIVAL_SHARE * point.snr:
            return True
        picture = _without_disk(picture, point.center_px, edge_reach(picture))
    return False


def _without_disk(picture: BodyPicture, center_px: FloatArray, radius_px: float) -> BodyPicture:
    """Return the picture with the pixels about a place (2,), or about several (n, 2), not known."""
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    near = np.zeros(picture.signal_dn.shape, dtype=bool)
    places = np.reshape(center_px, (-1, 2))
    for place in places[np.isfinite(places).all(axis=1)]:
        first, last = (
            np.clip(edge, 0, size).astype(int) for edge in (place - radius_px, place + radius_px + 1.0)
        )
        pixel, line = np.arange(first[0], last[0]), np.arange(first[1], last[1])[:, None]
        disk = np.hypot(pixel - place[0], line - place[1]) < radius_px
        near[first[1] : last[1], first[0] : last[0]] |= disk
    return picture.without(near)


def _others(picture: BodyPicture, name: str) -> list[str]:
    """Return the bodies that were not found yet."""
    names = (model.target.name for model in picture.models)
    return [n for n in names if n != name and n not in picture.found]


def _others_there(picture: BodyPicture, name: str) -> list[str]:
    """Return the bodies that were not found yet, and are no points."""
    return [other for other in _others(picture, name) if not is_pointlike(picture, other)]


def _without_found(picture: BodyPicture, name: str, place: FloatArray, search_px: float) -> BodyPicture:
    """Return the picture without the light of bodies that were found, as far as the search from a place reaches."""
    reach = search_px + 0.5 * picture.diameter_px(name) + edge_reach(picture)
    places = {other: picture.center_px(other) for other in picture.found if other != name}
    return without_bodies(
        picture,
        {
            other: at
            for other, at in places.items()
            if np.hypot(*(at - place)) < reach + 0.5 * picture.diameter_px(other)
        },
    )


def _in_company(
    picture: BodyPicture,
    name: str,
    ratio: float,
    expected: FloatArray,
    limit: float | None,
    near: float,
    close: BodyPlace | None = None,
) -> BodyPlace | None:
    """Return where a body's silhouette is; of two places, and one `close` by, where others are as they should be beside it.

    What looks like the body may be another one, the more so where charge of the body itself has spilled.
    """
    found = _silhouette_place(picture, name, ratio, expected, limit)
    others = _others_there(picture, name)
    if found is None or not others or np.hypot(*(found.center_px - expected)) <= near:
        return found
    rest = _without_disk(picture, found.center_px, picture.diameter_px(name) * ratio)
    second = _silhouette_place(rest, name, ratio, expected, limit)

    def score(place: BodyPlace) -> float:
        shift, total = place.center_px - expected, place.score
        for other in others:
            reach = search_radius(0.5 * picture.diameter_px(other), None)
            beside = _silhouette_place(picture, other, 1.0, picture.center_px(other) + shift, reach)
            total += 0.0 if beside is None or beside.score < LEAST_SCORE else beside.score
        return total

    places = [place for place in (close, second) if place is not None and place.score >= LEAST_SCORE]
    return max((found, *places), key=score)


def _silhouette_place(
    picture: BodyPicture, name: str, ratio: float, expected: FloatArray, limit: float | None
) -> BodyPlace | None:
    radius = 0.5 * picture.diameter_px(name) * ratio
    bins = max(1, round(radius / SEARCHED_RADIUS))
    template = _lit_template(picture, name, ratio, bins)
    reach = np.inf if limit is None else limit + bins * (1.0 + RING_SHARE) * (len(template) + 2)
    first = bins * np.clip(np.floor((expected - reach) / bins), 0, None)
    bright, dark_sigma, known = _binned(picture, bins, first, expected + reach)
    sky, lit_bins = SKY_SIGMAS * dark_sigma, float(template.sum())
    tops = _tops(bright[known], lit_bins)
    if lit_bins == 0.0 or max(tops, default=0.0) < sky:
        return None
    search = _FrameSearch(expected - first, limit, search_radius(radius, None), bins)
    sizes = SIZES if radius > SIZED_RADIUS_PX else (1.0,)
    sized = [_SizedTemplate(template, size, known) for size in sizes]
    best = _best_of(tops, sky, bright, known, sized, search)
    if best is None or best.score <= NEAR_SHARE:
        # Light is as wide as its optics make it; hits may be brighter than the body, and more than its pixels.
        wide, _, _ = _binned(picture, bins, first, expected + reach, as_wide_as=HIT_PX)
        others = [top for top in _tops(wide[known], lit_bins) if top < HIT_SHARE * min(tops)]
        best = _best_of(others, sky, bright, known, sized, search, best)
    if best is None:
        return None
    return replace(best, center_px=best.center_px + first, size_ratio=best.size_ratio * ratio)


def _tops(bright: FloatArray, lit_bins: float) -> list[float]:
    """Return how bright a body may be, as bright bins (n,) are, of which it lights so many or a part of them."""
    if not len(bright):
        return []
    ranks = [min(int(BRIGHT_RANK * share * lit_bins), len(bright) - 1) for share in CUT_SHARES]
    places = len(bright) - 1 - np.array(ranks)
    return list(dict.fromkeys(np.partition(bright, places)[places].tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class _FrameSearch:
    expected_px: FloatArray
    limit_px: float | None
    near_px: float
    bins: int


def _binned(
    picture: BodyPicture, bins: int, first: FloatArray, last: FloatArray, *, as_wide_as: int = 1
) -> tuple[FloatArray, float, BoolArray]:
    """Return brightness in bins, the noise of sky in them, and which are known; saturated pixels count as they are.

    Light that is not `as_wide_as` so many pixels in either direction is left out.
    """
    low = np.clip(first, 0, None)
    high = np.clip(np.ceil(last) + 1, low, picture.signal_dn.shape[::-1])
    part = tuple(slice(int(a), int(b)) for a, b in zip(low[::-1], high[::-1], strict=True))
    signal, noise_dn = picture.signal_dn[part], picture.noise_dn[part]
    usable = picture.shown(part)
    data = np.where(usable, signal, 0.0)
    if as_wide_as > 1:
        data = grey_opening(data, (as_wide_as, as_wide_as))
    count = block_reduce(usable.astype(np.float64), bins, np.sum)
    total = block_reduce(data, bins, np.sum)
    known = count > KNOWN_SHARE * bins**2
    noise = float(np.median(noise_dn[usable])) if usable.any() else np.inf
    return np.where(known, total / np.maximum(count, 1.0), 0.0), noise / bins, known


def _lit_template(picture: BodyPicture, name: str, ratio: float, bins: int) -> FloatArray:
    """Return how much of each bin (n, n), about the body's center in the middle one, is lit."""
    radius = 0.5 * picture.diameter_px(name) * ratio
    half = int(np.ceil(radius * max(SIZES) / bins)) + 1
    fine = 4
    steps = (np.arange(-half * fine, (half + 1) * fine) - 0.5 * (fine - 1)) * bins / fine
    place = np.array([0.5 * (picture.camera.n_pixel - 1), 0.5 * (picture.camera.n_line - 1)])
    x, y = np.meshgrid(steps, steps)
    model = displaced_model(picture, name, place, 1.0 / ratio)
    body = PlacedBody(model, picture.camera.pixel_scale_rad)
    where = place + np.stack([x.ravel(), y.ravel()], axis=-1)
    rays = pixel_rays(picture, where)
    good = np.isfinite(rays).all(axis=0)
    light = np.zeros(rays.shape[1])
    light[good] = body.radiance(rays[:, good])
    lit = (light > LIT_SHARE * light.max(initial=0.0)).reshape(x.shape)
    return np.asarray(block_reduce(lit.astype(np.float64), fine, np.mean))


def _resized(template: FloatArray, size: float) -> FloatArray:
    middle = len(template) // 2
    index = (np.arange(len(template)) - middle) / size + middle
    grid = np.meshgrid(index, index, indexing="ij")
    return np.asarray(map_coordinates(template, grid, order=1, mode="constant"))


class _SizedTemplate:
    """A lit silhouette of one size with the sky about it, and how much of both the frame shows at every lag."""

    def __init__(self, template: FloatArray, size: float, known: BoolArray) -> None:
        self.size = size
        shape = _resized(template, size)
        pad = int(np.ceil(RING_SHARE * len(shape) / 2)) + 1
        self.inside = np.pad(shape, pad)
        about = maximum_filter(self.inside, footprint=_disk(pad)) > 0.5
        about |= _full_disk(self.inside, len(shape))
        self.good = [fft.next_fast_len(n + len(self.inside), real=True) for n in known.shape]
        of_known = self.spectrum(known)
        self.of_in, self.of_about = self.spectrum(self.inside), self.spectrum(about)
        n = np.maximum(self.lagged(of_known, self.of_about), 1e-3)
        n_in, square_in = (self.lagged(of_known, of) for of in (self.of_in, self.spectrum(self.inside**2)))
        whole, self.share = float(self.inside.sum()), n_in / n
        self.per_bin = 1.0 / n
        # A larger part in sight is better evidence than a small one.
        seen = np.clip(n_in / max(whole, 1.0), 0.0, 1.0) ** 0.125
        var_in = square_in - n_in * self.share
        valid = (n_in > LEAST_VISIBLE * whole) & (var_in > 0.02 * whole)
        self.weight = np.where(valid, seen / np.sqrt(np.where(valid, var_in, 1.0)), 0.0)

    def spectrum(self, plane: NDArray[Any]) -> NDArray[np.complex64]:
        """Return the spectrum of a frame or a template, padded to hold every lag; counts of bins need no more digits."""
        return np.asarray(fft.rfft2(plane.astype(np.float32), self.good))

    def lagged(self, plane: NDArray[np.complex64], kernel: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the correlation of two spectra at every lag."""
        return np.asarray(fft.irfft2(plane * kernel.conj(), self.good))

    def score(self, of_lit: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the correlation coefficient at every lag with a plane that tells what is lit; 0 where there is none."""
        about, inside = (self.lagged(of_lit, kernel) for kernel in (self.of_about, self.of_in))
        spread = about - about**2 * self.per_bin
        return np.where(
            spread > 0.5, (inside - self.share * about) * self.weight / np.sqrt(np.maximum(spread, 0.5)), 0.0
        )


def _score(place: BodyPlace) -> float:
    return place.score


def _best_of(
    tops: Sequence[float],
    sky: float,
    bright: FloatArray,
    known: BoolArray,
    sized: Sequence[_SizedTemplate],
    search: _FrameSearch,
    best: BodyPlace | None = None,
) -> BodyPlace | None:
    """Return the best place of the silhouettes in what is lit of a body as bright as one of `tops`, or one there is."""
    for top in (top for top in tops if top >= sky):
        lit = (known & (bright > max(level * top, sky)) for level in LEVELS)
        found = (_correlated(plane, sized, search) for plane in lit)
        best = max((place for place in (best, *found) if place is not None), key=_score, default=None)
        if best is not None and best.score > NEAR_SHARE:
            break
    return best


def _correlated(lit: BoolArray, sized: Sequence[_SizedTemplate], search: _FrameSearch) -> BodyPlace | None:
    """Return where the best of the silhouettes is in a plane that tells what is lit."""
    of_lit = sized[0].spectrum(lit)
    found = (_correlated_one(of_lit, one, search) for one in sized)
    return max((place for place in found if place is not None), key=_score, default=None)


def _correlated_one(
    of_lit: NDArray[np.complex64], template: _SizedTemplate, search: _FrameSearch
) -> BodyPlace | None:
    score, middle, bins = template.score(of_lit), len(template.inside) // 2, search.bins
    line, pixel = (_lag_index(k, len(template.inside)) + middle for k in template.good)
    y, x = (line + 0.5) * bins - 0.5, (pixel + 0.5) * bins - 0.5

    def within(x: FloatArray, y: FloatArray, reach: float) -> BoolArray:
        return np.asarray(np.hypot(x - search.expected_px[0], y[:, None] - search.expected_px[1]) <= reach)

    if search.limit_px is not None:
        score = np.where(within(x, y, search.limit_px + bins), score, 0.0)
    peak = float(score.max())
    if peak <= 0.0:
        return None
    reach = search.near_px + bins
    lines, pixels = (
        np.flatnonzero(np.abs(at - here) <= reach)
        for at, here in zip((y, x), search.expected_px[::-1], strict=True)
    )
    near = score[np.ix_(lines, pixels)] * within(x[pixels], y[lines], reach)
    if near.max(initial=0.0) >= max(NEAR_SCORE, NEAR_SHARE * peak):
        k, m = np.unravel_index(int(near.argmax()), near.shape)
        i, j = lines[k], pixels[m]
    else:
        i, j = np.unravel_index(int(score.argmax()), score.shape)
    return BodyPlace(np.array([x[j], y[i]]), template.size, float(score[i, j]))


def _lag_index(n: int, width: int) -> FloatArray:
    index = np.arange(n, dtype=np.float64)
    return np.where(index >= n - width, index - n, index)


def _disk(radius: int) -> BoolArray:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return np.asarray(x * x + y * y <= radius * radius + 0.5)


def _full_disk(inside: FloatArray, width: int) -> BoolArray:
    y, x = np.indices(inside.shape) - len(inside) // 2
    return np.asarray(np.hypot(x, y) < 0.5 * width)


# ---- Bodies of a few pixels, whose silhouette is that of the PSF, and faint ones, of which no pixel stands out of the sky:
# their rendered light is looked for.

BLURRED_PX = 9.0
# Of a body that is there, and how much of what is under it the model explains
SEEN_SNR, SEEN_SHARE = 5.0, 0.3
FAINT_SEARCH_PX = 200.0
REFINED_PX = 3.0  # about a silhouette


def _blurred_place(
    picture: BodyPicture, name: str, ratio: float, expected: FloatArray, limit: float | None
) -> BodyPlace | None:
    """Return where a small body's light is near the expected place; else, if it may be far, where its silhouette is."""
    radius = 0.5 * picture.diameter_px(name) * ratio
    near = search_radius(radius, None) if limit is None else limit
    picture = without_bodies(picture, near_bodies(picture, name, expected))
    alone = _without_found(picture, name, expected, near)
    found = _place_of_light(alone, name, ratio, expected, near)
    if found is not None and (is_pointlike(picture, name) or _stands_out(alone, name, found, expected, near)):
        return found
    if limit is not None:
        return None
    alone = without_stars(_without_found(picture, name, expected, np.inf))
    if is_pointlike(picture, name):
        return _lone_place(alone, name, ratio, expected)
    rough = _in_company(alone, name, ratio, expected, None, near)
    if rough is None or rough.score < LEAST_SCORE or not _stands_out(alone, name, rough, expected, near):
        return None
    return _place_of_light(alone, name, ratio, rough.center_px, REFINED_PX)


def _place_of_light(
    picture: BodyPicture, name: str, ratio: float, place: FloatArray, search_px: float
) -> BodyPlace | None:
    """Return where the light of a body as it is rendered stands out of the sky, near a place."""
    return _as_place(_light_peak(picture, name, ratio, place, search_px), picture, name, ratio, search_px)


def _light_peak(
    picture: BodyPicture, name: str, ratio: float, place: FloatArray, search_px: float
) -> CorrelationPeak:
    radius = 0.5 * picture.diameter_px(name) * ratio
    return search_place(picture, name, place, radius, search_px, range_scale=1.0 / ratio)


def _as_place(
    peak: CorrelationPeak, picture: BodyPicture, name: str, ratio: float, search_px: float
) -> BodyPlace | None:
    radius = 0.5 * picture.diameter_px(name) * ratio
    # As unlikely to be noise as near by, wherever it may be.
    least = np.hypot(SEEN_SNR, np.sqrt(2.0 * np.log(max(search_px / search_radius(radius, None), 1.0) ** 2)))
    there = np.isfinite(peak.center_px).all() and peak.snr > least and peak.explained > SEEN_SHARE
    return BodyPlace(peak.center_px, ratio, peak.explained) if there else None


# ---- Bodies as small as a star's image, in a picture whose stars are known.

# Over the next brightest: two bodies of one field are rarely so different; and over the faintest star of the catalog.
LONE_RATIO, KNOWN_RATIO = 3.0, 2.0


def without_stars(picture: BodyPicture) -> BodyPicture:
    """Return the picture without the pixels about its stars, where they are known."""
    stars = picture.stars_px
    return picture if stars is None else _without_disk(picture, stars, edge_reach(picture))


def _lone_place(picture: BodyPicture, name: str, ratio: float, expected: FloatArray) -> BodyPlace | None:
    """Return where the one light of a frame without its stars is that can be a body; None: there are several, or none.

    It has to be so bright that the catalog would know it, were it a star.
    """
    for other in _others(picture, name):
        radius = 0.5 * picture.diameter_px(other)
        reach = radius + search_radius(radius, None) + edge_reach(picture)
        picture = _without_disk(picture, picture.center_px(other), reach)
    anywhere = 2.0 * float(np.hypot(*picture.signal_dn.shape))
    peak = _light_peak(picture, name, ratio, expected, anywhere)
    found = _as_place(peak, picture, name, ratio, anywhere)
    if found is None:
        return None
    rest = _without_disk(picture, found.center_px, picture.diameter_px(name) * ratio + edge_reach(picture))
    rival = _light_peak(rest, name, ratio, expected, anywhere)
    alone = peak.snr * peak.explained > LONE_RATIO * rival.snr * rival.explained
    return found if alone and peak.flux_dn > KNOWN_RATIO * picture.stars_known_dn else None


# ---- From there onto the limb.

FEWEST_CROSSINGS = 8
PLACE_TURNS, PLACED_PX, LEAST_NEAR_PX = 6, 0.1, 1.5
LARGEST_GROWTH = 0.3


def _on_limb(picture: BodyPicture, name: str, place: BodyPlace) -> BodyPlace:
    """Move a place onto the limb; what was found stays where the limb is not seen."""
    figure = picture.model(name).seen_figure
    center, size = place.center_px, place.size_ratio
    near = max(0.1 * picture.diameter_px(name) * size, 3.0)
    sigma_px, seen, strain = np.inf, (1.0, np.inf), np.zeros(2)
    for _ in range(PLACE_TURNS):
        body = strained_picture(picture, name, np.append(strain, np.zeros(3)))
        outline = Silhouette(body, name).at(center, 1.0 / size)
        crossings = cross_limb(picture, outline, 1.5 * near + 3.0, radiance_profiles(body, name, size))
        if np.count_nonzero(crossings.known) < FEWEST_CROSSINGS:
            break
        relief = figure.limb_roughness * 0.5 * outline.diameter_px
        moved = fit_crossings(crossings, outline, figure, relief, np.array([-np.log(size), *-strain]), near)
        sigma_px = float(np.sqrt(np.trace(moved.covariance[:2, :2])))
        seen = size * float(np.exp(moved.free_log_size)), moved.free_size_sigma
        center = center + moved.step_px
        size = size * float(np.exp(np.clip(moved.log_size, -LARGEST_GROWTH, LARGEST_GROWTH)))
        strain = strain + moved.strain * can_be_strained(picture.model(name))
        grown = abs(moved.log_size) + float(np.hypot(*moved.strain))
        length = float(np.hypot(*moved.step_px)) + grown * 0.5 * outline.diameter_px
        if length < PLACED_PX:
            break
        near = max(0.5 * near, min(near, 2.0 * length), LEAST_NEAR_PX)
    return BodyPlace(center, size, place.score, sigma_px, strain, *seen)
