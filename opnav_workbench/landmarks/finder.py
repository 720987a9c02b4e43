"""Landmarks of a body found in a picture: predicted, drawn, correlated, fitted, and held against each other.

Flow   prediction -> templates -> correlation over the whole search -> where all agree -> fits -> scattering law ->
       covariances -> consensus -> once more from the corrected pose -> statuses

Frame  J2000; (pixel, line) on the detector
Units  px, km, rad
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError, EstimationError, counted
from opnav_workbench.landmarks.drawing import Templates, draw_templates
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.landmarks.matching import (
    PatchFit,
    PicturePlanes,
    correlate,
    fit_patch,
    law_share,
)
from opnav_workbench.landmarks.pose import PosedLandmarks, PoseKnowledge, pose_from_landmarks
from opnav_workbench.landmarks.prediction import (
    MOST_EMISSION_DEG,
    MOST_INCIDENCE_DEG,
    LandmarkPrediction,
    WholeBody,
    landmark_partials,
    landmark_places,
    pixel_size_km,
    predict_landmarks,
)
from opnav_workbench.landmarks.results import LandmarkCenters, LandmarkSolution, LandmarkStatus, PoseSolution
from opnav_workbench.landmarks.whitening import fitted_white, shift_covariances
from opnav_workbench.render import BodyModel
from opnav_workbench.targets import TargetState
from opnav_workbench.threads import one_thread

__all__ = [
    "drawn_templates",
    "find_landmarks",
    "judge_landmarks",
    "picture_planes",
    "posed",
    "predicted_again",
    "with_pose",
]

MOST_LANDMARKS = 400  # of those that can be seen; more do not help a pose whose errors are shared
SMALLEST_WINDOW, LARGEST_WINDOW, WINDOW_SHARE = 15, 41, 0.95  # px: a template's side, of a maplet's width
DEFAULT_RADIUS_PX, LARGEST_RADIUS_PX = 12, 80
NEAR_COMMON_PX = 4  # of a landmark's peak from where all agree, beside what turning and scale spread
# Of a first pass, which only has to bring the second within its search radius: each of these tells that to some 0.2 px.
FIRST_LANDMARKS = 80
SECOND_RADIUS_PX = 3  # from the corrected pose
# Of unrelated patches of 600 px, whose detail is 2 px wide, the best of 49 shifts correlates with 0.3.
LEAST_CORRELATION = 0.45
DIVERGED = "its fit does not converge"
WORST_SIGMA_PX = 0.5
REJECT_SIGMAS = 3.5
# Templates of all landmarks share the PSF, the law and the way they are drawn; tests/landmarks/landmark_exam.py has 0.03 px.
COMMON_SIGMA_PX = 0.03
# What is believed of position (of the range) and twist where nobody says it, in the consensus alone.
LOOSE_POSITION, LOOSE_TWIST_DEG = 0.1, 3.0
SEED = 40811


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """One pass: templates where the landmarks are expected, and what was measured."""

    templates: Templates
    fits: tuple[PatchFit | None, ...]
    peaks: FloatArray
    why: tuple[str, ...]


@one_thread()
def find_landmarks(
    picture: BodyPicture,
    maplets: Maplets,
    *,
    attitude_covariance_rad2: FloatArray | None = None,
    position_covariance_km2: FloatArray | None = None,
    search_radius_px: float | None = None,
    most_emission_deg: float = MOST_EMISSION_DEG,
    most_incidence_deg: float = MOST_INCIDENCE_DEG,
) -> LandmarkSolution:
    """Find landmarks of a body.

    Parameters
    ----------
    picture
        With a model of the body among its models: its state, shape and law.
    maplets
        Of that body.
    attitude_covariance_rad2 : (3, 3) array, optional
        Of the picture's attitude: it takes part in the pose. Without it landmarks alone tell.
    position_covariance_km2 : (3, 3) array, optional
        Of the body's place relative to the spacecraft, J2000.
    search_radius_px
        How far from its prediction a landmark may lie; by default what attitude and position allow, 12 px or more.
    most_emission_deg, most_incidence_deg
        What is seen or lit more obliquely is left out.

    Raises
    ------
    CenterfindingError
        The picture has no model of the body, or its orientation or the Sun is not known.
    """
    model = picture.model(maplets.body)
    whole = WholeBody.of(model)
    first = predict_landmarks(
        maplets,
        model,
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        whole=whole,
        most_emission_deg=most_emission_deg,
        most_incidence_deg=most_incidence_deg,
    )
    rows = _chosen(first)
    counts = Counter(reason for reason in first.reason.tolist() if reason)
    if spare := int(first.usable.sum()) - len(rows):
        counts[f"beyond the {MOST_LANDMARKS} taken"] = spare
    known = PoseKnowledge(position_covariance_km2, attitude_covariance_rad2)
    planes = picture_planes(picture)
    wanted = maplets.take(rows)
    radius = _radius(picture, known, first, rows, search_radius_px)
    corrected, search = _passes(picture, planes, wanted, model, whole, known, radius)
    centers = _centers(picture, wanted, model, search, first, rows, counts, corrected)
    return judge_landmarks(centers, _of_picture(centers, picture, model), known)


def _chosen(prediction: LandmarkPrediction) -> IntArray:
    """Return the landmarks to look for: all that can be seen, or as many as are of use, at random."""
    rows = np.flatnonzero(prediction.usable)
    if len(rows) <= MOST_LANDMARKS:
        return rows
    return np.sort(np.random.default_rng(SEED).permutation(rows)[:MOST_LANDMARKS])


def picture_planes(picture: BodyPicture) -> PicturePlanes:
    """Return the picture with its whole variance: that of the sky, and the light's own."""
    signal = np.nan_to_num(np.asarray(picture.signal_dn, dtype=np.float64))
    variance = np.asarray(picture.noise_dn, dtype=np.float64) ** 2
    if picture.noise_model is not None:
        variance = variance + np.maximum(signal, 0.0) / picture.noise_model.gain_e_per_dn
    good = ~(picture.bad | picture.saturated) & np.isfinite(picture.signal_dn) & np.isfinite(variance)
    return PicturePlanes(signal, np.where(good & (variance > 0.0), variance, 1.0), good)


