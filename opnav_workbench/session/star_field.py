"""Where the star field lies in the picture, and so which detection is which star.

Before the pointing is solved, detections are matched with the pattern of catalog stars and small bodies: first within
the limits of the a priori pointing, then farther and farther around it, where only a sure answer counts.  After it, the
solved pointing says where each star is.  What the analyst says goes before all patterns: two stars marked, named or not
(`two_star_pointing`), or the field moved by hand, pixel by pixel (`nudge`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable, deeper_catalogs
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import angle_between, radec_from_unit, rotation_from_vector, unit
from opnav_workbench.scene import (
    StarPrediction,
    apparent_stars,
    camera_magnitudes,
    predict_body,
    predict_stars,
)
from opnav_workbench.session.context import DETECTION_SNR, Context, zero_point_mag
from opnav_workbench.session.inputs import Inputs, LostField
from opnav_workbench.session.orientation import CAMERA_FILE, MIRRORS, nearest_quarter_deg
from opnav_workbench.session.pointing import best_attitude, field_is_sure
from opnav_workbench.session.state import (
    BY_HAND,
    LOST,
    MARKED,
    MAX_POINT_DIAMETER_PX,
    ORIENTATION_TOPIC,
    FieldFound,
    FieldMatch,
    SessionState,
    predicted_stars,
    unsearched_statuses,
    with_decisions,
)
from opnav_workbench.stars import (
    Detections,
    Identification,
    SecondImages,
    StarFlag,
    detect,
    identify_marked,
    identify_sky,
    in_defect_rows,
    on_tracks,
    second_images,
)
from opnav_workbench.stars.pointing import places_even_behind

__all__ = [
    "brightest",
    "catalog_stars",
    "deeper_words",
    "identify_field",
    "nudge",
    "nudge_reach_px",
    "nudged_attitude",
    "star_detections",
    "two_star_pointing",
    "unknown_star_ids",
    "unusable",
]


# A proposal less sure than this is a guess. One star by nearness and brightness reaches 0.9; in fields that have nothing
# to do with the catalog three in a thousand do, and none reaches the 0.999 of a sure identification.
MIN_CONFIDENCE = 0.8
MAX_DETECTIONS = 300  # brightest: enough for any pattern
MIN_SHARP = 30  # detections sharper than a star, or on tracks, that are kept in any case: stars may be such
PIXEL_SIGMA_PX, IMAGE_SIGMAS = 0.3, 4.0  # how far the light of a second image is left out
IMAGES_OF_A_STAR = 4  # at most, of one that is drawn out
LIGHT_BETWEEN = 0.5  # of a second image's: where there is more, star and image are one trail
PROPOSAL = "the identification of the star field is a proposal"
BRIGHTER = "the brighter images are taken"
# An analyst brings the field nearer than this to its stars; the pattern then says how near.
HAND_SHIFT_PX, HAND_TWIST_DEG = 15.0, 0.5


def identify_field(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    """Locate the star field, from the solved pointing or marked stars if there are, else from the pattern."""
    if state.a_priori is None:
        return _unidentified(state, "no star is predicted")
    if state.pointing is not None:
        radius = context.settings.refined_radius_px
        attitude = state.pointing.camera_from_j2000
        said = _said_of_field(context, inputs, state, attitude)
        return _expected_stars(context, state.a_priori, attitude, state.star_field, radius, *said)
    if state.star_field is not None and state.star_field.search == MARKED:
        radius = context.settings.search_radius_px
        return _expected_stars(
            context, state.a_priori, state.star_field.camera_from_j2000, state.star_field, radius
        )
    if state.star_field is not None and state.star_field.search == BY_HAND:
        return _around_moved_field(context, inputs, state, state.star_field)
    return _from_pattern(context, inputs, state)


def _said_of_field(
    context: Context, inputs: Inputs, state: SessionState, attitude: FloatArray
) -> Iterator[str]:
    """Say again, once the pointing is solved, what is still to be known of the field that it rests on."""
    found, twice = state.star_field, _seen(context).twice
    if found is not None and found.search == LOST:
        yield _wrong_attitude(context, inputs, attitude)
    if not field_is_sure(state):
        assert found is not None
        yield f"{PROPOSAL}, of confidence {found.confidence:.2f}: confirm by eye or mark two stars"
    if twice is not None and twice.clear:
        yield f"{twice.words}: {BRIGHTER}"


def _expected_stars(
    context: Context,
    stars: StarPrediction,
    attitude: FloatArray,
    found: FieldFound | None,
    radius_px: float,
    *messages: str,
    anew: bool = False,
) -> FieldMatch:
    expected = stars.places(context.camera, attitude)
    visible = context.camera.on_detector(expected)
    return FieldMatch(found, stars if anew else None, expected, visible, radius_px, messages)


def _from_pattern(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    """Search within the a priori limits, then, where that is not sure, as far as there are stars for."""
    assert state.a_priori is not None
    if inputs.without_sky and inputs.lost is None:
        message = "the attitude is unknown: no star is looked for; search the whole sky (search_sky, or L)."
        return replace(_unidentified(state, ""), messages=(message,))
    detections, twice = star_detections(context), _seen(context).twice
    if twice is not None and not twice.clear:
        why = f"{twice.words}, and nothing tells which of the two is where the camera looked"
        return _unidentified(state, why, remedy=ONE_OF_TWO)
    match = _of_detections(context, inputs, state, detections)
    if twice is None or match.found is None:
        return match
    return replace(match, messages=(*match.messages, f"{twice.words}: {BRIGHTER}"))


def _of_detections(
    context: Context, inputs: Inputs, state: SessionState, detections: Detections
) -> FieldMatch:
    """Find the field whose pattern the detections have."""
    assert state.a_priori is not None
    settings = context.settings
    near = _matched_pattern(
        context, inputs, state, detections, state.a_priori, settings.max_shift_px, settings.max_twist_deg
    )
    if not near.sure and inputs.wide_stars is not None:
        wide = _from_wide_search(context, inputs, state, detections, inputs.wide_stars)
        if wide is not None:
            return wide
    if not near.sure and inputs.lost is not None and not inputs.told_by_stars:
        of_sky = _from_sky_search(context, inputs, state, detections, inputs.lost)
        if (
            of_sky.found is not None
            or inputs.lost.camera_from_j2000 is None
            or near.confidence < MIN_CONFIDENCE
        ):
            return of_sky  # a proposal yields to what is sure
    if not near.sure and inputs.has_a_priori_attitude:
        mirrored = _mirrored_pattern(context, inputs, state, detections)
        if mirrored:
            return _unidentified(state, mirrored, remedy=CAMERA_FILE)
    if near.confidence < MIN_CONFIDENCE:
        other = _of_other_brightness(context, inputs, state, detections, state.a_priori)
        if other:
            return _unidentified(state, other, remedy=OF_BRIGHTNESS)
        remedy = f"{deeper_words(context, inputs)}, {WIDER}"
        return _unidentified(state, _why_unsure(near), _search_limits(context, inputs), remedy)
    found = found_field(inputs, near, "a priori")
    messages = () if near.sure else (f"{PROPOSAL}: {near.message}",)
    return _expected_stars(
        context, state.a_priori, found.camera_from_j2000, found, settings.search_radius_px, *messages
    )


def _around_moved_field(
    context: Context, inputs: Inputs, state: SessionState, placed: FieldFound
) -> FieldMatch:
    """Take the field where the analyst moved it, more exactly where the pattern agrees."""
    assert state.a_priori is not None
    radius = context.settings.search_radius_px
    answer = _matched_pattern(
        context, inputs, state, star_detections(context), state.a_priori, HAND_SHIFT_PX, HAND_TWIST_DEG,
        placed.camera_from_j2000,
    )  # fmt: skip
    if answer.sure and answer.rotation is not None:
        attitude = answer.rotation @ placed.camera_from_j2000
        found = field_at(context, inputs, attitude, BY_HAND, answer.confidence, sure=True)
        return _expected_stars(context, state.a_priori, attitude, found, radius)
    message = f"the field rests on the analyst's hand: {answer.message}"
    return _expected_stars(context, state.a_priori, placed.camera_from_j2000, placed, radius, message)


def _from_wide_search(
    context: Context, inputs: Inputs, state: SessionState, detections: Detections, catalog: StarTable
) -> FieldMatch | None:
    """Search farther; only a sure answer counts, for there is room for many coincidences."""
    around = _all_directions(context, inputs, catalog)
    for shift_px, twist_deg in context.settings.wide_searches:
        answer = _matched_pattern(context, inputs, state, detections, around, shift_px, twist_deg)
        if not answer.sure:
            continue
        found = found_field(inputs, answer, "wide")
        stars = stars_around(context, inputs, catalog, found.camera_from_j2000)
        message = (
            f"the field lies ({answer.shift_px[0]:.0f}, {answer.shift_px[1]:.0f}) px and "
            f"{np.degrees(answer.twist_rad):.2f} deg off its a priori place: {answer.message}"
        )
        radius = context.settings.search_radius_px
        return _expected_stars(context, stars, found.camera_from_j2000, found, radius, message, anew=True)
    return None


def _from_sky_search(
    context: Context, inputs: Inputs, state: SessionState, detections: Detections, lost: LostField
) -> FieldMatch:
    """Take the field that a search of the whole sky found, if its stars agree."""
    if lost.camera_from_j2000 is None:
        return _unidentified(state, lost.message)
    settings, catalog = context.settings, catalog_stars(inputs)
    answer = _matched_pattern(
        context, inputs, state, detections, _all_directions(context, inputs, catalog),
        settings.max_shift_px, settings.max_twist_deg, lost.camera_from_j2000,
    )  # fmt: skip
    if not answer.sure or answer.rotation is None:
        around = _all_directions(context, inputs, catalog)
        other = _of_other_brightness(context, inputs, state, detections, around, lost.camera_from_j2000)
        if other:
            return _unidentified(state, other, remedy=OF_BRIGHTNESS)
        return _unidentified(state, _why_unsure(answer), f"; the whole sky: {lost.message}")
    attitude = answer.rotation @ lost.camera_from_j2000
    found = field_at(context, inputs, attitude, LOST, answer.confidence, sure=True)
    message = f"{_wrong_attitude(context, inputs, attitude)} ({answer.message})"
    stars = stars_around(context, inputs, catalog, attitude)
    return _expected_stars(context, stars, attitude, found, settings.search_radius_px, message, anew=True)


def _mirrored_pattern(context: Context, inputs: Inputs, state: SessionState, detections: Detections) -> str:
    """Tell whether the picture's mirror image, however turned, is the field of the a priori pointing; empty if not."""
    assert state.a_priori is not None
    flipped = detections.pixel_line * [1.0, -1.0] + [0.0, context.camera.n_line - 1.0]
    answer = _matched_pattern(
        context, inputs, state, replace(detections, pixel_line=flipped), state.a_priori,
        context.settings.max_shift_px, 180.0,
    )  # fmt: skip
    quarter = nearest_quarter_deg(answer.twist_rad)
    if not answer.sure or quarter is None:
        return ""
    return f"the picture is mirrored {MIRRORS[quarter]} ({answer.message})"


