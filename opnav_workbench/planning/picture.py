"""One planned picture: everything that is expected of it, whether it is good, and why, in plain words."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, OpNavError
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.planning.attitude import PointingPlan, plan_pointing
from opnav_workbench.planning.bodies import (
    PEAK_NEAR,
    POINT_PX,
    OtherBody,
    TargetPlan,
    other_bodies,
    plan_target,
)
from opnav_workbench.planning.exposure import BestExposure, best_exposure
from opnav_workbench.planning.light import ExpectedLight, expected_light
from opnav_workbench.planning.opened_sequence import OpenedSequence, reason_of
from opnav_workbench.planning.sequence import PlanLimits, PlannedPicture, SunRule
from opnav_workbench.planning.stars import StarPlan, catalog_depth_mag, limiting_magnitude, plan_stars

__all__ = ["PicturePlan", "PicturePrediction", "PlanVerdict", "plan_picture"]


# ---- Is a planned picture good? The verdict, and why, in plain words.

PlanGrade = Literal["good", "marginal", "bad"]
KEEP_OUT_MARGIN_DEG = (
    2.0  # nearer to the keep-out angle than this, a small change of the plan breaks the rule
)
SATURATED_SHARE = 0.02  # of a disk: less costs nothing


@dataclass(frozen=True, slots=True)
class PlanVerdict:
    """A grade and its reasons, the gravest first.

    Attributes
    ----------
    grade : "good", "marginal" or "bad"
    """

    grade: PlanGrade
    reasons: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The reasons as one text."""
        return "; ".join(self.reasons)


def judge_picture(
    camera: Camera,
    limits: PlanLimits,
    sun: SunRule,
    elongation_deg: float,
    stars: StarPlan,
    pointing: PointingPlan | None,
    targets: tuple[TargetPlan, ...],
) -> PlanVerdict:
    """Grade a picture: the worst of what its Sun, its stars and its targets say."""
    said = [
        *_sun_reasons(sun, elongation_deg),
        *_star_reasons(limits, stars, pointing),
        *(reason for target in targets for reason in _target_reasons(camera, limits, target, stars)),
    ]
    bad = [words for grade, words in said if grade == "bad"]
    marginal = [words for grade, words in said if grade == "marginal"]
    grade: PlanGrade = "bad" if bad else "marginal" if marginal else "good"
    return PlanVerdict(grade, tuple(bad + marginal))


Reasons = Iterator[tuple[PlanGrade, str]]


def _sun_reasons(sun: SunRule, elongation_deg: float) -> Reasons:
    if elongation_deg < sun.keep_out_deg:
        yield (
            "bad",
            f"the Sun is {elongation_deg:.1f}° away, inside the keep-out angle of {sun.keep_out_deg:g}°",
        )
    elif elongation_deg < sun.keep_out_deg + KEEP_OUT_MARGIN_DEG:
        yield (
            "marginal",
            f"the Sun is {elongation_deg:.1f}° away, hardly outside the keep-out angle of {sun.keep_out_deg:g}°",
        )


def _star_reasons(limits: PlanLimits, stars: StarPlan, pointing: PointingPlan | None) -> Reasons:
    count = int(stars.usable.sum())
    if count == 0 or pointing is None:
        yield "bad", f"no usable star: {_why_none(stars)}"
    elif count < limits.min_stars:
        yield "marginal", f"only {count} usable star{'s' if count > 1 else ''} ({limits.min_stars} wanted)"
    if pointing is not None and not pointing.twist_solved:
        yield "marginal", "the stars do not determine the twist better than it is known beforehand"


def _why_none(stars: StarPlan) -> str:
    if len(stars) == 0:
        return "the catalog has none in the field; use a deeper catalog, or turn the camera"
    counts = {
        name: stars.count(name) for name in ("faint", "saturated", "in_body_light", "hidden", "near_edge")
    }
    told = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)
    return f"{len(stars)} in the catalog are {told or 'blended'}"