def _radius(
    picture: BodyPicture,
    known: PoseKnowledge,
    prediction: LandmarkPrediction,
    rows: IntArray,
    asked_px: float | None,
) -> int:
    """Return how far landmarks are looked for, px."""
    if asked_px is not None:
        if not 1.0 <= asked_px <= LARGEST_RADIUS_PX:
            raise CenterfindingError(
                f"a search radius of {asked_px} px for landmarks: give 1 to {LARGEST_RADIUS_PX}."
            )
        return int(np.ceil(asked_px))
    if len(rows) == 0:
        return DEFAULT_RADIUS_PX
    scale = picture.camera.pixel_scale_rad
    turned = (
        0.0
        if known.attitude_covariance_rad2 is None
        else np.linalg.eigvalsh(known.attitude_covariance_rad2)[1]
    )
    moved = (
        0.0
        if known.position_covariance_km2 is None
        else np.linalg.eigvalsh(known.position_covariance_km2)[-1]
    )
    near = float(pixel_size_km(picture.camera, prediction.range_km[rows]).min())
    sigma = np.sqrt(turned / scale**2 + moved / near**2)
    return int(np.clip(np.ceil(4.0 * sigma), DEFAULT_RADIUS_PX, LARGEST_RADIUS_PX))


# ---- Passes: templates correlated and fitted, first far, then from the corrected pose.


def _passes(
    picture: BodyPicture,
    planes: PicturePlanes,
    maplets: Maplets,
    model: BodyModel,
    whole: WholeBody | None,
    known: PoseKnowledge,
    radius: int,
) -> tuple[BodyPicture, _Search | None]:
    """Return the picture with the pose that its landmarks agree on, and what was measured from there."""
    if len(maplets) == 0:
        return picture, None
    for some in _first_ones(maplets):
        templates = _templates(picture, some, model, whole)
        search = _searched(planes, templates, radius, common=True)
        corrected = _corrected(picture, some, model, known, search)
        if corrected is not None:
            break
    else:
        return picture, search
    here, place = corrected
    templates = _templates(here, maplets, place, whole).with_share(search.templates.share)
    return here, _searched(planes, templates, SECOND_RADIUS_PX, common=False)


def _first_ones(maplets: Maplets) -> tuple[Maplets, ...]:
    """Return those that a first pass tries, one after the other: some, and all where these do not agree."""
    if len(maplets) <= FIRST_LANDMARKS:
        return (maplets,)
    rows = np.random.default_rng(SEED).permutation(len(maplets))[:FIRST_LANDMARKS]
    return maplets.take(np.sort(rows)), maplets