def _wrong_attitude(context: Context, inputs: Inputs, attitude: FloatArray) -> str:
    if not inputs.has_a_priori_attitude and inputs.lost is not None:
        return f"no a priori attitude: {inputs.lost.message}"
    boresight = context.camera.boresight
    off = angle_between(attitude.T @ boresight, inputs.a_priori_camera_from_j2000.T @ boresight)
    return (
        f"the a priori attitude of the {inputs.attitude_source} is wrong: the picture lies {np.degrees(float(off)):.2f} deg "
        "from there, as a search of the whole sky has found"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What is detected in a picture, without second images of stars where one of the two is clearly the fainter."""

    detections: Detections
    twice: SecondImages | None
    unusable: BoolArray  # pixels for the fits of stars


_SEEN: WeakKeyDictionary[Context, _Seen] = WeakKeyDictionary()


def star_detections(context: Context) -> Detections:
    """Return the brightest detections of the picture, without second images of stars; none where no pixel is usable."""
    return _seen(context).detections


def unusable(context: Context) -> BoolArray:
    """Return which pixels show no star, or the second image of one (`SecondImages`)."""
    return _seen(context).unusable


def _seen(context: Context) -> _Seen:
    if context not in _SEEN:
        _SEEN[context] = _without_second_images(context, _detected(context))
    return _SEEN[context]


def _without_second_images(context: Context, found: Detections) -> _Seen:
    """Leave out second images, and join the maxima of images that are drawn out; a trail may have several."""
    bad: BoolArray = context.not_stars
    for _ in range(IMAGES_OF_A_STAR):
        twice = second_images(found)
        if twice is None:
            break
        if not _is_dark_between(context.signal_dn, found, twice):
            found = _joined(found, twice)
            continue
        if not twice.clear:
            return _Seen(found, twice, bad)
        sigma_px = float(np.hypot(context.camera.psf.sigma_px, PIXEL_SIGMA_PX))
        bad = _without_disks(bad, found.pixel_line[twice.second], IMAGE_SIGMAS * sigma_px)
        rest = found.take(np.setdiff1d(np.arange(len(found)), twice.second))
        return _Seen(rest, twice, bad)
    return _Seen(found, None, bad)


def _joined(found: Detections, twice: SecondImages) -> Detections:
    """Return detections in which both images of a star are one, in the middle of their light."""
    places, flux = found.pixel_line.copy(), found.flux_dn.copy()
    kept = np.ones(len(found), bool)
    for first, second in zip(twice.first, twice.second, strict=True):
        if kept[first] and kept[second]:
            total = flux[first] + flux[second]
            places[first] += (places[second] - places[first]) * flux[second] / total
            flux[first], kept[second] = total, False
    joined = replace(found, pixel_line=places, flux_dn=flux)
    order = np.argsort(-flux, kind="stable")
    return joined.take(order[kept[order]])


def _is_dark_between(image_dn: FloatArray, found: Detections, twice: SecondImages) -> bool:
    """Tell whether there are two images of each star, and not two maxima of one that is drawn out."""
    first, second = found.pixel_line[twice.first], found.pixel_line[twice.second]
    between, fainter = (_light_at(image_dn, places) for places in (0.5 * (first + second), second))
    share = between / np.maximum(fainter, np.finfo(float).tiny)
    return not np.isfinite(share).any() or float(np.nanmedian(share)) < LIGHT_BETWEEN


def _light_at(image_dn: FloatArray, places_px: FloatArray) -> FloatArray:
    """Return the mean of the 3 x 3 pixels around places (k, 2); nan where one is not known."""
    middle = np.round(places_px).astype(np.int64)
    steps = np.array([-1, 0, 1])
    line = np.clip(middle[:, 1, None, None] + steps[:, None], 0, image_dn.shape[0] - 1)
    pixel = np.clip(middle[:, 0, None, None] + steps, 0, image_dn.shape[1] - 1)
    return np.asarray(image_dn[line, pixel].mean(axis=(1, 2)), float)


def _without_disks(bad: BoolArray, centers_px: FloatArray, radius_px: float) -> BoolArray:
    """Return a mask with the pixels around some places (k, 2) added."""
    bad, reach = bad.copy(), int(np.ceil(radius_px))
    line, pixel = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    for center in centers_px:
        x, y = pixel + int(np.round(center[0])), line + int(np.round(center[1]))
        near = (np.hypot(x - center[0], y - center[1]) <= radius_px) & (x >= 0) & (y >= 0)
        near &= (x < bad.shape[1]) & (y < bad.shape[0])
        bad[y[near], x[near]] = True
    return bad


def _detected(context: Context) -> Detections:
    camera, saturated = context.camera, context.picture.saturated
    if np.all(context.not_stars | saturated | ~np.isfinite(context.signal_dn)):
        empty = np.empty(0)
        return Detections(np.empty((0, 2)), empty, empty, empty, np.empty(0, np.int64))
    found = detect(
        context.signal_dn,
        context.noise_dn,
        context.not_stars,
        camera.psf.sigma_px,
        DETECTION_SNR,
        saturated=saturated,
        sharpest_px=max(camera.psf.sigma_px - camera.psf.sigma_sigma_px, 0.5 * camera.psf.sigma_px),
    )
    found = found.take(np.flatnonzero(~in_defect_rows(found, context.signal_dn.shape)))
    # Hot pixels and cosmic rays may outnumber and outshine the stars: as many of them as of what looks like a star.
    sharp = (found.flags & StarFlag.COSMIC_RAY) != 0
    widest_px = camera.psf.sigma_px + camera.psf.sigma_sigma_px
    track = on_tracks(context.signal_dn, context.noise_dn, found, widest_px)
    crowd = sharp & (np.cumsum(sharp) > max(MIN_SHARP, np.count_nonzero(~sharp & ~track)))
    crowd |= track & (np.cumsum(track) > MIN_SHARP)
    return found.take(np.flatnonzero(~crowd)[:MAX_DETECTIONS])


@dataclass(frozen=True, slots=True, eq=False)
class _Directions:
    """Stars as directions only, however far off the detector."""

    directions: FloatArray
    mag: FloatArray


def _all_directions(context: Context, inputs: Inputs, catalog: StarTable) -> _Directions:
    mag, _ = camera_magnitudes(catalog, context.camera)
    return _Directions(apparent_stars(catalog, inputs.et, inputs.observer), mag)


def _matched_pattern(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    detections: Detections,
    stars: StarPrediction | _Directions,
    shift_px: float,
    twist_deg: float,
    attitude: FloatArray | None = None,
    *,
    by_brightness: bool = True,
) -> Identification:
    """Match the pattern around `attitude`, by default the a priori one; by places alone where brightness is not asked."""
    directions, mags = _pattern(context.camera, inputs, state, stars)
    around = inputs.a_priori_camera_from_j2000 if attitude is None else attitude
    return identify_sky(
        directions @ around.T,
        mags,
        detections,
        context.camera,
        max_shift_px=shift_px,
        max_twist_rad=float(np.radians(twist_deg)),
        zero_point_mag=zero_point_mag(context) if by_brightness else None,
    )


def _of_other_brightness(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    detections: Detections,
    stars: StarPrediction | _Directions,
    attitude: FloatArray | None = None,
) -> str:
    """Tell whether the stars stand where they should, only brighter or fainter than can be; empty if not."""
    expected, settings = zero_point_mag(context), context.settings
    if expected is None:
        return ""
    answer = _matched_pattern(
        context, inputs, state, detections, stars, settings.max_shift_px, settings.max_twist_deg, attitude,
        by_brightness=False,
    )  # fmt: skip
    if not answer.sure or answer.zero_point_mag is None or not np.isfinite(answer.zero_point_mag):
        return ""
    off = answer.zero_point_mag - expected
    how = f"{abs(off):.1f} mag {'brighter' if off > 0.0 else 'fainter'}"
    return (
        f"the stars stand in their places ({answer.message}), but are {how} than an exposure of "
        f"{context.picture.exposure_s:g} s makes them"
    )


def _pattern(
    camera: Camera, inputs: Inputs, state: SessionState, stars: StarPrediction | _Directions
) -> tuple[FloatArray, FloatArray]:
    """Directions (J2000) and magnitudes of stars and point-like bodies (magnitude nan where unknown)."""
    directions, mags = [stars.directions], [stars.mag]
    for target in (inputs.targets[name] for name in state.targets):
        body = predict_body(target, inputs.observer, camera, inputs.a_priori_camera_from_j2000)
        if body.on_detector and body.diameter_px <= MAX_POINT_DIAMETER_PX:
            directions.append(body.direction[None])
            mags.append(np.array([np.nan if target.magnitude is None else target.magnitude]))
    return np.concatenate(directions), np.concatenate(mags)


def found_field(inputs: Inputs, answer: Identification, search: str) -> FieldFound:
    """Return an identification as the session keeps it."""
    assert answer.rotation is not None
    attitude = answer.rotation @ inputs.a_priori_camera_from_j2000
    return FieldFound(attitude, answer.shift_px, answer.twist_rad, answer.confidence, search, answer.sure)


def field_at(
    context: Context, inputs: Inputs, attitude: FloatArray, search: str, confidence: float, *, sure: bool
) -> FieldFound:
    """Return the field that an attitude looks at, against the a priori one."""
    camera = context.camera
    focal = camera.focal_from_camera
    between = focal @ attitude @ inputs.a_priori_camera_from_j2000.T @ focal.T  # pixel, line, boresight
    boresight = np.stack(
        [camera.boresight, attitude @ inputs.a_priori_camera_from_j2000.T @ camera.boresight]
    )
    shift = np.diff(places_even_behind(camera, boresight), axis=0)[0]
    twist = float(np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]))
    return FieldFound(attitude, shift, twist, confidence, search, sure)


def stars_around(
    context: Context, inputs: Inputs, catalog: StarTable, attitude: FloatArray
) -> StarPrediction:
    """Predict the stars around the field that `attitude` looks at; their places stay those of the a priori pointing."""
    settings = context.settings
    stars = predict_stars(
        catalog, inputs.et, inputs.observer, context.camera, attitude, settings.max_shift_px
    )
    stars = brightest(stars, settings.max_stars)
    return stars.predicted_with(context.camera, inputs.a_priori_camera_from_j2000)


def brightest(stars: StarPrediction, most: int) -> StarPrediction:
    """Return the brightest stars, at most `most`, in their order."""
    if len(stars) <= most:
        return stars
    keep = np.sort(np.argsort(stars.mag, kind="stable")[:most])
    return stars.take(keep)


def _why_unsure(answer: Identification) -> str:
    if len(answer.pairs) == 0:
        return answer.message
    stars = "one star" if len(answer.pairs) == 1 else f"{len(answer.pairs)} stars"
    return f"the likeliest answer, {stars}, has a confidence of {answer.confidence:.2f} only"


def _search_limits(context: Context, inputs: Inputs) -> str:
    """How far was searched, in words."""
    if inputs.wide_stars is None or not context.settings.wide_searches:
        return ""
    shift, twist = context.settings.wide_searches[-1]
    return f"; nor is it within {shift:g} px and {twist:g} deg"


def deeper_words(context: Context, inputs: Inputs) -> str:
    """Return what to do for more stars in the field that the a priori pointing has."""
    camera = context.camera
    ra, dec = radec_from_unit(camera.boresight @ inputs.a_priori_camera_from_j2000)
    more = deeper_catalogs(float(ra), float(dec), camera.n_pixel * camera.n_line * camera.pixel_scale_rad**2)
    return f"take a deeper catalog ({more}; --catalog)" if more else "take a deeper catalog (--catalog)"


OF_BRIGHTNESS = "correct the exposure (its unit?) in header or mission file, or the camera file's zero point"
ONE_OF_TWO = "mark two stars (two_star_pointing)"
WIDER = "search the whole sky (--attitude none), widen the search (max_shift_px), or mark two stars (two_star_pointing)"


def _unidentified(state: SessionState, why: str, searched: str = "", remedy: str = WIDER) -> FieldMatch:
    count = 0 if state.a_priori is None else len(state.a_priori)
    message = f"the star field is not identified: {why}{searched}. The a priori pointing stands; {remedy}."
    return FieldMatch(None, None, np.full((count, 2), np.nan), np.zeros(count, dtype=bool), 0.0, (message,))


# ---- Session step: the analyst marks two stars, named or not, and the field follows from them.


def two_star_pointing(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Solve shift and twist of the field from two marked stars; `find_stars` then goes on from there."""
    predicted_stars(state)
    catalog = catalog_stars(inputs)
    answer = _marked_identification(context, inputs, catalog, parameters)
    if parameters["ids"] is None and answer.confidence < MIN_CONFIDENCE:
        raise SessionError(
            f"the two marked stars cannot be told from others of the same separation ({answer.message}); "
            "name them (ids=[...]), or mark two others, bright and far apart."
        )
    found = found_field(inputs, answer, MARKED)
    messages = () if found.sure else (f"the field rests on two marked stars: {answer.message}",)
    return _with_new_field(context, inputs, state, found).with_notes("stars", *messages)


def _with_new_field(context: Context, inputs: Inputs, state: SessionState, found: FieldFound) -> SessionState:
    """Predict the stars anew around a field that the analyst found; centers and pointing found before are dropped."""
    stars = stars_around(context, inputs, catalog_stars(inputs), found.camera_from_j2000)
    on_detector = context.camera.on_detector(stars.places(context.camera, found.camera_from_j2000))
    fresh = state.replace(
        a_priori=stars,
        centers=None,
        pointing=None,
        psf=None,
        star_field=found,
        found_status=unsearched_statuses(on_detector),
        star_methods=MappingProxyType({}),
    )
    status = with_decisions(fresh, fresh.found_status)
    without = fresh.replace(status=status).with_notes("stars").with_notes("pointing")
    return without.with_notes(ORIENTATION_TOPIC)


def _marked_identification(
    context: Context, inputs: Inputs, catalog: StarTable, parameters: dict[str, Any]
) -> Identification:
    directions = apparent_stars(catalog, inputs.et, inputs.observer)
    mag, _ = camera_magnitudes(catalog, context.camera)
    ids = parameters["ids"]
    if ids is None:
        named = None
    elif missing := unknown_star_ids(inputs, ids):
        raise SessionError(f"no star {', '.join(missing)} in the catalog around this field.")
    else:
        rows = [int(np.flatnonzero(catalog.id == star)[0]) for star in ids]
        named = (rows[0], rows[1])
    return identify_marked(
        directions @ inputs.a_priori_camera_from_j2000.T,
        mag,
        star_detections(context),
        context.camera,
        parameters["places"],
        named,
        max_shift_px=max(
            shift for shift, _ in [(context.settings.max_shift_px, 0.0), *context.settings.wide_searches]
        ),
        zero_point_mag=zero_point_mag(context),
    )


def catalog_stars(inputs: Inputs) -> StarTable:
    """Return every catalog row at hand, those near the a priori field first."""
    return StarTable.concatenate([inputs.stars, _far_stars(inputs)])


def _far_stars(inputs: Inputs) -> StarTable:
    """Stars of the wide search that are not among the near ones."""
    if inputs.wide_stars is None:
        return StarTable.empty()
    return inputs.wide_stars.take(~np.isin(inputs.wide_stars.id, inputs.stars.id))


def unknown_star_ids(inputs: Inputs, ids: Sequence[str]) -> list[str]:
    """Return those of `ids` that no catalog row at hand has."""
    known = set(inputs.stars.id.tolist()) | set(_far_stars(inputs).id.tolist())
    return [star for star in ids if star not in known]


def two_star_outcome(state: SessionState, _: dict[str, Any]) -> str:
    """One line of what came out, for the journal."""
    found = state.star_field
    assert found is not None
    shift = f"({found.shift_px[0]:+.1f}, {found.shift_px[1]:+.1f}) px"
    return f"field moved by {shift}, turned by {np.degrees(found.twist_rad):+.2f} deg; confidence {found.confidence:.3f}"


# ---- Session step: the analyst moves the predicted field by hand, pixel by pixel, until it lies on the stars.


def nudge(context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]) -> SessionState:
    """Move the field from where it is known best; what was found with the older pointing is dropped."""
    predicted_stars(state)
    shift = np.array([parameters["delta_pixel"], parameters["delta_line"]])
    twist = float(np.radians(parameters["delta_twist_deg"]))
    before = best_attitude(inputs, state, with_identified=True)
    attitude = nudged_attitude(context.camera, before, shift, twist)
    return _with_new_field(
        context, inputs, state, field_at(context, inputs, attitude, BY_HAND, 0.0, sure=False)
    )


