"""Bodies of a planned picture: size, phase, light, and how well a target's center will be known.

Flow   models -> rendered light and its derivatives with the place -> information of the pixels on center, brightness and
       background level -> covariance of the center -> with the attitude: of the target's direction
Units  px, arcsec, km

The bound is that of a body whose looks are known. Where the albedo is not, a limb is worth less than its bound.
Beside the targets, everything may enter the field whose position the open kernels know.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies import choose_method
from opnav_workbench.camera import Camera
from opnav_workbench.camera.model import sky_jacobian
from opnav_workbench.constants import ARCSEC_PER_RAD, LAST_BARYCENTER_ID
from opnav_workbench.errors import OpNavError
from opnav_workbench.kernels import KernelSet, body_id, body_name
from opnav_workbench.photometry import SUN_B_V
from opnav_workbench.planning.attitude import PointingPlan
from opnav_workbench.planning.light import ExpectedLight, star_psf
from opnav_workbench.planning.opened_sequence import OpenedSequence
from opnav_workbench.render import RenderedBody
from opnav_workbench.render.focal_plane import render_moving
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.simulation import PictureInputs

__all__ = [
    "BodyLight",
    "OtherBody",
    "TargetPlan",
    "body_light",
    "center_bound",
    "natural_bodies",
    "other_bodies",
    "plan_target",
    "v_magnitude",
]


# ---- Bodies of a planned picture: size, phase, light, and how well a target's center will be known.

MARGIN_SIGMAS, MARGIN_PX = 5.0, 4.0  # of light about the body that tells the background
PEAK_NEAR = 0.9  # of saturation; noise takes some pixels over it
ANY_LIGHT_E = 1e-3
POINT_PX = 1.0  # below, a body is measured as a star is


@dataclass(frozen=True, slots=True, eq=False)
class BodyLight:
    """One body's light in a window about it; arrays are [line, pixel].

    Attributes
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines; all on the detector.
    slopes : (2, n_line, n_pixel) array
        Electrons per px of motion along pixel and line.
    """

    window: tuple[int, int, int, int]
    electrons: FloatArray
    slopes: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def cut(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the window of a plane of the whole detector."""
        pixel, line, width, height = self.window
        return plane[line : line + height, pixel : pixel + width]


@dataclass(frozen=True, slots=True, eq=False)
class TargetPlan:
    """What a picture is expected to tell of a target.

    Attributes
    ----------
    prediction
        Place, diameter, phase, range, limb.
    mag
        V; where the light comes from albedo, that of a body of the Sun's color with this flux.
    flux_dn, peak_dn
        Of the body, and in its brightest pixel with all that lies below it.
    snr
        Brightness over its sigma; 0 without light on the detector.
    saturated
        Share of its pixels that are saturated (the brightest pixel's for a point).
    occulted
        Share of its disk behind other bodies.
    center_covariance_px2 : (2, 2) array or None
        From the noise of its own pixels: the scatter of measured centers.
    covariance_px2 : (2, 2) array or None
        With the attitude's: the scatter of observed minus predicted.
    sigma_arcsec : (2,) array
        Of its direction in RA (times cos Dec) and Dec; nan without pointing.
    sigma_km
        The larger axis of that error at the target's distance.
    """

    name: str
    prediction: BodyPrediction
    mag: float
    flux_dn: float
    peak_dn: float
    snr: float
    saturated: float
    occulted: float
    center_covariance_px2: FloatArray | None
    covariance_px2: FloatArray | None
    sigma_arcsec: FloatArray
    sigma_km: float
    km_per_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def method(self) -> str:
        """The method that processing takes for a body of this size whose albedo is not known."""
        return choose_method(self.prediction.diameter_px)

    @property
    def center_sigma_px(self) -> FloatArray:
        """Of its measured center along pixel and line (2,); nan where there is none."""
        return _sigmas(self.center_covariance_px2)

    @property
    def sigma_px(self) -> FloatArray:
        """The same with the pointing's error."""
        return _sigmas(self.covariance_px2)