def _templates(
    picture: BodyPicture, maplets: Maplets, model: BodyModel, whole: WholeBody | None
) -> Templates:
    """Draw maplets in windows as large as suits them all."""
    distance = np.linalg.norm(model.target.position_km)
    wide = 2.0 * maplets.half_width_km / pixel_size_km(picture.camera, np.asarray(distance))
    size = int(np.clip(WINDOW_SHARE * np.median(wide), SMALLEST_WINDOW, LARGEST_WINDOW)) // 2 * 2 + 1
    return drawn_templates(picture, maplets, model, whole, size)


def drawn_templates(
    picture: BodyPicture, maplets: Maplets, model: BodyModel, whole: WholeBody | None, size: int
) -> Templates:
    """Draw maplets as a picture sees them, in windows of `size` px."""
    return draw_templates(
        maplets,
        model,
        whole,
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        picture.psf,
        size,
    )


def _searched(planes: PicturePlanes, templates: Templates, radius: int, *, common: bool) -> _Search:
    """Correlate and fit, again with the scattering law that the first fits tell."""
    fits, peaks, why = _fitted(planes, templates, radius, common=common)
    share = law_share(planes, templates, fits) if any(f is not None for f in fits) else templates.share
    if share != templates.share:
        templates = templates.with_share(share)
        fits, peaks, why = _fitted(planes, templates, radius, common=common)
    if not common:
        first = fits
        fits = fitted_white(planes, templates, fits)
        for row, (before, fit) in enumerate(zip(first, fits, strict=True)):
            if before is not None and fit is None:
                why[row] = DIVERGED
    return _Search(templates, tuple(fits), peaks, tuple(why))


def _fitted(
    planes: PicturePlanes, templates: Templates, radius: int, *, common: bool
) -> tuple[list[PatchFit | None], FloatArray, list[str]]:
    scores = np.array([correlate(planes, templates, row, radius) for row in range(len(templates))])
    allowed = np.ones(scores.shape[1:], dtype=bool)
    if common and len(scores) > 1:
        allowed = _near_common_peak(scores, radius)
    fits: list[PatchFit | None] = []
    why: list[str] = []
    for row, score in enumerate(np.where(allowed, scores, -1.0)):
        line, pixel = np.unravel_index(int(score.argmax()), score.shape)
        fit = None
        if score[line, pixel] > 0.0:
            fit = fit_patch(planes, templates, row, np.array([pixel - radius, line - radius]))
        fits.append(fit)
        why.append("" if fit is not None else DIVERGED if score.max() > 0.0 else "no correlation")
    return fits, np.where(allowed, scores, -1.0).max(axis=(1, 2)), why


