"""Center of a body from its limb: sub-pixel limb points, and the outline of its model through them.

Flow   measured disk -> limb points about its outline -> outline moved, sized and strained through them -> ... until it
       stands still -> judged beside the likelihood's center
Frame  (pixel, line), 0-based, integer = pixel center
Units  px, km, DN

The outline is the silhouette of the ellipsoid or of the plate model, with distortion and stellar aberration; the center is
the projected center of figure. Size, axes, law and PSF are uncertain as far as the mission file and the pixels say.

Sources  Christian (2021), doi:10.1109/ACCESS.2021.3051914 (horizon fit); Owen (2011), AAS 11-215 (limbs)
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.fit import DiskShape
from opnav_workbench.bodies.disk.measurement import MeasuredDisk, measure_disk
from opnav_workbench.bodies.ellipse.limb_points import LimbPoints, find_limb_points
from opnav_workbench.bodies.ellipse.point_fits import LimbMotion, compare_ellipses, limb_motion, pinhole_px
from opnav_workbench.bodies.judgement import (
    CenterReading,
    difference_covariance,
    judged_center,
    second_reading,
)
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, BodyFlag, FreeEllipse, LimbEllipse
from opnav_workbench.bodies.silhouette import TURN, Outline, Silhouette
from opnav_workbench.errors import CenterfindingError

__all__ = ["find_ellipse"]

METHOD = "ellipse"
LEAST_DIAMETER_PX = 3.0
MOST_STAGES, EVEN_STAGES = 8, 3  # steps are halved after these: pieces of limb come and go
STILL_PX, STILL_SIGMAS = 0.01, 0.05
LARGEST_STEP = 0.3  # of the radius
NEAR_PX, NEAR_SIGMAS = (
    3.0,
    3.0,
)  # how far from the outline the limb is looked for, and sigmas of PSF and of roughness
ROUGH_SHARE, ROUGH_PX = 0.02, 0.5  # of the radius: a limb rougher than both is not that of the model
MISSING_SHARE = 0.05  # of the limb that should be in sight; with more of it missing the shape is another
MOSTLY = 0.5  # of the limb: missing, something else was found; saturated, that is all there is
SATURATED_PX = 0.5  # how well a saturated limb tells where it is
RATIO_SIGMAS, RATIO_SHARE = 3.0, 0.01  # of the free ellipse's radii: what is said of the model's
SIZE, STRAIN = 2, slice(3, 5)  # columns of the design, after the center's


def find_ellipse(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = True,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure from its lit limb.

    Parameters
    ----------
    name
        A sphere, a triaxial ellipsoid or a shape model of `picture.models`.
    circle
        An analyst's; None: predicted place and size.
    solve_range
        Solve for the range (the size in the picture) as well; given up where the picture tells the size less well than
        the mission file.
    search_radius_px
        How far from the expected place to look; None: anywhere.

    Returns
    -------
    BodyCenter
        Method ``ellipse``; `detail` is a `LimbEllipse`. Status ``ok`` where the likelihood of the pixels confirms the
        center; ``uncertain`` (see `flags` and `messages`); ``not_detected``, ``off_detector`` or ``failed`` without one.

    Raises
    ------
    CenterfindingError
        No such body in the picture.

    Notes
    -----
    The covariance holds the noise of the pixels, the roughness of the limb with its correlation along it, and what law,
    PSF, size and axes leave open; that of the range the uncertainty of the body's size as well.

    Examples
    --------
    A sphere of 60 px without noise, expected 3 px beside its place.

    >>> from opnav_workbench.targets import TargetState
    >>> from opnav_workbench.bodies import displaced_model, model_picture
    >>> from opnav_workbench.camera import Camera
    >>> from opnav_workbench.psf import GaussianPsf
    >>> from opnav_workbench.render import BodyModel
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> charon = TargetState("CHARON", [0, 0, 2.02e6], radii_km=[606.0] * 3, sun_position_km=[1e9, 1e9, -4e9])
    >>> empty = BodyPicture(np.zeros((1024, 1024)), 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                     (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> light = model_picture(empty, (0, 0, 1024, 1024), {"CHARON": [514.2, 510.3]})
    >>> seen = BodyPicture(1e3 / light.max() * light, 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                    (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> center = find_ellipse(seen, "CHARON")
    >>> center.status, center.pixel_line.round(1).tolist(), round(center.diameter_px)
    ('ok', [514.2, 510.3], 60)
    """
    diameter = picture.diameter_px(name)
    if 0.0 < diameter < LEAST_DIAMETER_PX:
        why = f"it is {diameter:.1f} px wide, too small for a limb (at least {LEAST_DIAMETER_PX:g} px); use 'disk'"
        return BodyCenter.without_center(name, METHOD, "failed", why)
    if circle is None and search_radius_px is None and _expected_outside(picture, name):
        return _off_detector(name, "its limb is expected off the detector")
    disk = measure_disk(picture, name, METHOD, circle, search_radius_px)
    if isinstance(disk, BodyCenter):
        return _none_there(picture, disk)
    try:
        stage, sized = _solved(disk, solve_range=solve_range)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, METHOD, "failed", str(error))
    if stage.motion is None or _missing_share(stage.points) > MOSTLY:
        return _no_limb(name, stage.points)
    center = judged_center(disk, _reading(disk, stage), _detail(disk, stage), solve_range=sized)
    return _told(center, stage, unsized=solve_range and not sized)


