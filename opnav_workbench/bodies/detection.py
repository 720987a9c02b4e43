"""Which bodies a picture shows, and roughly where; what stands against measuring the others.

Flow   what is expected of each body -> correlation search, the largest body first, whose shift is expected of the others
       too -> bodies detected; others that touch them and have to be rendered along; the rest, whose pixels are left out

A body counts as detected where it stands out of its whole search area by more than noise does once in a hundred such
areas, and where its model explains what is seen there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture, Circle, model_picture
from opnav_workbench.bodies.place_search import CorrelationPeak, search_place
from opnav_workbench.bodies.results import BodyCenter, BodyFlag
from opnav_workbench.bodies.subarray import PSF_REACH, RIM_PX, Cutout, choose_subarray, cut_out, search_radius

__all__ = [
    "FALSE_ALARM",
    "DetectedBody",
    "DetectedScene",
    "ExpectedBody",
    "SearchRequest",
    "detect_bodies",
    "detect_body",
    "detection_snr",
    "expect_body",
]


# ---- How strong a body must stand out of the noise to be one.

FALSE_ALARM = 0.01  # one search area in a hundred may hold noise that looks like a body


def detection_snr(search_radius_px: float, sigma_px: float) -> float:
    """Return the SNR that noise alone exceeds, somewhere in a circular search area, with `FALSE_ALARM`.

    The expected Euler characteristic of a Gaussian random field above a level; white noise filtered with a
    Gaussian of `sigma_px` has gradients of variance 1 / (2 sigma^2).

    Reference: Adler (1981), The Geometry of Random Fields; Worsley (1996), doi:10.2307/1427576.

    Examples
    --------
    >>> [round(detection_snr(radius, 0.7), 1) for radius in (3.0, 30.0)]
    [3.7, 4.8]
    """
    radius = search_radius_px / (np.sqrt(2.0) * sigma_px)

    def surplus(level: float) -> float:
        density = np.exp(-0.5 * level**2)
        area = np.pi * radius**2 * level * density / (2.0 * np.pi) ** 1.5
        rim = np.pi * radius * density / (2.0 * np.pi)
        return float(area + rim + ndtr(-level) - FALSE_ALARM)

    return float(brentq(surplus, 1.0, 10.0))


# ---- What is expected of a body before it is measured, and what already stands against measuring it.

MIN_EXPLAINED = (
    0.3  # share of what is under the model that it must explain: a star in a disk's place gives a few percent
)
SATURATED_SHARE = 0.9  # of the bright part of a body: what is left shows no edge
BRIGHT_SHARE = 0.3  # of the peak: pixels that count as the body
MIN_USABLE = 0.02
WELL_EXPLAINED = (
    0.9  # a model of the right size and an albedo pattern of Pluto's contrast reach this, roughly located
)
OTHER_SIZES = (0.6, 0.7, 0.85, 1.18, 1.4, 1.65)  # tried where the model explains less
MUCH_BETTER = 0.6  # of what was left unexplained, that another size may leave
MIN_SIZED_RADIUS_PX = 3.0  # smaller images tell their brightness, not their size
FAR_SIZES = 10.0  # detectors


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedBody:
    """Where and how large a body is expected.

    Attributes
    ----------
    center_px : (2,) array
    radius_px
        Of the circle that holds its predicted outline.
    range_scale
        Range over the a priori one that gives it the size of an analyst's circle; 1 without circle.
    circle_ratio
        An analyst's radius over the predicted one; nan without.
    """

    name: str
    center_px: FloatArray
    radius_px: float
    search_px: float
    range_scale: float
    circle_ratio: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class DetectedBody:
    """A body that is there, roughly located.

    Attributes
    ----------
    size_ratio
        Size of its image over the expected one, as far as the search tells: 1 unless another fits much better.
    sized_place
        Its place with that size.
    """

    expectation: ExpectedBody
    place: CorrelationPeak
    size_ratio: float
    sized_place: CorrelationPeak


def outline_radius_px(picture: BodyPicture, name: str) -> float:
    """Return the radius of the circle that holds a body's predicted outline, px."""
    prediction = picture.prediction(name)
    limb = prediction.limb_px - prediction.pixel_line
    return float(np.hypot(*limb.T).max()) if len(limb) and np.isfinite(limb).all() else 0.0