def nudged_attitude(
    camera: Camera, camera_from_j2000: FloatArray, shift_px: FloatArray, twist_rad: float
) -> FloatArray:
    """Return the attitude with which the field lies `shift_px` (pixel, line) farther and is turned.

    The twist turns the picture about its boresight, from +pixel toward +line.

    Raises
    ------
    SessionError
        The shift is larger than the detector.
    """
    rays = camera.unproject(camera.center_pixel_line + np.array([np.zeros(2), shift_px]))
    if np.abs(shift_px).max() > max(camera.n_pixel, camera.n_line) or not np.isfinite(rays).all():
        raise SessionError(
            f"a nudge by ({shift_px[0]:+.1f}, {shift_px[1]:+.1f}) px is more than {camera.name}'s field; move it in "
            "smaller steps, or mark two stars (two_star_pointing)."
        )
    across, turned = np.cross(*rays), np.cross(*camera.focal_from_camera[:2])
    angle = float(angle_between(*rays))
    move = rotation_from_vector(unit(across) * angle) if angle > 0.0 else np.eye(3)
    return np.asarray(move @ rotation_from_vector(turned * twist_rad) @ camera_from_j2000)


def nudge_reach_px(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> float:
    """Return how far from its a priori place a nudge would bring the field, at least."""
    shift = np.array([parameters["delta_pixel"], parameters["delta_line"]])
    before = best_attitude(inputs, state, with_identified=True)
    here = field_at(context, inputs, before, BY_HAND, 0.0, sure=False)
    return float(np.hypot(*(here.shift_px + shift)))


def nudge_outcome(state: SessionState, _: dict[str, Any]) -> str:
    """One line of what came out, for the journal."""
    found = state.star_field
    assert found is not None
    return f"field moved by hand: ({found.shift_px[0]:+.1f}, {found.shift_px[1]:+.1f}) px from its a priori place"