def _target_reasons(camera: Camera, limits: PlanLimits, target: TargetPlan, stars: StarPlan) -> Reasons:
    name, place, saturation_dn = target.name, target.prediction.pixel_line, camera.saturation_dn
    if not target.prediction.on_detector:
        yield "bad", f"{name} is off the detector{_where(camera, place)}"
        return
    if target.occulted > 0.99:
        yield "bad", f"{name} is hidden behind another body"
        return
    point = not target.prediction.diameter_px > POINT_PX
    if target.saturated > (0.0 if point else SATURATED_SHARE):
        share = "" if point else f" ({target.saturated:.0%} of its disk)"
        yield "bad", f"{name} is saturated{share}; expose shorter"
    elif saturation_dn is not None and target.peak_dn > PEAK_NEAR * saturation_dn:
        yield "marginal", f"{name} reaches {target.peak_dn:.0f} of {saturation_dn:.0f} DN, near saturation"
    if target.snr < limits.target_snr:
        yield "bad", f"{name} is too faint: SNR {target.snr:.1f}, {limits.target_snr:g} needed"
    elif target.snr < limits.clear_snr:
        yield "marginal", f"{name} is faint: SNR {target.snr:.1f}"
    yield from _edge_reasons(camera, limits, target)
    yield from _neighbour_reasons(target, stars, camera)
    yield from _precision_reasons(limits, target)


def _where(camera: Camera, place: np.ndarray) -> str:
    if not np.isfinite(place).all():
        return ", behind the camera"
    outside = np.maximum(-place, place - [camera.n_pixel - 1, camera.n_line - 1]).max()
    return f" by {outside:.0f} px"


def _edge_reasons(camera: Camera, limits: PlanLimits, target: TargetPlan) -> Reasons:
    place, radius = target.prediction.pixel_line, 0.5 * np.nan_to_num(target.prediction.diameter_px)
    inside = float(np.minimum(place, np.array([camera.n_pixel, camera.n_line]) - 1.0 - place).min())
    room = limits.edge_sigmas * camera.attitude_sigma.cross_px
    if inside < radius:
        yield "marginal", f"{target.name} is cut by the edge"
    elif inside < radius + room:
        words = f"{target.name} is {inside:.0f} px from the edge: {limits.edge_sigmas:g} sigma of pointing, {room:.0f} px, "
        yield "marginal", words + "may take it off the detector"


def _neighbour_reasons(target: TargetPlan, stars: StarPlan, camera: Camera) -> Reasons:
    if not len(stars) or target.prediction.diameter_px > POINT_PX:
        return
    distance = np.hypot(*(stars.pixel_line - target.prediction.pixel_line).T)
    near = int(np.argmin(distance))
    if distance[near] < 6.0 * camera.psf.sigma_px:
        yield (
            "marginal",
            f"star {stars.id[near]} of magnitude {stars.mag[near]:.1f} is {distance[near]:.1f} px from {target.name}",
        )


def _precision_reasons(limits: PlanLimits, target: TargetPlan) -> Reasons:
    sigma = float(np.max(target.sigma_px))
    if limits.target_sigma_px is not None and not sigma <= limits.target_sigma_px:
        yield "marginal", f"{target.name} known to {sigma:.2f} px only, {limits.target_sigma_px:g} wanted"
    if limits.target_sigma_km is not None and not target.sigma_km <= limits.target_sigma_km:
        yield (
            "marginal",
            f"{target.name} known to {target.sigma_km:.3g} km only, {limits.target_sigma_km:g} wanted",
        )


# ---- One planned picture: everything that is expected of it, and the verdict.


@dataclass(frozen=True, slots=True, eq=False)
class PicturePrediction:
    """What a picture is expected to be, where it can be told.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
    ra_deg, dec_deg, twist_deg
        Of the boresight.
    elongation_deg
        Angle between boresight and Sun.
    stray_light_dn
        Scattered sunlight in this exposure as the sequence states it.
    limit_mag
        Of a star at the limiting SNR, in the camera's band.
    catalog_mag
        How deep the catalog goes around the field, in its own band; nan where it has no stars.
    pointing
        None where no star determines it.
    other_bodies
        Other bodies in the field.
    image_dn : (n_line, n_pixel) array
        The expected picture, without noise.
    best_exposure
        None where it was not asked for.
    """

    camera: Camera
    et: float
    camera_from_j2000: FloatArray
    ra_deg: float
    dec_deg: float
    twist_deg: float
    elongation_deg: float
    stray_light_dn: float
    stars: StarPlan
    limit_mag: float
    catalog_mag: float
    pointing: PointingPlan | None
    targets: tuple[TargetPlan, ...]
    other_bodies: tuple[OtherBody, ...]
    image_dn: FloatArray
    best_exposure: BestExposure | None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def target(self, name: str) -> TargetPlan | None:
        """Return what is expected of a target; None where it is none of this picture."""
        return next((t for t in self.targets if t.name.upper() == name.upper()), None)