def _near_common_peak(scores: FloatArray, radius: int) -> np.ndarray:
    """Tell which shifts (2 r + 1, 2 r + 1) are near the one that all landmarks like best.

    Each surface is spread by what turning and scale may move one landmark against another.
    """
    spread = max(NEAR_COMMON_PX, radius // 6)
    best = ndimage.maximum_filter(scores, size=(1, 2 * (spread // 2) + 1, 2 * (spread // 2) + 1))
    together = np.maximum(best, 0.0).sum(axis=0)
    line, pixel = np.unravel_index(int(ndimage.gaussian_filter(together, 1.0).argmax()), together.shape)
    y, x = np.mgrid[: together.shape[0], : together.shape[1]]
    return np.asarray(np.hypot(y - line, x - pixel) <= spread + 1)


def _measured(search: _Search) -> tuple[FloatArray, FloatArray]:
    """Return observed places (n, 2) px and covariances (n, 2, 2); nan where there is none."""
    observed = np.full((len(search.fits), 2), np.nan)
    places = search.templates.first + search.templates.offset_px
    for row, fit in enumerate(search.fits):
        if fit is not None:
            observed[row] = places[row] + fit.shift_px
    return observed, shift_covariances(search.fits)


def _corrected(
    picture: BodyPicture, maplets: Maplets, model: BodyModel, known: PoseKnowledge, search: _Search
) -> tuple[BodyPicture, BodyModel] | None:
    """Return picture and model with the pose of a first pass; None where its landmarks do not agree."""
    observed, covariance = _measured(search)
    good = [fit is not None and fit.gain > 0.0 and fit.correlation > LEAST_CORRELATION for fit in search.fits]
    landmarks = PosedLandmarks(
        maplets.place_km,
        maplets.place_covariance_km2,
        observed,
        np.where(np.isfinite(covariance), covariance, np.eye(2)),
        model.target,
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        np.zeros((2, 2)),
    )
    try:
        pose, _ = pose_from_landmarks(landmarks, _loose(known, landmarks), good)
    except EstimationError:
        return None
    return with_pose(picture, model, pose)


def with_pose(picture: BodyPicture, model: BodyModel, pose: PoseSolution) -> tuple[BodyPicture, BodyModel]:
    """Return picture and model of a body with the camera where a pose has it."""
    moved = replace(model, target=replace(model.target, position_km=-pose.position_km))
    models = tuple(moved if one is model else one for one in picture.models)
    return replace(picture, camera_from_j2000=pose.camera_from_j2000, models=models), moved


def _loose(known: PoseKnowledge, landmarks: PosedLandmarks) -> PoseKnowledge:
    """Return knowledge that keeps a consensus from running away where nobody says how well the pose is known."""
    position, attitude = known.position_covariance_km2, known.attitude_covariance_rad2
    camera = landmarks.camera
    if position is None:
        position = (LOOSE_POSITION * landmarks.target.range_km) ** 2 * np.eye(3)
    if attitude is None:
        twist = np.radians(LOOSE_TWIST_DEG) ** 2 * np.outer(camera.boresight, camera.boresight)
        attitude = (LARGEST_RADIUS_PX * camera.pixel_scale_rad) ** 2 * np.eye(3) + twist
    return PoseKnowledge(position, attitude)


# ---- Results.


def _centers(
    picture: BodyPicture,
    maplets: Maplets,
    model: BodyModel,
    search: _Search | None,
    prediction: LandmarkPrediction,
    rows: IntArray,
    counts: Mapping[str, int],
    corrected: BodyPicture,
) -> LandmarkCenters:
    n = len(maplets)
    observed, covariance = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    correlation, gain, why = np.full(n, np.nan), np.full(n, np.nan), ["no correlation"] * n
    laws, share = ("", ""), 0.0
    if search is not None:
        observed, covariance = _measured(search)
        correlation = np.array([np.nan if fit is None else fit.correlation for fit in search.fits])
        gain = np.array([np.nan if fit is None else fit.gain for fit in search.fits])
        gain = gain / np.nanmedian(gain) if np.isfinite(gain).any() and np.nanmedian(gain) > 0.0 else gain
        why, laws, share = list(search.why), search.templates.laws, search.templates.share
    if corrected is picture and search is not None:
        why = [reason or "no pose is agreed on" for reason in why]
        observed, covariance = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    where = (model.target, picture.camera, picture.camera_from_j2000, picture.observer_velocity_km_s)
    return LandmarkCenters(
        body=maplets.body,
        source=maplets.source,
        id=maplets.id,
        place_km=maplets.place_km,
        place_covariance_km2=maplets.place_covariance_km2,
        predicted_px=prediction.pixel_line[rows],
        observed_px=observed,
        covariance_px2=covariance,
        common_covariance_px2=(COMMON_SIGMA_PX**2 + picture.excess_sigma_px**2) * np.eye(2),
        correlation=correlation,
        gain=gain,
        emission_deg=np.degrees(prediction.emission_rad[rows]),
        incidence_deg=np.degrees(prediction.incidence_rad[rows]),
        ratio=prediction.ratio[rows],
        failure=np.array(why, dtype=np.str_),
        partials=landmark_partials(maplets.place_km, *where),
        not_searched=MappingProxyType(dict(sorted(counts.items()))),
        window_px=0.0 if search is None else float(search.templates.size),
        laws=laws,
        law_share=share,
    )


def posed(
    centers: LandmarkCenters,
    target: TargetState,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
) -> PosedLandmarks:
    """Return measured landmarks as `pose_from_landmarks` takes them, with the state and attitude to start from."""
    return PosedLandmarks(
        centers.place_km,
        centers.place_covariance_km2,
        centers.observed_px,
        np.where(np.isfinite(centers.covariance_px2), centers.covariance_px2, np.eye(2)),
        target,
        camera,
        camera_from_j2000,
        velocity_km_s,
        centers.common_covariance_px2,
        centers.window_px,
    )


def _of_picture(centers: LandmarkCenters, picture: BodyPicture, model: BodyModel) -> PosedLandmarks:
    return posed(
        centers, model.target, picture.camera, picture.camera_from_j2000, picture.observer_velocity_km_s
    )


def predicted_again(centers: LandmarkCenters, landmarks: PosedLandmarks) -> LandmarkCenters:
    """Return the same measurements with predictions and partials of another state or attitude."""
    where = (landmarks.target, landmarks.camera, landmarks.camera_from_j2000, landmarks.velocity_km_s)
    return replace(
        centers,
        predicted_px=landmark_places(centers.place_km, *where),
        partials=landmark_partials(centers.place_km, *where),
    )


def judge_landmarks(
    centers: LandmarkCenters,
    landmarks: PosedLandmarks,
    known: PoseKnowledge,
    decisions: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> LandmarkSolution:
    """Return the statuses of measured landmarks, and the pose that they agree on.

    Parameters
    ----------
    landmarks
        The same with camera and state, see `posed`.
    decisions : mapping of str to (str, str)
        The analyst's verdicts ("accepted" or "rejected") and reasons by landmark; they outrank what is found here.
    """
    reasons = [_fault(centers, row) for row in range(len(centers))]
    verdicts = [decisions.get(str(name), ("", "")) for name in centers.id]
    good = np.array([not reason for reason in reasons], dtype=bool)
    good &= np.array([verdict != "rejected" for verdict, _ in verdicts], dtype=bool)
    by_hand = np.array([verdict == "accepted" for verdict, _ in verdicts], dtype=bool) & centers.measured
    messages: list[str] = []
    pose: PoseSolution | None = None
    loose = _loose(known, landmarks)
    used = np.zeros(len(centers), dtype=bool)
    try:
        _, agreed = pose_from_landmarks(landmarks, loose, good)
        agreed = agreed & ~_far(centers, landmarks, loose, agreed)
        pose, used = pose_from_landmarks(landmarks, known, agreed=agreed | by_hand)
    except EstimationError as error:
        messages.append(f"no pose from the landmarks of {centers.body}: {error}")
    status: list[LandmarkStatus] = []
    for row, (verdict, words) in enumerate(verdicts):
        found = bool(centers.measured[row])
        status.append("accepted" if used[row] else "rejected" if found else "not_found")
        if verdict == "rejected" and found:
            reasons[row] = f"by the analyst: {words}" if words else "by the analyst"
        elif used[row]:
            reasons[row] = words if verdict == "accepted" else ""
        elif not reasons[row]:
            reasons[row] = "it does not agree with the others" if pose is not None else "no pose is agreed on"
    n = int(used.sum())
    messages.append(f"{counted(n, 'landmark')} of {len(centers)} accepted on {centers.body}")
    return LandmarkSolution(centers, tuple(status), tuple(reasons), pose, tuple(messages))


def _fault(centers: LandmarkCenters, row: int) -> str:
    """Return why a landmark cannot be accepted by itself."""
    if centers.failure[row]:
        return str(centers.failure[row])
    if not centers.gain[row] > 0.0:
        return "it is dark where it should be bright"
    if not centers.correlation[row] >= LEAST_CORRELATION:
        return f"its correlation is {centers.correlation[row]:.2f}, below {LEAST_CORRELATION}"
    sigma = float(np.sqrt(np.linalg.eigvalsh(centers.covariance_px2[row])[-1]))
    if not sigma <= WORST_SIGMA_PX:
        return f"its sigma is {sigma:.2f} px, above {WORST_SIGMA_PX}"
    return ""


def _far(
    centers: LandmarkCenters, landmarks: PosedLandmarks, loose: PoseKnowledge, agreed: BoolArray
) -> BoolArray:
    """Tell which of the landmarks that agree lie too far from the pose of all of them."""
    pose, _ = pose_from_landmarks(landmarks, loose, agreed=agreed)
    by_place = centers.partials.place_px_per_km
    stated = centers.covariance_px2 + by_place @ centers.place_covariance_km2 @ np.swapaxes(by_place, 1, 2)
    out = np.ones(len(centers), dtype=bool)
    rows = np.flatnonzero(centers.measured)
    whole = stated[rows] + pose.excess_sigma_px**2 * np.eye(2)
    left = pose.post_fit_px[rows]
    square = np.einsum("ni,nij,nj->n", left, np.linalg.inv(whole), left)
    out[rows] = square > REJECT_SIGMAS**2
    return out
