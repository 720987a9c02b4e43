"""Is a planned picture good? The verdict, and why, in plain words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.planning.attitude import PointingPlan
from opnav_workbench.planning.bodies import PEAK_NEAR, POINT_PX, TargetPlan
from opnav_workbench.planning.sequence_parts import Limits, SunRule
from opnav_workbench.planning.stars import StarPlan

__all__ = ["Verdict", "judge_picture"]

Grade = Literal["good", "marginal", "bad"]
KEEP_OUT_MARGIN_DEG = (
    2.0  # nearer to the keep-out angle than this, a small change of the plan breaks the rule
)
SATURATED_SHARE = 0.02  # of a disk: less costs nothing


@dataclass(frozen=True, slots=True)
class Verdict:
    """A grade and its reasons, the gravest first.

    Attributes
    ----------
    grade : "good", "marginal" or "bad"
    reasons : tuple of str
    """

    grade: Grade
    reasons: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The reasons as one text."""
        return "; ".join(self.reasons)


def judge_picture(
    camera: Camera,
    limits: Limits,
    sun: SunRule,
    elongation_deg: float,
    stars: StarPlan,
    pointing: PointingPlan | None,
    targets: tuple[TargetPlan, ...],
    saturation_dn: float | None,
) -> Verdict:
    """Grade a picture: the worst of what its Sun, its stars and its targets say."""
    said = [
        *_sun(sun, elongation_deg),
        *_stars(limits, stars, pointing),
        *(entry for target in targets for entry in _target(camera, limits, target, stars, saturation_dn)),
    ]
    bad = [words for grade, words in said if grade == "bad"]
    marginal = [words for grade, words in said if grade == "marginal"]
    grade: Grade = "bad" if bad else "marginal" if marginal else "good"
    return Verdict(grade, tuple(bad + marginal))


Said = Iterator[tuple[Grade, str]]


def _sun(sun: SunRule, elongation_deg: float) -> Said:
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


def _stars(limits: Limits, stars: StarPlan, pointing: PointingPlan | None) -> Said:
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


def _target(
    camera: Camera, limits: Limits, target: TargetPlan, stars: StarPlan, saturation_dn: float | None
) -> Said:
    name, place = target.name, target.prediction.pixel_line
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
    yield from _place(camera, limits, target)
    yield from _neighbour(target, stars, camera)
    yield from _precision(limits, target)


def _where(camera: Camera, place: np.ndarray) -> str:
    if not np.isfinite(place).all():
        return ", behind the camera"
    outside = np.maximum(-place, place - [camera.n_pixel - 1, camera.n_line - 1]).max()
    return f" by {outside:.0f} px"


def _place(camera: Camera, limits: Limits, target: TargetPlan) -> Said:
    place, radius = target.prediction.pixel_line, 0.5 * np.nan_to_num(target.prediction.diameter_px)
    inside = float(np.minimum(place, np.array([camera.n_pixel, camera.n_line]) - 1.0 - place).min())
    room = limits.edge_sigmas * camera.attitude_sigma.cross_px
    if inside < radius:
        yield "marginal", f"{target.name} is cut by the edge"
    elif inside < radius + room:
        words = f"{target.name} is {inside:.0f} px from the edge: {limits.edge_sigmas:g} sigma of pointing, {room:.0f} px, "
        yield "marginal", words + "may take it off the detector"


def _neighbour(target: TargetPlan, stars: StarPlan, camera: Camera) -> Said:
    if not len(stars) or target.prediction.diameter_px > POINT_PX:
        return
    distance = np.hypot(*(stars.pixel_line - target.prediction.pixel_line).T)
    near = int(np.argmin(distance))
    if distance[near] < 6.0 * camera.psf.sigma_px:
        yield (
            "marginal",
            f"star {stars.id[near]} of magnitude {stars.mag[near]:.1f} is {distance[near]:.1f} px from {target.name}",
        )


def _precision(limits: Limits, target: TargetPlan) -> Said:
    sigma = float(np.max(target.sigma_px))
    if limits.target_sigma_px is not None and not sigma <= limits.target_sigma_px:
        yield "marginal", f"{target.name} known to {sigma:.2f} px only, {limits.target_sigma_px:g} wanted"
    if limits.target_sigma_km is not None and not target.sigma_km <= limits.target_sigma_km:
        yield (
            "marginal",
            f"{target.name} known to {target.sigma_km:.3g} km only, {limits.target_sigma_km:g} wanted",
        )