# ---- The outline through the limb points.


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Limb points about an outline, and what they say of it: None where they are too few."""

    shape: DiskShape
    outline: Outline
    points: LimbPoints
    motion: LimbMotion | None
    steps: tuple[tuple[float, float], ...] = ()
    converged: bool = False

    @property
    def overexposed(self) -> bool:
        """Whether points of saturated limb were taken."""
        return bool(np.any(self.points.saturated & self.points.usable))


def _solved(disk: MeasuredDisk, *, solve_range: bool) -> tuple[_Stage, bool]:
    """Return the last stage, and whether its size is that of the picture alone."""
    stage = _settled(disk, disk.fit.shape, sized=solve_range)
    told = stage.motion is not None and stage.motion.covariance[SIZE, SIZE] < disk.fit.figure.size_sigma**2
    if solve_range and not told:
        return _settled(disk, disk.fit.shape, sized=False), False
    return stage, solve_range


def _settled(disk: MeasuredDisk, shape: DiskShape, *, sized: bool) -> _Stage:
    """Repeat stages until the outline stands still."""
    steps: list[tuple[float, float]] = []
    for turn in range(MOST_STAGES):
        stage = _stage(disk, shape, sized=sized)
        if stage.motion is None:
            return replace(stage, steps=tuple(steps))
        radius = disk.radius_px
        scale = np.array([1.0, 1.0, radius, radius, radius])
        step = np.clip(stage.motion.motion[:5] * scale, -LARGEST_STEP * radius, LARGEST_STEP * radius)
        sigma = np.sqrt(np.diag(stage.motion.covariance)[:5]) * scale
        if np.all(np.abs(step) < np.maximum(STILL_PX, STILL_SIGMAS * sigma)):
            return replace(stage, steps=tuple(steps), converged=True)
        step = (1.0 if turn < EVEN_STAGES else 0.5) * step
        shape = _moved(shape, step / scale)
        steps.append((float(step[0]), float(step[1])))
    return replace(stage, steps=tuple(steps))


def _moved(shape: DiskShape, step: FloatArray) -> DiskShape:
    strain = shape.strain + np.append(step[STRAIN], np.zeros(len(shape.strain) - 2))
    center, log_size = shape.center_px + step[:2], shape.log_size + float(step[SIZE])
    return replace(shape, center_px=center, log_size=log_size, strain=strain)


def _stage(disk: MeasuredDisk, shape: DiskShape, *, sized: bool) -> _Stage:
    outline = disk.fit.made.outline(shape, rough=False)
    reach = NEAR_PX + NEAR_SIGMAS * (float(np.max(disk.picture.psf.sigma_px)) + disk.fit.prior.rough_px)
    points = find_limb_points(disk, outline, reach, saturated=False)
    if np.count_nonzero(points.saturated & points.seen) > MOSTLY * np.count_nonzero(points.seen):
        points = find_limb_points(disk, outline, reach, saturated=True)
    figure = disk.fit.figure
    size_sigma = np.inf if sized else figure.size_sigma
    nuisances = points.design.shape[1] - 5
    known = -np.array([0.0, 0.0, shape.log_size, *shape.strain[:2], *np.zeros(nuisances)])
    sigma = np.array([np.inf, np.inf, size_sigma, *(figure.axes_sigma,) * 2, *np.ones(nuisances)])
    motion = limb_motion(points.shift_px, points.sigma_px, points.design, points.usable, known, sigma)
    if motion is not None:
        points = points.with_outliers(motion.used, motion.residual_px)
    return _Stage(shape, outline, points, motion)


# ---- The result.


def _missing_share(points: LimbPoints) -> float:
    """Return the share of the model's lit limb, as far as it lies on the detector, that the picture does not show."""
    return float(points.missing.sum() / max(int((points.missing | points.usable).sum()), 1))


