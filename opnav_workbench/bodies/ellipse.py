"""Center of a body from its limb: sub-pixel limb points all along it, and the conic of its ellipsoid (or silhouette).

Flow   measured disk -> scans across all of its lit limb, each a limb point (`opnav_workbench.bodies.limb_scan.scanning`) ->
       outline by least squares -> judgement (`opnav_workbench.bodies.judgement`); a free ellipse through the points, to
       check the radii with
Frame  (pixel, line), 0-based, integer = pixel center
Units  px, km, DN

Source  Owen (2011), AAS 11-215 (limbs)
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.bodies.disk.measurement import measure_disk
from opnav_workbench.bodies.free_ellipse import compare_ellipses, pinhole_px
from opnav_workbench.bodies.judgement import judged_center
from opnav_workbench.bodies.limb_scan.fan import N_SCANS
from opnav_workbench.bodies.limb_scan.scanning import (
    ScannedLimb,
    scan_limb,
    scan_reading,
    undetermined_center,
)
from opnav_workbench.bodies.limb_scan.selection import ScanSelection
from opnav_workbench.bodies.limb_scan.view import LOOK, OUTLINE
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, FreeEllipse, LimbEllipse
from opnav_workbench.bodies.silhouette import TURN
from opnav_workbench.threads import one_thread

__all__ = ["find_ellipse"]

METHOD = "ellipse"
LEAST_DIAMETER_PX = 3.0
RATIO_SIGMAS, RATIO_SHARE = 3.0, 0.01  # of the free ellipse's radii: what is said of the model's


@one_thread()
def find_ellipse(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = True,
    search_radius_px: float | None = None,
    quick: bool = False,
) -> BodyCenter:
    """Find a body's center of figure from its lit limb.

    Parameters and errors as of `opnav_workbench.bodies.find_disk`.

    Returns
    -------
    BodyCenter
        Method ``ellipse``; `detail` is a `LimbEllipse`. Status ``ok`` where the likelihood of the whole disk and the
        crossings of the limb confirm the center; ``uncertain`` (see `flags` and `messages`); ``not_detected``,
        ``off_detector``, ``saturated`` or ``failed`` without a center.

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
    >>> charon = TargetState("CHARON", [0, 0, 2.02e6], radii_km=[606.0] * 3, sun_position_km=[4e9, 1e9, 0])
    >>> empty = BodyPicture(np.zeros((1024, 1024)), 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                     (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> light = model_picture(empty, (0, 0, 1024, 1024), {"CHARON": [514.2, 510.3]})
    >>> seen = BodyPicture(1e4 / light.max() * light, 1.0, False, False, camera, np.eye(3), np.zeros(3),
    ...                    (BodyModel(charon),), GaussianPsf(0.8, 0.8))
    >>> center = find_ellipse(seen, "CHARON")
    >>> center.status, center.pixel_line.round(1).tolist(), round(center.diameter_px)
    ('ok', [514.2, 510.3], 60)
    """
    diameter = picture.diameter_px(name)
    if 0.0 < diameter < LEAST_DIAMETER_PX:
        why = f"it is {diameter:.1f} px wide, too small for a limb (at least {LEAST_DIAMETER_PX:g} px); use 'auto'"
        return BodyCenter.without_center(name, METHOD, "failed", why)
    disk = measure_disk(picture, name, METHOD, circle, search_radius_px, quick=quick)
    if isinstance(disk, BodyCenter):
        return disk
    run = scan_limb(disk, N_SCANS, uneven=True)
    if isinstance(run, ScanSelection):
        return undetermined_center(disk, METHOD, run)
    detail = _detail(run)
    center = judged_center(disk, scan_reading(run, METHOD), detail, solve_range=solve_range)
    return replace(center, messages=(*center.messages, *_said_of_radii(detail.free)))


def _detail(run: ScannedLimb) -> LimbEllipse:
    fan, solved, disk = run.view.fan, run.solved, run.disk
    direction = np.stack([np.cos(fan.angle_rad), np.sin(fan.angle_rad)], axis=-1)
    seen = np.where(np.isfinite(run.choice.edge_px), run.match.offset_px, np.nan)
    observed = fan.center_px + (fan.limb_px + seen)[:, None] * direction
    outline = disk.fit.made.outline(run.solved_shape, rough=False)
    around = outline.points(outline.angle_rad)
    used = solved.used
    status, reason = run.statuses()
    arc = float(used.mean()) * TURN
    model = disk.picture.model(disk.name)
    # Of a shape model's outline an ellipse says nothing.
    free = None if model.shape is not None else _free(run, observed, around, arc)
    return LimbEllipse(
        angle_rad=fan.angle_rad,
        points_px=observed,
        predicted_px=observed - solved.residual_px[:, None] * direction,
        residual_px=solved.residual_px,
        sigma_px=run.sigma_px,
        brightness=run.match.brightness,
        status=status,
        reason=reason,
        outline_px=around,
        rms_px=float(np.sqrt(np.mean(solved.residual_px[used] ** 2))),
        rough_px=disk.fit.prior.rough_px,
        lit_arc_rad=arc,
        km_per_px=model.target.range_km * disk.picture.camera.pixel_scale_rad,
        free=free,
        iterations=run.steps,
    )


def _free(run: ScannedLimb, observed: FloatArray, outline: FloatArray, arc_rad: float) -> FreeEllipse | None:
    camera, used = run.disk.picture.camera, run.solved.used
    straight = pinhole_px(camera, observed[used])
    good = np.isfinite(straight).all(axis=1)
    rows = np.flatnonzero(used)[good]
    # Law and PSF move all points in common.
    look = run.match.common[rows, len(OUTLINE) :]
    shared = look @ run.disk.fit.solution.covariance[np.ix_(LOOK, LOOK)] @ look.T
    covariance = symmetric(run.solved.offset_covariance[np.ix_(rows, rows)] + shared)
    return compare_ellipses(straight[good], covariance, pinhole_px(camera, outline), arc_rad)


def _said_of_radii(free: FreeEllipse | None) -> list[str]:
    """Return which radii of the model the free ellipse does not have."""
    said = []
    if free is not None:
        for axis, ratio, sigma in zip(("long", "short"), free.ratio, free.ratio_sigma, strict=True):
            off = abs(float(ratio) - 1.0)
            if off > RATIO_SIGMAS * float(sigma) and off > RATIO_SHARE:
                said.append(
                    f"along the {axis} axis of its ellipse its radius is {ratio:.4f} +- {sigma:.4f} of the model's"
                )
    return said
