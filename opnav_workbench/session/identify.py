"""Which detection is which star: the field's shift and twist against the a priori pointing.

Before the pointing is solved, detections are matched with the predicted pattern of stars and small bodies; after it,
the solved pointing says where each star is.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.scene import predict_body
from opnav_workbench.session.context import Context
from opnav_workbench.session.state import Inputs, SessionState
from opnav_workbench.starcenters import Detections, Identification, detect, identify
from opnav_workbench.starcenters.identification import DETECTED_PART, LIMIT_MARGIN_MAG, SURE, TOLERANCE_PX
from opnav_workbench.starcenters.voting import move

__all__ = ["FieldMatch", "identify_field"]

DETECTION_SNR = 5.0  # lower than for blind detection: a false detection matches no pattern
# Less sure than this is a guess; a single star found by nearness and brightness reaches 0.3 to 0.6.
MIN_CONFIDENCE = 0.25
# So few leave no redundancy; that other stars are missing where they should be then speaks against them.
FEW_PAIRS = 2
# A body larger than this is not a point of the pattern, and its limb would add false detections.
MAX_POINT_DIAMETER_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class FieldMatch:
    """Where each predicted star is expected on the picture.

    Attributes
    ----------
    found : bool
    expected_px : (n, 2) array
    visible : (n,) array of bool
        Expected on the detector.
    shift_px : (2,) array
        Observed minus a priori place of the field at the detector's center.
    radius_px : float
        How far from the expected place a star may lie.
    messages : tuple of str
    """

    found: bool
    expected_px: FloatArray
    visible: BoolArray
    shift_px: FloatArray
    radius_px: float
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)


def identify_field(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    """Locate the star field, from the solved pointing if there is one, else from the pattern of detections."""
    if state.a_priori is None or len(state.a_priori) == 0:
        return _nothing(state, "no catalog star is predicted near this field")
    if state.pointing is not None:
        return _from_pointing(context, state)
    return _from_pattern(context, inputs, state)


def _from_pointing(context: Context, state: SessionState) -> FieldMatch:
    assert state.a_priori is not None
    assert state.pointing is not None
    pointing = state.pointing
    expected = state.a_priori.places(context.camera, pointing.camera_from_j2000)
    return FieldMatch(
        found=True,
        expected_px=expected,
        visible=context.camera.on_detector(expected),
        shift_px=np.array([pointing.delta_pixel, pointing.delta_line]),
        radius_px=context.settings.refined_radius_px,
    )


def _from_pattern(context: Context, inputs: Inputs, state: SessionState) -> FieldMatch:
    assert state.a_priori is not None
    match, missing = _matched(context, inputs, state)
    if match.confidence < MIN_CONFIDENCE:
        return _nothing(state, match.message)
    if _less(match.confidence, missing) < MIN_CONFIDENCE:
        return _nothing(
            state,
            f"only {len(match.pairs)} could be matched, and {missing} stars bright enough are not where they "
            "then should be",
        )
    camera = context.camera
    expected = move(state.a_priori.pixel_line, camera.center_pixel_line, match.shift_px, match.twist_rad)
    return FieldMatch(
        found=True,
        expected_px=expected,
        visible=camera.on_detector(expected),
        shift_px=match.shift_px,
        radius_px=context.settings.search_radius_px,
        messages=(match.message,) if match.confidence < SURE else (),
    )


def _matched(context: Context, inputs: Inputs, state: SessionState) -> tuple[Identification, int]:
    """Match the pattern with the picture's detections; also how many stars speak against a match of few."""
    camera, settings = context.camera, context.settings
    detections = detect(
        context.signal_dn,
        context.noise_dn,
        context.bad,
        camera.psf.sigma_px,
        DETECTION_SNR,
        saturated=context.frame.saturated,
    )
    points, mags = _pattern(context, inputs, state)
    match = identify(
        points,
        mags,
        detections,
        center_px=camera.center_pixel_line,
        max_shift_px=settings.max_shift_px,
        max_twist_rad=float(np.radians(settings.max_twist_deg)),
        zero_point_mag=_zero_point(context),
    )
    few = 0 < len(match.pairs) <= FEW_PAIRS
    return match, _missing(camera, points, mags, detections, match) if few else 0


def _missing(
    camera: Camera, points: FloatArray, mags: FloatArray, detections: Detections, match: Identification
) -> int:
    """How many stars should be seen beside those that were matched, and are not."""
    star, detection = match.pairs[np.argmax(detections.snr[match.pairs[:, 1]])]
    # How much fainter than this one a star may be and still be detected.
    reach = 2.5 * np.log10(max(float(detections.snr[detection]) / DETECTION_SNR, 1.0)) - LIMIT_MARGIN_MAG
    places = move(points, camera.center_pixel_line, match.shift_px, match.twist_rad)
    bright = (mags < mags[star] + reach) & camera.on_detector(places)
    bright[match.pairs[:, 0]] = False
    distance = np.hypot(*(places[:, None] - detections.pixel_line[None]).transpose(2, 0, 1)).min(axis=1)
    return int(np.sum(bright & (distance > TOLERANCE_PX)))


def _less(confidence: float, missing: int) -> float:
    """Confidence after `missing` stars, each of which a right match misses with probability 1 - DETECTED_PART."""
    odds = confidence / max(1.0 - confidence, np.finfo(float).tiny) * (1.0 - DETECTED_PART) ** missing
    return odds / (1.0 + odds)


def _zero_point(context: Context) -> float | None:
    """Magnitude of a star of 1 DN in this exposure."""
    zero_point = context.camera.zero_point_mag
    return None if zero_point is None else zero_point + 2.5 * float(np.log10(context.frame.exposure_s))


def _pattern(context: Context, inputs: Inputs, state: SessionState) -> tuple[FloatArray, FloatArray]:
    """Predicted places and magnitudes of stars and point-like bodies (magnitude nan where unknown)."""
    assert state.a_priori is not None
    points, mags = [state.a_priori.pixel_line], [state.a_priori.mag]
    for target in (inputs.targets[name] for name in state.targets):
        body = predict_body(target, inputs.observer, context.camera, inputs.a_priori_camera_from_j2000)
        if body.on_detector and body.diameter_px <= MAX_POINT_DIAMETER_PX:
            points.append(body.pixel_line[None])
            mags.append(np.array([np.nan if target.magnitude is None else target.magnitude]))
    return np.concatenate(points), np.concatenate(mags)


def _nothing(state: SessionState, why: str) -> FieldMatch:
    count = 0 if state.a_priori is None else len(state.a_priori)
    message = (
        f"the star field is not identified: {why}. The a priori pointing stands; "
        "take a deeper catalog (--catalog) or widen the search (max_shift_px)."
    )
    return FieldMatch(
        found=False,
        expected_px=np.full((count, 2), np.nan),
        visible=np.zeros(count, dtype=bool),
        shift_px=np.full(2, np.nan),
        radius_px=0.0,
        messages=(message,),
    )