def expect_body(
    picture: BodyPicture, name: str, method: str, circle: Circle | None, search_radius_px: float | None
) -> ExpectedBody | BodyCenter:
    """Return what is expected of a body, or why it cannot be measured."""
    prediction, radius = picture.prediction(name), outline_radius_px(picture, name)
    center = prediction.pixel_line if circle is None else circle.center_px
    n_pixel, n_line = picture.camera.n_pixel, picture.camera.n_line
    if not np.isfinite(center).all():
        return BodyCenter.without_center(name, method, "off_detector", "it is not in front of the camera")
    search = search_radius(radius, circle, search_radius_px)
    reach = radius + search
    outside = np.maximum(np.maximum(-0.5 - center, center - np.array([n_pixel, n_line]) + 0.5), 0.0)
    if np.hypot(*outside) > reach:
        where = f"expected at pixel {center[0]:.1f}, line {center[1]:.1f}"
        if np.abs(center).max() > FAR_SIZES * max(n_pixel, n_line):
            where = "expected far outside the field"
        message = f"{where}, {np.hypot(*outside):.0f} px off the {n_pixel} x {n_line} detector"
        return BodyCenter.without_center(name, method, "off_detector", message)
    ratio = circle.radius_px / radius if circle is not None and radius > 0.0 else np.nan
    return ExpectedBody(name, center, radius, search, 1.0 if np.isnan(ratio) else 1.0 / ratio, ratio)


def detect_body(
    picture: BodyPicture,
    expected: ExpectedBody,
    method: str,
    *,
    solve_range: bool = False,
    beside: Sequence[DetectedBody] = (),
    other_sizes: bool = True,
) -> DetectedBody | BodyCenter:
    """Search for a body, or say why it is not seen; also with other sizes where its own explains little.

    The light of bodies `beside` it, which were found already, is taken out.
    """
    scale = expected.range_scale if solve_range else 1.0

    def searched(range_scale: float) -> CorrelationPeak:
        return search_place(
            picture,
            expected.name,
            expected.center_px,
            expected.radius_px / range_scale,
            expected.search_px,
            range_scale=range_scale,
            light_beside=lambda window: _light_of(picture, beside, window),
        )

    place = searched(scale)
    name, search = expected.name, expected.search_px
    if not np.isfinite(place.center_px).all() or place.usable < MIN_USABLE:
        message = f"no usable pixels within {search:.1f} px of its expected place"
        return BodyCenter.without_center(name, method, "failed", message, flags=int(BodyFlag.EMPTY))
    share = _saturated_share(picture, expected, place)
    if share > SATURATED_SHARE:
        message = f"{100 * share:.0f} % of it is saturated; take a shorter exposure"
        return BodyCenter.without_center(name, method, "saturated", message, flags=int(BodyFlag.OVEREXPOSED))
    ratio, sized = 1.0, place
    if other_sizes:
        ratio, sized = _other_size(searched, expected, scale, place)
    needed = detection_snr(search, max(float(np.max(picture.psf.sigma_px)), 0.5 * expected.radius_px))
    if sized.snr < needed or sized.explained < MIN_EXPLAINED:
        seen = f"SNR {place.snr:.1f}, {needed:.1f} needed"
        if place.snr >= needed:
            seen = (
                f"what is there is not like it: the model explains {100 * place.explained:.0f} % of the light"
            )
        message = f"nothing found within {search:.1f} px of its expected place ({seen})"
        return BodyCenter.without_center(name, method, "not_detected", message)
    return DetectedBody(expected, place, ratio / scale, sized)


def _other_size(
    searched: Callable[[float], CorrelationPeak],
    expected: ExpectedBody,
    range_scale: float,
    place: CorrelationPeak,
) -> tuple[float, CorrelationPeak]:
    """Return the size, over that of the search, with which the model explains much more, and the place found with it."""
    best = 1.0, place
    if place.explained > WELL_EXPLAINED or expected.radius_px < MIN_SIZED_RADIUS_PX:
        return best
    for ratio in OTHER_SIZES:
        other = searched(range_scale / ratio)
        if other.explained > best[1].explained and other.snr > 0.9 * best[1].snr:
            best = ratio, other
    left = 1.0 - place.explained
    return best if 1.0 - best[1].explained < MUCH_BETTER * left else (1.0, place)


def _light_of(
    picture: BodyPicture, found: Sequence[DetectedBody], window: tuple[int, int, int, int]
) -> FloatArray:
    """Return the light of bodies in a window; those that do not reach it are not drawn."""
    light = np.zeros((window[3], window[2]))
    first, size = np.array(window[:2]), np.array(window[2:])
    for body in found:
        name, center = body.expectation.name, body.place.center_px
        reach = _measured_radius_px(body) + 2.0 * _psf_reach_px(picture)
        if np.all(center > first - reach) and np.all(center < first + size + reach):
            light += body.place.scale * model_picture(picture, window, {name: center}, only=(name,))
    return light


def _saturated_share(picture: BodyPicture, expected: ExpectedBody, place: CorrelationPeak) -> float:
    """Return the share of a body's disk that is saturated: lit or not, as a model's scale is not known."""
    if not picture.saturated.any():
        return 0.0
    circle = Circle(place.center_px, max(expected.radius_px, 1.0))
    part = choose_subarray(picture, expected.name, circle)
    if part.empty or not picture.saturated[part.slices].any():
        return 0.0
    light = model_picture(picture, part.window, {expected.name: place.center_px}, only=(expected.name,))
    bright = light > BRIGHT_SHARE * light.max()
    return float(picture.saturated[part.slices][bright].mean()) if bright.any() else 0.0


# ---- Several bodies in one picture.

