"""A body by hand, where no ephemeris knows it: a circle around it, its size or range, and how it is lit.

The analyst says what is seen in the picture; with an attitude it becomes the body's state, as an ephemeris would give it.
Without one the camera's own axes serve, and positions are good for the picture alone.

Frame  the picture (angles from +pixel toward +line), and that of the attitude
Units  km, px, rad
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import geometric_direction, unit
from opnav_workbench.targets import TargetState

__all__ = ["AssistedBody", "apparent_radius_px", "assisted_target", "phase_at_terminator", "picture_axes"]

CIRCLE_SIGMA = 0.1  # of a circle's radius, and so of a range that follows from it
STATED_RANGE_SIGMA = 1e-3  # of a range that is stated: a label's, or a plan's
LIGHTING_SIGMA_RAD = float(np.radians(5.0))  # what the eye, or the light of a mottled disk, tells of the Sun
NEAREST_HORN = 0.9  # of the radius: nearer to a tip of the terminator a place tells little of the phase


@dataclass(frozen=True, slots=True, eq=False)
class AssistedBody:
    """A body as an analyst sees it in the picture.

    Attributes
    ----------
    center_px : (2,) array
        (pixel, line); it may lie off the detector.
    radii_km : (3,) array
        Semi-axes along body x, y, z.
    phase_rad
        Angle Sun - body - camera, 0 to pi.
    sun_angle_rad
        Direction toward the Sun in the picture, from +pixel toward +line.
    radius_px
        How large the body looks; needed where `range_km` is not given.
    range_km
        Camera to body center; None: from `radius_px` and the mean radius.
    north_angle_rad
        Direction of the body's north pole in the picture, from +pixel toward +line (-pi/2: up); None: nobody knows how
        the body lies.
    lighting_sigma_rad
        How far the Sun may stand from there, in each of two directions.
    sub_observer_rad : (2,) array
        Longitude (east) and latitude of the camera as seen from the body.

    Raises
    ------
    CenterfindingError
        A value that is not finite or cannot be, or neither radius nor range.

    Examples
    --------
    >>> body = AssistedBody([512.0, 600.0], [252.0, 252.0, 252.0], 0.8, 3.1, radius_px=291.0)
    >>> body.mean_radius_km
    252.0
    """

    center_px: FloatArray
    radii_km: FloatArray
    phase_rad: float
    sun_angle_rad: float
    radius_px: float | None = None
    range_km: float | None = None
    north_angle_rad: float | None = None
    sub_observer_rad: FloatArray = (0.0, 0.0)  # type: ignore[assignment]
    lighting_sigma_rad: float = LIGHTING_SIGMA_RAD

    def __post_init__(self) -> None:
        for name, length in (("center_px", 2), ("radii_km", 3), ("sub_observer_rad", 2)):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != (length,) or not np.isfinite(array).all():
                raise CenterfindingError(f"{name} is {array.tolist()}; give {length} finite numbers.")
            object.__setattr__(self, name, array)
        freeze_arrays(self)
        self._check_size()
        self._check_angles()

    def _check_size(self) -> None:
        if not np.all(self.radii_km > 0.0):
            raise CenterfindingError(f"radii_km is {self.radii_km.tolist()}; give three positive numbers.")
        if self.radius_px is None and self.range_km is None:
            raise CenterfindingError("how far the body is, nobody tells; give radius_px or range_km.")
        for name in ("radius_px", "range_km"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise CenterfindingError(f"{name} is {value!r}; give a positive number.")
        if self.range_km is not None and self.range_km <= self.mean_radius_km:
            raise CenterfindingError(
                f"range_km is {self.range_km:g}, inside a body of {self.mean_radius_km:g} km; it counts from the center."
            )

    def _check_angles(self) -> None:
        if not np.isfinite([self.sun_angle_rad, self.north_angle_rad or 0.0]).all():
            raise CenterfindingError("the angles toward Sun and north must be finite numbers.")
        if not 0.0 <= self.phase_rad <= np.pi:
            raise CenterfindingError(
                f"the phase angle is {np.degrees(self.phase_rad):g} deg; give 0 (full) to 180 (dark)."
            )
        if not 0.0 <= self.lighting_sigma_rad <= 1.0:
            raise CenterfindingError(
                f"the Sun's sigma is {np.degrees(self.lighting_sigma_rad):g} deg; give 0 to 57."
            )

    @property
    def mean_radius_km(self) -> float:
        """Radius of a sphere of the same volume."""
        return float(np.cbrt(self.radii_km.prod()))


def assisted_target(
    name: str,
    body: AssistedBody,
    camera: Camera,
    camera_from_j2000: FloatArray,
    observer_velocity_km_s: FloatArray,
    sun_range_km: float = AU_KM,
) -> TargetState:
    """Return the state of a body that stands, with this attitude, where the analyst put it.

    Parameters
    ----------
    camera_from_j2000 : (3, 3) array
        The identity where nobody knows it: "J2000" then is the camera's own frame.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter: the aberration is taken off.
    sun_range_km
        How far the Sun is.

    Returns
    -------
    TargetState
        Its covariance is the circle's: a tenth of the radius across, and along where the range follows from it.

    Raises
    ------
    CenterfindingError
        The camera model does not cover the place.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> body = AssistedBody([300.0, 400.0], [252.0] * 3, 0.8, 3.1, radius_px=50.0)
    >>> round(assisted_target("ENCELADUS", body, camera, np.eye(3), np.zeros(3)).range_km)
    504002
    """
    camera = camera.standing(camera_from_j2000)
    toward = _toward(body, camera, f"{name}: ")
    axes = picture_axes(camera, body.center_px, toward)
    distance = body.range_km or _range(axes, body)
    sideways = np.cos(body.sun_angle_rad) * axes[0] + np.sin(body.sun_angle_rad) * axes[1]
    to_sun = np.sin(body.phase_rad) * unit(sideways) - np.cos(body.phase_rad) * toward
    apparent = toward @ camera_from_j2000
    direction = geometric_direction(apparent, observer_velocity_km_s)
    return TargetState(
        name,
        direction * distance,
        radii_km=body.radii_km,
        body_from_j2000=None
        if body.north_angle_rad is None
        else _orientation(body, body.north_angle_rad, axes, toward) @ camera_from_j2000,
        sun_position_km=to_sun @ camera_from_j2000 * sun_range_km,
        covariance_km2=_covariance(body, direction, distance),
    )


def apparent_radius_px(body: AssistedBody, camera: Camera) -> float:
    """Return how large a body looks: as it was drawn, or as its range says.

    Raises
    ------
    CenterfindingError
        The camera model does not cover the place.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> body = AssistedBody([300.0, 400.0], [252.0] * 3, 0.8, 3.1, range_km=504002.0)
    >>> round(apparent_radius_px(body, camera), 3)
    50.0
    """
    if body.radius_px is not None and body.range_km is None:
        return body.radius_px
    assert body.range_km is not None
    toward = _toward(body, camera)
    rad_per_px = _rad_per_px(picture_axes(camera, body.center_px, toward))
    return float(np.arcsin(body.mean_radius_km / body.range_km)) / rad_per_px


def _toward(body: AssistedBody, camera: Camera, whose: str = "") -> FloatArray:
    """Return the unit vector (3,) to a body's center, camera frame."""
    toward = np.asarray(camera.unproject(body.center_px[None])[0])
    if not np.isfinite(toward).all():
        raise CenterfindingError(
            f"{whose}{body.center_px.tolist()} px lies beyond what the model of {camera.name} covers."
        )
    return toward