def _none_there(picture: BodyPicture, none: BodyCenter) -> BodyCenter:
    """Return why a body has no center: where nothing was found, it may be that nothing could be."""
    if none.status != "not_detected":
        return none
    if not np.any(np.isfinite(picture.signal_dn) & (~picture.bad | picture.saturated)):
        why = "no usable pixel"
        return BodyCenter.without_center(none.name, METHOD, "failed", why, flags=int(BodyFlag.EMPTY))
    return none


def _expected_outside(picture: BodyPicture, name: str) -> bool:
    """Whether no part of a body's limb is expected on the detector."""
    if picture.model(name).is_point:
        return False
    try:
        outline = Silhouette(picture, name).at(picture.center_px(name))
    except CenterfindingError:
        return True
    places = outline.points(outline.angle_rad)
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    return not np.any(np.all((places > -0.5) & (places < size - 0.5), axis=1))


def _off_detector(name: str, why: str) -> BodyCenter:
    return BodyCenter.without_center(name, METHOD, "off_detector", why, flags=int(BodyFlag.CUT_BY_EDGE))


def _no_limb(name: str, points: LimbPoints) -> BodyCenter:
    if not points.seen.any():
        why = "no lit limb lies on the detector"
        return BodyCenter.without_center(name, METHOD, "off_detector", why, flags=int(BodyFlag.CUT_BY_EDGE))
    reasons, counts = np.unique(points.reason[points.seen], return_counts=True)
    why = f"of {points.seen.sum()} pieces of lit limb too few show it; mostly: {reasons[counts.argmax()]}"
    return BodyCenter.without_center(name, METHOD, "not_detected", why, flags=int(BodyFlag.EMPTY))


def _reading(disk: MeasuredDisk, stage: _Stage) -> CenterReading:
    motion, fit = stage.motion, disk.fit
    assert motion is not None
    center = stage.shape.center_px + motion.motion[:2]
    saturated = SATURATED_PX**2 * np.eye(2) if stage.overexposed else np.zeros((2, 2))
    covariance = motion.covariance[:2, :2] + saturated
    second = second_reading(
        "the likelihood of the pixels", fit.center_px, fit.covariance_px2, center, covariance
    )
    missing, rough_limit = _missing_share(stage.points), max(ROUGH_PX, ROUGH_SHARE * disk.radius_px)
    poor = motion.rough_px > rough_limit or missing > MISSING_SHARE
    lacks = f"along {100.0 * missing:.0f} % of its model's lit limb there is none: the body has another shape"
    return CenterReading(
        method=METHOD,
        center_px=center,
        covariance_px2=covariance + difference_covariance(fit.center_px - center),
        noise_covariance_px2=motion.noise_covariance[:2, :2],
        log_size=stage.shape.log_size + float(motion.motion[SIZE]),
        log_size_sigma=float(np.sqrt(motion.covariance[SIZE, SIZE])),
        chi2_reduced=motion.chi2_reduced,
        converged=stage.converged,
        second=second,
        conditions={BodyFlag.POOR_FIT: poor},
        notes={BodyFlag.POOR_FIT: lacks} if missing > MISSING_SHARE else {},
    )