@dataclass(frozen=True, slots=True, eq=False)
class PicturePlan:
    """A planned picture with its verdict.

    Attributes
    ----------
    pointing_words
        How the pointing is planned.
    prediction
        None where nothing can be told; the verdict says why.
    """

    picture: PlannedPicture
    pointing_words: str
    verdict: PlanVerdict
    prediction: PicturePrediction | None

    @property
    def name(self) -> str:
        """Of the picture."""
        return self.picture.name

    @property
    def utc(self) -> str:
        """Mid-exposure."""
        return "" if self.picture.utc is None else self.picture.utc.isoformat()


def plan_picture(
    opened: OpenedSequence, picture: PlannedPicture, *, others: Sequence[str] = (), exposures: bool = True
) -> PicturePlan:
    """Predict one picture and judge it.

    What cannot be predicted (no kernel coverage, a camera without throughput) is a bad verdict with its reason.

    Parameters
    ----------
    others
        Bodies that may enter the field.
    exposures
        Search the best exposure too.
    """
    words = opened.pointing(picture).words
    try:
        prediction = _predicted(opened, picture, others, exposures)
    except (OpNavError, ValueError) as error:
        return PicturePlan(picture, words, PlanVerdict("bad", (reason_of(error),)), None)
    sequence = opened.sequence
    verdict = judge_picture(
        prediction.camera,
        sequence.limits,
        sequence.sun,
        prediction.elongation_deg,
        prediction.stars,
        prediction.pointing,
        prediction.targets,
    )
    return PicturePlan(picture, words, verdict, prediction)


def _predicted(
    opened: OpenedSequence, picture: PlannedPicture, others: Sequence[str], exposures: bool
) -> PicturePrediction:
    camera = opened.camera(picture)
    fault = camera.exposure_fault(picture.exposure_s)
    if fault:
        raise CameraError(f"exposure of {fault}")
    inputs = opened.inputs(picture)
    light = expected_light(inputs)
    attitude = inputs.path.middle
    stars = plan_stars(light, opened.sequence.limits.star_snr)
    pointing = plan_pointing(stars, camera, attitude)
    wanted = [name.upper() for name in opened.targets(picture)]
    index = {body.target.name.upper(): i for i, body in enumerate(inputs.bodies)}
    targets = tuple(plan_target(light, index[name], pointing) for name in wanted)
    ra, dec, twist = pointing_angles(attitude, camera.focal_from_camera)
    boresight = attitude.T @ camera.boresight
    elongation = opened.elongation_deg(boresight, inputs.et)
    return PicturePrediction(
        camera=camera,
        et=inputs.et,
        camera_from_j2000=attitude,
        ra_deg=float(np.degrees(ra)) % 360.0,
        dec_deg=float(np.degrees(dec)),
        twist_deg=float(np.degrees(twist)) % 360.0,
        elongation_deg=elongation,
        stray_light_dn=opened.stray_light_dn_s(elongation) * inputs.exposure_s,
        stars=stars,
        limit_mag=limiting_magnitude(light, opened.sequence.limits.star_snr),
        catalog_mag=catalog_depth_mag(
            opened.opened_scenario.catalog, boresight, opened.sequence.magnitude_limit
        ),
        pointing=pointing,
        targets=targets,
        other_bodies=other_bodies(opened, inputs, others, wanted, opened.bodies_drawn(picture)),
        image_dn=light.picture.image_dn,
        best_exposure=_best_for_brightest(opened, light, stars, targets, index) if exposures else None,
    )


def _best_for_brightest(
    opened: OpenedSequence,
    light: ExpectedLight,
    stars: StarPlan,
    targets: tuple[TargetPlan, ...],
    index: dict[str, int],
) -> BestExposure:
    """Return the best exposure for the brightest target in the field, or for the stars alone."""
    seen = [t for t in targets if t.snr > 0.0 and t.prediction.on_detector]
    target = max(seen, key=lambda t: t.flux_dn, default=None)
    number = None if target is None else index[target.name.upper()]
    return best_exposure(light, stars, number, target, opened.sequence.limits.star_snr)
