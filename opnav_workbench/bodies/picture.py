"""The picture that a body is measured in, with its noise, its camera and its scene, and the bodies rendered in it.

Flow   `BodyPicture` (or `picture_from_circle`, where there are neither kernels nor an attitude) -> body moved to a trial
       place -> its light over a window
Frame  J2000; (pixel, line) on the detector. In a picture made from an analyst's circle the camera's own frame stands for
       J2000, and the observer for one at rest: centers (px) and ranges mean what they say, right ascensions do not
Units  DN above the background, km, px
"""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.image import estimate_background
from opnav_workbench.psf import GaussianPsf, Psf
from opnav_workbench.render import BodyModel, LunarLambert, ScatteringLaw, ShapeModel, render_bodies
from opnav_workbench.scene import AssistedBody, BodyPrediction, Observer, assisted_target, predict_body
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

__all__ = [
    "MEASURED_PSF_SIGMA",
    "BodyPicture",
    "Circle",
    "RayFan",
    "displaced_model",
    "model_picture",
    "picture_from_circle",
    "pixel_rays",
    "placed_models",
    "sized_target",
    "standing_at",
    "stated_psf_sigma",
    "sunlight_electrons",
]


# ---- Where a body is expected in the picture, and how large: an analyst's circle or the a priori one.


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle on the detector.

    Attributes
    ----------
    center_px : (2,) array
        (pixel, line); it may lie off the detector.

    Raises
    ------
    CenterfindingError
        A center that is not two finite numbers, or a radius that is not positive.

    Examples
    --------
    >>> Circle([511.5, 480.0], 95.0).diameter_px
    190.0
    """

    center_px: FloatArray
    radius_px: float

    def __post_init__(self) -> None:
        center = np.array(self.center_px, dtype=np.float64)
        if center.shape != (2,) or not np.isfinite(center).all():
            raise CenterfindingError(f"circle center is {center.tolist()}; give (pixel, line), finite.")
        if not 0.0 < self.radius_px < np.inf:
            raise CenterfindingError(f"circle radius is {self.radius_px} px; give a positive number.")
        object.__setattr__(self, "center_px", center)
        object.__setattr__(self, "radius_px", float(self.radius_px))
        freeze_arrays(self)

    @property
    def diameter_px(self) -> float:
        """Twice the radius."""
        return 2.0 * self.radius_px


# ---- Everything that finding a body in a picture needs.

MEASURED_PSF_SIGMA = 0.15


def stated_psf_sigma(camera: Camera) -> float:
    """Return the relative uncertainty of the width that a camera file states, where no star has measured it."""
    return max(camera.psf.relative_sigma, MEASURED_PSF_SIGMA)


NOISE_PIXELS = 4096  # that tell what is typical
LOWEST_CUT = 0.1  # of the saturated pixels lie lower than the level: the picture's background is off them


@dataclass(frozen=True, slots=True, eq=False)
class BodyPicture:
    """A picture, and what is expected in it.

    Attributes
    ----------
    signal_dn : (n_line, n_pixel) array
        Picture with its background removed; pixels that are not finite count as bad.
    noise_dn : (n_line, n_pixel) array
        Noise of each pixel without the bodies' own shot noise, which `noise_model` adds.
    bad, saturated : (n_line, n_pixel) arrays of bool
        Pixels to leave out.
    spilled : (n_line, n_pixel) array of bool
        Bad ones that charge of overexposed pixels hides; None: none.
    camera_from_j2000 : (3, 3) array
        The attitude, solved or a priori.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter, J2000.
    models
        Every body of the scene where it is expected; they hide and shade each other.
    found
        Names of those that stand where they were found: an error of the prediction that others share is not theirs.
    sunlight_e
        Electrons of the Sun at 1 au as a point, see `opnav_workbench.render.render_bodies`; None where the camera's
        response is not known, and brightnesses are then relative.
    noise_model
        Its gain turns light into shot noise.
    excess_sigma_px
        Centering error of the frame's stars beyond their covariances; a body suffers it too.
    psf_width_sigma
        Relative uncertainty of the PSF's width; by default that of one calibrated, or measured on the frame's stars, whose
        colors are not the body's.
    stars_px : (n, 2) array
        Where the picture's stars stand, all that are bright in it; None: it is not known which of its lights are stars, and
        a body as small as a star's image is then looked for near its expected place only.
    stars_known_dn
        Light (DN, of all its pixels) from which on every star is among them; fainter ones are in no catalog.

    Raises
    ------
    CenterfindingError
        Arrays of different shapes, two bodies of one name.
    """

    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    saturated: BoolArray
    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    models: tuple[BodyModel, ...]
    psf: Psf
    sunlight_e: float | None = None
    noise_model: NoiseModel | None = None
    excess_sigma_px: float = 0.0
    psf_width_sigma: float = MEASURED_PSF_SIGMA
    found: frozenset[str] = frozenset()
    spilled: BoolArray | None = None
    stars_px: FloatArray | None = None
    stars_known_dn: float = 0.0

    def __post_init__(self) -> None:
        signal = np.asarray(self.signal_dn, dtype=np.float64)
        shape = (self.camera.n_line, self.camera.n_pixel)
        if signal.shape != shape:
            raise CenterfindingError(
                f"the picture has shape {signal.shape}, its camera {self.camera.name} {shape} (lines, pixels)."
            )
        for field in ("noise_dn", "bad", "saturated"):
            kind = np.float64 if field == "noise_dn" else np.bool_
            try:
                plane: Any = np.broadcast_to(np.asarray(getattr(self, field), dtype=kind), shape)
            except ValueError as error:
                raise CenterfindingError(
                    f"{field} does not have the picture's shape {shape}: {error}."
                ) from error
            object.__setattr__(self, field, plane)
        object.__setattr__(self, "signal_dn", signal)
        object.__setattr__(self, "models", tuple(self.models))
        if self.stars_px is not None:
            object.__setattr__(self, "stars_px", np.reshape(np.asarray(self.stars_px, np.float64), (-1, 2)))
        names = [model.target.name for model in self.models]
        if len(set(names)) != len(names):
            raise CenterfindingError(f"two bodies of the scene have one name: {', '.join(sorted(names))}.")
        freeze_arrays(self)

    def model(self, name: str) -> BodyModel:
        """Return the model of a body.

        Raises
        ------
        CenterfindingError
            No such body in the scene.
        """
        for model in self.models:
            if model.target.name == name:
                return model
        known = ", ".join(model.target.name for model in self.models) or "none"
        raise CenterfindingError(f"no model of {name!r} in this picture; it has {known}.")

    @property
    def observer(self) -> Observer:
        """The observer, of whom predictions use the velocity alone."""
        return Observer(np.zeros(3), self.observer_velocity_km_s, "body picture")

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons per data number: the noise model's, else the camera's, else 1."""
        if self.noise_model is not None:
            return self.noise_model.gain_e_per_dn
        gain = self.camera.gain_e_per_dn
        return 1.0 if gain is None or not np.isfinite(gain) else float(gain)

    @property
    def typical_noise_dn(self) -> float:
        """Median of the noise, which changes slowly over the picture: of pixels spread evenly over it."""
        apart = max(isqrt(self.noise_dn.size // NOISE_PIXELS), 1)
        return float(np.median(self.noise_dn[::apart, ::apart]))

    @property
    def shot_gain_e_per_dn(self) -> float:
        """That of the light's own noise: infinite where no noise model says how light scatters."""
        return np.inf if self.noise_model is None else self.noise_model.gain_e_per_dn

    def shown(self, part: tuple[slice, ...] = np.s_[:, :]) -> BoolArray:
        """Tell which pixels (n_line, n_pixel) of a part of the picture show anything: saturated ones do, whatever else."""
        return np.isfinite(self.signal_dn[part]) & (~self.bad[part] | self.saturated[part])

    def with_model(self, model: BodyModel) -> "BodyPicture":
        """Return the picture with another model of the body that it is of."""
        name = model.target.name
        return replace(self, models=tuple(model if m.target.name == name else m for m in self.models))

    def without(self, pixels: BoolArray) -> "BodyPicture":
        """Return the picture with pixels (n_line, n_pixel) that show nothing of what is looked for, saturated or not."""
        return replace(self, bad=self.bad | pixels, saturated=self.saturated & ~pixels)

    def with_spilled(self, pixels: BoolArray) -> "BodyPicture":
        """Return the picture without what pixels (n_line, n_pixel) show that charge has run into, or may have."""
        spilled = pixels if self.spilled is None else self.spilled | pixels
        return replace(self.without(pixels), spilled=spilled)

    @property
    def saturation_dn(self) -> float:
        """The level at which the picture saturates; inf where it does not."""
        known = self.signal_dn[self.saturated & np.isfinite(self.signal_dn)]
        return float(np.quantile(known, LOWEST_CUT)) if len(known) else np.inf

    @property
    def overexposed(self) -> BoolArray:
        """Pixels (n_line, n_pixel) that are saturated, or that charge of such ones hides."""
        return self.saturated if self.spilled is None else self.saturated | self.spilled

    def prediction(self, name: str) -> BodyPrediction:
        """Return where and how large a body is expected."""
        return predict_body(
            sized_target(self.model(name)), self.observer, self.camera, self.camera_from_j2000
        )

    def center_px(self, name: str) -> FloatArray:
        """Return where a body's center of figure is expected (pixel, line); nan behind the camera."""
        return self.prediction(name).pixel_line

    def diameter_px(self, name: str) -> float:
        """Return a body's predicted diameter: that of the circle with the area of its outline; 0 for a point."""
        diameter = self.prediction(name).diameter_px
        return diameter if np.isfinite(diameter) else 0.0

    def phase_rad(self, name: str) -> float:
        """Return the angle Sun - body - spacecraft; nan where the Sun is not known."""
        return self.prediction(name).phase_rad


def sized_target(model: BodyModel) -> TargetState:
    """Return a model's target with the extent of its shape, which its diameter and outline are predicted from."""
    if model.shape is None:
        return model.target
    return replace(model.target, radii_km=model.shape.radii_km)


# ---- Bodies moved to where the picture may show them, and rendered there.

RELATIVE_SUNLIGHT_E = (
    1e15  # where the camera's response is unknown: any number will do, brightness is then fitted
)


def displaced_model(
    picture: BodyPicture, name: str, center_px: ArrayLike, range_scale: float = 1.0
) -> BodyModel:
    """Return a body's model, moved so that its center of figure is seen at a place.

    Orientation and the Sun's place stay; so does the range, unless scaled.

    Parameters
    ----------
    center_px : (2,) array_like
        (pixel, line).
    range_scale
        Range over that of the a priori model.

    Raises
    ------
    CenterfindingError
        The place lies beyond what the camera model covers.
    """
    model = picture.model(name)
    place = np.asarray(center_px, dtype=np.float64)
    apparent = picture.camera.unproject(place[None])[0] @ picture.camera_from_j2000
    if not np.isfinite(apparent).all():
        raise CenterfindingError(
            f"{name}: pixel {place[0]:.1f}, line {place[1]:.1f} lies beyond what the model of {picture.camera.name} covers."
        )
    direction = geometric_direction(apparent, picture.observer_velocity_km_s)
    position = direction * (model.target.range_km * range_scale)
    return replace(model, target=model.target.standing_at(position))


FAN_NODES = 6  # a ray's direction is a polynomial of the distance: to 1e-9 rad within a body's image


class RayFan:
    """Rays of points that lie on straight lines from a center: many of them, without undistorting each.

    Parameters
    ----------
    angle_rad, limb_px : (t,) arrays
        Of each line, and the distance on it that is 1.
    lowest
        Least share of that distance that will be asked for; the largest is 1.
    """

    def __init__(
        self,
        picture: BodyPicture,
        center_px: FloatArray,
        angle_rad: FloatArray,
        limb_px: FloatArray,
        lowest: float,
    ) -> None:
        self._middle, self._half = 0.5 * (lowest + 1.0), max(0.5 * (1.0 - lowest), 1e-6)
        node = np.cos(np.pi * (np.arange(FAN_NODES) + 0.5) / FAN_NODES)
        wheel = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
        reach = limb_px * (self._middle + self._half * node)[:, None]
        places = center_px + reach[..., None] * wheel
        rays = pixel_rays(picture, places.reshape(-1, 2)).reshape(3, FAN_NODES, len(angle_rad))
        self._terms = np.einsum("kn,int->kit", np.linalg.inv(np.vander(node, increasing=True)), rays)

    def at(self, line: IntArray, share: FloatArray) -> FloatArray:
        """Return geometric J2000 rays (3, n) at shares (n,) of the lines numbered (n,)."""
        x = (share - self._middle) / self._half
        out = self._terms[-1][:, line]
        for term in self._terms[-2::-1]:
            out *= x
            out += term[:, line]
        return np.asarray(out)


def pixel_rays(picture: BodyPicture, places_px: FloatArray) -> FloatArray:
    """Return geometric J2000 rays (3, n) of points (n, 2) on the detector."""
    apparent = picture.camera.unproject(places_px) @ picture.camera_from_j2000
    return geometric_direction(apparent, picture.observer_velocity_km_s).T


def placed_models(
    picture: BodyPicture,
    places_px: Mapping[str, ArrayLike],
    range_scale: float | Mapping[str, float] = 1.0,
    only: Collection[str] | None = None,
) -> tuple[BodyModel, ...]:
    """Return the scene's models, those with a place moved there; `range_scale` applies to them."""
    for name in places_px:
        picture.model(name)  # raises for a name that is not there

    def placed(name: str) -> BodyModel:
        if name not in places_px:
            return picture.model(name)
        scale = range_scale.get(name, 1.0) if isinstance(range_scale, Mapping) else range_scale
        return displaced_model(picture, name, places_px[name], scale)

    names = (model.target.name for model in picture.models)
    return tuple(placed(name) for name in names if only is None or name in only)


def standing_at(
    picture: BodyPicture, places_px: Mapping[str, ArrayLike], found: Collection[str] = ()
) -> BodyPicture:
    """Return the picture with bodies expected at places (2,), those of them named in `found` because they were found there.

    A body whose place the camera model does not cover is expected where it was.
    """
    models = {model.target.name: model for model in picture.models}
    for name in models.keys() & places_px.keys():
        with suppress(CenterfindingError):
            models[name] = displaced_model(picture, name, places_px[name])
    return replace(picture, models=tuple(models.values()), found=picture.found | frozenset(found))


def sunlight_electrons(picture: BodyPicture) -> float:
    """Return the sunlight to render with; a stand-in where the camera's response is unknown."""
    return RELATIVE_SUNLIGHT_E if picture.sunlight_e is None else picture.sunlight_e


def model_picture(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    places_px: Mapping[str, ArrayLike],
    *,
    range_scale: float | Mapping[str, float] = 1.0,
    only: Collection[str] | None = None,
) -> FloatArray:
    """Render the scene's bodies with the camera's PSF, with some of them moved.

    Parameters
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines.
    places_px : mapping of str to (2,) array_like
        Centers of figure (pixel, line) of bodies; the others stand where they are predicted.
    range_scale
        Range over the a priori one, of the bodies in `places_px`.
    only : collection of str, optional
        Leave out all other bodies.

    Returns
    -------
    (n_line, n_pixel) array
        DN where the camera's response is known, else relative.

    Raises
    ------
    CenterfindingError
        A name that is not in the scene, or a place beyond what the camera model covers.
    """
    models = placed_models(picture, places_px, range_scale, only)
    rendering = render_bodies(
        models,
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
    )
    return np.asarray(rendering.electrons / picture.gain_e_per_dn)


# ---- A body's picture without kernels.

LIMB_MARGIN = 1.3  # of the circle's radius: what is left out of the background
LUNAR_WEIGHT = 0.5  # between Lambert and Lommel-Seeliger: what is known least matters least


def picture_from_circle(
    image_dn: ArrayLike,
    camera: Camera,
    circle: Circle,
    *,
    radii_km: ArrayLike | None = None,
    shape: ShapeModel | None = None,
    phase_rad: float,
    sun_angle_rad: float,
    range_km: float | None = None,
    north_angle_rad: float = -0.5 * np.pi,
    sub_observer_rad: tuple[float, float] = (0.0, 0.0),
    law: ScatteringLaw | None = None,
    name: str = "BODY",
    bad: ArrayLike = False,
    saturated: ArrayLike = False,
    background_dn: ArrayLike | None = None,
    psf: Psf | None = None,
) -> BodyPicture:
    """Describe a body in a picture that has neither kernels nor attitude.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
    circle
        Around the body: where its center is, and how large it looks.
    radii_km : (3,) array_like
        Semi-axes along body x, y, z; not needed with `shape`.
    phase_rad
        Angle Sun - body - camera.
    sun_angle_rad
        Direction toward the Sun in the picture, from +pixel toward +line.
    range_km
        Camera to body center; None: from the circle's radius and the mean radius.
    north_angle_rad
        Direction of the body's north pole in the picture, from +pixel toward +line (-pi/2: up).
    sub_observer_rad : (float, float)
        Longitude (east) and latitude of the camera as seen from the body.
    law
        Half Lambert, half Lommel-Seeliger unless given.
    bad, saturated : (n_line, n_pixel) array_like of bool
    background_dn : (n_line, n_pixel) array_like, optional
        None: estimated beside the body.
    psf
        None: the camera's.

    Returns
    -------
    BodyPicture
        In whose "J2000" the camera is at rest and looks along its own axes: centers (px) and ranges mean what they say,
        right ascensions do not.

    Raises
    ------
    CenterfindingError
        Neither radii nor shape, or a circle that the camera model does not cover.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> sky = np.random.default_rng(1).normal(10.0, 2.0, (1024, 1024))
    >>> picture = picture_from_circle(sky, camera, Circle([300.0, 400.0], 50.0),
    ...                               radii_km=[252.0] * 3, phase_rad=0.8, sun_angle_rad=3.1)
    >>> round(picture.diameter_px("BODY"), 1), round(picture.model("BODY").target.range_km)
    (100.0, 504002)
    """
    image = np.asarray(image_dn, dtype=np.float64)
    body = AssistedBody(
        circle.center_px, _extents(radii_km, shape), phase_rad, sun_angle_rad, circle.radius_px, range_km,
        north_angle_rad, np.asarray(sub_observer_rad),
    )  # fmt: skip
    target = assisted_target(name, body, camera, np.eye(3), np.zeros(3))
    signal, noise = _signal(image, background_dn, circle, bad)
    return BodyPicture(
        signal_dn=signal,
        noise_dn=noise,
        bad=np.asarray(bad, dtype=bool),
        saturated=np.asarray(saturated, dtype=bool),
        camera=camera,
        camera_from_j2000=np.eye(3),
        observer_velocity_km_s=np.zeros(3),
        models=(BodyModel(target, law=law or LunarLambert(LUNAR_WEIGHT), shape=shape),),
        psf=psf or camera.psf_shape or GaussianPsf(camera.psf.sigma_px, camera.psf.sigma_px),
        psf_width_sigma=MEASURED_PSF_SIGMA if psf or camera.psf_shape else stated_psf_sigma(camera),
        noise_model=_noise_model(camera),
    )


def _extents(radii_km: ArrayLike | None, shape: ShapeModel | None) -> FloatArray:
    """Return semi-axes (3,), km; of a shape, those of a sphere of its volume."""
    if shape is not None:
        return np.full(3, np.cbrt(0.75 * shape.volume_km3 / np.pi))
    if radii_km is None:
        raise CenterfindingError("a body needs three positive radii_km, or a shape; give one of them.")
    return np.asarray(radii_km, dtype=np.float64)


def _signal(
    image: FloatArray, background_dn: ArrayLike | None, circle: Circle, bad: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the picture above its background, and that background's noise."""
    line, pixel = np.mgrid[: image.shape[0], : image.shape[1]]
    near = np.hypot(pixel - circle.center_px[0], line - circle.center_px[1]) < LIMB_MARGIN * circle.radius_px
    out = near | np.broadcast_to(np.asarray(bad, dtype=bool), image.shape)
    if out.all():
        raise CenterfindingError("the circle leaves no sky to take the background from; give background_dn.")
    signal = image if background_dn is None else image - np.asarray(background_dn, dtype=np.float64)
    background = estimate_background(signal, out)
    return signal - background.level_dn, np.maximum(background.noise_dn, np.finfo(np.float32).tiny)


def _noise_model(camera: Camera) -> NoiseModel | None:
    gain = camera.gain_e_per_dn
    if gain is None or not np.isfinite(gain):
        return None
    read = camera.read_noise_dn
    return NoiseModel(0.0 if read is None or not np.isfinite(read) else float(read), float(gain))