def _told(center: BodyCenter, stage: _Stage, *, unsized: bool) -> BodyCenter:
    """Return the center with what only its limb points tell."""
    detail = center.detail
    assert isinstance(detail, LimbEllipse)
    said = [*center.messages]
    if unsized:
        said.append("its range is not told: the picture tells its size less well than the mission file")
    if detail.rough_px > 0.0:
        worst = float(np.abs(detail.residual_px[stage.points.usable]).max())
        said.append(
            f"its limb leaves the model's by {detail.rough_px:.2f} px ({detail.rough_px * detail.km_per_px:.3g} km) rms, "
            f"{worst:.2f} px ({worst * detail.km_per_px:.3g} km) at most"
        )
    said += _said_of_radii(detail.free)
    flags = center.flags | (BodyFlag.SIZE_UNSOLVED if unsized else BodyFlag.OK)
    status = "uncertain" if stage.overexposed else center.status
    return replace(center, messages=tuple(said), flags=int(flags), status=status)


def _said_of_radii(free: FreeEllipse | None) -> list[str]:
    if free is None:
        return []
    off = np.abs(free.ratio - 1.0)
    wrong = off > np.maximum(RATIO_SIGMAS * free.ratio_sigma, RATIO_SHARE)
    return [
        f"along the {axis} axis of its ellipse its radius is {ratio:.4f} +- {sigma:.4f} of the model's: the ellipsoid is "
        "wrong there, or not all of it is solid limb"
        for axis, ratio, sigma, is_wrong in zip(
            ("long", "short"), free.ratio, free.ratio_sigma, wrong, strict=True
        )
        if is_wrong
    ]


def _detail(disk: MeasuredDisk, stage: _Stage) -> LimbEllipse:
    picture, points, motion = disk.picture, stage.points, stage.motion
    assert motion is not None
    used, n = points.usable, len(points.angle_rad)
    final = _moved(stage.shape, motion.motion[:5])
    about, model = disk.fit.made.outline(final, rough=False), picture.model(disk.name)
    observed = stage.outline.points(points.angle_rad) + points.shift_px[:, None] * points.normal
    length = float(TURN * disk.radius_px / n)
    arc = float(np.count_nonzero(used) * TURN / n)
    residual = np.where(np.isfinite(points.shift_px), motion.residual_px, np.nan)
    free = None
    if model.shape is None:  # of a shape model's outline an ellipse says nothing
        sigma = np.hypot(points.sigma_px, motion.rough_px)[used]
        plain = Silhouette(picture, disk.name).at(final.center_px, float(np.exp(-final.log_size)))
        free = _free(picture, observed[used], sigma, plain.points(plain.angle_rad), arc)
    return LimbEllipse(
        angle_rad=points.angle_rad,
        points_px=observed,
        predicted_px=about.points(points.angle_rad),
        normal=points.normal,
        residual_px=residual,
        sigma_px=points.sigma_px,
        height=points.height,
        status=points.status,
        reason=points.reason,
        outline_px=about.points(about.angle_rad),
        rms_px=float(np.sqrt(np.mean(residual[used] ** 2))),
        rough_px=motion.rough_px,
        rough_arc_px=motion.rough_length * length,
        lit_arc_rad=arc,
        covariance=motion.covariance[:3, :3] * np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0]),
        km_per_px=model.target.range_km * float(np.exp(-final.log_size)) * picture.camera.pixel_scale_rad,
        free=free,
        iterations=stage.steps,
    )


def _free(
    picture: BodyPicture, points: FloatArray, sigma: FloatArray, outline: FloatArray, arc: float
) -> FreeEllipse | None:
    straight = pinhole_px(picture.camera, points)
    good = np.isfinite(straight).all(axis=1)
    return compare_ellipses(straight[good], sigma[good], pinhole_px(picture.camera, outline), arc)
