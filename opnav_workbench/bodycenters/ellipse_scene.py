"""A body's picture without kernels: its place and size from an analyst's circle, its light and pole from the analyst.

Flow   circle, range or radii, direction of the Sun and of the pole in the picture -> body before the camera -> `BodyPicture`
Frame  the camera's own frame stands for J2000, and the observer for one at rest
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import AU_KM, unit
from opnav_workbench.image import estimate_background
from opnav_workbench.psf import GaussianPsf, Psf
from opnav_workbench.render import BodyModel, LunarLambert, ScatteringLaw, ShapeModel
from opnav_workbench.starcenters import NoiseModel

__all__ = ["picture_from_circle"]

LIMB_MARGIN = 1.3  # of the circle's radius: what is left out of the background
CIRCLE_SIGMA = 0.1  # of the range that follows from a circle
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
    camera : Camera
    circle : Circle
        Around the body: where its center is, and how large it looks.
    radii_km : (3,) array_like
        Semi-axes along body x, y, z; not needed with `shape`.
    shape : ShapeModel, optional
    phase_rad : float
        Angle Sun - body - camera.
    sun_angle_rad : float
        Direction toward the Sun in the picture, from +pixel toward +line.
    range_km : float, optional
        Camera to body center; None: from the circle's radius and the mean radius.
    north_angle_rad : float
        Direction of the body's north pole in the picture, from +pixel toward +line (-pi/2: up).
    sub_observer_rad : (float, float)
        Longitude (east) and latitude of the camera as seen from the body.
    law : ScatteringLaw, optional
        Half Lambert, half Lommel-Seeliger unless given.
    name : str
    bad, saturated : (n_line, n_pixel) array_like of bool
    background_dn : (n_line, n_pixel) array_like, optional
        None: estimated beside the body.
    psf : Psf, optional
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
    extent = _extent(radii_km, shape)
    toward = camera.unproject(circle.center_px[None])[0]
    if not np.isfinite(toward).all():
        raise CenterfindingError(
            f"a circle about {circle.center_px.tolist()} px lies beyond what the model of {camera.name} covers."
        )
    axes = _picture_axes(camera, circle.center_px, toward)
    distance = _range(camera, circle, toward, extent) if range_km is None else range_km
    position = toward * distance
    sideways = np.cos(sun_angle_rad) * axes[0] + np.sin(sun_angle_rad) * axes[1]
    to_sun = np.sin(phase_rad) * unit(sideways) - np.cos(phase_rad) * toward
    north = unit(np.cos(north_angle_rad) * axes[0] + np.sin(north_angle_rad) * axes[1])
    target = TargetState(
        name,
        position,
        radii_km=None if radii_km is None else np.asarray(radii_km, dtype=np.float64),
        body_from_j2000=_body_axes(*sub_observer_rad) @ np.stack([np.cross(north, -toward), north, -toward]),
        sun_position_km=to_sun * AU_KM,
        covariance_km2=None if range_km is not None else (CIRCLE_SIGMA * distance) ** 2 * np.eye(3),
    )
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
        noise_model=_noise_model(camera),
    )


def _extent(radii_km: ArrayLike | None, shape: ShapeModel | None) -> float:
    """Return the mean radius, km."""
    if shape is not None:
        return float(np.cbrt(0.75 * shape.volume_km3 / np.pi))
    radii = np.asarray(radii_km, dtype=np.float64) if radii_km is not None else np.zeros(0)
    if radii.shape != (3,) or not np.all(np.isfinite(radii) & (radii > 0.0)):
        raise CenterfindingError("a body needs three positive radii_km, or a shape; give one of them.")
    return float(np.cbrt(radii.prod()))


def _picture_axes(camera: Camera, place: FloatArray, toward: FloatArray) -> FloatArray:
    """Return directions (2, 3) across the line of sight along which pixel and line increase, rad/px."""
    slopes = camera.unproject_jacobian(place[None])[0].T
    return np.asarray(slopes - np.outer(slopes @ toward, toward))


def _range(camera: Camera, circle: Circle, toward: FloatArray, radius_km: float) -> float:
    axes = _picture_axes(camera, circle.center_px, toward)
    rad_per_px = float(np.sqrt(np.linalg.norm(np.cross(axes[0], axes[1]))))
    return radius_km / float(np.sin(min(circle.radius_px * rad_per_px, 0.5 * np.pi)))


def _body_axes(longitude: float, latitude: float) -> FloatArray:
    """Return the matrix from east, north and up at a place of the body to its fixed axes."""
    cos_b, sin_b, cos_l, sin_l = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
    east = [-sin_l, cos_l, 0.0]
    north = [-sin_b * cos_l, -sin_b * sin_l, cos_b]
    return np.array([east, north, [cos_b * cos_l, cos_b * sin_l, sin_b]]).T


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
