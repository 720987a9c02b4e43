"""Which bodies a picture shows, and roughly where; what stands against measuring the others.

Flow   what is expected of each body -> correlation search, the largest body first, whose shift is expected of the others
       too -> bodies detected; others that touch them and have to be rendered along; the rest, whose pixels are left out

A body counts as detected where it stands out of its whole search area by more than noise does once in a hundred such
areas, and where its model explains what is seen there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
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
    "fit_pixels",
    "groups_in_contact",
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
    subtract_dn: FloatArray | None = None,
    other_sizes: bool = True,
) -> DetectedBody | BodyCenter:
    """Search for a body, or say why it is not seen; also with other sizes where its own explains little."""
    scale = expected.range_scale if solve_range else 1.0
    place = _searched(picture, expected, scale, subtract_dn)
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
        ratio, sized = _other_size(picture, expected, scale, place, subtract_dn)
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


def _searched(
    picture: BodyPicture, expected: ExpectedBody, range_scale: float, subtract_dn: FloatArray | None
) -> CorrelationPeak:
    return search_place(
        picture,
        expected.name,
        expected.center_px,
        expected.radius_px / range_scale,
        expected.search_px,
        range_scale=range_scale,
        subtract_dn=subtract_dn,
    )


def _other_size(
    picture: BodyPicture,
    expected: ExpectedBody,
    range_scale: float,
    place: CorrelationPeak,
    subtract_dn: FloatArray | None,
) -> tuple[float, CorrelationPeak]:
    """Return the size, over that of the search, with which the model explains much more, and the place found with it."""
    best = 1.0, place
    if place.explained > WELL_EXPLAINED or expected.radius_px < MIN_SIZED_RADIUS_PX:
        return best
    for ratio in OTHER_SIZES:
        other = _searched(picture, expected, range_scale / ratio, subtract_dn)
        if other.explained > best[1].explained and other.snr > 0.9 * best[1].snr:
            best = ratio, other
    left = 1.0 - place.explained
    return best if 1.0 - best[1].explained < MUCH_BETTER * left else (1.0, place)


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
    overlapping : mapping of str to (2,) array
        Bodies that were not asked for and touch one that was found, at their likely places.
    apart : mapping of str to (2,) array
        Others in the scene, at their likely places.
    """

    found: Mapping[str, DetectedBody]
    missed: Mapping[str, BodyCenter]
    overlapping: Mapping[str, FloatArray]
    apart: Mapping[str, FloatArray]


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
    shift, light = np.zeros(2), None
    for name in sorted(expected, key=lambda name: -expected[name].radius_px):
        expectation = expected[name]
        if found and name not in search.circles:
            expectation = replace(expectation, center_px=expectation.center_px + shift)
        result = detect_body(
            picture, expectation, search.method, solve_range=search.solve_range, subtract_dn=light
        )
        if isinstance(result, BodyCenter):
            missed[name] = result
            continue
        if not found:
            shift = result.place.center_px - picture.center_px(name)
        found[name] = result
        if len(expected) > 1:
            light = _with_light(light, picture, result)
    others = {
        model.target.name: picture.center_px(model.target.name) + shift
        for model in picture.models
        if model.target.name not in names
    }
    touching = _in_contact(picture, found, others)
    return DetectedScene(
        found,
        missed,
        {name: place for name, place in others.items() if name in touching},
        {name: place for name, place in others.items() if name not in touching},
    )


def _with_light(light: FloatArray | None, picture: BodyPicture, body: DetectedBody) -> FloatArray:
    """Return light (n_line, n_pixel) with that of one more body, at its place and as bright as it was found."""
    window = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    name = body.expectation.name
    own = body.place.scale * model_picture(picture, window, {name: body.place.center_px}, only=(name,))
    return own if light is None else light + own


def _psf_reach_px(picture: BodyPicture) -> float:
    return PSF_REACH * float(np.max(picture.psf.sigma_px))