def _sigmas(covariance: FloatArray | None) -> FloatArray:
    return np.full(2, np.nan) if covariance is None else np.sqrt(np.diag(covariance))


def plan_target(light: ExpectedLight, index: int, pointing: PointingPlan | None) -> TargetPlan:
    """Return what a picture tells of the body with this index among its models."""
    inputs = light.inputs
    target, body = inputs.bodies[index].target, light.picture.rendering.bodies[index]
    prediction = predict_body(target, inputs.observer, inputs.camera, inputs.path.middle)
    seen = body_light(light, index)
    center, snr, peak, saturated = None, 0.0, float("nan"), 0.0
    if seen is not None:
        center, snr = center_bound(light, seen)
        level = light.picture.exposure.image_dn
        lit = seen.electrons > 0.1 * seen.electrons.max(initial=0.0)
        peak = float(seen.cut(level)[lit].max(initial=0.0))
        saturated = float(seen.cut(light.saturated.astype(float))[lit].mean()) if lit.any() else 0.0
        if saturated > 0.0 and not prediction.diameter_px > POINT_PX:
            center = None  # no center is taken from a saturated point
    flux = body.flux_e / light.values.gain_e_per_dn
    covariance, sky = _with_pointing(inputs.camera, inputs.path.middle, prediction, center, pointing)
    return TargetPlan(
        name=target.name,
        prediction=prediction,
        mag=v_magnitude(inputs.camera, flux, inputs.exposure_s)
        if target.magnitude is None
        else target.magnitude,
        flux_dn=flux,
        peak_dn=peak,
        snr=snr,
        saturated=saturated,
        occulted=body.occulted_fraction,
        center_covariance_px2=center,
        covariance_px2=covariance,
        sigma_arcsec=np.full(2, np.nan) if sky is None else np.sqrt(np.diag(sky)) * ARCSEC_PER_RAD,
        sigma_km=np.nan if sky is None else float(np.sqrt(np.linalg.eigvalsh(sky)[-1])) * prediction.range_km,
        km_per_px=inputs.camera.pixel_scale_rad * prediction.range_km,
    )


def v_magnitude(camera: Camera, flux_dn: float, exposure_s: float) -> float:
    """Return V of a body of the Sun's color from its flux; nan without light."""
    if not flux_dn > 0.0:
        return float("nan")
    in_band = camera.require("zero_point_mag") - 2.5 * float(np.log10(flux_dn / exposure_s))
    return in_band - float(camera.color.offset(SUN_B_V))


def body_light(light: ExpectedLight, index: int) -> BodyLight | None:
    """Return a body's light and its derivatives; None where none falls on the detector."""
    inputs = light.inputs
    body = light.picture.rendering.bodies[index]
    window = _window(inputs.camera, body, float(star_psf(inputs).sigma_px.max()))
    if window is None:
        return None
    moving = render_moving(
        [inputs.bodies[index]],
        inputs.camera,
        inputs.path.middle,
        inputs.observer.velocity_km_s,
        psf=star_psf(inputs),
        sunlight_e=inputs.camera.sunlight_e(inputs.exposure_s),
        window=window,
    )[0]
    if moving.electrons.max(initial=0.0) < ANY_LIGHT_E:
        return None
    return BodyLight(window, moving.electrons, moving.slopes)


def _window(camera: Camera, body: RenderedBody, sigma_px: float) -> tuple[int, int, int, int] | None:
    if not np.isfinite(body.center_px).all():
        return None
    half = 0.5 * np.nan_to_num(body.diameter_px) + MARGIN_SIGMAS * sigma_px + MARGIN_PX
    first = np.maximum(np.ceil(body.center_px - half), 0.0)
    last = np.minimum(np.floor(body.center_px + half), [camera.n_pixel - 1, camera.n_line - 1])
    if np.any(last - first < 1.0):
        return None
    (pixel, line), (width, height) = first.astype(int), (last - first).astype(int) + 1
    return int(pixel), int(line), int(width), int(height)


