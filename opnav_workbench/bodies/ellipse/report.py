"""From the last stage of a limb fit to a `BodyCenter`: covariances, flags, status and what the analyst must know."""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.ellipse.limb_points import EdgeFit, LimbPieces, LimbSelection, missing_share
from opnav_workbench.bodies.ellipse.point_fits import LimbMotion, compare_ellipses, pinhole_px
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import (
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    FreeEllipse,
    LimbEllipse,
    describe_body_flags,
    flags_where,
)
from opnav_workbench.bodies.silhouette import Outline

__all__ = ["METHOD", "LimbStage", "limb_center"]

METHOD = "ellipse"
WEAK_ARC_RAD = np.radians(60.0)
WEAK_SIGMA_PX, WEAK_SHARE = 0.5, 0.005  # at least so much, and this share of the radius
WEAK_RATIO = 8.0  # of the axes of the error ellipse
ROUGH_SHARE = 0.02  # of the radius: a limb rougher than this is not that of the model, and
ROUGH_PX = 0.5  # at least so much
MISSING_SHARE = 0.05  # of the limb that should be in sight; with more of it missing the shape is another
BETTER_SHARE = 0.4  # of the residuals: a free ellipse that leaves less tells of wrong radii

MISFIT_SHARE = 0.15  # a diameter this far from the expected one was not expected
RATIO_SIGMAS, RATIO_SHARE = 3.0, 0.01  # of the free ellipse's radii: what is said of the model's
THIN_SIGMAS = 1.0  # a crescent thinner than this many sigmas of the PSF is a line
DOUBTFUL_LIMB_FLAGS = (
    BodyFlag.POOR_FIT | BodyFlag.CIRCLE_MISFIT | BodyFlag.WEAK_GEOMETRY | BodyFlag.NOT_CONVERGED
    | BodyFlag.AT_LIMIT
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LimbStage:
    """One pass of a limb fit: the body rendered at a place, and what its limb says of that place.

    Attributes
    ----------
    window : (int, int, int, int)
    model_dn : (n_line, n_pixel) array
    motion
        None: too few pieces.
    """

    outline: Outline
    range_scale: float
    window: tuple[int, int, int, int]
    model_dn: FloatArray
    pieces: LimbPieces
    edges: EdgeFit
    selection: LimbSelection
    motion: LimbMotion | None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def limb_center(
    picture: BodyPicture,
    name: str,
    stage: LimbStage,
    circle: Circle | None,
    iterations: tuple[tuple[float, float], ...],
    *,
    converged: bool,
    asked_range: bool,
    solved_range: bool,
) -> BodyCenter:
    """Make the result of the last stage; its motion is small and still to be applied."""
    motion = stage.motion
    assert motion is not None
    detail = _detail(picture, name, stage, motion, iterations)
    diameter = stage.outline.diameter_px * float(np.exp(-motion.motion[2]))
    flags = _flags(picture, name, stage, motion, detail, diameter, circle)
    flags |= BodyFlag.OK if converged else BodyFlag.NOT_CONVERGED
    flags |= BodyFlag.SIZE_UNSOLVED if asked_range and not solved_range else BodyFlag.OK
    missing, expected = missing_share(stage.selection), _expected(picture, name, circle)
    excess = picture.excess_sigma_px**2 * np.eye(2)
    center = BodyCenter(
        name=name,
        method=METHOD,
        status="uncertain" if flags & DOUBTFUL_LIMB_FLAGS else "ok",
        pixel_line=stage.outline.center_px + motion.motion[:2],
        covariance_px2=motion.covariance[:2, :2] + excess,
        messages=tuple(_messages(flags, missing, detail, diameter, expected)),
        flags=int(flags),
        noise_covariance_px2=motion.noise_covariance[:2, :2] + excess,
        chi2_reduced=motion.chi2_reduced,
        detail=detail,
    )
    center = _with_brightness(center, picture, stage)
    return _with_size(center, picture, stage, motion, diameter) if solved_range else center


def _with_brightness(center: BodyCenter, picture: BodyPicture, stage: LimbStage) -> BodyCenter:
    height, sigma = _mean_height(stage)
    return replace(
        center,
        flux_dn=height * float(stage.model_dn.sum()),
        snr=height / sigma,
        brightness_scale=height,
        brightness_scale_sigma=sigma,
        background_dn=float(np.median(stage.edges.background_dn[stage.selection.usable])),
        pictures=_pictures(picture, stage, height),
    )


def _with_size(
    center: BodyCenter, picture: BodyPicture, stage: LimbStage, motion: LimbMotion, diameter: float
) -> BodyCenter:
    sigma = float(np.sqrt(motion.covariance[2, 2]))  # of the logarithm of the range
    scale = stage.range_scale * float(np.exp(motion.motion[2]))
    range_km = picture.model(center.name).target.range_km * scale
    return replace(
        center,
        diameter_px=diameter,
        diameter_sigma_px=diameter * sigma,
        range_km=range_km,
        range_sigma_km=range_km * sigma,
    )


def _mean_height(stage: LimbStage) -> tuple[float, float]:
    used = stage.selection.usable
    weight = stage.edges.height_sigma[used] ** -2.0
    return float(weight @ stage.edges.height[used] / weight.sum()), float(weight.sum() ** -0.5)


def _detail(
    picture: BodyPicture,
    name: str,
    stage: LimbStage,
    motion: LimbMotion,
    iterations: tuple[tuple[float, float], ...],
) -> LimbEllipse:
    pieces, selection, outline = stage.pieces, stage.selection, stage.outline
    move = motion.motion

    def moved(points: FloatArray) -> FloatArray:
        return np.asarray(outline.center_px + move[:2] + (points - outline.center_px) * np.exp(-move[2]))

    observed = pieces.point_px + stage.edges.shift_px[:, None] * pieces.normal
    around = moved(outline.points(outline.angle_rad))
    used = selection.usable
    sigma = np.hypot(stage.edges.sigma_px, motion.rough_px)
    arc = float(_arc_rad(pieces.angle_rad, used))
    model = picture.model(name)
    # Of a shape model's outline an ellipse says nothing.
    free = None if model.shape is not None else _free(picture, observed[used], sigma[used], around, arc)
    km_per_px = model.target.range_km * stage.range_scale * picture.camera.pixel_scale_rad
    return LimbEllipse(
        angle_rad=pieces.angle_rad,
        points_px=observed,
        predicted_px=moved(pieces.point_px),
        normal=pieces.normal,
        residual_px=motion.residual_px,
        sigma_px=stage.edges.sigma_px,
        height=stage.edges.height,
        status=selection.status,
        reason=selection.reason,
        outline_px=around,
        rms_px=float(np.sqrt(np.mean(motion.residual_px[used] ** 2))),
        rough_px=motion.rough_px,
        rough_arc_px=motion.rough_length * pieces.length_px,
        lit_arc_rad=arc,
        covariance=motion.covariance,
        km_per_px=km_per_px,
        free=free,
        iterations=iterations,
    )


def _free(
    picture: BodyPicture, points: FloatArray, sigma: FloatArray, outline: FloatArray, arc: float
) -> FreeEllipse | None:
    straight = pinhole_px(picture.camera, points)
    good = np.isfinite(straight).all(axis=1)
    return compare_ellipses(straight[good], sigma[good], pinhole_px(picture.camera, outline), arc)


def _arc_rad(angle: FloatArray, used: BoolArray) -> float:
    """Return the angle that the used ones of evenly spread pieces cover."""
    edges = np.sort(np.concatenate([angle, [angle[0] + 2.0 * np.pi]]))
    return float(np.sum(np.diff(edges)[used[np.argsort(angle)]]))


def _expected(picture: BodyPicture, name: str, circle: Circle | None) -> tuple[float, ...]:
    """Return the diameters that were expected, px."""
    predicted = picture.diameter_px(name)
    return (predicted,) if circle is None else (predicted, circle.diameter_px)


def _flags(
    picture: BodyPicture,
    name: str,
    stage: LimbStage,
    motion: LimbMotion,
    detail: LimbEllipse,
    diameter: float,
    circle: Circle | None,
) -> BodyFlag:
    values = np.linalg.eigvalsh(motion.covariance[:2, :2])
    sigma_min, sigma_max = np.sqrt(np.maximum(values, 0.0))
    thickness = 0.5 * diameter * (1.0 + np.cos(picture.phase_rad(name)))
    rough_limit = max(ROUGH_PX, ROUGH_SHARE * 0.5 * diameter)
    ratios = [diameter / expected for expected in _expected(picture, name, circle)]
    reasons = {
        BodyFlag.CUT_BY_EDGE: not stage.pieces.complete.all(),
        BodyFlag.OVEREXPOSED: stage.selection.saturated.any(),
        BodyFlag.OCCULTED: stage.selection.hidden.any(),
        BodyFlag.BAD_PIXELS: stage.edges.n_bad.any(),
        BodyFlag.THIN_CRESCENT: thickness < THIN_SIGMAS * float(np.max(picture.psf.sigma_px)),
        BodyFlag.POOR_FIT: detail.rough_px > rough_limit
        or missing_share(stage.selection) > MISSING_SHARE
        or _another_ellipse(detail),
        BodyFlag.CIRCLE_MISFIT: any(max(r, 1.0 / r) > 1.0 + MISFIT_SHARE for r in ratios),
        BodyFlag.WEAK_GEOMETRY: sigma_max > max(WEAK_SIGMA_PX, WEAK_SHARE * 0.5 * diameter)
        or (detail.lit_arc_rad < WEAK_ARC_RAD and sigma_max > WEAK_RATIO * sigma_min),
    }
    return flags_where(reasons)


def _messages(
    flags: BodyFlag, missing: float, detail: LimbEllipse, diameter: float, expected: tuple[float, ...]
) -> list[str]:
    said = [describe_body_flags(int(flags))] if flags else []
    if flags & BodyFlag.CIRCLE_MISFIT:
        wanted = " and ".join(f"{e:.1f}" for e in expected)
        said.append(
            f"its diameter is {diameter:.1f} px, expected {wanted} px; check the radii, the range or the circle"
        )
    if missing > MISSING_SHARE:
        said.append(
            f"along {100.0 * missing:.0f} % of its model's lit limb there is none: the body has another shape, and "
            "its center is that of the model laid against the limb in sight"
        )
    if detail.rough_px > 0.0:
        used = detail.status == "used"
        worst = float(np.abs(detail.residual_px[used]).max())
        said.append(
            f"its limb leaves the model's by {detail.rough_px:.2f} px ({detail.rough_px * detail.km_per_px:.3g} km) rms, "
            f"{worst:.2f} px ({worst * detail.km_per_px:.3g} km) at most"
        )
    return said + _said_of_radii(detail)


def _another_ellipse(detail: LimbEllipse) -> bool:
    """Whether an ellipse of other axes fits the limb, and the model's does not."""
    free = detail.free
    return free is not None and detail.rough_px > 0.0 and free.residual_rms_px < BETTER_SHARE * detail.rms_px


def _said_of_radii(detail: LimbEllipse) -> list[str]:
    free = detail.free
    if free is None:
        return []
    said = []
    if _another_ellipse(detail):
        (major, minor), (a, b) = free.ellipse.semi_axes, free.model.semi_axes
        said.append(
            f"its limb is an ellipse, but another one: {major:.1f} x {minor:.1f} px toward "
            f"{np.degrees(free.ellipse.angle_rad):.0f} deg, not {a:.1f} x {b:.1f} px toward "
            f"{np.degrees(free.model.angle_rad):.0f} deg; the radii or the pole of the ellipsoid are wrong"
        )
    for axis, ratio, sigma in zip(("long", "short"), free.ratio, free.ratio_sigma, strict=True):
        off = abs(float(ratio) - 1.0)
        if off > RATIO_SIGMAS * float(sigma) and off > RATIO_SHARE:
            said.append(
                f"along the {axis} axis of its ellipse its radius is {ratio:.4f} +- {sigma:.4f} of the model's: "
                "the ellipsoid is wrong there, or not all of it is solid limb"
            )
    return said


def _pictures(picture: BodyPicture, stage: LimbStage, height: float) -> BodyResiduals:
    pixel, line, n_pixel, n_line = stage.window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    data, model = picture.signal_dn[part], height * stage.model_dn
    mask = np.zeros(data.shape, dtype=bool)
    used = stage.selection.usable[stage.pieces.piece]
    mask[stage.pieces.line[used] - line, stage.pieces.pixel[used] - pixel] = True
    mask &= ~(picture.bad[part] | picture.saturated[part])
    return BodyResiduals(stage.window, data, model, data - model, mask)