def _in_contact(
    picture: BodyPicture, found: Mapping[str, DetectedBody], others: Mapping[str, FloatArray]
) -> set[str]:
    """Return which of the others hide a body that was found, or mix their light with it."""
    touching = set()
    for name, place in others.items():
        for body in found.values():
            apart = float(np.hypot(*(place - body.place.center_px)))
            reach = (
                outline_radius_px(picture, name) + body.expectation.radius_px + 2.0 * _psf_reach_px(picture)
            )
            if apart < reach + NEIGHBOUR_ERROR_PX:
                touching.add(name)
    return touching


def fit_pixels(picture: BodyPicture, detected: DetectedScene) -> Cutout | None:
    """Return the pixels about the bodies that are fitted together, without those of other bodies; None: there are none."""
    spread = _psf_reach_px(picture)
    circles = list(_fit_circles(picture, detected).values())
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low = np.stack([center - reach for center, reach in circles]).min(axis=0)
    high = np.stack([center + reach for center, reach in circles]).max(axis=0)
    first = np.clip(np.floor(low), 0, size).astype(int)
    last = np.clip(np.ceil(high), -1, size - 1).astype(int)
    count = np.maximum(last - first + 1, 0)
    if np.min(count) < 1:
        return None
    cutout = cut_out(picture, (int(first[0]), int(first[1]), int(count[0]), int(count[1])))
    line, pixel = np.ogrid[: cutout.use.shape[0], : cutout.use.shape[1]]

    def near(center: FloatArray, reach: float, *, square: bool) -> BoolArray:
        across, down = np.abs(pixel + first[0] - center[0]), np.abs(line + first[1] - center[1])
        return np.asarray(np.maximum(across, down) <= reach if square else np.hypot(across, down) <= reach)

    use = np.zeros(cutout.use.shape, dtype=bool)
    for center, reach in circles:
        use |= near(center, reach, square=True)
    for name, place in detected.apart.items():
        if np.isfinite(place).all():
            use &= ~near(place, outline_radius_px(picture, name) + spread + NEIGHBOUR_ERROR_PX, square=False)
    return replace(cutout, use=cutout.use & use)


def _fit_circles(picture: BodyPicture, detected: DetectedScene) -> dict[str, tuple[FloatArray, float]]:
    """Return center (2,) and reach, px, of what is fitted of each body."""
    about = _psf_reach_px(picture) + RIM_PX
    circles = {
        name: (body.place.center_px, _measured_radius_px(body) + about)
        for name, body in detected.found.items()
    }
    for name, place in detected.overlapping.items():
        circles[name] = place, outline_radius_px(picture, name) + about
    return circles


def groups_in_contact(picture: BodyPicture, detected: DetectedScene) -> list[DetectedScene]:
    """Return a scene for each group of bodies whose pixels touch, with the others apart from it.

    What does not share a pixel shares nothing: a joint fit of all would cost the square of their number, or more.
    """
    circles = _fit_circles(picture, detected)
    places = np.reshape([center for center, _ in circles.values()], (-1, 2))
    reach = np.array([far for _, far in circles.values()])
    apart = np.abs(places[:, None] - places).max(axis=2)
    count, group = connected_components(apart <= reach[:, None] + reach, directed=False)
    names = list(circles)

    def members(index: int) -> DetectedScene:
        own = {name for name, k in zip(names, group, strict=True) if k == index}
        others = {name: center for name, (center, _) in circles.items() if name not in own}
        return DetectedScene(
            {name: body for name, body in detected.found.items() if name in own},
            {},
            {name: place for name, place in detected.overlapping.items() if name in own},
            {**detected.apart, **others},
        )

    return [members(index) for index in range(count)]


def _measured_radius_px(body: DetectedBody) -> float:
    """Return how far from its center a body may reach: an analyst's circle or its image may be the larger."""
    ratio = body.expectation.circle_ratio
    return body.expectation.radius_px * max(ratio if np.isfinite(ratio) else 1.0, body.size_ratio, 1.0)