def phase_at_terminator(
    center_px: FloatArray, radius_px: float, sun_angle_rad: float, place_px: FloatArray
) -> float:
    """Return the phase angle (rad) of a sphere whose terminator passes through a place.

    The terminator is half an ellipse: where the limb is w = sqrt(r^2 - v^2) from the line through the center that is
    square to the Sun, it is -w cos(phase), toward the Sun counted positive; v is measured along that line.

    Parameters
    ----------
    center_px, place_px : (2,) array
        (pixel, line).
    sun_angle_rad
        Direction toward the Sun in the picture, from +pixel toward +line.

    Raises
    ------
    CenterfindingError
        The place lies outside the disk, or so near to a horn that it tells no phase.

    Examples
    --------
    >>> round(float(np.degrees(phase_at_terminator([100.0, 80.0], 50.0, 0.0, [125.0, 80.0]))), 6)
    120.0
    """
    off = np.asarray(place_px, dtype=float) - np.asarray(center_px, dtype=float)
    sun = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
    along, across = float(off @ sun) / radius_px, float(off @ [-sun[1], sun[0]]) / radius_px
    if abs(across) > NEAREST_HORN:
        raise CenterfindingError(
            "that place is beside the disk, or at a horn, where every phase has its terminator; "
            "take one nearer to the line from the Sun through the center."
        )
    cosine = -along / float(np.sqrt(1.0 - across**2))
    if abs(cosine) > 1.0:
        raise CenterfindingError("that place is outside the circle; the terminator lies within.")
    return float(np.arccos(cosine))


def picture_axes(camera: Camera, place: FloatArray, toward: FloatArray) -> FloatArray:
    """Return directions (2, 3) across the line of sight along which pixel and line increase, rad/px."""
    slopes = camera.unproject_jacobian(place[None])[0].T
    return np.asarray(slopes - np.outer(slopes @ toward, toward))


def _range(axes: FloatArray, body: AssistedBody) -> float:
    assert body.radius_px is not None
    return body.mean_radius_km / float(np.sin(min(body.radius_px * _rad_per_px(axes), 0.5 * np.pi)))


def _rad_per_px(axes: FloatArray) -> float:
    return float(np.sqrt(np.linalg.norm(np.cross(axes[0], axes[1]))))


def _covariance(body: AssistedBody, direction: FloatArray, distance: float) -> FloatArray:
    """Return how far a circle by hand may be off, across the line of sight and along it."""
    along = np.outer(direction, direction)
    range_sigma_km = distance * (CIRCLE_SIGMA if body.range_km is None else STATED_RANGE_SIGMA)
    across_km2 = (CIRCLE_SIGMA * body.mean_radius_km) ** 2
    return np.asarray(across_km2 * (np.eye(3) - along) + range_sigma_km**2 * along)


def _orientation(
    body: AssistedBody, north_angle_rad: float, axes: FloatArray, toward: FloatArray
) -> FloatArray:
    """Return the matrix from the camera's frame to the body's."""
    north = unit(np.cos(north_angle_rad) * axes[0] + np.sin(north_angle_rad) * axes[1])
    return _body_axes(*body.sub_observer_rad) @ np.stack([np.cross(north, -toward), north, -toward])


def _body_axes(longitude: float, latitude: float) -> FloatArray:
    """Return the matrix from east, north and up at a place of the body to its fixed axes."""
    cos_b, sin_b, cos_l, sin_l = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
    east = [-sin_l, cos_l, 0.0]
    north = [-sin_b * cos_l, -sin_b * sin_l, cos_b]
    return np.array([east, north, [cos_b * cos_l, cos_b * sin_l, sin_b]]).T
