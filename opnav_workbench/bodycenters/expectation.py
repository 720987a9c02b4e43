"""What is expected of a body before it is measured, and what already stands against measuring it."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.detection import detection_snr
from opnav_workbench.bodycenters.flags import BodyFlag
from opnav_workbench.bodycenters.model_picture import model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.place_search import Place, search_place
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.bodycenters.subarray import choose_subarray, search_radius

__all__ = ["Expectation", "Found", "expect", "find_place", "reach_px"]

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
class Expectation:
    """Where and how large a body is expected.

    Attributes
    ----------
    name : str
    center_px : (2,) array
    radius_px : float
        Of the circle that holds its predicted outline.
    search_px : float
    range_scale : float
        Range over the a priori one that gives it the size of an analyst's circle; 1 without circle.
    circle_ratio : float
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
class Found:
    """A body that is there, roughly located.

    Attributes
    ----------
    expectation : Expectation
    place : Place
    size_ratio : float
        Size of its image over the expected one, as far as the search tells: 1 unless another fits much better.
    sized_place : Place
        Its place with that size.
    """

    expectation: Expectation
    place: Place
    size_ratio: float
    sized_place: Place


def reach_px(picture: BodyPicture, name: str) -> float:
    """Return the radius of the circle that holds a body's predicted outline, px."""
    prediction = picture.prediction(name)
    limb = prediction.limb_px - prediction.pixel_line
    return float(np.hypot(*limb.T).max()) if len(limb) and np.isfinite(limb).all() else 0.0


def expect(
    picture: BodyPicture, name: str, method: str, circle: Circle | None, search_radius_px: float | None
) -> Expectation | BodyCenter:
    """Return what is expected of a body, or why it cannot be measured."""
    prediction, radius = picture.prediction(name), reach_px(picture, name)
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
    return Expectation(name, center, radius, search, 1.0 if np.isnan(ratio) else 1.0 / ratio, ratio)


def find_place(
    picture: BodyPicture,
    expected: Expectation,
    method: str,
    *,
    solve_range: bool = False,
    subtract_dn: FloatArray | None = None,
    other_sizes: bool = True,
) -> Found | BodyCenter:
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
    return Found(expected, place, ratio / scale, sized)


def _searched(
    picture: BodyPicture, expected: Expectation, range_scale: float, subtract_dn: FloatArray | None
) -> Place:
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
    expected: Expectation,
    range_scale: float,
    place: Place,
    subtract_dn: FloatArray | None,
) -> tuple[float, Place]:
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


def _saturated_share(picture: BodyPicture, expected: Expectation, place: Place) -> float:
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