NEIGHBOUR_ERROR_PX = 2.0  # of a neighbour's place, once the picture's common shift is known


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """How bodies are to be searched."""

    method: str
    circles: Mapping[str, Circle]
    solve_range: bool = False
    search_radius_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DetectedScene:
    """Bodies that were found, and what became of the others.

    Attributes
    ----------
    missed
        Those without a center, and why.
    places : mapping of str to (2,) array
        Of all bodies of the scene that are not `missed`: where they were found, else where they are likely to be.
    radii_px : mapping of str to float
        Of circles that hold their images.
    """

    found: Mapping[str, DetectedBody]
    missed: Mapping[str, BodyCenter]
    places: Mapping[str, FloatArray]
    radii_px: Mapping[str, float]

    def groups(self, picture: BodyPicture) -> list[tuple[str, ...]]:
        """Return which bodies hide each other or mix their light, those that were found first; one of each group was."""
        groups: list[tuple[str, ...]] = []
        for name in self.places:
            touched = [group for group in groups if any(self._touch(picture, name, other) for other in group)]
            groups = [group for group in groups if group not in touched]
            groups.append((*(other for group in touched for other in group), name))
        ordered = (tuple(sorted(group, key=lambda name: name not in self.found)) for group in groups)
        return [group for group in ordered if group[0] in self.found]

    def _touch(self, picture: BodyPicture, one: str, other: str) -> bool:
        apart = float(np.hypot(*(self.places[one] - self.places[other])))
        reach = self.radii_px[one] + self.radii_px[other] + 2.0 * _psf_reach_px(picture)
        return apart < reach + NEIGHBOUR_ERROR_PX

    def pixels(self, picture: BodyPicture, group: Sequence[str]) -> Cutout | None:
        """Return the pixels about the bodies of a group, without those of other bodies; None: there are none."""
        spread = _psf_reach_px(picture)
        places = np.stack([self.places[name] for name in group])
        reach = np.array([self.radii_px[name] + spread + RIM_PX for name in group])
        size = np.array([picture.camera.n_pixel, picture.camera.n_line])
        first = np.clip(np.floor((places - reach[:, None]).min(axis=0)), 0, size).astype(int)
        last = np.clip(np.ceil((places + reach[:, None]).max(axis=0)), -1, size - 1).astype(int)
        n_pixel, n_line = (int(n) for n in last - first + 1)
        if min(n_pixel, n_line) < 1:
            return None
        cutout = cut_out(picture, (int(first[0]), int(first[1]), n_pixel, n_line))
        line, pixel = np.ogrid[first[1] : last[1] + 1, first[0] : last[0] + 1]
        near = np.zeros((n_line, n_pixel), dtype=bool)
        for (x, y), half in zip(places, reach, strict=True):
            near |= np.maximum(np.abs(pixel - x), np.abs(line - y)) <= half
        for name in self.places.keys() - set(group):
            (x, y), half = self.places[name], self.radii_px[name] + spread + NEIGHBOUR_ERROR_PX
            near &= np.hypot(pixel - x, line - y) > half
        return replace(cutout, use=cutout.use & near)


def detect_bodies(picture: BodyPicture, names: Sequence[str], search: SearchRequest) -> DetectedScene:
    """Find bodies, the largest first: its shift against the prediction is expected of the others too."""
    expected: dict[str, ExpectedBody] = {}
    missed: dict[str, BodyCenter] = {}
    for name in names:
        answer = expect_body(picture, name, search.method, search.circles.get(name), search.search_radius_px)
        if isinstance(answer, BodyCenter):
            missed[name] = answer
        else:
            expected[name] = answer
    found: dict[str, DetectedBody] = {}
    shift = np.zeros(2)
    for name in sorted(expected, key=lambda name: -expected[name].radius_px):
        expectation = expected[name]
        if found and name not in search.circles:
            expectation = replace(expectation, center_px=expectation.center_px + shift)
        result = detect_body(
            picture, expectation, search.method, solve_range=search.solve_range, beside=tuple(found.values())
        )
        if isinstance(result, BodyCenter):
            missed[name] = result
            continue
        if not found:
            shift = result.place.center_px - picture.center_px(name)
        found[name] = result
    places = {name: body.sized_place.center_px for name, body in found.items()}
    radii = {name: _measured_radius_px(body) for name, body in found.items()}
    for name in (model.target.name for model in picture.models):
        place = picture.center_px(name) + shift
        if name not in names and np.isfinite(place).all():
            places[name], radii[name] = place, outline_radius_px(picture, name)
    return DetectedScene(found, missed, places, radii)


def _psf_reach_px(picture: BodyPicture) -> float:
    return PSF_REACH * float(np.max(picture.psf.sigma_px))


def _measured_radius_px(body: DetectedBody) -> float:
    """Return how far from its center a body may reach: an analyst's circle or its image may be the larger."""
    ratio = body.expectation.circle_ratio
    return body.expectation.radius_px * max(ratio if np.isfinite(ratio) else 1.0, body.size_ratio, 1.0)