def center_bound(
    light: ExpectedLight, seen: BodyLight, scale: float = 1.0, expected_e: FloatArray | None = None
) -> tuple[FloatArray, float]:
    """Return the Cramer-Rao bound of a body's center (2, 2), px^2, and its signal-to-noise ratio.

    Free are center, brightness and background level; pixels that are saturated tell nothing.

    Parameters
    ----------
    scale
        Light of the body over that of `seen`.
    expected_e
        Mean electrons in the window, all light, in place of those of `light`.
    """
    gain = light.values.gain_e_per_dn
    mean = seen.cut(light.expected_e) if expected_e is None else expected_e
    weight = np.where(seen.cut(light.saturated), 0.0, 1.0) if expected_e is None else np.ones(mean.shape)
    weight = weight / light.variance_dn2(mean)
    level = np.ones_like(mean)
    columns = np.stack([*(scale * seen.slopes / gain), scale * seen.electrons / gain, level]).reshape(4, -1)
    size = np.sqrt((columns**2 * weight.ravel()).sum(axis=1))
    size = np.where(size > 0.0, size, 1.0)
    scaled = columns / size[:, None]
    covariance = np.linalg.pinv((scaled * weight.ravel()) @ scaled.T, hermitian=True) / np.outer(size, size)
    return covariance[:2, :2], float(1.0 / np.sqrt(covariance[2, 2]))


def _with_pointing(
    camera: Camera,
    attitude: FloatArray,
    prediction: BodyPrediction,
    center_px2: FloatArray | None,
    pointing: PointingPlan | None,
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return covariances of observed minus predicted: px^2, and rad^2 toward east and north."""
    if center_px2 is None or pointing is None:
        return None, None
    by_attitude = camera.attitude_jacobian(attitude @ prediction.direction)
    covariance = center_px2 + by_attitude @ pointing.covariance_rad2 @ by_attitude.T
    jacobian = sky_jacobian(camera, attitude, prediction.pixel_line)
    return covariance, jacobian @ covariance @ jacobian.T


# ---- Bodies that enter the field beside the targets: everything whose position the open kernels know.


@dataclass(frozen=True, slots=True)
class OtherBody:
    """A body in the field that is no target.

    Attributes
    ----------
    pixel, line
        Its center, perhaps just off the detector.
    diameter_px
        0 where its size is not known.
    mag
        V where the mission file knows it, else nan.
    drawn
        Its light is part of the prediction.
    """

    name: str
    pixel: float
    line: float
    diameter_px: float
    mag: float
    drawn: bool


def natural_bodies() -> tuple[str, ...]:
    """Return the names of the bodies, no spacecraft and no barycenters, that the active kernels have positions of."""
    active = KernelSet.active()
    numbers = [] if active is None else [cover.body for cover in active.coverage("SPK")]
    return tuple(body_name(number) for number in sorted(set(numbers)) if number > LAST_BARYCENTER_ID)


def other_bodies(
    opened: OpenedSequence,
    inputs: PictureInputs,
    names: Sequence[str],
    targets: Sequence[str],
    drawn: Sequence[str],
) -> tuple[OtherBody, ...]:
    """Return the bodies of `names` that are in the field, or whose disk reaches into it, and are no targets."""
    camera, attitude = inputs.camera, inputs.path.middle
    own, shown = ({body_id(name) for name in group} for group in (targets, drawn))
    found = []
    for name in names:
        if body_id(name) in own:
            continue
        try:
            state = opened.mission.with_magnitude(opened.target(name, inputs.et))
        except OpNavError:  # the kernels do not have it then
            continue
        seen = predict_body(state, inputs.observer, camera, attitude)
        size = float(np.nan_to_num(seen.diameter_px))
        if not camera.on_detector(seen.pixel_line, 0.5 * size):
            continue
        mag = np.nan if state.magnitude is None else state.magnitude
        pixel, line = (float(p) for p in seen.pixel_line)
        found.append(OtherBody(name, pixel, line, size, mag, body_id(name) in shown))
    return tuple(found)
